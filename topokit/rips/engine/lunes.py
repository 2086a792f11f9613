"""Lunes as the AND of two rows of bits: is one a cone, is it connected, and what are its components?

`rows` (n, words) holds for each vertex the bitset of the vertices that it is joined to; a vertex is joined to itself.
"""

from __future__ import annotations

from collections import namedtuple

import numpy as np

from . import compiled, inlined
from .edges import are_points, edge_length, ends_of, precedes
from .tree import between_boxes, nearby_point

ONE = np.uint64(1)
# The powers of two differ modulo 67, so that the remainder determines which bit is set.
BIT_OF_REMAINDER = np.zeros(67, dtype=np.int64)
for _bit in range(64):
    BIT_OF_REMAINDER[2**_bit % 67] = _bit

# Two bitsets of vertices, a list of vertices that wait, and the apexes of components with the longer edge of each.
Lune = namedtuple("Lune", "bits left waiting apexes values")
# A grid over the points of a tree: for each cell 1 more than a vertex near its centre, 0 until it is sought; cells along each
# axis; and cells in a unit of length.
Grid = namedtuple("Grid", "vertex sides scale")


@inlined
def lowest_bit(word):
    """Return the position of the lowest bit that is set."""
    return BIT_OF_REMAINDER[(word & (~word + ONE)) % np.uint64(67)]


@inlined
def has_bit(bits, i):
    """Return bit i of a bitset, as the number 0 or 1."""
    return (bits[i >> 6] >> np.uint64(i & 63)) & ONE


@inlined
def join(rows, x, y):
    """Set the bits of the edge {x, y}."""
    rows[x, y >> 6] |= ONE << np.uint64(y & 63)
    rows[y, x >> 6] |= ONE << np.uint64(x & 63)


@compiled
def join_edges(points, tree, rows, shortest, longest):
    """Set the bits of all edges with shortest <= length < longest, and perhaps of shorter ones."""
    start = tree.start
    end = tree.end
    for a in range(tree.first_leaf, len(start)):
        for b in range(a, len(start)):
            least, most = between_boxes(tree.low, tree.high, a, b)
            if least < longest and most >= shortest:
                for x in range(start[a], end[a]):
                    for y in range(start[b], end[b]):
                        if edge_length(points, x, y) < longest:
                            join(rows, x, y)


@compiled
def new_lune(n):
    """Return space for the search of a lune of n vertices."""
    words = (n + 63) >> 6
    return Lune(
        np.empty(words, np.uint64),
        np.empty(words, np.uint64),
        np.empty(n, np.int64),
        np.empty(n, np.int64),
        np.empty(n),
    )


# Cones ----------------------------------------------------------------------------------------------------------------


@inlined
def is_cone(rows, x, y, z):
    """Return True if z is in the lune of {x, y} and joined to all of it."""
    if not (rows[x, z >> 6] & rows[y, z >> 6]) >> np.uint64(z & 63) & ONE:
        return False
    outside = np.uint64(0)
    for w in range(rows.shape[1]):
        outside |= rows[x, w] & rows[y, w] & ~rows[z, w]
    return outside == 0


@compiled
def new_grid(tree):
    """Return a grid of up to eight cells for each point."""
    sides = np.empty(3, np.int64)
    width = 0.0
    for k in range(3):
        width = max(width, tree.high[0, k] - tree.low[0, k])
    scale = 1.0 / width if width > 0.0 else 0.0
    cells = 1
    while scale > 0.0 and cells <= 8 * len(tree.points):
        scale *= 1.2
        cells = 1
        for k in range(3):
            cells *= int((tree.high[0, k] - tree.low[0, k]) * scale) + 1
    scale /= 1.2
    for k in range(3):
        sides[k] = int((tree.high[0, k] - tree.low[0, k]) * scale) + 1
    return Grid(np.zeros(sides[0] * sides[1] * sides[2], np.int64), sides, scale)


