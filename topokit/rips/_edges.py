"""Edges of a point cloud or of a matrix of distances, a window of lengths at a time, in the total order.

A cloud comes as a kd-tree (`_tree`), whose boxes are walked in pairs so that only edges of about the right length are
looked at. For a cloud a "length" here is squared: it orders edges alike and costs no root.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ._tree import between_boxes, centre, nearby_point

_BITS = 21  # of an int64 for a vertex, three times: two million vertices
_MASK = (1 << _BITS) - 1


@njit(cache=True, forceinline=True)
def edge_length(data, i, j, axes):
    """The entry of a matrix (no axes), or the squared distance of two points; the same for (i, j) and (j, i)."""
    if len(axes) == 0:
        return data[i, j]
    total = 0.0
    for k in range(len(axes)):
        step = data[i, k] - data[j, k]
        total += step * step
    return total


@njit(cache=True, forceinline=True)
def tie_precedes(label, a, b, x, y):
    """Whether {a, b} precedes {x, y}, an edge of the same length, in the total order."""
    a, b, x, y = label[a], label[b], label[x], label[y]
    return min(a, b) < min(x, y) or (min(a, b) == min(x, y) and max(a, b) < max(x, y))


@njit(cache=True)
def new_room():
    """Arrays for `edges_between` to fill, handed on from window to window: fresh memory costs more than what is done in it."""
    return np.empty(0, np.int64), np.empty(0), np.empty(0, np.int64), np.empty(0), np.empty(0, np.int32)


@njit(cache=True, forceinline=True)
def ends_of(key):
    """Both ends of an edge, and a vertex near its middle."""
    return key & _MASK, (key >> _BITS) & _MASK, key >> (2 * _BITS)


@njit(cache=True)
def _most_edges(tree, shortest, longest):
    """An upper bound for the edges that the walk below finds."""
    start, end = tree.start, tree.end
    pairs, top, most_edges = np.zeros((272, 2), dtype=np.int64), 0, 0
    while top >= 0:
        a, b = pairs[top, 0], pairs[top, 1]
        top -= 1
        least, most = between_boxes(tree, a, b)
        if least >= longest or most < shortest:
            continue
        if a < tree.first_leaf:
            for i in range(1, 3):
                for j in range(1, 3):
                    if a != b or i <= j:
                        top += 1
                        pairs[top, 0], pairs[top, 1] = 2 * a + i, 2 * b + j
            continue
        most_edges += (end[a] - start[a]) * (end[b] - start[b])
    return most_edges


@njit(cache=True)
def _edges_of_points(tree, shortest, longest, keys, lengths):
    """All edges with shortest <= squared length < longest, by walking pairs of boxes of the tree; their number."""
    points, axes, start, end = tree.points, tree.axes, tree.start, tree.end
    pairs, top, size = np.zeros((272, 2), dtype=np.int64), 0, 0
    place = np.empty(len(axes))
    while top >= 0:
        a, b = pairs[top, 0], pairs[top, 1]
        top -= 1
        least, most = between_boxes(tree, a, b)
        if least >= longest or most < shortest:
            continue
        if a < tree.first_leaf:
            for i in range(1, 3):
                for j in range(1, 3):
                    if a != b or i <= j:
                        top += 1
                        pairs[top, 0], pairs[top, 1] = 2 * a + i, 2 * b + j
            continue
        centre(tree, a, b, place)
        middle = nearby_point(tree, place) << (2 * _BITS)
        for x in range(start[a], end[a]):
            for y in range(x + 1 if a == b else start[b], end[b]):
                length = 0.0
                for k in range(len(axes)):
                    step = points[x, k] - points[y, k]
                    length += step * step
                keys[size] = middle | (y << _BITS) | x
                lengths[size] = length
                size += (shortest <= length) & (length < longest)  # no branch: it could not be foreseen
    return size


@njit(cache=True)
def _edges_of_matrix(data, shortest, longest, keys, lengths):
    """All edges with shortest <= length < longest; their number. One end stands for the middle."""
    size = 0
    for x in range(len(data)):
        for y in range(x + 1, len(data)):
            keys[size] = (x << (2 * _BITS)) | (y << _BITS) | x
            lengths[size] = length = data[x, y]
            size += (shortest <= length) & (length < longest)
    return size


@njit(cache=True)
def _sort(room, m, label, shortest, longest):
    """Put m edges in the total order: a slice of lengths holds about one edge, and insertion does the rest."""
    keys, lengths, sorted_keys, sorted_lengths, start = room
    scale = m / (longest - shortest)
    start[: m + 2] = 0
    for e in range(m):
        start[min(int((lengths[e] - shortest) * scale), m - 1) + 2] += 1
    for s in range(1, m + 2):
        start[s] += start[s - 1]
    for e in range(m):
        s = min(int((lengths[e] - shortest) * scale), m - 1) + 1
        sorted_keys[start[s]], sorted_lengths[start[s]] = keys[e], lengths[e]
        start[s] += 1
    for e in range(1, m):
        key, length = sorted_keys[e], sorted_lengths[e]
        i = e
        while i > 0 and (
            sorted_lengths[i - 1] > length
            or (sorted_lengths[i - 1] == length and _tied_before(label, key, sorted_keys[i - 1]))
        ):
            sorted_keys[i], sorted_lengths[i] = sorted_keys[i - 1], sorted_lengths[i - 1]
            i -= 1
        sorted_keys[i], sorted_lengths[i] = key, length


@njit(cache=True, forceinline=True)
def _tied_before(label, key, other):
    a, b, _ = ends_of(key)
    x, y, _ = ends_of(other)
    return tie_precedes(label, a, b, x, y)


@njit(cache=True)
def edges_between(data, axes, tree, shortest, longest, room):
    """The edges with shortest <= length < longest, in the total order.

    Returns
    -------
    room : tuple
        To be handed to the next call.
    keys, lengths : (m,) int64, float64
        Views of it, good until then; `ends_of` reads a key.
    """
    most = len(data) * len(data) // 2 if len(axes) == 0 else _most_edges(tree, shortest, longest)
    if most >= len(room[0]):  # memory that is never written to is never taken
        room = (np.empty(most + 1, np.int64), np.empty(most + 1), room[2], room[3], room[4])
    if len(axes) == 0:
        m = _edges_of_matrix(data, shortest, longest, room[0], room[1])
    else:
        m = _edges_of_points(tree, shortest, longest, room[0], room[1])
    if m > len(room[2]):
        room = (room[0], room[1], np.empty(m, np.int64), np.empty(m), np.empty(m + 2, np.int32))
    _sort(room, m, tree.label, shortest, longest)
    return room, room[2][:m], room[3][:m]


@njit(cache=True)
def greatest_length(data, axes, tree):
    """An upper bound of all lengths."""
    return data.max() if len(axes) == 0 else between_boxes(tree, 0, 0)[1]


@njit(cache=True)
def first_window(data, axes, tree):
    """A length below which most vertices have their nearest neighbours."""
    total, n = 0.0, len(data)
    for x in range(n):
        nearest = np.inf
        # for points, those that are next in the tree's order are near
        for y in range(n) if len(axes) == 0 else range(max(0, x - 4), min(n, x + 5)):
            if y != x:
                nearest = min(nearest, edge_length(data, x, y, axes))
        total += nearest if len(axes) == 0 else np.sqrt(nearest)
    first = 2.0 * total / n if len(axes) == 0 else (2.5 * total / n) ** 2
    return max(first, 1e-6 * greatest_length(data, axes, tree))
