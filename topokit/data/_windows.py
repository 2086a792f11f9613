"""Windows for training: 16 clouds of the past, 60 planned actions and the states that followed.

Source: Antonova et al. 2021, section 5 (h = 16, k = 60). Taught in chapter 11.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from topokit._validate import whole
from topokit.io import ABSENT, HISTORY, HORIZON, TICKS, Episode, as_metres, as_ticks, state_arrays
from topokit.sampling import farthest_point_sample
from topokit.seqph import track

from ._dataset import Dataset

Array = NDArray[np.float32]
Ticks = NDArray[np.signedinteger[Any]]


@dataclass(frozen=True, eq=False)
class _Film:
    """An episode from which windows are cut: places as integers in units of 0.1 mm, values in metres."""

    clouds: Ticks  # (T, P, 3)
    grippers: Ticks  # (T, 2, 3)
    actions: Ticks
    held: NDArray[np.bool_]  # (T,)
    ids: NDArray[np.int32]  # (T, S') identities of the tracked loops, -1 where there is none
    lifetimes: Array  # (T, S')
    states: dict[str, NDArray[Any]]  # of the loops, (T, S' + 1, ...) each, 0 in the last slot
    places: dict[int, NDArray[np.int64]] = field(default_factory=dict)  # of loops, by frame; filled when asked for


class WindowDataset(torch.utils.data.Dataset[dict[str, torch.Tensor]]):
    """All windows of some episodes, in the order of episodes and frames; a `torch.utils.data.Dataset`.

    An item is a dict of tensors: observations and plan at frame t, and the states that followed. There are h frames of
    history, k frames of horizon, P points and S slots; lengths are in metres:

    =================  =================  ==================================================================================
    ``clouds``         (h, P, 3)          observations of the frames t-h+1..t
    ``grippers``       (h, 2, 3)          places of the grippers in these frames
    ``held``           (h,) bool          True where they held the garment
    ``actions``        (k, 2, 3)          planned places of the grippers at t+1..t+k
    ``actions_held``   (k,) bool          True where they shall hold it
    ``triangles``      (k, S, 6, 3, 3)    the two killer triangles, thick first, then four neighbours; one that is absent
                                          repeats the thick killer triangle
    ``values``         (k, S, 6)          their filtration values, 0 where absent
    ``birth, death``   (k, S)             filtration values of birth and death
    ``killer_shift``   (k, S)             Hausdorff distance to the previous appearance, 0 where new
    ``present``        (k, S) bool        where it is False, all of the above are 0
    ``past_...``       (h, S, ...)        the same six for the history
    ``episode``        int64              number of the episode
    ``frame``          int64              number t of the frame
    ``garment``        int64              index in `Dataset.garments`
    =================  =================  ==================================================================================

    A slot is one identity through the whole window. First come the loops that are alive in the history, the longest lifetime
    on average over its frames first (0 where absent). Then come loops that appear later, in order of appearance. Loops after
    the first S have no slot.

    Parameters
    ----------
    dataset : Dataset or path
    episodes : iterable of int, optional
        Numbers of the episodes, such as one part of `Dataset.split`; all labelled ones when not given.
    labels : str
        Name of the set of labels.
    history, horizon : int
        Numbers of frames h and k.
    n_points : int
        Number P of points of the observation: a farthest-point sample, from the point farthest from its mean on, so that the
        order of the mesh has no effect. The points of a smaller observation are repeated.
    slots : int
        Number S of slots.
    stride : int
        Frames from one window of an episode to the next.
    observe : callable, optional
        Function that replaces the clouds of an episode: from its number and its clouds, (T, P, 3) float64, to clouds
        (T, P', 3), in metres. All states, past and future, are then tracked by seqPH on the new clouds, from the first
        frame on, as for labels. The labels then only determine the list of episodes.
    """

    def __init__(
        self,
        dataset: Dataset | str | Path,
        episodes: Iterable[int] | None = None,
        *,
        labels: str = "full",
        history: int = HISTORY,
        horizon: int = HORIZON,
        n_points: int = 128,
        slots: int = 4,
        stride: int = 1,
        observe: Callable[[int, NDArray[np.float64]], NDArray[np.float64]] | None = None,
    ) -> None:
        sizes = {"history": history, "horizon": horizon, "n_points": n_points, "slots": slots, "stride": stride}
        history, horizon, n_points, slots, stride = (whole(value, name, 1) for name, value in sizes.items())
        self.dataset = dataset if isinstance(dataset, Dataset) else Dataset(dataset)
        self.labels = labels
        self.observe = observe
        self.history = history
        self.horizon = horizon
        self.n_points = n_points
        self.slots = slots
        self._films: dict[int, _Film] = {}

        # The episodes, all of which must have labels.
        labelled = self.dataset.labelled(labels)
        self.episodes = labelled if episodes is None else np.unique(np.array([*episodes], dtype=np.int64))
        missing = np.setdiff1d(self.episodes, labelled)
        if len(missing):
            lacking = f"{len(missing)} episodes have no labels {labels!r}, the first is {missing[0]}"
            raise ValueError(f"{lacking}: topokit.data.label_dataset makes them")

        # The windows: a frame t of an episode that has enough frames before and after it.
        lengths = [self.dataset.record(i).frames for i in self.episodes]
        spans = [range(history - 1, length - horizon, stride) for length in lengths]
        counts = [len(span) for span in spans]
        if not any(counts):
            raise ValueError(f"no episode has the {history + horizon} frames of a window (of {len(lengths)} episodes)")
        frames = np.concatenate([np.arange(span.start, span.stop, span.step) for span in spans])
        self.index = np.column_stack([np.repeat(self.episodes, counts), frames])

    def __len__(self) -> int:
        return len(self.index)

    def __repr__(self) -> str:
        return f"WindowDataset({len(self)} windows of {len(self.episodes)} episodes, labels {self.labels!r})"

    def __getitem__(self, i: int) -> dict[str, torch.Tensor]:
        """Return window `i` as a dict of tensors."""
        window = self._window(*self.index[i].tolist())
        for name, part in window.items():
            if part.dtype.kind == "i" and part.ndim:  # places
                window[name] = part.astype(np.float32) * np.float32(1 / TICKS)
        return {name: torch.from_numpy(part) for name, part in window.items()}

    def _window(self, number: int, frame: int) -> dict[str, NDArray[Any]]:
        """Return the parts of a window, places in units of 0.1 mm."""
        film = self._film(number)
        frames = np.arange(frame - self.history + 1, frame + self.horizon + 1)
        past, future = np.split(frames, [self.history])
        if frame not in film.places:
            film.places[frame] = self._places(film, past, future)
        states = {name: part[frames[:, None], film.places[frame]] for name, part in film.states.items()}
        return {
            "clouds": film.clouds[past],
            "grippers": film.grippers[past],
            "actions": film.actions[future],
            "held": film.held[past],
            "actions_held": film.held[future],
            **{name: part[self.history :] for name, part in states.items()},
            **{f"past_{name}": part[: self.history] for name, part in states.items()},
            "episode": np.array(number),
            "frame": np.array(frame),
            "garment": np.array(self.dataset.garments.index(self.dataset.record(number).garment)),
        }

    def true_loops(self, i: int) -> tuple[Array, ...]:
        """Return the vertices of every true loop in the frames t+1..t+k of window `i`, (k, L, 3) metres each."""
        number, frame = self.index[i].tolist()
        episode = self.dataset[number]
        ahead = slice(frame + 1, frame + self.horizon + 1)
        return tuple(episode.points[ahead, loop] for loop in episode.loops)

    def seen(self, number: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the clouds (T, P, 3) on which the states of an episode were tracked, and its target's centre line, (L, 3)."""
        episode = self.dataset[number]
        clouds = as_metres(self._tracked_clouds(episode, number))
        return clouds.astype(np.float64), episode.centre_line.astype(np.float64)

    def __getstate__(self) -> dict[str, Any]:
        """Return what a spawned process gets: all but the decoded episodes."""
        return {**vars(self), "_films": {}}

    def load(self) -> WindowDataset:
        """Decode all episodes now; processes forked later share them."""
        for number in self.episodes.tolist():
            self._film(number)
        return self

    def select(self, rows: ArrayLike) -> WindowDataset:
        """Return the windows of these rows of `index` alone, in their order; decoded episodes are shared."""
        chosen = copy.copy(self)
        chosen._films = self._films
        chosen.index = self.index[np.asarray(rows, dtype=np.int64)]
        chosen.episodes = np.unique(chosen.index[:, 0])
        return chosen

    def _places(self, film: _Film, past: NDArray[np.int64], future: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return where the loop of each slot is among those of each frame of a window, (h + k, S); -1 where it is absent."""
        # The loops of the history, the longest total lifetime first.
        alive = film.ids[past] >= 0
        known, position = np.unique(film.ids[past][alive], return_inverse=True)
        total = np.bincount(position, film.lifetimes[past][alive], len(known))
        known_first = known[np.argsort(-total, kind="stable")]

        # Then those that appear later, in the order of frames, and within a frame of lifetime.
        later, first = np.unique(film.ids[future], return_index=True)
        later = later[np.argsort(first)]
        newcomers = later[(later >= 0) & ~np.isin(later, known)]
        order = np.concatenate([known_first, newcomers, np.full(self.slots, -2)])[: self.slots]
        match = film.ids[np.concatenate([past, future]), None, :] == order[None, :, None]  # (h + k, S, S')
        return np.where(match.any(axis=2), match.argmax(axis=2), -1)

    def _film(self, number: int) -> _Film:
        """Return an episode as windows are cut from it, decoded when it is needed first."""
        if number in self._films:
            return self._films[number]
        episode = self.dataset[number]
        tracked = self._tracked_clouds(episode, number)
        clouds = tracked
        if self.observe is None:
            clouds = self._sampled(episode)
            arrays = self.dataset.labels(self.labels).arrays(number, tracked)
        else:
            arrays = state_arrays(track(as_metres(tracked), n_jobs=1))

        # Labels are stored in single precision, so states that were tracked just now are rounded likewise.
        ids = arrays["id"]
        numbers = np.asarray(arrays["values"], np.float32)
        birth, death, killer_shift = np.moveaxis(np.nan_to_num(numbers[..., :3], nan=0.0), -1, 0)
        killers = arrays["simplices"][..., 4:10].reshape(*ids.shape, 2, 3)
        neighbours = arrays["simplices"][..., 10:].reshape(*ids.shape, 4, 3)

        # A neighbour that is absent repeats the thick killer triangle, with the value 0.
        absent = neighbours[..., :1] == ABSENT
        corners = np.concatenate([killers, np.where(absent, killers[:, :, :1], neighbours)], axis=2)  # (T, S', 6, 3)
        states = {
            "triangles": tracked[np.arange(len(ids))[:, None, None, None], corners],
            "values": np.concatenate([numbers[..., [1, 1]], np.where(absent[..., 0], 0, numbers[..., 3:7])], axis=2),
            "present": ids >= 0,
            "birth": birth,
            "death": death,
            "killer_shift": killer_shift,
        }
        self._films[number] = _Film(
            clouds=clouds[:, np.arange(self.n_points) % clouds.shape[1]],
            grippers=as_ticks(episode.grippers),
            actions=as_ticks(episode.actions),
            held=episode.held,
            ids=ids,
            lifetimes=death - birth,
            states={name: np.append(part, np.zeros_like(part[:, :1]), axis=1) for name, part in states.items()},
        )
        return self._films[number]

    def _tracked_clouds(self, episode: Episode, number: int) -> Ticks:
        """Return the clouds (T, n, 3) on which the states of an episode were tracked."""
        if self.observe is None:
            return as_ticks(self.dataset.labels(self.labels).cloud(episode))
        clouds = as_metres(self._sampled(episode)).astype(np.float64)
        return as_ticks(self.observe(number, clouds), "clouds")

    def _sampled(self, episode: Episode) -> Ticks:
        """Return points of the observation (T, P', 3), P' <= P."""
        clouds = as_ticks(episode.observed)
        few = min(self.n_points, clouds.shape[1])
        return np.array([cloud[farthest_point_sample(cloud, few, None)[0]] for cloud in clouds])
