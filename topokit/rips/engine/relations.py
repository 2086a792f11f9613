"""Relations between loops: cycles that bound, written in the creators of loops, and reduced.

Idea: each edge of a cycle is replaced by the two other edges of a triangle on it, again and again, until all have empty lunes.
Those that joined two components form a tree and count as nothing; so the others, the creators of loops, determine which cycle
it is. Persistence is the reduction of these sets, youngest creator first.
"""

from __future__ import annotations

from collections import namedtuple

import numpy as np

from . import compiled
from .lunes import ONE, vertex_of_lune

FEW = 128  # vertices of which two words are enough for a bitset

# What is kept of edges, as a number: 1 + z for a vertex z of the lune that an edge had when it arrived; where this was empty, -1
# if the edge joined two components, and -2 - c if it created loop c; 0 for what is not kept. Few vertices have a table `apexes`
# (n, n), at the larger vertex and then the smaller one. Of more vertices only edges with an empty lune are kept, as lists at
# their ends: the first link of a vertex; for a link the next one, the edge's other end, and its number. `waiting` is space.
Graph = namedtuple("Graph", "head links waiting apexes")
# Loops by number: the edges that create them; killer edges with two apexes, -1 while alive; and for a dead loop the bitset of the
# creators that remain of its relation. There is a row more, for the relation that is being reduced.
Loops = namedtuple("Loops", "created killed columns")


@compiled
def twice_as_long(table):
    """Return a table of integers with space for as many rows again; a loop compiles ten times as fast as `np.concatenate`."""
    longer = np.empty((2 * len(table), table.shape[1]), np.int64)
    for i in range(len(table)):
        for k in range(table.shape[1]):
            longer[i, k] = table[i, k]
    return longer


@compiled
def new_graph(n):
    """Return a graph of n vertices without edges."""
    head = np.empty(n, np.int64)
    for v in range(n):
        head[v] = -1
    few = n <= FEW
    apexes = np.zeros((n, n) if few else (0, 0), np.int16)
    return Graph(head, np.empty((0 if few else 8 * n, 3), np.int64), np.empty((256, 2), np.int64), apexes)


@compiled
def add_edge(graph, size, a, b, kept):
    """Add the edge {a, b} to the lists of `size` edges, and return the graph; `kept` is what is kept of it."""
    if 2 * size + 2 > len(graph.links):
        graph = Graph(graph.head, twice_as_long(graph.links), graph.waiting, graph.apexes)
    head = graph.head
    links = graph.links
    for link in range(2 * size, 2 * size + 2):
        links[link, 0] = head[a]
        links[link, 1] = b
        links[link, 2] = kept
        head[a] = link
        a, b = b, a
    return graph


@compiled
def new_loops():
    """Return space for the first loops."""
    return Loops(np.empty((64, 2), np.int64), np.empty((64, 4), np.int64), np.zeros((65, 1), np.uint64))


@compiled
def add_loop(loops, born, x, y):
    """Add the loop that {x, y} creates to `born` others, and return the loops."""
    if born == len(loops.created):
        columns = np.zeros((2 * born + 1, born >> 5), np.uint64)
        for loop in range(born):
            for w in range(loops.columns.shape[1]):
                columns[loop, w] = loops.columns[loop, w]
        loops = Loops(twice_as_long(loops.created), twice_as_long(loops.killed), columns)
    loops.created[born, 0] = x
    loops.created[born, 1] = y
    for k in range(4):
        loops.killed[born, k] = -1
    return loops


@compiled
def write_in_creators(data, label, rows, graph, x, first, y, further, column):
    """Write the cycle x, first, y, further in creators into `column` (a bitset, mod 2)."""
    # Names for fields of tuples: numba counts each use of a field, in every turn of a loop.
    head = graph.head
    links = graph.links
    waiting = graph.waiting
    apexes = graph.apexes
    for w in range(len(column)):
        column[w] = np.uint64(0)
    top = -1
    a = further
    for b in (x, first, y, further):
        top += 1
        waiting[top, 0] = a
        waiting[top, 1] = b
        a = b
    while top >= 0:
        a = waiting[top, 0]
        b = waiting[top, 1]
        kept = np.int64(0)
        if len(apexes):
            kept = np.int64(apexes[max(a, b), min(a, b)])
        else:
            link = head[a]
            while link >= 0 and links[link, 1] != b:
                link = links[link, 0]
            if link >= 0:
                kept = links[link, 2]
        if kept >= 0:
            # The two other edges of a triangle that was complete with the edge replace it.
            z = kept - 1 if kept else vertex_of_lune(data, label, rows, a, b)
            if top + 2 > len(waiting):
                waiting = twice_as_long(waiting)
            waiting[top, 1] = z
            waiting[top + 1, 0] = z
            waiting[top + 1, 1] = b
            top += 1
        else:
            if kept < -1:
                creator = -2 - kept
                column[creator >> 6] ^= ONE << np.uint64(creator & 63)
            top -= 1


@compiled
def reduce_column(column, killed, columns):
    """Reduce a relation, the bitset of its creators, by those of the dead loops; return the loop it kills, -1 for none."""
    for word in range(len(column) - 1, -1, -1):
        while column[word]:
            bit = 63
            while not (column[word] >> np.uint64(bit)) & ONE:
                bit -= 1
            youngest = (word << 6) + bit
            if killed[youngest, 0] < 0:
                return youngest
            for w in range(word + 1):
                column[w] ^= columns[youngest, w]
    return -1


@compiled
def kill_loops(data, label, rows, graph, loops, born, x, y, apexes, count):
    """Reduce the relations of an edge whose lune has `count` components, each with its apex; return how many loops die."""
    dead = 0
    killed = loops.killed
    columns = loops.columns
    column = columns[born, : (born + 63) >> 6]
    for i in range(1, count):
        write_in_creators(data, label, rows, graph, x, apexes[0], y, apexes[i], column)
        loop = reduce_column(column, killed, columns)
        if loop >= 0:
            for w in range(len(column)):
                columns[loop, w] = column[w]
            killed[loop, 0] = x
            killed[loop, 1] = y
            killed[loop, 2] = apexes[0]
            killed[loop, 3] = apexes[i]
            dead += 1
    return dead
