"""A balanced kd-tree in flat arrays, and the distances that prune it.

Node i has children 2 i + 1 and 2 i + 2; all leaves are on one level and hold 4 to 8 points. Points are stored in the order
of the leaves, so that what is near in space is near in memory. `axes` is a tuple as long as the dimension: its length is
known when the code is compiled, which lets the compiler unroll every loop over coordinates.
"""

from __future__ import annotations

from collections import namedtuple

import numpy as np

from ._jit import njit

Tree = namedtuple("Tree", "points label start end low high first_leaf axes")

LEAF = 8


@njit()
def bound_box(points, order, start, end, low, high):
    """Write the corners of the box of points order[start:end] into `low` and `high`; return its longest axis."""
    for k in range(len(low)):
        low[k], high[k] = np.inf, -np.inf
    for i in range(start, end):
        for k in range(len(low)):
            value = points[order[i], k]
            low[k], high[k] = min(low[k], value), max(high[k], value)
    axis = 0
    for k in range(1, len(low)):
        if high[k] - low[k] > high[axis] - low[axis]:
            axis = k
    return axis


@njit()
def build_tree(points, axes):
    """Build the tree of an (n, d) cloud, n >= 1."""
    n, d = points.shape
    depth = 0
    while n > LEAF << depth:
        depth += 1
    first_leaf = (1 << depth) - 1
    nodes = 2 * first_leaf + 1
    order = np.arange(n)
    start, end = np.zeros(nodes, dtype=np.int64), np.zeros(nodes, dtype=np.int64)
    low, high = np.empty((nodes, d)), np.empty((nodes, d))
    end[0] = n
    for node in range(nodes):
        axis = bound_box(points, order, start[node], end[node], low[node], high[node])
        if node < first_leaf:
            middle = (start[node] + end[node]) >> 1
            mine = order[start[node] : end[node]]
            mine[:] = mine[np.argpartition(points[mine, axis], middle - start[node])]
            start[2 * node + 1], end[2 * node + 1] = start[node], middle
            start[2 * node + 2], end[2 * node + 2] = middle, end[node]
    ordered = np.empty((n, d))
    for i in range(n):
        for k in range(d):
            ordered[i, k] = points[order[i], k]
    return Tree(ordered, order, start, end, low, high, first_leaf, axes)


@njit()
def repeats(tree):
    """Whether a point is there twice, as far as the next ones in the tree's order tell."""
    for i in range(len(tree.points) - 1):
        same = True
        for k in range(len(tree.axes)):
            same = same and tree.points[i, k] == tree.points[i + 1, k]
        if same:
            return True
    return False


@njit(forceinline=True)
def nearest_in_box(tree, place, node):
    """Smallest squared distance from a place to the box of a node."""
    total = 0.0
    for k in range(len(tree.axes)):
        step = max(tree.low[node, k] - place[k], place[k] - tree.high[node, k], 0.0)
        total += step * step
    return total


@njit(forceinline=True)
def between_boxes(tree, a, b):
    """Smallest and largest squared distance between points of two boxes."""
    least, most = 0.0, 0.0
    for k in range(len(tree.axes)):
        gap = max(tree.low[a, k] - tree.high[b, k], tree.low[b, k] - tree.high[a, k], 0.0)
        span = max(tree.high[a, k] - tree.low[b, k], tree.high[b, k] - tree.low[a, k])
        least += gap * gap
        most += span * span
    return least, most


@njit()
def centre(tree, a, b, place):
    """Put the middle between two boxes into `place`; return how far from it the midpoint of an edge may be."""
    low, high, spread = tree.low, tree.high, 0.0
    for k in range(len(tree.axes)):
        place[k] = 0.25 * (low[a, k] + high[a, k] + low[b, k] + high[b, k])
        spread += (high[a, k] - low[a, k] + high[b, k] - low[b, k]) ** 2
    return 0.25 * np.sqrt(spread)


@njit()
def nearby_point(tree, place):
    """A point near a place, and its squared distance: the nearest of the leaf that always taking the nearer box leads to."""
    points, node = tree.points, 0
    while node < tree.first_leaf:
        node = 2 * node + 1
        node += nearest_in_box(tree, place, node + 1) < nearest_in_box(tree, place, node)
    best, bound = -1, np.inf
    for z in range(tree.start[node], tree.end[node]):
        square = 0.0
        for k in range(len(tree.axes)):
            step = points[z, k] - place[k]
            square += step * step
        if square < bound:
            best, bound = z, square
    return best, bound
