"""The page *Coming from ...*: every piece of code runs, and the table is that of the results."""

from __future__ import annotations

import importlib.util
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from topokit import rips_persistence

from conftest import DATA, polygon

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "book" / "coming_from.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


def imported(block: str) -> set[str]:
    """The packages that a piece of code imports."""
    lines = re.findall(r"^(?:from|import) (.+?)(?: import .*| as .*)?$", block, re.MULTILINE)
    return {name.strip().split(".")[0] for line in lines for name in line.split(",")}


def test_there_are_pieces_of_all_neighbours():
    names = {
        "lerobot",
        "gudhi",
        "gymnasium",
        "networkx",
        "rerun",
        "ripser",
        "sklearn",
        "stable_baselines3",
        "torch",
        "topokit",
    }
    assert names <= set().union(*map(imported, BLOCKS))


def write_dataset(folder: Path, clouds: list[np.ndarray]) -> None:
    """Frames of an episode as LeRobot's datasets hold them, and one of another episode."""
    import pyarrow as pa
    from pyarrow import parquet

    for part in ("meta", "data/chunk-000"):
        (folder / part).mkdir(parents=True)
    (folder / "meta/info.json").write_text("{}")
    rows = {"observation.pointcloud": [cloud.tolist() for cloud in [*clouds, clouds[0]]]}
    rows |= {"timestamp": [0.0, 0.1, 0.0], "frame_index": [0, 1, 0], "episode_index": [0, 0, 1]}
    parquet.write_table(pa.table(rows), folder / "data/chunk-000/file-000.parquet")


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_a_piece_runs(number, tmp_path, monkeypatch):
    needed = imported(BLOCKS[number]) | ({"rerun"} if "view import rerun" in BLOCKS[number] else set())
    needed |= {"pyarrow"} if "lerobot" in BLOCKS[number] else {"rosbags"} if "LoopMessages" in BLOCKS[number] else set()
    if missing := [name for name in needed if importlib.util.find_spec(name) is None]:
        pytest.skip(f"{missing[0]} is not installed")
    (tmp_path / "data_small").symlink_to(DATA, target_is_directory=True)
    monkeypatch.chdir(tmp_path)
    points = np.column_stack([polygon(20), 0.1 * np.cos(2 * np.arange(20))])
    whole = "rerun(film, track(film.points, times=film.times)"
    code = BLOCKS[number].replace(whole, "rerun(film.points[:2], track(film.points[:2])")  # two frames are quick
    names = {"points": points, "clouds": [points, points[:15]]}
    if "from_lerobot" in BLOCKS[number]:
        write_dataset(tmp_path / "folding", [points, 1.1 * points])
    if "LoopMessages" in BLOCKS[number]:
        from ros import Rclpy, as_ros
        from test_sensors import cloud_message, ring

        Rclpy([]).installed(monkeypatch)
        names["message"] = as_ros(cloud_message(ring().reshape(6, 10, 3), 1.0))
    exec(compile(code, "coming_from.md", "exec"), names)
    loops = [len(names[name]) for name in ("diagram", "bars") if name in names and "worst" not in names]
    assert all(count == (0 if "descent" in names else 1) for count in loops)
    if "worst" in names:
        known = rips_persistence(points).lifetime[0]
        assert 0.005 < known - float(names["bars"].detach().diff()[0]) <= 0.02 + 1e-9
    if "states" in names:
        assert [state.loops[0].id for state in names["states"]] == [0, 0]
    if "markers" in names:
        assert len(names["markers"].markers) == 4
    if "to_lerobot" in names:
        assert json.loads((tmp_path / "garments/meta/info.json").read_text())["total_episodes"] == 2
    if "env" in names:
        names["env"].close()


def test_the_table_is_that_of_the_results(monkeypatch):
    pytest.importorskip("torch")
    monkeypatch.syspath_prepend(ROOT / "book" / "experiments")
    monkeypatch.delitem(sys.modules, "doors", raising=False)
    import doors

    found = json.loads((ROOT / "book" / "results" / "doors.json").read_text())
    assert doors.paged(PAGE, found) == PAGE
    assert [row["neighbour"] for row in found["rows"]] == list(dict.fromkeys(row["neighbour"] for row in found["rows"]))
