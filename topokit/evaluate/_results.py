"""The file of results: written, read, and shown; and the code that it is made by. Taught in chapter 13."""

from __future__ import annotations

import ast
import hashlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import topokit
from topokit._archive import FormatError, atomic_file

KIND = "topokit-evaluation"
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
}  # of a condition, and what they mean
_NO_SHARES = ("distance_cm", "nll", "nll_median", "brier")


def read_results(path: str | Path) -> dict[str, Any]:
    """Read a file that `evaluate_forecasts` wrote.

    Raises
    ------
    FileNotFoundError, FormatError
        When there is none, or it is something else.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: there is no such file; topokit evaluate makes it")
    try:
        results: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if results["kind"] != KIND:
            raise KeyError("kind")
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise FormatError(f"{path}: holds no results of topokit evaluate; take another name for --out") from error
    return results


def write_results(path: str | Path, results: Mapping[str, Any]) -> None:
    """Write results as JSON with a line for every innermost object or list; the file is replaced in one piece."""
    text = json.dumps(results, indent=1, allow_nan=False)
    for innermost in (r"\{[^][{}]*\}", r"\[[^][{}]*\]"):
        text = re.sub(innermost, lambda match: re.sub(r"\s+", " ", match[0]), text)
    with atomic_file(path) as handle:
        handle.write(f"{text}\n".encode())


def write_report(results: str | Path, out: str | Path) -> list[Path]:
    """Write `tables.md` and figures into a folder, from a file of results and from nothing else.

    Parameters
    ----------
    results : path
        What `evaluate_forecasts` wrote.
    out : path
        A folder; it is made when it is not there.

    Raises
    ------
    FileNotFoundError, FormatError
        As `read_results`, and when a part of the results is missing or is not what it should be.
    """
    content = read_results(results)
    try:
        return _write_report(content, Path(out))
    except (LookupError, TypeError, AttributeError, ValueError, ArithmeticError, StopIteration) as error:
        what = f"{type(error).__name__}: {error}"
        raise FormatError(f"{results}: a part is missing or of another kind ({what}); evaluate again") from error


def _write_report(content: Mapping[str, Any], folder: Path) -> list[Path]:
    from topokit import view

    where, first = next(iter(content["conditions"].items()))
    hull, distance = "Share of windows in the hull", "Distance from the centre of the true loop"
    figures: dict[str, tuple[str, Callable[..., Any], tuple[Any, ...]]] = {
        "hull_accuracy": (f"{hull}, by horizon", view.plot_accuracy, (first, content["horizons"])),
        "distance": (f"{distance}, by horizon", view.plot_by_horizon, (first, "distance_cm")),
        "conditions": (f"{hull}, by condition", view.plot_conditions, (content,)),
        "treatments": (f"{hull}, by treatment of the hull", view.plot_treatments, (first,)),
    }
    text = [_tables(content, view.model_label).rstrip(), f"## Figures ({where}, where they do not name others)"]
    text += [f"![{caption}]({name}.svg)" for name, (caption, _, _) in figures.items()]
    tables = folder / "tables.md"
    with atomic_file(tables) as handle:
        handle.write(("\n\n".join(text) + "\n").encode())
    return [tables, *(_draw(folder / f"{name}.svg", draw, given) for name, (_, draw, given) in figures.items())]


def _draw(path: Path, draw: Callable[..., Any], given: Sequence[Any]) -> Path:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 3.6), layout="constrained")
    draw(*given, figure.add_subplot())
    with atomic_file(path) as handle, mpl.rc_context({"svg.hashsalt": "topokit"}):  # same numbers, same file
        figure.savefig(handle, format="svg", metadata={"Date": None})
    return path


def _tables(results: Mapping[str, Any], label: Callable[[str], str]) -> str:
    """All tables as one Markdown document; `label` says what a model is called."""
    horizons = results["horizons"]
    lines = ["# Results", "", f"Ours is `{results['ours']}`. {results['measure']}.", ""]
    lines += ["Made by", "", "```", *results["commands"], "```", ""]
    for name, condition in results["conditions"].items():
        episodes, windows = condition["episodes"], condition["windows"]
        lines += [f"## {name.capitalize()}", "", f"{windows} windows of {episodes} episodes.", ""]
        for measure in [measure for measure in MEASURES if measure in condition]:  # an older file lacks some
            share, meaning = measure not in _NO_SHARES, MEASURES[measure]
            lines += [f"### {meaning[0].upper()}{meaning[1:]}{' (%)' if share else ''}", ""]
            lines += [table_of(condition[measure], horizons, share, label), ""]
        if condition["gain_of_ours"]:
            lines += ["### What ours gains over the others in the hull measure (points)", ""]
            lines += [table_of(condition["gain_of_ours"], horizons, label=label), ""]
    return "\n".join(lines)


def table_of(
    rows: Mapping[str, Mapping[str, Any]],
    horizons: Sequence[str],
    share: bool = True,
    label: Callable[[str], str] = str,
) -> str:
    """A measure as a table in Markdown, shares in per cent."""
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


@cache
def library_digest(package: Path = Path(topokit.__file__).parent) -> str:
    """Return a name for the code that numbers are made by: all modules of a package but those that draw.

    Words about the code, comments and docstrings, do not count.
    """
    paths = sorted(path for path in package.rglob("*.py") if "view" not in path.relative_to(package).parts)
    trees = [_WithoutWords().visit(ast.parse(path.read_bytes())) for path in paths]
    names = [path.relative_to(package).as_posix() for path in paths]
    return digest([names, *map(ast.dump, trees)])


class _WithoutWords(ast.NodeTransformer):
    def visit_Expr(self, node: ast.Expr) -> ast.Expr | None:
        words = isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        return None if words else node


def digest(parts: Sequence[Any]) -> str:
    """A name for anything that JSON can hold."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:16]
