"""The degree-1 persistence diagram with the simplices that create and end each loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._validate import as_ids
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

        Returns at most four rows of an outer edge and an apex, the thick triangle's first. Triangles that come after the loop's
        death are left out.
        """
        death = self.death[i]
        triangles = list[tuple[int, int, int]]()
        for x, y, apex in self.killer_triangles[i].tolist() if death < np.inf else ():
            for a, b, opposite in ((x, apex, y), (apex, y, x)):
                # When does the triangle of the outer edge {a, b} and another vertex enter?
                to_a, to_b = self._cloud.radii(np.array([[a], [b]]), slice(None)).reshape(2, -1)
                enters = np.maximum(np.maximum(to_a, to_b), to_a[b])
                enters[[a, b, opposite]] = np.inf
                first = int(enters.argmin())
                if enters[first] <= death:
                    triangles.append((a, b, first))
        return np.array(triangles, np.int64).reshape(-1, 3)

    def cycle(self, i: int) -> NDArray[np.int64]:
        """Return a closed walk around loop `i`, tight at its birth: the birth edge and the shortest path around it.

        It becomes a boundary with the killer edge, not before. The path is the shortest, along edges that precede the birth
        edge, for which this is so: the shortest of all may go around an older loop as well, and would outlive the bar. It runs
        from one end of the birth edge to the other; the last vertex joins the first.

        Where very many older loops are alive, the search for that path gives up; and where the two rings at the ends of a pipe
        die, no connected walk at birth is in their class. Then walks around older loops are added, there and back over a
        bridge of edges that precede the killer edge and, used twice, count as nothing.

        Examples
        --------
        >>> from topokit import rips_persistence
        >>> rips_persistence([[0, 0], [2, 0], [2, 2], [0, 2], [1, 1.9]]).cycle(0)
        array([1, 0, 3, 4, 2])
        """
        birth_edge = tuple(self.birth_edge[i].tolist())
        killer_edge = None if np.isinf(self.death[i]) else tuple(self.killer_edge[i].tolist())
        return np.array(self._homology.representative(birth_edge, killer_edge), dtype=np.int64)

    def tighten(self, cycle: ArrayLike, radius: float) -> NDArray[np.int64]:
        """Shorten a closed walk without leaving its homology class over Z/2 in the Rips complex of a radius.

        Stretches of a third of the walk are replaced by the shortest path between their ends that is homologous to them, until
        none can be. It is not always the shortest walk of its class. A boundary shrinks to a vertex.

        Parameters
        ----------
        cycle : (length,) array_like of int
            Vertex ids; the last joins the first. The answer begins with the first of them that is still there.
        radius : float
            At most the diagram's `max_radius`. Half the length of the walk's longest edge is used where that is more.

        Examples
        --------
        Around the square; at radius 1.2 the corner at vertex 4 can be cut.

        >>> from topokit import rips_persistence
        >>> diagram = rips_persistence([[0, 0], [2, 0], [2, 2], [0, 2], [1, 2.5]])
        >>> diagram.tighten([0, 1, 2, 4, 3], radius=1.2)
        array([0, 1, 2, 3])
        """
        from ._cycles import sides

        ids = as_ids(cycle, "cycle", self.n_points).tolist()
        walk = [a for a, _ in sides(ids)] or ids[:1]
        radius = max([radius, *(self._homology.side(a, b) / 2 for a, b in sides(walk))])
        if radius > self.max_radius:
            raise ValueError(f"the diagram ends at max_radius {self.max_radius:g}, and radius {radius:g} is asked for")

        tight = self._homology.tightened(walk, (self._cloud.key_of(radius), self.n_points, self.n_points))
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

        Examples
        --------
        >>> from topokit import rips_persistence
        >>> dgm = rips_persistence([[0, 0], [2, 0], [2, 2], [0, 2], [1, 2.5]])
        >>> dgm.killers_of([[0, 1, 2, 4, 3], [0, 1, 2, 3]]), dgm.killer_edge
        (array([[1, 4],
               [2, 3]]), array([[1, 4]]))
        """
        ids = [as_ids(walk, f"walks[{number}]", self.n_points).tolist() for number, walk in enumerate(walks)]
        edges = [edge or (-1, -1) for edge in self._homology.killers_of(ids)]
        return np.array(edges, dtype=np.int64).reshape(-1, 2)

    @cached_property
    def _homology(self) -> Homology:
        from ._cycles import Homology  # SciPy takes a while to import

        return Homology(self._cloud, *self._simplices)
