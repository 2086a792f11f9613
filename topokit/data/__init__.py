"""Datasets of many episodes: made in parallel, one file an episode, labelled, checked, and read as windows for training.

Source: Antonova et al. 2021, section 6 (23,000 trajectories). Taught in chapter 11.
"""

from typing import TYPE_CHECKING

from topokit._lazy import attach

if TYPE_CHECKING:
    from ._dataset import Dataset
    from ._generate import generate_dataset
    from ._label import label_dataset
    from ._recipe import DatasetConfig, make_episode
    from ._windows import WindowDataset

__getattr__, __dir__, __all__ = attach(__name__, __file__, "data,sim,learn")
