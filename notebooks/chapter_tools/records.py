"""Figures of a record of forecasts, `book/results/motion.json` or `unseen.json`. Taught in chapter 15."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.axes import Axes

from topokit.view import loop_colour

LABELS = {"ours": "Motion", "seqph": "seqPH", "mlp": "MLP", "mlp, places": "MLP, places", "pointnet": "PointNet"}
GREYS = {"seqph": "0.35", "hold": "0.75", "carry": "0.6"}
COLOURS = {"ours": 0, "mlp": 1, "pointnet": 2, "ridge": 5, "few": 4, "longer": 2}  # of the identities: one palette
MARKS = {
    "ours": "o",
    "mlp": "s",
    "pointnet": "^",
    "ridge": "D",
    "mlp, places": "v",
    "few": "s",
    "longer": "^",
    "carry": "P",
    "hold": "X",
}
CURVES = {"marked curve alone": "marked", "any curve of the class": "any"}
# Treatments that lie between others are not drawn.
NOT_DRAWN = {f"{curve}, within {tolerance} cm" for curve in CURVES for tolerance in (0, 1, 3, 10)}
ACCURACY = "mean in the true hull (%)"


def model_label(model: str) -> str:
    """Return the name of a model in tables and figures."""
    return LABELS.get(model, model)


def plot_accuracy(condition: Mapping[str, Any], horizons: Sequence[str], ax: Axes) -> Axes:
    """Draw the paper's figure: the hull measure as bars with intervals, a group for each horizon.

    Parameters
    ----------
    condition : mapping
        One of the `conditions` of the record, or one garment of it.
    horizons : sequence of str
        Those of the record.
    ax : Axes
    """
    rows = condition["hull_accuracy"]
    width = 0.84 / len(rows)
    for k, (model, cells) in enumerate(rows.items()):
        offset = (k - (len(rows) - 1) / 2) * width
        places = [group + offset for group in range(len(horizons))]
        low, value, high = ([100 * (cells[key][side] or 0) for key in horizons] for side in ("low", "mean", "high"))
        below = [max(b - a, 0) for a, b in zip(low, value, strict=True)]
        above = [max(b - a, 0) for a, b in zip(value, high, strict=True)]
        ax.bar(places, value, 0.92 * width, color=_colour(model), label=model_label(model))
        ax.errorbar(places, value, [below, above], fmt="none", ecolor="0.1", elinewidth=1, capsize=1.5)
    ax.set_xticks(range(len(horizons)), ["mean" if key == "mean" else f"t+{key}" for key in horizons])
    ax.set(ylabel=ACCURACY, ylim=(0, 100))
    return _with_legend(ax)


def plot_by_horizon(condition: Mapping[str, Any], measure: str, ax: Axes) -> Axes:
    """Draw a measure against the horizon, with bands for the intervals of PointNet and Motion.

    Parameters
    ----------
    condition : mapping
        One of the `conditions` of the record.
    measure : str
        A name of its `curves`.
    ax : Axes
    """
    scale = 1 if measure.endswith("cm") else 100
    for model, cells in condition["curves"][measure].items():
        known = {int(step): cell for step, cell in cells.items() if cell["mean"] is not None}
        low, value, high = ([scale * cell[side] for cell in known.values()] for side in ("low", "mean", "high"))
        look = {"linestyle": "--" if model in GREYS else "-", "marker": MARKS.get(model, "."), "markersize": 4}
        ax.plot(list(known), value, color=_colour(model), label=model_label(model), **look)
        if model in ("pointnet", "ours"):
            ax.fill_between(list(known), low, high, color=_colour(model), alpha=0.2, linewidth=0)
    names = {"hull_accuracy": ACCURACY, "distance_cm": "distance from the true centre (cm)"}
    ax.set(xlabel="frames ahead", ylabel=names.get(measure, f"{measure} (%)"), ylim=(0, None))
    return _with_legend(ax)


def plot_conditions(results: Mapping[str, Any], ax: Axes) -> Axes:
    """Draw the hull measure of all models under all conditions of a record, the mean over the horizons, with intervals."""
    tables = [condition["hull_accuracy"] for condition in results["conditions"].values()]
    models = list(dict.fromkeys(model for table in tables for model in table))
    for k, model in enumerate(models):
        offset = (k - (len(models) - 1) / 2) * 0.8 / len(models)
        for i, table in enumerate(tables):
            cell = table.get(model, {}).get("mean")
            if not cell or cell["mean"] is None:
                continue
            place = i + offset
            label = None if i else model_label(model)
            ax.plot([100 * cell["low"], 100 * cell["high"]], [place, place], color=_colour(model), linewidth=1.5)
            ax.plot(100 * cell["mean"], place, MARKS.get(model, "."), markersize=4, color=_colour(model), label=label)
    ax.set_yticks(range(len(tables)), list(results["conditions"]))
    ax.invert_yaxis()
    for i in range(1, len(tables)):
        ax.axhline(i - 0.5, color="0.85", linewidth=0.8)
    ax.set_xlabel(ACCURACY)
    return _with_legend(ax)


def plot_treatments(condition: Mapping[str, Any], ax: Axes) -> Axes:
    """Draw the hull measure under each treatment of nearly flat hulls: lines that do not cross keep the order.

    Parameters
    ----------
    condition : mapping
        The first of the `conditions` of the record.
    ax : Axes
    """
    treatments = {name: rows for name, rows in condition["hull_treatments"].items() if name not in NOT_DRAWN}
    for model in next(iter(treatments.values())):
        values = [100 * rows[model]["mean"]["mean"] for rows in treatments.values()]
        ax.plot(
            range(len(values)),
            values,
            MARKS.get(model, ".") + "-",
            markersize=4,
            color=_colour(model),
            label=model_label(model),
        )
    names = []
    for name in treatments:
        for curve, short in CURVES.items():
            name = name.replace(f"{curve}, within", f"{short}:")
        names.append(name.replace(" ", "\n", 2))
    ax.set_xticks(range(len(names)), names, fontsize="x-small")
    ax.set(ylabel=ACCURACY, ylim=(0, 100))
    return _with_legend(ax)


def _colour(model: str) -> str:
    if model in GREYS:
        return GREYS[model]
    return loop_colour(COLOURS.get(model, 3))


def _with_legend(ax: Axes) -> Axes:
    count = len(ax.get_legend_handles_labels()[1])
    columns = count if count < 8 else (count + 1) // 2
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=columns, fontsize="small", frameon=False)
    return ax
