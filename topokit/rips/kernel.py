"""Degree-1 Rips persistence: lunes as the AND of two bitsets.

Idea: edges arrive in the total order (length, smaller index, larger index). Every vertex keeps a bitset of the vertices it
is joined to, so the lune of an arriving edge {x, y} is row x AND row y. Most lunes are cones: one vertex near the middle of the
edge, the same for all edges between two small boxes, is joined to all the others. Of the rest, an empty lune joins two
components or creates a loop; a connected one changes nothing; each further component of a disconnected one brings a relation
x, z_i, y, z_1 that may kill one loop, as `_creators` tells. Triangles are never listed. It ends when no loop is alive and no
later edge has an empty lune.

Source: Koyama, Memoli, Robins, Turner 2023 (the reduced Vietoris-Rips filtration). Read in chapter 2.
"""

from __future__ import annotations

from collections import namedtuple

import numpy as np

from ._creators import ONE, Graph, add_in_creators, first_word, lowest, new_loops, reduce_column, with_edge, with_loop
from ._edges import EDGE_BYTES, edge_length, edges_between, ends_of, first_window, greatest_length, next_window
from ._jit import njit
from ._lunes import last_empty_lune

__all__ = ["is_cone", "is_connected", "pair_edges", "reduce_column"]

FEW_WORDS = 32  # rows so short are read as quickly as a place is compared
Search = namedtuple("Search", "lune left stack apexes values")  # two bitsets of vertices, and room for all


@njit(forceinline=True)
def _join(rows, x, y):
    rows[x, y >> 6] |= ONE << np.uint64(y & 63)
    rows[y, x >> 6] |= ONE << np.uint64(x & 63)


@njit(forceinline=True)
def is_cone(rows, x, y, z):
    """Whether z is in the lune of {x, y} and joined to all of it; `rows` (n, words) holds the vertices joined to each."""
    if not (rows[x, z >> 6] & rows[y, z >> 6]) >> np.uint64(z & 63) & ONE:
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
    if len(axes) == 0 or length == 0.0 or z in (x, y):
        return False
    along, apart = 0.0, 0.0
    for k in range(len(axes)):
        # In this order it is exact for what is very near.
        step = 0.5 * ((data[z, k] - data[x, k]) + (data[z, k] - data[y, k]))
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
            return (w << 6) + lowest(lune[w])
    return -1


@njit(forceinline=True)
def is_connected(rows, lune, z, left):
    """Whether a lune is connected: absorb, from z on, vertices that share a neighbour in it with what is absorbed already.

    False may also mean that the order was unlucky: the full search decides. `left` (words,) is room for a bitset."""
    words = len(lune)
    some = np.uint64(0)
    for w in range(words):
        left[w] = lune[w] & ~rows[z, w]
        some |= left[w]
    while some:
        w = 0
        while not left[w]:
            w += 1
        v = (w << 6) + lowest(left[w])
        shared, some = np.uint64(0), np.uint64(0)
        for w in range(words):
            shared |= lune[w] & rows[v, w] & ~left[w]
            left[w] &= ~rows[v, w]
            some |= left[w]
        if not shared:
            return False
    return True


@njit(forceinline=True)
def _take_component(data, axes, rows, label, x, y, z, lune, stack):
    """Take the component of z out of the lune; return its apex, whose longer edge to {x, y} is shortest, and that edge."""
    apex, best, top = -1, np.inf, 0
    stack[0] = z
    lune[z >> 6] ^= ONE << np.uint64(z & 63)
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
                stack[top] = (w << 6) + lowest(reached)
                reached &= reached - ONE
    return apex, best


