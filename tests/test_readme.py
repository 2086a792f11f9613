"""The numbers of README and of the pages are those of book/results, and README's first lines print what they say."""

from __future__ import annotations

import json
import re
from pathlib import Path

import forecast_benchmark
import linkers
import pandas as pd
from tables import in_page

import _rips_tables

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
USAGE = (ROOT / "book" / "usage.md").read_text()
FORECASTERS = {
    "Motion": "ours",
    "seqPH, sees the frame": "seqph",
    "seqPH, sees 128 points of it": "seqph_128_points",
    "seqPH, sees 32 points of it": "seqph_32_points",
    "MLP with skip": "mlp_skip",
}


def record(name: str) -> dict:
    return json.loads((ROOT / "book" / "results" / f"{name}.json").read_text())


def per_cent(row: str, model: str) -> int:
    """Return a model's share in a condition of the record of motion, or of all garments by another measure."""
    conditions = record("motion")["conditions"]
    treatments = conditions["all garments"]["hull_treatments"]
    rows = {name: condition["hull_accuracy"] for name, condition in conditions.items()}
    rows["all garments, the paper's measure"] = treatments["marked curve alone, within 0 cm"]
    rows["all garments, any curve of the class"] = treatments["any curve of the class, within 1 cm"]
    return round(100 * rows[row][model]["mean"]["mean"])


def table_after(mark: str) -> list[list[str]]:
    """Return the cells of a table of the page of usage, without the rule below its head."""
    head, _, *lines = USAGE.split(f"<!-- book/results/{mark} -->")[1].strip().splitlines()
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in (head, *lines)]


def test_shares_in_the_hull():
    (_, *models), *lines = table_after("motion.json")
    assert lines
    for name, *shown in lines:
        assert [int(cell) for cell in shown] == [per_cent(name, FORECASTERS.get(m, m.lower())) for m in models]


def test_shares_in_the_setting_of_the_paper():
    table = pd.read_csv(ROOT / "book" / "results" / "paper.csv", dtype={"seed": str})
    of_all = (table["seed"] == "all") & table["training_films"].isin([0, 1000])
    table = table[of_all & (table["setting"] == "paper") & (table["mesh"] == "coarse")]
    share = table.set_index(["garments", "measure", "horizon", "forecaster"])["share"]
    measures = (("apron", "marked"), ("apron2", "any"))
    columns = [(*measure, step) for measure in measures for step in ("1", "15", "30", "60")]
    _, *lines = table_after("paper.csv")
    assert lines
    for name, *shown in lines:
        forecaster = name.lower() if name == "Motion" else FORECASTERS.get(name, name.lower())
        assert [int(cell) for cell in shown] == [round(100 * share[(*column, forecaster)]) for column in columns]


def test_tables_of_the_benchmarks():
    pages = (("rips", "speed", _rips_tables), ("linkers", "benchmark", linkers))
    for script, page, found in (*pages, ("forecast_benchmark", "forecast_benchmark", forecast_benchmark)):
        text = (ROOT / "book" / f"{page}.md").read_text()
        assert in_page(text, f"{script}.py", found.tables(record(script))) == text, f"run {script}.py --page"


def test_numbers_of_readme():
    rows = dict(re.findall(r"^\| ([^|]+?) \| (.*) \|$", README, re.MULTILINE))
    entries = record("rips")["rows"]["single"]["entries"]
    apron = next(entry for entry in entries if (entry["what"], entry["points"]) == ("apron", 1000))
    name, ms = min(apron["peers"].items(), key=lambda peer: peer[1])
    shown = rows["one cloud of an apron, 1,000 points"]
    assert shown.startswith(f"{_rips_tables.duration(apron['ms'])} | {ms / apron['ms']:.3g} times")
    assert shown.endswith(name)

    # Loops that are tracked and forecast, by two measures, and garments that hang.
    measures = ("all garments", "all garments, the paper's measure")
    by = {model: [per_cent(row, model) for row in measures] for model in ("seqph", "ours", "carry")}
    tracked = re.findall(r"(\d+) %", rows["the tracked loop lies in the true one"])
    forecast = re.findall(r"(\d+) %", rows["the forecast loop lies in the true one, 1 to 60 frames ahead"])
    assert [int(number) for number in tracked[:2] + forecast] == by["seqph"] + by["ours"] + by["carry"]
    servo = [e for e in record("hanging")["episodes"] if (e["who"], e["scene"]) == ("servo", "still")]
    found = [e["success"] for e in servo if not e["task"].endswith("mannequin")]
    hung = rows["garments hung on hooks and hangers, simulated"].split(" |")[0]
    assert hung == f"{sum(found)} of {len(found)}"
    assert hung in USAGE


def test_the_first_lines_print_what_they_say():
    code = re.search(r"```python\n(import numpy.*?)```", README, re.DOTALL)[1]
    printed: list[str] = []
    exec(code, {"print": lambda *values: printed.append(" ".join(str(value) for value in values))})
    said = [line.split("  # ")[1] for line in code.splitlines() if line.startswith("print(")]
    assert len(said) == len(printed)
    for words, values in zip(said, printed, strict=True):
        assert " ".join(words.split()).startswith(" ".join(values.split()))
