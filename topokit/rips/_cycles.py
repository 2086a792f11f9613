"""Closed walks around loops: one that is short at birth and dies when its loop does, and shorter ones in the same class.

Idea: a cycle, written in creators as in `kernel`, is a short set. The relations that kill loops, reduced, turn that set into
the cycle's *class*: nothing is left of it exactly when the cycle is a boundary. Both are worked out only when asked for.

The shortest way around a birth edge {x, y} is the shortest path from x to y before it arrives. It may go around an older
loop as well and then outlives the bar. So the search runs in pairs (vertex, class of the path so far), as in a covering
space where the unwanted loops are unrolled: the shortest path that ends in the right class is the answer.

Source: Koyama, Memoli, Robins, Turner 2023 (creators); Busaryev, Cabello, Chen, Dey, Wang 2012 (classes of edges);
Erickson and Nayyeri 2011 (the search in pairs).
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable, Sequence
from functools import reduce
from itertools import pairwise, starmap
from operator import xor

import numpy as np
from numpy.typing import NDArray

from ._cloud import Cloud
from .kernel import edge_length, first_triangle, neighbours, shortest_paths

SEARCH_LIMIT = 20_000  # pairs (vertex, class) looked at before a search gives up
Edge = tuple[int, int]
Time = tuple[float, int, int]  # what `edge_length` says of an edge, and its ends
NEVER: Time = (math.inf, 0, 0)
_Array = NDArray[np.float64]
_Axes = tuple[int, ...]


class Homology:
    """Degree-1 classes in the Rips filtration of a cloud, as sets of creators: an int, bit c for the c-th loop born."""

    def __init__(self, cloud: Cloud, created: NDArray[np.int64], killed: NDArray[np.int64]) -> None:
        self._data, self._axes = cloud.data, cloud.axes
        self._creator: dict[Edge, int] = {(a, b): c for c, (a, b) in enumerate(created.tolist())}
        self._killers: list[list[int]] = killed.tolist()
        self._killed_at = [self.time(x, y) if x >= 0 else NEVER for x, y, _, _ in self._killers]
        self._edges: dict[Edge, int] = {}  # edges written in creators
        self._columns: dict[int, int] = {}  # reduced relations, by youngest creator
        self._classes: dict[Edge, int] = {}  # of edges, at the time that was asked for last
        self._classes_at: Time | None = None

    def time(self, i: int, j: int) -> Time:
        """When the edge {i, j} arrives."""
        return edge_length(self._data, i, j, self._axes), min(i, j), max(i, j)

    def length(self, walk: Sequence[int]) -> float:
        """Length of a closed walk."""
        return math.fsum(self.side(a, b) for a, b in sides(walk))

    def side(self, a: int, b: int) -> float:
        """Length of an edge."""
        key = self.time(a, b)[0]
        return math.sqrt(key) if self._axes else key

    def in_creators(self, a: int, b: int) -> int:
        """The edge {a, b} written in creators."""
        waiting = [(min(a, b), max(a, b))]
        while waiting:
            edge = waiting[-1]
            if edge in self._edges:
                waiting.pop()
            elif edge in self._creator:
                self._edges[edge] = 1 << self._creator[edge]
            elif (z := first_triangle(self._data, self._axes, *edge)) < 0:
                self._edges[edge] = 0  # a tree edge
            else:
                one, other = ((min(v, z), max(v, z)) for v in edge)
                if one in self._edges and other in self._edges:
                    self._edges[edge] = self._edges[one] ^ self._edges[other]
                else:
                    waiting += [one, other]
        return self._edges[edge]

    def _around(self, walk: Sequence[int]) -> int:
        """A closed walk written in creators."""
        return reduce(xor, starmap(self.in_creators, sides(walk)))

    def class_of(self, edges: Iterable[Edge], time: Time) -> int:
        """The class of a chain in the complex just before a time, linear in the chain; 0 for a boundary."""
        if time != self._classes_at:
            self._classes_at, self._classes = time, {}
        total = 0
        for a, b in edges:
            edge = (a, b) if a < b else (b, a)
            if edge not in self._classes:
                self._classes[edge] = self._reduced(self.in_creators(a, b), time)[0]
            total ^= self._classes[edge]
        return total

    def _reduced(self, column: int, time: Time) -> tuple[int, set[int]]:
        """What relations before a time leave of a set of creators; creators that are left or are such a relation's youngest."""
        left, used = 0, set[int]()
        while column:
            youngest = column.bit_length() - 1
            used.add(youngest)
            if self._killed_at[youngest] < time:
                column ^= self._columns.get(youngest) or self._relation_of(youngest)
            else:
                left |= 1 << youngest
                column ^= 1 << youngest
        return left, used

    def killers_of(self, walks: Iterable[Sequence[int]]) -> list[Edge | None]:
        """For closed walks in order: the edge with which each becomes a boundary or homologous to a sum of earlier ones."""
        edges, settled = list[Edge | None](), dict[int, set[int]]()
        for walk in walks:
            last = max(self.time(a, b) for a, b in sides(walk))
            (_, used), latest = self._reduced(self._around(walk), NEVER), -1
            while used and (latest := max(used, key=self._killed_at.__getitem__)) in settled:
                used = used ^ settled[latest]
            if used:
                settled[latest] = used
                last = max(last, self._killed_at[latest])
            edges.append(None if last[0] == math.inf else last[1:])
        return edges

    def _relation_of(self, creator: int) -> int:
        """The relation that kills a loop, reduced by those before it until the loop is its youngest."""
        waiting, unfinished = [creator], dict[int, int]()
        while waiting:
            c = waiting[-1]
            if c not in unfinished:
                x, y, first, further = self._killers[c]
                unfinished[c] = self._around([x, first, y, further])
            while (youngest := unfinished[c].bit_length() - 1) != c and youngest in self._columns:
                unfinished[c] ^= self._columns[youngest]
            if youngest == c:
                self._columns[c] = unfinished[c]
                waiting.pop()
            else:
                waiting.append(youngest)
        return self._columns[creator]

    def representative(self, birth_edge: Edge, killer_edge: Edge | None) -> list[int]:
        """A short closed walk that is born with an edge and, if there is a killer edge, becomes a boundary with that."""
        x, y = birth_edge
        born = self.time(x, y)
        walk = self.path([x], [y], born)
        if killer_edge is None:
            return walk
        key, low, high = self.time(*killer_edge)
        death = (key, low, high + 1)  # just after the killer edge
        if self.class_of(sides(walk), death) == 0:
            return walk
        around = self.path_in_class(x, y, born, death, self.class_of([birth_edge], death))
        return around or self._corrected(walk, born, death)

    def path(self, sources: Sequence[int], targets: Sequence[int], time: Time) -> list[int]:
        """The shortest path from one of the sources to one of the targets before a time; [] when there is none."""
        stop = sources[0] if len(sources) == 1 else -1
        length, after = shortest_paths(self._data, self._axes, time, np.asarray(targets), stop)
        path = [min(sources, key=lambda v: length[v])]
        while after[path[-1]] >= 0:
            path.append(int(after[path[-1]]))
        return path if length[path[0]] < math.inf else []

    def path_in_class(
        self, source: int, target: int, time: Time, death: Time, wanted: int, bound: float = math.inf
    ) -> list[int]:
        """The shortest path before a time whose class before `death` is the one wanted; [] if none is found below the bound."""
        remaining = shortest_paths(self._data, self._axes, time, np.array([target]), -1)[0].tolist()
        start, goal = (source, 0), (target, wanted)
        best, before = {start: (0.0, 0)}, {start: start}
        queue = [(remaining[source], 0, start)]
        done: set[tuple[int, int]] = set()
        while queue and len(done) < SEARCH_LIMIT:
            *_, state = heapq.heappop(queue)
            if state == goal:
                return _back(before, goal)
            if state in done:
                continue
            done.add(state)
            v, so_far = state
            length, steps = best[state]
            for w, step in zip(*map(np.ndarray.tolist, neighbours(self._data, self._axes, v, time)), strict=True):
                if length + step + remaining[w] >= bound:
                    continue
                onward, way = (w, so_far ^ self.class_of([(v, w)], death)), (length + step, steps + 1)
                if onward not in done and way < best.get(onward, (math.inf, 0)):
                    best[onward], before[onward] = way, state
                    heapq.heappush(queue, (way[0] + remaining[w], way[1], onward))
        return []

    def _corrected(self, walk: list[int], born: Time, death: Time) -> list[int]:
        """Add to a walk those around the older loops that it contains, so that nothing of it is left at death."""
        edges = list(self._creator)
        while left := self.class_of(sides(walk), death):
            x, y = edges[left.bit_length() - 1]
            other = self.path([x], [y], self.time(x, y))
            bridge = next(path for t in (born, death) if (path := self.path(walk, other, t)))
            walk = _spliced(walk, bridge, other)
        return walk

    def tightened(self, walk: list[int], time: Time) -> list[int]:
        """Shorten a closed walk within its class before a time, until no third of it can be made shorter."""
        if self.class_of(sides(walk), time) == 0:
            return walk[:1]
        settled: set[tuple[int, ...]] = set()
        turns = 0
        while turns < len(walk):
            reach = np.cumsum([self.side(a, b) for a, b in sides(walk)])
            end = max(int(np.searchsorted(reach, reach[-1] / 3)), 2) + 1
            arc, rest = walk[:end], walk[end:]
            path = [] if tuple(arc) in settled else self._shorter(arc, time)
            settled.add(tuple(path or arc))
            walk, turns = (path or arc) + rest, 0 if path else turns + 1
            walk = [*walk[1:], walk[0]]
        return walk

    def _shorter(self, arc: list[int], time: Time) -> list[int]:
        """A path with the ends and the class of an arc, and shorter; [] when there is none or none is found."""
        bound = (1 - 1e-12) * sum(map(self.side, arc, arc[1:]))
        wanted = self.class_of(pairwise(arc), time)
        path = self.path([arc[0]], [arc[-1]], time)
        if sum(map(self.side, path, path[1:])) >= bound:
            return []
        if self.class_of(pairwise(path), time) != wanted:
            path = self.path_in_class(arc[0], arc[-1], time, time, wanted, bound)
        return path if sum(map(self.side, path, path[1:])) < bound else []


def sides(walk: Sequence[int]) -> list[Edge]:
    """The edges of a closed walk, the one that closes it last."""
    return list(zip(walk, (*walk[1:], walk[0]), strict=True))


def _back(before: dict[tuple[int, int], tuple[int, int]], state: tuple[int, int]) -> list[int]:
    path = [state[0]]
    while before[state] != state:
        state = before[state]
        path.append(state[0])
    return path[::-1]


def _spliced(walk: list[int], bridge: list[int], other: list[int]) -> list[int]:
    """A closed walk that leaves `walk` over a bridge, goes around `other`, and comes back."""
    i, j = walk.index(bridge[0]), other.index(bridge[-1])
    detour = [*bridge[:-1], *other[j:], *other[: j + 1], *bridge[-2::-1]]
    return [*walk[:i], *detour, *walk[i + 1 :]]
