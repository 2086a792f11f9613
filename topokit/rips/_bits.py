"""Degree-1 Rips persistence of up to a few thousand points: lunes as the AND of two bitsets.

Idea: edges arrive in the total order (length, smaller index, larger index). Every vertex keeps a bitset of the vertices it
is joined to, so the lune of an arriving edge {x, y} is row x AND row y. Most lunes are cones: one vertex near the middle of the
edge, the same for all edges between two small boxes, is joined to all the others, and one pass over three rows shows it. Of
the rest, an empty lune joins two components or creates a loop; a connected one changes nothing; each further component of a
disconnected one brings a relation x, z_i, y, z_1 that may kill one loop. Triangles are never listed.

A relation is written in *creators*, the edges that made loops: an edge with a non-empty lune is replaced by the two other
edges of a triangle on it, until only edges with empty lunes are left; those that joined components are a spanning tree and
count as nothing, because a cycle is known by its edges outside the tree. Persistence is then the reduction of these short
sets, youngest creator first. It ends when no loop is alive and no later edge has an empty lune.

Source: Koyama, Memoli, Robins, Turner 2023 (the reduced Vietoris-Rips filtration).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ._edges import edge_length, edges_between, ends_of, first_window, greatest_length, tie_precedes
from ._lunes import long_empty_lunes

__all__ = ["pair_edges"]

_DEBRUIJN = np.uint64(0x03F79D71B4CB0A89)
_BIT = np.zeros(64, dtype=np.int64)
for _k in range(64):
    _BIT[((int(_DEBRUIJN) << _k) & (2**64 - 1)) >> 58] = _k
_ONE = np.uint64(1)
GROWTH = 0.5  # of the window of lengths; twice that for squared ones


@njit(cache=True, forceinline=True)
def _lowest(word):
    """Position of the lowest bit that is set."""
    return _BIT[((word & (~word + _ONE)) * _DEBRUIJN) >> np.uint64(58)]


@njit(cache=True, forceinline=True)
def _join(rows, x, y):
    rows[x, y >> 6] |= _ONE << np.uint64(y & 63)
    rows[y, x >> 6] |= _ONE << np.uint64(x & 63)


@njit(cache=True, forceinline=True)
def _is_cone(rows, x, y, z):
    """Whether z is in the lune of {x, y} and joined to all of it."""
    if not (rows[x, z >> 6] & rows[y, z >> 6]) >> np.uint64(z & 63) & _ONE:
        return False
    outside = np.uint64(0)
    for w in range(rows.shape[1]):
        outside |= rows[x, w] & rows[y, w] & ~rows[z, w]
    return outside == 0


@njit(cache=True, forceinline=True)
def _lune(rows, x, y, lune):
    """Put the lune of {x, y} into the bitset `lune`; return one of its vertices, -1 when it is empty."""
    for w in range(len(lune)):
        lune[w] = rows[x, w] & rows[y, w]
    for w in range(len(lune)):
        if lune[w]:
            return (w << 6) + _lowest(lune[w])
    return -1


@njit(cache=True, forceinline=True)
def _is_connected(rows, lune, z, left):
    """Whether a lune is connected: absorb, from z on, vertices that share a neighbour in it with what is absorbed already.

    `left` is room for a bitset. False may also mean that the order was unlucky: the full search decides.
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


@njit(cache=True)
def _components(data, axes, rows, label, x, y, lune, stack, apexes, values):
    """Number of components of the lune (a bitset, which is emptied); the apex of each is left in `apexes`, nearest first.

    The apex of a component is the vertex whose later edge to {x, y} comes first, ties by index.
    """
    words, count = len(lune), 0
    for w in range(words):
        while lune[w]:
            apex, best, top = -1, np.inf, 0
            stack[0] = (w << 6) + _lowest(lune[w])
            lune[w] &= lune[w] - _ONE
            while top >= 0:  # search the component, taking what it reaches out of the lune
                z = stack[top]
                top -= 1
                value = max(edge_length(data, x, z, axes), edge_length(data, y, z, axes))
                if value < best or (value == best and label[z] < label[apex]):
                    apex, best = z, value
                for v in range(words):
                    reached = lune[v] & rows[z, v]
                    lune[v] ^= reached
                    while reached:
                        top += 1
                        stack[top] = (v << 6) + _lowest(reached)
                        reached &= reached - _ONE
            i = count
            while i > 0 and (values[i - 1] > best or (values[i - 1] == best and label[apexes[i - 1]] > label[apex])):
                values[i], apexes[i] = values[i - 1], apexes[i - 1]
                i -= 1
            values[i], apexes[i] = best, apex
            count += 1
    return count


