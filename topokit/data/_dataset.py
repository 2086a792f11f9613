"""Read a dataset: its episodes, its labels, and its parts for training and test. Taught in chapter 11."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from topokit._config import checked
from topokit.io import EPISODE_KIND, Episode, load_episode, states_of
from topokit.seqph import TopologicalState

from ._folder import NotNegative, NumberedFiles, read_settings
from ._labels import ABOUT as ABOUT_LABELS
from ._labels import Labels
from ._recipe import DatasetConfig

ABOUT = "dataset.json"
Ids = NDArray[np.int64]


@checked
class DatasetSettings:
    """The settings of a dataset, as stored in its folder."""

    schema: Literal[2]
    config: DatasetConfig
    seed: NotNegative
    episodes: Annotated[int, Field(ge=1)]  #: number of episodes
    versions: Mapping[str, str]  #: versions of the packages on which bytes depend
    #: numbers of the episodes, for a part of a dataset; all of them when not given
    numbers: tuple[NotNegative, ...] | None = None


class Dataset(NumberedFiles):
    """A dataset that `generate_dataset` made in a folder.

    The number of an episode does not depend on other episodes: ``dataset[7]`` is `make_episode(config, seed, 7)`, to
    within 0.05 mm. Iteration gives the whole episodes, in order.

    Parameters
    ----------
    folder : path

    Raises
    ------
    FileNotFoundError
        When there is no dataset in the folder.
    FormatError
        When the file of its settings (`dataset.json`) is damaged.
    """

    def __init__(self, folder: str | Path) -> None:
        if not (Path(folder) / ABOUT).is_file():
            raise FileNotFoundError(f"{folder}: there is no dataset (no {ABOUT}); topokit generate makes one")
        super().__init__(folder, EPISODE_KIND, ABOUT)
        self.settings: DatasetSettings = read_settings(DatasetSettings, self.folder / ABOUT)  #: its settings
        self._labels: dict[str, Labels] = {}

    @property
    def config(self) -> DatasetConfig:
        """Return the configuration from which the episodes were drawn."""
        return self.settings.config

    @property
    def seed(self) -> int:
        """Return the seed with which the episodes were drawn."""
        return self.settings.seed

    @property
    def wanted(self) -> Sequence[int]:
        """Return the numbers of all planned episodes of the dataset."""
        if self.settings.numbers is not None:
            return self.settings.numbers
        return range(self.settings.episodes)

    @cached_property
    def garments(self) -> tuple[str, ...]:
        """Return all garments that the configuration can draw, in alphabetical order."""
        return tuple(sorted({task.rpartition("-")[0] for task in self.config.tasks}))

    def __len__(self) -> int:
        return len(self.episodes)

    def __repr__(self) -> str:
        counted = f"{len(self)} of {len(self.wanted)} episodes, {len(self.refused)} rejected or failed"
        return f"Dataset({str(self.folder)!r}, {counted})"

    def __getitem__(self, episode: int) -> Episode:
        """Return an episode by its number; raise KeyError when there is none, FormatError when its file is damaged."""
        return load_episode(self.path_of(episode))

    def __iter__(self) -> Iterator[Episode]:
        return (self[number] for number in self.episodes.tolist())

    @property
    def label_names(self) -> tuple[str, ...]:
        """Return the names of the sets of labels, in alphabetical order."""
        return tuple(sorted(path.parent.name for path in self.folder.glob(f"labels/*/{ABOUT_LABELS}")))

    def labels(self, name: str) -> Labels:
        """Return a set of labels: its `options` of the tracker, its `records` and its arrays.

        Raises
        ------
        FileNotFoundError
            When there are no labels of that name.
        """
        if name not in self._labels:
            if name not in self.label_names:
                known = ", ".join(self.label_names) or "none: topokit.data.label_dataset makes them"
                raise FileNotFoundError(f"{self.folder} has no labels {name!r}; it has {known}")
            self._labels[name] = Labels(self.folder / "labels" / name)
        return self._labels[name]

    def labelled(self, name: str) -> Ids:
        """Return the numbers (n,) of the episodes that have labels of that name."""
        return np.intersect1d(self.episodes, self.labels(name).episodes)

    def states(self, episode: int, name: str) -> list[TopologicalState]:
        """Return the tracked states of an episode, one a frame, from its labels.

        Lengths are rounded to single precision; the parameters of a state count the loops that had no slot (`dropped`).

        Parameters
        ----------
        episode : int
        name : str
            Name of the set of labels.
        """
        labels = self.labels(name)
        film = self[episode]
        cloud = labels.cloud(film)
        return states_of(labels.arrays(episode, cloud), cloud, film.times)

    def split(
        self, shares: Mapping[str, float] | None = None, *, seed: int = 0, held_out: Sequence[str] = ()
    ) -> dict[str, Ids]:
        """Divide the numbers of the episodes into parts, never within an episode: neighbouring frames are nearly the same.

        Each episode is drawn on its own: the shares hold approximately, and no episode changes its part when the dataset grows.
        Parts are cut in one order, however `shares` names them: "train" first, "test" last, others between them by name.

        Parameters
        ----------
        shares : mapping of str to float, optional
            Parts and their shares; "train" .8, "validation" .1 and "test" .1 when not given.
        seed : int
        held_out : sequence of str
            Garments of the last part alone, for example ``["apron", "apron2"]``, which are alike.

        Raises
        ------
        ValueError
            When a share is not positive, or a garment is unknown.
        """
        shares = shares or {"train": 0.8, "validation": 0.1, "test": 0.1}
        names = sorted(shares, key=lambda name: ({"train": -1, "test": 1}.get(name, 0), name))
        weights = np.array([shares[name] for name in names], dtype=np.float64)
        if len(names) < 2 or not (weights > 0).all():
            raise ValueError(f"shares must give two parts or more a positive share each, not {dict(shares)}")
        unknown = sorted(set(held_out) - set(self.garments))
        if unknown:
            raise ValueError(f"held_out: no garment {', '.join(unknown)}; there are {', '.join(self.garments)}")
        # Not the stream (seed, i) that episode i was made from: its first draw is the task.
        keys = [np.random.SeedSequence(seed, spawn_key=(int(i), 1)) for i in self.episodes]
        draws = [np.random.default_rng(key).random() for key in keys]
        part = np.searchsorted(np.cumsum(weights / weights.sum())[:-1], draws, side="right")
        part[[self.record(i).garment in held_out for i in self.episodes]] = len(names) - 1
        return {name: self.episodes[part == k] for k, name in enumerate(names)}
