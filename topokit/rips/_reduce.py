"""Pair loops with the edges that kill them, given the edges with empty and with disconnected lunes.

Idea: the edges with an empty lune are the relative-neighbourhood graph. In the total order they either join two
components (a spanning tree) or create a loop. Every other edge can be replaced by the two other edges of a triangle on it,
until only edges of that graph are left; a cycle is known by its creators alone, because the others form a tree. So a
relation of the Rips complex becomes a short set of creators, and persistence is the reduction of these sets, youngest
creator first.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ._bits import find, loses
from ._edges import first_window, greatest_length
from ._lunes import long_empty_lunes, lune_vertex, special_edges
from ._tree import before, build_tree, square

GROWTH = 1.25  # of the length of edges from one window to the next
_ONE = np.uint64(1)


@njit(cache=True)
def _sorted(tree, edges):
    """Positions of edges in the total order; stable."""
    lengths = np.empty(len(edges))
    for i in range(len(edges)):
        lengths[i] = square(tree, edges[i, 0], edges[i, 1])
    order = np.argsort(lengths, kind="mergesort")
    for i in range(1, len(order)):  # equal lengths stand together: sort those by the labels of their ends
        e, j = order[i], i
        while j > 0 and lengths[order[j - 1]] == lengths[e]:
            other = order[j - 1]
            if not before(tree, edges[e, 0], edges[e, 1], lengths[e], edges[other, 0], edges[other, 1]):
                break
            order[j] = other
            j -= 1
        order[j] = e
    return order


@njit(cache=True)
def _creators(n, edges):
    """For each edge of the relative-neighbourhood graph, in order: the number of the loop it creates, -1 for a tree edge."""
    creator = np.full(len(edges), -1, dtype=np.int64)
    parent = np.arange(n)
    born = 0
    for e in range(len(edges)):
        a, b = find(parent, edges[e, 0]), find(parent, edges[e, 1])
        if a != b:
            parent[a] = b
        else:
            creator[e] = born
            born += 1
    return creator, born


@njit(cache=True)
def _incidence(n, edges):
    """Edges at each vertex as (start, other end, edge), rows of one vertex together."""
    start = np.zeros(n + 1, dtype=np.int64)
    for e in range(len(edges)):
        start[edges[e, 0] + 1] += 1
        start[edges[e, 1] + 1] += 1
    for i in range(n):
        start[i + 1] += start[i]
    fill = start[:-1].copy()
    other, which = np.empty(2 * len(edges), dtype=np.int64), np.empty(2 * len(edges), dtype=np.int64)
    for e in range(len(edges)):
        for side in range(2):
            a, b = edges[e, side], edges[e, 1 - side]
            other[fill[a]], which[fill[a]] = b, e
            fill[a] += 1
    return start, other, which


@njit(cache=True)
def _add_in_creators(tree, graph, creator, a, b, column, stack, visit, place):
    """Add the edge {a, b}, written in creators, to `column` (a bitset, mod 2)."""
    start, other, which = graph
    stack[0, 0], stack[0, 1] = a, b
    top = 0
    while top >= 0:
        a, b = stack[top, 0], stack[top, 1]
        top -= 1
        edge = -1
        for i in range(start[a], start[a + 1]):
            if other[i] == b:
                edge = which[i]
                break
        if edge < 0:
            z = lune_vertex(tree, a, b, visit, place)
            stack[top + 1, 0], stack[top + 1, 1] = a, z
            stack[top + 2, 0], stack[top + 2, 1] = z, b
            top += 2
        elif creator[edge] >= 0:
            column[creator[edge] >> 6] ^= _ONE << np.uint64(creator[edge] & 63)


@njit(cache=True, nogil=True)
def tree_pairs(points, axes, max_length):
    """Pair the edges that create loops with the edges that kill them.

    Parameters
    ----------
    points : (n, d) float64, n >= 4
    axes : tuple of d zeros
    max_length : float
        Squared; edges above it do not arrive.

    Returns
    -------
    created : (c, 2) int64
        The edges that create loops, in order, as indices into `points`.
    killed : (c, 4) int64
        For each the killer edge and the two apexes (first component, further component), -1 when nothing kills it.
    """
    n = len(points)
    tree = build_tree(points, axes)
    extent = greatest_length(tree.points, axes, tree)
    shortest, longest = 0.0, first_window(tree.points, axes, tree)
    empty, relations = special_edges(tree, shortest, longest)
    rng = np.concatenate((empty, long_empty_lunes(tree, longest)))
    rng = rng[_sorted(tree, rng)]
    creator, born = _creators(n, rng)
    graph = _incidence(n, rng)
    created = np.empty((born, 2), dtype=np.int64)
    for e in range(len(rng)):
        if creator[e] >= 0:
            created[creator[e]] = rng[e]
    killed = np.full((born, 4), -1, dtype=np.int64)
    columns = np.zeros((born, (born + 63) >> 6), dtype=np.uint64)
    column = np.empty((born + 63) >> 6, dtype=np.uint64)
    stack, visit, place = np.empty((4 * n + 8, 2), dtype=np.int64), np.empty(256, dtype=np.int64), np.empty(len(axes))
    alive = born
    while alive > 0:
        for r in _sorted(tree, relations):
            x, y, first, further = relations[r]
            if square(tree, x, y) > max_length:
                break
            column[:] = 0
            for a, b in ((x, first), (first, y), (y, further), (further, x)):
                _add_in_creators(tree, graph, creator, a, b, column, stack, visit, place)
            loop = loses(column, columns, killed)
            if loop >= 0:
                columns[loop] = column
                killed[loop] = relations[r]
                alive -= 1
                if alive == 0:
                    break
        if longest > max_length or longest > extent * 1.0001:
            break
        shortest, longest = longest, longest * GROWTH * GROWTH
        if alive > 0:
            relations = special_edges(tree, shortest, longest)[1]
    kept = 0
    for c in range(born):
        x, y = created[c]
        if square(tree, x, y) > max_length:
            break
        kept += 1
        a, b = tree.label[x], tree.label[y]
        created[c, 0], created[c, 1] = min(a, b), max(a, b)
        if killed[c, 0] >= 0:
            a, b = tree.label[killed[c, 0]], tree.label[killed[c, 1]]
            killed[c, 0], killed[c, 1] = min(a, b), max(a, b)
            killed[c, 2], killed[c, 3] = tree.label[killed[c, 2]], tree.label[killed[c, 3]]
    return created[:kept], killed[:kept]
