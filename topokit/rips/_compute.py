"""From a checked array to births, deaths and simplices: the door to the compiled kernels."""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ._lengths import power_of_two

MOST_ROWS = 4096  # points with a bitset each; more are handled without any n x n table
_PATIENCE = 3.0  # seconds of compiling before it is said
_ready: set[int] = set()
_compiling = threading.Lock()
_kept = threading.local()  # each thread's room for edges, kept from one cloud to the next
_MOST_KEPT = 1 << 22  # edges

Pairs = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]


def pairs(array: NDArray[np.float64], max_radius: float, precomputed: bool) -> Pairs:
    """Creating edges (c, 2), killer edges with their two apexes (c, 4), births and deaths (c,)."""
    if len(array) < 4 or (array.shape[1] == 1 and not precomputed):  # a loop needs four vertices, and room to go around
        return np.empty((0, 2), np.int64), np.empty((0, 4), np.int64), np.empty(0), np.empty(0)
    if array.shape[1] < 3 and not precomputed:  # the plane is a part of space: one kernel less to compile
        array = np.column_stack([array, np.zeros(len(array))])
    _compile(0 if precomputed else array.shape[1])
    # Lengths of points are compared squared. A power of two saves squares from overflow and underflow, and costs no digit.
    scale = 1.0 if precomputed else power_of_two(array)
    created, killed = _kernel(array * scale, 2 * max_radius * scale, precomputed)
    birth, death = (_lengths(array, edges, scale, precomputed) / 2 for edges in (created, killed))
    death[(killed[:, 0] < 0) | (death > max_radius)] = np.inf
    killed[np.isinf(death)] = -1
    inside = birth <= max_radius
    return created[inside], killed[inside], birth[inside], death[inside]


def _kernel(
    array: NDArray[np.float64], max_length: float, precomputed: bool
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Run the kernel for the array: by bitsets, or for many points without them."""
    from ._bits import pair_edges  # numba takes a while to import
    from ._edges import new_room
    from ._reduce import tree_pairs
    from ._tree import build_tree

    if precomputed:
        points, axes, limit, half = array, (), max_length, 0.63
        tree = build_tree(np.zeros((1, 1)), (0,))._replace(label=np.arange(len(array)))
    else:
        axes, half = (0,) * array.shape[1], 0.4
        limit = max_length**2 * (1 + 1e-15)  # rather an edge too many, which `pairs` leaves out, than one too few
        if len(array) > MOST_ROWS:
            return tree_pairs(array, axes, limit)
        tree = build_tree(array, axes)
        points = tree.points
    room, created, killed = pair_edges(points, axes, tree, limit, half, getattr(_kept, "room", None) or new_room())
    _kept.room = room if len(room[0]) <= _MOST_KEPT else None
    return created, killed


def _lengths(
    array: NDArray[np.float64], edges: NDArray[np.int64], scale: float, precomputed: bool
) -> NDArray[np.float64]:
    """Lengths of the edges in the first two columns."""
    x, y = edges[:, 0], edges[:, 1]
    if precomputed:
        return array[x, y]
    total = np.zeros(len(edges))
    for axis in range(array.shape[1]):  # in the order of the kernels: NumPy's sum pairs the terms
        total += ((array[x, axis] - array[y, axis]) * scale) ** 2
    return np.sqrt(total) / scale


def _compile(dimension: int) -> None:
    """Compile the kernel for points of a dimension (0: a matrix) on a tiny cloud, or load it; once a process."""
    with _compiling:
        if dimension in _ready:
            return
        what = f"points in {dimension} dimensions" if dimension else "matrices of distances"
        with _announced(f"topokit: compiling the persistence kernel for {what} (once; kept for the next time)"):
            tiny = np.zeros((4, dimension or 4))
            _kernel(tiny, 1.0, dimension == 0)
        _ready.add(dimension)


@contextlib.contextmanager
def _announced(message: str) -> Iterator[None]:
    """Say on stderr what is being waited for, when it takes long."""
    timer = threading.Timer(_PATIENCE, lambda: print(message, file=sys.stderr, flush=True))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
