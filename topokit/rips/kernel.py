"""Degree-1 Rips persistence: lunes as the AND of two bitsets.

Idea: edges arrive in the total order (length, smaller index, larger index). Every vertex keeps a bitset of the vertices it
is joined to, so the lune of an arriving edge {x, y} is row x AND row y. Most lunes are cones: one vertex near the middle of the
edge, the same for all edges between two small boxes, is joined to all the others. Often it is near enough for that to be sure;
else one pass over three rows shows it. Of the rest, an empty lune joins two components or creates a loop; a connected one
changes nothing; each further component of a disconnected one brings a relation x, z_i, y, z_1 that may kill one loop.
Triangles are never listed.

A relation is written in *creators*, the edges that made loops: an edge with a non-empty lune is replaced by the two other
edges of a triangle on it, until only edges with empty lunes are left; those that joined components are a spanning tree and
count as nothing, because a cycle is known by its edges outside the tree. Persistence is then the reduction of these short
sets, youngest creator first. It ends when no loop is alive and no later edge has an empty lune.

Source: Koyama, Memoli, Robins, Turner 2023 (the reduced Vietoris-Rips filtration). Read in chapter 2.
"""

from __future__ import annotations

from collections import namedtuple

import numpy as np

from ._edges import EDGE_BYTES, edges_between, ends_of, first_window, greatest_length, next_window
from ._jit import njit
from ._lengths import edge_length, precedes
from ._lunes import last_empty_lune

__all__ = ["is_cone", "is_connected", "pair_edges", "reduce_column"]

# Bitsets of n vertices, or room for n of them.
Search = namedtuple("Search", "lune left stack apexes values")
# Edges with an empty lune, as lists at their ends: the first slot of a vertex, and for a slot the next one, the edge's other
# end, and the number of the loop that it created (-1: none, it joined two components).
Graph = namedtuple("Graph", "head following other creator")
# Loops by number: the edges that create them, killer edges with two apexes (-1: still alive), the columns of the dead ones, of
# which that of loop c begins at word `_first_word(c)`, and room for one column.
Loops = namedtuple("Loops", "created killed columns column")

_DEBRUIJN = np.uint64(0x03F79D71B4CB0A89)
_BIT = np.zeros(64, dtype=np.int64)
for _k in range(64):
    _BIT[((int(_DEBRUIJN) << _k) & (2**64 - 1)) >> 58] = _k
_ONE = np.uint64(1)
FEW_WORDS = 32  # rows so short are read as quickly as a place is compared


@njit(forceinline=True)
def _lowest(word):
    """Position of the lowest bit that is set."""
    return _BIT[((word & (~word + _ONE)) * _DEBRUIJN) >> np.uint64(58)]


@njit(forceinline=True)
def _join(rows, x, y):
    rows[x, y >> 6] |= _ONE << np.uint64(y & 63)
    rows[y, x >> 6] |= _ONE << np.uint64(x & 63)


@njit(forceinline=True)
def is_cone(rows, x, y, z):
    """Whether z is in the lune of {x, y} and joined to all of it.

    Parameters
    ----------
    rows : (n, words) uint64
        The vertices joined to each vertex, itself among them.
    x, y, z : int
        Vertices.
    """
    if not (rows[x, z >> 6] & rows[y, z >> 6]) >> np.uint64(z & 63) & _ONE:
        return False
    outside = np.uint64(0)
    for w in range(rows.shape[1]):
        outside |= rows[x, w] & rows[y, w] & ~rows[z, w]
    return outside == 0


@njit(forceinline=True)
def _is_near_middle(data, axes, x, y, z, length):
    """Whether z is nearer than the length of {x, y} to every place where a point of the lune can be; never for a matrix.

    With z at distance b from the line through x and y, and a from their midpoint along it, the farthest such place is on the
    lune's rim: a^2 + (sqrt(3)/2 L + b)^2 < L^2.
    """
    if len(axes) == 0 or length == 0.0:
        return False
    along, apart = 0.0, 0.0
    for k in range(len(axes)):
        step = data[z, k] - 0.5 * (data[x, k] + data[y, k])
        along += step * (data[y, k] - data[x, k])
        apart += step * step
    along = along * along / length
    across = np.sqrt(max(apart - along, 0.0)) + np.sqrt(0.75 * length)
    return along <= 0.25 * length and along + across * across < length * (1.0 - 1e-9)


