"""The page *Coming from ...*: every piece of code runs where its packages are installed, and the table is that of the results."""

from __future__ import annotations

import importlib.util
import json
import re
from pathlib import Path

import numpy as np
import pytest
from sensor_files import cloud_message, ring, save_bag

from topokit import rips_persistence
from topokit.io import load_episode

from conftest import DATA, polygon

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "book" / "coming_from.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


def imported(block: str) -> set[str]:
    """Return the packages that a piece of code imports."""
    lines = re.findall(r"^(?:from|import) (.+?)(?: import .*| as .*)?$", block, re.MULTILINE)
    return {name.strip().split(".")[0] for line in lines for name in line.split(",")}


def is_installed(name: str) -> bool:
    return importlib.util.find_spec(name) is not None


def write_lerobot(folder: Path, clouds: list[np.ndarray]) -> None:
    """Write the frames of an episode as LeRobot's datasets hold them, in another order, and one of another episode."""
    import pyarrow as pa
    from pyarrow import parquet

    (folder / "data/chunk-000").mkdir(parents=True)
    rows = {
        "observation.pointcloud": [cloud.tolist() for cloud in (clouds[1], clouds[0], clouds[0])],
        "timestamp": [0.1, 0.0, 0.0],
        "frame_index": [1, 0, 0],
        "episode_index": [0, 0, 1],
    }
    parquet.write_table(pa.table(rows), folder / "data/chunk-000/file-000.parquet")


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_a_piece_runs(number, tmp_path, monkeypatch):
    block = BLOCKS[number]
    needed = imported(block) | ({"rosbags"} if "read_clouds" in block else set())
    missing = sorted(name for name in needed if not is_installed(name))
    if missing:
        pytest.skip(f"{missing[0]} is not installed")
    (tmp_path / "data_small").symlink_to(DATA, target_is_directory=True)
    monkeypatch.chdir(tmp_path)
    points = np.column_stack([polygon(20), 0.1 * np.cos(2 * np.arange(20))])
    names = {"points": points, "clouds": [points, points[:15]]}
    if "folding" in block:
        write_lerobot(tmp_path / "folding", [points, 1.1 * points])
    if "recording" in block:
        messages = [cloud_message(ring(t).reshape(6, 10, 3), 1 + t) for t in range(2)]
        save_bag(tmp_path / "recording", {"/camera/points": messages, "/other/points": messages})
    exec(compile(block, "coming_from.md", "exec"), names)

    # Every cloud here has one loop, unless the piece has opened it.
    for name in ("diagram", "bars"):
        if name in names and "worst" not in names:
            assert len(names[name]) == (0 if "descent" in names else 1)
    if "graph" in names:
        known = rips_persistence(points)
        np.testing.assert_allclose(names["found"]["dgms"][1][:, 0], 2 * known.birth)
        assert names["found"]["killer_edge"].tolist() == [[-1, -1]]  # the tree ends before it dies
    if "worst" in names:
        lost = rips_persistence(points).lifetime[0] - float(names["bars"].detach().diff()[0])
        assert 0.005 < lost <= 0.02 + 1e-9
    if "states" in names:
        assert [[loop.id for loop in state.loops] for state in names["states"]] == [[0], [0]]
        assert names["states"][0].time < names["states"][1].time
    if "rr" in names:
        assert (tmp_path / "apron.rrd").stat().st_size > 10_000
    if "garments" in names and "LeRobotDataset" in names:
        film = load_episode(DATA / "apron_hook_0.npz")
        assert (names["garments"].num_episodes, names["garments"].num_frames) == (2, 2 * (len(film) - 1))
    if "env" in names:
        names["env"].close()


def test_pieces_that_no_environment_runs_are_marked():
    for section in PAGE.split("\n## "):
        packages = set().union(*map(imported, re.findall(r"```python\n(.*?)```", section, re.DOTALL)))
        if packages & {"rclpy", "lerobot"}:
            assert re.search(r"\*(This node was not run|No test runs this piece)", section)


def test_the_table_is_that_of_the_results():
    doors = pytest.importorskip("doors")  # of book/experiments
    found = json.loads((ROOT / "book" / "results" / "doors.json").read_text())
    assert doors.paged(PAGE, found) == PAGE