@njit()
def _components(data, axes, rows, label, x, y, search):
    """Number of components of the lune, which is emptied; the apex of each is left in `search.apexes`, nearest first."""
    lune, apexes, values, count = search.lune, search.apexes, search.values, 0
    for w in range(len(lune)):
        while lune[w]:
            z = (w << 6) + lowest(lune[w])
            apex, best = _take_component(data, axes, rows, label, x, y, z, lune, search.stack)
            i = count
            while i > 0 and (values[i - 1] > best or (values[i - 1] == best and label[apexes[i - 1]] > label[apex])):
                values[i], apexes[i] = values[i - 1], apexes[i - 1]
                i -= 1
            values[i], apexes[i] = best, apex
            count += 1
    return count


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
            add_in_creators(data, axes, rows, label, graph, a, b, loops.column, stack)
        loop = reduce_column(loops.column, loops.columns, loops.killed)
        if loop >= 0:
            start, words = first_word(loop), (loop >> 6) + 1
            for w in range(words):
                loops.columns[start + w] = loops.column[w]
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


@njit(nogil=True)
def pair_edges(data, axes, tree, max_length, m, longest, room, spare, halt):
    """Pair the edges that create loops, (c, 2), with the edges that kill them and their two apexes, (c, 4), -1 for none.

    `data` holds distances, or points in the order of `tree`, whose labels alone a matrix needs; lengths are squared for points.
    `room` is that of `edges_between`; it may have the first window already, m edges in order, all that are shorter than
    `longest` (else m is -1). It comes back for the next call, and last the length of the edge that was read last. Besides the
    n x n bits `spare` bytes may be taken: half for the edges of a window, half for the columns of loops. When these do not
    suffice, or another thread writes into `halt` (1,), it says why and what comes back is not all.
    """
    n, label = len(data), tree.label
    words = (n + 63) >> 6
    rows = np.zeros((n, words), dtype=np.uint64)
    for v in range(n):
        _join(rows, v, v)  # a vertex reaches itself
    bitsets, places = np.empty((2, words), np.uint64), np.empty((2, n), np.int64)
    search = Search(bitsets[0], bitsets[1], places[0], places[1], np.empty(n))
    graph, size = Graph(np.full(n, -1), np.empty((8 * n, 3), np.int64)), 0
    loops, born, alive = new_loops(64), 0, 0
    stack, parent, pieces = np.empty((256, 2), dtype=np.int64), np.arange(n), n
    last = -1.0  # the length of the last edge with an empty lune, once it is known
    shortest, length, greatest = 0.0, 0.0, greatest_length(data, axes, tree)
    done = greatest == 0
    if m < 0:
        longest, room.waiting[0] = first_window(data, axes, tree), 0
    while not done:
        if m < 0:
            room, m, longest = edges_between(data, axes, tree, shortest, longest, room, spare // (2 * EDGE_BYTES), halt)
        for e in range(m):
            x, y, middle = ends_of(room.keys[e])
            length = room.lengths[e]
            if halt[0] or length > max_length or (alive == 0 and 0 <= last < length):
                done = True
                break
            near = middle < 0 or (words > FEW_WORDS and _is_near_middle(data, axes, x, y, middle, length))
            if near or is_cone(rows, x, y, middle):
                _join(rows, x, y)
                continue
            z = _lune(rows, x, y, search.lune)
            if (search.lune[middle >> 6] >> np.uint64(middle & 63)) & ONE:
                z = middle
            connected = z >= 0 and (alive == 0 or is_connected(rows, search.lune, z, search.left))
            _join(rows, x, y)
            if connected:
                continue
            if z >= 0:
                alive -= _kill(data, axes, rows, label, graph, loops, x, y, search, stack)
            else:
                a, b = _root(parent, x), _root(parent, y)
                graph = with_edge(graph, size, x, y, born if a == b else -1)
                size += 1
                if a != b:  # the edge joins two components
                    parent[a] = b
                    pieces -= 1
                else:  # it creates a loop
                    loops = with_loop(loops, born, x, y, spare // 2, halt)
                    born += 1
                    alive += 1
            if alive == 0 and pieces == 1 and last < 0:
                last = last_empty_lune(data, axes, tree, length)
        done = done or halt[0] != 0 or longest > greatest or (alive == 0 and 0 <= last < longest)
        shortest, longest, m = longest, next_window(data, axes, shortest, longest, m), -1
    return room, loops.created[:born], loops.killed[:born], length
