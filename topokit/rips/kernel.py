"""The compiled kernel of degree-1 Rips persistence: lunes as the AND of two bitsets.

Idea: edges arrive in the total order (length, smaller index, larger index). Every vertex keeps a bitset of the vertices that
it is joined to, so the *lune* of an arriving edge {x, y}, all that is joined to both, is row x AND row y. There are four cases.

- Most lunes are cones: one vertex is joined to all the others. It is near the middle of the edge, where a grid gives it. Such
  an edge changes nothing.
- An empty lune joins two components or creates a loop; the edge is then a *creator*.
- A connected lune changes nothing.
- Each further component of a disconnected lune brings a relation x, z_i, y, z_1: a cycle that bounds from now on. Written in
  creators and reduced, it may kill one loop.

Triangles are never listed. The work ends when no loop is alive and no later edge has an empty lune.

The sections of this file follow the data: lengths and their order, bits, a kd-tree of the points, edges a window at a time,
lunes, relations between loops, when to stop, the pairing itself, and large clouds, which are paired without bitsets.
Functions that Python calls take plain arrays and tuples, and their compiled code is kept; the others are compiled into them.

Source: Koyama, Memoli, Robins, Turner 2023 (the reduced Vietoris-Rips filtration). Read in appendix B.
"""

from __future__ import annotations

from collections import namedtuple

import numpy as np

from ._numba import njit

__all__ = ["is_cone", "is_connected", "pair_edges", "reduce_column"]

# What a kernel writes into `stop[0]` when it ends early. It raises no exception, because that would not give memory back.
# A thread that ends the run of another writes 1.
TOO_MANY_EDGES = 2
TOO_MANY_LOOPS = 3

WINDOW = 1 << 22  # edges sorted at a time, unless more have one length
EDGE_BYTES = 36  # bytes of an `EdgeBuffer` for an edge
FEW_EDGES = 8  # number of edges up to which insertion sort is fastest
FEW_WORDS = 32  # length of a row up to which reading it is as quick as comparing places
SPACE = 3  # coordinates of a point
ALIKE = 0.1  # largest share by which the squared lengths differ at which two clouds that are alike end
FIRST = 3.0  # length of the first window, in mean distances to a nearest neighbour
LEAF = 8  # largest number of points in a leaf of the tree
ROUNDING = 4e-16  # error of a place that is a mean of coordinates, which are at most 1
CELLS = 8  # cells of a grid for each point
GRID_WORDS = 4  # length of a row from which on a vertex near the middle of an edge is looked up


# Lengths and the total order ------------------------------------------------------------------------------------------
#
# A cloud's `data` are its points (n, 3), or a symmetric matrix (n, n) of distances with n > 3. The width shows which of both,
# and one compiled function serves both. The "length" of an edge between points is squared here: it orders edges alike and costs
# no root.


@njit(forceinline=True)
def edge_length(data, i, j):
    """Return the squared distance of two points, or the entry of a matrix; the same for (i, j) and (j, i).

    It decides ties. `_cloud.squares` is the same in NumPy, to the last bit.
    """
    if data.shape[1] != SPACE:
        return data[i, j]
    a = data[i, 0] - data[j, 0]
    b = data[i, 1] - data[j, 1]
    c = data[i, 2] - data[j, 2]
    return a * a + b * b + c * c


@njit(forceinline=True)
def precedes(length, a, b, other_length, x, y):
    """Return True if the edge {a, b} comes before {x, y} in the total order, given the lengths of both."""
    if length != other_length:
        return length < other_length
    low = min(a, b)
    other_low = min(x, y)
    return low < other_low or (low == other_low and max(a, b) < max(x, y))


# Bits -----------------------------------------------------------------------------------------------------------------

ONE = np.uint64(1)
# The powers of two differ modulo 67, so that the remainder determines which bit is set.
_BIT_OF_REMAINDER = np.zeros(67, dtype=np.int64)
for _bit in range(64):
    _BIT_OF_REMAINDER[2**_bit % 67] = _bit


@njit(forceinline=True)
def lowest_bit(word):
    """Return the position of the lowest bit that is set."""
    return _BIT_OF_REMAINDER[(word & (~word + ONE)) % np.uint64(67)]


@njit(forceinline=True)
def has_bit(bits, i):
    """Return bit i of a bitset, as the number 0 or 1."""
    return (bits[i >> 6] >> np.uint64(i & 63)) & ONE


@njit(forceinline=True)
def join(rows, x, y):
    """Set the bits of the edge {x, y}."""
    rows[x, y >> 6] |= ONE << np.uint64(y & 63)
    rows[y, x >> 6] |= ONE << np.uint64(x & 63)


@njit()
def twice_as_long(table):
    """Return a table of integers with space for as many rows again; a loop compiles ten times as fast as `np.concatenate`."""
    longer = np.empty((2 * len(table), table.shape[1]), np.int64)
    for i in range(len(table)):
        for k in range(table.shape[1]):
            longer[i, k] = table[i, k]
    return longer


# A kd-tree ------------------------------------------------------------------------------------------------------------
#
# The tree is balanced and lies in flat arrays. Node i has the children 2 i + 1 and 2 i + 2; all leaves are on one level and
# hold 4 to 8 points. Points are stored in the order of the leaves, so that what is near in space is near in memory; `label`
# holds their numbers in the cloud. The points of a node are `points[start[node]:end[node]]`, in the box from `low` to `high`.

Tree = namedtuple("Tree", "points label start end low high first_leaf")


@njit()
def bound_box(points, order, start, end, low, high):
    """Write the corners of the box of points[order[start:end]] into `low` and `high`; return its longest axis."""
    axis = 0
    for k in range(len(low)):
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


@njit()
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


@njit()
def build_tree(points):
    """Build the tree of an (n, 3) cloud, n >= 1."""
    n = len(points)
    depth = 0
    while n > LEAF << depth:
        depth += 1
    first_leaf = (1 << depth) - 1
    n_nodes = 2 * first_leaf + 1
    order = np.arange(n)
    start = np.zeros(n_nodes, dtype=np.int64)
    end = np.zeros(n_nodes, dtype=np.int64)
    low = np.empty((n_nodes, SPACE))
    high = np.empty((n_nodes, SPACE))

    # Halve the points of each node at the median of its longest axis.
    end[0] = n
    for node in range(n_nodes):
        axis = bound_box(points, order, start[node], end[node], low[node], high[node])
        if node < first_leaf:
            middle = (start[node] + end[node]) >> 1
            put_in_place(points, axis, order, start[node], end[node] - 1, middle)
            start[2 * node + 1] = start[node]
            end[2 * node + 1] = middle
            start[2 * node + 2] = middle
            end[2 * node + 2] = end[node]

    ordered = np.empty((n, SPACE))
    for i in range(n):
        for k in range(SPACE):
            ordered[i, k] = points[order[i], k]
    return Tree(ordered, order, start, end, low, high, first_leaf)


@njit()
def _no_tree(n):
    """Return a tree with one leaf, of the n vertices of a matrix."""
    nothing = np.zeros((1, SPACE))
    return Tree(nothing, np.arange(n), np.zeros(1, np.int64), np.full(1, n), nothing, nothing, 0)


@njit()
def has_repeats(tree):
    """Return True if neighbours in the tree's order show that a point occurs twice."""
    for i in range(len(tree.points) - 1):
        same = True
        for k in range(SPACE):
            same = same and tree.points[i, k] == tree.points[i + 1, k]
        if same:
            return True
    return False


@njit(forceinline=True)
def place_to_point(place, points, z):
    """Return the squared distance from a place to a point."""
    square = 0.0
    for k in range(SPACE):
        step = points[z, k] - place[k]
        square += step * step
    return square


@njit(forceinline=True)
def place_to_box(low, high, place, node):
    """Return the smallest squared distance from a place to the box of a node."""
    total = 0.0
    for k in range(SPACE):
        step = max(low[node, k] - place[k], place[k] - high[node, k], 0.0)
        total += step * step
    return total


