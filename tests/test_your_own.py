"""The page *Your garment, your camera, your robot*: its code runs, its files are read, its figures are those of the records."""

from __future__ import annotations

import json
import re
import statistics
from pathlib import Path

import numpy as np
import pytest
from forecasts import load_evaluation

pytest.importorskip("pybullet")
pytest.importorskip("torch")

from topokit._config import from_mapping
from topokit.control import Servo
from topokit.data import DatasetConfig
from topokit.models import TrainConfig
from topokit.sim import WARDROBE

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "book" / "your_own.md").read_text()
CODE = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
FILES = [json.loads(block) for block in re.findall(r"```json\n(.*?)```", PAGE, re.DOTALL)]


def piece(word: str) -> str:
    """Return the piece of Python on the page that has a word."""
    return next(block for block in CODE if word in block)


def test_the_bib_is_read_in_the_size_that_the_films_have(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(piece("lines.append"), {})
    exec(piece("from_mesh"), {})
    films = from_mapping(DatasetConfig, FILES[0], "bib.json")
    garment = films.task("bib-hook").garment()
    assert garment.loop_names == ("neck",)
    assert np.ptp(garment.vertices, axis=0).max() == pytest.approx(16 * 0.0254)
    neck = garment.vertices[garment.loops[0]]
    np.testing.assert_allclose(np.linalg.norm(neck - neck.mean(axis=0), axis=1), 3 * 0.0254, atol=1e-5)  # 3 inches
    assert (garment.vertices[garment.grips, 2] > neck[:, 2].mean()).all()


def test_the_files_of_the_page_are_valid_and_fit_together(tmp_path):
    _, evaluation, training = FILES
    (tmp_path / "eval.json").write_text(json.dumps(evaluation))
    assert load_evaluation(tmp_path / "eval.json").shape == from_mapping(TrainConfig, training, "training").shape
    for path in (training["start"], *evaluation["models"]["shipped"]):
        assert (ROOT / path).is_file()


def test_the_loop_hangs_a_garment_and_stops_when_the_robot_does():
    names: dict = {}
    exec(piece("def hang"), names)
    exec(piece("class SimulatedRobot"), names)
    coarse = WARDROBE["apron"](spacing=0.05, strap_width=0.05)
    robot = names["SimulatedRobot"]("apron-hook", garment=coarse)
    controller = names["planner"](robot, speed=1.2)
    assert names["hang"](robot, controller) == "let go"
    assert robot.info["success"]
    np.testing.assert_allclose(
        robot._env.goal, controller.goals, atol=1e-3
    )  # the robot was sent where the controller meant

    class Caught(names["SimulatedRobot"]):
        def move(self, goals, release=0.0):
            return super().move(goals, release) and False

    caught = Caught("apron-hook", garment=coarse)
    before = caught.observe()["grippers"]
    assert names["hang"](caught, Servo()) == "stopped by the robot"
    np.testing.assert_allclose(caught.observe()["grippers"], before, atol=0.02)


def test_figures_of_the_loop_are_those_of_the_record():
    episodes = json.loads((ROOT / "book" / "results" / "hanging.json").read_text())["episodes"]
    shown = {"clouds late by 200 ms": "late by 200 ms", "a push at the cloth": "shove"}
    rows = re.findall(r"^\| ([^|]+) \| (\d+) hang, (\d+) frames \| (\d+) hang, (\d+) frames \|$", PAGE, re.MULTILINE)
    assert len(rows) == 5
    for name, *numbers in rows:
        for who, hung, frames in (("servo", *numbers[:2]), ("carry", *numbers[2:])):
            found = [e for e in episodes if e["who"] == who and e["scene"] == shown.get(name, name)]
            assert len(found) == 56
            assert [int(hung), int(frames)] == [
                sum(e["success"] for e in found),
                round(sum(e["frames"] for e in found) / 56),
            ]
    times = [statistics.median(e["decision_ms"] for e in episodes if e["who"] == who) for who in ("servo", "carry")]
    assert re.findall(r"(\d+) ms for an action.*?(\d+) ms", PAGE) == [tuple(f"{ms:.0f}" for ms in times)]
