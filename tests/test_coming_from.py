"""The page *Coming from ...*: every piece of code runs where its packages are installed, and the table is that of the results."""

from __future__ import annotations

import importlib
import importlib.util
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
BLOCK = r"```python\n(.*?)```"
SECTIONS = [section for section in PAGE.split("\n## ") if re.search(BLOCK, section, re.DOTALL)]


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
@pytest.mark.parametrize("section", SECTIONS, ids=[section.partition("\n")[0] for section in SECTIONS])
def test_the_pieces_of_a_section_run_one_after_another(section, tmp_path, monkeypatch):
    (tmp_path / "data_small").symlink_to(DATA, target_is_directory=True)
    monkeypatch.chdir(tmp_path)
    points = np.column_stack([polygon(20), 0.1 * np.cos(2 * np.arange(20))])
    names = {"points": points, "clouds": [points, points[:15]]}
    ran = 0
    for block in re.findall(BLOCK, section, re.DOTALL):
        needed = imported(block)
        if not all(map(is_installed, needed)):
            continue
        if "folding" in block:
            write_lerobot(tmp_path / "folding", [points, 1.1 * points])
        if "recording" in block:
            messages = [cloud_message(ring(t), 1 + t) for t in range(2)]
            save_bag(tmp_path / "recording", {"/camera/points": messages, "/other/points": messages})
        if "pypcd4" in block:
            importlib.import_module("pypcd4").PointCloud.from_xyz_points(ring()).save(tmp_path / "ring.pcd")
        exec(compile(block, "coming_from.md", "exec"), names)
        check(block, names, points, tmp_path)
        ran += 1
    if not ran:
        pytest.skip("no piece has its packages installed")


def check(block: str, names: dict, points: np.ndarray, folder: Path) -> None:
    """Check what a piece of code computed from the one loop of the cloud."""
    known = rips_persistence(points)
    bar = np.column_stack([known.birth, known.death])
    if "worst" in block:
        lost = known.lifetime[0] - float(names["bars"].detach().diff()[0])
        assert 0.005 < lost <= 0.02 + 1e-9
    elif "descent" in block:
        assert len(names["bars"]) == 0
    elif "moved" in block:
        np.testing.assert_allclose(names["bars"].detach().numpy(), bar)
    elif "bars =" in block:
        np.testing.assert_allclose(names["bars"], 2 * bar, rtol=1e-6)
    if "generators" in block and "moved" not in block:
        assert names["generators"][0].tolist() == [[*known.birth_edge[0, ::-1], *known.killer_edge[0, ::-1]]]
    if "get_skeleton" in block:
        assert names["diagram"].birth_edge.tolist() == known.birth_edge.tolist()
        assert names["diagram"].killer_edge.tolist() == [[-1, -1]]  # the tree ends before it dies
    if "table = features" in block:
        np.testing.assert_allclose(names["table"][0], [known.birth[0], known.lifetime[0], 0, 0, 0, 0, 0, 0])
    if "states" in block:
        assert [[loop.id for loop in state.loops] for state in names["states"]] == [[0], [0]]
        assert names["states"][0].time < names["states"][1].time
    if "rr.save" in block:
        assert (folder / "apron.rrd").stat().st_size > 10_000
    if "LeRobotDataset" in block:
        film = load_episode(DATA / "apron_hook_0.npz")
        assert (names["garments"].num_episodes, names["garments"].num_frames) == (2, 2 * (len(film) - 1))
    if "env" in names:
        names["env"].close()
