"""What README shows is what was measured: its tables and sentences against book/results."""

from __future__ import annotations

import json
from pathlib import Path

import _rips_tables

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()


def record(name: str) -> dict:
    return json.loads((ROOT / "book" / "results" / f"{name}.json").read_text())


def test_shares_in_the_hull():
    """The table's lines are conditions, its columns models: means over the horizons, in per cent."""
    conditions = record("motion")["conditions"]
    rows = {name: condition["hull_accuracy"] for name, condition in conditions.items()}
    treatments = conditions["all garments"]["hull_treatments"]
    rows["all garments, strict"] = treatments["marked curve alone, within 0 cm"]
    rows["all garments, any curve of the class"] = treatments["any curve of the class, within 1 cm"]
    head, _, *lines = README.split("<!-- book/results/motion.json -->")[1].strip().splitlines()
    models = ["ours" if name.strip() == "Motion" else name.strip().lower() for name in head.strip("|").split("|")[1:]]
    assert lines
    for line in lines:
        name, *shown = (cell.strip() for cell in line.strip("|").split("|"))
        assert [int(cell) for cell in shown] == [round(100 * rows[name][model]["mean"]["mean"]) for model in models]


def test_times_of_persistence():
    assert _rips_tables.in_page(README, record("rips")) == README, "run python book/experiments/rips.py --readme"


def test_meshes_of_strangers():
    results = record("garments")
    garments = [row for row in results["meshes"] if row["expected"] == "hangs"]
    text = " ".join(README.split())
    assert f"Of {len(results['meshes'])} files, {len(garments)} garments as other tools write them" in text
    assert f"{results['hangs']} hang at the end of the film, and {results['refused']} are refused" in text