@njit(forceinline=True)
def between_boxes(low, high, a, b):
    """Return the smallest and the largest squared distance between places of two boxes."""
    least = 0.0
    most = 0.0
    for k in range(SPACE):
        gap = max(low[a, k] - high[b, k], low[b, k] - high[a, k], 0.0)
        span = max(high[a, k] - low[b, k], high[b, k] - low[a, k])
        least += gap * gap
        most += span * span
    return least, most


@njit(forceinline=True)
def middle_of_boxes(low, high, a, b, place):
    """Write the middle between two boxes into `place`."""
    for k in range(SPACE):
        place[k] = 0.25 * (low[a, k] + high[a, k] + low[b, k] + high[b, k])


@njit(forceinline=True)
def push_children(low, high, node, place, nodes, top):
    """Put the children of a node on a stack of nodes, the one nearer to a place last; return the new top."""
    nearer = 2 * node + 1
    farther = 2 * node + 2
    if place_to_box(low, high, place, farther) < place_to_box(low, high, place, nearer):
        nearer, farther = farther, nearer
    nodes[top + 1] = farther
    nodes[top + 2] = nearer
    return top + 2


@njit(forceinline=True)
def _push_pairs(a, b, z, box_pairs, top):
    """Put the pairs of children of two nodes on a stack, with a point that may be between them; return the new top."""
    for i in range(1, 3):
        for j in range(1, 3):
            if a != b or i <= j:
                top += 1
                box_pairs[top, 0] = 2 * a + i
                box_pairs[top, 1] = 2 * b + j
                box_pairs[top, 2] = z
    return top


@njit(forceinline=True)
def reach_of_lune(points, x, y, length, place):
    """Write the midpoint of {x, y} into `place`; return the square of how far from it a point of the lune may be."""
    for k in range(SPACE):
        place[k] = 0.5 * (points[x, k] + points[y, k])
    return (0.86605 * np.sqrt(length) + ROUNDING) ** 2  # a lune lies within sqrt(3)/2 of the length


@njit()
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


# Edges, a window of lengths at a time ---------------------------------------------------------------------------------
#
# Pairs of leaves of the tree are passed over when they are too far apart. An edge is one integer, its *key*: both ends, and a
# vertex near its middle.

_BITS = 21  # bits of a key for a vertex, three times: two million vertices
_MASK = (1 << _BITS) - 1
# Edges of a window as they are found, then in order (`keys`, `lengths`); how many come before a slice of lengths.
EdgeBuffer = namedtuple("EdgeBuffer", "found_keys found_lengths keys lengths slice_start")


@njit(cache=True)
def new_buffer(capacity):
    """Return arrays for `edges_between`; they are handed on from call to call, as fresh memory is slow."""
    return EdgeBuffer(
        np.empty(capacity, np.int64),
        np.empty(capacity),
        np.empty(capacity, np.int64),
        np.empty(capacity),
        np.empty(capacity + 2, np.int32),
    )


@njit()
def as_arrays(buffer):
    """Return the arrays of a buffer as a plain tuple, for Python."""
    return buffer.found_keys, buffer.found_lengths, buffer.keys, buffer.lengths, buffer.slice_start


@njit(forceinline=True)
def edge_key(x, y):
    """Return the key of the edge {x, y}, with vertex 0 for its middle."""
    return (y << _BITS) | x


@njit(forceinline=True)
def ends_of(key):
    """Return both ends of an edge, and a vertex near its middle; negative when one is so near that the lune is a cone."""
    return key & _MASK, (key >> _BITS) & _MASK, key >> (2 * _BITS)


@njit()
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
            if between_boxes(low, high, a, b)[0] >= longest:
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
                    keys[size] = edge_key(x, y)
                    lengths[size] = length
                    size += np.uint64((shortest <= length) & (length < longest))
    return np.int64(size)


@njit(forceinline=True)
def _key_precedes(key, length, other_key, other_length, label):
    """Return True if an edge comes before another in the total order, given keys and lengths."""
    if length != other_length:
        return length < other_length
    a, b, _ = ends_of(key)
    x, y, _ = ends_of(other_key)
    return precedes(length, label[a], label[b], length, label[x], label[y])


@njit()
def heap_sort(keys, lengths, label):
    """Put edges in the total order, however many have almost the same length: the last edge of a heap leaves it first."""
    size = len(keys)
    half = size >> 1
    for step in range(size + half):
        if step < half:  # build the heap, from its last parent up
            parent = half - 1 - step
            end = size
        else:  # take its last edge out, and let the edge that was put in its place sink
            parent = 0
            end = size - 1 - (step - half)
            keys[0], keys[end] = keys[end], keys[0]
            lengths[0], lengths[end] = lengths[end], lengths[0]
        key = keys[parent]
        length = lengths[parent]
        child = 2 * parent + 1
        while child < end:
            if child + 1 < end and _key_precedes(
                keys[child], lengths[child], keys[child + 1], lengths[child + 1], label
            ):
                child += 1
            if not _key_precedes(key, length, keys[child], lengths[child], label):
                break
            keys[parent] = keys[child]
            lengths[parent] = lengths[child]
            parent = child
            child = 2 * child + 1
        keys[parent] = key
        lengths[parent] = length


@njit()
def sort_edges(buffer, m, label):
    """Put m edges in the total order: a slice of lengths holds about one edge, and insertion does the rest."""
    keys = buffer.found_keys
    lengths = buffer.found_lengths
    slice_start = buffer.slice_start
    sorted_keys = buffer.keys
    sorted_lengths = buffer.lengths
    shortest = np.inf
    longest = 0.0
    for e in range(m):
        shortest = min(shortest, lengths[e])
        longest = max(longest, lengths[e])
    scale = 0.0
    if longest > shortest and m / (longest - shortest) < 1e300:  # else the number of a slice would not be finite
        scale = m / (longest - shortest)

    # Count the edges of each slice, and sum up: then slice_start[s + 1] is where slice s begins.
    slice_start[: m + 2] = 0
    for e in range(m):
        slice_start[min(int((lengths[e] - shortest) * scale), m - 1) + 2] += 1
    for s in range(1, m + 2):
        slice_start[s] += slice_start[s - 1]

    # Put each edge into its slice. Afterwards slice_start[s] is where slice s begins.
    for e in range(m):
        s = min(int((lengths[e] - shortest) * scale), m - 1) + 1
        sorted_keys[slice_start[s]] = keys[e]
        sorted_lengths[slice_start[s]] = lengths[e]
        slice_start[s] += 1

    # Sort within the slices: full ones by a heap, and then all edges by insertion.
    for s in range(m):
        first = slice_start[s]
        last = slice_start[s + 1]
        if last - first > FEW_EDGES:
            heap_sort(sorted_keys[first:last], sorted_lengths[first:last], label)
    for e in range(1, m):
        key = sorted_keys[e]
        length = sorted_lengths[e]
        i = e
        if length > sorted_lengths[i - 1]:
            continue  # without a call, for which numba would count uses of `label`
        while i > 0 and _key_precedes(key, length, sorted_keys[i - 1], sorted_lengths[i - 1], label):
            sorted_keys[i] = sorted_keys[i - 1]
            sorted_lengths[i] = sorted_lengths[i - 1]
            i -= 1
        sorted_keys[i] = key
        sorted_lengths[i] = length


@njit()
def edges_between(data, tree, shortest, longest, buffer, max_edges, stop):
    """Put the edges with shortest <= length < longest, or a smaller bound, in order.

    Return the buffer, which may be a larger one, the number of edges, and the bound.
    """
    while True:
        m = list_edges(data, tree, shortest, longest, buffer.found_keys, buffer.found_lengths)
        if m >= 0:
            sort_edges(buffer, m, tree.label)
            return buffer, m, longest

        # Too many: take a shorter window; where it is as short as can be, a larger buffer.
        middle = shortest + 0.5 * (longest - shortest)
        capacity = len(buffer.keys)
        if capacity >= min(WINDOW, max_edges) and shortest < middle < longest:
            longest = middle
        elif capacity < max_edges:
            buffer = new_buffer(min(2 * capacity, max_edges))
        else:
            stop[0] = TOO_MANY_EDGES
            return buffer, 0, longest


