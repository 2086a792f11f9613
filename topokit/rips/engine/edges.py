"""Edges: their lengths, the total order, and all edges between two lengths, sorted.

The `data` of a cloud are its points (n, 3), in the order of the tree, or a symmetric matrix (n, n) of distances with n > 3. The
width shows which of both, and one compiled function serves both. The "length" of an edge between points is squared here: it
orders edges alike and costs no root.

An edge is one integer, its *key*: both ends, and a vertex near its middle.
"""

from __future__ import annotations

from collections import namedtuple

import numpy as np

from . import compiled, inlined
from .tree import between_boxes

WINDOW = 1 << 22  # edges sorted at a time, unless more have one length
# Edges of a window as they are found, then in order (`keys`, `lengths`); how many come before a slice of lengths.
Edges = namedtuple("Edges", "found_keys found_lengths keys lengths slice_start")


@inlined
def are_points(data):
    """Return True for points, False for a matrix of distances."""
    return data.shape[1] == 3


@inlined
def edge_length(data, i, j):
    """Return the squared distance of two points, or the entry of a matrix; the same for (i, j) and (j, i).

    It decides ties. `_cloud.squares` is the same in NumPy, to the last bit.
    """
    if not are_points(data):
        return data[i, j]
    a = data[i, 0] - data[j, 0]
    b = data[i, 1] - data[j, 1]
    c = data[i, 2] - data[j, 2]
    return a * a + b * b + c * c


@inlined
def precedes(length, a, b, other_length, x, y):
    """Return True if the edge {a, b} comes before {x, y} in the total order, given the lengths of both."""
    if length != other_length:
        return length < other_length
    low = min(a, b)
    other_low = min(x, y)
    return low < other_low or (low == other_low and max(a, b) < max(x, y))


@inlined
def ends_of(key):
    """Return both ends of an edge, and a vertex near its middle: 21 bits each. The middle is vertex 0 until it is sought."""
    return key & 0x1FFFFF, (key >> 21) & 0x1FFFFF, key >> 42


# A window of edges ----------------------------------------------------------------------------------------------------


@compiled
def new_edges(capacity):
    """Return space for so many edges."""
    return Edges(
        np.empty(capacity, np.int64),
        np.empty(capacity),
        np.empty(capacity, np.int64),
        np.empty(capacity),
        np.empty(capacity + 2, np.int64),
    )


@compiled
def list_edges(data, tree, shortest, longest, keys, lengths):
    """Find all edges with shortest <= length < longest; return their number, -1 if there is no space for them."""
    # Names for fields of tuples, which would be counted as used in every turn of a loop.
    start = tree.start
    end = tree.end
    low = tree.low
    high = tree.high
    last_leaf = len(start) - 1
    size = np.uint64(0)  # numba looks whether an index with a sign is negative
    for a in range(tree.first_leaf, last_leaf + 1):
        b = a
        while b <= last_leaf:
            # The next leaves, all in a row, that are not too far.
            least, most = between_boxes(low, high, a, b)
            if least >= longest or (are_points(data) and most < shortest):
                b += 1
                continue
            first = start[b]
            while b <= last_leaf and between_boxes(low, high, a, b)[0] < longest:
                b += 1
            last = end[b - 1]
            for x in range(start[a], end[a]):
                if np.int64(size) + last - first > len(keys):
                    return -1
                for y in range(max(first, x + 1), last):
                    # Every edge is written, and its place is kept or not: a branch here could not be foreseen.
                    length = edge_length(data, x, y)
                    keys[size] = (y << 21) | x
                    lengths[size] = length
                    size += np.uint64((shortest <= length) & (length < longest))
    return np.int64(size)


@inlined
def key_precedes(key, length, other_key, other_length, label):
    """Return True if an edge comes before another in the total order, given keys and lengths."""
    if length != other_length:
        return length < other_length
    a, b, _ = ends_of(key)
    x, y, _ = ends_of(other_key)
    return precedes(length, label[a], label[b], length, label[x], label[y])


