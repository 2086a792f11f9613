"""A balanced kd-tree in flat arrays, and the distances that prune it.

Node i has children 2 i + 1 and 2 i + 2; all leaves are on one level and hold 4 to 8 points. Points are stored in the order
of the leaves, so that what is near in space is near in memory. `axes` is a tuple as long as the dimension: its length is
known when the code is compiled, which lets the compiler unroll every loop over coordinates.
"""

from __future__ import annotations

from collections import namedtuple

import numpy as np
from numba import njit

Tree = namedtuple("Tree", "points label start end low high first_leaf axes")

LEAF = 8


@njit(cache=True)
def _select(points, order, start, end, middle, axis):
    """Reorder order[start:end] so that position `middle` holds what sorting along `axis` would put there."""
    low, high = start, end - 1
    while low < high:
        pivot = points[order[(low + high) >> 1], axis]
        i, j = low, high
        while i <= j:
            while points[order[i], axis] < pivot:
                i += 1
            while points[order[j], axis] > pivot:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            return


@njit(cache=True)
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
        for k in range(d):
            low[node, k], high[node, k] = np.inf, -np.inf
        for i in range(start[node], end[node]):
            for k in range(d):
                value = points[order[i], k]
                low[node, k] = min(low[node, k], value)
                high[node, k] = max(high[node, k], value)
        if node < first_leaf:
            axis = 0
            for k in range(1, d):
                if high[node, k] - low[node, k] > high[node, axis] - low[node, axis]:
                    axis = k
            middle = (start[node] + end[node]) >> 1
            _select(points, order, start[node], end[node], middle, axis)
            start[2 * node + 1], end[2 * node + 1] = start[node], middle
            start[2 * node + 2], end[2 * node + 2] = middle, end[node]
    return Tree(points[order], order, start, end, low, high, first_leaf, axes)


@njit(cache=True, forceinline=True)
def square(tree, i, j):
    """Squared distance of two points; the same to the last bit for (i, j) and (j, i)."""
    total = 0.0
    for k in range(len(tree.axes)):
        step = tree.points[i, k] - tree.points[j, k]
        total += step * step
    return total


@njit(cache=True, forceinline=True)
def before(tree, a, b, length, x, y):
    """Whether the edge {a, b}, of squared length `length`, precedes {x, y} in the total order."""
    other = square(tree, x, y)
    if length != other:
        return length < other
    a, b, x, y = tree.label[a], tree.label[b], tree.label[x], tree.label[y]
    return min(a, b) < min(x, y) or (min(a, b) == min(x, y) and max(a, b) < max(x, y))


@njit(cache=True, forceinline=True)
def nearest_in_box(tree, place, node):
    """Smallest squared distance from a place to the box of a node."""
    total = 0.0
    for k in range(len(tree.axes)):
        step = max(tree.low[node, k] - place[k], place[k] - tree.high[node, k], 0.0)
        total += step * step
    return total


@njit(cache=True, forceinline=True)
def farthest_in_box(tree, place, node):
    """Largest squared distance from a place to the box of a node."""
    total = 0.0
    for k in range(len(tree.axes)):
        step = max(place[k] - tree.low[node, k], tree.high[node, k] - place[k])
        total += step * step
    return total


@njit(cache=True, forceinline=True)
def between_boxes(tree, a, b):
    """Smallest and largest squared distance between points of two boxes."""
    least, most = 0.0, 0.0
    for k in range(len(tree.axes)):
        gap = max(tree.low[a, k] - tree.high[b, k], tree.low[b, k] - tree.high[a, k], 0.0)
        span = max(tree.high[a, k] - tree.low[b, k], tree.high[b, k] - tree.low[a, k])
        least += gap * gap
        most += span * span
    return least, most


@njit(cache=True)
def nearest_point(tree, place, bound, enough, stack):
    """A point within sqrt(bound) of `place` and its squared distance: the nearest, or any nearer than sqrt(enough); or -1."""
    best, top = -1, 0
    stack[0] = 0
    while top >= 0 and (best < 0 or bound > enough):
        node = stack[top]
        top -= 1
        if nearest_in_box(tree, place, node) >= bound:
            continue
        if node >= tree.first_leaf:
            for i in range(tree.start[node], tree.end[node]):
                total = 0.0
                for k in range(len(tree.axes)):
                    step = tree.points[i, k] - place[k]
                    total += step * step
                if total < bound:
                    best, bound = i, total
            continue
        left, right = 2 * node + 1, 2 * node + 2
        if nearest_in_box(tree, place, left) <= nearest_in_box(tree, place, right):
            left, right = right, left
        stack[top + 1], stack[top + 2] = left, right  # the nearer child is looked at first
        top += 2
    return best, bound


@njit(cache=True, forceinline=True)
def centre(tree, a, b, place):
    """Put the middle between two boxes into `place`; return the larger of the distances a midpoint may be from it."""
    spread = 0.0
    for k in range(len(tree.axes)):
        place[k] = 0.25 * (tree.low[a, k] + tree.high[a, k] + tree.low[b, k] + tree.high[b, k])
        spread += (tree.high[a, k] - tree.low[a, k] + tree.high[b, k] - tree.low[b, k]) ** 2
    return 0.25 * np.sqrt(spread)


@njit(cache=True, forceinline=True)
def nearby_point(tree, place):
    """A point near a place: the nearest of the leaf that is reached by always taking the nearer box."""
    node = 0
    while node < tree.first_leaf:
        left, right = 2 * node + 1, 2 * node + 2
        node = left if nearest_in_box(tree, place, left) <= nearest_in_box(tree, place, right) else right
    best, bound = -1, np.inf
    for z in range(tree.start[node], tree.end[node]):
        total = 0.0
        for k in range(len(tree.axes)):
            step = tree.points[z, k] - place[k]
            total += step * step
        if total < bound:
            best, bound = z, total
    return best
