"""Triangle meshes as surfaces: their edges, their winding, their borders, and closed cycles along their edges."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

from topokit.rips import Diagram, rips_persistence, tighten

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
_GAP = 4  # edges: as far as a hole in a loop is closed without asking


def half_edges(faces: Ids) -> Ids:
    """(3F, 2) the three edges of every face, smaller id first."""
    return np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)


def edge_lengths(vertices: Array, edges: Ids) -> Array:
    """(E,) lengths of edges (E, 2) between vertices (N, 3)."""
    return np.asarray(np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1))


def face_areas(vertices: Array, faces: Ids) -> Array:
    """(F,) areas of faces (F, 3)."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)


def wind(faces: Ids) -> tuple[Ids, int, bool]:
    """Turn faces so that neighbours run through their common edge in opposite directions.

    Idea: every face stands twice in a graph, as it is and turned round; a face as it is joins its neighbour as it is when
    the two agree, and turned round when not. Of the two halves of the graph the one that turns fewer faces is taken. A
    surface with one side has one half. Returned are the faces, how many were turned, and whether all neighbours agree now.
    """
    n = len(faces)
    directed = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    _, which, count = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(which.ravel(), kind="stable")
    order = order[count[which.ravel()[order]] == 2]  # where three faces meet there is no agreeing
    one, other = order[::2], order[1::2]
    agree = directed[one, 0] != directed[other, 0]
    f, g = one // 3, other // 3
    ends = np.concatenate([np.column_stack([f, g + n * ~agree]), np.column_stack([f + n, g + n * agree])])
    label = joined(ends, 2 * n).reshape(2, n)
    as_it_is = np.bincount(label[0], minlength=label.max() + 1)  # faces of each half that stay
    one, other = as_it_is[label[0]], as_it_is[label[1]]
    turn = (one < other) | ((one == other) & (label[0] > label[1]))
    return np.where(turn[:, None], faces[:, ::-1], faces), int(turn.sum()), not (label[0] == label[1]).any()


def strangers(cycle: Ids, edges: Ids) -> list[tuple[int, int]]:
    """The pairs of vertices that follow each other in a closed cycle and are not joined by an edge (E, 2)."""
    known = set(map(tuple, edges.tolist()))
    pairs = zip(cycle.tolist(), np.roll(cycle, -1).tolist(), strict=True)
    return [(a, b) for a, b in pairs if (min(a, b), max(a, b)) not in known]


def joined(pairs: Ids, n: int) -> Ids:
    """(n,) the number of each vertex's component in the graph of these edges (E, 2)."""
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def components(faces: Ids) -> Ids:
    """(F,) the number of each face's component. Faces are joined by an edge, not by a vertex that they touch at."""
    edges, edge = np.unique(half_edges(faces), axis=0, return_inverse=True)
    ends = np.column_stack([np.repeat(np.arange(len(faces)), 3), len(faces) + edge.ravel()])
    return joined(ends, len(faces) + len(edges))[: len(faces)]


def border_cycles(faces: Ids) -> list[Ids]:
    """The borders of a mesh, edges in one face only, as simple closed cycles; where they touch they are taken apart."""
    edges, count = np.unique(half_edges(faces), axis=0, return_counts=True)
    rest: dict[int, list[int]] = {}
    for a, b in edges[count == 1].tolist():
        rest.setdefault(a, []).append(b)
        rest.setdefault(b, []).append(a)
    cycles = []
    for start in rest:
        walk = [start]
        while rest[walk[-1]]:
            walk.append(rest[walk[-1]].pop())
            rest[walk[-1]].remove(walk[-2])
        cycles += _split(walk)[0]
    return [np.array(cycle, dtype=np.int64) for cycle in cycles]