@compiled
def insertion_sort(keys, lengths, label, first, last, step):
    """Put keys[first:last] in the total order, each `step`-th of them among each other."""
    for e in range(first + step, last):
        key = keys[e]
        length = lengths[e]
        i = e
        while i >= first + step and key_precedes(key, length, keys[i - step], lengths[i - step], label):
            keys[i] = keys[i - step]
            lengths[i] = lengths[i - step]
            i -= step
        keys[i] = key
        lengths[i] = length


@compiled
def sort_edges(edges, m, label):
    """Put m edges in the total order: a slice of lengths holds about one edge, and insertion does the rest.

    Source: Shell 1959 (sorting with diminishing steps, for slices with many edges of almost the same length).
    """
    found_keys = edges.found_keys
    found_lengths = edges.found_lengths
    slice_start = edges.slice_start
    keys = edges.keys
    lengths = edges.lengths
    shortest = np.inf
    longest = 0.0
    for e in range(m):
        shortest = min(shortest, found_lengths[e])
        longest = max(longest, found_lengths[e])
    scale = 0.0
    if longest > shortest and m / (longest - shortest) < 1e300:  # else the number of a slice would not be finite
        scale = m / (longest - shortest)

    # Count the edges of each slice, and sum up: then slice_start[s + 1] is where slice s begins.
    for s in range(m + 2):
        slice_start[s] = 0
    for e in range(m):
        slice_start[min(int((found_lengths[e] - shortest) * scale), m - 1) + 2] += 1
    for s in range(1, m + 2):
        slice_start[s] += slice_start[s - 1]

    # Put each edge into its slice. Afterwards slice_start[s] is where slice s begins.
    for e in range(m):
        s = min(int((found_lengths[e] - shortest) * scale), m - 1) + 1
        keys[slice_start[s]] = found_keys[e]
        lengths[slice_start[s]] = found_lengths[e]
        slice_start[s] += 1

    # Sort within the slices: full ones by steps that shrink, and then all edges by insertion.
    for s in range(m):
        step = (slice_start[s + 1] - slice_start[s]) // 3
        while step > 2:
            insertion_sort(keys, lengths, label, slice_start[s], slice_start[s + 1], step)
            step = step * 4 // 9
    insertion_sort(keys, lengths, label, 0, m, 1)


@compiled
def edges_between(data, tree, shortest, longest, edges):
    """Put the edges with shortest <= length < longest, or a smaller bound, in order.

    Return the edges, perhaps in a larger space, their number, and the bound.
    """
    while True:
        m = list_edges(data, tree, shortest, longest, edges.found_keys, edges.found_lengths)
        if m >= 0:
            sort_edges(edges, m, tree.label)
            return edges, m, longest

        # Too many: take a larger space, or a shorter window where it can be shorter.
        middle = shortest + 0.5 * (longest - shortest)
        if len(edges.keys) >= WINDOW and shortest < middle < longest:
            longest = middle
        else:
            edges = new_edges(2 * len(edges.keys))


@compiled
def first_window(data):
    """Return a length below which most vertices have their nearest neighbours.

    Vertices that are next to each other in the order of a tree are near.
    """
    n = len(data)
    total = 0.0
    for x in range(n):
        nearest = np.inf
        for y in range(max(0, x - 4), min(n, x + 5)) if are_points(data) else range(n):
            if y != x:
                nearest = min(nearest, edge_length(data, x, y))
        total += np.sqrt(nearest) if are_points(data) else nearest
    if are_points(data):
        return (3.0 * total / n) ** 2
    return 2.0 * total / n


@compiled
def next_window(shortest, longest, m, some):
    """Return the bound of the window after one with m edges: about `some` edges, if these are not fewer than m."""
    ratio = max(1.0, some / (m + 1))
    return longest + max(min(longest, ratio * (longest - shortest)), 1e-6 * longest)
