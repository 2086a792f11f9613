"""Which edges of a point cloud have an empty or a disconnected lune: all that degree-1 persistence needs to see.

Idea: whether a lune is connected depends on distances alone, not on what was processed before, so pairs of points can be
dismissed in any order, and in bulk. The lune of an edge of length L lies within sqrt(3)/2 L of its midpoint; a point
within (1 - sqrt(3)/2) L of the midpoint is therefore nearer than L to all of it, the lune is a cone, and the edge changes
nothing. For two boxes of a kd-tree one such point dismisses every edge between them. Between two leaves a central point z
is kept, and the few points that lie farther from z than an edge is long are all that can prevent a cone. What is left is
examined exactly.

Source: Koyama, Memoli, Robins, Turner 2023; the cone argument is taught in chapter 2.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ._tree import (
    LEAF,
    before,
    between_boxes,
    centre,
    farthest_in_box,
    nearby_point,
    nearest_in_box,
    nearest_point,
    square,
)

CONE = (1.0 - np.sqrt(0.75)) * (1.0 - 1e-9)  # a little less, for rounding


@njit(cache=True, forceinline=True)
def in_lune(tree, z, x, y, length):
    """Whether the edges {x, z} and {y, z} both precede {x, y}, whose squared length is `length`."""
    to_x, to_y = square(tree, x, z), square(tree, y, z)
    if to_x > length or to_y > length or z in (x, y):
        return False
    if to_x < length and to_y < length:
        return True
    return before(tree, x, z, to_x, x, y) and before(tree, y, z, to_y, x, y)


@njit(cache=True)
def lune_vertex(tree, x, y, stack, place):
    """The vertex of the lune of {x, y} nearest to its midpoint, -1 when the lune is empty."""
    length = square(tree, x, y)
    for k in range(len(tree.axes)):
        place[k] = 0.5 * (tree.points[x, k] + tree.points[y, k])
    best, bound, top = -1, np.inf, 0
    stack[0] = 0
    while top >= 0:
        node = stack[top]
        top -= 1
        gap = nearest_in_box(tree, place, node)
        if gap >= bound or gap > length:
            continue
        if node >= tree.first_leaf:
            for z in range(tree.start[node], tree.end[node]):
                total = 0.0
                for k in range(len(tree.axes)):
                    step = tree.points[z, k] - place[k]
                    total += step * step
                if total < bound and in_lune(tree, z, x, y, length):
                    best, bound = z, total
            continue
        left, right = 2 * node + 1, 2 * node + 2
        if nearest_in_box(tree, place, left) <= nearest_in_box(tree, place, right):
            left, right = right, left
        stack[top + 1], stack[top + 2] = left, right
        top += 2
    return best


@njit(cache=True)
def _gather(tree, a, b, longest, z, shortest, stack, found):
    """Points that may be in a lune between leaves a and b, edges up to sqrt(longest), and sqrt(shortest) or more from z."""
    count, top = 0, 0
    stack[0] = 0
    while top >= 0:
        node = stack[top]
        top -= 1
        if between_boxes(tree, node, a)[0] > longest or between_boxes(tree, node, b)[0] > longest:
            continue
        if farthest_in_box(tree, tree.points[z], node) < shortest:
            continue
        if node < tree.first_leaf:
            stack[top + 1], stack[top + 2] = 2 * node + 1, 2 * node + 2
            top += 2
            continue
        for w in range(tree.start[node], tree.end[node]):
            if square(tree, z, w) >= shortest:
                found[count] = w
                count += 1
    return count


@njit(cache=True)
def _components(tree, x, y, length, lune, left, queue, apexes):
    """Components of the lune held in lune[:left] (which is used up): their number, and the apex of each, nearest first.

    The apex is the vertex whose later edge to {x, y} comes first. The first of the vertices not yet reached is the apex of
    its own component, so components come out in the order of their apexes.
    """
    count = 0
    while left > 0:
        best, best_value = 0, np.inf
        for i in range(left):
            value = max(square(tree, x, lune[i]), square(tree, y, lune[i]))
            if value < best_value or (value == best_value and tree.label[lune[i]] < tree.label[lune[best]]):
                best, best_value = i, value
        queue[0] = apexes[count] = lune[best]
        count += 1
        left -= 1
        lune[best] = lune[left]
        waiting = 1
        while waiting > 0 and left > 0:
            waiting -= 1
            z, i = queue[waiting], 0
            while i < left:
                w = lune[i]
                apart = square(tree, z, w)
                if apart < length or (apart == length and before(tree, z, w, apart, x, y)):
                    queue[waiting] = w
                    waiting += 1
                    left -= 1
                    lune[i] = lune[left]
                else:
                    i += 1
    return count


@njit(cache=True)
def _is_cone(tree, x, y, length, z, far, size):
    """Whether z is in the lune of {x, y} and joined to all of it; far[:size] are the points that may not be."""
    if not in_lune(tree, z, x, y, length):
        return False
    for i in range(size):
        w = far[i]
        if w != z and in_lune(tree, w, x, y, length) and not before(tree, z, w, square(tree, z, w), x, y):
            return False
    return True


@njit(cache=True, forceinline=True)
def _near_axis(tree, x, y, length, z):
    """Whether z is so near the segment from x to y that it is nearer than the edge's length to every place of the lune.

    With z at distance b from the line and a from the middle along it, the farthest place lies on the lune's rim:
    a^2 + (sqrt(3)/2 L + b)^2 < L^2.
    """
    along, to_middle = 0.0, 0.0
    for k in range(len(tree.axes)):
        axis = tree.points[y, k] - tree.points[x, k]
        step = tree.points[z, k] - 0.5 * (tree.points[x, k] + tree.points[y, k])
        along += step * axis
        to_middle += step * step
    along = along * along / length  # squared distance from the middle, along the edge
    if along > 0.25 * length:
        return False
    across = np.sqrt(max(to_middle - along, 0.0)) + np.sqrt(0.75 * length)
    return along + across * across < length * (1.0 - 1e-9)


@njit(cache=True)
def _append(edges, size, x, y, first, further):
    """Append a row to a table that grows by doubling."""
    if size == len(edges):
        grown = np.empty((2 * size, 4), dtype=np.int64)
        grown[:size] = edges
        edges = grown
    edges[size, 0], edges[size, 1], edges[size, 2], edges[size, 3] = x, y, first, further
    return edges, size + 1


@njit(cache=True)
def special_edges(tree, shortest, longest):
    """Find the edges with an empty or a disconnected lune among those with shortest <= squared length < longest.

    Returns
    -------
    empty : (k, 2) int64
        Edges whose lune is empty.
    relations : (m, 4) int64
        Edges with a disconnected lune: the edge, the apex of the lune's first component, that of a further one; a row for
        each further component.
    """
    n = len(tree.points)
    empty, n_empty = np.empty((2 * n + 16, 4), dtype=np.int64), 0
    relations, n_relations = np.empty((n + 16, 4), dtype=np.int64), 0
    pairs = np.empty((4 * 64 + 16, 2), dtype=np.int64)
    stack = np.empty(256, dtype=np.int64)
    place = np.empty(len(tree.axes))
    far, lune, queue, apexes = (
        np.empty(n, np.int64),
        np.empty(n, np.int64),
        np.empty(n, np.int64),
        np.empty(n, np.int64),
    )
    around = np.empty(n, np.int64)
    open_edges, lengths = np.empty((64, 2), dtype=np.int64), np.empty(64)
    pairs[0, 0], pairs[0, 1] = 0, 0
    top = 0
    while top >= 0:
        a, b = pairs[top]
        top -= 1
        least, most = between_boxes(tree, a, b)
        if least >= longest or most < shortest:
            continue
        spread = centre(tree, a, b, place)
        if a != b:
            room = CONE * np.sqrt(max(least, shortest)) - spread
            if room > 0.0 and nearest_point(tree, place, room * room, room * room, stack)[0] >= 0:
                continue
        if a < tree.first_leaf:
            for i in range(1, 3):
                for j in range(1, 3):
                    if a != b or i <= j:
                        top += 1
                        pairs[top, 0], pairs[top, 1] = 2 * a + i, 2 * b + j
            continue
        # Two leaves. A central point dismisses most edges one by one.
        z = nearest_point(tree, place, np.inf, 0.0, stack)[0]
        size, low, high = 0, np.inf, 0.0
        for x in range(tree.start[a], tree.end[a]):
            for y in range(max(tree.start[b], x + 1) if a == b else tree.start[b], tree.end[b]):
                length = square(tree, x, y)
                if shortest <= length < longest and not (length > 0.0 and _near_axis(tree, x, y, length, z)):
                    open_edges[size, 0], open_edges[size, 1], lengths[size] = x, y, length
                    low, high = min(low, length), max(high, length)
                    size += 1
        if size == 0:
            continue
        n_far = _gather(tree, a, b, high, z, low, stack, far)
        n_around = -1
        for e in range(size):
            x, y, length = open_edges[e, 0], open_edges[e, 1], lengths[e]
            if _is_cone(tree, x, y, length, z, far, n_far):
                continue
            if n_around < 0:
                n_around = _gather(tree, a, b, high, z, 0.0, stack, around)
            left = 0
            for i in range(n_around):
                if in_lune(tree, around[i], x, y, length):
                    lune[left] = around[i]
                    left += 1
            count = _components(tree, x, y, length, lune, left, queue, apexes)
            if count == 0:
                empty, n_empty = _append(empty, n_empty, x, y, -1, -1)
            for i in range(1, count):
                relations, n_relations = _append(relations, n_relations, x, y, apexes[0], apexes[i])
    return empty[:n_empty, :2], relations[:n_relations]


@njit(cache=True)
def long_empty_lunes(tree, shortest):
    """Find the edges with an empty lune among those with squared length >= shortest, as (k, 2) indices into the tree.

    A point that is nearer to all of two boxes than they are to each other is in the lune of every edge between them: a point
    near the middle is tried, and the one that was tried for the boxes around them. What two leaves are left with is tried
    on the points of the leaves themselves; the few edges that remain are searched.
    """
    points, axes, start, end = tree.points, tree.axes, tree.start, tree.end
    found, size = np.empty((64, 4), dtype=np.int64), 0
    pairs, top = np.zeros((272, 3), dtype=np.int64), 0  # two boxes, and a point that may be between them
    stack, place, to_z = np.empty(256, dtype=np.int64), np.empty(len(axes)), np.empty(LEAF + 1)
    while top >= 0:
        a, b, z = pairs[top, 0], pairs[top, 1], pairs[top, 2]
        top -= 1
        least, most = between_boxes(tree, a, b)
        least = max(least, shortest)
        if most < shortest or _between(tree, z, a, b):
            continue
        if a != b:
            centre(tree, a, b, place)
            z = nearby_point(tree, place)
            if _between(tree, z, a, b):
                continue
        if a < tree.first_leaf:
            for i in range(1, 3):
                for j in range(1, 3):
                    if a != b or i <= j:
                        top += 1
                        pairs[top, 0], pairs[top, 1], pairs[top, 2] = 2 * a + i, 2 * b + j, z
            continue
        for y in range(start[b], end[b]):
            to_z[y - start[b]] = square(tree, y, z)
        for x in range(start[a], end[a]):
            x_to_z = square(tree, x, z)
            for y in range(x + 1 if a == b else start[b], end[b]):
                length = 0.0
                for k in range(len(axes)):
                    step = points[x, k] - points[y, k]
                    length += step * step
                if length < shortest or (x_to_z < length and to_z[y - start[b]] < length and z != x and z != y):
                    continue
                if _leaf_meets_lune(tree, x, y, length, a) or _leaf_meets_lune(tree, x, y, length, b):
                    continue
                if lune_vertex(tree, x, y, stack, place) < 0:
                    found, size = _append(found, size, x, y, -1, -1)
    return found[:size, :2]


@njit(cache=True, forceinline=True)
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


@njit(cache=True, forceinline=True)
def _between(tree, z, a, b):
    """Whether z is in the lune of every edge between two boxes."""
    return _is_nearer(tree, z, a, b) and _is_nearer(tree, z, b, a)


@njit(cache=True, forceinline=True)
def _leaf_meets_lune(tree, x, y, length, leaf):
    """Whether a point of a leaf is in the lune of {x, y}, edges of the same length left out."""
    for z in range(tree.start[leaf], tree.end[leaf]):
        if z not in (x, y) and square(tree, x, z) < length and square(tree, y, z) < length:
            return True
    return False
