"""Shapes and recorded episodes that several tests use."""

from __future__ import annotations

import os
import signal
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "Agg")  # tests have no display

import numpy as np
import pytest

DATA = Path(__file__).parent.parent / "data_small"


def polygon(n: int, radius: float = 1.0) -> np.ndarray:
    """Corners of a regular n-gon in the plane."""
    angle = 2 * np.pi * np.arange(n) / n
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


@contextmanager
def memory() -> Iterator[Callable[[], int]]:
    """Yield what tells the most bytes that Python has taken since."""
    tracemalloc.start()
    try:
        yield lambda: tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def hear_ctrl_c() -> None:
    """Ctrl-C is ignored by what a shell runs in the background, the end of the terminal by nohup, and by all that these start."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.fixture(scope="session")
def episode_path() -> Path:
    """The first recorded apron episode."""
    return DATA / "apron_hook_0.npz"
