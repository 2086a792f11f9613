"""Many clouds in one call; of clouds that differ little, the edges of one are those of the next.

Idea: in a film the points move, but hardly against their neighbours. What is listed for one frame, all edges shorter than some
`reach`, holds for the next one all that are shorter than a bound, which the points' motion gives; only their lengths are new.
Where the list ends, the tree takes over, so a bad list costs time and nothing else.

Source: Verlet 1967 (lists of neighbours).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from ._creators import twice_as_long
from ._edges import _BITS, EDGE_BYTES, FEW_POINTS, Room, edge_length, edges_between, ends_of, first_window, sort_edges
from ._jit import njit
from ._tree import Tree, between_boxes, bound_box, build_tree, repeats
from .kernel import pair_edges

SLACK = 1.05  # times the squared length at which the cloud before ended: this one is expected to end below
REACH = 1.3  # times that length are listed, for several clouds
ALIKE = 0.25  # of that length must be certain without a list, or the clouds have nothing to do with each other


@njit()
def nothing_before(axes):
    """What is known of the cloud before, where there is none."""
    return _before(build_tree(np.zeros((1, len(axes))), axes), np.empty(0, np.int64), False, 0.0, 0.0)


@njit()
def _before(tree, keys, listed, reach, end):
    """A cloud's tree; all edges shorter than `reach`, unless none is listed; where it ended. Plain tuples reach numba sooner."""
    known = np.array([1.0 * listed, reach, end])
    return tree.points, tree.label, tree.start, tree.end, tree.low, tree.high, keys, known


@njit()
def _moved(tree, points):
    """The same tree of points that have moved, with its boxes around them."""
    ordered, low, high = np.empty(points.shape), np.empty(tree.low.shape), np.empty(tree.low.shape)
    for i in range(len(points)):
        for k in range(len(tree.axes)):
            ordered[i, k] = points[tree.label[i], k]
    for node in range(len(tree.start)):
        bound_box(points, tree.label, tree.start[node], tree.end[node], low[node], high[node])
    return Tree(ordered, tree.label, tree.start, tree.end, low, high, tree.first_leaf, tree.axes)


@njit()
def _complete_below(tree, moved, reach):
    """A squared length below which all edges of the moved tree were shorter than `reach` before.

    Points of two leaves have come nearer by no more than the largest difference of a step of one and a step of the other.
    """
    first, n_leaves, bound = tree.first_leaf, tree.first_leaf + 1, reach
    low, high = np.empty((n_leaves, 3)), np.empty((n_leaves, 3))
    for a in range(n_leaves):
        for k in range(3):
            low[a, k], high[a, k] = np.inf, -np.inf
            for i in range(tree.start[first + a], tree.end[first + a]):
                step = moved.points[i, k] - tree.points[i, k]
                low[a, k], high[a, k] = min(low[a, k], step), max(high[a, k], step)
    for a in range(n_leaves):
        for b in range(a, n_leaves):
            apart = between_boxes(moved, first + a, first + b)[0]
            if apart < bound:
                nearer = 0.0
                for k in range(3):
                    nearer += max(high[a, k] - low[b, k], high[b, k] - low[a, k]) ** 2
                left = max(np.sqrt(reach) - np.sqrt(nearer) - 1e-12, 0.0)  # coordinates are at most 1
                bound = min(bound, max(apart, left * left))
    return bound


@njit()
def room_of(room):
    """The arrays of a room, as a plain tuple."""
    found, found_lengths, keys, lengths, start, later, later_lengths, waiting = room
    return found, found_lengths, keys, lengths, start, later, later_lengths, waiting


@njit()
def _as_list(room, m):
    """The edges of a window, to be kept; an end stands for a middle that was near enough."""
    keys = np.empty(m, np.int64)
    for e in range(m):
        x, y, middle = ends_of(room.keys[e])
        keys[e] = room.keys[e] if middle >= 0 else (x << (2 * _BITS)) | (y << _BITS) | x
    return keys


@njit()
def _edges_of_list(keys, tree, bound, room):
    """Put the listed edges that are shorter than a bound in order; their number."""
    size = 0
    for e in range(len(keys)):
        x, y, _ = ends_of(keys[e])
        length = edge_length(tree.points, x, y, tree.axes)
        room.found[size], room.found_lengths[size] = keys[e], length
        size += length < bound
    sort_edges(room, size, tree.label)
    return size


@njit(nogil=True)
def pair_clouds(data, axes, starts, max_lengths, before, room, spare):
    """Pair the edges of each cloud as `pair_edges` does, by the points' numbers in their cloud.

    The points of cloud c are data[starts[c]:starts[c + 1]]. The last array holds how many loops each cloud has, -1 when
    points are repeated: then nothing is done.
    """
    counts, total, most = np.zeros(len(max_lengths), np.int64), 0, spare // (2 * EDGE_BYTES)
    created, killed = np.empty((64, 2), np.int64), np.empty((64, 4), np.int64)
    places, label, start, stop, low, high, keys, known = before
    tree, room = Tree(places, label, start, stop, low, high, len(start) >> 1, axes), Room(*room)
    listed, reach, end = known[0] > 0, known[1], known[2]
    for c in range(len(counts)):
        points, bound = data[starts[c] : starts[c + 1]], 0.0
        if len(points) < 4:
            continue
        now = tree
        if len(points) == len(tree.points) and len(points) <= FEW_POINTS:
            now = _moved(tree, points)
            bound = _complete_below(tree, now, reach)
        again = listed and 0.0 < SLACK * end <= bound
        if not again:
            now = tree = build_tree(points, axes)
            listed, reach = False, 0.0
        if repeats(now):
            counts[c] = -1
            continue
        if now.low[0, 1] == now.high[0, 1] and now.low[0, 2] == now.high[0, 2]:
            continue  # on a line
        if again:
            longest, room.waiting[0] = SLACK * end, -1
            m = _edges_of_list(keys, now, longest, room)
        else:
            listed, room.waiting[0] = bound > ALIKE * end, 0
            longest = REACH * end if listed else first_window(tree.points, axes, tree)
            room, m, longest = edges_between(tree.points, axes, tree, 0.0, longest, room, most)
            if listed:
                keys, reach = _as_list(room, m), longest
        room, some, killers, end = pair_edges(now.points, axes, now, max_lengths[c], room, m, longest, spare)
        if not listed:
            reach = end
        counts[c] = len(some)
        while total + len(some) > len(created):
            created, killed = twice_as_long(created), twice_as_long(killed)
        for i in range(len(some)):
            for k in range(4):
                if k < 2:
                    created[total, k] = now.label[some[i, k]]
                killed[total, k] = now.label[killers[i, k]] if killers[i, k] >= 0 else -1
            total += 1
    return _before(tree, keys, listed, reach, end), room_of(room), created[:total], killed[:total], counts


@njit(nogil=True)
def pair_matrix(data, axes, space, max_length, room, spare):
    """The same for a matrix of distances, with no axes; its tree is of points in `space`, for which it is compiled anyway."""
    one, most, room = build_tree(np.zeros((1, len(space))), space), spare // (2 * EDGE_BYTES), Room(*room)
    tree = Tree(one.points, np.arange(len(data)), one.start, one.end, one.low, one.high, one.first_leaf, space)
    longest = first_window(data, axes, tree)
    room.waiting[0] = 0
    room, m, longest = edges_between(data, axes, tree, 0.0, longest, room, most)
    room, created, killed, _ = pair_edges(data, axes, tree, max_length, room, m, longest, spare)
    return room_of(room), created, killed