class EdgeGraph:
    """The vertices (N, 3) and the edges (E, 2) of a mesh, weighted by length."""

    def __init__(self, vertices: Array, edges: Ids) -> None:
        self._graph = csr_matrix((edge_lengths(vertices, edges), edges.T), shape=(len(vertices),) * 2)

    def distances(self, ids: Ids) -> Array:
        """(k, k) lengths of the shortest paths between vertices."""
        one_way = dijkstra(self._graph, directed=False, indices=ids)[:, ids]
        return np.asarray(np.minimum(one_way, one_way.T))  # there and back differ by rounding

    def path(self, start: int, end: int) -> list[int]:
        """The shortest path: a single edge where there is one."""
        if self._graph[min(start, end), max(start, end)]:
            return [start, end]
        _, before = dijkstra(self._graph, directed=False, indices=start, return_predecessors=True)
        path = [end]
        while path[-1] != start:
            path.append(int(before[path[-1]]))
        return path[::-1]

    def around(self, ids: Sequence[int]) -> list[list[int]]:
        return [self.path(a, b) for a, b in zip(ids, [*ids[1:], ids[0]], strict=True)]

    def loops(self, n: int) -> list[Ids]:
        """The n longest-lived loops of the mesh, or as many as are none of its noise, by persistence of distances along it."""
        every = np.arange(self._graph.shape[0])
        diagram = rips_persistence(self.distances(every), metric="precomputed")
        plain = diagram.death[:n] > 2 * diagram.birth[:n]
        return [np.array(self._along(diagram, i, every)) for i in np.flatnonzero(plain).tolist()]

    def _along(self, diagram: Diagram, i: int, members: Ids) -> list[int]:
        """A cycle along edges around loop i of a diagram of these vertices."""
        end = min(diagram.death[i], 2 * diagram.birth[i])  # halfway there is a tighter cycle than the one at birth
        tight = members[tighten(diagram, diagram.cycle(i), radius=(diagram.birth[i] + end) / 2)].tolist()
        return max(simple_cycles(_walk(self.around(tight))), key=len)

    def close(self, ids: Sequence[int], names: Ids) -> tuple[Ids, str]:
        """Make a simple closed cycle along edges of the vertices of a loop, in order or not; say in words what it took.

        Idea: in order, gaps of a few edges are closed by shortest paths. Without order (most neighbours far apart), or where the
        order runs into itself, the cycle is the one around the longest-lived loop of these vertices, with distances along the
        mesh: persistence again. `names` are what messages call the vertices.
        """
        given = [a for a, b in zip(ids, [*ids[1:], ids[0]], strict=True) if a != b]
        members = np.unique(given)
        if len(members) < 3:
            raise ValueError(f"it has {len(members)} different vertices; three at least make a loop")
        paths = self.around(given)
        gaps = sum(len(path) > 2 for path in paths)
        widest = max(paths, key=len)
        closed = _walk(paths)
        if 2 * gaps <= len(paths) and len(widest) <= _GAP + 1 and len(set(closed)) == len(closed):
            return np.array(closed), f"{gaps} gaps between its vertices were closed along the mesh" if gaps else ""
        diagram = rips_persistence(self.distances(members), metric="precomputed")
        if not len(diagram) or diagram.death[0] < 1.5 * diagram.birth[0]:
            ends = f"{names[widest[0]]} and {names[widest[-1]]}"
            raise ValueError(f"its vertices {ends} follow each other but are {len(widest) - 1} edges apart")
        closed = self._along(diagram, 0, members)
        cycle = f"the cycle they lie around, {len(closed)} vertices, {len(set(closed) & set(given))} of them its own"
        how = f"its {len(members)} vertices are in no order along the mesh; {cycle}, was found by persistence"
        return np.array(closed), how


def _walk(paths: Sequence[Sequence[int]]) -> list[int]:
    return [vertex for path in paths for vertex in path[:-1]]


def simple_cycles(walk: Sequence[int]) -> list[list[int]]:
    """Cut a closed walk where it returns to a vertex; what goes there and back over a bridge falls away."""
    parts, path = _split(walk)
    return [part for part in [*parts, path] if len(part) > 2]


def _split(walk: Sequence[int]) -> tuple[list[list[int]], list[int]]:
    """The simple cycles that a walk closes, in their order, and the path that is left."""
    parts: list[list[int]] = []
    path: list[int] = []
    for vertex in walk:
        if vertex in path:
            start = path.index(vertex)
            parts.append(path[start:])
            path = path[:start]
        path.append(vertex)
    return parts, path


def demand(holds: bool, otherwise: str) -> None:
    if not holds:
        raise ValueError(otherwise)


def check_mesh(vertices: Array, faces: Ids) -> None:
    repeats = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    if repeats.any():
        raise ValueError(f"faces[{np.argmax(repeats)}] names a vertex twice: {faces[np.argmax(repeats)].tolist()}")
    unused = np.setdiff1d(np.arange(len(vertices)), faces)
    if len(unused):
        raise ValueError(f"{len(unused)} vertices are in no face, the first is vertex {unused[0]}; remove them")
    edges = np.unique(half_edges(faces), axis=0)
    parts = components(faces).max() + 1
    if parts > 1:  # PyBullet never returns from loading one that hangs together by a vertex
        raise ValueError(f"the mesh has {parts} components that no edge joins; weld or keep one of them")
    length = edge_lengths(vertices, edges)
    if length.min() <= 0:
        raise ValueError(f"edge {edges[np.argmin(length)].tolist()} has length 0; weld its two vertices")


def check_loop(loop: Ids, edges: Ids, name: str) -> None:
    if loop.ndim != 1 or len(loop) < 3:
        raise ValueError(f"{name} must be a cycle of at least 3 vertex ids, not of shape {loop.shape}")
    if len(np.unique(loop)) != len(loop):
        raise ValueError(f"{name} passes through a vertex twice")
    apart = strangers(loop, edges)
    if apart:
        a, b = apart[0]
        raise ValueError(f"{name} is not a closed cycle of the mesh: no edge joins vertices {a} and {b}")
