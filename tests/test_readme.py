"""What README and the pages show is what was measured: their tables and sentences against book/results."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pandas as pd

import _rips_tables

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
USAGE = (ROOT / "book" / "usage.md").read_text()
SPEED = (ROOT / "book" / "speed.md").read_text()


def record(name: str) -> dict:
    return json.loads((ROOT / "book" / "results" / f"{name}.json").read_text())


def shares() -> dict[str, dict]:
    """The shares of the record of motion by row of the table; "all garments" also by other measures."""
    conditions = record("motion")["conditions"]
    rows = {name: condition["hull_accuracy"] for name, condition in conditions.items()}
    treatments = conditions["all garments"]["hull_treatments"]
    rows["all garments, the paper's measure"] = treatments["marked curve alone, within 0 cm"]
    rows["all garments, any curve of the class"] = treatments["any curve of the class, within 1 cm"]
    return rows


def per_cent(row: str, model: str) -> int:
    return round(100 * shares()[row][model]["mean"]["mean"])


def test_shares_in_the_hull():
    """The table's lines are conditions, its columns models: means over the horizons, in per cent."""
    head, _, *lines = USAGE.split("<!-- book/results/motion.json -->")[1].strip().splitlines()
    models = ["ours" if name.strip() == "Motion" else name.strip().lower() for name in head.strip("|").split("|")[1:]]
    assert lines
    for line in lines:
        name, *shown = (cell.strip() for cell in line.strip("|").split("|"))
        assert [int(cell) for cell in shown] == [per_cent(name, model) for model in models]


FORECASTERS = {
    "seqPH, sees the frame": "seqph",
    "seqPH, sees 128 points of it": "seqph_128_points",
    "MLP with skip": "mlp_skip",
}
COLUMNS = (("apron", "marked"), ("apron", "marked1"), ("apron2", "wide"))


def test_shares_in_the_setting_of_the_paper():
    table = pd.read_csv(ROOT / "book" / "results" / "paper.csv", dtype={"seed": str})
    of_all = (table["seed"] == "all") & (table["horizon"] == "mean") & table["training_films"].isin([0, 1000])
    table = table[of_all & (table["setting"] == "paper") & (table["mesh"] == "coarse")]
    share = table.set_index(["garments", "measure", "forecaster"])["share"]
    _, _, *lines = USAGE.split("<!-- book/results/paper.csv -->")[1].strip().splitlines()
    assert lines
    for line in lines:
        name, *shown = (cell.strip() for cell in line.strip("|").split("|"))
        forecaster = FORECASTERS.get(name, name.lower())
        assert [int(cell) for cell in shown] == [round(100 * share[(*column, forecaster)]) for column in COLUMNS]


def test_times_of_persistence():
    assert _rips_tables.in_page(SPEED, record("rips")) == SPEED, "run python book/experiments/rips.py --page"


def test_numbers_of_readme():
    rows = dict(re.findall(r"^\| ([^|]+?) \| (.*) \|$", README, re.MULTILINE))
    rips = {name: row["entries"] for name, row in record("rips")["rows"].items()}

    apron = next(e for e in rips["single"] if (e["what"], e["points"]) == ("apron", 1000))
    name, ms = min(apron["peers"].items(), key=lambda peer: peer[1])
    assert rows["one cloud of an apron, 1,000 points"] == (
        f"{_rips_tables.outcome(apron)} | {ms / apron['ms']:.3g} times as long for the next program, {name}"
    )

    # Loops that are tracked and forecast, by two measures, and garments that hang.
    wide, paper = "all garments", "all garments, the paper's measure"
    by = {model: [per_cent(row, model) for row in (wide, paper)] for model in ("seqph", "ours", "carry")}
    said = "{} % by the wide measure, {} % by the paper's"
    assert rows["the tracked loop lies in the true one"].startswith(said.format(*by["seqph"]))
    forecast = rows["the forecast loop lies in the true one, 1 to 60 frames ahead"]
    by_hands = "moving the loop with the hands, without a forecast"
    assert forecast == f"{said.format(*by['ours'])} | {by_hands}: {by['carry'][0]} %, {by['carry'][1]} %"
    hung = rows["garments hung on hooks and hangers, simulated"].split(" |")[0]
    found = [e["success"] for e in record("hanging")["episodes"] if is_servo(e)]
    assert hung == f"{sum(found)} of {len(found)}"
    assert f"the servo hung {hung} garments on hooks and hangers" in " ".join(USAGE.split())


def is_servo(episode: dict) -> bool:
    still = episode["who"] == "servo" and episode["scene"] == "still"
    return still and not episode["task"].endswith("mannequin")


def test_the_first_lines_print_what_they_say():
    code = re.search(r"```python\n(import numpy.*?)```", README, re.DOTALL)[1]
    printed: list[str] = []
    exec(code, {"print": lambda *values: printed.append(" ".join(str(value) for value in values))})
    said = [line.split("  # ")[1] for line in code.splitlines() if line.startswith("print(")]
    assert len(said) == len(printed)
    for words, values in zip(said, printed, strict=True):
        assert " ".join(words.split()).startswith(" ".join(values.split()))
