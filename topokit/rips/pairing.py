"""The pairing of edges by lunes, as the book tells it, and for small clouds.

Idea: edges arrive in the total order (length, smaller index, larger index). The *lune* of an arriving edge {x, y} holds the
vertices that are joined to both its ends already. There are three cases.

- An empty lune: the edge joins two components, or it creates a loop. Both kinds are *creators*.
- A connected lune changes nothing.
- Each further component of a disconnected lune brings a *relation*, a cycle x, z_1, y, z_i that bounds from now on. Written in
  the creators of loops and reduced, it may kill one loop.

A set of vertices is one Python integer, whose bit v is set when v is in the set. So the lune is the AND of two integers, and a
set is absorbed in one operation however many vertices it has. `topokit.rips.engine` does the same with less for each edge, once
it is compiled; both return the same pairs.

Source: Koyama, Memoli, Robins, Turner 2023 (the reduced Vietoris-Rips filtration). Taught in chapter 2.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .._validate import Array, Ids
from ._cloud import Cloud


def pair_edges(cloud: Cloud, max_key: float) -> tuple[Ids, Ids, Array, Array]:
    """Pair the edges that create loops with the edges that kill them.

    Parameters
    ----------
    cloud : Cloud
    max_key : float
        Key (`Cloud.keys`) of the last edge that may be used.

    Returns
    -------
    created : (c, 2) int64
        Edges that create loops, in the order in which they arrive.
    killed : (c, 4) int64
        The edges that kill these loops, each with the apexes of its two triangles; -1 for a loop that is still alive.
    birth, death : (c,) float64
        The radii of these edges; death is inf for a loop that is still alive.
    """
    edges, arrival, keys = edges_in_order(cloud, max_key)
    joined = [1 << v for v in range(len(cloud))]  # a vertex is joined to itself
    loops = Loops(arrival)
    component = list(range(len(cloud)))  # of each vertex another one of its component, in the end the same for all
    for x, y in edges.tolist():
        lune = joined[x] & joined[y]
        joined[x] |= 1 << y
        joined[y] |= 1 << x
        if not lune:
            a = root_of(component, x)
            b = root_of(component, y)
            component[a] = b
            loops.add_creator(x, y, creates_loop=a == b)

        # While no loop is alive, none can be killed.
        elif loops.alive and connected_part(joined, lune) != lune:
            first, *others = apexes_of(joined, lune, keys[np.maximum(arrival[x], arrival[y])])
            for further in others:
                loops.add_relation(x, y, first, further)
    created = np.array(loops.created, np.int64).reshape(-1, 2)
    killed = np.array(loops.killed, np.int64).reshape(-1, 4)
    death = np.where(killed[:, 0] < 0, np.inf, cloud.radii(killed[:, 0], killed[:, 1]))
    return created, killed, cloud.radii(created[:, 0], created[:, 1]), death


# The total order ------------------------------------------------------------------------------------------------------


def edges_in_order(cloud: Cloud, max_key: float) -> tuple[Ids, Ids, Array]:
    """Return the edges up to a key in the total order, what number each edge has in it, and their keys.

    Returns
    -------
    edges : (m, 2) int64
        The smaller vertex first.
    arrival : (n, n) int64
        The number of the edge between two vertices; m where there is none.
    keys : (m + 1,) float64
        What orders them, and infinity.
    """
    n = len(cloud)
    # Pairs are listed by the smaller and then by the larger vertex; a stable sort keeps that order for edges of one length.
    low, high = np.triu_indices(n, 1)
    keys = cloud.keys(low, high)
    order = np.argsort(keys, kind="stable")
    order = order[keys[order] <= max_key]
    edges = np.column_stack([low[order], high[order]])
    numbers = np.arange(len(edges))
    arrival = np.full((n, n), len(edges))
    arrival[edges[:, 0], edges[:, 1]] = numbers
    arrival[edges[:, 1], edges[:, 0]] = numbers
    return edges, arrival, np.append(keys[order], np.inf)


# Lunes ----------------------------------------------------------------------------------------------------------------


def vertices_of(bits: int) -> Iterator[int]:
    """Yield the vertices of a set, the largest first."""
    while bits:
        vertex = bits.bit_length() - 1
        yield vertex
        bits ^= 1 << vertex


def connected_part(joined: list[int], lune: int) -> int:
    """Return the component of a lune that holds its largest vertex."""
    part = lune & joined[lune.bit_length() - 1]
    waiting = lune & ~part
    while waiting:
        vertex = waiting.bit_length() - 1
        if joined[vertex] & part:
            part |= lune & joined[vertex]
            waiting = lune & ~part
        else:
            waiting ^= 1 << vertex
    return part


def apexes_of(joined: list[int], lune: int, values: Array) -> list[int]:
    """Return from each component of a lune the vertex of least value, its *apex*; ties go to the smaller vertex."""
    apexes = []
    while lune:
        part = connected_part(joined, lune)
        lune ^= part
        apexes.append(min((values[vertex], vertex) for vertex in vertices_of(part)))
    return [apex for _, apex in sorted(apexes)]


def root_of(component: list[int], vertex: int) -> int:
    """Return the vertex that stands for the component of a vertex; the engine compiles this too."""
    while component[vertex] != vertex:
        component[vertex] = component[component[vertex]]
        vertex = component[vertex]
    return vertex


# Relations between loops ----------------------------------------------------------------------------------------------


class Loops:
    """The loops born so far, and the relations between them: sets of loops, as bits, that together bound."""

    def __init__(self, arrival: Ids) -> None:
        self.created: list[tuple[int, int]] = []
        self.killed: list[tuple[int, int, int, int]] = []
        self.alive = 0
        self._arrival = arrival
        self._creators: dict[tuple[int, int], int] = {}  # edges with empty lunes, and the loop of each as a set
        self._relations: dict[int, int] = {}  # reduced; by the youngest loop, which each has killed

    def add_creator(self, x: int, y: int, *, creates_loop: bool) -> None:
        """Add an edge with an empty lune."""
        self._creators[x, y] = 0
        if creates_loop:
            self._creators[x, y] = 1 << len(self.created)
            self.created.append((x, y))
            self.killed.append((-1, -1, -1, -1))
            self.alive += 1

    def add_relation(self, x: int, y: int, first: int, further: int) -> None:
        """Reduce the cycle x, first, y, further, which bounds from now on; it kills the youngest loop that is left in it."""
        left = 0
        for a, b in ((x, first), (first, y), (y, further), (further, x)):
            left ^= self._loops_of(a, b)
        while left:
            youngest = left.bit_length() - 1
            if youngest not in self._relations:
                self._relations[youngest] = left
                self.killed[youngest] = (x, y, first, further)
                self.alive -= 1
                return
            left ^= self._relations[youngest]

    def _loops_of(self, a: int, b: int) -> int:
        """Return an edge written in loops.

        An edge with an empty lune stands for the loop that it created or, in the tree, for none. Every other edge is replaced
        by the two other edges of the first triangle on it.
        """
        total = 0
        waiting = [(a, b)]
        while waiting:
            a, b = waiting.pop()
            edge = (min(a, b), max(a, b))
            if edge in self._creators:
                total ^= self._creators[edge]
            else:
                apex = int(np.maximum(self._arrival[a], self._arrival[b]).argmin())
                waiting += [(a, apex), (apex, b)]
        return total