@njit(forceinline=True)
def _lune(rows, x, y, lune):
    """Put the lune of {x, y} into the bitset `lune`; return one of its vertices, -1 when it is empty."""
    for w in range(len(lune)):
        lune[w] = rows[x, w] & rows[y, w]
    for w in range(len(lune)):
        if lune[w]:
            return (w << 6) + _lowest(lune[w])
    return -1


@njit(forceinline=True)
def is_connected(rows, lune, z, left):
    """Whether a lune is connected: absorb, from z on, vertices that share a neighbour in it with what is absorbed already.

    False may also mean that the order was unlucky: the full search decides.

    Parameters
    ----------
    rows : (n, words) uint64
        The vertices joined to each vertex, itself among them.
    lune : (words,) uint64
    z : int
        A vertex of the lune.
    left : (words,) uint64
        Room for a bitset.
    """
    words = len(lune)
    some = np.uint64(0)
    for w in range(words):
        left[w] = lune[w] & ~rows[z, w]
        some |= left[w]
    while some:
        w = 0
        while not left[w]:
            w += 1
        v = (w << 6) + _lowest(left[w])
        shared = np.uint64(0)
        for w in range(words):
            shared |= lune[w] & rows[v, w] & ~left[w]
        if not shared:
            return False
        some = np.uint64(0)
        for w in range(words):
            left[w] &= ~rows[v, w]
            some |= left[w]
    return True


@njit(forceinline=True)
def _take_component(data, axes, rows, label, x, y, z, lune, stack):
    """Take the component of z out of the lune; return its apex and the longer edge from that to {x, y}.

    The apex of a component is the vertex whose later edge to {x, y} comes first, ties by index.
    """
    apex, best, top = -1, np.inf, 0
    stack[0] = z
    lune[z >> 6] ^= _ONE << np.uint64(z & 63)
    while top >= 0:
        z = stack[top]
        top -= 1
        value = max(edge_length(data, x, z, axes), edge_length(data, y, z, axes))
        if value < best or (value == best and label[z] < label[apex]):
            apex, best = z, value
        for w in range(len(lune)):
            reached = lune[w] & rows[z, w]
            lune[w] ^= reached
            while reached:
                top += 1
                stack[top] = (w << 6) + _lowest(reached)
                reached &= reached - _ONE
    return apex, best


@njit()
def _components(data, axes, rows, label, x, y, search):
    """Number of components of the lune, which is emptied; the apex of each is left in `search.apexes`, nearest first."""
    lune, apexes, values, count = search.lune, search.apexes, search.values, 0
    for w in range(len(lune)):
        while lune[w]:
            z = (w << 6) + _lowest(lune[w])
            apex, best = _take_component(data, axes, rows, label, x, y, z, lune, search.stack)
            i = count
            while i > 0 and (values[i - 1] > best or (values[i - 1] == best and label[apexes[i - 1]] > label[apex])):
                values[i], apexes[i] = values[i - 1], apexes[i - 1]
                i -= 1
            values[i], apexes[i] = best, apex
            count += 1
    return count


@njit(forceinline=True)
def _lune_vertex(data, axes, rows, label, a, b):
    """A vertex of the lune that {a, b} had when it arrived: one near the middle, or that whose longer edge is shortest.

    Near is what is little farther from both ends than half the length, or a quarter of the square; which one does not matter.
    """
    length = edge_length(data, a, b, axes)
    near = (0.63 if len(axes) == 0 else 0.4) * length
    best, best_value = -1, np.inf
    for w in range(rows.shape[1]):
        both = rows[a, w] & rows[b, w]
        while both:
            z = (w << 6) + _lowest(both)
            both &= both - _ONE
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
def _add_in_creators(data, axes, rows, label, graph, a, b, column, stack):
    """Add the edge {a, b}, written in creators, to `column` (a bitset, mod 2)."""
    stack[0, 0], stack[0, 1] = a, b
    top = 0
    while top >= 0:
        a, b = stack[top, 0], stack[top, 1]
        top -= 1
        slot = graph.head[a]
        while slot >= 0 and graph.other[slot] != b:
            slot = graph.following[slot]
        if slot >= 0:  # its lune was empty; an edge that joined two components counts as nothing
            creator = graph.creator[slot]
            if creator >= 0:
                column[creator >> 6] ^= _ONE << np.uint64(creator & 63)
            continue
        z = _lune_vertex(data, axes, rows, label, a, b)
        if top + 2 >= len(stack):
            stack = np.concatenate((stack, np.empty_like(stack)))
        stack[top + 1, 0], stack[top + 1, 1] = a, z
        stack[top + 2, 0], stack[top + 2, 1] = z, b
        top += 2