@njit()
def first_window(data):
    """Return a length below which most vertices have their nearest neighbours.

    Vertices that are next to each other in the order of a tree are near.
    """
    n = len(data)
    total = 0.0
    for x in range(n):
        nearest = np.inf
        for y in range(max(0, x - 4), min(n, x + 5)) if data.shape[1] == SPACE else range(n):
            if y != x:
                nearest = min(nearest, edge_length(data, x, y))
        total += np.sqrt(nearest) if data.shape[1] == SPACE else nearest
    if data.shape[1] == SPACE:
        return (FIRST * total / n) ** 2
    return 2.0 * total / n


@njit()
def next_window(data, shortest, longest, m):
    """Return the bound of the window after one with m edges: as many again or more, and not too many more."""
    ratio = max(1.0, 0.5 * WINDOW / (m + 1))
    return longest + max(min(longest, ratio * (longest - shortest)), 1e-6 * longest)


# Lunes ----------------------------------------------------------------------------------------------------------------
#
# `rows` (n, words) holds for each vertex the bitset of the vertices that it is joined to; a vertex is joined to itself.

# Two bitsets of vertices, a list of vertices that wait, and the apexes of components with the longer edge of each.
LuneSearch = namedtuple("LuneSearch", "lune left waiting apexes values")


@njit(forceinline=True)
def is_cone(rows, x, y, z):
    """Return True if z is in the lune of {x, y} and joined to all of it."""
    if not (rows[x, z >> 6] & rows[y, z >> 6]) >> np.uint64(z & 63) & ONE:
        return False
    outside = np.uint64(0)
    for w in range(rows.shape[1]):
        outside |= rows[x, w] & rows[y, w] & ~rows[z, w]
    return outside == 0


@njit(forceinline=True)
def is_near_middle(data, x, y, z, length):
    """Return True if z is nearer than the length of {x, y} to every place where a point of the lune can be.

    With z at distance b from the line through x and y, and a from their midpoint along it, the farthest such place is on the
    lune's rim: a^2 + (sqrt(3)/2 L + b)^2 < L^2. For a matrix it is never known.
    """
    if data.shape[1] != SPACE or length == 0.0 or z in (x, y):
        return False
    along = 0.0
    apart = 0.0
    for k in range(SPACE):
        # In this order it is exact for what is very near.
        step = 0.5 * ((data[z, k] - data[x, k]) + (data[z, k] - data[y, k]))
        along += step * (data[y, k] - data[x, k])
        apart += step * step
    along = along * along / length
    across = np.sqrt(max(apart - along, 0.0)) + np.sqrt(0.75 * length)
    return along <= 0.25 * length and along + across * across < length * (1.0 - 1e-9)


@njit(forceinline=True)
def _write_lune(rows, x, y, lune):
    """Write the lune of {x, y} into the bitset `lune`; return its first vertex, -1 when it is empty."""
    for w in range(len(lune)):
        lune[w] = rows[x, w] & rows[y, w]
    for w in range(len(lune)):
        if lune[w]:
            return (w << 6) + lowest_bit(lune[w])
    return -1


@njit(forceinline=True)
def is_connected(rows, lune, z, left):
    """Return True if a lune is connected; False may also mean that the order was unlucky, and the full search decides.

    Vertices that z reaches are absorbed, and then, one by one, vertices that share a neighbour in the lune with those.
    `left` (words,) is space for a bitset.
    """
    words = len(lune)
    some_left = np.uint64(0)
    for w in range(words):
        left[w] = lune[w] & ~rows[z, w]
        some_left |= left[w]
    while some_left:
        # The first vertex that is left.
        w = 0
        while not left[w]:
            w += 1
        v = (w << 6) + lowest_bit(left[w])
        # Its neighbours in the lune that are absorbed already; if there is one, v and its neighbours are absorbed.
        shared = np.uint64(0)
        some_left = np.uint64(0)
        for w in range(words):
            shared |= lune[w] & rows[v, w] & ~left[w]
            left[w] &= ~rows[v, w]
            some_left |= left[w]
        if not shared:
            return False
    return True


@njit(forceinline=True)
def _take_component(data, rows, label, x, y, z, lune, waiting):
    """Take the component of z out of the lune; return its apex, whose longer edge to {x, y} is shortest, and that edge."""
    apex = -1
    apex_value = np.inf
    waiting[0] = z
    lune[z >> 6] ^= ONE << np.uint64(z & 63)
    top = 0
    while top >= 0:
        z = waiting[top]
        top -= 1
        value = max(edge_length(data, x, z), edge_length(data, y, z))
        if value < apex_value or (value == apex_value and label[z] < label[apex]):
            apex = z
            apex_value = value
        for w in range(len(lune)):
            reached = lune[w] & rows[z, w]
            lune[w] ^= reached
            while reached:
                top += 1
                waiting[top] = (w << 6) + lowest_bit(reached)
                reached &= reached - ONE
    return apex, apex_value


@njit()
def _count_components(data, rows, label, x, y, search):
    """Return the number of components of the lune, which is emptied; the apexes are left in the search, nearest first."""
    lune = search.lune
    apexes = search.apexes
    values = search.values
    waiting = search.waiting
    count = 0
    for w in range(len(lune)):
        while lune[w]:
            z = (w << 6) + lowest_bit(lune[w])
            apex, value = _take_component(data, rows, label, x, y, z, lune, waiting)
            _insert_apex(apex, value, label, apexes, values, count)
            count += 1
    return count


@njit()
def _insert_apex(apex, value, label, apexes, values, count):
    """Insert an apex into a list of `count` others, by its value, then by its label."""
    i = count
    while i > 0 and (values[i - 1] > value or (values[i - 1] == value and label[apexes[i - 1]] > label[apex])):
        values[i] = values[i - 1]
        apexes[i] = apexes[i - 1]
        i -= 1
    values[i] = value
    apexes[i] = apex


# Relations between loops ----------------------------------------------------------------------------------------------
#
# Idea: a relation is a cycle that bounds. Each of its edges is replaced by the two other edges of a triangle on it, again and
# again, until all have empty lunes. Those that joined two components form a tree and count as nothing; so the others, the
# creators of loops, determine which cycle it is. Persistence is the reduction of these short sets, youngest creator first.

# Edges with an empty lune, as lists at their ends: the first link of a vertex, and for a link the next one, the edge's other
# end, and the number of the loop that it created (-1: none, it joined two components).
Graph = namedtuple("Graph", "head links")
# Loops by number: the edges that create them; killer edges with two apexes, -1 while alive; for a dead one where its column is
# in the list of all `columns` and where that ends, which are the creators that remain of its relation; how long that list is;
# and space for one column, as a bitset.
Loops = namedtuple("Loops", "created killed column_ends columns n_in_columns column")
# Space for walks in the complex: edges that wait, nodes of the tree that wait, and a place.
Walk = namedtuple("Walk", "edges nodes place")


@njit()
def _add_edge(head, links, size, a, b, loop):
    """Add the edge {a, b} to the `size` ones of a graph; `loop` is the number of the loop that it created."""
    for link, vertex, other_end in ((2 * size, a, b), (2 * size + 1, b, a)):
        links[link, 0] = head[vertex]
        links[link, 1] = other_end
        links[link, 2] = loop
        head[vertex] = link


@njit()
def _new_loops(capacity):
    return Loops(
        np.empty((capacity, 2), dtype=np.int64),
        np.empty((capacity, 4), dtype=np.int64),
        np.empty((capacity, 2), dtype=np.int64),
        np.empty((2 * capacity, 1), dtype=np.int64),
        np.zeros(1, dtype=np.int64),
        np.zeros((capacity + 63) >> 6, dtype=np.uint64),
    )


@njit()
def _new_walk():
    return Walk(np.empty((256, 2), dtype=np.int64), np.empty(256, dtype=np.int64), np.empty(3))


