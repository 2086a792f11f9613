"""Read a dataset: its episodes, its labels, and its parts for training and test. Taught in chapter 11.

Labels are the tracked loops in every frame of every episode, stored as `topokit.io.state_arrays` describes.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field, fields
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from topokit._archive import FormatError, load_archive, load_header
from topokit._config import checked, load
from topokit.io import EPISODE_KIND, Episode, check_states, load_episode, states_of
from topokit.seqph import TopologicalState

from ._folder import NumberedFiles
from ._recipe import DatasetConfig

ABOUT = "dataset.json"
ABOUT_LABELS = "labels.json"
LABELS_KIND = "topokit-labels"
Ids = NDArray[np.int64]
NotNegative = Annotated[int, Field(ge=0)]


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


@checked
class Record:
    """A summary of an episode."""

    episode: NotNegative
    #: result: ok (there is a file), rejected (it was not physical) or failed (it could not be made)
    status: Literal["ok", "rejected", "failed"] = "ok"
    reason: str = ""  #: reason of a status other than ok
    task: str = ""
    garment: str = ""
    target: str = ""
    seed: NotNegative = 0  #: seed of the episode
    success: bool = False
    frames: NotNegative = 0
    physics: Mapping[str, Any] = field(default_factory=dict)


@checked
class LabelSettings:
    """The settings with which a set of labels was made."""

    schema: Literal[2]
    observation: Literal["full", "observed"]  #: the points that were tracked
    #: number of first points of an observation that were tracked; None for all
    n_points: Annotated[int, Field(ge=4)] | None
    options: Mapping[str, Any]  #: the options of the tracker, `topokit.SeqPH`
    versions: Mapping[str, str]  #: the versions of the packages that made the labels


class Labels(NumberedFiles):
    """One set of labels of a dataset, in a folder beside its episodes: `Dataset.labels`."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, ABOUT_LABELS)
        self.settings = load(LabelSettings, folder / ABOUT_LABELS)  #: the settings with which the labels were made
        self.options = dict(self.settings.options)  #: the options of the tracker

    def cloud(self, episode: Episode) -> NDArray[np.float32]:
        """Return the cloud that was tracked in an episode, (T, n, 3) metres: all vertices, or the first observed points."""
        if self.settings.observation == "full":
            return episode.points
        return episode.observed[:, : self.settings.n_points]

    def arrays(self, number: int, clouds: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Return the arrays of labels of an episode (`topokit.io.state_arrays`), given its cloud (T, n, 3) that was tracked."""
        path = self.path_of(number)
        _, arrays = load_archive(path, LABELS_KIND)
        try:
            check_states(arrays, clouds)
        except (KeyError, ValueError) as error:
            raise FormatError(f"{path}: {error}; remove the file and label again") from error
        return arrays


class Dataset(NumberedFiles):
    """A dataset that `generate_dataset` made in a folder; iteration gives its episodes, in order, to within 0.05 mm."""

    def __init__(self, folder: str | Path) -> None:
        if not (Path(folder).expanduser() / ABOUT).is_file():
            raise FileNotFoundError(f"{folder}: there is no dataset (no {ABOUT}); topokit generate makes one")
        super().__init__(folder, ABOUT)
        self.settings = load(DatasetSettings, self.folder / ABOUT)  #: its settings
        self.config = self.settings.config  #: the configuration from which the episodes were drawn
        self.seed = self.settings.seed  #: the seed with which the episodes were drawn
        #: the numbers of all planned episodes
        self.wanted: Sequence[int] = self.settings.numbers or range(self.settings.episodes)
        #: all garments that the configuration can draw, in alphabetical order
        self.garments = tuple(sorted({task.rpartition("-")[0] for task in self.config.tasks}))
        self._records: dict[int, Record] = {}
        self._labels: dict[str, Labels] = {}

    def __len__(self) -> int:
        return len(self.episodes)

    def __repr__(self) -> str:
        counted = f"{len(self)} of {len(self.wanted)} episodes, {len(self.failures)} rejected or failed"
        return f"Dataset({str(self.folder)!r}, {counted})"

    def __getitem__(self, episode: int) -> Episode:
        """Return an episode by its number; raise KeyError when there is none, FormatError when its file is damaged."""
        path = self.path_of(episode)
        if path.suffix == ".json":
            record = self.record(episode)
            raise KeyError(f"episode {episode} was {record.status}: {record.reason}")
        return load_episode(path)

    def __iter__(self) -> Iterator[Episode]:
        return (self[number] for number in self.episodes.tolist())

    def record(self, episode: int) -> Record:
        """Return the summary of an episode, read from the header of its file; raise KeyError when it was not tried."""
        if episode not in self._records:
            path = self.path_of(episode)
            header = json.loads(path.read_bytes()) if path.suffix == ".json" else load_header(path, EPISODE_KIND)
            known = {part.name: header[part.name] for part in fields(Record) if part.name in header}
            self._records[episode] = Record(**{**known, "episode": int(path.stem)})
        return self._records[episode]

    @cached_property
    def records(self) -> tuple[Record, ...]:
        """Return a record for every episode that was tried, in order."""
        return tuple(self.record(number) for number in sorted(self._paths))

    @property
    def failures(self) -> tuple[Record, ...]:
        """Return the records of rejected and failed episodes, each with its `reason`."""
        return tuple(self.record(number) for number in sorted({*self._paths} - {*self.episodes.tolist()}))

    @property
    def counts(self) -> dict[str, int]:
        """Return the numbers of "ok", "rejected" and "failed" episodes, each only when there are any."""
        statuses = ["ok"] * len(self) + [record.status for record in self.failures]
        return {status: statuses.count(status) for status in sorted(set(statuses))}

    @property
    def label_names(self) -> tuple[str, ...]:
        """Return the names of the sets of labels, in alphabetical order."""
        return tuple(sorted(path.parent.name for path in self.folder.glob(f"labels/*/{ABOUT_LABELS}")))

    def labels(self, name: str) -> Labels:
        """Return a set of labels: its arrays, and its `options` of the tracker."""
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