@njit(cache=True, forceinline=True)
def _lune_vertex(data, axes, rows, label, a, b, half):
    """A vertex of the lune that {a, b} had when it arrived, near the middle: the first whose edges are at most `half` as long
    (or little more than that, by the caller's choice), or the one whose longer edge is shortest."""
    length = edge_length(data, a, b, axes)
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
            if (to_a == length and not tie_precedes(label, a, z, a, b)) or (
                to_b == length and not tie_precedes(label, b, z, a, b)
            ):
                continue
            if value <= half * length:
                return z
            best, best_value = z, value
    return best


@njit(cache=True, forceinline=True)
def _add_in_creators(data, axes, rows, label, graph, a, b, half, column, stack):
    """Add the edge {a, b}, written in creators, to `column` (a bitset, mod 2)."""
    head, following, other, creator = graph
    stack[0, 0], stack[0, 1] = a, b
    top = 0
    while top >= 0:
        a, b = stack[top, 0], stack[top, 1]
        top -= 1
        slot = head[a]
        while slot >= 0 and other[slot] != b:
            slot = following[slot]
        if slot >= 0:  # its lune was empty; a tree edge, creator -1, counts as nothing
            if creator[slot] >= 0:
                column[creator[slot] >> 6] ^= _ONE << np.uint64(creator[slot] & 63)
            continue
        z = _lune_vertex(data, axes, rows, label, a, b, half)
        if top + 2 >= len(stack):
            stack = np.concatenate((stack, np.empty_like(stack)))
        stack[top + 1, 0], stack[top + 1, 1] = a, z
        stack[top + 2, 0], stack[top + 2, 1] = z, b
        top += 2


@njit(cache=True)
def _note(graph, slot, a, b, number):
    """Put the edge {a, b}, whose lune is empty, on the lists of its two ends, in slots `slot` and `slot` + 1."""
    head, following, other, creator = graph
    other[slot], following[slot], head[a], creator[slot] = b, head[a], slot, number
    other[slot + 1], following[slot + 1], head[b], creator[slot + 1] = a, head[b], slot + 1, number


@njit(cache=True)
def _pivot(column):
    """The youngest creator of a column, -1 when it is empty."""
    for w in range(len(column) - 1, -1, -1):
        if column[w]:
            bit = 63
            while not (column[w] >> np.uint64(bit)) & _ONE:
                bit -= 1
            return (w << 6) + bit
    return -1


@njit(cache=True)
def _doubled(array):
    return np.concatenate((array, array))


@njit(cache=True)
def find(parent, x):
    while parent[x] != x:
        parent[x] = parent[parent[x]]
        x = parent[x]
    return x


@njit(cache=True)
def _last_empty_lune(data, axes, tree, rows, reached):
    """The greatest length of an edge with an empty lune among those not shorter than `reached`; 0 when there is none.

    For a matrix `rows` are those at `reached`, and lunes are taken to hold strictly shorter edges only, which may find an
    edge too many: it costs time, nothing else.
    """
    if len(axes) > 0:
        found, latest = long_empty_lunes(tree, reached), 0.0
        for e in range(len(found)):
            latest = max(latest, edge_length(data, found[e, 0], found[e, 1], axes))
        return latest
    latest = 0.0
    for x in range(len(data)):
        for y in range(x + 1, len(data)):
            length = data[x, y]
            if length < max(reached, latest):
                continue
            empty = True
            for w in range(rows.shape[1]):
                if rows[x, w] & rows[y, w]:
                    empty = False
                    break
            z = 0
            while empty and z < len(data):
                empty = z in (x, y) or data[x, z] >= length or data[y, z] >= length
                z += 1
            if empty:
                latest = length
    return latest


@njit(cache=True)
def loses(column, columns, killed):
    """Reduce a column by those of the loops that are dead; return the loop it kills, -1 for none."""
    pivot = _pivot(column)
    while pivot >= 0 and killed[pivot, 0] >= 0:
        for w in range((pivot >> 6) + 1):
            column[w] ^= columns[pivot, w]
        pivot = _pivot(column)
    return pivot


@njit(cache=True)
def _more_loops(created, killed, columns):
    """The tables of the loops with twice the room."""
    born = len(created)
    more = np.zeros((2 * born, born >> 5), dtype=np.uint64)
    more[:born, : born >> 6] = columns
    return (
        _doubled(created),
        np.concatenate((killed, np.full_like(killed, -1))),
        more,
        np.zeros(born >> 5, dtype=np.uint64),
    )