@njit()
def _doubled(array):
    return np.concatenate((array, array))


@njit()
def _with_edge(graph, slot, a, b, creator):
    """The graph with the edge {a, b} on the lists of its two ends, in slots `slot` and `slot` + 1."""
    if slot + 2 > len(graph.other):
        graph = Graph(graph.head, _doubled(graph.following), _doubled(graph.other), _doubled(graph.creator))
    for here, v, other in ((slot, a, b), (slot + 1, b, a)):
        graph.other[here], graph.following[here], graph.creator[here] = other, graph.head[v], creator
        graph.head[v] = here
    return graph


@njit(forceinline=True)
def _first_word(loop):
    """Where the column of a loop begins: before it are those of the older ones, each as long as its youngest creator needs."""
    whole, rest = loop >> 6, loop & 63
    return 32 * whole * (whole + 1) + rest * (whole + 1)


@njit()
def _new_loops(capacity):
    return Loops(
        np.empty((capacity, 2), dtype=np.int64),
        np.full((capacity, 4), -1, dtype=np.int64),
        np.empty(_first_word(capacity), dtype=np.uint64),
        np.zeros(capacity >> 6, dtype=np.uint64),
    )


@njit()
def _with_loop(loops, born, x, y, spare):
    """The loops with one more, created by the edge {x, y}."""
    if born == len(loops.created):
        if 8 * (_first_word(born) + _first_word(2 * born)) > spare:
            raise MemoryError("loops")
        more = _new_loops(2 * born)
        more.created[:born], more.killed[:born] = loops.created, loops.killed
        more.columns[: len(loops.columns)] = loops.columns
        loops = more
    loops.created[born, 0], loops.created[born, 1] = x, y
    return loops


@njit()
def _pivot(column):
    """The youngest creator of a column, -1 when it is empty."""
    for w in range(len(column) - 1, -1, -1):
        if column[w]:
            bit = 63
            while not (column[w] >> np.uint64(bit)) & _ONE:
                bit -= 1
            return (w << 6) + bit
    return -1


@njit()
def reduce_column(column, columns, killed):
    """Reduce a column by those of the loops that are dead; return the loop it kills, -1 for none.

    Parameters
    ----------
    column : (words,) uint64
        A relation as the bitset of its creators; changed.
    columns : (all words,) uint64
        The columns of the dead loops, one after the other.
    killed : (c, 4) int64
        Killer edges and apexes of the loops, -1 for those that are alive.
    """
    pivot = _pivot(column)
    while pivot >= 0 and killed[pivot, 0] >= 0:
        first = _first_word(pivot)
        for w in range((pivot >> 6) + 1):
            column[w] ^= columns[first + w]
        pivot = _pivot(column)
    return pivot


@njit(forceinline=True)
def _kill(data, axes, rows, label, graph, loops, x, y, search, stack):
    """Reduce the relations that an edge with a disconnected lune brings; return how many loops die of them."""
    dead = 0
    count = _components(data, axes, rows, label, x, y, search)
    first = search.apexes[0]
    for i in range(1, count):
        further = search.apexes[i]
        loops.column[:] = 0
        for a, b in ((x, first), (first, y), (y, further), (further, x)):
            _add_in_creators(data, axes, rows, label, graph, a, b, loops.column, stack)
        loop = reduce_column(loops.column, loops.columns, loops.killed)
        if loop >= 0:
            start, words = _first_word(loop), (loop >> 6) + 1
            loops.columns[start : start + words] = loops.column[:words]
            killed = loops.killed[loop]
            killed[0], killed[1], killed[2], killed[3] = x, y, first, further
            dead += 1
    return dead


