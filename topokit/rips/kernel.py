"""The compiled kernel of degree-1 Rips persistence: lunes as the AND of two bitsets.

Idea: edges arrive in the total order (length, smaller index, larger index). Every vertex keeps a bitset of the vertices that
it is joined to, so the *lune* of an arriving edge {x, y}, all that is joined to both, is row x AND row y. There are four cases.

- Most lunes are cones: one vertex is joined to all the others. It is near the middle of the edge, and the same vertex serves
  all edges between two small boxes. Such an edge changes nothing.
- An empty lune joins two components or creates a loop; the edge is then a *creator*.
- A connected lune changes nothing.
- Each further component of a disconnected lune brings a relation x, z_i, y, z_1: a cycle that bounds from now on. Written in
  creators and reduced, it may kill one loop.

Triangles are never listed. The work ends when no loop is alive and no later edge has an empty lune.

The sections of this file follow the data: lengths and their order, bits, a kd-tree of the points, edges a window at a time,
lunes, relations between loops, when to stop, the pairing itself, and films of clouds.
Functions that Python calls take plain arrays and tuples and are cached by numba on disk; the others are compiled into them.

Source: Koyama, Memoli, Robins, Turner 2023 (the reduced Vietoris-Rips filtration). Read in chapter 2.
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
EDGE_BYTES = 108  # bytes of an `EdgeBuffer` for an edge
FEW_POINTS = 4096  # for so few points, edges too long for a window are kept for the next one
FEW_EDGES = 8  # number of edges up to which insertion sort is fastest
FEW_WORDS = 32  # length of a row up to which reading it is as quick as comparing places
LEAF = 8  # largest number of points in a leaf of the tree
# A lune lies within sqrt(3)/2 of its edge's length from the midpoint: a point within the rest is joined to all of it.
CONE = (1.0 - np.sqrt(0.75)) * (1.0 - 1e-9)
ROUNDING = 4e-16  # error of a place that is a mean of coordinates, which are at most 1
SLACK = 1.05  # factor of the squared length at which the last cloud ended: this one is expected to end below
REACH = 1.3  # factor of that length up to which edges are listed, for several clouds
ALIKE = (
    0.25  # this part of that length must be certain without a list, or the clouds have nothing to do with each other
)


# Lengths and the total order ------------------------------------------------------------------------------------------
#
# A cloud's `data` are its points, or a symmetric matrix of distances. `axes` is a tuple of zeros as long as the dimension, and
# empty for a matrix: its length is known when the code is compiled, so the compiler unrolls every loop over coordinates. The
# "length" of an edge between points is squared here: it orders edges alike and costs no root.


@njit(forceinline=True)
def edge_length(data, i, j, axes):
    """Return the entry of a matrix (no axes), or the squared distance of two points; the same for (i, j) and (j, i).

    All compiled code calls it, since it decides ties; `_cloud.squares` is the same in NumPy, to the last bit.
    """
    if len(axes) == 0:
        return data[i, j]
    total = 0.0
    for k in range(len(axes)):
        step = data[i, k] - data[j, k]
        total += step * step
    return total


@njit(forceinline=True)
def root_of(length, axes):
    """Return the length of an edge of which `edge_length` is given."""
    if len(axes) == 0:
        return length
    return np.sqrt(length)


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

Tree = namedtuple("Tree", "points label start end low high first_leaf axes")


@njit()
def bound_box(points, order, start, end, low, high):
    """Write the corners of the box of points[order[start:end]] into `low` and `high`; return its longest axis."""
    for k in range(len(low)):
        low[k] = np.inf
        high[k] = -np.inf
    for i in range(start, end):
        for k in range(len(low)):
            value = points[order[i], k]
            low[k] = min(low[k], value)
            high[k] = max(high[k], value)
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
    n_nodes = 2 * first_leaf + 1
    order = np.arange(n)
    start = np.zeros(n_nodes, dtype=np.int64)
    end = np.zeros(n_nodes, dtype=np.int64)
    low = np.empty((n_nodes, d))
    high = np.empty((n_nodes, d))

    # Halve the points of each node at the median of its longest axis.
    end[0] = n
    for node in range(n_nodes):
        axis = bound_box(points, order, start[node], end[node], low[node], high[node])
        if node < first_leaf:
            middle = (start[node] + end[node]) >> 1
            inside = order[start[node] : end[node]]
            inside[:] = inside[np.argpartition(points[inside, axis], middle - start[node])]
            start[2 * node + 1] = start[node]
            end[2 * node + 1] = middle
            start[2 * node + 2] = middle
            end[2 * node + 2] = end[node]

    ordered = np.empty((n, d))
    for i in range(n):
        for k in range(d):
            ordered[i, k] = points[order[i], k]
    return Tree(ordered, order, start, end, low, high, first_leaf, axes)


@njit()
def has_repeats(tree):
    """Return True if neighbours in the tree's order show that a point occurs twice."""
    for i in range(len(tree.points) - 1):
        same = True
        for k in range(len(tree.axes)):
            same = same and tree.points[i, k] == tree.points[i + 1, k]
        if same:
            return True
    return False


