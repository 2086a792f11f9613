"""Many clouds in one call; of clouds that differ little, the edges of one are those of the next.

Idea: in a film the points move, but hardly against their neighbours. What is listed for one frame, all edges shorter than some
`reach`, holds for the next one all that are shorter than a bound, which the points' motion gives; only their lengths are new.
Where the list ends, the tree takes over, so a bad list costs time and nothing else.

Source: Verlet 1967 (lists of neighbours).
"""

from __future__ import annotations

from collections import namedtuple

import numpy as np

from ._creators import twice_as_long
from ._edges import _BITS, EDGE_BYTES, edge_length, edges_between, ends_of, sort_edges
from ._jit import njit
from ._tree import Tree, between_boxes, bound_box, build_tree, repeats
from .kernel import pair_edges

SLACK = 1.05  # times the squared length at which the cloud before ended: this one is expected to end below
REACH = 1.3  # times that length are listed, for several clouds
ALIKE = 0.25  # of that length must be certain without a list, or the clouds have nothing to do with each other
# Of the cloud before: its tree; its edges shorter than `reach`, if they are listed; the length of the last edge that was read.
Before = namedtuple("Before", "tree keys reach end")


@njit()
def _around(tree, points):
    """The same tree of other points, which come in its order."""
    order, low, high = np.arange(len(points)), np.empty(tree.low.shape), np.empty(tree.low.shape)
    for node in range(len(low)):
        bound_box(points, order, tree.start[node], tree.end[node], low[node], high[node])
    return Tree(points, tree.label, tree.start, tree.end, low, high, tree.first_leaf, tree.axes)


@njit()
def moved(tree, points, reach):
    """The same tree of points that have moved; a squared length below which all its edges were shorter than `reach` before.

    Points of two leaves have come nearer by no more than the largest difference of a step of one and a step of the other.
    """
    places, steps = np.empty(points.shape), np.empty(points.shape)
    for i in range(len(points)):
        for k in range(len(tree.axes)):
            places[i, k] = points[tree.label[i], k]
            steps[i, k] = places[i, k] - tree.points[i, k]
    now, by, bound = _around(tree, places), _around(tree, steps), reach
    for a in range(tree.first_leaf, len(tree.low)):
        for b in range(a, len(tree.low)):
            apart = between_boxes(now, a, b)[0]
            if apart < bound:
                nearer = np.sqrt(between_boxes(by, a, b)[1])
                left = max(np.sqrt(reach) - nearer - 1e-12, 0.0)  # coordinates are at most 1
                bound = min(bound, max(apart, left * left))
    return now, bound


@njit()
def _edges_of_list(keys, tree, bound, room):
    """Find the listed edges that are shorter than a bound; their number. An end stands for a middle that was near enough."""
    size, room.waiting[0] = 0, -1
    for e in range(len(keys)):
        x, y, middle = ends_of(keys[e])
        length = edge_length(tree.points, x, y, tree.axes)
        room.found[size] = keys[e] if middle >= 0 else (x << (2 * _BITS)) | (y << _BITS) | x
        room.found_lengths[size] = length
        size += length < bound
    return size


@njit(nogil=True)
def pair_clouds(data, axes, starts, max_lengths, before, room, spare, halt):
    """Pair the edges of each cloud as `pair_edges` does, by the points' numbers in their cloud.

    The points of cloud c are data[starts[c]:starts[c + 1]]. The last array holds how many loops each cloud has, -1 when
    points are repeated: then nothing is done.
    """
    counts, total, most = np.zeros(len(max_lengths), np.int64), 0, spare // (2 * EDGE_BYTES)
    created, killed = np.empty((64, 2), np.int64), np.empty((64, 4), np.int64)
    tree, keys, reach, end = before
    for c in range(len(counts)):
        points, now, bound, m, longest = data[starts[c] : starts[c + 1]], tree, 0.0, -1, 0.0
        if len(points) < 4:
            continue
        if len(points) == len(tree.points):
            now, bound = moved(tree, points, reach if len(keys) else end)
        again = 0 < len(keys) <= len(room.found) and SLACK * end <= bound
        if not again:
            now = tree = build_tree(points, axes)
            keys = keys[:0]
        if repeats(now):
            counts[c] = -1
            continue
        if again:
            m, longest = _edges_of_list(keys, now, SLACK * end, room), SLACK * end
            sort_edges(room, m, now.label)
        elif bound > ALIKE * end:
            room.waiting[0] = 0
            room, m, longest = edges_between(tree.points, axes, tree, 0.0, REACH * end, room, most, halt)
            keys, reach = room.keys[:m].copy(), longest
        room, some, killers, end = pair_edges(now.points, axes, now, max_lengths[c], m, longest, room, spare, halt)
        counts[c] = len(some)
        while total + len(some) > len(created):
            created, killed = twice_as_long(created), twice_as_long(killed)
        for i in range(len(some)):
            for k in range(4):
                if k < 2:
                    created[total, k] = now.label[some[i, k]]
                killed[total, k] = now.label[killers[i, k]] if killers[i, k] >= 0 else -1
            total += 1
    return room, Before(tree, keys, reach, end), created[:total], killed[:total], counts
