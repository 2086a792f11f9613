"""Closed walks around loops: one that is short at birth and dies when its loop does, and shorter ones in the same class.

Idea: a cycle, written in creators as in `pairing`, is a short set. The relations that kill loops, reduced, turn that set into
the cycle's *class*: nothing is left of it exactly when the cycle is a boundary. The pairing needs the relations of one edge at a
time; here edges are asked for again and again, so what is worked out is kept, and it is worked out only when asked for.

The shortest way around a birth edge {x, y} is the shortest path from x to y before it arrives. It may go around an older
loop as well and then outlives the bar. So the search runs in pairs (vertex, class of the path so far), as in a covering
space where the unwanted loops are unrolled: the shortest path that ends in the right class is the answer.

Source: Koyama, Memoli, Robins, Turner 2023 (creators); Busaryev, Cabello, Chen, Dey, Wang 2012 (classes of edges);
Erickson and Nayyeri 2011 (the search in pairs).
"""

from __future__ import annotations

import heapq
import math
import operator
from collections.abc import Iterable, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import TypeVar

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from .._validate import Array, Ids
from ._cloud import Cloud

SEARCH_LIMIT = 20_000  # pairs (vertex, class) looked at before a search gives up
Edge = tuple[int, int]
Time = tuple[float, int, int]  # when an edge arrives: its key (`Cloud.keys`), and its ends, the smaller one first
NEVER: Time = (math.inf, 0, 0)
T = TypeVar("T")


