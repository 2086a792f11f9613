"""What README says of time is what was measured: book/results/rips.json, made by book/experiments/rips.py."""

from __future__ import annotations

import copy
import importlib
import json
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()


@pytest.fixture
def load(monkeypatch):
    """Import a file of book/experiments."""
    monkeypatch.syspath_prepend(ROOT / "book" / "experiments")
    return importlib.import_module


@pytest.fixture
def tables(load):
    return load("_rips_tables")


@pytest.fixture
def results():
    return json.loads((ROOT / "book" / "results" / "rips.json").read_text())


def test_readme_shows_the_recorded_run(results, tables):
    assert tables.in_page(README, results) == README, "run python book/experiments/rips.py --readme"


def test_readme_would_change_with_any_row(results, tables):
    for name in results["rows"]:
        other = copy.deepcopy(results)
        other["rows"][name]["entries"][0]["ms"] *= 2
        assert tables.in_page(README, other) != README, f"README shows nothing of {name}"


def test_every_row_of_the_benchmark_is_recorded(results, load):
    assert set(results["rows"]) == set(load("rips").ROWS)
    assert all(row["entries"] for row in results["rows"].values())


def test_peers_ran_beside_single_clouds(results, load):
    ran = {name for entry in results["rows"]["single"]["entries"] for name in entry["peers"]}
    assert ran == set(load("_rips_peers").NAMES)


def test_growth_is_the_slope_of_the_recorded_times(tables):
    entries = [{"what": "ring", "points": n, "ms": n**1.5, "peers": {"other": 3.0 * n**2}} for n in (10, 100, 1000)]
    found = {library: power for _, library, power in tables.growth(entries)}
    assert found == pytest.approx({"topokit": 1.5, "other": 2.0})
