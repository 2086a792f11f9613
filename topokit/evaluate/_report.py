"""Tables and figures from one file of results, and from nothing else.

Taught in chapter 11.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from topokit._archive import atomic_file

from ._results import read_results
from ._summary import MEASURES


def write_report(results: str | Path, out: str | Path) -> list[Path]:
    """Write `tables.md` and the figures of a file of results, which it shows at its end, into a folder.

    Parameters
    ----------
    results : path
        What `evaluate_forecasts` wrote.
    out : path
        A folder; it is made when it is not there.

    Returns
    -------
    list of Path

    Raises
    ------
    FileNotFoundError, FormatError
        When there is no file of results.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    from topokit import view

    content, folder = read_results(results), Path(out)
    where, first = next(iter(content["conditions"].items()))
    hull = "Share of windows in the hull, by"
    figures: dict[str, tuple[str, Callable[..., Any], tuple[Any, ...]]] = {
        "hull_accuracy": (f"{hull} horizon", view.plot_accuracy, (first, content["horizons"])),
        "distance": (
            "Distance from the centre of the true loop, by horizon",
            view.plot_by_horizon,
            (first, "distance_cm"),
        ),
        "conditions": (f"{hull} condition", view.plot_conditions, (content,)),
        "treatments": (f"{hull} treatment of the hull", view.plot_treatments, (first,)),
    }
    shown = [f"![{caption}]({name}.svg)" for name, (caption, _, _) in figures.items()]
    text = [
        markdown(content, view.model_label).rstrip(),
        f"## Figures ({where}, where they do not name others)",
        *shown,
    ]
    files = [folder / "tables.md"]
    with atomic_file(files[0]) as handle:
        handle.write(("\n\n".join(text) + "\n").encode())
    for name, (_, draw, given) in figures.items():
        files.append(folder / f"{name}.svg")
        figure = Figure(figsize=(8, 3.6), layout="constrained")
        draw(*given, figure.add_subplot())
        with atomic_file(files[-1]) as handle, mpl.rc_context({"svg.hashsalt": "topokit"}):  # same numbers, same file
            figure.savefig(handle, format="svg", metadata={"Date": None})
    return files


def hull_table(condition: Mapping[str, Any], horizons: Sequence[str]) -> str:
    """The hull measure of a condition as Markdown, per cent; models go by their names in the results."""
    return _table(condition["hull_accuracy"], horizons, share=True)


def markdown(results: Mapping[str, Any], label: Callable[[str], str]) -> str:
    """All tables as one Markdown document; `label` says what a model is called."""
    lines = ["# Results", "", f"Ours is `{results['ours']}`. {results['measure']}.", ""]
    lines += ["Made by", "", "```", *results["commands"], "```", ""]
    for name, condition in results["conditions"].items():
        episodes, windows = condition["episodes"], condition["windows"]
        lines += [f"## {name.capitalize()}", "", f"{windows} windows of {episodes} episodes.", ""]
        for measure in [measure for measure in MEASURES if measure in condition]:  # an older file lacks some
            share = measure not in ("distance_cm", "distance_median_cm", "nll", "nll_median")
            meaning = MEASURES[measure]
            title = meaning[0].upper() + meaning[1:] + (" (%)" if share else "")
            lines += [f"### {title}", "", _table(condition[measure], results["horizons"], share, label), ""]
        if condition["gain_of_ours"]:
            lines += ["### What ours gains over the others in the hull measure (points)", ""]
            lines += [_table(condition["gain_of_ours"], results["horizons"], True, label), ""]
    return "\n".join(lines)


def _table(
    rows: Mapping[str, Mapping[str, Any]], horizons: Sequence[str], share: bool, label: Callable[[str], str] = str
) -> str:
    head = ["", *(key if key == "mean" else f"t+{key}" for key in horizons)]
    body = [[label(model), *(_cell(cells.get(key), share) for key in horizons)] for model, cells in rows.items()]
    lines = ["| " + " | ".join(line) + " |" for line in [head, ["---", *["---:"] * len(horizons)], *body]]
    return "\n".join(lines)


def _cell(entry: Mapping[str, float | None] | None, share: bool) -> str:
    if not entry or entry["mean"] is None:
        return "-"
    scale, digits = (100, 1) if share else (1, 2)
    numbers = [entry[side] for side in ("mean", "low", "high")]
    value, low, high = ("-" if number is None else f"{scale * number:.{digits}f}" for number in numbers)
    return f"{value} [{low}, {high}]"
