"""The windows of a condition: which, what is seen of them, where their true loops are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topokit.data import Dataset, WindowDataset
from topokit.data._label import TRACKER, arrays_of
from topokit.data._layout import pack, unpack
from topokit.data._windows import _Episode, _Tracked
from topokit.seqph import track

from ._accuracy import TrueCurves
from ._config import Clouds
from ._tracking import true_loops

__all__ = ["SpoiltWindows", "choose", "spoil", "true_curves"]

LOOPS = 8  # kept of a frame, as in labels


def choose(windows: WindowDataset, most: int) -> NDArray[np.int64]:
    """At most so many windows of each garment, spread evenly over its episodes and their frames; places in `windows`."""
    garment = [windows.dataset.group.records[int(i)].garment for i in windows.index[:, 0]]
    chosen = []
    for name in sorted(set(garment)):
        rows = np.flatnonzero([g == name for g in garment])
        chosen.append(rows[np.unique(np.linspace(0, len(rows) - 1, min(most, len(rows))).round().astype(int))])
    return np.sort(np.concatenate(chosen))


def true_curves(windows: WindowDataset, rows: Sequence[int], steps: Sequence[int]) -> list[TrueCurves]:
    """The true loops of windows at some steps: which are there, and where."""
    found = []
    for number, frame in windows.index[np.asarray(rows)].tolist():
        whole, at = _true_curves(windows.dataset.group.url, number), frame + np.array(steps)
        parts = (whole.curves, whole.closing, whole.present)
        found.append(TrueCurves(*(tuple(part[at] for part in each) for each in parts)))
    return found


@cache  # conditions share their episodes; a few hundred, half a second and a megabyte each
def _true_curves(url: str, number: int) -> TrueCurves:
    """The true loops of an episode, at all its frames."""
    dataset = Dataset(url)
    stored = dataset.arrays(number, "points", "loops")
    points = unpack(stored["points"]).astype(np.float64)
    lengths = dataset.document(number)["loops"]
    loops = [row[:length].astype(np.int64) for row, length in zip(stored["loops"], lengths, strict=True)]
    frames, row = true_loops(points, loops), np.arange(len(points))[:, None]
    killers = np.array([frame.killers for frame in frames])  # (T, loops, 2)
    return TrueCurves(
        tuple(points[:, loop] for loop in loops),
        tuple(points[row, killers[:, loop]] for loop in range(len(loops))),
        tuple(np.array([frame.present for frame in frames]).T),
    )


def spoil(clouds: NDArray[np.floating], how: Clouds, rng: np.random.Generator) -> NDArray[np.float64]:
    """(T, m, 3) clouds (T, P, 3) with fewer points, noise and outliers, every frame for itself."""
    frames, points = clouds.shape[:2]
    left = max(4, round(how.keep * points))
    kept = np.sort(rng.permuted(np.tile(np.arange(points), (frames, 1)), axis=1)[:, :left], axis=1)
    seen = np.take_along_axis(np.asarray(clouds, dtype=np.float64), kept[..., None], axis=1)
    seen += rng.normal(0, how.noise, seen.shape)
    wild = rng.permuted(np.tile(np.arange(left) < round(how.outliers * left), (frames, 1)), axis=1)
    low, high = clouds.min(axis=1, keepdims=True) - 0.1, clouds.max(axis=1, keepdims=True) + 0.1
    return np.where(wild[..., None], rng.uniform(low, high, seen.shape), seen)


class SpoiltWindows(WindowDataset):
    """Windows whose clouds were spoilt, and whose states are what seqPH tracks on them, from the episode's first frame on.

    So a baseline that starts from tracked states sees no more than a network does: `n_points` points, spoilt.
    """

    def __init__(self, *arguments: Any, how: Clouds, seed: int, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._how, self._seed = how, seed

    def _decode(self, number: int) -> _Episode:
        episode = super()._decode(number)
        clouds = unpack(episode.clouds[:, : min(self.n_points, self.dataset.group.records[number].observed)])
        seen = pack("clouds", spoil(clouds, self._how, np.random.default_rng((self._seed, number))))
        found = arrays_of(track(unpack(seen), n_jobs=1, **TRACKER), LOOPS)
        return replace(
            episode, clouds=seen[:, np.arange(self.n_points) % seen.shape[1]], tracked=_Tracked.of(found, seen)
        )
