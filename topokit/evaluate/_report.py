"""Tables and figures from one file of results, and from nothing else.

Taught in chapter 11.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from topokit._archive import atomic_file

from ._summary import MEASURES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "LABELS",
    "hull_table",
    "markdown",
    "plot_bars",
    "plot_conditions",
    "plot_curves",
    "plot_treatments",
    "write_report",
]

LABELS = {
    "seqph": "seqPH",
    "hold": "hold",
    "carry": "carry",
    "ridge": "ridge",
    "mlp": "MLP",
    "pointnet": "PointNet",
    "ours": "ours",
}
_GREY = {"seqph": "0.35", "hold": "0.75", "carry": "0.6"}
_COLOURS = {"ridge": 5, "mlp": 1, "pointnet": 2, "ours": 0}  # those of the identities, so that books have one palette
_NOT_DRAWN = tuple(f"marked curve alone, within {tolerance} cm" for tolerance in (0, 1, 3, 10))  # between the others
Cells = Mapping[str, Any]


def write_report(results: str | Path, out: str | Path) -> list[Path]:
    """Write `tables.md` and the figures of a file of results, which it shows at its end, into a folder.

    Returns
    -------
    list of Path

    Raises
    ------
    FileNotFoundError, FormatError
        When there is no file of results.
    """
    from ._forecasts import read_results

    content = read_results(results)
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / "tables.md"]
    where, first = next(iter(content["conditions"].items()))
    hull = "Share of windows in the hull, by"
    figures = (
        ("hull_accuracy", f"{hull} horizon", lambda ax: plot_bars(first, content["horizons"], ax)),
        (
            "distance",
            "Distance from the centre of the true loop, by horizon",
            lambda ax: plot_curves(first, "distance_cm", ax),
        ),
        ("conditions", f"{hull} condition", lambda ax: plot_conditions(content, ax)),
        ("treatments", f"{hull} treatment of the hull", lambda ax: plot_treatments(first, ax)),
    )
    shown = [f"![{caption}]({name}.svg)" for name, caption, _ in figures]
    text = [markdown(content).rstrip(), f"## Figures ({where}, where they do not name others)", *shown]
    with atomic_file(files[0]) as handle:
        handle.write(("\n\n".join(text) + "\n").encode())
    for name, _, draw in figures:
        figure = _figure()
        draw(figure.add_subplot())  # type: ignore[no-untyped-call]
        files.append(folder / f"{name}.svg")
        with atomic_file(files[-1]) as handle:
            figure.savefig(handle, format="svg", metadata={"Date": None})
    return files


# -- tables -----------------------------------------------------------------------------------------------------------------


def hull_table(condition: Mapping[str, Any], horizons: Sequence[str]) -> str:
    """The hull measure of a condition as Markdown, per cent."""
    return _table(condition["hull_accuracy"], horizons, share=True)


def markdown(results: Mapping[str, Any]) -> str:
    """All tables as one Markdown document."""
    lines = ["# Results", "", f"Ours is `{results['ours']}`. {results['measure']}.", ""]
    lines += ["Made by", "", "```", *results["commands"], "```", ""]
    for name, condition in results["conditions"].items():
        episodes, windows = condition["episodes"], condition["windows"]
        lines += [f"## {name.capitalize()}", "", f"{windows} windows of {episodes} episodes.", ""]
        for measure, meaning in MEASURES.items():
            share = measure not in ("distance_cm", "distance_median_cm", "nll", "nll_median")
            title = meaning[0].upper() + meaning[1:] + (" (%)" if share else "")
            lines += [f"### {title}", "", _table(condition[measure], results["horizons"], share), ""]
        if condition["gain_of_ours"]:
            lines += ["### What ours gains over the others in the hull measure (points)", ""]
            lines += [_table(condition["gain_of_ours"], results["horizons"], share=True), ""]
    return "\n".join(lines)


def _table(rows: Mapping[str, Cells], horizons: Sequence[str], share: bool) -> str:
    head = ["", *(key if key == "mean" else f"t+{key}" for key in horizons)]
    body = [[label(model), *(_cell(cells.get(key), share) for key in horizons)] for model, cells in rows.items()]
    lines = ["| " + " | ".join(line) + " |" for line in [head, ["---", *["---:"] * len(horizons)], *body]]
    return "\n".join(lines)


def _cell(entry: Mapping[str, float | None] | None, share: bool) -> str:
    if not entry or entry["mean"] is None:
        return "-"
    scale, digits = (100, 1) if share else (1, 2)
    value, low, high = (
        "-" if number is None else f"{scale * number:.{digits}f}"
        for number in (entry[k] for k in ("mean", "low", "high"))
    )
    return f"{value} [{low}, {high}]"


def label(model: str) -> str:
    """What a model is called in tables and figures."""
    return LABELS.get(model, model)


# -- figures ----------------------------------------------------------------------------------------------------------------


def plot_bars(condition: Mapping[str, Any], horizons: Sequence[str], ax: Axes) -> Axes:
    """The paper's figure: the hull measure as bars with intervals, a group for each horizon."""
    rows = condition["hull_accuracy"]
    width = 0.84 / len(rows)
    for k, (model, cells) in enumerate(rows.items()):
        place = [i + (k - (len(rows) - 1) / 2) * width for i in range(len(horizons))]
        values, below, above = _bars([cells[key] for key in horizons], 100)
        ax.bar(place, values, 0.92 * width, color=_colour(model), label=label(model))
        ax.errorbar(place, values, [below, above], fmt="none", ecolor="0.1", elinewidth=1, capsize=1.5)
    ax.set_xticks(range(len(horizons)), [key if key == "mean" else f"t+{key}" for key in horizons])
    ax.set(ylabel="mean in the true hull (%)", ylim=(0, 100))
    _legend(ax, len(rows))
    return ax


