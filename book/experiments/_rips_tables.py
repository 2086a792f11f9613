"""The figures of the benchmark of persistence as lines, as a file, and as README's tables."""

from __future__ import annotations

import datetime as dt
import json
import os
import platform
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import _rips_peers

Entry = dict[str, Any]


def growth(entries: Sequence[Entry]) -> Iterator[tuple[str, str, float]]:
    """Yield shape, library and exponent: time grows as that power of the number of points."""
    for shape in dict.fromkeys(entry["what"] for entry in entries):
        mine = [entry for entry in entries if entry["what"] == shape]
        for name in ("topokit", *mine[0]["peers"]):
            times = {e["points"]: e["ms"] if name == "topokit" else e["peers"].get(name) for e in mine}
            known = {n: ms for n, ms in times.items() if ms is not None}
            if len(known) > 1:
                yield shape, name, float(np.polyfit(np.log(list(known)), np.log(list(known.values())), 1)[0])


def line(entry: Entry) -> str:
    """Return an entry as a line of the table."""
    sizes = " x ".join(f"{entry[k]:,}" for k in ("clouds", "points") if k in entry)
    told = {
        "floor_ms": "{:.2f} ms the floor",
        "fixed_ms": "{:.2f} ms fixed",
        "pairs": "{:,} pairs",
        "one_by_one_ms": "{:.1f} ms one by one",
        "plain_ms": "{:.1f} ms without",
        "cached_ms": "{:.0f} ms cached",
        "persistence_ms": "{:.2f} ms persistence",
        "all_ms": "{:.1f} ms all",
        "gb": "{:.2f} GB",
    }
    peers = [f"{name} {ms / entry['ms']:.1f}x" for name, ms in entry.get("peers", {}).items()]
    rest = [text.format(entry[key]) for key, text in told.items() if key in entry]
    return f"{entry['what']:>44} {sizes:>12} {entry['ms']:>10.2f} ms  " + ", ".join([*peers, *rest])


def processor() -> str:
    """Return the processor's name, as far as the system knows it."""
    info = Path("/proc/cpuinfo")
    models = (
        [row.split(":")[1].strip() for row in info.read_text().splitlines() if "model name" in row]
        if info.exists()
        else []
    )
    return models[0] if models else platform.processor() or platform.machine()


def machine() -> Entry:
    """Return the machine that the figures are from."""
    return {
        "processor": processor(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "versions": _rips_peers.versions(),
    }


def store(path: Path, name: str, entries: list[Entry], command: str) -> None:
    """Put a row into the file. Rows from another machine or other versions do not stay beside it."""
    old = json.loads(path.read_text()) if path.exists() else {}
    here = machine()
    rows = old["rows"] if old.get("machine") == here else {}
    row: Entry = {"command": command, "date": dt.date.today().isoformat(), "entries": entries}
    if name == "single":
        row["growth"] = [
            {"what": shape, "library": library, "exponent": round(e, 3)} for shape, library, e in growth(entries)
        ]
    rows[name] = row
    text = json.dumps({"machine": here, "rows": rows}, indent=1)
    path.write_text(text + "\n")


def rounded(value: Any) -> Any:
    """Round to four digits, which are more than a run repeats."""
    if isinstance(value, dict):
        return {key: rounded(part) for key, part in value.items()}
    return float(f"{value:.4g}") if isinstance(value, float) else value


def readme(results: Entry) -> str:
    """Return README's section about time: single clouds against peers, and a line of each other row."""
    where = results["machine"]
    rows = results["rows"]
    versions = where["versions"]
    shown = [e for e in rows["single"]["entries"] if e["points"] <= 1000]
    names = [name for name in _rips_peers.NAMES if any(name in e["peers"] for e in shown)]
    date = rows["single"]["date"]
    named = ", ".join(f"{package} {versions[package]}" for package in versions if package not in ("numpy", "scipy"))
    text = [
        "The time for one cloud, killers included, and how many times as long its peers take, on one core",
        f"({where['processor']}, {date}; `{rows['single']['command']}`, after `pip install '.[bench]'`: {named}):",
        "",
        f"| cloud | points | topokit | {' | '.join(names)} |",
        "|---|---|---|" + "---|" * len(names),
    ]
    for e in shown:
        ratios = [f"{e['peers'][name] / e['ms']:.3g}" if name in e["peers"] else "" for name in names]
        text.append(f"| {e['what']} | {e['points']:,} | {duration(e['ms'])} | {' | '.join(ratios)} |")
    text += ["", "One line of each other row of the benchmark; the rest is in `book/results/rips.json`:", ""]
    text += ["| work | topokit | beside it |", "|---|---|---|"]
    text += [other_work(row["entries"][0]) for name, row in rows.items() if name != "single"]
    return "\n".join(text)


def in_page(page: str, results: Entry) -> str:
    """Return a page with the tables between its two marks made anew."""
    before, rest = page.split(MARKS[0])
    _, after = rest.split(MARKS[1])
    return f"{before}{MARKS[0]}\n{readme(results)}\n{MARKS[1]}{after}"


def other_work(e: Entry) -> str:
    """Return a line of README's second table."""
    sizes = [f"{e[k]:,} {k}" for k in ("clouds", "points") if k in e]
    beside = [f"{name} {ratio:.3g} times" for name, ratio in ratios(e, FEW)]
    beside += [text.format(duration(e[key])) for key, text in BESIDE.items() if key in e]
    beside += [f"{e['gb']:.2f} GB"] if "gb" in e else []
    return f"| {', '.join([e['what'], *sizes])} | {duration(e['ms'])} | {', '.join(beside)} |"


def ratios(e: Entry, names: Sequence[str]) -> list[tuple[str, float]]:
    """Return how many times as long as topokit those peers took."""
    return [(name, e["peers"][name] / e["ms"]) for name in names if name in e.get("peers", {})]


def duration(ms: float) -> str:
    """Return milliseconds as words, or seconds where that is shorter."""
    return f"{ms:.3g} ms" if ms < 999.5 else f"{ms / 1e3:.3g} s"


MARKS = ("<!-- python book/experiments/rips.py --readme -->", "<!-- until here -->")
FEW = ("redzed-tda", "tda", "ripser.py")
BESIDE = {
    "one_by_one_ms": "one by one {}",
    "plain_ms": "without {}",
    "cached_ms": "the next time {}",
    "persistence_ms": "of which persistence {}",
    "all_ms": "all loops {}",
}