@njit()
def _with_space(loops, born, more, spare, stop):
    """Return the loops with space for one after `born` of them, and for `more` columns, if `spare` bytes hold them."""
    created = loops.created
    killed = loops.killed
    column_ends = loops.column_ends
    columns = loops.columns
    column = loops.column
    if born == len(created):
        created = twice_as_long(created)
        killed = twice_as_long(killed)
        column_ends = twice_as_long(column_ends)
        column = np.zeros(2 * len(column), np.uint64)
    while loops.n_in_columns[0] + more * born > len(columns):
        columns = twice_as_long(columns)
    if 64 * len(created) + 8 * len(columns) > spare:
        stop[0] = TOO_MANY_LOOPS
    return Loops(created, killed, column_ends, columns, loops.n_in_columns, column)


@njit(forceinline=True)
def is_in_lune(data, label, x, y, length, z):
    """Return True if both edges from z come before {x, y}, of which the length is given."""
    if z in (x, y):
        return False
    to_x = edge_length(data, x, z)
    to_y = edge_length(data, y, z)
    if max(to_x, to_y) < length:
        return True
    if max(to_x, to_y) > length:
        return False
    return precedes(to_x, label[x], label[z], length, label[x], label[y]) and precedes(
        to_y, label[y], label[z], length, label[x], label[y]
    )


@njit()
def _vertex_of_rows(data, label, rows, a, b):
    """Return a vertex of the lune that {a, b} had when it arrived, -1 if there is none.

    It is the first in the rows that is near the middle, or the one whose longer edge to a and b is shortest.
    """
    length = edge_length(data, a, b)
    near = (
        0.4 if data.shape[1] == SPACE else 0.63
    ) * length  # a little more than a quarter of the square, or than half
    best = -1
    best_value = np.inf
    w = 0
    while w < rows.shape[1] and best_value > near:
        both = rows[a, w] & rows[b, w]
        while both and best_value > near:
            z = (w << 6) + lowest_bit(both)
            both &= both - ONE
            value = max(edge_length(data, a, z), edge_length(data, b, z))
            # The rows may hold later edges too.
            if value < best_value and (
                value < length or (value == length and is_in_lune(data, label, a, b, length, z))
            ):
                best = z
                best_value = value
        w += 1
    return best


@njit()
def _vertex_of_tree(points, label, start, end, low, high, a, b, nodes, place):
    """Return the vertex nearest to the middle of {a, b} in the lune that it had when it arrived, -1 if there is none."""
    length = edge_length(points, a, b)
    best = -1
    reach = reach_of_lune(points, a, b, length, place)
    nodes[0] = 0
    top = 0
    while top >= 0:
        node = nodes[top]
        top -= 1
        if place_to_box(low, high, place, node) > reach:
            continue
        if 2 * node + 2 < len(start):
            top = push_children(low, high, node, place, nodes, top)
            continue
        for z in range(start[node], end[node]):
            square = place_to_point(place, points, z)
            if square <= reach and is_in_lune(points, label, a, b, length, z):
                best = z
                reach = square
    return best


@njit()
def _write_in_creators(data, tree, rows, graph, relation, column, walk):
    """Write a cycle, its vertices (m,), in creators into `column` (a bitset, mod 2).

    The tree is searched where there is one row alone, for a cloud without them.
    """
    label = tree.label
    start = tree.start
    end = tree.end
    low = tree.low
    high = tree.high
    head = graph.head
    links = graph.links
    edges = walk.edges
    nodes = walk.nodes
    place = walk.place
    column[:] = 0
    for i in range(len(relation)):
        edges[i, 0] = relation[i - 1]
        edges[i, 1] = relation[i]
    top = len(relation) - 1
    while top >= 0:
        a = edges[top, 0]
        b = edges[top, 1]
        top -= 1

        # Is it in the graph? Then its lune was empty, and it is a creator or an edge of the tree.
        link = head[a]
        while link >= 0 and links[link, 1] != b:
            link = links[link, 0]
        if link >= 0:
            creator = links[link, 2]
            if creator >= 0:
                column[creator >> 6] ^= ONE << np.uint64(creator & 63)
            continue

        # Otherwise the two other edges of a triangle that was complete with it replace it.
        if len(rows) > 1:
            z = _vertex_of_rows(data, label, rows, a, b)
        else:
            z = _vertex_of_tree(data, label, start, end, low, high, a, b, nodes, place)
        if z < 0:
            raise AssertionError("an edge with an empty lune was passed over: please report this cloud to topokit")
        if top + 2 >= len(edges):
            edges = twice_as_long(edges)
        edges[top + 1, 0] = a
        edges[top + 1, 1] = z
        edges[top + 2, 0] = z
        edges[top + 2, 1] = b
        top += 2


@njit()
def reduce_column(column, killed, column_ends, columns):
    """Reduce a relation, the bitset of its creators, by those of the dead loops; return the loop it kills, -1 for none."""
    word = len(column) - 1
    while word >= 0:
        if not column[word]:
            word -= 1
            continue
        bit = 63
        while not (column[word] >> np.uint64(bit)) & ONE:
            bit -= 1
        youngest = (word << 6) + bit
        if killed[youngest, 0] < 0:
            return youngest
        for i in range(column_ends[youngest, 0], column_ends[youngest, 1]):
            creator = columns[i, 0]
            column[creator >> 6] ^= ONE << np.uint64(creator & 63)
    return -1


@njit()
def _kill_loops(data, tree, rows, graph, loops, x, y, apexes, count, walk):
    """Reduce the relations that an edge brings whose lune has `count` components, each with its apex; return how many loops die.

    The list of columns must have space for `count` - 1 more.
    """
    dead = 0
    killed = loops.killed
    column = loops.column
    column_ends = loops.column_ends
    columns = loops.columns
    size = loops.n_in_columns[0]
    relation = np.array([x, apexes[0], y, -1])
    for i in range(1, count):
        relation[3] = apexes[i]
        _write_in_creators(data, tree, rows, graph, relation, column, walk)
        loop = reduce_column(column, killed, column_ends, columns)
        if loop >= 0:
            # Append the creators that remain to the list of columns.
            column_ends[loop, 0] = size
            for word in range((loop >> 6) + 1):
                bits = column[word]
                while bits:
                    columns[size, 0] = (word << 6) + lowest_bit(bits)
                    size += 1
                    bits &= bits - ONE
            column_ends[loop, 1] = size
            killed[loop, 0] = x
            killed[loop, 1] = y
            killed[loop, 2] = apexes[0]
            killed[loop, 3] = apexes[i]
            dead += 1
    loops.n_in_columns[0] = size
    return dead


# When to stop ---------------------------------------------------------------------------------------------------------
#
# Idea: after the last edge with an empty lune no loop is born any more. A point that is nearer to all of two boxes than they
# are to each other is in the lune of every edge between them. A point near the middle is tried, then the points of two leaves;
# the few edges that remain are searched. Here a lune holds strictly shorter edges only: where lengths tie, the kernel may read
# on for nothing, and its answer is the same.


@njit()
def last_empty_lune(data, tree, rows, shortest):
    """Return the greatest length of an edge with an empty lune among those not shorter than `shortest`, 0 for none.

    `rows` has shorter edges, as many as are known; it has one row when none are.
    """
    if data.shape[1] == SPACE:
        return _last_of_points(tree, rows, shortest)
    return _last_of_matrix(data, rows, shortest)


@njit(forceinline=True)
def _meet(rows, x, y):
    """Return True if a vertex is joined to both x and y."""
    both = np.uint64(0)
    for w in range(rows.shape[1]):
        both |= rows[x, w] & rows[y, w]
    return both != 0


@njit()
def _last_of_matrix(data, rows, shortest):
    latest = 0.0
    for x in range(len(data)):
        for y in range(x + 1, len(data)):
            length = data[x, y]
            if length >= max(shortest, latest) and not _meet(rows, x, y):
                z = 0
                while z < len(data) and (data[x, z] >= length or data[y, z] >= length):
                    z += 1
                if z == len(data):
                    latest = length
    return latest


