"""A cloud as the kernel reads it, and the way from there to births, deaths and simplices."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Sequence
from concurrent import futures
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._validate import Ids, as_points

MEMORY = 4 << 30  # bytes that the tables for one cloud may take
TIME = 300.0  # seconds that one cloud may take, unless more are allowed
_ESTIMATED = 1 << 14  # points from which on the seconds are estimated; an eighth of a matrix, with its many loops
WATCHED = 2000  # points that can take a second, as a quarter can of a matrix
_SMALLEST = 2.0**-1022  # of the numbers with all their digits
_TINY = 2.0**-450  # of the largest coordinate: squares of larger differences have all their digits
_PATIENCE = 3.0  # seconds of compiling before it is said
_ready: set[tuple[tuple[int, ...], bool]] = set()
_compiling = threading.Lock()
_kept = threading.local()  # each thread's room for edges, kept from one cloud to the next, and what ends its work

Pairs = tuple[Ids, Ids, NDArray[np.float64], NDArray[np.float64]]


class TooLargeError(MemoryError, ValueError):
    """A cloud that takes more memory or time than it may."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points or distances. Squared lengths order edges of points: roots may hide a difference.

    A power of two brings all of them to at most 1, saves squares from overflow and underflow, and costs no digit.
    """

    data: NDArray[np.float64]  # (n, 3) coordinates times `scale`; or (n, n) distances times `scale`
    axes: tuple[int, ...]  # three zeros; none for distances, as which more than three dimensions are read
    scale: float

    @classmethod
    def of(cls, points: ArrayLike, metric: str = "euclidean") -> Cloud:
        """Check and copy (n, d) coordinates, or with ``metric="precomputed"`` the (n, n) distances."""
        if metric not in ("euclidean", "precomputed"):
            raise ValueError(f'metric must be "euclidean" or "precomputed", not {metric!r}')
        array = as_points(points, refuse_transposed=metric == "euclidean")
        if metric == "precomputed":
            _check_distances(array)
        sizes = array if metric == "precomputed" else np.abs(array)
        largest = sizes.max(initial=0.0)
        scale = 2.0 ** -max(int(np.frexp(largest)[1]), -1022)
        scaled = array * scale
        if metric == "precomputed":
            if scale < 1 and np.count_nonzero(scaled < _SMALLEST) > np.count_nonzero(array == 0):
                least = array[array > 0].min()
                what = f"the matrix of distances holds {least:.3g} and {largest:.3g}"
                why = "beside the one the other cannot be told from 0"
                raise ValueError(f"{what}: {why}; give distances so small as 0")
            return cls(scaled, (), scale)
        if largest > 1e307 and np.linalg.norm(np.ptp(array / 4, axis=0) / 2**1000) > 2**23:
            raise ValueError(f"points reach {largest:.3g}, and half their distances overflow; divide them by ten")
        tiny = sizes < _TINY * largest
        if np.count_nonzero(tiny) and (array[tiny] != 0).any():
            _check_near(array, tiny)
        if array.shape[1] <= 3:
            return cls(np.hstack([scaled, np.zeros((len(array), 3 - array.shape[1]))]), (0, 0, 0), scale)
        size = 8 * len(array) ** 2
        if size > MEMORY:
            raise _too_large(len(array), f"{size / 1e9:.1f} GB for distances in {array.shape[1]} dimensions")
        from scipy.spatial.distance import pdist, squareform  # SciPy takes a while to import

        return cls(squareform(pdist(scaled)), (), scale)

    def __len__(self) -> int:
        return len(self.data)

    def keys(self, i: int | NDArray[np.int64], j: NDArray[np.int64] | slice) -> NDArray[np.float64]:
        """What orders edges from i to j: distances of a matrix, squared lengths of points; in scaled units."""
        return squares(self.data[i], self.data[j]) if self.axes else self.data[i, j]

    def radii(self, i: int | NDArray[np.int64], j: NDArray[np.int64] | slice) -> NDArray[np.float64]:
        """Half the lengths of edges from i to j, times `scale`: tiny ones would lose digits in the unit of the points."""
        keys = self.keys(i, j)
        return np.asarray(np.sqrt(keys) if self.axes else keys) / 2

    def key_of(self, radius: float) -> float:
        """What an edge of a scaled radius has for a key, in floating point rather too much than too little."""
        length = 2 * radius * (1 + 1e-15)
        return length * length if self.axes else length


def squares(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """Squared distances of points, summed axis by axis as the kernels do; NumPy's `sum` pairs the terms."""
    terms = (one - other) ** 2
    return np.asarray(sum(terms[..., axis] for axis in range(terms.shape[-1])))


def _check_near(array: NDArray[np.float64], tiny: NDArray[np.bool_]) -> None:
    """Raise ValueError when two points differ in tiny coordinates alone: the square of their distance may be 0."""
    coarse = np.where(tiny, 0.0, array)
    _, first, place = np.unique(coarse, axis=0, return_index=True, return_inverse=True)
    same = first[place.ravel()]
    rows = np.flatnonzero((array != array[same]).any(axis=1))
    if len(rows):
        near = f"points[{same[rows[0]]}] and points[{rows[0]}] are nearer to each other than 1e-135"
        cure = "round the coordinates, np.round(points, 100) for example"
        raise ValueError(f"{near} of the cloud's extent, which floating point cannot tell from 0 in a square: {cure}")


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


