"""Triangle meshes as surfaces: their edges, their winding, their borders, and closed cycles along their edges."""

from collections.abc import Sequence

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

from topokit.rips import Diagram, rips_persistence, tighten

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
_GAP = 4  # edges: a gap of so many in a loop is closed along the mesh


def half_edges(faces: Ids) -> Ids:
    """Return (3F, 2) the three edges of every face, smaller id first."""
    return np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)


def edge_lengths(vertices: Array, edges: Ids) -> Array:
    """Return (E,) the lengths of edges (E, 2) between vertices (N, 3)."""
    return np.asarray(np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1))


def face_areas(vertices: Array, faces: Ids) -> Array:
    """Return (F,) the areas of faces (F, 3)."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)


def vector_area(curve: Array) -> Array:
    """Return the area (3,) of a closed curve (k, 3), along its normal."""
    arms = curve - curve.mean(axis=0)
    return np.asarray(np.cross(arms, np.roll(arms, -1, axis=0)).sum(axis=0) / 2)


def is_inside(vertices: Array, faces: Ids, place: Array) -> bool:
    """Return True if a closed surface is around a place (3,), by the sum of the solid angles of its faces.

    Source: van Oosterom, Strackee 1983, *The solid angle of a plane triangle*.
    """
    a, b, c = np.moveaxis(vertices[faces] - place, 1, 0)
    long_a, long_b, long_c = (np.linalg.norm(arm, axis=1) for arm in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    products = [np.einsum("ij,ij->i", one, other) for one, other in ((a, b), (b, c), (c, a))]
    against = long_a * long_b * long_c + products[0] * long_c + products[1] * long_a + products[2] * long_b
    return bool(abs(2 * np.arctan2(volume, against).sum()) > 2 * np.pi)


def wind(faces: Ids) -> Ids:
    """Return the faces turned so that neighbours run through their common edge in opposite directions; the first is kept."""
    mesh = trimesh.Trimesh(np.zeros((faces.max() + 1, 3)), faces.copy(), process=False)
    trimesh.repair.fix_winding(mesh)
    wound = np.array(mesh.faces, dtype=np.int64)
    return wound if (wound[0] == faces[0]).all() else wound[:, ::-1]


def not_joined(cycle: Ids, edges: Ids) -> list[tuple[int, int]]:
    """Return the pairs of vertices that follow each other in a closed cycle and are not joined by an edge (E, 2)."""
    known = set(map(tuple, edges.tolist()))
    pairs = zip(cycle.tolist(), np.roll(cycle, -1).tolist(), strict=True)
    return [(a, b) for a, b in pairs if (min(a, b), max(a, b)) not in known]


def component_of(pairs: Ids, n: int) -> Ids:
    """Return (n,) the number of each vertex's component in the graph of these edges (E, 2)."""
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    return np.asarray(label, dtype=np.int64)


def components(faces: Ids) -> Ids:
    """Return (F,) the number of each face's component; faces are joined by an edge, not by a vertex that they share.

    trimesh joins faces only where exactly two meet; a strap that is sewn on makes edges of three.
    """
    edges, edge_of = np.unique(half_edges(faces), axis=0, return_inverse=True)
    face_of = np.repeat(np.arange(len(faces)), 3)
    ends = np.column_stack([face_of, len(faces) + edge_of.ravel()])
    return component_of(ends, len(faces) + len(edges))[: len(faces)]


def border_cycles(faces: Ids) -> list[Ids]:
    """Return the borders of a mesh, edges in one face only, as simple closed cycles; where they touch they are taken apart."""
    edges = half_edges(faces)
    border = edges[trimesh.grouping.group_rows(edges, require_count=1)]
    border = border[np.lexsort(border.T[::-1])]
    # The edges that no walk has used, by vertex.
    unused: dict[int, list[int]] = {}
    for a, b in border.tolist():
        unused.setdefault(a, []).append(b)
        unused.setdefault(b, []).append(a)
    cycles = []
    for start in unused:
        walk = [start]
        while unused[walk[-1]]:
            before = walk[-1]
            after = unused[before].pop()
            unused[after].remove(before)
            walk.append(after)
        closed, _ = _split(walk)
        cycles += closed
    return [np.array(cycle, dtype=np.int64) for cycle in cycles]


def of_three_vertices(faces: Ids) -> Ids:
    """Return the faces that name three different vertices."""
    return faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]


def once_each(faces: Ids) -> Ids:
    """Return the faces in their order, without those that lie on an earlier one."""
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return faces[np.sort(first)]


def weighted(vertices: Array, edges: Ids) -> csr_matrix:
    """Return the graph of edges (E, 2) between vertices (N, 3), weighted by length."""
    return csr_matrix((edge_lengths(vertices, edges), edges.T), shape=(len(vertices),) * 2)


