"""Compiled searches in the graph of the edges that arrive before a time, read off coordinates or a matrix."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ._edges import edge_length, precedes
from ._jit import njit

Time = tuple[float, int, int]  # what `edge_length` says of an edge, and its ends
_Array = NDArray[np.float64]
_Axes = tuple[int, ...]


@njit()
def lune_vertex(data: _Array, axes: _Axes, x: int, y: int) -> int:
    """The vertex z that completes the earliest triangle before the edge {x, y}, x < y; -1 when its lune is empty."""
    length = edge_length(data, x, y, axes)
    best, least = -1, np.inf
    for z in range(len(data)):
        if z in (x, y):
            continue
        to_x, to_y = edge_length(data, x, z, axes), edge_length(data, y, z, axes)
        later = max(to_x, to_y)
        if later < least and precedes(to_x, x, z, length, x, y) and precedes(to_y, y, z, length, x, y):
            best, least = z, later
    return best


@njit()
def neighbours(data: _Array, axes: _Axes, v: int, time: Time) -> tuple[NDArray[np.int64], _Array]:
    """The vertices joined to v before a time, and the lengths of the edges to them."""
    found, lengths, size = np.empty(len(data), np.int64), np.empty(len(data)), 0
    for w in range(len(data)):
        key = edge_length(data, v, w, axes)
        if w != v and precedes(key, v, w, time[0], time[1], time[2]):
            found[size], lengths[size] = w, key if len(axes) == 0 else np.sqrt(key)
            size += 1
    return found[:size], lengths[:size]


@njit()
def shortest_paths(
    data: _Array, axes: _Axes, time: Time, targets: NDArray[np.int64], stop: int
) -> tuple[_Array, NDArray[np.int64]]:
    """Shortest paths along edges that precede a time, to the nearest target, by Dijkstra's method.

    Returns
    -------
    length : (n,) float64
        Infinite where there is no path, and where the path is longer than that from `stop` (-1: nowhere).
    after : (n,) int64
        The next vertex on the way, -1 at a target. Among equal lengths the path with fewer steps.
    """
    n = len(data)
    length, after = np.full(n, np.inf), np.full(n, -1)
    steps, done = np.zeros(n, np.int64), np.zeros(n, np.bool_)
    length[targets] = 0.0
    while True:
        v = -1
        for w in range(n):
            if not done[w] and length[w] < np.inf and (v < 0 or (length[w], steps[w]) < (length[v], steps[v])):
                v = w
        if v < 0 or v == stop:
            break
        done[v] = True
        for w in range(n):
            if done[w]:
                continue
            key = edge_length(data, v, w, axes)
            if precedes(key, v, w, time[0], time[1], time[2]):
                way = length[v] + (key if len(axes) == 0 else np.sqrt(key))
                if way < length[w] or (way == length[w] and steps[v] + 1 < steps[w]):
                    length[w], after[w], steps[w] = way, v, steps[v] + 1
    for w in range(n):
        if not done[w] and w != stop:
            length[w] = np.inf
    return length, after