@njit(cache=True)
def _label(label, created, killed):
    """Write edges and apexes by the labels of their vertices, the smaller end of an edge first."""
    for i in range(len(created)):
        a, b = label[created[i, 0]], label[created[i, 1]]
        created[i, 0], created[i, 1] = min(a, b), max(a, b)
        if killed[i, 0] >= 0:
            a, b = label[killed[i, 0]], label[killed[i, 1]]
            killed[i, 0], killed[i, 1] = min(a, b), max(a, b)
            killed[i, 2], killed[i, 3] = label[killed[i, 2]], label[killed[i, 3]]


@njit(cache=True, nogil=True)
def pair_edges(data, axes, tree, max_length, half, room):
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
    half : float
        An edge is replaced by two edges at most this share of its length where there are such; a little more than a half
        for distances, than a quarter for squared ones.
    room : tuple
        Of `edges_between`; `new_room()` at first.

    Returns
    -------
    room : tuple
        For the next call.
    created : (c, 2) int64
        The edges that create loops, in order, smaller label first.
    killed : (c, 4) int64
        For each the killer edge and the two apexes (first component, further component), -1 when nothing kills it.
    """
    n, label = len(data), tree.label
    words = (n + 63) >> 6
    rows = np.zeros((n, words), dtype=np.uint64)
    for v in range(n):
        rows[v, v >> 6] |= _ONE << np.uint64(v & 63)  # a vertex reaches itself
    created, killed = np.empty((64, 2), dtype=np.int64), np.full((64, 4), -1, dtype=np.int64)
    columns, column = np.zeros((64, 1), dtype=np.uint64), np.zeros(1, dtype=np.uint64)
    graph, slots = (np.full(n, -1), np.empty(8 * n, np.int64), np.empty(8 * n, np.int64), np.empty(8 * n, np.int64)), 0
    lune, left = np.empty(words, dtype=np.uint64), np.empty(words, dtype=np.uint64)
    apexes, values, search = np.empty(n, dtype=np.int64), np.empty(n), np.empty(n, dtype=np.int64)
    stack, parent, pieces = np.empty((256, 2), dtype=np.int64), np.arange(n), n
    born, alive, last = 0, 0, -1.0  # `last` is the length of the last edge with an empty lune, once it is known
    shortest, longest, greatest = 0.0, first_window(data, axes, tree), greatest_length(data, axes, tree)
    while greatest > 0:
        room, keys, lengths = edges_between(data, axes, tree, shortest, longest, room)
        for e in range(len(keys)):
            x, y, middle = ends_of(keys[e])
            length = lengths[e]
            if length > max_length or (alive == 0 and 0 <= last < length):
                greatest = 0.0
                break
            if _is_cone(rows, x, y, middle):
                _join(rows, x, y)
                continue
            z = _lune(rows, x, y, lune)
            if (lune[middle >> 6] >> np.uint64(middle & 63)) & _ONE:
                z = middle
            connected = z >= 0 and (alive == 0 or _is_connected(rows, lune, z, left))
            _join(rows, x, y)
            if connected:
                continue
            if z < 0:  # the edge joins two components or creates a loop
                if slots + 2 > len(graph[1]):
                    graph = (graph[0], _doubled(graph[1]), _doubled(graph[2]), _doubled(graph[3]))
                a, b = find(parent, x), find(parent, y)
                _note(graph, slots, x, y, born if a == b else -1)
                slots += 2
                if a != b:
                    parent[a] = b
                    pieces -= 1
                    continue
                if born == len(created):
                    created, killed, columns, column = _more_loops(created, killed, columns)
                created[born, 0], created[born, 1] = x, y
                born += 1
                alive += 1
                continue
            count = _components(data, axes, rows, label, x, y, lune, search, apexes, values)
            for i in range(1, count):
                column[:] = 0
                for a, b in ((x, apexes[0]), (apexes[0], y), (y, apexes[i]), (apexes[i], x)):
                    _add_in_creators(data, axes, rows, label, graph, a, b, half, column, stack)
                loop = loses(column, columns, killed)
                if loop >= 0:
                    columns[loop] = column
                    killed[loop, 0], killed[loop, 1], killed[loop, 2], killed[loop, 3] = x, y, apexes[0], apexes[i]
                    alive -= 1
            if alive == 0 and pieces == 1 and last < 0:
                last = _last_empty_lune(data, axes, tree, rows, length)
        if longest > greatest:
            break
        shortest, longest = longest, longest * (1 + GROWTH * (1 + (len(axes) > 0)))
    created, killed = created[:born], killed[:born]
    _label(label, created, killed)
    return room, created, killed