class EdgeGraph:
    """The vertices (N, 3) and the edges (E, 2) of a mesh, weighted by length."""

    def __init__(self, vertices: Array, edges: Ids) -> None:
        self._graph = weighted(vertices, edges)

    def distances(self, ids: Ids) -> Array:
        """Return (k, k) the lengths of the shortest paths between vertices."""
        one_way = dijkstra(self._graph, directed=False, indices=ids)[:, ids]
        return np.asarray(np.minimum(one_way, one_way.T))  # there and back differ by rounding

    def path(self, start: int, end: int) -> list[int]:
        """Return the shortest path: a single edge where there is one."""
        if self._graph[min(start, end), max(start, end)]:
            return [start, end]
        _, before = dijkstra(self._graph, directed=False, indices=start, return_predecessors=True)
        path = [end]
        while path[-1] != start:
            path.append(int(before[path[-1]]))
        return path[::-1]

    def around(self, ids: Sequence[int]) -> list[list[int]]:
        """Return the shortest paths from each vertex of a closed cycle to the next."""
        return [self.path(a, b) for a, b in zip(ids, [*ids[1:], ids[0]], strict=True)]

    def loops(self, n: int) -> list[Ids]:
        """Return the n longest-lived loops of the mesh, or fewer where the rest is noise.

        They are those of the persistence of distances along the mesh that live as long as they take to be born.
        """
        everything = np.arange(self._graph.shape[0])
        diagram = rips_persistence(self.distances(everything), metric="precomputed")
        significant = np.flatnonzero(diagram.death[:n] > 2 * diagram.birth[:n])
        return [np.array(self._along(diagram, i, everything)) for i in significant.tolist()]

    def _along(self, diagram: Diagram, i: int, members: Ids) -> list[int]:
        """Return a cycle along edges around loop i of a diagram of these vertices."""
        # Between birth and death there is a tighter cycle than the one at birth.
        end = min(diagram.death[i], 2 * diagram.birth[i])
        radius = (diagram.birth[i] + end) / 2
        tight = members[tighten(diagram, diagram.cycle(i), radius=radius)].tolist()
        return max(simple_cycles(_walk(self.around(tight))), key=len)

    def close(self, ids: Sequence[int], names: Ids) -> tuple[Ids, str]:
        """Make a simple closed cycle along edges of the vertices of a loop, in order or not; say in words what it took.

        Idea: for vertices in order, gaps of a few edges are closed by shortest paths. Without order (most neighbours far
        apart), or where the order runs into itself, the cycle is the one around the longest-lived loop of these vertices,
        with distances along the mesh: persistence again. `names` are the ids that messages give for the vertices.
        """
        given = [a for a, b in zip(ids, [*ids[1:], ids[0]], strict=True) if a != b]
        members = np.unique(given)
        if len(members) < 3:
            raise ValueError(f"it has {len(members)} different vertices; three at least make a loop")
        # In order: most neighbours are joined by an edge, and the others are not far apart.
        paths = self.around(given)
        gaps = sum(len(path) > 2 for path in paths)
        widest = max(paths, key=len)
        closed = _walk(paths)
        in_order = 2 * gaps <= len(paths) and len(widest) <= _GAP + 1
        if in_order and len(set(closed)) == len(closed):
            how = ""
            if gaps:
                how = f"{gaps} gaps between its vertices were closed along the mesh"
            return np.array(closed), how
        # Without order: persistence.
        diagram = rips_persistence(self.distances(members), metric="precomputed")
        if not len(diagram) or diagram.death[0] < 1.5 * diagram.birth[0]:
            ends = f"{names[widest[0]]} and {names[widest[-1]]}"
            raise ValueError(f"its vertices {ends} follow each other but are {len(widest) - 1} edges apart")
        closed = self._along(diagram, 0, members)
        cycle = f"the cycle they lie around, {len(closed)} vertices, {len(set(closed) & set(given))} of them its own"
        how = f"its {len(members)} vertices are in no order along the mesh; {cycle}, was found by persistence"
        return np.array(closed), how


def _walk(paths: Sequence[Sequence[int]]) -> list[int]:
    """Join paths, each of which begins where the one before ends, to a closed walk."""
    return [vertex for path in paths for vertex in path[:-1]]


def simple_cycles(walk: Sequence[int]) -> list[list[int]]:
    """Cut a closed walk where it returns to a vertex; what goes there and back over a bridge falls away."""
    parts, path = _split(walk)
    return [part for part in [*parts, path] if len(part) > 2]


def _split(walk: Sequence[int]) -> tuple[list[list[int]], list[int]]:
    """Return the simple cycles that a walk closes, in their order, and the path that is left."""
    parts: list[list[int]] = []
    path: list[int] = []
    for vertex in walk:
        if vertex in path:
            start = path.index(vertex)
            parts.append(path[start:])
            path = path[:start]
        path.append(vertex)
    return parts, path


def check_mesh(vertices: Array, faces: Ids) -> None:
    """Raise ValueError when a mesh would make the physics engine fail or hang."""
    repeats = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    if repeats.any():
        raise ValueError(f"faces[{np.argmax(repeats)}] names a vertex twice: {faces[np.argmax(repeats)].tolist()}")
    unused = np.setdiff1d(np.arange(len(vertices)), faces)
    if len(unused):
        raise ValueError(f"{len(unused)} vertices are in no face, the first is vertex {unused[0]}; remove them")
    edges = np.unique(half_edges(faces), axis=0)
    count = components(faces).max() + 1
    if count > 1:  # PyBullet never returns from loading one that hangs together by a vertex
        raise ValueError(f"the mesh has {count} components that no edge joins; weld or keep one of them")
    length = edge_lengths(vertices, edges)
    if length.min() <= 0:
        raise ValueError(f"edge {edges[np.argmin(length)].tolist()} has length 0; weld its two vertices")


def check_loop(loop: Ids, edges: Ids, name: str) -> None:
    """Raise ValueError unless a loop is a simple closed cycle along edges (E, 2)."""
    if loop.ndim != 1 or len(loop) < 3:
        raise ValueError(f"{name} must be a cycle of at least 3 vertex ids, not of shape {loop.shape}")
    if len(np.unique(loop)) != len(loop):
        raise ValueError(f"{name} passes through a vertex twice")
    apart = not_joined(loop, edges)
    if apart:
        a, b = apart[0]
        raise ValueError(f"{name} is not a closed cycle of the mesh: no edge joins vertices {a} and {b}")
