"""Triangle meshes as surfaces: their edges, their winding, their loops, and paths along their edges.

trimesh is imported where it is used: a fresh process, which each episode has, starts sooner without it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components, depth_first_order, dijkstra

from topokit._geometry import angle, turned
from topokit._validate import as_ids
from topokit.linking import side_lengths
from topokit.rips import rips_persistence

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
Ids = NDArray[np.int64]


def half_edges(faces: Ids) -> Ids:
    """Return (3F, 2) the three edges of every face, smaller id first."""
    return np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)


def edge_lengths(vertices: Array, edges: Ids) -> Array:
    """Return (E,) the lengths of edges (E, 2) between vertices (N, 3)."""
    return np.asarray(np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1))


def wind(faces: Ids) -> Ids:
    """Return the faces turned so that neighbours run through their common edge in opposite directions; the first is kept."""
    import trimesh

    mesh = trimesh.Trimesh(np.zeros((faces.max() + 1, 3)), faces.copy(), process=False)
    trimesh.repair.fix_winding(mesh)
    wound = np.array(mesh.faces, dtype=np.int64)
    return wound if (wound[0] == faces[0]).all() else wound[:, ::-1]


def is_cycle(ids: Ids, edges: Ids) -> bool:
    """Return whether ids (L,) are three or more different vertices around a closed cycle along edges (E, 2)."""
    steps = np.sort(np.column_stack([ids, np.roll(ids, -1)]), axis=1)
    return (
        len(ids) > 2
        and len(np.unique(ids)) == len(ids)
        and {*map(tuple, steps.tolist())} <= {*map(tuple, edges.tolist())}
    )


def component_of(pairs: Ids, n: int) -> Ids:
    """Return (n,) the number of each vertex's component in the graph of these edges (E, 2)."""
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    return np.asarray(label, dtype=np.int64)


def count_components(faces: Ids) -> int:
    """Return the number of components of a mesh; trimesh does not join at an edge of three faces, such as a strap makes."""
    edges, edge_of = np.unique(half_edges(faces), axis=0, return_inverse=True)
    face_of = np.repeat(np.arange(len(faces)), 3)
    ends = np.column_stack([face_of, len(faces) + edge_of.ravel()])
    return int(component_of(ends, len(faces) + len(edges)).max()) + 1


def border_cycles(faces: Ids) -> list[Ids]:
    """Return the borders of a mesh, edges in one face only, as closed cycles; borders that touch each other give none."""
    edges, count = np.unique(half_edges(faces), axis=0, return_counts=True)
    border = edges[count == 1]
    graph = csr_matrix((np.ones(len(border)), border.T), shape=(int(faces.max()) + 1,) * 2)
    _, label = connected_components(graph, directed=False)
    _, first = np.unique(label[border[:, 0]], return_index=True)
    walks = [depth_first_order(graph, start, directed=False, return_predecessors=False) for start in border[first, 0]]
    return [np.roll(walk[::-1], 1).astype(np.int64) for walk in walks]


class EdgeGraph:
    """The vertices (N, 3) and the edges (E, 2) of a mesh, weighted by length."""

    def __init__(self, vertices: Array, edges: Ids) -> None:
        self._graph = csr_matrix((edge_lengths(vertices, edges), edges.T), shape=(len(vertices),) * 2)

    def distances(self, ids: Ids) -> Array:
        """Return (k, k) the lengths of the shortest paths between vertices."""
        one_way = dijkstra(self._graph, directed=False, indices=ids)[:, ids]
        return np.asarray(np.minimum(one_way, one_way.T))  # there and back differ by rounding

    def path(self, start: int, end: int) -> list[int]:
        """Return the vertices along the shortest path."""
        _, before = dijkstra(self._graph, directed=False, indices=start, return_predecessors=True)
        path = [end]
        while path[-1] != start:
            path.append(int(before[path[-1]]))
        return path[::-1]


def simple_cycles(walk: Sequence[int]) -> list[list[int]]:
    """Cut a closed walk where it returns to a vertex; what goes there and back over a bridge falls away."""
    parts: list[list[int]] = []
    path: list[int] = []
    for vertex in walk:
        if vertex in path:
            start = path.index(vertex)
            parts.append(path[start:])
            path = path[:start]
        path.append(vertex)
    return [part for part in [*parts, path] if len(part) > 2]


class Surface:
    """The faces of a mesh with one vertex at each place and each face once; vertices keep the ids of the mesh."""

    def __init__(self, mesh: str | Path | trimesh.Trimesh) -> None:
        import trimesh

        if not isinstance(mesh, trimesh.Trimesh):
            mesh = trimesh.load_mesh(mesh)
        self.vertices: Array = np.asarray(mesh.vertices, dtype=np.float64)
        # All vertices at one place go by the id of the first of them.
        first, place_of = trimesh.grouping.unique_rows(self.vertices)
        self._first_at: Ids = first[place_of]
        faces = self._first_at[mesh.faces]
        corners = np.sort(faces, axis=1)
        _, once = np.unique(corners, axis=0, return_index=True)
        once = once[(np.diff(corners[once], axis=1) > 0).all(axis=1)]
        self.faces = wind(faces[np.sort(once)])
        self.edges = np.unique(half_edges(self.faces), axis=0)
        self.used = np.unique(self.faces)

    def numbers(self, ids: ArrayLike, name: str) -> Ids:
        """Return the places of vertices, given by the ids of the mesh, in `used`."""
        known = self._first_at[as_ids(ids, name, len(self.vertices))]
        if not np.isin(known, self.used).all():
            raise ValueError(f"{name}: a vertex is in no face")
        return np.searchsorted(self.used, known)

    def loops(self) -> dict[str, Ids]:
        """Return the loops of `Garment.find_loops`."""
        cycles = border_cycles(self.faces)
        # By Euler's formula; a closed surface has a class in dimension 2, too.
        n_classes = 1 - len(self.used) + len(self.edges) - len(self.faces) + (not cycles)
        if n_classes >= max(len(cycles), 1):
            cycles = self._persistent_loops(n_classes)
        cycles.sort(key=lambda cycle: -float(side_lengths(self.vertices[cycle]).sum()))
        return {f"loop {i + 1}": cycle for i, cycle in enumerate(cycles)}

    def _persistent_loops(self, n: int) -> list[Ids]:
        """Return cycles along edges that represent the n longest-lived classes of the distances along the mesh."""
        graph = EdgeGraph(self.vertices, self.edges)
        diagram = rips_persistence(graph.distances(self.used), metric="precomputed")
        cycles = []
        for i in range(n):
            corners = self.used[diagram.cycle(i)].tolist()
            paths = [graph.path(a, b) for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)]
            walk = [vertex for path in paths for vertex in path[:-1]]
            cycles.append(np.array(max(simple_cycles(walk), key=len)))
        return cycles


def held_upright(vertices: Array, up: str, grips: Ids) -> Array:
    """Return vertices (N, 3) with an axis of theirs upwards, and about the middle of the grips: the first left of the second."""
    upright = np.roll(vertices, 2 - "xyz".index(up[-1]), axis=1)
    if up[0] == "-":
        upright = upright * [1, -1, -1]  # half a turn about x
    first, second = upright[grips]
    return turned(upright - (first + second) / 2, -angle(np.array([1.0, 0, 0]), second - first))