@njit()
def _root(parent, x):
    while parent[x] != x:
        parent[x] = parent[parent[x]]
        x = parent[x]
    return x


@njit()
def _labelled(loops, born, label):
    """Created and killer edges by the labels of their vertices, the smaller end of an edge first."""
    created, killed = loops.created[:born], loops.killed[:born]
    for edges in (created, killed):
        for i in range(born):
            if edges[i, 0] >= 0:
                a, b = label[edges[i, 0]], label[edges[i, 1]]
                edges[i, 0], edges[i, 1] = min(a, b), max(a, b)
    for i in range(born):
        if killed[i, 0] >= 0:
            killed[i, 2], killed[i, 3] = label[killed[i, 2]], label[killed[i, 3]]
    return created, killed


@njit(nogil=True)
def pair_edges(data, axes, tree, max_length, room, spare):
    """Pair the edges that create loops with the edges that kill them.

    Parameters
    ----------
    data : (n, n) or (n, d) float64
        Distances, or the points of `tree` in its own order.
    axes : tuple
        Empty for a matrix, d zeros for points.
    tree : Tree
        Of the points; of any one point for a matrix, where only its labels 0 to n - 1 are used.
    max_length : float
        Edges longer than that do not arrive. Squared for points, as all lengths here.
    room : tuple
        Of `edges_between`; `new_room` at first.
    spare : int
        Bytes that may be taken besides the n x n bits: half for the edges of a window, half for the columns of loops.

    Returns
    -------
    room : tuple
        For the next call.
    created : (c, 2) int64
        The edges that create loops, in order, smaller label first.
    killed : (c, 4) int64
        For each the killer edge and the two apexes (first component, further component), -1 when nothing kills it.

    Raises
    ------
    MemoryError
        When that would not be enough.
    """
    n, label = len(data), tree.label
    words = (n + 63) >> 6
    rows = np.zeros((n, words), dtype=np.uint64)
    for v in range(n):
        _join(rows, v, v)  # a vertex reaches itself
    search = Search(
        np.empty(words, np.uint64), np.empty(words, np.uint64), np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n)
    )
    graph, slots = Graph(np.full(n, -1), np.empty(8 * n, np.int64), np.empty(8 * n, np.int64), np.empty(8 * n, np.int64)), 0
    loops, born, alive = _new_loops(64), 0, 0
    stack, parent, pieces = np.empty((256, 2), dtype=np.int64), np.arange(n), n
    last = -1.0  # the length of the last edge with an empty lune, once it is known
    shortest, longest, greatest = 0.0, first_window(data, axes, tree), greatest_length(data, axes, tree)
    done = greatest == 0
    while not done:
        room, m, longest = edges_between(data, axes, tree, shortest, longest, room, spare // (2 * EDGE_BYTES))
        for e in range(m):
            x, y, middle = ends_of(room[2][e])
            length = room[3][e]
            if length > max_length or (alive == 0 and 0 <= last < length):
                done = True
                break
            near = middle < 0 or (words > FEW_WORDS and _is_near_middle(data, axes, x, y, middle, length))
            if near or is_cone(rows, x, y, middle):
                _join(rows, x, y)
                continue
            z = _lune(rows, x, y, search.lune)
            if (search.lune[middle >> 6] >> np.uint64(middle & 63)) & _ONE:
                z = middle
            connected = z >= 0 and (alive == 0 or is_connected(rows, search.lune, z, search.left))
            _join(rows, x, y)
            if connected:
                continue
            if z >= 0:
                alive -= _kill(data, axes, rows, label, graph, loops, x, y, search, stack)
                if alive == 0 and pieces == 1 and last < 0:
                    last = last_empty_lune(data, axes, tree, rows, length)
                continue
            a, b = _root(parent, x), _root(parent, y)
            graph = _with_edge(graph, slots, x, y, born if a == b else -1)
            slots += 2
            if a != b:  # the edge joins two components
                parent[a] = b
                pieces -= 1
            else:  # it creates a loop
                loops = _with_loop(loops, born, x, y, spare // 2)
                born += 1
                alive += 1
        done = done or longest > greatest
        shortest, longest = longest, next_window(data, axes, shortest, longest, m)
    created, killed = _labelled(loops, born, label)
    return room, created, killed
