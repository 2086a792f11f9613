"""Datasets that are made in seconds: coarse cloth, few frames; parts of datasets; and commands to be disturbed."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from topokit.data import Dataset, DatasetConfig, generate_dataset, label_dataset
from topokit.sim import WARDROBE, SimulationConfig

from conftest import hear_ctrl_c

TINY = DatasetConfig(
    tasks={"sheet-hook": 2, "sheet2-hanger": 1, "mask-hook": 1},
    sizes={"sheet": {"spacing": 0.06}, "sheet2": {"spacing": 0.05}, "mask": {"spacing": 0.03}},
    simulation=SimulationConfig(dt=1 / 500, steps_per_frame=8, frames=20, settle=0.05),
    n_observed=48,
)
SEED = 5
OPTIONS = {"alpha": 0.003}  # cloth this coarse has no loop that outlives its spacing


def write_cloth(path: Path, *, stretched: float = 1.0) -> dict[str, Any]:
    """Write a cloth with a hole as an OBJ file; return what a configuration says of it."""
    cloth = WARDROBE["sheet"](spacing=0.06)
    lines = ["v {} {} {}".format(*(stretched * vertex)) for vertex in cloth.vertices]
    lines += ["f {} {} {}".format(*(face + 1)) for face in cloth.faces]
    path.write_text("\n".join(lines))
    return {
        "up": "z",
        "unit": 1.0,
        "grips": cloth.grips.tolist(),
        "loops": {"hole": cloth.loops[0].tolist()},
    }


def labelled(folder: Path, episodes: int) -> Path:
    """Make a dataset with labels of all vertices, and of 40 observed ones."""
    generate_dataset(TINY, folder, episodes, SEED, progress=False)
    label_dataset(folder, options=OPTIONS, progress=False)
    label_dataset(folder, "observed", n_points=40, options=OPTIONS, progress=False)
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    """Return the files of a folder."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def part_of(dataset: Dataset, numbers: Iterable[int], out: Path) -> Dataset:
    """Copy some episodes of a dataset, with their labels."""
    numbers = sorted(int(number) for number in numbers)
    for folder in (dataset.folder, *(dataset.labels(name).folder for name in dataset.label_names)):
        target = out / folder.relative_to(dataset.folder)
        target.mkdir(parents=True)
        for path in [*folder.glob("[a-z]*.json"), *(folder / f"{number:08d}.npz" for number in numbers)]:
            shutil.copy(path, target)
    about = json.loads((out / "dataset.json").read_text())
    (out / "dataset.json").write_text(json.dumps({**about, "numbers": numbers}))
    return Dataset(out)


def command(*arguments: str | Path) -> subprocess.Popen[str]:
    """Start a topokit command in a session of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "topokit", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        start_new_session=True,
        preexec_fn=hear_ctrl_c,
    )


def wait_until(
    condition: Callable[[], bool], process: subprocess.Popen[str] | None = None, seconds: float = 120.0
) -> None:
    """Wait for something that a process brings about."""
    end = time.monotonic() + seconds
    while not condition():
        assert process is None or process.poll() is None, process and process.communicate()
        assert time.monotonic() < end, "it takes too long"
        time.sleep(0.02)