def plot_curves(condition: Mapping[str, Any], measure: str, ax: Axes) -> Axes:
    """A measure against the horizon, with bands for the intervals of PointNet and ours."""
    rows = condition["curves"][measure]
    scale = 1 if measure.endswith("cm") else 100
    for model, cells in rows.items():
        there = [(int(step), cell) for step, cell in cells.items() if cell["mean"] is not None]
        steps = [step for step, _ in there]
        dashes = "--" if model in _GREY else "-"
        ax.plot(
            steps,
            [scale * cell["mean"] for _, cell in there],
            color=_colour(model),
            label=label(model),
            linestyle=dashes,
        )
        if model in ("pointnet", "ours"):
            low, high = ([scale * cell[side] for _, cell in there] for side in ("low", "high"))
            ax.fill_between(steps, low, high, color=_colour(model), alpha=0.2, linewidth=0)
    name = {"hull_accuracy": "mean in the true hull (%)", "distance_cm": "distance from the true centre (cm)"}
    ax.set(xlabel="frames ahead", ylabel=name.get(measure, f"{measure} (%)"), ylim=(0, None))
    _legend(ax, len(rows))
    return ax


def plot_conditions(results: Mapping[str, Any], ax: Axes, horizon: str = "mean") -> Axes:
    """The hull measure of all models under all conditions, as dots with intervals."""
    conditions = results["conditions"]
    models = list(dict.fromkeys(model for condition in conditions.values() for model in condition["hull_accuracy"]))
    for k, model in enumerate(models):
        for i, condition in enumerate(conditions.values()):
            cell = condition["hull_accuracy"].get(model, {}).get(horizon)
            if not cell or cell["mean"] is None:
                continue
            place = i + (k - (len(models) - 1) / 2) * 0.8 / len(models)
            ax.plot([100 * cell["low"], 100 * cell["high"]], [place, place], color=_colour(model), linewidth=1.5)
            ax.plot(
                100 * cell["mean"],
                place,
                "o",
                markersize=4,
                color=_colour(model),
                label=label(model) if not i else None,
            )
    ax.set_yticks(range(len(conditions)), list(conditions))
    ax.invert_yaxis()
    for i in range(1, len(conditions)):
        ax.axhline(i - 0.5, color="0.85", linewidth=0.8)
    ax.set_xlabel("mean in the true hull (%)" + ("" if horizon == "mean" else f", t+{horizon}"))
    _legend(ax, len(models))
    return ax


def plot_treatments(condition: Mapping[str, Any], ax: Axes, horizon: str = "mean") -> Axes:
    """The hull measure under each treatment of nearly flat hulls: lines that do not cross keep the order."""
    ways = {name: rows for name, rows in condition["hull_treatments"].items() if name not in _NOT_DRAWN}
    for model in next(iter(ways.values())):
        values = [100 * rows[model][horizon]["mean"] for rows in ways.values()]
        ax.plot(range(len(ways)), values, "o-", markersize=4, color=_colour(model), label=label(model))
    ax.set_xticks(range(len(ways)), [_two_lines(name) for name in ways], fontsize="x-small")
    ax.set(ylabel="mean in the true hull (%)", ylim=(0, 100))
    _legend(ax, len(LABELS))
    return ax


def _two_lines(name: str) -> str:
    first, _, rest = name.replace("marked curve alone, within", "marked:").partition(" ")
    return f"{first}\n{rest}"


def _bars(cells: Sequence[Mapping[str, float | None]], scale: float) -> tuple[list[float], list[float], list[float]]:
    """Values, and how far the intervals reach below and above."""
    known = [{key: scale * (value or 0.0) for key, value in cell.items()} for cell in cells]
    return (
        [cell["mean"] for cell in known],
        [max(cell["mean"] - cell["low"], 0) for cell in known],
        [max(cell["high"] - cell["mean"], 0) for cell in known],
    )


def _colour(model: str) -> str:
    from topokit.view import loop_colour

    return _GREY.get(model) or loop_colour(_COLOURS.get(model, 3))


def _legend(ax: Axes, columns: int) -> None:
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=min(columns, 7), fontsize="small", frameon=False)


def _figure() -> Figure:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    mpl.rcParams["svg.hashsalt"] = "topokit"  # the same file from the same numbers
    return Figure(figsize=(8, 3.6), layout="constrained")
