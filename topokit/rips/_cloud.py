"""A cloud as the kernel reads it, and the way from there to births, deaths and simplices."""

from __future__ import annotations

import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._validate import as_points

MEMORY = 4 << 30  # bytes that the tables for one cloud may take
_PATIENCE = 3.0  # seconds of compiling before it is said
_ready: set[tuple[int, ...]] = set()
_compiling = threading.Lock()
_kept = threading.local()  # each thread's room for edges, kept from one cloud to the next

Ids = NDArray[np.int64]
Pairs = tuple[Ids, Ids, NDArray[np.float64], NDArray[np.float64], Ids]


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points or distances. Squared lengths order edges of points: roots may hide a difference.

    A power of two saves squares from overflow and underflow, and costs no digit.
    """

    data: NDArray[np.float64]  # (n, 3) coordinates times `scale`; or (n, n) distances
    axes: tuple[int, ...]  # three zeros; none for distances, as which more than three dimensions are read
    scale: float

    @classmethod
    def of(cls, points: ArrayLike, metric: str = "euclidean") -> Cloud:
        """Check and copy (n, d) coordinates, or with ``metric="precomputed"`` the (n, n) distances."""
        if metric not in ("euclidean", "precomputed"):
            raise ValueError(f'metric must be "euclidean" or "precomputed", not {metric!r}')
        array = as_points(points)
        if metric == "precomputed":
            _check_distances(array)
            return cls(array.copy(), (), 1.0)
        exponent = int(np.frexp(np.abs(array).max(initial=0.0))[1])
        scale = 2.0 ** -min(max(exponent, -1000), 1000)
        if array.shape[1] <= 3:
            data = np.zeros((len(array), 3))
            data[:, : array.shape[1]] = array * scale
            return cls(data, (0, 0, 0), scale)
        size = 8 * len(array) ** 2
        if size > MEMORY:
            raise _too_large(len(array), f"{size / 1e9:.1f} GB for distances in {array.shape[1]} dimensions")
        from scipy.spatial.distance import pdist, squareform  # SciPy takes a while to import

        distances = pdist(array * scale)
        distances /= scale  # in place and once for each two points
        return cls(squareform(distances), (), 1.0)

    def __len__(self) -> int:
        return len(self.data)

    def keys(self, i: int | NDArray[np.int64], j: NDArray[np.int64] | slice) -> NDArray[np.float64]:
        """What orders edges from i to j: distances of a matrix, squared lengths times `scale` twice for points."""
        return squares(self.data[i], self.data[j]) if self.axes else self.data[i, j]

    def lengths(self, i: int | NDArray[np.int64], j: NDArray[np.int64] | slice) -> NDArray[np.float64]:
        """Lengths of edges from i to j, in the unit of the points."""
        return np.asarray(np.sqrt(self.keys(i, j)) / self.scale if self.axes else self.keys(i, j))

    def key_of(self, length: float) -> float:
        """What an edge of a length has for a key, in floating point rather too much than too little."""
        scaled = length * self.scale * (1 + 1e-15)
        return scaled * scaled if self.axes else scaled


def squares(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """Squared distances of points, summed axis by axis as the kernels do; NumPy's `sum` pairs the terms."""
    total = np.zeros(np.broadcast_shapes(one.shape, other.shape)[:-1])
    for axis in range(one.shape[-1]):
        total += (one[..., axis] - other[..., axis]) ** 2
    return total


def _check_distances(matrix: NDArray[np.float64]) -> None:
    """Raise ValueError when the matrix cannot be one of distances; the message names the entry."""
    if matrix.shape[0] != matrix.shape[1]:
        raise ValueError(f"the matrix of distances must be square, not of shape {matrix.shape}")
    for wrong, what in (
        (matrix < 0, "negative"),
        (matrix != matrix.T, "not symmetric"),
        (np.diag(np.diag(matrix) != 0), "not zero on the diagonal"),
    ):
        if wrong.any():
            i, j = np.argwhere(wrong)[0].tolist()
            raise ValueError(f"the matrix of distances is {what} at [{i}, {j}]: {matrix[i, j]} and {matrix[j, i]}")


class Film:
    """What the kernel remembers of a cloud for the next one, when they differ little."""

    before: Any = None


