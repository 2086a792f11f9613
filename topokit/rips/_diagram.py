"""The degree-1 persistence diagram with the simplices that create and end each loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._validate import as_ids, positive
from ._cloud import Cloud

if TYPE_CHECKING:
    from ._cycles import Homology


@dataclass(frozen=True, eq=False)
class Diagram:
    """Degree-1 Rips persistence of a point cloud or a distance matrix, longest lifetime first.

    A loop that `max_radius` keeps from dying has death inf and -1 for its killer's vertices.
    """

    birth: NDArray[np.float64]  #: (n,) half the length of the birth edge, in the unit of the points
    death: NDArray[np.float64]  #: (n,) half the length of the killer edge
    birth_edge: NDArray[np.int64]  #: (n, 2) vertex ids, the smaller first
    killer_edge: NDArray[np.int64]  #: (n, 2) vertex ids
    #: (n, 2, 3) the killer edge and an apex, twice: one of each of the two components of the lune that the killing relation
    #: joins. The thick triangle, whose apex is farther from the edge's farther end, comes first.
    killer_triangles: NDArray[np.int64]
    n_points: int  #: number of points of the cloud
    max_radius: float  #: radius at which the filtration stopped
    _cloud: Cloud
    _simplices: tuple[NDArray[np.int64], NDArray[np.int64]]  # of short loops too: created (c, 2), killed (c, 4)

    def __post_init__(self) -> None:
        for name in ("birth", "death", "birth_edge", "killer_edge", "killer_triangles"):
            getattr(self, name).setflags(write=False)

    def __len__(self) -> int:
        return len(self.birth)

    def __repr__(self) -> str:
        longest = f", longest lifetime {self.lifetime[0]:.4g}" if len(self) else ""
        return f"Diagram({len(self)} loops of {self.n_points} points{longest})"

    @property
    def lifetime(self) -> NDArray[np.float64]:
        """Return the lifetimes (n,) of the loops: death - birth."""
        return self.death - self.birth

    def neighbours(self, i: int) -> NDArray[np.int64]:
        """Return the triangles next to the killer triangles of loop `i`: on each of four outer edges the one that comes first.

        Returns
        -------
        (m, 3) int64, m <= 4
            Outer edge and apex, the thick triangle's first. Triangles that come after the loop's death are left out.
        """
        self._check_index(i)
        if np.isinf(self.death[i]):
            return np.empty((0, 3), dtype=np.int64)
        vertices = self.killer_triangles[i].ravel()[[0, 1, 2, 5]]  # both ends of the killer edge, and the two apexes
        radii = self._cloud.radii(vertices[:, None], slice(None)).reshape(4, -1)
        death = radii[0, vertices[1]]

        # When a triangle on an outer edge {a, b} enters, for each third vertex but those of the killer triangle itself.
        outer = np.array(
            [[0, 2, 1], [2, 1, 0], [0, 3, 1], [3, 1, 0]]
        )  # edges of the killer triangles, and the third vertex
        a, b, _ = outer.T
        triangles = vertices[outer]
        enters = np.maximum(np.maximum(radii[a], radii[b]), radii[a, triangles[:, 1], None])
        rows = np.arange(4)
        enters[rows[:, None], triangles] = np.inf

        triangles[:, 2] = enters.argmin(axis=1)
        return triangles[enters[rows, triangles[:, 2]] <= death]

    def cycle(self, i: int) -> NDArray[np.int64]:
        """Return a closed walk around loop `i`, tight at its birth: the birth edge and the shortest path around it.

        It becomes a boundary with the killer edge, not before. The path is the shortest, along edges that precede the birth
        edge, for which this is so: the shortest of all may go around an older loop as well, and would outlive the bar.

        There are two exceptions: where very many older loops are alive, the search for that path gives up, and where what
        dies are the two rings at the ends of a pipe, no connected walk at birth is in their class. Then walks around older
        loops are added, there and back over a bridge of edges that precede the killer edge and, used twice, count as nothing.

        Returns
        -------
        (length,) int64
            Vertex ids, from one end of the birth edge to the other; the last joins the first.

        Examples
        --------
        >>> from topokit import rips_persistence
        >>> rips_persistence([[0, 0], [2, 0], [2, 2], [0, 2], [1, 1.9]]).cycle(0)
        array([1, 0, 3, 4, 2])
        """
        self._check_index(i)
        birth_edge = tuple(self.birth_edge[i].tolist())
        killer_edge = None if np.isinf(self.death[i]) else tuple(self.killer_edge[i].tolist())
        return np.array(self._homology.representative(birth_edge, killer_edge), dtype=np.int64)

    def tighten(self, cycle: ArrayLike, *, radius: float | None = None) -> NDArray[np.int64]:
        """Shorten a closed walk without leaving its homology class.

        Stretches of a third of the walk are replaced by the shortest path between their ends that is homologous to them, until
        none can be. The walk keeps its class over Z/2; it is not always the shortest of it. A boundary shrinks to a vertex.

        Parameters
        ----------
        cycle : (length,) array_like of int
            Vertex ids; the last joins the first.
        radius : float, optional
            The Rips complex has all edges up to the length 2 * radius. When the radius is not given, or is below half the
            length of the walk's longest edge, that half length is used. It may be at most the diagram's `max_radius`.

        Returns
        -------
        (new_length,) int64
            Vertex ids, from the first old vertex that is still there.

        Examples
        --------
        Around the square; at radius 1.2 the corner at vertex 4 can be cut.

        >>> from topokit import rips_persistence
        >>> diagram = rips_persistence([[0, 0], [2, 0], [2, 2], [0, 2], [1, 2.5]])
        >>> diagram.tighten([0, 1, 2, 4, 3])
        array([0, 1, 2, 4, 3])
        >>> diagram.tighten([0, 1, 2, 4, 3], radius=1.2)
        array([0, 1, 2, 3])
        """
        walk = _as_walk(cycle, self.n_points)
        homology = self._homology

        # The complex just after the walk's latest edge, or at the radius.
        key, low, high = max(homology.time(a, b) for a, b in pairwise([*walk, walk[0]]))
        time = (key, low, high + 1)
        reached = float(self._cloud.radii(low, np.array(high)))
        if radius is not None:
            given = positive(radius, "radius", infinite=True)
            time = max(time, (self._cloud.key_of(given), self.n_points, self.n_points))
            reached = max(reached, given)
        if reached > self.max_radius:
            raise ValueError(f"the diagram ends at max_radius {self.max_radius:g}, and radius {reached:g} is asked for")

        # Begin at the first old vertex that is still there.
        tight = homology.tightened(walk, time)
        first = next((tight.index(vertex) for vertex in walk if vertex in tight), 0)
        return np.array([*tight[first:], *tight[:first]], dtype=np.int64)

    def killers_of(self, walks: Sequence[ArrayLike]) -> NDArray[np.int64]:
        """Return for closed walks the edges with which they die by the elder rule.

        With that edge a walk becomes a boundary, or homologous to a sum of walks that come before it in `walks`. So
        independent walks have different killers, even when they merge long before both are filled in.

        Parameters
        ----------
        walks : sequence of (length,) array_like of int
            Vertex ids of closed walks; the last joins the first. Edges may have any length.

        Returns
        -------
        (len(walks), 2) int64
            A killer edge, or the walk's own latest edge; -1 where `max_radius` keeps it from ending.

        Raises
        ------
        ValueError
            When a walk has no edge.

        Examples
        --------
        >>> from topokit import rips_persistence
        >>> dgm = rips_persistence([[0, 0], [2, 0], [2, 2], [0, 2], [1, 2.5]])
        >>> dgm.killers_of([[0, 1, 2, 4, 3], [0, 1, 2, 3]]), dgm.killer_edge
        (array([[1, 4],
               [2, 3]]), array([[1, 4]]))
        """
        ids = [_as_walk(walk, self.n_points, f"walks[{number}]") for number, walk in enumerate(walks)]
        if any(len(walk) == 1 for walk in ids):
            raise ValueError("a walk must have an edge, not a single vertex")
        edges = [edge or (-1, -1) for edge in self._homology.killers_of(ids)]
        return np.array(edges, dtype=np.int64).reshape(-1, 2)

    @cached_property
    def _homology(self) -> Homology:
        from ._cycles import Homology  # SciPy takes a while to import

        return Homology(self._cloud, *self._simplices)

    def _check_index(self, i: int) -> None:
        if not -len(self) <= i < len(self):
            raise IndexError(f"no loop {i}: the diagram has {len(self)}")


def _as_walk(cycle: ArrayLike, n_points: int, name: str = "cycle") -> list[int]:
    """Return the vertex ids of a closed walk, repeated ones next to each other left out."""
    if np.ndim(cycle) != 1:
        raise TypeError(f"{name} must be a sequence of vertex ids, not {np.asarray(cycle).tolist()!s:.40}")
    if not np.size(cycle):
        raise ValueError(f"{name} is empty: a closed walk needs vertex ids")
    ids = as_ids(cycle, name, n_points)
    changes = ids != np.roll(ids, -1)
    return ids[changes].tolist() if changes.any() else [int(ids[0])]
