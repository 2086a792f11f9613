"""Degree-1 Rips persistence from a matrix of distances, by lunes.

Idea: edges arrive in the order (length, smaller index, larger index). The lune of an arriving edge {x, y} is the set of
vertices already joined to both ends. An empty lune merges two components or creates a loop; a connected one changes
nothing; each further component of a disconnected one brings a relation x, z_i, y, z_1 that may kill one loop. Triangles
are never listed. A loop that a relation bounds is written in *creators* (the edges that made loops): an edge with a
non-empty lune is replaced by the other two edges of a triangle on it until only creators and tree edges are left, and
tree edges count as nothing, because a cycle is known by its edges outside a spanning tree.

Adjacency is a bitset a vertex, filled as edges arrive, so that a lune is the AND of two rows.

Source: Koyama, Memoli, Robins, Turner 2023 (the reduced Vietoris-Rips filtration).
"""

from __future__ import annotations

import numpy as np
from numba import njit

__all__ = ["dense_pairs"]

_DEBRUIJN = np.uint64(0x03F79D71B4CB0A89)
_BIT = np.zeros(64, dtype=np.int64)
for _k in range(64):
    _BIT[((int(_DEBRUIJN) << _k) & (2**64 - 1)) >> 58] = _k
_ONE = np.uint64(1)


@njit(cache=True, inline="always")
def _lowest(word: np.uint64) -> int:
    """Position of the lowest bit that is set."""
    return _BIT[((word & (~word + _ONE)) * _DEBRUIJN) >> np.uint64(58)]


@njit(cache=True)
def _before(d, a, b, x, y):
    """Whether the edge {a, b} comes before {x, y} in the total order."""
    if d[a, b] != d[x, y]:
        return d[a, b] < d[x, y]
    low, high, other_low, other_high = min(a, b), max(a, b), min(x, y), max(x, y)
    return low < other_low or (low == other_low and high < other_high)


@njit(cache=True)
def _count_empty_lunes(d):
    """How many edges have an empty lune: the relative-neighbourhood graph, ties broken by the total order."""
    n = len(d)
    count = 0
    for x in range(n):
        for y in range(x + 1, n):
            empty = True
            for z in range(n):
                if z != x and z != y and _before(d, x, z, x, y) and _before(d, y, z, x, y):
                    empty = False
                    break
            count += empty
    return count


@njit(cache=True)
def _apex(d, x, y):
    """The vertex of the lune of {x, y} whose later edge to it comes first, -1 when the lune is empty."""
    best = -1
    for z in range(len(d)):
        if z in (x, y) or not _before(d, x, z, x, y) or not _before(d, y, z, x, y):
            continue
        if best < 0 or max(d[x, z], d[y, z]) < max(d[x, best], d[y, best]):
            best = z
    return best


@njit(cache=True)
def _components(d, rows, x, y, lune, apexes):
    """Number of components of the lune (a bitset, which is emptied); the apex of each is left in `apexes`."""
    words = len(lune)
    count = 0
    stack = np.empty(len(d), dtype=np.int64)
    for w in range(words):
        while lune[w]:
            top = 0
            z = (w << 6) + _lowest(lune[w])
            lune[w] &= lune[w] - _ONE
            stack[0] = z
            apex = z
            while top >= 0:  # search the component of z, taking what it reaches out of the lune
                z = stack[top]
                top -= 1
                value, best = max(d[x, z], d[y, z]), max(d[x, apex], d[y, apex])
                if value < best or (value == best and z < apex):
                    apex = z
                for v in range(words):
                    reached = lune[v] & rows[z, v]
                    lune[v] ^= reached
                    while reached:
                        top += 1
                        stack[top] = (v << 6) + _lowest(reached)
                        reached &= reached - _ONE
            apexes[count] = apex
            count += 1
    return count


@njit(cache=True)
def _sort_apexes(d, x, y, apexes, count):
    """Order the apexes by (later edge to them, index): the first is that of the component that meets the edge first."""
    for i in range(1, count):
        z = apexes[i]
        value = max(d[x, z], d[y, z])
        j = i
        while j > 0:
            other = max(d[x, apexes[j - 1]], d[y, apexes[j - 1]])
            if other < value or (other == value and apexes[j - 1] < z):
                break
            apexes[j] = apexes[j - 1]
            j -= 1
        apexes[j] = z


