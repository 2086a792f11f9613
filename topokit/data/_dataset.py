"""Read a dataset: episodes, labels, splits, and a smaller dataset of some of its episodes. Taught in chapter 9."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topokit._archive import FormatError
from topokit.io import Episode, check_episode
from topokit.seqph import TopologicalState

from ._group import Group, damage_in, decode, label_name, open_episodes, replace, tracked_cloud
from ._layout import episode_of, needed, skeleton, states_of
from ._recipe import DatasetConfig
from ._records import Record, index_bytes, record_path

Ids = NDArray[np.int64]
_PARTS = {"train": 0.8, "validation": 0.1, "test": 0.1}
_FIRST_AND_LAST = {"train": -1, "test": 1}  # of a split; what is between them has the order of the alphabet


class Dataset:
    """A dataset that `generate` made, in a folder or at any URL that fsspec reads.

    Episodes keep their number whatever became of their neighbours: ``dataset[7]`` is `make_episode(config, seed, 7)`, to
    within 0.05 mm. Iterating gives those that are whole, in order.

    Parameters
    ----------
    url : str or path
        ``runs/data``, ``s3://bucket/data``, ``zip://::data.zip``, ``memory://data`` and so on.
    """

    def __init__(self, url: str | Path) -> None:
        self.group = open_episodes(url)
        self.seed: int = self.group.manifest["seed"]
        self.episodes: Ids = self.group.whole  #: (n,) numbers of the whole ones
        self._labels: dict[str, Group] = {}

    @cached_property
    def config(self) -> DatasetConfig:
        """What the episodes were drawn from."""
        return DatasetConfig.from_json(self.group.manifest["config"])

    @cached_property
    def records(self) -> tuple[Record, ...]:
        """One for every episode that was tried, in order."""
        return tuple(self.group.records[i] for i in sorted(self.group.records))

    @property
    def failures(self) -> tuple[Record, ...]:
        """Those that were rejected or failed, each with its `reason`."""
        return tuple(record for record in self.records if record.status != "ok")

    @cached_property
    def garments(self) -> tuple[str, ...]:
        """All garments that the configuration can draw, in alphabetical order."""
        return tuple(sorted({task.rpartition("-")[0] for task in self.group.manifest["config"]["tasks"]}))

    def __len__(self) -> int:
        return len(self.episodes)

    def __repr__(self) -> str:
        whole, of = len(self), len(self.group.numbers)
        return f"Dataset({self.group.url!r}, {whole} of {of} episodes, {len(self.failures)} rejected or failed)"

    def __getitem__(self, episode: int) -> Episode:
        """Return an episode by its number, verified; a KeyError says why there is none, a FormatError what is damaged."""
        document = self.group.document(self._known(episode))
        with damage_in(self.group, document["episode"]):
            found = episode_of(decode(self.group, document), document, self.group.manifest)
            check_episode(found)
        return found

    def __iter__(self) -> Iterator[Episode]:
        return (self[int(i)] for i in self.episodes)

    def _known(self, episode: int) -> int:
        record = self.group.records.get(int(episode))
        if record is None:
            raise KeyError(f"{self.group.url} has no episode {episode}")
        if record.status != "ok":
            raise KeyError(f"episode {episode} was {record.status}: {record.reason}")
        return int(episode)

    def document(self, episode: int) -> dict[str, Any]:
        """Return the full record of an episode: its physics, what was drawn, and the checksums of its objects."""
        return self.group.document(int(episode))

    def checksum(self) -> str:
        """Return one SHA-256 of what the dataset is and of all its episodes: the same however it was made."""
        return self.group.checksum()

    def labels(self, name: str) -> Group:
        """Return a set of labels: its `records`, its `manifest` with the options of the tracker, and its arrays.

        Raises
        ------
        FileNotFoundError
            When there are none of that name.
        """
        if name not in self._labels:
            if self.group.read(f"labels/{label_name(name)}/zarr.json") is None:
                known = ", ".join(self.group.names("labels")) or "none: topokit label makes them"
                raise FileNotFoundError(f"{self.group.url} has no labels {name!r}; it has {known}")
            self._labels[name] = Group(self.group.url, f"labels/{name}", self.group)
        return self._labels[name]

    def labelled(self, name: str) -> Ids:
        """(n,) the numbers of the episodes that have labels of that name."""
        return np.intersect1d(self.episodes, self.labels(name).whole)

    def states(self, episode: int, name: str) -> list[TopologicalState]:
        """Return the tracked states of an episode, one a frame, from its labels.

        Lengths are rounded to single precision; the parameters of a state count the loops that had no slot (`dropped`).

        Parameters
        ----------
        episode : int
        name : str
            Of the labels.
        """
        labels, document = self.labels(name), self.group.document(self._known(episode))
        cloud = tracked_cloud(self.group, document, labels.manifest)
        with damage_in(labels, int(episode)):
            return states_of(decode(labels, labels.document(int(episode))), cloud, document["dt"])

    def split(
        self, by: str = "episode", shares: Mapping[str, float] = _PARTS, *, seed: int = 0, held_out: Sequence[str] = ()
    ) -> dict[str, Ids]:
        """Divide the numbers of the episodes into parts, never within an episode: neighbouring frames are nearly the same.

        Parts are cut in one order, however `shares` names them: "train" first, "test" last, others between them by name.

        Parameters
        ----------
        by : {"episode", "garment"}
            By episode each is drawn on its own: the shares are met about, and no episode changes its part when the dataset
            grows. By garment whole garments are dealt out, at least one to every part.
        shares : mapping of str to float
            Parts and their shares.
        seed : int
        held_out : sequence of str
            Garments of the last part, for example ``["apron", "apron2"]``, which are alike. By garment they are all of it; by
            episode its share of the others' episodes is added, so that training and validation know the same garments.

        Raises
        ------
        ValueError
            When there is no such way to split, a share is not positive, or garments are unknown or too few.
        """
        names = sorted(shares, key=lambda name: (_FIRST_AND_LAST.get(name, 0), name))
        weights = np.array([shares[name] for name in names], dtype=np.float64)
        if len(names) < 2 or not (weights > 0).all() or not np.isfinite(weights).all():
            raise ValueError(f"shares must give two parts or more a positive share each, not {dict(shares)}")
        unknown = sorted(set(held_out) - set(self.garments))
        if unknown:
            raise ValueError(f"held_out: no garment {', '.join(unknown)}; there are {', '.join(self.garments)}")
        if by == "garment":
            owner = self._owners(weights, seed, held_out)
            part = np.array([owner[self.group.records[int(i)].garment] for i in self.episodes], dtype=np.int64)
        elif by != "episode":
            raise ValueError(f"by must be 'episode' or 'garment', not {by!r}")
        else:
            # Not the stream (seed, i) that episode i was made from: its first draw is the task.
            keys = [np.random.SeedSequence(seed, spawn_key=(int(i), 1)) for i in self.episodes]
            draws = [np.random.default_rng(key).random() for key in keys]
            part = np.searchsorted(np.cumsum(weights / weights.sum())[:-1], draws, side="right")
            part[[self.group.records[int(i)].garment in held_out for i in self.episodes]] = len(names) - 1
        return {name: self.episodes[part == k] for k, name in enumerate(names)}

    def _owners(self, weights: NDArray[np.float64], seed: int, held_out: Sequence[str]) -> dict[str, int]:
        """Which part each garment goes to."""
        rest = [g for g in np.random.default_rng(seed).permutation(self.garments).tolist() if g not in held_out]
        parts = len(weights) - bool(held_out)
        if len(rest) < parts:
            raise ValueError(f"{len(rest)} garments cannot be dealt out to {parts} parts")
        shares = (weights / weights.sum())[:parts]
        free = len(rest) - parts  # beyond the one that every part gets
        ends = np.rint(np.cumsum(shares / shares.sum()) * free).astype(int) + np.arange(1, parts + 1)
        owner = {garment: int(np.searchsorted(ends, place, side="right")) for place, garment in enumerate(rest)}
        return {**owner, **dict.fromkeys(held_out, len(weights) - 1)}

    def cut(self, episodes: Iterable[int], out: str | Path) -> Dataset:
        """Write a dataset of some of the episodes, with their labels; they keep their numbers and checksums.

        Parameters
        ----------
        episodes : iterable of int
        out : path or URL
            A folder that is empty or not there yet, or a place that fsspec writes to.

        Raises
        ------
        ValueError
            When there is no episode to write, the folder is not empty, or something is damaged: nothing is written then.
        """
        numbers = sorted({self._known(i) for i in episodes})
        if not numbers:
            raise ValueError("a cut needs one episode at least")
        for _ in self._parts(numbers):
            pass  # all of it is verified before a byte is written
        fs, root = needed("fsspec").core.url_to_fs(str(out))
        if fs.exists(root) and fs.ls(root):
            raise ValueError(f"{out} is not an empty folder")
        local = "file" in np.atleast_1d(fs.protocol)
        for path, content in self._parts(numbers):
            if local:
                replace(Path(root, path), content)
            else:
                fs.pipe_file(f"{root.rstrip('/')}/{path}", content)
        return Dataset(out)

    def _parts(self, numbers: list[int]) -> Iterator[tuple[str, bytes]]:
        """Path and verified content of all that a cut holds; the zarr.json that makes it a dataset comes last."""
        for group in (*map(self.labels, self.group.names("labels")), self.group):
            prefix = f"{group.prefix}/" if group.prefix else ""
            there = [i for i in numbers if i in group.records]
            for number in there:
                own = {record_path(number), *(f.path(number) for f in group.fields)}
                objects = group.document(number)["objects"]
                for path, checksum in {**objects, record_path(number): group.records[number].sha256}.items():
                    if path not in own or group.linked(path):
                        where = group.where(record_path(number))
                        raise FormatError(f"{where}: names {path!r:.200}, which is not its own or is reached by a link")
                    yield prefix + path, group.verified(path, checksum, number)
            made = skeleton(group.fields, {**group.manifest, "numbers": numbers})
            index = index_bytes(group.records[i] for i in there)
            for path, content in reversed([*made.items(), ("index.json", index)]):
                yield prefix + path, content
