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
    return f"{e['what']:>44} {sizes(e):>26} {outcome(e):>12}  {beside(e)}"


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


def store(path: Path, name: str, entries: list[Entry], command: str) -> None:
    """Put a row into the file. Rows from another machine or other versions do not stay beside it."""
    here = machine()
    rows = {}
    if path.exists():
        old = json.loads(path.read_text())
        if old["machine"] == here:
            rows = old["rows"]
    rows[name] = {"command": command, "date": dt.date.today().isoformat(), "entries": entries}
    text = json.dumps({"machine": here, "rows": rows}, indent=1)
    path.write_text(text + "\n")


def rounded(value: Any) -> Any:
    """Round to four digits, which are more than a run repeats."""
    if isinstance(value, dict):
        return {key: rounded(part) for key, part in value.items()}
    return float(f"{value:.4g}") if isinstance(value, float) else value


def tables(results: Entry) -> str:
    """Return the tables of the page: single clouds against peers, and every entry of the other rows."""
    where = results["machine"]
    rows = results["rows"]
    versions = where["versions"]
    shown = [e for e in rows["single"]["entries"] if e["points"] <= 1000]
    names = [name for name in _rips_peers.NAMES if any(name in e["peers"] for e in shown)]
    date = rows["single"]["date"]
    named = ", ".join(f"{package} {versions[package]}" for package in versions if package not in ("numpy", "scipy"))
    text = [
        "The time for one cloud, killers included, and how many times as long its peers take, on one core",
        f"({where['processor']}, {date}; `{rows['single']['command']}`, after `pip install --group bench`: {named}):",
        "",
        f"| cloud | points | topokit | {' | '.join(names)} |",
        "|---|---|---|" + "---|" * len(names),
    ]
    for e in shown:
        ratios = [f"{e['peers'][name] / e['ms']:.3g}" if name in e["peers"] else "" for name in names]
        text.append(f"| {e['what']} | {e['points']:,} | {outcome(e)} | {' | '.join(ratios)} |")
    text += ["", "The other rows of the benchmark:", "", "| work | size | topokit | beside it |", "|---|---|---|---|"]
    others = [e for name, row in rows.items() if name != "single" for e in row["entries"]]
    text += [f"| {e['what']} | {sizes(e)} | {outcome(e)} | {beside(e)} |" for e in others]
    return "\n".join(text)


def sizes(e: Entry) -> str:
    """Return how many clouds and points an entry is about."""
    return " of ".join(f"{e[key]:,} {key}" for key in ("clouds", "points") if key in e)


def outcome(e: Entry) -> str:
    """Return the time that topokit took."""
    return duration(e["ms"])


def beside(e: Entry) -> str:
    """Return what is measured beside the time."""
    parts = [f"{name} {ms / e['ms']:.3g} times" for name, ms in e.get("peers", {}).items()]
    parts += [text.format(duration(e[key])) for key, text in BESIDE.items() if e.get(key)]
    parts += [f"{1e3 * e['clouds'] / e['ms']:,.0f} clouds a second"] if "clouds" in e else []
    return ", ".join(parts)


def duration(ms: float) -> str:
    """Return milliseconds as words, or seconds where that is shorter."""
    return f"{ms:.3g} ms" if ms < 999.5 else f"{ms / 1e3:.3g} s"


BESIDE = {
    "one_by_one_ms": "one by one {}",
    "processor_ms": "of which processor {}",
    "cached_ms": "the next time {}",
    "persistence_ms": "of which persistence {}",
}