@compiled
def find_middles(tree, grid, keys, m):
    """Put a vertex near the middle of each of m edges into its key."""
    points = tree.points
    vertex = grid.vertex
    sides = grid.sides
    scale = grid.scale
    low = tree.low
    place = np.empty(3)
    for e in range(m):
        x, y, _ = ends_of(keys[e])
        cell = 0
        for k in range(3):
            cell = sides[k] * cell + int((0.5 * (points[x, k] + points[y, k]) - low[0, k]) * scale)
        z = vertex[cell] - 1
        if z < 0:
            rest = cell
            for k in range(2, -1, -1):
                place[k] = low[0, k] + (rest % sides[k] + 0.5) / scale
                rest //= sides[k]
            z = nearby_point(tree, place)
            vertex[cell] = z + 1
        keys[e] |= np.int64(z) << 42


# Connected lunes, and components --------------------------------------------------------------------------------------


@inlined
def write_lune(rows, x, y, bits):
    """Write the lune of {x, y} into a bitset; return its first vertex, -1 when it is empty."""
    for w in range(len(bits)):
        bits[w] = rows[x, w] & rows[y, w]
    for w in range(len(bits)):
        if bits[w]:
            return (w << 6) + lowest_bit(bits[w])
    return -1


@inlined
def is_connected(rows, bits, z, left):
    """Return True if a lune is connected; False may also mean that the order was unlucky, and the full search decides.

    Vertices that z reaches are absorbed, and then, one by one, vertices that share a neighbour in the lune with those.
    `left` (words,) is space for a bitset.
    """
    words = len(bits)
    some_left = np.uint64(0)
    for w in range(words):
        left[w] = bits[w] & ~rows[z, w]
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
            shared |= bits[w] & rows[v, w] & ~left[w]
            left[w] &= ~rows[v, w]
            some_left |= left[w]
        if not shared:
            return False
    return True


@inlined
def first_of(low, high):
    """Return the lowest bit of two words, of which one is not 0."""
    return lowest_bit(low if low else high) + (0 if low else 64)


@inlined
def are_connected(rows, low, high, z):
    """Do what `is_connected` does for a lune in two words."""
    left_low = low & ~rows[z, 0]
    left_high = high & ~rows[z, 1]
    while left_low | left_high:
        v = first_of(left_low, left_high)
        if not (low & rows[v, 0] & ~left_low) | (high & rows[v, 1] & ~left_high):
            return False
        left_low &= ~rows[v, 0]
        left_high &= ~rows[v, 1]
    return True


@inlined
def take_component(data, rows, label, x, y, z, lune):
    """Take the component of z out of the lune; return its apex, whose longer edge to {x, y} is shortest, and that edge."""
    bits = lune.bits
    waiting = lune.waiting
    apex = -1
    apex_value = np.inf
    waiting[0] = z
    bits[z >> 6] ^= ONE << np.uint64(z & 63)
    top = 0
    while top >= 0:
        z = waiting[top]
        top -= 1
        value = max(edge_length(data, x, z), edge_length(data, y, z))
        if value < apex_value or (value == apex_value and label[z] < label[apex]):
            apex = z
            apex_value = value
        for w in range(len(bits)):
            reached = bits[w] & rows[z, w]
            bits[w] ^= reached
            while reached:
                top += 1
                waiting[top] = (w << 6) + lowest_bit(reached)
                reached &= reached - ONE
    return apex, apex_value


@compiled
def count_components(data, rows, label, x, y, lune):
    """Return the number of components of the lune, which is emptied; the apexes are left in `lune`, nearest first."""
    bits = lune.bits
    apexes = lune.apexes
    values = lune.values
    count = 0
    for w in range(len(bits)):
        while bits[w]:
            z = (w << 6) + lowest_bit(bits[w])
            apex, value = take_component(data, rows, label, x, y, z, lune)
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


@compiled
def vertex_of_lune(data, label, rows, a, b):
    """Return a vertex of the lune that {a, b} had when it arrived, -1 if there is none.

    It is the first in the rows that is near the middle, or the one whose longer edge to a and b is shortest.
    """
    length = edge_length(data, a, b)
    near = (0.4 if are_points(data) else 0.63) * length  # a little more than a quarter of the square, or than half
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


@inlined
def is_in_lune(data, label, x, y, length, z):
    """Return True if both edges from z, the longer one as long as {x, y}, come before {x, y}."""
    if z in (x, y):
        return False
    to_x = edge_length(data, x, z)
    to_y = edge_length(data, y, z)
    return precedes(to_x, label[x], label[z], length, label[x], label[y]) and precedes(
        to_y, label[y], label[z], length, label[x], label[y]
    )
