"""Datasets that are made in seconds: coarse cloth, few frames; and faults for the processes that make them."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from topokit.data import DatasetConfig, _generate, generate_dataset, label_dataset
from topokit.sim import Garment, SimulationConfig

from conftest import hear_ctrl_c

TINY = DatasetConfig(
    tasks={"sheet-hook": 2, "sheet2-hanger": 1, "mask-hook": 1},
    sizes={"sheet": {"spacing": 0.06}, "sheet2": {"spacing": 0.05}, "mask": {"spacing": 0.03}},
    simulation=SimulationConfig(dt=1 / 500, steps_per_frame=8, frames=20, settle=0.05),
    n_observed=48,
)
SEED = 5
OPTIONS = {"alpha": 0.003}  # cloth this coarse has no loop that outlives its spacing


def write_cloth(path: Path, *, stretched: float = 1.0) -> list[int]:
    """Write a cloth with a hole as an OBJ file of a stranger; return the vertex ids of the hole."""
    cloth = Garment.sheet(spacing=0.06)
    lines = ["v {} {} {}".format(*(stretched * vertex)) for vertex in cloth.vertices]
    lines += ["f {} {} {}".format(*(face + 1)) for face in cloth.faces]
    path.write_text("\n".join(lines))
    return cloth.loops[0].tolist()


@contextmanager
def without_dask() -> Iterator[None]:
    """Do the jobs one after another in this process: they are the same, and Dask takes seconds to start."""

    def jobs(job: Any, items: Any, _: Any) -> Iterator[Any]:
        for item in items:
            yield item, job(item)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_generate, "run_jobs", jobs)
        patch.setattr(_generate, "_forge", None)
        yield
        if _generate._forge is not None:
            _generate._forge.close()


def labelled(folder: Path, episodes: int, *, observed: bool = True) -> Path:
    """Make a dataset with labels of all vertices, and of 40 observed ones."""
    with without_dask():
        generate_dataset(TINY, folder, episodes, SEED, progress=False)
        label_dataset(folder, options=OPTIONS, progress=False)
        if observed:
            label_dataset(folder, "observed", n_points=40, options=OPTIONS, progress=False)
    return folder


def crash(job: dict[str, object]) -> str:
    """What PyBullet can do."""
    os.kill(os.getpid(), signal.SIGSEGV)
    return "never"


def crash_twice(job: dict[str, object]) -> str:
    """Crash, but not on the third try."""
    from topokit.data._generate import simulate_and_commit

    return crash(job) if job["attempt"] != 3 else simulate_and_commit(job)


def hang(job: dict[str, object]) -> str:
    """What PyBullet can do, too."""
    while True:
        pass


def sleep(job: dict[str, object]) -> str:
    """Take long, and little of the processor."""
    time.sleep(1.5)
    return "ok"


def fill_the_disk(job: dict[str, object]) -> str:
    """Find no room."""
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def command(*arguments: str | Path, site: Path | None = None) -> subprocess.Popen[str]:
    """Start a topokit command; modules in `site`, such as sitecustomize, come first in all its processes."""
    path = os.pathsep.join(map(str, filter(None, [site, *sys.path])))
    return subprocess.Popen(
        [sys.executable, "-m", "topokit", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
        start_new_session=True,
        preexec_fn=hear_ctrl_c,
    )


def wait_until(condition: Callable[[], bool], process: subprocess.Popen[str], seconds: float = 120.0) -> None:
    """Wait for something that a process brings about."""
    end = time.monotonic() + seconds
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end, "it takes too long"
        time.sleep(0.02)
