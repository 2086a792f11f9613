"""Edges of a point cloud or of a matrix of distances, a window of lengths at a time, in the total order.

A cloud comes as a kd-tree (`_tree`), whose boxes are walked in pairs so that only edges of about the right length are
looked at. For a cloud a "length" here is squared: it orders edges alike and costs no root.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ._tree import LEAF, between_boxes


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
def _with_room(ends, lengths, size, more):
    """The same arrays with room for `more` after `size`."""
    if size + more <= len(lengths):
        return ends, lengths
    new_ends, new_lengths = np.empty((2 * size + more, 2), dtype=np.int32), np.empty(2 * size + more)
    new_ends[:size], new_lengths[:size] = ends[:size], lengths[:size]
    return new_ends, new_lengths


@njit(cache=True)
def _edges_of_points(tree, shortest, longest):
    """All edges with shortest <= squared length < longest, by walking pairs of boxes of the tree."""
    points, axes, start, end = tree.points, tree.axes, tree.start, tree.end
    ends, lengths, size = np.empty((4096, 2), dtype=np.int32), np.empty(4096), 0
    pairs, top = np.zeros((272, 2), dtype=np.int64), 0
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
        ends, lengths = _with_room(ends, lengths, size, LEAF * LEAF)
        for x in range(start[a], end[a]):
            for y in range(x + 1 if a == b else start[b], end[b]):
                length = edge_length(points, x, y, axes)
                if shortest <= length < longest:
                    ends[size, 0], ends[size, 1], lengths[size] = x, y, length
                    size += 1
    return ends[:size], lengths[:size]


@njit(cache=True)
def _edges_of_matrix(data, shortest, longest):
    """All edges with shortest <= length < longest."""
    ends, lengths, size = np.empty((4096, 2), dtype=np.int32), np.empty(4096), 0
    for x in range(len(data)):
        ends, lengths = _with_room(ends, lengths, size, len(data))
        for y in range(x + 1, len(data)):
            length = data[x, y]
            if shortest <= length < longest:
                ends[size, 0], ends[size, 1], lengths[size] = x, y, length
                size += 1
    return ends[:size], lengths[:size]


@njit(cache=True)
def _sorted(ends, lengths, label, shortest, longest):
    """Edges in the total order: a slice of lengths holds about one edge, and insertion does the rest."""
    m = len(lengths)
    scale = m / (longest - shortest)
    start = np.zeros(m + 2, dtype=np.int64)
    for e in range(m):
        start[min(int((lengths[e] - shortest) * scale), m - 1) + 2] += 1
    for s in range(1, m + 2):
        start[s] += start[s - 1]
    sorted_ends, sorted_lengths = np.empty_like(ends), np.empty_like(lengths)
    for e in range(m):
        s = min(int((lengths[e] - shortest) * scale), m - 1) + 1
        sorted_ends[start[s], 0], sorted_ends[start[s], 1] = ends[e, 0], ends[e, 1]
        sorted_lengths[start[s]] = lengths[e]
        start[s] += 1
    for e in range(1, m):
        x, y, length = sorted_ends[e, 0], sorted_ends[e, 1], sorted_lengths[e]
        i = e
        while i > 0 and (
            sorted_lengths[i - 1] > length
            or (
                sorted_lengths[i - 1] == length
                and tie_precedes(label, x, y, sorted_ends[i - 1, 0], sorted_ends[i - 1, 1])
            )
        ):
            sorted_ends[i, 0], sorted_ends[i, 1] = sorted_ends[i - 1, 0], sorted_ends[i - 1, 1]
            sorted_lengths[i] = sorted_lengths[i - 1]
            i -= 1
        sorted_ends[i, 0], sorted_ends[i, 1], sorted_lengths[i] = x, y, length
    return sorted_ends, sorted_lengths


@njit(cache=True)
def edges_between(data, axes, tree, shortest, longest):
    """Ends (m, 2) and lengths (m,) of the edges with shortest <= length < longest, in the total order."""
    if len(axes) == 0:
        ends, lengths = _edges_of_matrix(data, shortest, longest)
    else:
        ends, lengths = _edges_of_points(tree, shortest, longest)
    return _sorted(ends, lengths, tree.label, shortest, longest)


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
