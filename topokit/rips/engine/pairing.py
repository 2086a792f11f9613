"""The pairing of a cloud's edges, compiled, and the landmarks that show where nothing happens.

Idea: let L be some points of a large cloud P, its *landmarks*, such that every point has one within eps. A map that takes each
point to its nearest landmark lengthens no edge by more than 2 eps, and L is a part of P. So the loops of L that are born before
the length r and die after s + 2 eps are different loops of P from r to s. If P has no other loop alive at r, and no edge with an
empty lune is to come, then nothing is born and nothing dies up to s: these edges are joined, and neither sorted nor tested. The
proof is in appendix B.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ..._validate import Array, Ids
from ...sampling import farthest_point_sample
from ..pairing import root_of as root_of_plain
from . import compiled
from .edges import WINDOW, are_points, edge_length, edges_between, ends_of, first_window, new_edges, next_window
from .lunes import (
    are_connected,
    count_components,
    find_middles,
    first_of,
    has_bit,
    is_cone,
    is_connected,
    join,
    join_edges,
    new_grid,
    new_lune,
    write_lune,
)
from .relations import FEW, add_edge, add_loop, kill_loops, new_graph, new_loops
from .stop import greatest_length, last_empty
from .tree import build_tree, first_numbers, tree_of_matrix

LARGE = 3000  # points from which on landmarks are worth their time

root_of = compiled(root_of_plain)


@compiled
def next_change(rows, apexes, keys, lengths, e, m, longest, last, until, alive, bits, left, stop):
    """Join edges from the e-th on until one changes something; return its number + 1, and a vertex of its lune, -1 for none.

    Edges longer than `longest` are not read; where one comes, or all m are read, the second number is -2. Edges between the
    lengths `last` and `until` are joined only. Few vertices have a table `apexes` (`relations.Graph`).
    """
    z = -2
    while e < m and z == -2 and stop[0] == 0 and lengths[e] <= longest:
        # A cone changes nothing, nor does a connected lune; while no loop is alive, none can be killed either.
        x, y, middle = ends_of(keys[e])
        if len(apexes):
            bits[0] = low = rows[x, 0] & rows[y, 0]
            bits[1] = high = rows[x, 1] & rows[y, 1]
            z = first_of(low, high) if low | high else -1
            apexes[y, x] = 1 + z
            if z >= 0 and (not alive or are_connected(rows, low, high, z)):
                z = -2
        elif not last < lengths[e] < until and not is_cone(rows, x, y, middle):
            z = write_lune(rows, x, y, bits)
            if has_bit(bits, middle):
                z = middle
            if z >= 0 and (not alive or is_connected(rows, bits, z, left)):
                z = -2
        join(rows, x, y)
        e += 1
    return e, z


@compiled
def take_edge(data, label, row):
    """Number the vertices of a row as in the cloud, the smaller end of the edge first; return the length of the edge."""
    x = row[0]
    y = row[1]
    if x < 0:
        return np.inf
    for k in range(len(row)):
        row[k] = label[row[k]]
    if row[0] > row[1]:
        row[0], row[1] = row[1], row[0]
    length = edge_length(data, x, y)
    return np.sqrt(length) if are_points(data) else length


@compiled
def end_of_gap(bars, alive, length, scale):
    """Return a length before which the loops alive at a length survive, 0 if `bars` (`pair_edges`) do not show one."""
    if alive == 0:
        return np.inf
    for k in range(len(bars)):
        alive -= (2.0 * scale * bars[k, 0]) ** 2 < length
        if alive == 0:
            return (2.0 * scale * bars[k, 1]) ** 2
    return 0.0


@njit(error_model="numpy", nogil=True, cache=True)
def pair_with(data, max_length, stop, bars):
    """Pair the edges as `pair_edges` does.

    Each of `bars` (k, 2) says that a loop that is born before one radius lives longer than a second one, the longest first.
    """
    n = len(data)
    if are_points(data):
        tree = build_tree(data)
        data = tree.points
        max_length *= tree.scale * tree.scale
    else:
        tree = tree_of_matrix(n)
    label = tree.label
    few = n <= FEW
    words = 2 if few else (n + 63) >> 6
    rows = np.zeros((n, words), dtype=np.uint64)
    for v in range(n):
        join(rows, v, v)
    lune = new_lune(64 * words)
    bits = lune.bits
    grid = new_grid(tree)
    graph = new_graph(n)
    apexes = graph.apexes
    n_graph = np.int64(0)
    loops = new_loops()
    born = np.int64(0)
    alive = 0
    parent = first_numbers(n)
    n_components = n
    greatest = min(greatest_length(data, tree), max_length)  # the greatest length that matters
    beyond = greatest * (1.0 + 1e-12) + 5e-324
    last = np.inf  # the length of the last edge with an empty lune, once it is known
    until = 0.0  # after that edge, and before this length, nothing dies
    some = WINDOW >> 4 if len(bars) else WINDOW >> 1  # edges in a window: fewer where a gap may follow
    shortest = 0.0
    longest = min(max(first_window(data), 1e-6 * greatest, 5e-324), beyond)
    edges = new_edges(min(n * n // 2 + n, 1 << 16))
    done = False
    while not done:
        edges, m, longest = edges_between(data, tree, shortest, longest, edges)
        # Rows of up to 3 words are read as quickly as a middle is looked up.
        if are_points(data) and words > 3:
            find_middles(tree, grid, edges.keys, m)
        keys = edges.keys
        lengths = edges.lengths
        e = np.int64(0)
        while e < m:
            bound = min(max_length, last) if alive == 0 else max_length
            e, z = next_change(rows, apexes, keys, lengths, e, m, bound, last, until, alive > 0, bits, lune.left, stop)
            if z == -2:
                done = e < m
                break
            length = lengths[e - 1]
            x, y, _ = ends_of(keys[e - 1])
            if z >= 0:  # the lune is disconnected
                count = count_components(data, rows, label, x, y, lune)
                alive -= kill_loops(data, label, rows, graph, loops, born, x, y, lune.apexes, count)
            else:  # the lune is empty
                a = root_of(parent, x)
                b = root_of(parent, y)
                kept = -2 - born if a == b else -1
                if few:
                    apexes[y, x] = kept
                else:
                    graph = add_edge(graph, n_graph, x, y, kept)
                    n_graph += 1
                if a != b:  # the edge joins two components
                    parent[a] = b
                    n_components -= 1
                else:  # it creates a loop
                    loops = add_loop(loops, born, x, y)
                    born += 1
                    alive += 1

            # Once all is one component and the loops alive survive for long, compute up to which length edges can create one.
            until = end_of_gap(bars, alive, length, tree.scale)
            if until > 2.0 * length and n_components == 1 and last == np.inf:
                last = last_empty(data, tree, rows, length)
        if stop[0] != 0 or longest > greatest or (last < longest and until > greatest):
            done = True
        start = shortest
        shortest = longest
        longest = min(next_window(start, longest, m, some), beyond)
        if not done and last < shortest < until:
            join_edges(data, tree, rows, shortest, until)
            longest = min(until + longest - shortest, beyond)
            shortest = until

    birth = np.empty(born)
    death = np.empty(born)
    for loop in range(born):
        birth[loop] = take_edge(data, label, loops.created[loop]) / (2.0 * tree.scale)
        death[loop] = take_edge(data, label, loops.killed[loop]) / (2.0 * tree.scale)
    return loops.created[:born], loops.killed[:born], birth, death


def pair_edges(data: Array, max_length: float, stop: Ids) -> tuple[Ids, Ids, Array, Array]:
    """Pair the edges that create loops with the edges that kill them, as `topokit.rips.pairing.pair_edges` does.

    `data` holds (n, 3) points or an (n, n) matrix of distances, n >= 4. Lengths are squared for points. Another thread writes
    something other than 0 into `stop` (1,) to end the run; then the result is incomplete.
    """
    bars = np.empty((0, 2))
    if data.shape[1] == 3 and len(data) >= LARGE:
        landmarks, eps = farthest_point_sample(data, max(4, int(len(data) ** 0.8)))
        _, _, birth, death = pair_with(data[landmarks], max_length, stop, bars)
        start = birth * (1 + 1e-9)  # rounding must not decide
        end = (np.minimum(death, np.sqrt(max_length) / 2) - eps) * (1 - 1e-9)
        long = np.flatnonzero(end > 1.5 * start)
        long = long[np.argsort(-end[long])]
        bars = np.column_stack([start[long], end[long]])
    return pair_with(data, max_length, stop, bars)
