"""Persistence by the textbook: the reduction of the boundary matrix, for small clouds, in any degree.

Idea: the boundary of each simplex, in the order in which they arrive, is a column over Z/2: the set of its facets. From left
to right, while a column's youngest facet (its *pivot*) is already the pivot of a column to its left, add that column. Where
nothing is left, the simplex closed a cycle, and something is born. Otherwise what is left is a cycle that it filled, and what
the pivot created dies. `topokit.rips_persistence` finds the same pairs in degree 1 without listing triangles.

Source: Edelsbrunner, Letscher, Zomorodian 2002; Cohen-Steiner, Edelsbrunner, Morozov 2006 (R = D V). Taught in chapter 2.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

from numpy.typing import ArrayLike

from .._validate import positive, whole
from ._cloud import Cloud, check_memory
from .pairing import edges_in_order

__all__ = ["MAX_SIMPLICES", "Pair", "Reduction", "Simplex", "filtration", "persistence", "reduce"]

MAX_SIMPLICES = 100_000  # a few seconds; 84 points in degree 1, 39 in degree 2
Vertices = tuple[int, ...]


@dataclass(frozen=True)
class Simplex:
    """A simplex of the filtration."""

    vertices: Vertices  #: increasing
    value: float  #: half its longest edge, 0 for a vertex
    latest_edge: tuple[int, int] | None  #: with which it arrives; None for a vertex


@dataclass(frozen=True)
class Pair:
    """A bar, with the simplices that begin and end it."""

    degree: int  #: 0 for a component, 1 for a loop
    birth: float  #: half a diameter
    death: float  #: inf when nothing ends the bar
    birth_simplex: Vertices  #: vertices of the simplex that begins it
    death_simplex: Vertices | None  #: None when nothing ends the bar
    birth_edge: tuple[int, int] | None  #: latest edge of the first simplex; None for a vertex
    killer_edge: tuple[int, int] | None  #: latest edge of the last one
    cycle: tuple[Vertices, ...]  #: simplices of a cycle that is born with the bar and bounds at its death, not before

    @property
    def lifetime(self) -> float:
        """Return death - birth."""
        return self.death - self.birth


@dataclass(frozen=True)
class Reduction:
    """A reduced boundary matrix D V, where D holds the boundaries and V says which columns were added."""

    simplices: list[Simplex]  #: the filtration; its positions number columns and rows
    columns: list[set[int]]  #: reduced; no two that are not empty have the same largest entry
    chains: list[set[int]]  #: columns of V: whose boundaries add up to `columns[j]`; a cycle where that is empty
    killer: dict[int, int]  #: from the simplex with which something is born to the one that kills it

    def pairs(self, degree: int) -> Iterator[Pair]:
        """Yield what is born in a degree, in order of birth, bars of length zero among it."""
        for j, simplex in enumerate(self.simplices):
            if len(simplex.vertices) != degree + 1 or self.columns[j]:
                continue
            # What is never killed has the cycle that V holds; otherwise the killer's column is one that bounds at death.
            last = Simplex((), math.inf, None)  # stands for no simplex
            cycle = self.chains[j]
            if j in self.killer:
                last = self.simplices[self.killer[j]]
                cycle = self.columns[self.killer[j]]
            yield Pair(
                degree=degree,
                birth=simplex.value,
                death=last.value,
                birth_simplex=simplex.vertices,
                death_simplex=last.vertices or None,
                birth_edge=simplex.latest_edge,
                killer_edge=last.latest_edge,
                cycle=tuple(self.simplices[i].vertices for i in sorted(cycle)),
            )


def persistence(
    points: ArrayLike, degree: int = 1, *, max_radius: float = math.inf, metric: str = "euclidean"
) -> list[Pair]:
    """Compute the Vietoris-Rips persistence of a small cloud in one degree by reducing the boundary matrix.

    Parameters
    ----------
    points : (n, d) array_like
        Coordinates, or with ``metric="precomputed"`` the (n, n) symmetric matrix of distances.
    degree : int
        0 for components, 1 for loops, 2 for voids.
    max_radius : float
        Stop the filtration there; what is still alive gets death inf.
    metric : {"euclidean", "precomputed"}

    Returns
    -------
    list of Pair
        Longest lifetime first, then by birth and by birth simplex; none of length zero.

    Examples
    --------
    The second triangle of the diagonal {0, 2} fills the loop of a square.

    >>> square = [[0, 0], [2, 0], [2, 2], [0, 2]]
    >>> loop, = persistence(square)
    >>> loop.birth_simplex, loop.death_simplex, loop.killer_edge
    ((2, 3), (0, 2, 3), (0, 2))
    >>> loop.cycle
    ((0, 1), (0, 3), (1, 2), (2, 3))
    >>> [component.death for component in persistence(square, degree=0)]
    [inf, 1.0, 1.0, 1.0]
    """
    whole(degree, "degree")
    reduction = reduce(filtration(points, degree + 1, max_radius=max_radius, metric=metric))
    bars = [pair for pair in reduction.pairs(degree) if pair.death > pair.birth]
    return sorted(bars, key=lambda pair: (-pair.lifetime, pair.birth, pair.birth_simplex))


def filtration(
    points: ArrayLike, dimension: int, *, max_radius: float = math.inf, metric: str = "euclidean"
) -> list[Simplex]:
    """List the simplices of the Rips complex up to a dimension, in the order in which they arrive.

    Vertices come first, then edges by (length, smaller index, larger index). Each brings at once, by dimension, then by
    vertices, what it spans with the cliques of its *lune*, the vertices already joined to both its ends.

    Parameters
    ----------
    points : (n, d) array_like
    dimension : int
        The dimension of the largest simplices.
    max_radius, metric
        As in `persistence`.

    Examples
    --------
    >>> [simplex.vertices for simplex in filtration([[0.0], [1.0], [3.0]], 2)]
    [(0,), (1,), (2,), (0, 1), (1, 2), (0, 2), (0, 1, 2)]
    """
    whole(dimension, "dimension")
    cutoff = positive(max_radius, "max_radius", infinite=True)
    cloud = Cloud.of(points, metric)
    n = len(cloud)
    _check_size(n, n, dimension)
    check_memory(n, is_matrix=True)
    simplices = [Simplex((i,), 0.0, None) for i in range(n)]
    joined: list[set[int]] = [set() for _ in range(n)]
    edges, _, _ = edges_in_order(cloud, cloud.key_of(cutoff))
    for (i, j), radius in zip(edges.tolist(), cloud.radii(*edges.T).tolist(), strict=True):
        if radius > cutoff:
            break
        lune = sorted(joined[i] & joined[j])
        cliques: list[Vertices] = [()]
        for _ in range(dimension):
            # The edge with each clique of its lune; then the cliques grow by a vertex with a larger number.
            arriving = sorted(tuple(sorted((i, j, *clique))) for clique in cliques)
            simplices += [Simplex(vertices, radius, (i, j)) for vertices in arriving]
            _check_size(len(simplices), n, dimension)
            cliques = [
                (*clique, z)
                for clique in cliques
                for z in lune
                if z > max(clique, default=-1) and joined[z].issuperset(clique)
            ]
        joined[i].add(j)
        joined[j].add(i)
    return simplices


def reduce(simplices: Sequence[Simplex]) -> Reduction:
    """Reduce the boundary matrix of a filtration, every simplex after its facets, over Z/2, column by column from the left.

    Examples
    --------
    The third edge of a triangle finds a column with its pivot, vertex 2, and is left empty.

    >>> reduction = reduce(filtration([[0.0], [1.0], [3.0]], 2))
    >>> reduction.columns
    [set(), set(), set(), {0, 1}, {1, 2}, set(), {3, 4, 5}]
    >>> reduction.killer
    {1: 3, 2: 4, 5: 6}
    """
    position = {simplex.vertices: j for j, simplex in enumerate(simplices)}
    columns: list[set[int]] = []
    chains: list[set[int]] = []
    killer: dict[int, int] = {}
    for j, simplex in enumerate(simplices):
        # The boundary of the simplex, none for a vertex.
        column = set[int]()
        if simplex.latest_edge:
            facets = combinations(simplex.vertices, len(simplex.vertices) - 1)
            column = {position[facet] for facet in facets}
        chain = {j}
        # While the pivot is that of a column to the left, add that column.
        while column and max(column) in killer:
            left = killer[max(column)]
            column ^= columns[left]
            chain ^= chains[left]
        if column:
            killer[max(column)] = j
        columns.append(column)
        chains.append(chain)
    return Reduction(list(simplices), columns, chains, killer)


def _check_size(count: int, n: int, dimension: int) -> None:
    if count > MAX_SIMPLICES:
        raise ValueError(
            f"the Rips complex of these {n} points has more than {MAX_SIMPLICES} simplices up to dimension {dimension}: lower "
            "max_radius or the degree, take a subset (topokit.farthest_point_sample), or use topokit.rips_persistence"
        )
