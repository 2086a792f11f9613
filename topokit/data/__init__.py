"""Datasets of many episodes: made in parallel, stored in Zarr, labelled, checked, and read as windows for training.

Source: Antonova et al. 2021, section 6 (23,000 trajectories). Taught in chapter 8.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from topokit._lazy import attach

if TYPE_CHECKING:
    from ._check import Problem, check_dataset
    from ._dataset import Dataset
    from ._generate import generate_dataset
    from ._label import label_dataset
    from ._recipe import DatasetConfig, make_episode
    from ._windows import WindowDataset, spoil

__all__ = [
    "Dataset",
    "DatasetConfig",
    "Problem",
    "WindowDataset",
    "check_dataset",
    "generate_dataset",
    "label_dataset",
    "make_episode",
    "spoil",
]

__getattr__ = attach(
    __name__,
    {
        "_check": "Problem check_dataset",
        "_dataset": "Dataset",
        "_generate": "generate_dataset",
        "_label": "label_dataset",
        "_recipe": "DatasetConfig make_episode",
        "_windows": "WindowDataset spoil",
    },
    extra="data,sim,learn",
)