class Homology:
    """Degree-1 classes in the Rips filtration of a cloud, as sets of creators: an int, bit c for the c-th loop born."""

    def __init__(self, cloud: Cloud, created: Ids, killed: Ids) -> None:
        self._cloud = cloud
        self._simplices = (created, killed)
        self._places: list[list[float]] = [] if cloud.is_matrix else cloud.data.tolist()
        self._tree = None if cloud.is_matrix else cKDTree(cloud.data)
        # Rows of keys are asked for again and again: keep up to four million numbers.
        rows_kept = max(4_000_000 // (len(cloud) + 1), 1)
        self._keys_from = lru_cache(rows_kept)(self._new_keys_from)
        self._complex_at = lru_cache(1)(self._new_complex_at)
        self._creator: dict[Edge, int] = {(a, b): loop for loop, (a, b) in enumerate(created.tolist())}
        self._killers: list[list[int]] = killed.tolist()
        self._killed_at = [self.time(x, y) if x >= 0 else NEVER for x, y, _, _ in self._killers]
        self._in_creators: dict[Edge, int] = {}  # edges written in creators
        self._columns: dict[int, int] = {}  # reduced relations, by youngest creator
        self._classes: dict[Edge, int] = {}  # classes of edges, at the time that was asked for last
        self._classes_at: Time | None = None

    def __reduce__(self) -> tuple[type[Homology], tuple[Cloud, Ids, Ids]]:
        """Pickle the loops alone; the rest is worked out again when it is asked for."""
        return Homology, (self._cloud, *self._simplices)

    def time(self, i: int, j: int) -> Time:
        """Return when the edge {i, j} arrives."""
        return self._key(i, j), *as_edge(i, j)

    def side(self, a: int, b: int) -> float:
        """Return the length of an edge."""
        key = self._key(a, b)
        return key if self._cloud.is_matrix else math.sqrt(key)

    def _path_length(self, path: Sequence[int]) -> float:
        return sum(self.side(a, b) for a, b in pairwise(path))

    # Edges ------------------------------------------------------------------------------------------------------------

    def _key(self, i: int, j: int) -> float:
        """Return the key of an edge as `Cloud.keys` does, to the last bit."""
        if self._cloud.is_matrix:
            return float(self._cloud.data[i, j])
        x, y, z = map(operator.sub, self._places[i], self._places[j])
        return x * x + y * y + z * z

    def _new_keys_from(self, vertex: int) -> Array:
        """Return the keys of the edges from a vertex to all others, infinity for itself."""
        keys = self._cloud.keys(vertex, slice(None)).copy()
        keys[vertex] = np.inf
        return keys

    def _new_complex_at(self, time: Time) -> csr_array:
        """Return the edges before a time, as the (n, n) sparse matrix of their lengths."""
        n = len(self._cloud)
        if self._tree is None:
            a, b = np.nonzero(np.triu(self._cloud.data <= time[0], 1))
        else:
            a, b = self._tree.query_pairs(math.sqrt(time[0]) * (1 + 1e-12), output_type="ndarray").T
        keys = self._cloud.keys(a, b)
        arrived = (keys < time[0]) | ((keys == time[0]) & ((a < time[1]) | ((a == time[1]) & (b < time[2]))))
        a = a[arrived]
        b = b[arrived]
        lengths = keys[arrived] if self._cloud.is_matrix else np.sqrt(keys[arrived])
        return csr_array((np.tile(lengths, 2), (np.append(a, b), np.append(b, a))), (n, n))

    def _neighbours(self, vertex: int, time: Time) -> tuple[Ids, Array]:
        """Return the vertices joined to a vertex before a time, and the lengths of the edges to them."""
        edges = self._complex_at(time)
        row = slice(edges.indptr[vertex], edges.indptr[vertex + 1])
        return edges.indices[row], edges.data[row]

    def _first_triangle(self, x: int, y: int) -> int:
        """Return the vertex that completes the earliest triangle before the edge {x, y}; -1 when its lune is empty."""
        keys = self._keys_from(x)
        longer = np.maximum(keys, self._keys_from(y))
        apex = int(longer.argmin())
        if longer[apex] < keys[y]:
            return apex

        # Among edges of one length the numbers of the vertices decide.
        time = self.time(x, y)
        for apex in np.flatnonzero(longer == time[0]).tolist():
            if max(self.time(x, apex), self.time(y, apex)) < time:
                return apex
        return -1

    # Classes ----------------------------------------------------------------------------------------------------------

    def in_creators(self, a: int, b: int) -> int:
        """Return the edge {a, b} written in creators."""
        asked = as_edge(a, b)
        apexes = dict[Edge, int]()
        waiting = [asked]
        while waiting:
            edge = waiting.pop()
            if edge in self._in_creators or edge in apexes:
                continue
            x, y = edge
            z = -1 if edge in self._creator else self._first_triangle(x, y)
            apexes[edge] = z
            if z >= 0:
                waiting += [as_edge(x, z), as_edge(y, z)]

        # A creator stands for its loop, an edge of the tree for none, and the two other edges of its first triangle, which
        # arrive earlier, for any other edge.
        for x, y in sorted(apexes, key=lambda edge: self.time(*edge)):
            z = apexes[x, y]
            if z >= 0:
                self._in_creators[x, y] = self._in_creators[as_edge(x, z)] ^ self._in_creators[as_edge(y, z)]
            else:
                self._in_creators[x, y] = 1 << self._creator[x, y] if (x, y) in self._creator else 0
        return self._in_creators[asked]

    def _walk_in_creators(self, walk: Sequence[int]) -> int:
        total = 0
        for a, b in sides(walk):
            total ^= self.in_creators(a, b)
        return total

    def class_of(self, edges: Iterable[Edge], time: Time) -> int:
        """Return the class of a chain in the complex just before a time, linear in the chain; 0 for a boundary."""
        if time != self._classes_at:
            self._classes_at = time
            self._classes = {}
        total = 0
        for a, b in edges:
            edge = as_edge(a, b)
            if edge not in self._classes:
                self._classes[edge] = self._reduced(self.in_creators(a, b), time)[0]
            total ^= self._classes[edge]
        return total

    def _reduced(self, column: int, time: Time) -> tuple[int, set[int]]:
        """Return what the relations before a time leave of a set of creators.

        Also return the creators that are left or are the youngest of a relation that was used.
        """
        left = 0
        used = set[int]()
        while column:
            youngest = column.bit_length() - 1
            used.add(youngest)
            if self._killed_at[youngest] < time:
                column ^= self._columns.get(youngest) or self._relation_of(youngest)
            else:
                left |= 1 << youngest
                column ^= 1 << youngest
        return left, used

    def _relation_of(self, loop: int) -> int:
        """Return the relation that kills a loop, reduced by those before it until the loop is its youngest creator."""
        waiting = [loop]
        unfinished = dict[int, int]()
        while waiting:
            current = waiting[-1]
            if current not in unfinished:
                x, y, first, further = self._killers[current]
                unfinished[current] = self._walk_in_creators([x, first, y, further])
            column = unfinished[current]
            while (youngest := column.bit_length() - 1) != current and youngest in self._columns:
                column ^= self._columns[youngest]
            unfinished[current] = column
            if youngest == current:
                self._columns[current] = column
                waiting.pop()
            else:  # the relation of that loop is needed first
                waiting.append(youngest)
        return self._columns[loop]

    def killers_of(self, walks: Iterable[Sequence[int]]) -> list[Edge | None]:
        """Return for closed walks the edges with which they die by the elder rule, None for those that never do.

        With that edge a walk becomes a boundary or homologous to a sum of earlier ones.
        """
        edges = list[Edge | None]()
        settled = dict[int, set[int]]()  # by the loop that dies last: the relations that fill an earlier walk
        for walk in walks:
            last = max(self.time(a, b) for a, b in sides(walk))
            _, used = self._reduced(self._walk_in_creators(walk), NEVER)
            while used:
                latest = max(used, key=self._killed_at.__getitem__)
                if latest not in settled:
                    settled[latest] = used
                    last = max(last, self._killed_at[latest])
                    break
                used = used ^ settled[latest]
            edges.append(None if last[0] == math.inf else last[1:])
        return edges

    # Walks ------------------------------------------------------------------------------------------------------------

    def representative(self, birth_edge: Edge, killer_edge: Edge | None) -> list[int]:
        """Return a short closed walk that is born with an edge and, if there is a killer edge, becomes a boundary with that."""
        x, y = birth_edge
        born = self.time(x, y)
        walk = self.path([x], [y], born)
        if killer_edge is None:
            return walk
        length, low, high = self.time(*killer_edge)
        death = (length, low, high + 1)  # just after the killer edge
        if self.class_of(sides(walk), death) == 0:
            return walk
        around = self.path_in_class(x, y, born, death, self.class_of([birth_edge], death))
        return around or self._corrected(walk, born, death)

    def path(self, sources: Sequence[int], targets: Sequence[int], time: Time) -> list[int]:
        """Return the shortest path from one of the sources to one of the targets before a time; [] when there is none."""
        remaining = self._shortest_paths(targets, time)
        start = min(sources, key=remaining.__getitem__)
        if remaining[start] == math.inf:
            return []

        # Among shortest paths one with the fewest steps, and of those the one that goes to the nearest vertex first.
        before = {start: start}
        queue = [start]
        for vertex in queue:
            if vertex in targets:
                break
            joined, lengths = self._neighbours(vertex, time)
            following = joined[remaining[joined] + lengths == remaining[vertex]]
            for other in following[np.lexsort((following, remaining[following]))].tolist():
                if other not in before:
                    before[other] = vertex
                    queue.append(other)
        return _path_back(before, vertex)

    def _shortest_paths(self, targets: Sequence[int], time: Time) -> Array:
        """Return for each vertex the length of the shortest path before a time to the nearest target; infinite without one."""
        return dijkstra(self._complex_at(time), indices=targets, min_only=True)

    def path_in_class(
        self, source: int, target: int, time: Time, death: Time, wanted: int, bound: float = math.inf
    ) -> list[int]:
        """Return the shortest path before a time whose class before `death` is the one wanted.

        It is [] if none is found that is shorter than the bound. The search is A*: the lengths of shortest paths of any class
        bound what remains from below.
        """
        remaining = self._shortest_paths([target], time).tolist()
        start = (source, 0)
        goal = (target, wanted)
        best = {start: (0.0, 0)}  # length and steps of the best path to a vertex in a class
        before = {start: start}
        queue = [(remaining[source], 0, start)]
        done: set[tuple[int, int]] = set()
        while queue and len(done) < SEARCH_LIMIT:
            _, _, state = heapq.heappop(queue)
            if state == goal:
                return [vertex for vertex, _ in _path_back(before, goal)]
            if state in done:
                continue
            done.add(state)
            vertex, path_class = state
            length, steps = best[state]
            joined, side_lengths = self._neighbours(vertex, time)
            for other, side_length in zip(joined.tolist(), side_lengths.tolist(), strict=True):
                if length + side_length + remaining[other] >= bound:
                    continue
                next_state = (other, path_class ^ self.class_of([(vertex, other)], death))
                next_path = (length + side_length, steps + 1)
                if next_state not in done and next_path < best.get(next_state, (math.inf, 0)):
                    best[next_state] = next_path
                    before[next_state] = state
                    heapq.heappush(queue, (next_path[0] + remaining[other], next_path[1], next_state))
        return []

    def _corrected(self, walk: list[int], born: Time, death: Time) -> list[int]:
        """Add to a walk those around the older loops that it contains, so that nothing of it is left at death."""
        while left := self.class_of(sides(walk), death):
            x, y = self._simplices[0][left.bit_length() - 1].tolist()
            other = self.path([x], [y], self.time(x, y))
            bridge = self.path(walk, other, born) or self.path(walk, other, death)
            walk = _spliced(walk, bridge, other)
        return walk

    def tightened(self, walk: list[int], time: Time) -> list[int]:
        """Shorten a closed walk within its class before a time, until no third of it can be made shorter."""
        if self.class_of(sides(walk), time) == 0:
            return walk[:1]
        settled: set[tuple[int, ...]] = set()
        turns = 0  # vertices since the last change
        while turns < len(walk):
            # The first third of the walk, by length.
            reach = np.cumsum([self.side(a, b) for a, b in sides(walk)])
            end = max(int(np.searchsorted(reach, reach[-1] / 3)), 2) + 1
            arc = walk[:end]
            shorter = [] if tuple(arc) in settled else self._shorter(arc, time)
            if shorter:
                turns = 0
                arc = shorter
            else:
                turns += 1
            settled.add(tuple(arc))

            # Go on from the next vertex.
            walk = arc + walk[end:]
            walk = [*walk[1:], walk[0]]
        return walk

    def _shorter(self, arc: list[int], time: Time) -> list[int]:
        """Return a path with the ends and the class of an arc, and shorter; [] when there is none or none is found."""
        bound = (1 - 1e-12) * self._path_length(arc)
        wanted = self.class_of(pairwise(arc), time)
        path = self.path([arc[0]], [arc[-1]], time)
        if self._path_length(path) >= bound:
            return []
        if self.class_of(pairwise(path), time) != wanted:
            path = self.path_in_class(arc[0], arc[-1], time, time, wanted, bound)
        return path if self._path_length(path) < bound else []


def as_edge(a: int, b: int) -> Edge:
    """Return an edge with the smaller end first."""
    return (a, b) if a < b else (b, a)


def sides(walk: Sequence[int]) -> list[Edge]:
    """Return the edges of a closed walk, the one that closes it last; a vertex that follows itself makes none."""
    return [(a, b) for a, b in zip(walk, (*walk[1:], walk[0]), strict=True) if a != b]


def _path_back(before: dict[T, T], node: T) -> list[T]:
    """Return the nodes of the path that ends in a node; its first one is before itself."""
    path = [node]
    while before[node] != node:
        node = before[node]
        path.append(node)
    return path[::-1]


def _spliced(walk: list[int], bridge: list[int], other: list[int]) -> list[int]:
    """Return a closed walk that leaves `walk` over a bridge, goes around `other`, and comes back."""
    i = walk.index(bridge[0])
    j = other.index(bridge[-1])
    detour = [*bridge[:-1], *other[j:], *other[: j + 1], *bridge[-2::-1]]
    return [*walk[:i], *detour, *walk[i + 1 :]]