@njit(cache=True)
def _add_in_creators(d, a, b, label, apex_of, column, stack):
    """Add the edge {a, b}, written in creators, to `column` (a bitset, mod 2)."""
    stack[0, 0], stack[0, 1] = a, b
    top = 0
    while top >= 0:
        a, b = stack[top, 0], stack[top, 1]
        top -= 1
        creator = label[a, b]
        if creator >= 0:
            column[creator >> 6] ^= _ONE << np.uint64(creator & 63)
        elif creator == -1:  # its lune is not empty; -2 is a tree edge, which counts as nothing
            if apex_of[a, b] < 0:
                apex_of[a, b] = apex_of[b, a] = _apex(d, a, b)
            z = apex_of[a, b]
            stack[top + 1, 0], stack[top + 1, 1] = a, z
            stack[top + 2, 0], stack[top + 2, 1] = z, b
            top += 2


@njit(cache=True)
def _find(parent, x):
    while parent[x] != x:
        parent[x] = parent[parent[x]]
        x = parent[x]
    return x


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
def dense_pairs(d, ex, ey, max_length):
    """Pair the edges that create loops with the edges that kill them.

    Parameters
    ----------
    d : (n, n) float64
        Symmetric; any increasing function of the distance (squared distances will do).
    ex, ey : (m,) int64
        All edges, ex < ey, in the total order.
    max_length : float
        Edges with d above it do not arrive.

    Returns
    -------
    created : (c, 2) int64
        The edges that create loops, in order.
    killed : (c, 4) int64
        For each the killer edge and the two apexes (first component, further component), -1 when nothing kills it.
    """
    n = len(d)
    empty_lunes = _count_empty_lunes(d)
    creators = max(empty_lunes - (n - 1), 0)
    words, column_words = (n + 63) >> 6, (creators + 63) >> 6
    rows = np.zeros((n, words), dtype=np.uint64)
    label = np.full((n, n), -1, dtype=np.int32)
    apex_of = np.full((n, n), -1, dtype=np.int32)
    created = np.empty((creators, 2), dtype=np.int64)
    killed = np.full((creators, 4), -1, dtype=np.int64)
    columns = np.zeros((creators, column_words), dtype=np.uint64)
    parent = np.arange(n)
    lune = np.empty(words, dtype=np.uint64)
    apexes = np.empty(n, dtype=np.int64)
    stack = np.empty((4 * n + 8, 2), dtype=np.int64)
    column = np.empty(column_words, dtype=np.uint64)
    seen, born, alive = 0, 0, 0
    for e in range(len(ex)):
        x, y = ex[e], ey[e]
        if d[x, y] > max_length or (alive == 0 and seen == empty_lunes):
            break  # no loop is left and none will come
        some = np.uint64(0)
        for w in range(words):
            lune[w] = rows[x, w] & rows[y, w]
            some |= lune[w]
        rows[x, y >> 6] |= _ONE << np.uint64(y & 63)
        rows[y, x >> 6] |= _ONE << np.uint64(x & 63)
        if not some:
            seen += 1
            rx, ry = _find(parent, x), _find(parent, y)
            if rx != ry:
                parent[rx] = ry
                label[x, y] = label[y, x] = -2
            else:
                created[born, 0], created[born, 1] = x, y
                label[x, y] = label[y, x] = born
                born += 1
                alive += 1
            continue
        if alive == 0:
            continue
        count = _components(d, rows, x, y, lune, apexes)
        if count == 1:
            continue
        _sort_apexes(d, x, y, apexes, count)
        for i in range(1, count):
            first, further = apexes[0], apexes[i]
            column[:] = 0
            for a, b in ((x, first), (first, y), (y, further), (further, x)):
                _add_in_creators(d, a, b, label, apex_of, column, stack)
            pivot = _pivot(column)
            while pivot >= 0 and killed[pivot, 0] >= 0:
                for w in range(column_words):
                    column[w] ^= columns[pivot, w]
                pivot = _pivot(column)
            if pivot >= 0:
                columns[pivot] = column
                killed[pivot, 0], killed[pivot, 1], killed[pivot, 2], killed[pivot, 3] = x, y, first, further
                alive -= 1
    return created[:born], killed[:born]
