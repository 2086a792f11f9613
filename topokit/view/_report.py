"""Figures of an evaluation, from the file of its results (`topokit.evaluate.read_results`). Taught in chapter 13."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.axes import Axes

from ._plots import loop_colour

_LABELS = {"seqph": "seqPH", "mlp": "MLP", "mlp, places": "MLP, places", "pointnet": "PointNet"}
_GREYS = {"seqph": "0.35", "hold": "0.75", "carry": "0.6"}
_COLOURS = {"ours": 0, "mlp": 1, "pointnet": 2, "ridge": 5, "few": 4, "longer": 2}  # of the identities: one palette
_CURVES = {"marked curve alone": "marked", "any curve of the class": "any"}
# These lie between others.
_NOT_DRAWN = tuple(f"{curve}, within {tolerance} cm" for curve in _CURVES for tolerance in (0, 1, 3, 10))
_ACCURACY = "mean in the true hull (%)"


def model_label(model: str) -> str:
    """Return what a model of the results is called in tables and figures."""
    return _LABELS.get(model, model)


def plot_accuracy(condition: Mapping[str, Any], horizons: Sequence[str], ax: Axes) -> Axes:
    """Draw the paper's figure: the hull measure as bars with intervals, a group for each horizon.

    Parameters
    ----------
    condition : mapping, one of the `conditions` of the results or one garment of it
    horizons : sequence of str, those of the results
    ax : Axes
    """
    rows = condition["hull_accuracy"]
    width = 0.84 / len(rows)
    for k, (model, cells) in enumerate(rows.items()):
        place = [i + (k - (len(rows) - 1) / 2) * width for i in range(len(horizons))]
        low, value, high = ([100 * (cells[key][side] or 0) for key in horizons] for side in ("low", "mean", "high"))
        reach = [[max(b - a, 0) for a, b in zip(*pair, strict=True)] for pair in ((low, value), (value, high))]
        ax.bar(place, value, 0.92 * width, color=_colour(model), label=model_label(model))
        ax.errorbar(place, value, reach, fmt="none", ecolor="0.1", elinewidth=1, capsize=1.5)
    ax.set_xticks(range(len(horizons)), [key if key == "mean" else f"t+{key}" for key in horizons])
    ax.set(ylabel=_ACCURACY, ylim=(0, 100))
    return _with_legend(ax)


def plot_by_horizon(condition: Mapping[str, Any], measure: str, ax: Axes) -> Axes:
    """Draw a measure against the horizon, with bands for the intervals of PointNet and ours.

    Parameters
    ----------
    condition : mapping, one of the `conditions` of the results
    measure : str, a name of its `curves`
    ax : Axes
    """
    scale = 1 if measure.endswith("cm") else 100
    for model, cells in condition["curves"][measure].items():
        there = [(int(step), cell) for step, cell in cells.items() if cell["mean"] is not None]
        steps = [step for step, _ in there]
        low, value, high = ([scale * cell[side] for _, cell in there] for side in ("low", "mean", "high"))
        dashes = "--" if model in _GREYS else "-"
        ax.plot(steps, value, color=_colour(model), label=model_label(model), linestyle=dashes)
        if model in ("pointnet", "ours"):
            ax.fill_between(steps, low, high, color=_colour(model), alpha=0.2, linewidth=0)
    names = {"hull_accuracy": _ACCURACY, "distance_cm": "distance from the true centre (cm)"}
    ax.set(xlabel="frames ahead", ylabel=names.get(measure, f"{measure} (%)"), ylim=(0, None))
    return _with_legend(ax)


def plot_conditions(results: Mapping[str, Any], ax: Axes) -> Axes:
    """Draw the hull measure of all models under all conditions, the mean over the horizons, as dots with intervals.

    Parameters
    ----------
    results : mapping, the whole file
    ax : Axes
    """
    tables = [condition["hull_accuracy"] for condition in results["conditions"].values()]
    models = list(dict.fromkeys(model for table in tables for model in table))
    for k, model in enumerate(models):
        for i, table in enumerate(tables):
            cell = table.get(model, {}).get("mean")
            if not cell or cell["mean"] is None:
                continue
            place = i + (k - (len(models) - 1) / 2) * 0.8 / len(models)
            label = model_label(model) if not i else None
            ax.plot([100 * cell["low"], 100 * cell["high"]], [place, place], color=_colour(model), linewidth=1.5)
            ax.plot(100 * cell["mean"], place, "o", markersize=4, color=_colour(model), label=label)
    ax.set_yticks(range(len(tables)), list(results["conditions"]))
    ax.invert_yaxis()
    for i in range(1, len(tables)):
        ax.axhline(i - 0.5, color="0.85", linewidth=0.8)
    ax.set_xlabel(_ACCURACY)
    return _with_legend(ax)


def plot_treatments(condition: Mapping[str, Any], ax: Axes) -> Axes:
    """Draw the hull measure under each treatment of nearly flat hulls: lines that do not cross keep the order.

    Parameters
    ----------
    condition : mapping, the first of the `conditions` of the results
    ax : Axes
    """
    ways = {name: rows for name, rows in condition["hull_treatments"].items() if name not in _NOT_DRAWN}
    for model in next(iter(ways.values())):
        values = [100 * rows[model]["mean"]["mean"] for rows in ways.values()]
        ax.plot(range(len(ways)), values, "o-", markersize=4, color=_colour(model), label=model_label(model))
    names = list(ways)
    for curve, short in _CURVES.items():
        names = [name.replace(f"{curve}, within", f"{short}:") for name in names]
    names = [name.replace(" ", "\n", 2) for name in names]
    ax.set_xticks(range(len(ways)), names, fontsize="x-small")
    ax.set(ylabel=_ACCURACY, ylim=(0, 100))
    return _with_legend(ax)


def _colour(model: str) -> str:
    return _GREYS.get(model) or loop_colour(_COLOURS.get(model, 3))


def _with_legend(ax: Axes) -> Axes:
    count = len(ax.get_legend_handles_labels()[1])
    columns = count if count < 8 else (count + 1) // 2
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=columns, fontsize="small", frameon=False)
    return ax