@njit()
def _last_of_points(tree, rows, shortest):
    points = tree.points
    start = tree.start
    end = tree.end
    low = tree.low
    high = tree.high
    latest = 0.0
    box_pairs = np.zeros((272, 3), dtype=np.int64)  # two boxes, and a point that may be between them
    nodes = np.empty(256, dtype=np.int64)
    place = np.empty(SPACE)
    top = 0
    while top >= 0:
        a = box_pairs[top, 0]
        b = box_pairs[top, 1]
        z = box_pairs[top, 2]
        top -= 1
        shortest = max(shortest, latest)

        # Is a point in the lunes of all edges between the boxes: the one of the larger boxes, or one near the middle?
        if between_boxes(low, high, a, b)[1] < shortest or _is_between(points, low, high, z, a, b):
            continue
        if a != b:
            middle_of_boxes(low, high, a, b, place)
            z = nearby_point(tree, place)
            if _is_between(points, low, high, z, a, b):
                continue
        if a < tree.first_leaf:
            top = _push_pairs(a, b, z, box_pairs, top)
            continue

        # Two leaves: edge by edge. The point z, what is joined to both ends or is in a leaf, and then all points are looked at.
        for x in range(start[a], end[a]):
            for y in range(x + 1 if a == b else start[b], end[b]):
                length = edge_length(points, x, y)
                if length < shortest or length <= latest or _is_strictly_in_lune(points, z, x, y, length):
                    continue
                if len(rows) > 1:
                    met = _meet(rows, x, y)
                else:
                    met = _meets_lune(points, x, y, length, start[a], end[a])
                    met = met or _meets_lune(points, x, y, length, start[b], end[b])
                if not met and _is_empty_lune(points, start, end, low, high, x, y, length, nodes, place):
                    latest = length
    return latest


@njit(forceinline=True)
def _is_strictly_in_lune(points, z, x, y, length):
    """Return True if z is nearer to both ends of {x, y} than its length."""
    return z != x and z != y and edge_length(points, x, z) < length and edge_length(points, y, z) < length


@njit(forceinline=True)
def _meets_lune(points, x, y, length, first, end):
    """Return True if one of the points `first` to `end` is in the lune of {x, y}."""
    met = False
    for z in range(first, end):
        met = met or _is_strictly_in_lune(points, z, x, y, length)
    return met


@njit()
def _is_empty_lune(points, start, end, low, high, x, y, length, nodes, place):
    """Return True if no point is in the lune of {x, y}; boxes nearer to its midpoint are looked at first."""
    reach = reach_of_lune(points, x, y, length, place)
    nodes[0] = 0
    top = 0
    is_empty = True
    while top >= 0 and is_empty:
        node = nodes[top]
        top -= 1
        if place_to_box(low, high, place, node) <= reach:
            if 2 * node + 2 < len(start):
                top = push_children(low, high, node, place, nodes, top)
            else:
                is_empty = not _meets_lune(points, x, y, length, start[node], end[node])
    return is_empty


@njit(forceinline=True)
def _is_nearer(points, low, high, z, a, b):
    """Return True if the point z is nearer to every place of box b than any place of box a is.

    |z - y|^2 - |x - y|^2 is a sum over the axes; along one it is greatest with y at an end of b and x as near to it as a allows.
    """
    total = 0.0
    size = 0.0
    for k in range(SPACE):
        most = -np.inf
        for y in (low[b, k], high[b, k]):
            gap = max(low[a, k] - y, y - high[a, k], 0.0)
            step = points[z, k] - y
            most = max(most, step * step - gap * gap)
            size = max(size, step * step, gap * gap)
        total += most
    return total < -1e-12 * size  # rounding must not decide


@njit(forceinline=True)
def _is_between(points, low, high, z, a, b):
    """Return True if z is in the lune of every edge between two boxes."""
    return _is_nearer(points, low, high, z, a, b) and _is_nearer(points, low, high, z, b, a)


# The pairing ----------------------------------------------------------------------------------------------------------


@njit()
def _root(parent, x):
    """Return the vertex that represents the component of x."""
    while parent[x] != x:
        parent[x] = parent[parent[x]]
        x = parent[x]
    return x


# A grid over the points of a tree: for each cell a vertex near its centre, -1 until it is sought; cells along each axis; and
# cells in a unit of length.
Grid = namedtuple("Grid", "vertex sides scale")


@njit()
def _new_grid(tree, most):
    """Return a grid of up to `most` cells."""
    sides = np.ones(SPACE, np.int64)
    scale = 0.0
    if most > 0:
        width = 0.0
        for k in range(SPACE):
            width = max(width, tree.high[0, k] - tree.low[0, k])
        cells = 1
        while cells <= most:
            scale = 1.2 * scale if scale > 0.0 else 1.0 / width
            cells = 1
            for k in range(SPACE):
                cells *= int((tree.high[0, k] - tree.low[0, k]) * scale) + 1
        scale /= 1.2
        for k in range(SPACE):
            sides[k] = int((tree.high[0, k] - tree.low[0, k]) * scale) + 1
    return Grid(np.full(sides[0] * sides[1] * sides[2], -1, np.int32), sides, scale)


@njit()
def _find_middles(points, tree, grid, keys, lengths, m, far):
    """Put a vertex near the middle of each of m edges into its key; with `far` -1 where that shows the lune to be a cone."""
    vertex = grid.vertex
    sides = grid.sides
    scale = grid.scale
    low = tree.low
    place = np.empty(SPACE)
    for e in range(m):
        x, y, _ = ends_of(keys[e])
        cell = 0
        for k in range(SPACE):
            cell = sides[k] * cell + int((0.5 * (points[x, k] + points[y, k]) - low[0, k]) * scale)
        z = vertex[cell]
        if z < 0:
            rest = cell
            for k in range(SPACE - 1, -1, -1):
                place[k] = low[0, k] + (rest % sides[k] + 0.5) / scale
                rest //= sides[k]
            z = nearby_point(tree, place)
            vertex[cell] = z
        if far and is_near_middle(points, x, y, z, lengths[e]):
            z = -1
        keys[e] |= np.int64(z) << (2 * _BITS)


@njit()
def next_change(rows, keys, lengths, e, m, longest, alive, lune, left, stop):
    """Join edges from the e-th on until one changes something; return its number + 1, and a vertex of its lune, -1 for none.

    Edges longer than `longest` are not read; where one comes, or all m are read, the second number is -2.
    """
    z = -2
    while e < m and z == -2 and stop[0] == 0 and lengths[e] <= longest:
        # A cone changes nothing, nor does a connected lune; while no loop is alive, none can be killed either.
        x, y, middle = ends_of(keys[e])
        if middle >= 0 and not is_cone(rows, x, y, middle):
            z = _write_lune(rows, x, y, lune)
            if has_bit(lune, middle):
                z = middle
            if z >= 0 and (not alive or is_connected(rows, lune, z, left)):
                z = -2
        join(rows, x, y)
        e += 1
    return e, z


@njit()
def _radius(data, tree, row):
    """Return a length such that one vertex is joined to all others by no longer edges: later edges change nothing."""
    if data.shape[1] == SPACE:
        middle_of_boxes(tree.low, tree.high, 0, 0, row)
        z = nearby_point(tree, row)
        radius = 0.0
        for y in range(len(data)):
            radius = max(radius, edge_length(data, z, y))
        return radius
    radius = np.inf
    for x in range(len(data)):
        radius = min(radius, data[x].max())
    return radius


