"""Edges of a point cloud or of a matrix of distances, a window of lengths at a time, in the total order.

A cloud comes as a kd-tree (`_tree`), whose boxes are walked in pairs so that only edges of about the right length are
looked at. For a cloud a "length" here is squared: it orders edges alike and costs no root. `edge_length` decides ties, so
all compiled code asks it, and `_cloud.squares` is its like in NumPy, the same to the last bit.
"""

from __future__ import annotations

from collections import namedtuple

import numpy as np

from ._jit import njit
from ._tree import LEAF, between_boxes, centre, nearby_point

WINDOW = 1 << 22  # edges at a time, unless more have one length
FEW_POINTS = 4096  # so few that edges too long for a window are kept for the next one
EDGE_BYTES = 108  # of room for an edge while it is sorted
# A lune lies within sqrt(3)/2 of its edge's length from the midpoint: what is within the rest is joined to all of it.
CONE = (1.0 - np.sqrt(0.75)) * (1.0 - 1e-9)
ROUNDING = 4e-16  # of a place that is a mean of coordinates, which are at most 1
HALTED, TOO_MANY_EDGES, TOO_MANY_LOOPS = 1, 2, 3  # in `halt[0]`: an exception would not give memory back
FEW = 8  # edges that insertion sorts as quickly as anything
_BITS = 21  # of an int64 for a vertex, three times: two million vertices
_MASK = (1 << _BITS) - 1
# Edges as they are found, and in order: `keys` for `ends_of`, and lengths. How many are before a slice of lengths. Edges that
# wait for a later window, and their number (-1: none was kept waiting).
Room = namedtuple("Room", "found found_lengths keys lengths start later later_lengths waiting")


@njit(forceinline=True)
def edge_length(data, i, j, axes):
    """The entry of a matrix (no axes), or the squared distance of two points; the same for (i, j) and (j, i)."""
    if len(axes) == 0:
        return data[i, j]
    total = 0.0
    for k in range(len(axes)):
        step = data[i, k] - data[j, k]
        total += step * step
    return total


@njit(forceinline=True)
def precedes(length, a, b, other, x, y):
    """Whether the edge {a, b} comes before {x, y} in the total order, given the lengths of both."""
    if length != other:
        return length < other
    low, least = min(a, b), min(x, y)
    return low < least or (low == least and max(a, b) < max(x, y))


@njit()
def new_room(capacity):
    """Arrays for `edges_between`, handed on as fresh memory is slow."""
    return Room(
        np.empty(capacity, np.int64),
        np.empty(capacity),
        np.empty(capacity, np.int64),
        np.empty(capacity),
        np.empty(capacity + 2, np.int32),
        np.empty(capacity, np.int64),
        np.empty(capacity),
        np.zeros(1, np.int64),
    )


@njit()
def _larger(room, capacity):
    """More room, with the edges that wait."""
    more = new_room(capacity)
    more.waiting[0] = room.waiting[0]
    for e in range(room.waiting[0]):
        more.later[e], more.later_lengths[e] = room.later[e], room.later_lengths[e]
    return more


@njit(forceinline=True)
def ends_of(key):
    """Both ends of an edge, and a vertex near its middle; negative when one is so near that the lune is a cone."""
    return key & _MASK, (key >> _BITS) & _MASK, key >> (2 * _BITS)


@njit(forceinline=True)
def _middle(tree, a, b, shortest, place):
    """A vertex near the middle of the edges between two leaves; -1 when one is near enough for the lunes to be cones."""
    spread = centre(tree, a, b, place)
    middle, apart = nearby_point(tree, place)
    near = CONE * np.sqrt(shortest) - spread - ROUNDING
    return -1 if near > 0.0 and apart < near * near else middle


@njit()
def _edges_of_points(tree, shortest, longest, room):
    """Find all edges with shortest <= squared length < longest by walking pairs of boxes; their number, -1 if room is short.

    Of few points, two leaves are looked at once: when the window reaches their nearest places. Their longer edges wait.
    """
    points, axes, start, end = tree.points, tree.axes, tree.start, tree.end
    found, lengths, later, later_lengths = room.found, room.found_lengths, room.later, room.later_lengths
    pairs, top, size, waiting = np.zeros((272, 2), dtype=np.int64), 0, 0, room.waiting[0]
    place = np.empty(len(axes))
    once = len(points) <= FEW_POINTS and waiting >= 0
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
        if once and least < shortest:
            continue
        if max(size, waiting) + LEAF * LEAF > len(found):
            return -1
        middle = _middle(tree, a, b, max(least, shortest), place) << (2 * _BITS)
        for x in range(start[a], end[a]):
            for y in range(x + 1 if a == b else start[b], end[b]):
                length = edge_length(points, x, y, axes)
                found[size] = later[waiting] = middle | (y << _BITS) | x
                lengths[size] = later_lengths[waiting] = length
                size += (shortest <= length) & (length < longest)  # no branch: it could not be foreseen
                waiting += once & (length >= longest)
    return _take_waiting(room, longest, size, waiting) if once else size


