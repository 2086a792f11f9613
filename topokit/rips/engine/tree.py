"""A kd-tree of points in flat arrays.

The tree is balanced. Node i has the children 2 i + 1 and 2 i + 2; all leaves are on one level and hold 4 to 8 points. Points are
stored in the order of the leaves, so that what is near in space is near in memory; `label` holds their numbers in the cloud.
The points of a node are `points[start[node]:end[node]]`, in the box from `low` to `high`.
"""

from __future__ import annotations

import math
from collections import namedtuple

import numpy as np

from . import compiled, inlined

Tree = namedtuple("Tree", "points label start end low high first_leaf scale")


@compiled
def bound_box(points, order, start, end, low, high):
    """Write the corners of the box of points[order[start:end]] into `low` and `high`; return its longest axis."""
    axis = 0
    for k in range(3):
        least = np.inf
        most = -np.inf
        for i in range(start, end):
            value = points[order[i], k]
            least = value if value < least else least
            most = value if value > most else most
        low[k] = least
        high[k] = most
        if most - least > high[axis] - low[axis]:
            axis = k
    return axis


@compiled
def put_in_place(points, axis, order, first, last, middle):
    """Reorder order[first:last + 1] until what is before `middle` is no farther along an axis than what is after it.

    Source: Hoare 1961 (find).
    """
    while first < last:
        pivot = points[order[middle], axis]
        i = first
        j = last
        while i <= j:
            while points[order[i], axis] < pivot:
                i += 1
            while points[order[j], axis] > pivot:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if j < middle:
            first = i
        if i > middle:
            last = j


@compiled
def first_numbers(n):
    """Return the numbers 0 to n - 1; loops compile much faster than NumPy's functions."""
    numbers = np.empty(n, np.int64)
    for i in range(n):
        numbers[i] = i
    return numbers


@compiled
def build_tree(points):
    """Build the tree of an (n, 3) cloud, n >= 1, whose coordinates are multiplied by `scale`.

    It is the power of two that brings all to at most 1, which costs no digit.
    """
    n = len(points)
    depth = 0
    while n > 8 << depth:
        depth += 1
    first_leaf = (1 << depth) - 1
    n_nodes = 2 * first_leaf + 1
    order = first_numbers(n)
    start = np.empty(n_nodes, np.int64)
    end = np.empty(n_nodes, np.int64)
    low = np.empty((n_nodes, 3))
    high = np.empty((n_nodes, 3))

    largest = 0.0
    for i in range(n):
        for k in range(3):
            largest = max(largest, abs(points[i, k]))
    scale = math.ldexp(1.0, -math.frexp(largest)[1])
    scaled = np.empty((n, 3))
    for i in range(n):
        for k in range(3):
            scaled[i, k] = scale * points[i, k]

    # Halve the points of each node at the median of its longest axis.
    start[0] = 0
    end[0] = n
    for node in range(n_nodes):
        axis = bound_box(scaled, order, start[node], end[node], low[node], high[node])
        if node < first_leaf:
            middle = (start[node] + end[node]) >> 1
            put_in_place(scaled, axis, order, start[node], end[node] - 1, middle)
            start[2 * node + 1] = start[node]
            end[2 * node + 1] = middle
            start[2 * node + 2] = middle
            end[2 * node + 2] = end[node]

    ordered = np.empty((n, 3))
    for i in range(n):
        for k in range(3):
            ordered[i, k] = scaled[order[i], k]
    return Tree(ordered, order, start, end, low, high, first_leaf, scale)


@compiled
def tree_of_matrix(n):
    """Return a tree with one leaf, of the n vertices of a matrix of distances."""
    nothing = np.empty((1, 3))
    for k in range(3):
        nothing[0, k] = 0.0
    start = np.empty(1, np.int64)
    end = np.empty(1, np.int64)
    start[0] = 0
    end[0] = n
    return Tree(nothing, first_numbers(n), start, end, nothing, nothing, 0, 1.0)


# Distances to boxes ---------------------------------------------------------------------------------------------------


@inlined
def place_to_point(place, points, z):
    """Return the squared distance from a place to a point."""
    square = 0.0
    for k in range(3):
        step = points[z, k] - place[k]
        square += step * step
    return square


@inlined
def place_to_box(low, high, place, node):
    """Return the smallest squared distance from a place to the box of a node."""
    total = 0.0
    for k in range(3):
        step = max(low[node, k] - place[k], place[k] - high[node, k], 0.0)
        total += step * step
    return total


@inlined
def between_boxes(low, high, a, b):
    """Return the smallest and the largest squared distance between places of two boxes."""
    least = 0.0
    most = 0.0
    for k in range(3):
        gap = max(low[a, k] - high[b, k], low[b, k] - high[a, k], 0.0)
        span = max(high[a, k] - low[b, k], high[b, k] - low[a, k])
        least += gap * gap
        most += span * span
    return least, most


@inlined
def middle_of_boxes(low, high, a, b, place):
    """Write the middle between two boxes into `place`."""
    for k in range(3):
        place[k] = 0.25 * (low[a, k] + high[a, k] + low[b, k] + high[b, k])


@compiled
def nearby_point(tree, place):
    """Return a point near a place: the nearest in the leaf that always taking the nearer box leads to."""
    points = tree.points
    low = tree.low
    high = tree.high
    node = 0
    while node < tree.first_leaf:
        node = 2 * node + 1
        node += place_to_box(low, high, place, node + 1) < place_to_box(low, high, place, node)
    nearest = -1
    least = np.inf
    for z in range(tree.start[node], tree.end[node]):
        square = place_to_point(place, points, z)
        if square < least:
            nearest = z
            least = square
    return nearest
