"""The degree-1 persistence diagram with the simplices that create and end each loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._validate import Array, Ids, as_ids, positive
from ._cloud import Cloud
from ._pairs import pairs

if TYPE_CHECKING:
    from ._cycles import Homology

_OUTER = np.array([[0, 2, 1], [2, 1, 0], [0, 3, 1], [3, 1, 0]])  # edges of the killer triangles, and the third vertex


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
        a, b, _ = _OUTER.T
        triangles = vertices[_OUTER]
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

    def to_gudhi(self) -> tuple[Ids, list[Ids], Ids, list[Ids]]:
        """Return the pairs in the form of GUDHI's ``SimplexTree.flag_persistence_generators``, larger vertices first.

        GUDHI is not needed for it. Which of two components dies when they merge is open, as all are born at 0: here it is the
        one whose first vertex has the larger number.

        Returns
        -------
        (c, 3) int64, list of (n, 4) int64, (k,) int64, list of (m, 2) int64
            For each merge of components, a vertex and the edge. For loops that end, birth edge and killer edge. A vertex of
            each component that stays. The birth edges of loops that stay. The lists are empty when there is no such loop.

        Examples
        --------
        >>> from topokit import rips_persistence
        >>> rips_persistence([[0, 0], [2, 0], [2, 2], [0, 2]]).to_gudhi()[1]
        [array([[3, 2, 2, 0]])]
        """
        edges, radii = _component_merges(self._cloud, self.max_radius)
        dying, staying = _elders(edges, self.n_points)
        merges = np.column_stack([dying, edges[:, ::-1]])[radii > 0]
        birth_edge = self.birth_edge[:, ::-1]
        killer_edge = self.killer_edge[:, ::-1]
        stays = np.isinf(self.death)
        ended = np.hstack([birth_edge, killer_edge])[~stays]
        staying_loops = birth_edge[stays]
        return merges, [ended] if len(ended) else [], staying, [staying_loops] if len(staying_loops) else []

    @cached_property
    def _homology(self) -> Homology:
        from ._cycles import Homology  # SciPy takes a while to import

        return Homology(self._cloud, *self._simplices)

    def _check_index(self, i: int) -> None:
        if not -len(self) <= i < len(self):
            raise IndexError(f"no loop {i}: the diagram has {len(self)}")


def tighten(
    points: ArrayLike | Diagram, cycle: ArrayLike, *, radius: float | None = None, metric: str = "euclidean"
) -> NDArray[np.int64]:
    """Shorten a closed walk without leaving its homology class.

    Stretches of a third of the walk are replaced by the shortest path between their ends that is homologous to them, until
    none can be. The walk keeps its class over Z/2; it is not always the shortest of it. A boundary shrinks to a vertex.

    Parameters
    ----------
    points : (n, d) array_like or Diagram
        Coordinates, with ``metric="precomputed"`` the (n, n) distances, or a diagram of either.
    cycle : (length,) array_like of int
        Vertex ids; the last joins the first.
    radius : float, optional
        The Rips complex has all edges up to the length 2 * radius. When the radius is not given, or is below half the length of
        the walk's longest edge, that half length is used.
    metric : {"euclidean", "precomputed"}
        Kind of `points`; ignored for a diagram.

    Returns
    -------
    (new_length,) int64
        Vertex ids, from the first old vertex that is still there.

    Raises
    ------
    TypeError, ValueError
        When `cycle` is not a sequence of vertex ids.

    Examples
    --------
    Around the square; at radius 1.2 the corner at vertex 4 can be cut.

    >>> points = [[0, 0], [2, 0], [2, 2], [0, 2], [1, 2.5]]
    >>> tighten(points, [0, 1, 2, 4, 3])
    array([0, 1, 2, 4, 3])
    >>> tighten(points, [0, 1, 2, 4, 3], radius=1.2)
    array([0, 1, 2, 3])
    """
    from ._cycles import Homology, sides  # SciPy takes a while to import

    if isinstance(points, Diagram):
        diagram = points
        cloud = diagram._cloud
    else:
        diagram = None
        cloud = Cloud.of(points, metric)
    walk = _as_walk(cycle, len(cloud))

    # The complex just after the walk's latest edge, or at the radius.
    a, b = np.sort(sides(walk)).T
    key, low, high = max(zip(cloud.keys(a, b).tolist(), a.tolist(), b.tolist(), strict=True))
    time = (key, low, high + 1)
    bound = float(cloud.radii(low, np.array(high)))
    if radius is not None:
        given = positive(radius, "radius", infinite=True) * cloud.scale
        bound = max(bound, given)
        time = max(time, (cloud.key_of(given), len(cloud), len(cloud)))
    bound *= 1 + 1e-12

    # Its classes are known if the diagram reaches so far.
    if diagram is not None and bound <= diagram.max_radius * cloud.scale:
        classes = diagram._homology
    else:
        found = pairs(cloud, bound)
        classes = Homology(cloud, found.created, found.killed)
    tight = classes.tightened(walk, time)
    if classes.length(tight) > classes.length(walk):  # only by rounding
        tight = walk

    # Begin at the first old vertex that is still there.
    first = next((tight.index(vertex) for vertex in walk if vertex in tight), 0)
    return np.array([*tight[first:], *tight[:first]], dtype=np.int64)


def _as_walk(cycle: ArrayLike, n_points: int, name: str = "cycle") -> list[int]:
    """Return the vertex ids of a closed walk, repeated ones next to each other left out."""
    if np.ndim(cycle) != 1:
        raise TypeError(f"{name} must be a sequence of vertex ids, not {np.asarray(cycle).tolist()!s:.40}")
    if not np.size(cycle):
        raise ValueError(f"{name} is empty: a closed walk needs vertex ids")
    ids = as_ids(cycle, name, n_points)
    changes = ids != np.roll(ids, -1)
    return ids[changes].tolist() if changes.any() else [int(ids[0])]


def _component_merges(cloud: Cloud, max_radius: float) -> tuple[Ids, Array]:
    """Return the (m, 2) edges with which components merge, smaller vertex first, in the total order; and half their lengths."""
    edges = _spanning_tree(cloud)
    radii = cloud.radii(edges[:, 0], edges[:, 1]) / cloud.scale
    inside = radii <= max_radius
    return edges[inside], radii[inside]


def _spanning_tree(cloud: Cloud) -> Ids:
    """Return the (n - 1, 2) edges of the minimum spanning tree in the total order, smaller vertex first, by Prim's method."""
    n = len(cloud)
    edges = np.empty((max(n - 1, 0), 3))  # key, smaller and larger vertex
    keys = np.full(n, np.inf)  # of the shortest edge from the tree to each vertex outside; not a number inside
    nearest = np.zeros(n, np.int64)  # the vertex of the tree at which that edge begins
    new = 0
    for row in range(len(edges)):
        # A vertex has joined the tree, and is now the nearest one of some vertices outside.
        keys[new] = np.nan
        to_new = cloud.keys(new, slice(None))
        is_nearer = to_new < keys
        for other in np.flatnonzero(to_new == keys).tolist():
            is_nearer[other] = sorted((new, other)) < sorted((nearest[other], other))
        nearest[is_nearer] = new
        keys[is_nearer] = to_new[is_nearer]

        # The first edge in the total order that leaves the tree brings the next vertex.
        shortest = np.flatnonzero(keys == np.fmin.reduce(keys)).tolist()
        new = min(shortest, key=lambda other: sorted((nearest[other], other)))
        edges[row] = keys[new], *sorted((nearest[new], new))
    order = np.lexsort((edges[:, 2], edges[:, 1], edges[:, 0]))
    return edges[order, 1:].astype(np.int64)


def _elders(edges: Ids, n: int) -> tuple[Ids, Ids]:
    """Return the vertex that dies with each merge, the one with the larger number of two first vertices, and those that stay."""
    first = list(range(n))  # on the way to the first vertex of the component

    def first_of(vertex: int) -> int:
        while first[vertex] != vertex:
            first[vertex] = first[first[vertex]]
            vertex = first[vertex]
        return vertex

    dying = []
    for a, b in edges.tolist():
        elder, younger = sorted((first_of(a), first_of(b)))
        first[younger] = elder
        dying.append(younger)
    staying = [vertex for vertex in range(n) if first[vertex] == vertex]
    return np.array(dying, np.int64), np.array(staying, np.int64)
