"""Datasets of many episodes: made in parallel, stored in Zarr, labelled, checked, and read as windows for training.

Source: Antonova et al. 2021, section 6 (23,000 trajectories). Taught in chapter 8.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from topokit._lazy import attach

if TYPE_CHECKING:
    from ._check import Problem, check
    from ._generate import Interrupted, generate
    from ._label import label
    from ._spoil import spoil
    from ._windows import WindowDataset
    from .config import DatasetConfig, make_episode
    from .dataset import Dataset

__all__ = [
    "Dataset",
    "DatasetConfig",
    "Interrupted",
    "Problem",
    "WindowDataset",
    "check",
    "generate",
    "label",
    "make_episode",
    "spoil",
]

__getattr__ = attach(
    __name__,
    {
        "_check": "Problem check",
        "_generate": "Interrupted generate",
        "_label": "label",
        "_spoil": "spoil",
        "config": "DatasetConfig make_episode",
        "dataset": "Dataset",
        "_windows": "WindowDataset",
    },
    extra="data,sim,learn",
)
