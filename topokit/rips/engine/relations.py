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

# Edges with an empty lune, as lists at their ends: the first link of a vertex; for a link the next one, the edge's other end, and
# the number of the loop that it created (-1: none, it joined two components); and edges that wait to be written in creators.
Graph = namedtuple("Graph", "head links waiting")
# Loops by number: the edges that create them; killer edges with two apexes, -1 while alive; and for a dead loop the bitset of the
# creators that remain of its relation.
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
    return Graph(head, np.empty((8 * n, 3), np.int64), np.empty((256, 2), np.int64))


@compiled
def add_edge(graph, size, a, b, loop):
    """Add the edge {a, b} to a graph of `size` edges, and return the graph; `loop` is the number of the loop that it created."""
    if 2 * size + 2 > len(graph.links):
        graph = Graph(graph.head, twice_as_long(graph.links), graph.waiting)
    head = graph.head
    links = graph.links
    for link in range(2 * size, 2 * size + 2):
        links[link, 0] = head[a]
        links[link, 1] = b
        links[link, 2] = loop
        head[a] = link
        a, b = b, a
    return graph


@compiled
def new_loops():
    """Return space for the first loops."""
    return Loops(np.empty((64, 2), np.int64), np.empty((64, 4), np.int64), np.zeros((64, 1), np.uint64))


@compiled
def add_loop(loops, born, x, y):
    """Add the loop that {x, y} creates to `born` others, and return the loops."""
    if born == len(loops.created):
        columns = np.zeros((2 * born, born >> 5), np.uint64)
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
def write_in_creators(data, label, rows, graph, relation, column):
    """Write a cycle, its vertices (m,), in creators into `column` (a bitset, mod 2); return the graph."""
    head = graph.head
    links = graph.links
    waiting = graph.waiting
    for w in range(len(column)):
        column[w] = np.uint64(0)
    for i in range(len(relation)):
        waiting[i, 0] = relation[i - 1]
        waiting[i, 1] = relation[i]
    top = len(relation) - 1
    while top >= 0:
        a = waiting[top, 0]
        b = waiting[top, 1]
        top -= 1

        # Is it in the graph? Then its lune was empty, and it is a creator or an edge of the tree.
        link = head[a]
        while link >= 0 and links[link, 1] != b:
            link = links[link, 0]
        if link >= 0:
            creator = links[link, 2]
            if creator >= 0:
                column[creator >> 6] ^= ONE << np.uint64(creator & 63)
            continue

        # Otherwise the two other edges of a triangle that was complete with it replace it.
        z = vertex_of_lune(data, label, rows, a, b)
        if top + 2 >= len(waiting):
            waiting = twice_as_long(waiting)
        waiting[top + 1, 0] = a
        waiting[top + 1, 1] = z
        waiting[top + 2, 0] = z
        waiting[top + 2, 1] = b
        top += 2
    return Graph(head, links, waiting)


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
    """Reduce the relations that an edge brings whose lune has `count` components, each with its apex.

    Return the graph, and how many of the `born` loops die.
    """
    dead = 0
    killed = loops.killed
    columns = loops.columns
    column = np.empty((born + 63) >> 6, np.uint64)
    relation = np.empty(4, np.int64)
    relation[0] = x
    relation[1] = apexes[0]
    relation[2] = y
    for i in range(1, count):
        relation[3] = apexes[i]
        graph = write_in_creators(data, label, rows, graph, relation, column)
        loop = reduce_column(column, killed, columns)
        if loop >= 0:
            for w in range(len(column)):
                columns[loop, w] = column[w]
            killed[loop, 0] = x
            killed[loop, 1] = y
            killed[loop, 2] = apexes[0]
            killed[loop, 3] = apexes[i]
            dead += 1
    return graph, dead