@njit(forceinline=True)
def place_to_box(tree, place, node):
    """Return the smallest squared distance from a place to the box of a node."""
    total = 0.0
    for k in range(len(tree.axes)):
        step = max(tree.low[node, k] - place[k], place[k] - tree.high[node, k], 0.0)
        total += step * step
    return total


@njit(forceinline=True)
def between_boxes(tree, a, b):
    """Return the smallest and the largest squared distance between places of two boxes."""
    least = 0.0
    most = 0.0
    for k in range(len(tree.axes)):
        gap = max(tree.low[a, k] - tree.high[b, k], tree.low[b, k] - tree.high[a, k], 0.0)
        span = max(tree.high[a, k] - tree.low[b, k], tree.high[b, k] - tree.low[a, k])
        least += gap * gap
        most += span * span
    return least, most


@njit()
def centre(tree, a, b, place):
    """Write the middle between two boxes into `place`; return how far from it the midpoint of an edge may be."""
    low = tree.low
    high = tree.high
    spread = 0.0
    for k in range(len(tree.axes)):
        place[k] = 0.25 * (low[a, k] + high[a, k] + low[b, k] + high[b, k])
        spread += (high[a, k] - low[a, k] + high[b, k] - low[b, k]) ** 2
    return 0.25 * np.sqrt(spread)


@njit()
def nearby_point(tree, place):
    """Return a point near a place, and its squared distance.

    It is the nearest of the points in the leaf that always taking the nearer box leads to.
    """
    points = tree.points
    node = 0
    while node < tree.first_leaf:
        node = 2 * node + 1
        node += place_to_box(tree, place, node + 1) < place_to_box(tree, place, node)
    nearest = -1
    least = np.inf
    for z in range(tree.start[node], tree.end[node]):
        square = 0.0
        for k in range(len(tree.axes)):
            step = points[z, k] - place[k]
            square += step * step
        if square < least:
            nearest = z
            least = square
    return nearest, least


# Edges, a window of lengths at a time ---------------------------------------------------------------------------------
#
# The boxes of the tree are walked in pairs, so that only edges of about the right length are looked at. An edge is one integer,
# its *key*: both ends, and a vertex near its middle.

_BITS = 21  # bits of a key for a vertex, three times: two million vertices
_MASK = (1 << _BITS) - 1
# Edges of a window as they are found, then in order (`keys`, `lengths`); how many come before a slice of lengths; edges that
# wait for a later window, and their number (-1: none was kept waiting).
EdgeBuffer = namedtuple(
    "EdgeBuffer", "found_keys found_lengths keys lengths slice_start later_keys later_lengths waiting"
)