@njit()
def _take_waiting(room, longest, size, waiting):
    """Move the edges that have waited for this window, of `waiting` in all, behind `size` others; -1 if room is short."""
    if size + room.waiting[0] > len(room.found):
        return -1
    still = 0
    for e in range(waiting):
        key, length = room.later[e], room.later_lengths[e]
        if e < room.waiting[0]:  # the others are of this window's leaves, and too long for it
            room.found[size], room.found_lengths[size] = key, length
            size += length < longest
        room.later[still], room.later_lengths[still] = key, length
        still += length >= longest
    room.waiting[0] = still
    return size


@njit()
def _edges_of_matrix(data, shortest, longest, keys, lengths):
    """Find all edges with shortest <= length < longest; their number, -1 if room is short. One end stands for the middle."""
    size = 0
    for x in range(len(data)):
        if size + len(data) - x > len(keys):
            return -1
        for y in range(x + 1, len(data)):
            keys[size] = (x << (2 * _BITS)) | (y << _BITS) | x
            lengths[size] = length = data[x, y]
            size += (shortest <= length) & (length < longest)
    return size


@njit(forceinline=True)
def _comes_before(key, length, other_key, other_length, label):
    if length != other_length:
        return length < other_length
    a, b, _ = ends_of(key)
    x, y, _ = ends_of(other_key)
    return precedes(length, label[a], label[b], length, label[x], label[y])


@njit()
def _sort_slice(keys, lengths, label):
    """Put edges in the total order, however many have almost the same length: a heap, whose last edge leaves it first."""
    size = len(keys)
    for step in range(size + (size >> 1)):
        if step < size >> 1:
            parent, end = (size >> 1) - 1 - step, size
        else:
            parent, end = 0, size - 1 - (step - (size >> 1))
            keys[0], keys[end] = keys[end], keys[0]
            lengths[0], lengths[end] = lengths[end], lengths[0]
        key, length = keys[parent], lengths[parent]
        child = 2 * parent + 1
        while child < end:
            if child + 1 < end and _comes_before(
                keys[child], lengths[child], keys[child + 1], lengths[child + 1], label
            ):
                child += 1
            if not _comes_before(key, length, keys[child], lengths[child], label):
                break
            keys[parent], lengths[parent] = keys[child], lengths[child]
            parent, child = child, 2 * child + 1
        keys[parent], lengths[parent] = key, length


@njit()
def sort_edges(room, m, label):
    """Put m edges in the total order: a slice of lengths holds about one edge, and insertion does the rest."""
    keys, lengths, start = room.found, room.found_lengths, room.start
    sorted_keys, sorted_lengths = room.keys, room.lengths
    shortest, longest = np.inf, 0.0
    for e in range(m):
        shortest, longest = min(shortest, lengths[e]), max(longest, lengths[e])
    scale = m / (longest - shortest) if longest > shortest else 0.0
    if not scale < 1e300:  # tiny distances: the place of a slice would not be a number
        scale = 0.0
    start[: m + 2] = 0
    for e in range(m):
        start[min(int((lengths[e] - shortest) * scale), m - 1) + 2] += 1
    for s in range(1, m + 2):
        start[s] += start[s - 1]
    for e in range(m):
        s = min(int((lengths[e] - shortest) * scale), m - 1) + 1
        sorted_keys[start[s]], sorted_lengths[start[s]] = keys[e], lengths[e]
        start[s] += 1
    for s in range(m):
        if start[s + 1] - start[s] > FEW:
            _sort_slice(sorted_keys[start[s] : start[s + 1]], sorted_lengths[start[s] : start[s + 1]], label)
    for e in range(1, m):
        key, length, i = sorted_keys[e], sorted_lengths[e], e
        if length > sorted_lengths[i - 1]:
            continue  # without a call, for which numba would count uses of `label`
        while i > 0 and _comes_before(key, length, sorted_keys[i - 1], sorted_lengths[i - 1], label):
            sorted_keys[i], sorted_lengths[i] = sorted_keys[i - 1], sorted_lengths[i - 1]
            i -= 1
        sorted_keys[i], sorted_lengths[i] = key, length


@njit()
def edges_between(data, axes, tree, shortest, longest, room, most, halt):
    """Put the edges with shortest <= length < longest, or a smaller bound, in order; return `room`, their number, the bound."""
    while True:
        if len(axes) == 0:
            m = _edges_of_matrix(data, shortest, longest, room.found, room.found_lengths)
        else:
            m = _edges_of_points(tree, shortest, longest, room)
        if m >= 0:
            sort_edges(room, m, tree.label)
            return room, m, longest
        middle = shortest + 0.5 * (longest - shortest)
        if len(room.found) >= min(WINDOW, most) and shortest < middle < longest:
            longest = middle
        elif len(room.found) < most:
            room = _larger(room, min(2 * len(room.found), most))
        else:
            halt[0] = TOO_MANY_EDGES
            return room, 0, longest


@njit()
def next_window(data, axes, shortest, longest, m):
    """The bound of the window after one with m edges: as many again or more, and not too many more."""
    growth = 0.5 * longest if len(axes) == 0 or len(data) <= FEW_POINTS else longest
    ratio = max(1.0, 0.5 * WINDOW / (m + 1))
    return longest + max(min(growth, ratio * (longest - shortest)), 1e-6 * longest)


@njit()
def greatest_length(data, axes, tree):
    """An upper bound of all lengths."""
    return data.max() if len(axes) == 0 else between_boxes(tree, 0, 0)[1]


@njit()
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
    return max(first, 1e-6 * greatest_length(data, axes, tree), 5e-324)
