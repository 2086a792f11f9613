"""Make tables (.md) and figures (.svg) of a record of forecasts, without measuring anything.

    python book/experiments/report.py book/results/motion.json --out book/report

Takes seconds on any machine; `make book` runs it.
"""

import argparse
import html
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "notebooks"))
from chapter_tools.records import model_label, plot_accuracy, plot_by_horizon, plot_conditions, plot_treatments

MEASURES = {
    "hull_accuracy": "share of windows in which the mean of the mixture is in the hull",
    "in_plane": "share of windows in which it is in the outline of the true loop, and near its plane",
    "in_opening": "share of windows in which it is nearer to the centre of the true loop than that loop's farthest vertex",
    "distance_cm": "mean distance from the centre of the true loop, cm",
    "nll": "mean negative log-likelihood of points of the true opening, nats",
    "nll_median": "median of that over the windows",
    "cover50": "share of points of the opening in the region of 50 %",
    "cover90": "share of points of the opening in the region of 90 %",
    "lost": "chance that of two forecasts the one that is 5 cm outside the hull expects more error (AUROC; half: a guess)",
    "identity": "true loops found at t+1 that are found by the same slot",
    "presence": "balanced accuracy: is the slot's loop there for the tracker?",
    "brier": "mean square of what is said of presence less what is true: a coin has 0.25",
    "opens_recall": "loops more than at t: how many of these are forecast",
    "opens_precision": "how many of those that are forecast come true",
    "closes_recall": "loops fewer than at t: how many of these are forecast",
    "closes_precision": "how many of those that are forecast come true",
}
NO_SHARES = ("distance_cm", "nll", "nll_median", "brier")


def write_report(results: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write `tables.md` and four figures into a folder; return their paths."""
    where, first = next(iter(results["conditions"].items()))
    figures = {
        "hull_accuracy": ("Share of windows in the hull, by horizon", plot_accuracy, (first, results["horizons"])),
        "distance": ("Distance from the centre of the true loop, by horizon", plot_by_horizon, (first, "distance_cm")),
        "conditions": ("Share of windows in the hull, by condition", plot_conditions, (results,)),
        "treatments": ("Share of windows in the hull, by treatment of the hull", plot_treatments, (first,)),
    }
    folder.mkdir(parents=True, exist_ok=True)
    parts = [tables_of(results).rstrip(), f"## Figures ({where}, where they do not name others)"]
    paths = [folder / "tables.md"]
    for name, (caption, draw, given) in figures.items():
        figure = Figure(figsize=(8, 3.6), layout="constrained")
        draw(*given, figure.add_subplot())
        paths.append(folder / f"{name}.svg")
        with mpl.rc_context({"svg.hashsalt": "topokit"}):  # the same numbers make the same file
            figure.savefig(paths[-1], format="svg", metadata={"Date": None})
        parts.append(f"![{caption}]({name}.svg)")
    paths[0].write_text("\n\n".join(parts) + "\n", encoding="utf-8")
    return paths


def tables_of(results: Mapping[str, Any]) -> str:
    """Return all tables as one Markdown document."""
    horizons = results["horizons"]
    lines = ["# Results", "", f"Ours is `{results['ours']}`. {results['measure']}.", ""]
    lines += ["Made by", "", "```", *results["commands"], "```", ""]
    for name, condition in results["conditions"].items():
        lines += [
            f"## {name.capitalize()}",
            "",
            f"{condition['windows']} windows of {condition['episodes']} episodes.",
            "",
        ]
        for measure, meaning in MEASURES.items():
            share = measure not in NO_SHARES
            unit = " (%)" if share else ""
            lines += [f"### {meaning[0].upper()}{meaning[1:]}{unit}", ""]
            lines += [table_of(condition[measure], horizons, share), ""]
        if condition["gain_of_ours"]:
            lines += ["### What ours gains over the others in the hull measure (points)", ""]
            lines += [table_of(condition["gain_of_ours"], horizons, share=True), ""]
    return "\n".join(lines)


def table_of(rows: Mapping[str, Mapping[str, Any]], horizons: Sequence[str], share: bool) -> str:
    """Return a measure as a table in Markdown, shares in per cent."""
    head = ["", *("mean" if key == "mean" else f"t+{key}" for key in horizons)]
    rule = ["---", *["---:"] * len(horizons)]
    body = [
        [model_label(model), *(cell_of(cells.get(key), share) for key in horizons)] for model, cells in rows.items()
    ]
    lines = [[html.escape(cell).replace("|", "&#124;") for cell in line] for line in [head, rule, *body]]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def cell_of(entry: Mapping[str, Any] | None, share: bool) -> str:
    """Return a mean and its interval as words."""
    if not entry or entry["mean"] is None:
        return "-"
    scale, form = (100, "{:.1f}") if share else (1, "{:.2f}")
    numbers = [entry.get(side) for side in ("mean", "low", "high")]
    return "{} [{}, {}]".format(*("-" if number is None else form.format(scale * number) for number in numbers))


def main() -> None:
    """Read a record and write its tables and figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path, help="a record of forecasts (.json)")
    parser.add_argument("--out", type=Path, required=True, help="folder for tables and figures")
    options = parser.parse_args()
    for path in write_report(json.loads(options.results.read_text(encoding="utf-8")), options.out):
        print(path)


if __name__ == "__main__":
    main()