def pairs(cloud: Cloud, max_radius: float, time_limit: float = TIME) -> Pairs:
    """Creating edges (c, 2), killer edges with their two apexes (c, 4), births and deaths (c,); radii in scaled units."""
    if len(cloud) < 4 or (cloud.axes and not cloud.data[:, 1:].any()):  # on a line
        return np.empty((0, 2), np.int64), np.empty((0, 4), np.int64), np.empty(0), np.empty(0)
    _compile(cloud.axes)
    return _within(cloud, *_run(cloud, cloud.key_of(max_radius), time_limit), max_radius)[:4]


def pairs_of_many(clouds: Sequence[Cloud], max_radius: float, film: list[Any]) -> list[Pairs]:
    """What `pairs` finds in each cloud, up to a radius in the unit of the points: short ones in space in one compiled call."""
    axes, lengths, bounds = clouds[0].axes, [*map(len, clouds)], [max_radius * cloud.scale for cloud in clouds]
    if not axes or not 4 <= max(lengths) < WATCHED:
        return [*map(pairs, clouds, bounds)]
    _compile(axes, stack=True)
    stack, starts = Cloud(np.concatenate([cloud.data for cloud in clouds]), axes, 1.0), np.cumsum([0, *lengths])
    created, killed, counts = _run_stack(stack, starts, bounds, film)
    number = np.repeat(np.arange(len(clouds)), np.maximum(counts, 0))
    *table, inside = _within(stack, created, killed, np.array(bounds)[number], starts[number, None])
    ends = pairwise(np.searchsorted(number[inside], np.arange(len(clouds) + 1)).tolist())
    found: list[Any] = [[column[a:b] for column in table] for a, b in ends]
    for c in np.flatnonzero(counts < 0).tolist():
        found[c] = pairs(clouds[c], bounds[c])
    return found


def _within(cloud: Cloud, created: Ids, killed: Ids, most: Any, first: Any = 0) -> Any:
    """`Pairs` born by `most`, killed by then or never, and which those are; `first` is added to vertex ids."""
    created.sort()
    killed[:, :2].sort()
    ends = np.stack([created, killed[:, :2]]) + first
    birth, death = cloud.radii(ends[..., 0], ends[..., 1])
    death[(killed[:, 0] < 0) | (death > most)] = np.inf
    killed[np.isinf(death)] = -1
    inside = birth <= most
    return created[inside], killed[inside], birth[inside], death[inside], inside


def _run_stack(stack: Cloud, starts: Ids, bounds: Sequence[float], film: list[Any]) -> Any:
    """Creating edges and killer edges with their apexes, and how many each cloud has: -1 where points are repeated."""
    from ._stack import Before, pair_clouds  # numba takes a while to import
    from ._tree import build_tree

    if not film:
        film.append(Before(build_tree(np.zeros((1, 3)), stack.axes), np.empty(0, np.int64), 0.0, 0.0))
    arguments = (stack.data, stack.axes, starts, np.array([*map(stack.key_of, bounds)]), film[0])
    film[0], *found = _watched(pair_clouds, arguments, int(np.diff(starts).max()), None)
    return found


