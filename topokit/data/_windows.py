"""Windows for training: 16 clouds of the past, 60 planned actions, and the states that they led to.

Source: Antonova et al. 2021, section 5 (h = 16, k = 60). Taught in chapter 8.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ._layout import METRE, unpack
from ._read import ABSENT, SIMPLICES, decode
from .dataset import Dataset

__all__ = ["Truth", "WindowDataset"]

Array = NDArray[np.float32]
_UNIT = np.float32(1 / METRE)


@dataclass(frozen=True, eq=False)
class Truth:
    """What evaluation compares a forecast with.

    Attributes
    ----------
    loops, past_loops : tuple of (k, L, 3) and of (h, L, 3) float32
        Vertices of every true loop in the frames t+1..t+k, and in t-h+1..t, metres.
    task : str
    success : bool
        Of the whole episode.
    """

    loops: tuple[Array, ...]
    past_loops: tuple[Array, ...]
    task: str
    success: bool


@dataclass(frozen=True, eq=False)
class _Tracked:
    """Labels of an episode: integers, in units of 0.1 mm, beside values in metres."""

    ids: NDArray[np.int32]  # (T, S'), -1 where there is no loop
    triangles: NDArray[np.int16]  # (T, S', 6, 3, 3)
    values: Array  # (T, S', 6)
    numbers: Array  # (T, S', 3): birth, death, step

    @classmethod
    def of(cls, found: Mapping[str, NDArray[Any]], cloud: NDArray[np.int16]) -> _Tracked:
        """From stored arrays, and the cloud that was tracked."""
        triangles, values = _triangles(found["simplices"], found["values"], cloud)
        return cls(found["id"], triangles, values, np.nan_to_num(found["values"][..., :3], nan=0.0))

    @property
    def nbytes(self) -> int:
        return sum(array.nbytes for array in vars(self).values())


@dataclass(frozen=True, eq=False)
class _Episode:
    """An episode as windows are cut from it: integers, in units of 0.1 mm."""

    clouds: NDArray[np.int16]  # (T, P, 3)
    grippers: NDArray[np.int16]  # (T, 2, 3)
    actions: NDArray[np.int16]
    held: NDArray[np.bool_]  # (T,)
    tracked: _Tracked
    seen: _Tracked | None = None

    @property
    def nbytes(self) -> int:
        return sum(part.nbytes for part in vars(self).values() if part is not None)


class WindowDataset(torch.utils.data.Dataset[dict[str, torch.Tensor]]):
    """All windows of some episodes, in the order of episodes and frames; a `torch.utils.data.Dataset`.

    An item is a dict of tensors: what was seen and planned up to frame t, and the states that followed. With h frames of
    history, k of horizon, P points and S slots, lengths in metres:

    =================  =================  ==================================================================================
    ``clouds``         (h, P, 3)          observations of the frames t-h+1..t
    ``grippers``       (h, 2, 3)          where the grippers were then
    ``held``           (h,) bool          whether they held the garment
    ``actions``        (k, 2, 3)          where they shall be at t+1..t+k
    ``actions_held``   (k,) bool          whether they shall hold it
    ``triangles``      (k, S, 6, 3, 3)    the two killer triangles, thick first, then four neighbours; one that is absent
                                          repeats the thick killer triangle
    ``values``         (k, S, 6)          their filtration values, 0 where absent
    ``birth, death``   (k, S)
    ``step``           (k, S)             Hausdorff distance to the previous appearance, 0 where new
    ``present``        (k, S) bool        where it is False, all of the above are 0
    ``past_...``       (h, S, ...)        the same six for the history
    ``seen_...``       (h, S, ...)        and those of `seen_labels`, if any; their slots have identities of their own
    ``episode``        int64              number of the episode
    ``frame``          int64              t
    ``garment``        int64              place in `Dataset.garments`
    =================  =================  ==================================================================================

    A slot is one identity through the whole window. First come the loops that are alive in the history, the longest lifetime
    on average over its frames first (0 where absent), then those that appear later, in their order. More than S have no slot.

    Parameters
    ----------
    dataset : Dataset, path or URL
    episodes : iterable of int, optional
        One part of `Dataset.split`, so that no episode is in two parts; all labelled ones when not given.
    labels : str
        Which set of labels.
    seen_labels : str, optional
        A second set, for what a tracker sees of the history with fewer points (`topokit label --observation observed`).
    history, horizon : int
        h and k.
    n_points : int
        P: a farthest-point sample of the observation; one that has fewer points is repeated.
    slots : int
        S.
    stride : int
        Frames from one window of an episode to the next.
    memory : float
        Bytes of decoded episodes that a process keeps; the one that was not used for longest goes first.

    Raises
    ------
    ValueError
        When an episode has no labels of that name, or no window fits into any.
    FileNotFoundError
        When there are no labels of that name.
    """

    def __init__(
        self,
        dataset: Dataset | str | Path,
        episodes: Iterable[int] | None = None,
        *,
        labels: str = "full",
        seen_labels: str | None = None,
        history: int = 16,
        horizon: int = 60,
        n_points: int = 128,
        slots: int = 4,
        stride: int = 1,
        memory: float = 4e9,
    ) -> None:
        for name, value in {
            "history": history,
            "horizon": horizon,
            "n_points": n_points,
            "slots": slots,
            "stride": stride,
        }.items():
            if isinstance(value, bool) or not isinstance(value, int) or value < 1:
                raise ValueError(f"{name} must be a whole number, at least 1, not {value!r}")
        self.dataset = dataset if isinstance(dataset, Dataset) else Dataset(dataset)
        self.labels, self.seen_labels, self.history, self.horizon = labels, seen_labels, history, horizon
        self.n_points, self.slots, self.stride = n_points, slots, stride
        labelled = {name: self.dataset.labelled(name) for name in (labels, seen_labels) if name is not None}
        self.episodes = labelled[labels] if episodes is None else np.unique(np.fromiter(episodes, dtype=np.int64))
        for name, known in labelled.items():
            missing = np.setdiff1d(self.episodes, known)
            if len(missing):
                raise ValueError(
                    f"{len(missing)} episodes have no labels {name!r}, the first is {missing[0]}: topokit label makes them"
                )
        lengths = np.array([self.dataset.group.records[int(i)].frames for i in self.episodes], dtype=np.int64)
        counts = np.maximum(0, -(-(lengths - history - horizon + 1) // stride))
        if counts.sum() == 0:
            raise ValueError(
                f"no episode has the {history + horizon} frames of a window (of {len(self.episodes)} episodes)"
            )
        place = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        self.index = np.column_stack([np.repeat(self.episodes, counts), history - 1 + stride * place])
        self._garment = {garment: i for i, garment in enumerate(self.dataset.garments)}
        self._kept: OrderedDict[int, _Episode] = OrderedDict()
        self._memory, self._bytes = memory, 0

    def __len__(self) -> int:
        return len(self.index)

    def __repr__(self) -> str:
        return f"WindowDataset({len(self)} windows of {len(self.episodes)} episodes, labels {self.labels!r})"

    def __getitem__(self, i: int) -> dict[str, torch.Tensor]:
        """Return window `i` as a dict of tensors."""
        number, frame = (int(value) for value in self.index[i])
        episode = self._episode(number)
        past = slice(frame - self.history + 1, frame + 1)
        future = slice(frame + 1, frame + self.horizon + 1)
        parts: dict[str, Any] = {
            "clouds": episode.clouds[past] * _UNIT,
            "grippers": episode.grippers[past] * _UNIT,
            "held": episode.held[past].copy(),
            "actions": episode.actions[future] * _UNIT,
            "actions_held": episode.held[future].copy(),
            **self._states(episode, past, future),
            "episode": np.int64(number),
            "frame": np.int64(frame),
            "garment": np.int64(self._garment[self.dataset.group.records[number].garment]),
        }
        return {name: torch.as_tensor(part) for name, part in parts.items()}

    def truth(self, i: int) -> Truth:
        """Return where the true loops are in window `i`."""
        number, frame = (int(value) for value in self.index[i])
        document = self.dataset.document(number)
        stored = decode(self.dataset.group, document, ("points", "loops"))
        points = unpack(stored["points"])
        loops = [points[:, row[:length]] for row, length in zip(stored["loops"], document["loops"], strict=True)]
        return Truth(
            tuple(loop[frame + 1 : frame + self.horizon + 1] for loop in loops),
            tuple(loop[frame - self.history + 1 : frame + 1] for loop in loops),
            document["task"],
            document["success"],
        )

    def load(self) -> WindowDataset:
        """Decode the episodes now, as many as `memory` lets; processes forked later share them."""
        for number in self.episodes:
            if self._bytes >= self._memory:
                break
            self._episode(int(number))
        return self

    def _states(self, episode: _Episode, past: slice, future: slice) -> dict[str, Any]:
        """The labels of the two spans, by identity, and what else was seen of the first."""
        order = self._identities(episode.tracked, past, future)
        parts = _by_identity(episode.tracked, order, slice(past.start, future.stop))
        h = past.stop - past.start
        seen = {}
        if episode.seen is not None:
            seen = _by_identity(episode.seen, self._identities(episode.seen, past, slice(0, 0)), past)
        return {
            **{name: part[h:] for name, part in parts.items()},
            **{f"past_{name}": part[:h] for name, part in parts.items()},
            **{f"seen_{name}": part for name, part in seen.items()},
        }

    def _identities(self, tracked: _Tracked, past: slice, future: slice) -> NDArray[np.int64]:
        """(S,) who has which slot; -2 for nobody."""
        ids = tracked.ids[past]
        alive = ids >= 0
        lifetime = tracked.numbers[past][..., 1] - tracked.numbers[past][..., 0]
        known, where = np.unique(ids[alive], return_inverse=True)
        order = known[np.argsort(-np.bincount(where, lifetime[alive], len(known)), kind="stable")]
        if len(order) < self.slots:
            later, first = np.unique(
                tracked.ids[future], return_index=True
            )  # first: in order of frames, then of lifetime
            later = later[np.argsort(first)]
            order = np.concatenate([order, later[(later >= 0) & ~np.isin(later, known)]])
        filled = np.full(self.slots, -2, dtype=np.int64)
        filled[: len(order[: self.slots])] = order[: self.slots]
        return filled

    def _episode(self, number: int) -> _Episode:
        kept = self._kept.get(number)
        if kept is not None:
            self._kept.move_to_end(number)
            return kept
        made = self._decode(number)
        self._kept[number] = made
        self._bytes += made.nbytes
        while self._bytes > self._memory and len(self._kept) > 1:
            self._bytes -= self._kept.popitem(last=False)[1].nbytes
        return made

    def _decode(self, number: int) -> _Episode:
        group = self.dataset.group
        stored = decode(group, group.document(number), ("points", "observed", "actions", "grippers", "held"))
        points, seen = stored["points"], stored["observed"]
        take = np.arange(self.n_points) % seen.shape[1]
        row = np.arange(len(points))[:, None]

        def tracked(name: str) -> _Tracked:
            labels, cloud = self.dataset.labels(name), points
            if labels.manifest["observation"] != "full":
                some = seen[:, : labels.manifest["n_points"]]
                cloud = some if seen.ndim == 3 else points[row, some]
            return _Tracked.of(decode(labels, labels.document(number), ("id", "simplices", "values")), cloud)

        return _Episode(
            seen[:, take] if seen.ndim == 3 else points[row, seen[:, take]],
            stored["grippers"],
            stored["actions"],
            stored["held"].astype(bool),
            tracked(self.labels),
            None if self.seen_labels is None else tracked(self.seen_labels),
        )

    def __getstate__(self) -> dict[str, Any]:
        """Processes that are spawned decode for themselves: what was decoded here is not sent to them."""
        return {**vars(self), "_kept": OrderedDict(), "_bytes": 0}


def _by_identity(tracked: _Tracked, order: NDArray[np.int64], span: slice) -> dict[str, NDArray[Any]]:
    """The states of some frames in slots; zeros where a loop is not there."""
    ids = tracked.ids[span]  # (T, S')
    match = ids[:, None, :] == order[None, :, None]  # (T, S, S')
    present, place = match.any(axis=2), match.argmax(axis=2)
    row = np.arange(len(ids))[:, None]
    numbers = np.where(present[..., None], tracked.numbers[span][row, place], 0)
    return {
        "triangles": tracked.triangles[span][row, place] * (_UNIT * present[..., None, None, None]),
        "values": np.where(present[..., None], tracked.values[span][row, place], 0),
        "present": present,
        **{name: numbers[..., i] for i, name in enumerate(("birth", "death", "step"))},
    }


def _triangles(simplices: NDArray[Any], numbers: Array, cloud: NDArray[np.int16]) -> tuple[NDArray[np.int16], Array]:
    """(T, S, 6, 3, 3) triangles and (T, S, 6) filtration values of labels: killers, then neighbours."""
    frames, slots = simplices.shape[:2]
    killers = simplices[..., SIMPLICES["killer_triangles"]].reshape(frames, slots, 2, 3)
    neighbours = simplices[..., SIMPLICES["neighbours"]].reshape(frames, slots, 4, 3)
    absent = neighbours[..., :1] == ABSENT
    ids = np.concatenate([killers, np.where(absent, killers[:, :, :1], neighbours)], axis=2)  # (T, S, 6, 3)
    there = np.where(absent[..., 0], 0, numbers[..., 3:7])
    values = np.concatenate([numbers[..., [1, 1]], there], axis=2)
    return cloud[np.arange(frames)[:, None, None, None], ids], values