@njit()
def pair_edges(data, tree, max_length, likely, buffer, spare, stop):
    """Pair the edges that create loops, (c, 2), with the edges that kill them and their two apexes, (c, 4), -1 for none.

    `data` holds distances, or points in the order of `tree`. Lengths are squared for points. Besides the n x n bits `spare`
    bytes may be taken: half for the edges of a window, half for the columns of loops. When these do not suffice, or another
    thread writes into `stop` (1,), `stop` holds the reason and the result is incomplete.

    The first window reaches to the length `likely`, if that is more than most distances of neighbours.

    Return the buffer for the next call, both tables, and the length from which on nothing was read.
    """
    n = len(data)
    label = tree.label
    words = (n + 63) >> 6
    rows = np.zeros((n, words), dtype=np.uint64)
    for v in range(n):
        join(rows, v, v)
    lune = np.empty(words, np.uint64)
    left = np.empty(words, np.uint64)
    apexes = np.empty(n, np.int64)
    search = LuneSearch(lune, left, np.empty(n, np.int64), apexes, np.empty(n))
    head = np.full(n, -1)
    links = np.empty((8 * n, 3), np.int64)
    graph = Graph(head, links)
    graph_size = np.int64(0)
    loops = _new_loops(64)
    created = loops.created
    killed = loops.killed
    n_in_columns = loops.n_in_columns
    space = len(loops.columns)
    born = np.int64(0)
    alive = 0
    parent = np.arange(n)
    n_components = n
    walk = _new_walk()
    row = np.empty(n)
    greatest = min(_radius(data, tree, row), max_length)  # the greatest length that matters
    beyond = greatest * (1.0 + 1e-12) + 5e-324
    has_grid = data.shape[1] == SPACE and words >= GRID_WORDS
    grid = _new_grid(tree, CELLS * n if has_grid else 0)
    last = -1.0  # the length of the last edge with an empty lune, once it is known
    shortest = 0.0
    longest = min(max(first_window(data), likely, 1e-6 * greatest, 5e-324), beyond)
    done = False
    end = longest
    while not done:
        buffer, m, longest = edges_between(data, tree, shortest, longest, buffer, spare // (2 * EDGE_BYTES), stop)
        if has_grid:
            _find_middles(data, tree, grid, buffer.keys, buffer.lengths, m, words > FEW_WORDS)
        keys = buffer.keys
        lengths = buffer.lengths
        e = np.int64(0)
        while e < m:
            bound = max_length
            if alive == 0 and last >= 0:
                bound = min(bound, last)
            e, z = next_change(rows, keys, lengths, e, m, bound, alive > 0, lune, left, stop)
            if z == -2:
                done = e < m
                end = lengths[e] if done else longest
                break
            x, y, _ = ends_of(keys[e - 1])
            length = lengths[e - 1]
            if z >= 0:  # the lune is disconnected
                count = _count_components(data, rows, label, x, y, search)
                if n_in_columns[0] + (count - 1) * born > space:
                    loops = _with_space(loops, born, count - 1, spare // 2, stop)
                    created = loops.created
                    killed = loops.killed
                    space = len(loops.columns)
                alive -= _kill_loops(data, tree, rows, graph, loops, x, y, apexes, count, walk)
            else:  # the lune is empty
                a = _root(parent, x)
                b = _root(parent, y)
                if 2 * graph_size + 2 > len(links):
                    links = twice_as_long(links)
                    graph = Graph(head, links)
                _add_edge(head, links, graph_size, x, y, born if a == b else -1)
                graph_size += 1
                if a != b:  # the edge joins two components
                    parent[a] = b
                    n_components -= 1
                else:  # it creates a loop
                    if born == len(created):
                        loops = _with_space(loops, born, 0, spare // 2, stop)
                        created = loops.created
                        killed = loops.killed
                    created[born, 0] = x
                    created[born, 1] = y
                    for k in range(4):
                        killed[born, k] = -1
                    born += 1
                    alive += 1

            # Once all is one component and no loop is alive, compute up to which length edges can matter.
            if alive == 0 and n_components == 1 and last < 0:
                last = last_empty_lune(data, tree, rows, length)
        if stop[0] != 0 or longest > greatest or (alive == 0 and 0 <= last < longest):
            done = True
        start = shortest
        shortest = longest
        longest = min(next_window(data, start, longest, m), beyond)
    return buffer, created[:born], killed[:born], end


@njit(nogil=True, cache=True)
def pair_clouds(data, starts, max_lengths, buffer_arrays, spare, stop):
    """Pair the edges of clouds as `pair_edges` does, by the numbers of the vertices in their cloud.

    The points of cloud c are data[starts[c]:starts[c + 1]]; or data is one matrix.

    Return the buffer, both tables, and how many loops each cloud has, -1 when points are repeated: then nothing is done.
    """
    buffer = EdgeBuffer(*buffer_arrays)
    counts = np.zeros(len(max_lengths), np.int64)
    total = 0
    created = np.empty((64, 2), np.int64)
    killed = np.empty((64, 4), np.int64)
    end = 0.0
    likely = 0.0
    for c in range(len(counts)):
        cloud = data[starts[c] : starts[c + 1]]
        if len(cloud) < 4:
            continue
        if data.shape[1] == SPACE:
            tree = build_tree(cloud)
            cloud = tree.points
            if has_repeats(tree):
                counts[c] = -1
                continue
        else:
            tree = _no_tree(len(cloud))
        before = end
        buffer, loops, killers, end = pair_edges(cloud, tree, max_lengths[c], likely, buffer, spare, stop)

        # Frames of a film, or one scene under several plans, end alike: then the next cloud is read in one window.
        likely = 0.0
        if abs(end - before) < ALIKE * end:
            likely = (1.0 + ALIKE) * end

        # Append the pairs, by the numbers of the points in their cloud.
        counts[c] = len(loops)
        while total + len(loops) > len(created):
            created = twice_as_long(created)
            killed = twice_as_long(killed)
        for i in range(len(loops)):
            for k in range(2):
                created[total, k] = tree.label[loops[i, k]]
            for k in range(4):
                killed[total, k] = -1
                if killers[i, k] >= 0:
                    killed[total, k] = tree.label[killers[i, k]]
            total += 1
    return (
        as_arrays(buffer),
        created[:total],
        killed[:total],
        counts,
    )


# Large clouds ---------------------------------------------------------------------------------------------------------
#
# Idea: most edges have a connected lune, and change nothing. Whether a lune is connected follows from the points in it, in
# whatever order edges are looked at. So nothing is kept for each pair of points, and edges are not sorted: the tree is walked
# once for each window of lengths, the points around two leaves are gathered, and only edges with an empty or a disconnected
# lune are listed, a few for each point. These are put in order and paired.
#
# Where lunes hold many points, bitsets are faster. Then there are two rows for each point: who was joined to it `before` the
# window, and who will be `after` it. A lune within the window is at least what the former have in common, and at most what the
# latter have; when all of the larger set is connected by edges from before, over vertices of the smaller one, so is the lune.
# With the intersections and unions of the rows of two boxes it is known for all edges between them at once.

# Rows of points, (n, words), and for each small node of the tree the `common` part of the rows before and the `union` of those
# after. All are of one word while they are not used.
Rows = namedtuple("Rows", "before after common union")
# Space for pairs of nodes that wait, for points around two leaves, for a lune, for its apexes and their values, and for a bitset.
Space = namedtuple("Space", "box_pairs near lune apexes values left")

LUNE_FOR_ROWS = 32  # mean number of points in a lune from which rows pay
NODE_FOR_ROWS = 64  # largest number of points in a node that has rows
GROWTH = 1.3  # ratio of the squared lengths where a window ends and begins
SMALLEST_WINDOW = 1e-18  # of the greatest squared length
GROWTH_WITH_ROWS = 1.07  # with rows, which are the less certain the longer the window is
FEW_STEPS = 32  # vertices tried before it is left open whether a lune is connected
# A lune lies within sqrt(3)/2 of its edge's length from the midpoint: a point within the rest is joined to all of it.
CONE = (1.0 - np.sqrt(0.75)) * (1.0 - 1e-9)
BYTES_A_POINT = 2048  # of the tables for a large cloud; two million points have vertices that fit a key


@njit()
def _no_rows():
    nothing = np.zeros((1, 1), np.uint64)
    return Rows(nothing, nothing, nothing, nothing)


@njit()
def _new_rows(tree, longest, space, stop):
    """Return the rows of all points after the edges shorter than `longest`."""
    n = len(tree.points)
    n_nodes = len(tree.start)
    words = (n + 63) >> 6
    after = np.zeros((n, words), np.uint64)
    for v in range(n):
        join(after, v, v)
    _join_between(tree, 0.0, longest, after, space.box_pairs, stop)
    return Rows(after.copy(), after, np.zeros((n_nodes, words), np.uint64), np.zeros((n_nodes, words), np.uint64))


@njit()
def _join_between(tree, shortest, longest, rows, box_pairs, stop):
    """Set the bits of all edges with shortest <= squared length < longest."""
    points = tree.points
    box_pairs[0, :] = 0
    top = 0
    while top >= 0:
        a = box_pairs[top, 0]
        b = box_pairs[top, 1]
        top -= 1
        least, most = between_boxes(tree.low, tree.high, a, b)
        if least >= longest or most < shortest:
            continue
        if stop[0]:
            break
        if a < tree.first_leaf:
            top = _push_pairs(a, b, 0, box_pairs, top)
            continue
        for x in range(tree.start[a], tree.end[a]):
            for y in range(x + 1 if a == b else tree.start[b], tree.end[b]):
                length = edge_length(points, x, y)
                if shortest <= length < longest:
                    join(rows, x, y)


@njit()
def _summarise_nodes(tree, rows):
    """Write the common parts and the unions of the rows of small nodes, children first."""
    before = rows.before
    after = rows.after
    common = rows.common
    union = rows.union
    words = before.shape[1]
    for node in range(len(tree.start) - 1, -1, -1):
        first = tree.start[node]
        if tree.end[node] - first > NODE_FOR_ROWS:
            break
        if node < tree.first_leaf:
            for w in range(words):
                common[node, w] = common[2 * node + 1, w] & common[2 * node + 2, w]
                union[node, w] = union[2 * node + 1, w] | union[2 * node + 2, w]
            continue
        for w in range(words):
            common[node, w] = before[first, w]
            union[node, w] = after[first, w]
        for x in range(first + 1, tree.end[node]):
            for w in range(words):
                common[node, w] &= before[x, w]
                union[node, w] |= after[x, w]


@njit()
def _is_surely_connected(sure, possible, a, b, before, z, left):
    """Return True if every lune with a certain and a possible part is connected; False may mean that it is not known.

    The vertices that are surely in the lune are in the rows a and b of `sure`, and all that may be are in those of `possible`.
    From z on, vertices of the lune absorb what is joined to them before. `left` is space for a bitset.
    """
    if not (has_bit(sure[a], z) and has_bit(sure[b], z)):
        return False
    words = before.shape[1]
    some_left = np.uint64(0)
    for w in range(words):
        some_left |= possible[a, w] & possible[b, w] & ~before[z, w]
    if not some_left:
        return True
    for w in range(words):
        left[w] = possible[a, w] & possible[b, w] & ~before[z, w]
    first = 0
    for _ in range(FEW_STEPS):
        # The first vertex v that is left. Near it a vertex u is sought that is surely in the lune and absorbed, and joined to v.
        while first < words and not left[first]:
            first += 1
        if first == words:
            return True
        v = (first << 6) + lowest_bit(left[first])
        u = -1
        for i in range(words):
            w = first + i
            if w >= words:
                w -= words
            shared = sure[a, w] & sure[b, w] & before[v, w] & ~left[w]
            if shared:
                u = (w << 6) + lowest_bit(shared)
                break
        if u < 0:
            return False

        # All that is joined to u is absorbed, v with it; and what is joined to v, if that is surely in the lune.
        for w in range(first, words):
            left[w] &= ~before[u, w]
        if has_bit(sure[a], v) and has_bit(sure[b], v):
            for w in range(first, words):
                left[w] &= ~before[v, w]
    return False


@njit(forceinline=True)
def _spread_of_middles(tree, a, b):
    """Return how far from the middle between two boxes the midpoint of an edge between them may be."""
    total = 0.0
    for k in range(SPACE):
        total += (tree.high[a, k] - tree.low[a, k] + tree.high[b, k] - tree.low[b, k]) ** 2
    return 0.25 * np.sqrt(total)


@njit()
def _points_near(tree, a, b, longest, nodes, near):
    """Write the points that may be in the lune of an edge between two nodes into `near`; return their number.

    The edge is not longer than `longest`, squared.
    """
    size = 0
    nodes[0] = 0
    top = 0
    while top >= 0:
        node = nodes[top]
        top -= 1
        if (
            between_boxes(tree.low, tree.high, a, node)[0] > longest
            or between_boxes(tree.low, tree.high, b, node)[0] > longest
        ):
            continue
        if node < tree.first_leaf:
            nodes[top + 1] = 2 * node + 1
            nodes[top + 2] = 2 * node + 2
            top += 2
            continue
        for z in range(tree.start[node], tree.end[node]):
            near[size] = z
            size += 1
    return size


@njit()
def _points_after(rows, x, y, near):
    """Write the points that are joined to x and to y after the window into `near`; return their number."""
    after = rows.after
    size = 0
    for w in range(after.shape[1]):
        both = after[x, w] & after[y, w]
        while both:
            near[size] = (w << 6) + lowest_bit(both)
            size += 1
            both &= both - ONE
    return size


@njit()
def _list_lune(points, label, x, y, length, near, n_near, lune):
    """Write those of the points `near` that are in the lune of {x, y} into `lune`; return their number.

    The first of them is the nearest to the middle.
    """
    size = 0
    best = 0
    best_value = np.inf
    for i in range(n_near):
        z = near[i]
        to_x = edge_length(points, x, z)
        to_y = edge_length(points, y, z)
        if max(to_x, to_y) > length:
            continue
        if is_in_lune(points, label, x, y, length, z):
            lune[size] = z
            if to_x + to_y < best_value:
                best_value = to_x + to_y
                best = size
            size += 1
    if size:
        lune[0], lune[best] = lune[best], lune[0]
    return size


@njit()
def _end_of_component(points, label, x, y, length, lune, first, size):
    """Move the component of lune[first] in lune[first:size] to the front; return where it ends."""
    end = first + 1
    i = first
    while i < end < size:
        z = lune[i]
        i += 1
        for j in range(end, size):
            w = lune[j]
            side = edge_length(points, z, w)
            if side < length or (side == length and precedes(side, label[z], label[w], length, label[x], label[y])):
                lune[j] = lune[end]
                lune[end] = w
                end += 1
    return end


@njit()
def _apexes_of_lune(tree, x, y, length, space, walk):
    """Write the apexes of the components of the lune of {x, y} into the space, nearest first; return their number."""
    points = tree.points
    label = tree.label
    lune = space.lune

    # Points no farther from the midpoint than a lune reaches.
    nodes = walk.nodes
    reach = reach_of_lune(points, x, y, length, walk.place)
    n_near = 0
    nodes[0] = 0
    top = 0
    while top >= 0:
        node = nodes[top]
        top -= 1
        if place_to_box(tree.low, tree.high, walk.place, node) > reach:
            continue
        if node < tree.first_leaf:
            top = push_children(tree.low, tree.high, node, walk.place, nodes, top)
            continue
        for z in range(tree.start[node], tree.end[node]):
            space.near[n_near] = z
            n_near += 1

    size = _list_lune(points, label, x, y, length, space.near, n_near, lune)
    count = 0
    first = 0
    while first < size:
        end = _end_of_component(points, label, x, y, length, lune, first, size)
        apex = -1
        apex_value = np.inf
        for i in range(first, end):
            z = lune[i]
            value = max(edge_length(points, x, z), edge_length(points, y, z))
            if value < apex_value or (value == apex_value and label[z] < label[apex]):
                apex = z
                apex_value = value
        _insert_apex(apex, apex_value, label, space.apexes, space.values, count)
        count += 1
        first = end
    return count


@njit()
def _list_edges(tree, shortest, longest, only_empty, rows, buffer, space, walk, stop):
    """List the edges with shortest <= squared length < longest whose lune is empty or disconnected, in no order.

    With `only_empty` those with a disconnected lune are left out: while no loop is alive, they change nothing. The third part of
    a key is 1 when the lune is disconnected, 0 when it is empty.

    Return the number of edges, -1 if the buffer is too small; and how many lunes were listed, and the points in them.
    """
    points = tree.points
    label = tree.label
    start = tree.start
    end = tree.end
    box_pairs = space.box_pairs
    lune = space.lune
    has_rows = len(rows.before) > 1
    n_edges = 0
    n_lunes = 0
    n_in_lunes = 0
    helper = 0  # a vertex that was near the middle of an edge like this one
    box_pairs[0, :] = 0
    top = 0
    while top >= 0:
        a = box_pairs[top, 0]
        b = box_pairs[top, 1]
        z = box_pairs[top, 2]
        top -= 1
        least, most = between_boxes(tree.low, tree.high, a, b)
        if least >= longest or most < shortest:
            continue
        if stop[0]:
            break

        # Is it known of all edges between the boxes that their lunes are connected? A point near the middle helps, or the one
        # that was near the middle of the larger boxes.
        if least > 0.0:
            middle_of_larger = z
            middle_of_boxes(tree.low, tree.high, a, b, walk.place)
            z = nearby_point(tree, walk.place)
            if only_empty and _is_between(points, tree.low, tree.high, z, a, b):
                continue
            spread = _spread_of_middles(tree, a, b)
            length = np.sqrt(max(shortest, least))
            near = CONE * length - spread - ROUNDING
            if near > 0.0 and place_to_point(walk.place, points, z) < near * near:
                continue
            if has_rows and end[a] - start[a] <= NODE_FOR_ROWS and spread < 0.2 * length:
                if _is_surely_connected(rows.common, rows.union, a, b, rows.before, z, space.left):
                    continue
                if _is_surely_connected(rows.common, rows.union, a, b, rows.before, middle_of_larger, space.left):
                    continue
        if a < tree.first_leaf:
            top = _push_pairs(a, b, z, box_pairs, top)
            continue

        # Two leaves: edge by edge.
        n_near = -1
        for x in range(start[a], end[a]):
            for y in range(x + 1 if a == b else start[b], end[b]):
                length = edge_length(points, x, y)
                if length < shortest or length >= longest or is_near_middle(points, x, y, z, length):
                    continue
                if only_empty:
                    if _is_strictly_in_lune(points, z, x, y, length):
                        continue
                    nearest = _vertex_of_tree(
                        points, label, start, end, tree.low, tree.high, x, y, walk.nodes, walk.place
                    )
                    if nearest >= 0:
                        continue
                if has_rows:
                    if _is_surely_connected(rows.before, rows.after, x, y, rows.before, helper, space.left):
                        continue
                    if _is_surely_connected(rows.before, rows.after, x, y, rows.before, z, space.left):
                        continue
                    n_near = _points_after(rows, x, y, space.near)
                elif n_near < 0:
                    n_near = _points_near(tree, a, b, min(most, longest), walk.nodes, space.near)
                size = _list_lune(points, label, x, y, length, space.near, n_near, lune)
                n_lunes += 1
                n_in_lunes += size
                if size > 0:
                    helper = lune[0]
                    if _end_of_component(points, label, x, y, length, lune, 0, size) == size:
                        continue
                if n_edges == len(buffer.found_keys):
                    return -1, n_lunes, n_in_lunes
                disconnected = np.int64(size > 0)
                buffer.found_keys[n_edges] = edge_key(x, y) | disconnected << (2 * _BITS)
                buffer.found_lengths[n_edges] = length
                n_edges += 1
    return n_edges, n_lunes, n_in_lunes


@njit()
def _closes_loop(buffer, m, parent):
    """Return True if one of m edges with empty lunes joins vertices of one component, those before it counted."""
    parent = parent.copy()
    for e in range(m):
        x, y, _ = ends_of(buffer.keys[e])
        a = _root(parent, x)
        b = _root(parent, y)
        if a == b:
            return True
        parent[a] = b
    return False


@njit(nogil=True, cache=True)
def pair_large(data, max_length, buffer_arrays, spare, stop):
    """Pair the edges of a large cloud of points as `pair_edges` does, by the points' numbers in the cloud.

    Return the buffer, both tables, and whether points are repeated: then nothing is done.
    """
    buffer = EdgeBuffer(*buffer_arrays)
    tree = build_tree(data)
    n = len(data)
    points = tree.points
    label = tree.label
    words = (n + 63) >> 6
    if has_repeats(tree):
        return as_arrays(buffer), np.empty((0, 2), np.int64), np.empty((0, 4), np.int64), True

    walk = _new_walk()
    space = Space(
        np.empty((512, 3), np.int64),
        np.empty(n, np.int64),
        np.empty(n, np.int64),
        np.empty(n, np.int64),
        np.empty(n),
        np.empty(words, np.uint64),
    )
    rows = _no_rows()
    no_rows = rows.before
    bytes_of_rows = 16 * words * (n + len(tree.start))
    graph = Graph(np.full(n, -1), np.empty((8 * n, 3), np.int64))
    graph_size = np.int64(0)
    loops = _new_loops(64)
    born = np.int64(0)
    alive = 0
    parent = np.arange(n)
    n_components = n
    last = -1.0  # the length of the last edge with an empty lune, once it is known
    greatest = min(_radius(points, tree, walk.place), max_length)  # the greatest length that matters
    beyond = greatest * (1.0 + 1e-12) + 5e-324
    shortest = 0.0
    # Windows grow by a ratio, so that the first one must not end at nearly nothing: neighbours may be in the same place.
    longest = min(max(first_window(points), SMALLEST_WINDOW * greatest, 5e-324), beyond)
    done = False
    while not done:
        # The next window of edges. While no loop is alive, those with an empty lune, and the others if a loop is born then.
        only_empty = alive == 0 and born > 0
        n_lunes = 0
        n_in_lunes = 0
        m = -1
        while m < 0:
            if only_empty:
                rows = _no_rows()
            elif len(rows.before) > 1:
                _join_between(tree, shortest, longest, rows.after, space.box_pairs, stop)
                _summarise_nodes(tree, rows)
            m, n_lunes, n_in_lunes = _list_edges(tree, shortest, longest, only_empty, rows, buffer, space, walk, stop)
            if m < 0:  # they do not fit
                if 2 * EDGE_BYTES * len(buffer.found_keys) > spare // 4:
                    stop[0] = TOO_MANY_EDGES
                    m = 0
                else:
                    buffer = new_buffer(2 * len(buffer.found_keys))
                continue
            sort_edges(buffer, m, label)
            if only_empty and _closes_loop(buffer, m, parent):
                only_empty = False
                m = -1

        for e in range(m):
            x, y, disconnected = ends_of(buffer.keys[e])
            length = buffer.lengths[e]
            if stop[0] or length > max_length or (alive == 0 and 0 <= last < length):
                done = True
                break
            if disconnected:
                if alive > 0:
                    count = _apexes_of_lune(tree, x, y, length, space, walk)
                    loops = _with_space(loops, born, count - 1, spare // 4, stop)
                    alive -= _kill_loops(points, tree, no_rows, graph, loops, x, y, space.apexes, count, walk)
            else:
                a = _root(parent, x)
                b = _root(parent, y)
                if 2 * graph_size + 2 > len(graph.links):
                    graph = Graph(graph.head, twice_as_long(graph.links))
                _add_edge(graph.head, graph.links, graph_size, x, y, born if a == b else -1)
                graph_size += 1
                if a != b:  # the edge joins two components
                    parent[a] = b
                    n_components -= 1
                else:  # it creates a loop
                    loops = _with_space(loops, born, 0, spare // 4, stop)
                    loops.created[born, 0] = x
                    loops.created[born, 1] = y
                    loops.killed[born, :] = -1
                    born += 1
                    alive += 1
            if alive == 0 and n_components == 1 and last < 0:
                last = last_empty_lune(points, tree, rows.before, length)
        if stop[0] or longest > greatest or (alive == 0 and 0 <= last < longest):
            done = True

        shortest = longest
        has_rows = len(rows.before) > 1
        if has_rows:
            rows.before[:] = rows.after
        elif not done and n_in_lunes > LUNE_FOR_ROWS * n_lunes and bytes_of_rows < spare // 2:
            rows = _new_rows(tree, longest, space, stop)
            has_rows = True
        longest = min(longest * (GROWTH_WITH_ROWS if has_rows else GROWTH), beyond)

    created = loops.created[:born]
    killed = loops.killed[:born]
    for i in range(born):
        for k in range(2):
            created[i, k] = label[created[i, k]]
        for k in range(4):
            if killed[i, k] >= 0:
                killed[i, k] = label[killed[i, k]]
    return as_arrays(buffer), created, killed, False
