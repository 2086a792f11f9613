"""Relations between loops, written in creators and reduced.

A relation is a cycle that bounds. Each of its edges is replaced by the two other edges of a triangle on it, again and again,
until all have empty lunes; those that joined two components form a tree and count as nothing, so the others, the *creators* of
loops, say which cycle it is. Persistence is the reduction of these short sets, youngest creator first.
"""

from __future__ import annotations

from collections import namedtuple

import numpy as np

from ._edges import TOO_MANY_LOOPS, edge_length, precedes
from ._jit import njit

# Edges with an empty lune, as lists at their ends: the first link of a vertex, and for a link the next one, the edge's other
# end, and the number of the loop that it created (-1: none, it joined two components).
Graph = namedtuple("Graph", "head links")
# Loops by number: the edges that create them; killer edges with two apexes, -1 while alive; the columns of the dead ones, of
# which that of loop c begins at word `first_word(c)`; and room for one column.
Loops = namedtuple("Loops", "created killed columns column")

ONE = np.uint64(1)
_BIT = np.zeros(67, dtype=np.int64)
for _k in range(64):
    _BIT[2**_k % 67] = _k  # the powers of two differ modulo 67


@njit(forceinline=True)
def lowest(word):
    """Position of the lowest bit that is set."""
    return _BIT[(word & (~word + ONE)) % np.uint64(67)]


@njit()
def twice_as_long(rows):
    """A table of integers with room for as many rows again; a loop compiles ten times as fast as `np.concatenate`."""
    longer = np.empty((2 * len(rows), rows.shape[1]), np.int64)
    for i in range(len(rows)):
        for k in range(rows.shape[1]):
            longer[i, k] = rows[i, k]
    return longer


@njit(forceinline=True)
def _lune_vertex(data, axes, rows, label, a, b):
    """A vertex of the lune that {a, b} had when it arrived: one near the middle, or that whose longer edge is shortest."""
    length = edge_length(data, a, b, axes)
    near = (0.63 if len(axes) == 0 else 0.4) * length  # a little more than half of it, or a quarter of the square
    best, best_value = -1, np.inf
    for w in range(rows.shape[1]):
        both = rows[a, w] & rows[b, w]
        while both:
            z = (w << 6) + lowest(both)
            both &= both - ONE
            to_a, to_b = edge_length(data, a, z, axes), edge_length(data, b, z, axes)
            value = max(to_a, to_b)
            if z in (a, b) or value > length or value >= best_value:
                continue
            x, y, apex = label[a], label[b], label[z]
            if precedes(to_a, x, apex, length, x, y) and precedes(to_b, y, apex, length, x, y):
                if value <= near:
                    return z
                best, best_value = z, value
    return best


@njit(forceinline=True)
def add_in_creators(data, axes, rows, label, graph, a, b, column, stack):
    """Add the edge {a, b}, written in creators, to `column` (a bitset, mod 2)."""
    stack[0, 0], stack[0, 1] = a, b
    top = 0
    while top >= 0:
        a, b = stack[top, 0], stack[top, 1]
        top -= 1
        link = graph.head[a]
        while link >= 0 and graph.links[link, 1] != b:
            link = graph.links[link, 0]
        if link >= 0:  # its lune was empty; an edge that joined two components counts as nothing
            creator = graph.links[link, 2]
            if creator >= 0:
                column[creator >> 6] ^= ONE << np.uint64(creator & 63)
            continue
        z = _lune_vertex(data, axes, rows, label, a, b)
        if z < 0:
            raise AssertionError("an edge with an empty lune was passed over: please report this cloud to topokit")
        if top + 2 >= len(stack):
            stack = twice_as_long(stack)
        stack[top + 1, 0], stack[top + 1, 1] = a, z
        stack[top + 2, 0], stack[top + 2, 1] = z, b
        top += 2


@njit()
def with_edge(graph, size, a, b, creator):
    """The graph with one more edge {a, b}, after `size` of them."""
    head, links = graph
    if 2 * size + 2 > len(links):
        links = twice_as_long(links)
    for link, v, other in ((2 * size, a, b), (2 * size + 1, b, a)):
        links[link, 0], links[link, 1], links[link, 2] = head[v], other, creator
        head[v] = link
    return Graph(head, links)


@njit(forceinline=True)
def first_word(loop):
    """Where the column of a loop begins: before it are those of the older ones, each as long as its youngest creator needs."""
    whole, rest = loop >> 6, loop & 63
    return 32 * whole * (whole + 1) + rest * (whole + 1)


@njit()
def new_loops(capacity):
    return Loops(
        np.empty((capacity, 2), dtype=np.int64),
        np.empty((capacity, 4), dtype=np.int64),
        np.empty(first_word(capacity), dtype=np.uint64),
        np.zeros(capacity >> 6, dtype=np.uint64),
    )


@njit()
def with_loop(loops, born, x, y, spare, halt):
    """The loops with one more, created by the edge {x, y}, if `spare` bytes hold them."""
    if born == len(loops.created):
        if 8 * (first_word(born) + first_word(2 * born)) > spare:
            halt[0] = TOO_MANY_LOOPS
            return loops
        columns = np.empty(first_word(2 * born), np.uint64)
        for w in range(len(loops.columns)):
            columns[w] = loops.columns[w]
        loops = Loops(
            twice_as_long(loops.created), twice_as_long(loops.killed), columns, np.zeros(born >> 5, np.uint64)
        )
    loops.created[born, 0], loops.created[born, 1] = x, y
    for k in range(4):
        loops.killed[born, k] = -1
    return loops


@njit()
def _pivot(column):
    """The youngest creator of a column, -1 when it is empty."""
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
    pivot = _pivot(column)
    while pivot >= 0 and killed[pivot, 0] >= 0:
        first = first_word(pivot)
        for w in range((pivot >> 6) + 1):
            column[w] ^= columns[first + w]
        pivot = _pivot(column)
    return pivot
