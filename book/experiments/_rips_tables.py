"""The figures of the benchmark of persistence as lines, as a file, and as the tables of the page *Speed*."""

import datetime as dt
import json
import os
import platform
import re
from pathlib import Path
from typing import Any

import _rips_peers

Entry = dict[str, Any]


def line(e: Entry) -> str:
    """Return an entry as a line of text."""
    return f"{e['what']:>44} {sizes(e):>26} {duration(e['ms']):>12}  {beside(e)}"


def machine() -> Entry:
    """Return the machine that the figures are from; its processor as far as the system knows it."""
    info = Path("/proc/cpuinfo")
    models = [platform.machine()]
    if info.exists():
        models = re.findall(r"model name\s*: (.*)", info.read_text()) or models
    return {
        "processor": models[0],
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "versions": _rips_peers.versions(),
    }


def known_rows(path: Path) -> Entry:
    """Return the rows of a file, unless it is from another machine or other versions."""
    if not path.exists():
        return {}
    old = json.loads(path.read_text())
    return old["rows"] if old["machine"] == machine() else {}


def store(path: Path, name: str, entries: list[Entry], command: str) -> None:
    """Put a row into the file. Rows from another machine or other versions do not stay beside it."""
    row = {"command": command, "date": dt.date.today().isoformat(), "entries": entries}
    rows = known_rows(path) | {name: row}
    text = json.dumps({"machine": machine(), "rows": rows}, indent=1)
    path.write_text(text + "\n")


def rounded(value: Any) -> Any:
    """Round to four digits, which are more than a run repeats."""
    if isinstance(value, dict):
        return {key: rounded(part) for key, part in value.items()}
    if isinstance(value, list):
        return [rounded(part) for part in value]
    return float(f"{value:.4g}") if isinstance(value, float) else value


def tables(results: Entry) -> str:
    """Return the tables of the page: single clouds against peers, those where a peer is ahead, and the other rows."""
    where = results["machine"]
    rows = results["rows"]
    versions = where["versions"]
    shown = [e for e in rows["single"]["entries"] if e["points"] <= 1000]
    named = ", ".join(f"{package} {versions[package]}" for package in versions if package not in ("numpy", "scipy"))
    others = [e for name, row in rows.items() if name not in ("single", "small") for e in row["entries"]]
    return "\n".join(
        [
            "The time for one cloud, killers included, and how many times as long its peers take, on one core",
            f"({where['processor']}, {rows['single']['date']}; `{rows['single']['command']}`, after",
            f"`pip install --group bench gudhi==3.14a2`: {named}):",
            "",
            *against_peers(shown),
            "",
            words([e for row in rows.values() for e in row["entries"]]),
            "",
            *(against_peers(rows["small"]["entries"]) if "small" in rows else []),
            "",
            "The other rows of the benchmark:",
            "",
            "| work | size | topokit | beside it |",
            "|---|---|---|---|",
            *[f"| {e['what']} | {sizes(e)} | {duration(e['ms'])} | {beside(e)} |" for e in others],
        ]
    )


def against_peers(entries: list[Entry]) -> list[str]:
    """Return a table of clouds and peers. A ratio below 1, where the peer is ahead, is bold."""
    names = [name for name in _rips_peers.NAMES if any(name in e["peers"] for e in entries)]
    text = [f"| cloud | points | topokit | {' | '.join(names)} |", "|---|---|---|" + "---|" * len(names)]
    for e in entries:
        ratios = [e["peers"].get(name, float("nan")) / e["ms"] for name in names]
        cells = [f"**{r:.3g}**" if r < 1 else f"{r:.3g}" if r == r else "" for r in ratios]
        text.append(f"| {e['what']} | {e['points']:,} | {duration(e['ms'])} | {' | '.join(cells)} |")
    return text


def words(entries: list[Entry]) -> str:
    """Return in words where a peer is ahead, in any row."""
    text = ["Where a peer is ahead its number is below 1, in bold."]
    for name in _rips_peers.NAMES:
        points: dict[str, list[str]] = {}
        for e in entries:
            if e.get("peers", {}).get(name, float("inf")) < e["ms"]:
                points.setdefault(e["what"], []).append(f"{e['points']:,}")
        if points:
            clouds = [f"{what} of {', '.join(numbers)} points" for what, numbers in points.items()]
            text.append(f"{name} is faster on {'; '.join(clouds)}.")
    return " ".join(text)


def sizes(e: Entry) -> str:
    """Return how many plans, clouds and points an entry is about."""
    return " of ".join(f"{e[key]:,} {key}" for key in ("plans", "clouds", "points") if key in e)


def beside(e: Entry) -> str:
    """Return what is measured beside the time."""
    parts = [f"{name} {ms / e['ms']:.3g} times" for name, ms in e.get("peers", {}).items()]
    parts += [
        text.format(duration(e[key]) if key.endswith("_ms") else e[key]) for key, text in BESIDE.items() if key in e
    ]
    parts += [f"{1e3 * e['clouds'] / e['ms']:,.0f} clouds a second"] if "one_by_one_ms" in e else []
    return ", ".join(parts)


def duration(ms: float) -> str:
    """Return milliseconds as words, or seconds where that is shorter."""
    return f"{ms:.3g} ms" if ms < 999.5 else f"{ms / 1e3:.3g} s"


BESIDE = {
    "power": "the time grows as the points to the power {:.2f}, from 500 on",
    "one_by_one_ms": "one by one {}",
    "cached_ms": "the next time {}",
    "compiled_ms": "with the engine compiled before {}",
    "slow_frames": "after {} frames of more than 50 ms",
    "slow_seconds": "which take {:.3g} s",
    "longest_ms": "the longest {}",
    "persistence_ms": "of which persistence {}",
    "products_ms": "of which matrix products {}",
}