@njit(cache=True)
def new_buffer(capacity):
    """Return arrays for `edges_between`; they are handed on from call to call, as fresh memory is slow."""
    return EdgeBuffer(
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
def _larger_buffer(buffer, capacity):
    """Return a larger buffer with the edges that wait."""
    larger = new_buffer(capacity)
    larger.waiting[0] = buffer.waiting[0]
    for e in range(buffer.waiting[0]):
        larger.later_keys[e] = buffer.later_keys[e]
        larger.later_lengths[e] = buffer.later_lengths[e]
    return larger


@njit(forceinline=True)
def edge_key(x, y, middle):
    """Return the key of the edge {x, y}."""
    return middle << (2 * _BITS) | (y << _BITS) | x


@njit(forceinline=True)
def ends_of(key):
    """Return both ends of an edge, and a vertex near its middle; negative when one is so near that the lune is a cone."""
    return key & _MASK, (key >> _BITS) & _MASK, key >> (2 * _BITS)


@njit(forceinline=True)
def _middle_vertex(tree, a, b, shortest, place):
    """Return a vertex near the middle of the edges between two leaves; -1 when one is near enough for the lunes to be cones."""
    spread = centre(tree, a, b, place)
    middle, square = nearby_point(tree, place)
    near = CONE * np.sqrt(shortest) - spread - ROUNDING
    if near > 0.0 and square < near * near:
        return -1
    return middle


@njit()
def _edges_of_points(tree, shortest, longest, buffer):
    """Find all edges with shortest <= squared length < longest; return their number, -1 if the buffer is too small.

    Of few points, each two leaves are looked at once: when the window reaches their nearest places. Their longer edges wait.
    """
    # Names for fields of tuples, which would be counted as used in every turn of a loop.
    points = tree.points
    axes = tree.axes
    start = tree.start
    end = tree.end
    found_keys = buffer.found_keys
    found_lengths = buffer.found_lengths
    later_keys = buffer.later_keys
    later_lengths = buffer.later_lengths
    once = len(points) <= FEW_POINTS and buffer.waiting[0] >= 0
    waiting = buffer.waiting[0]
    size = 0
    place = np.empty(len(axes))
    box_pairs = np.zeros((272, 2), dtype=np.int64)
    top = 0
    while top >= 0:
        a = box_pairs[top, 0]
        b = box_pairs[top, 1]
        top -= 1
        least, most = between_boxes(tree, a, b)
        if least >= longest or most < shortest:
            continue

        # Two boxes that are no leaves: go on with their halves.
        if a < tree.first_leaf:
            for i in range(1, 3):
                for j in range(1, 3):
                    if a != b or i <= j:
                        top += 1
                        box_pairs[top, 0] = 2 * a + i
                        box_pairs[top, 1] = 2 * b + j
            continue

        # Two leaves: write down all edges between them that are not too short.
        if once and least < shortest:
            continue
        if max(size, waiting) + LEAF * LEAF > len(found_keys):
            return -1
        middle = _middle_vertex(tree, a, b, max(least, shortest), place)
        for x in range(start[a], end[a]):
            for y in range(x + 1 if a == b else start[b], end[b]):
                length = edge_length(points, x, y, axes)
                key = edge_key(x, y, middle)
                # Both places are written to, and one of them is kept: a branch here could not be foreseen.
                found_keys[size] = key
                found_lengths[size] = length
                later_keys[waiting] = key
                later_lengths[waiting] = length
                size += (shortest <= length) & (length < longest)
                waiting += once & (length >= longest)
    if once:
        return _take_waiting(buffer, longest, size, waiting)
    return size


@njit()
def _take_waiting(buffer, longest, size, waiting):
    """Move the edges that have waited for this window, of `waiting` in all, behind `size` others; return the new size.

    It returns -1 if the buffer is too small.
    """
    found_keys = buffer.found_keys
    found_lengths = buffer.found_lengths
    later_keys = buffer.later_keys
    later_lengths = buffer.later_lengths
    waited = buffer.waiting[0]
    if size + waited > len(found_keys):
        return -1
    still_waiting = 0
    for e in range(waiting):
        key = later_keys[e]
        length = later_lengths[e]
        if e < waited:  # the others are of this window's leaves, and too long for it
            found_keys[size] = key
            found_lengths[size] = length
            size += length < longest
        later_keys[still_waiting] = key
        later_lengths[still_waiting] = length
        still_waiting += length >= longest
    buffer.waiting[0] = still_waiting
    return size


@njit()
def _edges_of_matrix(data, shortest, longest, keys, lengths):
    """Find all edges with shortest <= length < longest; return their number, -1 if the buffer is too small.

    One end replaces the middle.
    """
    size = 0
    for x in range(len(data)):
        if size + len(data) - x > len(keys):
            return -1
        for y in range(x + 1, len(data)):
            length = data[x, y]
            keys[size] = edge_key(x, y, x)
            lengths[size] = length
            size += (shortest <= length) & (length < longest)
    return size


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
def edges_between(data, axes, tree, shortest, longest, buffer, max_edges, stop):
    """Put the edges with shortest <= length < longest, or a smaller bound, in order.

    Return the buffer, which may have grown, the number of edges, and the bound.
    """
    while True:
        if len(axes) == 0:
            m = _edges_of_matrix(data, shortest, longest, buffer.found_keys, buffer.found_lengths)
        else:
            m = _edges_of_points(tree, shortest, longest, buffer)
        if m >= 0:
            sort_edges(buffer, m, tree.label)
            return buffer, m, longest

        # Too many: take a shorter window; where it is as short as can be, a larger buffer.
        middle = shortest + 0.5 * (longest - shortest)
        if len(buffer.found_keys) >= min(WINDOW, max_edges) and shortest < middle < longest:
            longest = middle
        elif len(buffer.found_keys) < max_edges:
            buffer = _larger_buffer(buffer, min(2 * len(buffer.found_keys), max_edges))
        else:
            stop[0] = TOO_MANY_EDGES
            return buffer, 0, longest


@njit()
def first_window(data, axes, tree):
    """Return a length below which most vertices have their nearest neighbours."""
    n = len(data)
    total = 0.0
    for x in range(n):
        nearest = np.inf
        # Points that are next in the tree's order are near.
        for y in range(n) if len(axes) == 0 else range(max(0, x - 4), min(n, x + 5)):
            if y != x:
                nearest = min(nearest, edge_length(data, x, y, axes))
        total += root_of(nearest, axes)
    first = 2.0 * total / n if len(axes) == 0 else (2.5 * total / n) ** 2
    return max(first, 1e-6 * greatest_length(data, axes, tree), 5e-324)


@njit()
def next_window(data, axes, shortest, longest, m):
    """Return the bound of the window after one with m edges: as many again or more, and not too many more."""
    growth = longest
    if len(axes) == 0 or len(data) <= FEW_POINTS:
        growth = 0.5 * longest
    ratio = max(1.0, 0.5 * WINDOW / (m + 1))
    return longest + max(min(growth, ratio * (longest - shortest)), 1e-6 * longest)


@njit()
def greatest_length(data, axes, tree):
    """Return an upper bound of all lengths."""
    if len(axes) == 0:
        return data.max()
    return between_boxes(tree, 0, 0)[1]


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
def is_near_middle(data, axes, x, y, z, length):
    """Return True if z is nearer than the length of {x, y} to every place where a point of the lune can be.

    With z at distance b from the line through x and y, and a from their midpoint along it, the farthest such place is on the
    lune's rim: a^2 + (sqrt(3)/2 L + b)^2 < L^2. For a matrix it is never known.
    """
    if len(axes) == 0 or length == 0.0 or z in (x, y):
        return False
    along = 0.0
    apart = 0.0
    for k in range(len(axes)):
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
def _take_component(data, axes, rows, label, x, y, z, lune, waiting):
    """Take the component of z out of the lune; return its apex, whose longer edge to {x, y} is shortest, and that edge."""
    apex = -1
    apex_value = np.inf
    waiting[0] = z
    lune[z >> 6] ^= ONE << np.uint64(z & 63)
    top = 0
    while top >= 0:
        z = waiting[top]
        top -= 1
        value = max(edge_length(data, x, z, axes), edge_length(data, y, z, axes))
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
def _count_components(data, axes, rows, label, x, y, search):
    """Return the number of components of the lune, which is emptied; the apexes are left in the search, nearest first."""
    lune = search.lune
    apexes = search.apexes
    values = search.values
    count = 0
    for w in range(len(lune)):
        while lune[w]:
            z = (w << 6) + lowest_bit(lune[w])
            apex, value = _take_component(data, axes, rows, label, x, y, z, lune, search.waiting)
            # Insert the apex by its value, then by its label.
            i = count
            while i > 0 and (values[i - 1] > value or (values[i - 1] == value and label[apexes[i - 1]] > label[apex])):
                values[i] = values[i - 1]
                apexes[i] = apexes[i - 1]
                i -= 1
            values[i] = value
            apexes[i] = apex
            count += 1
    return count


# Relations between loops ----------------------------------------------------------------------------------------------
#
# Idea: a relation is a cycle that bounds. Each of its edges is replaced by the two other edges of a triangle on it, again and
# again, until all have empty lunes. Those that joined two components form a tree and count as nothing; so the others, the
# creators of loops, determine which cycle it is. Persistence is the reduction of these short sets, youngest creator first.

# Edges with an empty lune, as lists at their ends: the first link of a vertex, and for a link the next one, the edge's other
# end, and the number of the loop that it created (-1: none, it joined two components).
Graph = namedtuple("Graph", "head links")
# Loops by number: the edges that create them; killer edges with two apexes, -1 while alive; the columns of the dead ones, the
# column of loop c from word `first_word(c)` on; and space for one column.
Loops = namedtuple("Loops", "created killed columns column")


@njit()
def _with_edge(graph, size, a, b, loop):
    """Return the graph with one more edge {a, b}, after `size` of them; `loop` is the number of the loop that it created."""
    head = graph.head
    links = graph.links
    if 2 * size + 2 > len(links):
        links = twice_as_long(links)
    for link, vertex, other_end in ((2 * size, a, b), (2 * size + 1, b, a)):
        links[link, 0] = head[vertex]
        links[link, 1] = other_end
        links[link, 2] = loop
        head[vertex] = link
    return Graph(head, links)


@njit(forceinline=True)
def first_word(loop):
    """Return where the column of a loop begins.

    Before it are the columns of the older loops, each as long as its youngest creator needs.
    """
    full_words = loop >> 6
    return 32 * full_words * (full_words + 1) + (loop & 63) * (full_words + 1)


@njit()
def _new_loops(capacity):
    return Loops(
        np.empty((capacity, 2), dtype=np.int64),
        np.empty((capacity, 4), dtype=np.int64),
        np.empty(first_word(capacity), dtype=np.uint64),
        np.zeros(capacity >> 6, dtype=np.uint64),
    )


@njit()
def _with_loop(loops, born, x, y, spare, stop):
    """Return the loops with one more, created by the edge {x, y}, if `spare` bytes hold them."""
    if born == len(loops.created):
        if 8 * (first_word(born) + first_word(2 * born)) > spare:
            stop[0] = TOO_MANY_LOOPS
            return loops
        columns = np.empty(first_word(2 * born), np.uint64)
        for w in range(len(loops.columns)):
            columns[w] = loops.columns[w]
        loops = Loops(
            twice_as_long(loops.created), twice_as_long(loops.killed), columns, np.zeros(born >> 5, np.uint64)
        )
    loops.created[born, 0] = x
    loops.created[born, 1] = y
    for k in range(4):
        loops.killed[born, k] = -1
    return loops


@njit(forceinline=True)
def _vertex_of_lune(data, axes, rows, label, a, b):
    """Return a vertex of the lune that {a, b} had when it arrived, -1 if there is none.

    It is one near the middle, or the one whose longer edge to a and b is shortest.
    """
    length = edge_length(data, a, b, axes)
    near = (0.63 if len(axes) == 0 else 0.4) * length  # a little more than half of it, or a quarter of the square
    best = -1
    best_value = np.inf
    for w in range(rows.shape[1]):
        both = rows[a, w] & rows[b, w]
        while both:
            z = (w << 6) + lowest_bit(both)
            both &= both - ONE
            to_a = edge_length(data, a, z, axes)
            to_b = edge_length(data, b, z, axes)
            value = max(to_a, to_b)
            if z in (a, b) or value > length or value >= best_value:
                continue
            # `rows` holds later edges too: both edges to z must have come before {a, b}.
            if precedes(to_a, label[a], label[z], length, label[a], label[b]) and precedes(
                to_b, label[b], label[z], length, label[a], label[b]
            ):
                if value <= near:
                    return z
                best = z
                best_value = value
    return best


@njit(forceinline=True)
def _add_in_creators(data, axes, rows, label, graph, a, b, column, edges):
    """Add the edge {a, b}, written in creators, to `column` (a bitset, mod 2); `edges` is space for a stack of edges."""
    edges[0, 0] = a
    edges[0, 1] = b
    top = 0
    while top >= 0:
        a = edges[top, 0]
        b = edges[top, 1]
        top -= 1

        # Is it in the graph? Then its lune was empty, and it is a creator or an edge of the tree.
        link = graph.head[a]
        while link >= 0 and graph.links[link, 1] != b:
            link = graph.links[link, 0]
        if link >= 0:
            creator = graph.links[link, 2]
            if creator >= 0:
                column[creator >> 6] ^= ONE << np.uint64(creator & 63)
            continue

        # Otherwise the two other edges of a triangle that was complete with it replace it.
        z = _vertex_of_lune(data, axes, rows, label, a, b)
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
def _youngest(column):
    """Return the youngest creator of a column, -1 when it is empty."""
    for w in range(len(column) - 1, -1, -1):
        if column[w]:
            bit = 63
            while not (column[w] >> np.uint64(bit)) & ONE:
                bit -= 1
            return (w << 6) + bit
    return -1


@njit()
def reduce_column(column, columns, killed):
    """Reduce a relation, the bitset of its creators, by those of the dead loops; return the loop it kills, -1 for none."""
    pivot = _youngest(column)
    while pivot >= 0 and killed[pivot, 0] >= 0:
        first = first_word(pivot)
        for w in range((pivot >> 6) + 1):
            column[w] ^= columns[first + w]
        pivot = _youngest(column)
    return pivot


@njit(forceinline=True)
def _kill_loops(data, axes, rows, label, graph, loops, x, y, search, edges):
    """Reduce the relations that an edge with a disconnected lune brings; return how many loops die of them."""
    dead = 0
    count = _count_components(data, axes, rows, label, x, y, search)
    first = search.apexes[0]
    for i in range(1, count):
        further = search.apexes[i]
        loops.column[:] = 0
        for a, b in ((x, first), (first, y), (y, further), (further, x)):
            _add_in_creators(data, axes, rows, label, graph, a, b, loops.column, edges)
        loop = reduce_column(loops.column, loops.columns, loops.killed)
        if loop >= 0:
            start = first_word(loop)
            for w in range((loop >> 6) + 1):
                loops.columns[start + w] = loops.column[w]
            loops.killed[loop, 0] = x
            loops.killed[loop, 1] = y
            loops.killed[loop, 2] = first
            loops.killed[loop, 3] = further
            dead += 1
    return dead


# When to stop ---------------------------------------------------------------------------------------------------------
#
# Idea: after the last edge with an empty lune no loop is born any more. A point that is nearer to all of two boxes than they
# are to each other is in the lune of every edge between them. A point near the middle is tried, then the points of two leaves;
# the few edges that remain are searched. Here a lune holds strictly shorter edges only: where lengths tie, the kernel may read
# on for nothing, and its answer is the same.


@njit()
def last_empty_lune(data, axes, tree, shortest):
    """Return the greatest length of an edge with an empty lune among those not shorter than `shortest`, 0 for none."""
    if len(axes) == 0:
        return _last_of_matrix(data, shortest)
    return _last_of_points(tree, shortest)


@njit()
def _last_of_matrix(data, shortest):
    latest = 0.0
    for x in range(len(data)):
        for y in range(x + 1, len(data)):
            length = data[x, y]
            if length >= max(shortest, latest):
                z = 0
                while z < len(data) and (data[x, z] >= length or data[y, z] >= length):
                    z += 1
                if z == len(data):
                    latest = length
    return latest


@njit()
def _last_of_points(tree, shortest):
    points = tree.points
    start = tree.start
    end = tree.end
    latest = 0.0
    box_pairs = np.zeros((272, 3), dtype=np.int64)  # two boxes, and a point that may be between them
    nodes = np.empty(256, dtype=np.int64)
    place = np.empty(len(tree.axes))
    top = 0
    while top >= 0:
        a = box_pairs[top, 0]
        b = box_pairs[top, 1]
        z = box_pairs[top, 2]
        top -= 1
        shortest = max(shortest, latest)

        # Is a point in the lunes of all edges between the boxes: the one of the larger boxes, or one near the middle?
        if between_boxes(tree, a, b)[1] < shortest or _is_between(tree, z, a, b):
            continue
        if a != b:
            centre(tree, a, b, place)
            z = nearby_point(tree, place)[0]
            if _is_between(tree, z, a, b):
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

        # Two leaves: edge by edge. The point z, the points of both leaves, and then all are looked at.
        for x in range(start[a], end[a]):
            for y in range(x + 1 if a == b else start[b], end[b]):
                length = edge_length(points, x, y, tree.axes)
                if length < shortest or length <= latest or _is_in_lune(tree, z, x, y, length):
                    continue
                met = _leaf_meets_lune(tree, x, y, length, a) or _leaf_meets_lune(tree, x, y, length, b)
                if not met and _is_empty_lune(tree, x, y, length, nodes, place):
                    latest = length
    return latest


@njit(forceinline=True)
def _is_in_lune(tree, z, x, y, length):
    """Return True if z is nearer to both ends of {x, y} than its length."""
    points = tree.points
    axes = tree.axes
    return z != x and z != y and edge_length(points, x, z, axes) < length and edge_length(points, y, z, axes) < length


@njit(forceinline=True)
def _leaf_meets_lune(tree, x, y, length, leaf):
    """Return True if a point of a leaf is in the lune of {x, y}."""
    met = False
    for z in range(tree.start[leaf], tree.end[leaf]):
        met = met or _is_in_lune(tree, z, x, y, length)
    return met


@njit()
def _is_empty_lune(tree, x, y, length, nodes, place):
    """Return True if no point is in the lune of {x, y}; boxes nearer to its midpoint are looked at first."""
    for k in range(len(tree.axes)):
        place[k] = 0.5 * (tree.points[x, k] + tree.points[y, k])
    reach = (0.86605 * np.sqrt(length) + ROUNDING) ** 2  # a lune lies within sqrt(3)/2 of the length
    nodes[0] = 0
    top = 0
    while top >= 0:
        node = nodes[top]
        top -= 1
        if place_to_box(tree, place, node) > reach:
            continue
        if node < tree.first_leaf:
            nearer = 2 * node + 1
            farther = 2 * node + 2
            if place_to_box(tree, place, farther) < place_to_box(tree, place, nearer):
                nearer, farther = farther, nearer
            nodes[top + 1] = farther
            nodes[top + 2] = nearer
            top += 2
        elif _leaf_meets_lune(tree, x, y, length, node):
            return False
    return True


@njit(forceinline=True)
def _is_nearer(tree, z, a, b):
    """Return True if the point z is nearer to every place of box b than any place of box a is.

    |z - y|^2 - |x - y|^2 is a sum over the axes; along one it is greatest with y at an end of b and x as near to it as a allows.
    """
    total = 0.0
    size = 0.0
    for k in range(len(tree.axes)):
        most = -np.inf
        for y in (tree.low[b, k], tree.high[b, k]):
            gap = max(tree.low[a, k] - y, y - tree.high[a, k], 0.0)
            step = tree.points[z, k] - y
            most = max(most, step * step - gap * gap)
            size = max(size, step * step, gap * gap)
        total += most
    return total < -1e-12 * size  # rounding must not decide


@njit(forceinline=True)
def _is_between(tree, z, a, b):
    """Return True if z is in the lune of every edge between two boxes."""
    return _is_nearer(tree, z, a, b) and _is_nearer(tree, z, b, a)


# The pairing ----------------------------------------------------------------------------------------------------------


@njit()
def _root(parent, x):
    """Return the vertex that represents the component of x."""
    while parent[x] != x:
        parent[x] = parent[parent[x]]
        x = parent[x]
    return x


@njit()
def pair_edges(data, axes, tree, max_length, m, longest, buffer, spare, stop):
    """Pair the edges that create loops, (c, 2), with the edges that kill them and their two apexes, (c, 4), -1 for none.

    `data` holds distances, or points in the order of `tree`; a matrix needs the tree's labels alone. Lengths are squared for
    points. The buffer may have the first window already: m edges in order, all that are shorter than `longest`; else m is -1.
    Besides the n x n bits `spare` bytes may be taken: half for the edges of a window, half for the columns of loops. When these
    do not suffice, or another thread writes into `stop` (1,), `stop` holds the reason and the result is incomplete.

    Return the buffer for the next call, both tables, and the length of the edge that was read last.
    """
    n = len(data)
    label = tree.label
    words = (n + 63) >> 6
    rows = np.zeros((n, words), dtype=np.uint64)
    for v in range(n):
        join(rows, v, v)
    search = LuneSearch(
        np.empty(words, np.uint64),
        np.empty(words, np.uint64),
        np.empty(n, np.int64),
        np.empty(n, np.int64),
        np.empty(n),
    )
    graph = Graph(np.full(n, -1), np.empty((8 * n, 3), np.int64))
    graph_size = 0
    loops = _new_loops(64)
    born = 0
    alive = 0
    parent = np.arange(n)
    n_components = n
    edges = np.empty((256, 2), dtype=np.int64)
    last = -1.0  # the length of the last edge with an empty lune, once it is known
    shortest = 0.0
    length = 0.0
    greatest = greatest_length(data, axes, tree)
    done = greatest == 0
    if m < 0:
        longest = first_window(data, axes, tree)
        buffer.waiting[0] = 0
    while not done:
        if m < 0:
            buffer, m, longest = edges_between(
                data, axes, tree, shortest, longest, buffer, spare // (2 * EDGE_BYTES), stop
            )
        for e in range(m):
            x, y, middle = ends_of(buffer.keys[e])
            length = buffer.lengths[e]
            if stop[0] or length > max_length or (alive == 0 and 0 <= last < length):
                done = True
                break

            # A cone changes nothing, nor does a connected lune; while no loop is alive, none can be killed either.
            near = middle < 0 or (words > FEW_WORDS and is_near_middle(data, axes, x, y, middle, length))
            if near or is_cone(rows, x, y, middle):
                join(rows, x, y)
                continue
            z = _write_lune(rows, x, y, search.lune)
            if has_bit(search.lune, middle):
                z = middle
            connected = z >= 0 and (alive == 0 or is_connected(rows, search.lune, z, search.left))
            join(rows, x, y)
            if connected:
                continue

            if z >= 0:  # the lune is disconnected
                alive -= _kill_loops(data, axes, rows, label, graph, loops, x, y, search, edges)
            else:  # the lune is empty
                a = _root(parent, x)
                b = _root(parent, y)
                graph = _with_edge(graph, graph_size, x, y, born if a == b else -1)
                graph_size += 1
                if a != b:  # the edge joins two components
                    parent[a] = b
                    n_components -= 1
                else:  # it creates a loop
                    loops = _with_loop(loops, born, x, y, spare // 2, stop)
                    born += 1
                    alive += 1

            # Once all is one component and no loop is alive, compute up to which length edges can matter.
            if alive == 0 and n_components == 1 and last < 0:
                last = last_empty_lune(data, axes, tree, length)
        if stop[0] != 0 or longest > greatest or (alive == 0 and 0 <= last < longest):
            done = True
        start = shortest
        shortest = longest
        longest = next_window(data, axes, start, longest, m)
        m = -1
    return buffer, loops.created[:born], loops.killed[:born], length


@njit(nogil=True, cache=True)
def pair_matrix(data, max_length, buffer_arrays, spare, stop):
    """Pair the edges of a matrix of distances as `pair_edges` does; return the buffer and both tables."""
    nothing = np.zeros((1, 3))
    zero = np.zeros(1, np.int64)
    tree = Tree(nothing, np.arange(len(data)), zero, zero, nothing, nothing, 0, (0, 0, 0))
    buffer, created, killed, _ = pair_edges(
        data, (), tree, max_length, -1, 0.0, EdgeBuffer(*buffer_arrays), spare, stop
    )
    return buffer, created, killed


# Films of clouds ------------------------------------------------------------------------------------------------------
#
# Idea: in a film the points move, but hardly against their neighbours. The list of one frame's edges shorter than some `reach`
# holds for the next frame all that are shorter than a bound, which follows from the points' motion; only their lengths are new.
# Where the list ends, the tree takes over, so a bad list costs time and nothing else.
#
# Source: Verlet 1967 (lists of neighbours).


@njit()
def _same_tree_around(tree, points):
    """Return the same tree around other points, which come in its order."""
    order = np.arange(len(points))
    low = np.empty(tree.low.shape)
    high = np.empty(tree.low.shape)
    for node in range(len(low)):
        bound_box(points, order, tree.start[node], tree.end[node], low[node], high[node])
    return Tree(points, tree.label, tree.start, tree.end, low, high, tree.first_leaf, tree.axes)


@njit()
def move_tree(tree, points, reach):
    """Return the same tree around points that have moved, and a bound.

    All edges whose squared length is below the bound now were shorter than `reach` before: points of two leaves have come
    nearer by no more than the largest difference of a step of one and a step of the other.
    """
    places = np.empty(points.shape)
    steps = np.empty(points.shape)
    for i in range(len(points)):
        for k in range(len(tree.axes)):
            places[i, k] = points[tree.label[i], k]
            steps[i, k] = places[i, k] - tree.points[i, k]
    moved = _same_tree_around(tree, places)
    of_steps = _same_tree_around(tree, steps)
    bound = reach
    for a in range(tree.first_leaf, len(tree.low)):
        for b in range(a, len(tree.low)):
            apart = between_boxes(moved, a, b)[0]
            if apart < bound:
                nearer = np.sqrt(between_boxes(of_steps, a, b)[1])
                left = max(np.sqrt(reach) - nearer - 1e-12, 0.0)  # coordinates are at most 1
                bound = min(bound, max(apart, left * left))
    return moved, bound


@njit()
def _edges_of_list(keys, tree, bound, buffer):
    """Find the listed edges that are shorter than a bound; return their number.

    An end replaces a middle that was near enough for the lune to be a cone: the points have moved.
    """
    buffer.waiting[0] = -1
    found_keys = buffer.found_keys
    found_lengths = buffer.found_lengths
    points = tree.points
    size = 0
    for e in range(len(keys)):
        x, y, middle = ends_of(keys[e])
        length = edge_length(points, x, y, tree.axes)
        found_keys[size] = keys[e] if middle >= 0 else edge_key(x, y, x)
        found_lengths[size] = length
        size += length < bound
    return size


@njit(nogil=True, cache=True)
def pair_clouds(data, axes, starts, max_lengths, tree_arrays, keys, reach, end, buffer_arrays, spare, stop):
    """Pair the edges of clouds of points as `pair_edges` does, by the points' numbers in their cloud.

    The points of cloud c are data[starts[c]:starts[c + 1]]. Known of the cloud before are its tree; the keys of its edges
    shorter than `reach`, if they are listed; and the length of the last edge that was read, `end`.

    Return the buffer; tree, keys, reach and end of the last cloud; both tables; and how many loops each cloud has, -1 when
    points are repeated: then nothing is done.
    """
    tree = Tree(*tree_arrays)
    buffer = EdgeBuffer(*buffer_arrays)
    max_edges = spare // (2 * EDGE_BYTES)
    counts = np.zeros(len(max_lengths), np.int64)
    total = 0
    created = np.empty((64, 2), np.int64)
    killed = np.empty((64, 4), np.int64)
    for c in range(len(counts)):
        points = data[starts[c] : starts[c + 1]]
        if len(points) < 4:
            continue

        # Can the list of the cloud before be used again? Otherwise a new tree is built.
        moved = tree
        bound = 0.0
        if len(points) == len(tree.points):
            moved, bound = move_tree(tree, points, reach if len(keys) else end)
        again = 0 < len(keys) <= len(buffer.found_keys) and SLACK * end <= bound
        if not again:
            tree = build_tree(points, axes)
            moved = tree
            keys = keys[:0]
        if has_repeats(moved):
            counts[c] = -1
            continue

        # The first window: from the list, or from the tree for a new list if the cloud is like the one before.
        m = -1
        longest = 0.0
        if again:
            longest = SLACK * end
            m = _edges_of_list(keys, moved, longest, buffer)
            sort_edges(buffer, m, moved.label)
        elif bound > ALIKE * end:
            buffer.waiting[0] = 0
            buffer, m, longest = edges_between(tree.points, axes, tree, 0.0, REACH * end, buffer, max_edges, stop)
            keys = buffer.keys[:m].copy()
            reach = longest
        buffer, loops, killers, end = pair_edges(
            moved.points, axes, moved, max_lengths[c], m, longest, buffer, spare, stop
        )

        # Append the pairs, by the numbers of the points in their cloud.
        counts[c] = len(loops)
        while total + len(loops) > len(created):
            created = twice_as_long(created)
            killed = twice_as_long(killed)
        for i in range(len(loops)):
            for k in range(2):
                created[total, k] = moved.label[loops[i, k]]
            for k in range(4):
                killed[total, k] = -1
                if killers[i, k] >= 0:
                    killed[total, k] = moved.label[killers[i, k]]
            total += 1
    return buffer, (tree, keys, reach, end), created[:total], killed[:total], counts
