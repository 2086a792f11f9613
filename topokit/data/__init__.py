"""Datasets of many episodes: made in parallel, stored in Zarr, labelled, checked, and read as windows for training.

Source: Antonova et al. 2021, section 6 (23,000 trajectories). Taught in chapter 8.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ._check import Problem, check
    from ._generate import Interrupted, generate
    from ._label import label
    from .config import DatasetConfig, make_episode
    from .dataset import Dataset
    from .windows import Truth, WindowDataset

_WHERE = {
    "Dataset": "dataset",
    "DatasetConfig": "config",
    "Interrupted": "_generate",
    "Problem": "_check",
    "Truth": "windows",
    "WindowDataset": "windows",
    "check": "_check",
    "generate": "_generate",
    "label": "_label",
    "make_episode": "config",
}

__all__ = [
    "Dataset",
    "DatasetConfig",
    "Interrupted",
    "Problem",
    "Truth",
    "WindowDataset",
    "check",
    "generate",
    "label",
    "make_episode",
]


def __getattr__(name: str) -> Any:
    """Import what is used when it is used: Zarr, Dask, PyBullet and PyTorch are not needed for everything."""
    if name in _WHERE:
        return getattr(import_module(f".{_WHERE[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