def _run(cloud: Cloud, max_length: float, time_limit: float | None) -> tuple[Ids, Ids]:
    """Creating edges and killer edges with their apexes; no `time_limit` for what is known to be quick."""
    from ._edges import EDGE_BYTES, WINDOW  # numba takes a while to import
    from ._tree import build_tree, repeats
    from .kernel import pair_edges

    if cloud.axes:
        tree = build_tree(cloud.data, cloud.axes)
        data = tree.points
        if repeats(tree):  # edges of a second copy are cones over the first, and that between them closes nothing
            first = np.sort(np.unique(cloud.data + 0.0, axis=0, return_index=True)[1])
            created, killed = _run(Cloud(cloud.data[first], cloud.axes, cloud.scale), max_length, time_limit)
            once = np.append(first, -1)
            return once[created], once[killed]
    else:
        tree = build_tree(np.zeros((1, 3)), (0, 0, 0))  # in space, for which it is compiled anyway
        tree = tree._replace(label=np.arange(len(cloud)))
        data = cloud.data
    bits = _bits(len(cloud))
    many = len(cloud) >= (_ESTIMATED if cloud.axes else _ESTIMATED // 8)
    if time_limit is not None and (bits > MEMORY or (many and time_limit < np.inf)):
        seconds = _estimate(cloud, max_length, time_limit)
        if bits > MEMORY or seconds > time_limit:
            size = (bits + EDGE_BYTES * WINDOW) / 1e9
            raise _too_large(len(cloud), f"about {seconds / 60:,.1f} minutes and {size:.1f} GB", time_limit)
    arguments = (data, cloud.axes, tree, max_length, -1, 0.0)
    created, killed, _ = _watched(pair_edges, arguments, len(cloud), time_limit)
    label = np.append(tree.label, -1)  # of what is not there
    return label[created], label[killed]


def _watched(kernel: Callable[..., Any], arguments: tuple[Any, ...], n: int, time_limit: float | None) -> Any:
    """What a kernel finds. Where it may take long, it has a thread of its own: this one hears Ctrl-C and the clock."""
    from ._edges import EDGE_BYTES, HALTED, TOO_MANY_EDGES, TOO_MANY_LOOPS, WINDOW, new_room

    spare = MEMORY - _bits(n)
    room, own = getattr(_kept, "room", None), getattr(_kept, "halt", None)
    if room is None or EDGE_BYTES * len(room.found) > spare // 2:
        room = new_room(min(1 << 16, spare // (2 * EDGE_BYTES)))
    arguments = (*arguments, room, spare)
    halt = np.zeros(1, np.int64) if own is None else own
    if own is not None or time_limit is None or n < (WATCHED if arguments[1] else WATCHED // 4):
        room, *found = kernel(*arguments, halt)
        if halt[0] == HALTED:
            raise futures.CancelledError
    else:
        with futures.ThreadPoolExecutor(1) as pool:
            try:
                job = pool.submit(lambda: kernel(*arguments, halt))
                room, *found = job.result(min(time_limit, threading.TIMEOUT_MAX))
            except futures.TimeoutError as error:
                raise _too_large(n, "more", time_limit) from error
            finally:
                halt[0] = halt[0] or HALTED
    for reason, what in ((TOO_MANY_EDGES, "edges of the same length"), (TOO_MANY_LOOPS, "loops, however short")):
        if halt[0] == reason:
            halt[0] = 0
            raise _too_large(n, f"more memory: there are very many {what}", time_limit)
    _kept.room = room if len(room.found) <= WINDOW else None
    return found


def _bits(n: int) -> int:
    """How many bytes a bit for each pair of points takes."""
    return n * ((n + 63) // 64) * 8


def own_halt(halts: list[NDArray[np.int64]]) -> None:
    """Let another thread end what this one computes: `end` with the list that this is put into."""
    _kept.halt = np.zeros(1, np.int64)
    halts.append(_kept.halt)


def end(halts: list[NDArray[np.int64]]) -> None:
    for halt in halts:
        from ._edges import HALTED  # numba takes a while to import

        halt[0] = HALTED


def _estimate(cloud: Cloud, max_length: float, time_limit: float) -> float:
    """About how many seconds a cloud takes, from random parts of it: larger ones for as long as it is not clear."""
    n, size = len(cloud), _ESTIMATED // (32 if cloud.axes else 128)
    rng, most = np.random.default_rng(0), _ESTIMATED // (4 if cloud.axes else 32)
    before = _timed(cloud, rng.choice(n, size, replace=False), max_length)
    while True:
        size *= 2
        took, times = _timed(cloud, rng.choice(n, size, replace=False), max_length), n / size
        if size >= most or took * times**3 < time_limit or took * times**2 > time_limit:
            growth = np.log2(took / before) + 0.3  # many points have caches that are too small against them as well
            return float(took * times ** np.clip(growth, 2, 4))
        before = took


def _timed(cloud: Cloud, ids: NDArray[np.int64], max_length: float) -> float:
    part = cloud.data[ids] if cloud.axes else cloud.data[np.ix_(ids, ids)]
    start = time.thread_time()
    _run(Cloud(part, cloud.axes, cloud.scale), max_length, None)
    return max(time.thread_time() - start, 1e-4)


def _too_large(n: int, what: str, time_limit: float | None = TIME) -> TooLargeError:
    allowed = f"{MEMORY / 1e9:.1f} GB" + ("" if time_limit is None else f" and {time_limit:g} seconds")
    cure = "stop earlier (max_radius), or allow more time (time_limit)"
    needs = f"persistence may take {allowed} for one cloud, and these {n} points need {what}"
    return TooLargeError(f"{needs}; take a subset (topokit.farthest_point_sample), {cure}")


def _compile(axes: tuple[int, ...], stack: bool = False) -> None:
    """Compile the kernel for points of a dimension (none: a matrix) or a stack on a tiny cloud, or load it; once a process."""
    with _compiling:
        if (axes, stack) in _ready:
            return
        what = "several clouds at once" if stack else "points in space" if axes else "matrices of distances"
        message = f"topokit: compiling the persistence kernel for {what} (once; kept for the next time)"
        notice = threading.Timer(_PATIENCE, print, [message], {"file": sys.stderr, "flush": True})
        notice.start()
        try:
            tiny = Cloud(np.eye(4, len(axes) or 4), axes, 1.0)
            _run_stack(tiny, np.array([0, 4]), [1.0], []) if stack else _run(tiny, 1.0, None)
        finally:
            notice.cancel()
        _ready.add((axes, stack))