def pairs(clouds: Sequence[Cloud], max_radius: float, film: Film | None = None) -> Pairs:
    """Creating edges (c, 2), killer edges with their two apexes (c, 4), births and deaths (c,), and whose they are.

    A matrix comes alone.
    """
    found = _within_memory(clouds, [cloud.key_of(2 * max_radius) for cloud in clouds], film or Film())
    created, killed = (np.concatenate(parts) for parts in zip(*found, strict=True))
    number = np.repeat(np.arange(len(clouds)), [len(some) for some, _ in found])
    starts = np.cumsum([0, *map(len, clouds)])[number]
    whole = Cloud(np.concatenate([cloud.data for cloud in clouds]), clouds[0].axes, 1.0)
    scale = np.array([cloud.scale for cloud in clouds])[number]
    birth, death = (whole.lengths(ends[:, 0] + starts, ends[:, 1] + starts) / scale / 2 for ends in (created, killed))
    death[(killed[:, 0] < 0) | (death > max_radius)] = np.inf
    killed[np.isinf(death)] = -1
    inside = birth <= max_radius
    return created[inside], killed[inside], birth[inside], death[inside], number[inside]


def _within_memory(clouds: Sequence[Cloud], max_lengths: Sequence[float], film: Film) -> list[tuple[Ids, Ids]]:
    if max(map(len, clouds)) < 4:
        return [(np.empty((0, 2), np.int64), np.empty((0, 4), np.int64)) for _ in clouds]
    try:
        _compile(clouds[0].axes)
        return _run(clouds, max_lengths, film)
    except MemoryError as error:
        raise _too_large(max(map(len, clouds)), str(error)) from error


def _too_large(n: int, what: str) -> MemoryError:
    return MemoryError(
        f"persistence may take {MEMORY / 1e9:.1f} GB for one cloud, and these {n} points need {what}; "
        "take a subset (topokit.farthest_point_sample)"
    )


def _run(clouds: Sequence[Cloud], max_lengths: Sequence[float], film: Film) -> list[tuple[Ids, Ids]]:
    from ._edges import EDGE_BYTES, WINDOW, new_room  # numba takes a while to import
    from ._stack import nothing_before, pair_clouds, pair_matrix

    most, axes = max(map(len, clouds)), clouds[0].axes
    bits = most * ((most + 63) // 64) * 8
    if bits > MEMORY:
        raise MemoryError(f"{bits / 1e9:.1f} GB for a bit for each pair of points")
    spare = MEMORY - bits
    room = getattr(_kept, "room", None)
    if room is None or EDGE_BYTES * len(room[0]) > spare // 2:
        room = tuple(new_room(min(1 << 16, spare // (2 * EDGE_BYTES))))
    if axes:
        data, ends = np.concatenate([cloud.data for cloud in clouds]), np.cumsum([0, *map(len, clouds)])
        before = nothing_before(axes) if film.before is None else film.before
        film.before, room, created, killed, counts = pair_clouds(
            data, axes, ends, np.array(max_lengths), before, room, spare
        )
    else:
        room, created, killed = pair_matrix(clouds[0].data, axes, (0, 0, 0), max_lengths[0], room, spare)
        counts = np.array([len(created)])
    _kept.room = room if len(room[0]) <= WINDOW else None
    created.sort()
    killed[:, :2].sort()
    ends = np.cumsum([0, *np.maximum(counts, 0)]).tolist()
    found = [(created[a:b], killed[a:b]) for a, b in pairwise(ends)]
    for c in np.flatnonzero(counts < 0).tolist():
        found[c] = _run_once(clouds[c], max_lengths[c])
    return found


def _run_once(cloud: Cloud, max_length: float) -> tuple[Ids, Ids]:
    """Repeated points count once: edges of a second copy are cones over the first, and that between them closes nothing."""
    first = np.sort(np.unique(cloud.data + 0.0, axis=0, return_index=True)[1])
    [(created, killed)] = _run([Cloud(cloud.data[first], cloud.axes, cloud.scale)], [max_length], Film())
    once = np.append(first, -1)
    return once[created], once[killed]


def _compile(axes: tuple[int, ...]) -> None:
    """Compile the kernel for points of a dimension (none: a matrix) on a tiny cloud, or load it; once a process."""
    with _compiling:
        if axes in _ready:
            return
        what = "points in space" if axes else "matrices of distances"
        message = f"topokit: compiling the persistence kernel for {what} (once; kept for the next time)"
        notice = threading.Timer(_PATIENCE, print, [message], {"file": sys.stderr, "flush": True})
        notice.start()
        try:
            _run([Cloud(np.eye(4, len(axes) or 4), axes, 1.0)], [1.0], Film())
        finally:
            notice.cancel()
        _ready.add(axes)
