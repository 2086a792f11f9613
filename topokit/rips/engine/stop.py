"""When to stop: the last edge with an empty lune, after which no loop is born any more.

Idea: a point that is nearer to all of two boxes than they are to each other is in the lune of every edge between them. A point
near the middle is tried; the few edges that remain are searched. Here a lune holds strictly shorter edges only: where lengths
tie, the pairing may read on for nothing, and its answer is the same.
"""

from __future__ import annotations

import numpy as np

from . import compiled, inlined
from .edges import are_points, edge_length
from .tree import between_boxes, middle_of_boxes, nearby_point


@compiled
def greatest_length(data, tree):
    """Return a length that no edge exceeds."""
    if are_points(data):
        return between_boxes(tree.low, tree.high, 0, 0)[1]
    greatest = 0.0
    for x in range(len(data)):
        for y in range(x):
            greatest = max(greatest, data[x, y])
    return greatest


@compiled
def last_empty(data, tree, rows, shortest):
    """Return the greatest length of an edge with an empty lune among those not shorter than `shortest`, 0 for none.

    `rows` has all shorter edges. Points are searched by pairs of boxes; all vertices of a matrix are in one.
    """
    start = tree.start
    end = tree.end
    low = tree.low
    high = tree.high
    latest = 0.0
    box_pairs = np.empty((272, 3), np.int64)  # two boxes, and a point that may be between them
    for k in range(3):
        box_pairs[0, k] = 0
    place = np.empty(3)
    top = 0
    while top >= 0:
        a = box_pairs[top, 0]
        b = box_pairs[top, 1]
        z = box_pairs[top, 2]
        top -= 1
        shortest = max(shortest, latest)

        # Is a point in the lunes of all edges between the boxes: the one of the larger boxes, or one near the middle?
        if are_points(data) and (between_boxes(low, high, a, b)[1] < shortest or is_between(data, low, high, z, a, b)):
            continue
        if a != b:
            middle_of_boxes(low, high, a, b, place)
            z = nearby_point(tree, place)
            if is_between(data, low, high, z, a, b):
                continue
        if a < tree.first_leaf:
            for i in range(1, 3):
                for j in range(1, 3):
                    if a != b or i <= j:
                        top += 1
                        box_pairs[top, 0] = 2 * a + i
                        box_pairs[top, 1] = 2 * b + j
                        box_pairs[top, 2] = z
            continue

        # Two leaves: edge by edge. The point z, what is joined to both ends, and then all points are looked at.
        for x in range(start[a], end[a]):
            to_z = edge_length(data, x, z)
            for y in range(x + 1 if a == b else start[b], end[b]):
                length = edge_length(data, x, y)
                is_open = max(to_z, edge_length(data, y, z)) >= length >= shortest
                if is_open and length > latest and not meet(rows, x, y) and is_empty_lune(data, x, y, length):
                    latest = length
    return latest


@inlined
def meet(rows, x, y):
    """Return True if a vertex is joined to both x and y."""
    both = np.uint64(0)
    for w in range(rows.shape[1]):
        both |= rows[x, w] & rows[y, w]
    return both != 0


@inlined
def is_strictly_in_lune(data, z, x, y, length):
    """Return True if z is nearer to both ends of {x, y} than its length."""
    return max(edge_length(data, x, z), edge_length(data, y, z)) < length


@compiled
def is_empty_lune(data, x, y, length):
    """Return True if no vertex is in the lune of {x, y}."""
    z = 0
    while z < len(data) and not is_strictly_in_lune(data, z, x, y, length):
        z += 1
    return z == len(data)


@inlined
def is_nearer(points, low, high, z, a, b):
    """Return True if the point z is nearer to every place of box b than any place of box a is.

    |z - y|^2 - |x - y|^2 is a sum over the axes; along one it is greatest with y at an end of b and x as near to it as a allows.
    """
    total = 0.0
    size = 0.0
    for k in range(3):
        most = -np.inf
        for y in (low[b, k], high[b, k]):
            gap = max(low[a, k] - y, y - high[a, k], 0.0)
            step = points[z, k] - y
            most = max(most, step * step - gap * gap)
            size = max(size, step * step, gap * gap)
        total += most
    return total < -1e-12 * size  # rounding must not decide


@inlined
def is_between(points, low, high, z, a, b):
    """Return True if z is in the lune of every edge between two boxes."""
    return is_nearer(points, low, high, z, a, b) and is_nearer(points, low, high, z, b, a)
