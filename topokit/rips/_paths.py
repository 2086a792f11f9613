"""Compiled searches in the graph of the edges that arrive before a time, read off coordinates or a matrix."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["edge_key", "lune_vertex", "neighbours", "shortest_paths"]

Time = tuple[float, int, int]  # what orders edges: (length or its square, smaller index, larger index)
_Array = NDArray[np.float64]


@njit(cache=True, inline="always")
def _key(data: _Array, precomputed: bool, i: int, j: int) -> float:
    """The distance of two vertices, or its square: what orders edges."""
    if precomputed:
        return data[i, j]
    total = 0.0
    for k in range(data.shape[1]):
        step = data[i, k] - data[j, k]
        total += step * step
    return total


@njit(cache=True)
def edge_key(data: _Array, precomputed: bool, i: int, j: int) -> float:
    """`_key`, to be called from Python."""
    return _key(data, precomputed, i, j)


@njit(cache=True, inline="always")
def _precedes(key: float, i: int, j: int, time: Time) -> bool:
    """Whether the edge {i, j} arrives before a time."""
    if key != time[0]:
        return key < time[0]
    low, high = min(i, j), max(i, j)
    return low < time[1] or (low == time[1] and high < time[2])


@njit(cache=True)
def lune_vertex(data: _Array, precomputed: bool, x: int, y: int) -> int:
    """The vertex z that completes the earliest triangle before the edge {x, y}, x < y; -1 when its lune is empty."""
    time = (_key(data, precomputed, x, y), x, y)
    best, least = -1, np.inf
    for z in range(len(data)):
        if z in (x, y):
            continue
        to_x, to_y = _key(data, precomputed, x, z), _key(data, precomputed, y, z)
        later = max(to_x, to_y)
        if later < least and _precedes(to_x, x, z, time) and _precedes(to_y, y, z, time):
            best, least = z, later
    return best


@njit(cache=True)
def neighbours(data: _Array, precomputed: bool, v: int, time: Time) -> tuple[NDArray[np.int64], _Array]:
    """The vertices joined to v before a time, and the lengths of the edges to them."""
    found, lengths, size = np.empty(len(data), np.int64), np.empty(len(data)), 0
    for w in range(len(data)):
        key = _key(data, precomputed, v, w)
        if w != v and _precedes(key, v, w, time):
            found[size], lengths[size] = w, key if precomputed else np.sqrt(key)
            size += 1
    return found[:size], lengths[:size]


@njit(cache=True)
def shortest_paths(
    data: _Array, precomputed: bool, time: Time, targets: NDArray[np.int64], stop: int
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
            key = _key(data, precomputed, v, w)
            if _precedes(key, v, w, time):
                way = length[v] + (key if precomputed else np.sqrt(key))
                if way < length[w] or (way == length[w] and steps[v] + 1 < steps[w]):
                    length[w], after[w], steps[w] = way, v, steps[v] + 1
    for w in range(n):
        if not done[w] and w != stop:
            length[w] = np.inf
    return length, after
