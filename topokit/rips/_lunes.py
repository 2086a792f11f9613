"""How late an edge with an empty lune can still come: after the last of them no loop is born any more.

Idea: a point that is nearer to all of two boxes than they are to each other is in the lune of every edge between them. A
point near the middle is tried, then the points of two leaves; the few edges that remain are searched. Here a lune holds
strictly shorter edges only: where lengths tie, the kernel may read on for nothing, and its answer is the same.
"""

from __future__ import annotations

import numpy as np

from ._edges import ROUNDING, edge_length
from ._jit import njit
from ._tree import between_boxes, centre, nearby_point, nearest_in_box


@njit()
def last_empty_lune(data, axes, tree, shortest):
    """The greatest length of an edge with an empty lune among those not shorter than `shortest`; 0 when there is none."""
    return _last_of_matrix(data, shortest) if len(axes) == 0 else _last_of_points(tree, shortest)


@njit()
def _last_of_matrix(data, shortest):
    latest = 0.0
    for x in range(len(data)):
        for y in range(x + 1, len(data)):
            length = data[x, y]
            if length >= max(shortest, latest):
                z = 0
                while z < len(data) and (data[x, z] >= length or data[y, z] >= length):
                    z += 1
                if z == len(data):
                    latest = length
    return latest


@njit()
def _last_of_points(tree, shortest):
    axes, start, end = tree.axes, tree.start, tree.end
    pairs, top, latest = np.zeros((272, 3), dtype=np.int64), 0, 0.0  # two boxes, and a point that may be between them
    stack, place = np.empty(256, dtype=np.int64), np.empty(len(axes))
    while top >= 0:
        a, b, z = pairs[top, 0], pairs[top, 1], pairs[top, 2]
        top -= 1
        shortest = max(shortest, latest)
        if between_boxes(tree, a, b)[1] < shortest or _is_between(tree, z, a, b):
            continue
        if a != b:
            centre(tree, a, b, place)
            z = nearby_point(tree, place)[0]
            if _is_between(tree, z, a, b):
                continue
        if a < tree.first_leaf:
            for i in range(1, 3):
                for j in range(1, 3):
                    if a != b or i <= j:
                        top += 1
                        pairs[top, 0], pairs[top, 1], pairs[top, 2] = 2 * a + i, 2 * b + j, z
            continue
        for x in range(start[a], end[a]):
            for y in range(x + 1 if a == b else start[b], end[b]):
                length = edge_length(tree.points, x, y, axes)
                if length < shortest or length <= latest or _is_in_lune(tree, z, x, y, length):
                    continue
                met = _leaf_meets_lune(tree, x, y, length, a) or _leaf_meets_lune(tree, x, y, length, b)
                if not met and _is_empty(tree, x, y, length, stack, place):
                    latest = length
    return latest


@njit(forceinline=True)
def _is_in_lune(tree, z, x, y, length):
    """Whether z is nearer to both ends of {x, y} than its length."""
    points, axes = tree.points, tree.axes
    return z != x and z != y and edge_length(points, x, z, axes) < length and edge_length(points, y, z, axes) < length


@njit(forceinline=True)
def _leaf_meets_lune(tree, x, y, length, leaf):
    met = False
    for z in range(tree.start[leaf], tree.end[leaf]):
        met = met or _is_in_lune(tree, z, x, y, length)
    return met


@njit()
def _is_empty(tree, x, y, length, stack, place):
    """Whether no point is in the lune of {x, y}; boxes nearer to its midpoint are looked at first."""
    for k in range(len(tree.axes)):
        place[k] = 0.5 * (tree.points[x, k] + tree.points[y, k])
    reach = (0.86605 * np.sqrt(length) + ROUNDING) ** 2  # a lune lies within sqrt(3)/2 of the length
    top = 0
    stack[0] = 0
    while top >= 0:
        node = stack[top]
        top -= 1
        if nearest_in_box(tree, place, node) > reach:
            continue
        if node < tree.first_leaf:
            left, right = 2 * node + 1, 2 * node + 2
            if nearest_in_box(tree, place, left) <= nearest_in_box(tree, place, right):
                left, right = right, left
            stack[top + 1], stack[top + 2] = left, right
            top += 2
        elif _leaf_meets_lune(tree, x, y, length, node):
            return False
    return True


@njit(forceinline=True)
def _is_nearer(tree, z, a, b):
    """Whether the point z is nearer to every place of box b than any place of box a is.

    |z - y|^2 - |x - y|^2 is a sum over the axes; along one it is greatest with y at an end of b and x as near to it as a allows.
    """
    total, size = 0.0, 0.0
    for k in range(len(tree.axes)):
        most = -np.inf
        for y in (tree.low[b, k], tree.high[b, k]):
            gap = max(tree.low[a, k] - y, y - tree.high[a, k], 0.0)
            step = tree.points[z, k] - y
            most = max(most, step * step - gap * gap)
            size = max(size, step * step, gap * gap)
        total += most
    return total < -1e-12 * size  # rounding must not decide


@njit(forceinline=True)
def _is_between(tree, z, a, b):
    """Whether z is in the lune of every edge between two boxes."""
    return _is_nearer(tree, z, a, b) and _is_nearer(tree, z, b, a)
