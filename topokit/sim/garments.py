"""Garments: triangle meshes that know their true loops and where to be held.

A garment is cut from flat patterns: an outline and its holes are sampled at the spacing, the inside is filled with a
triangular lattice, relaxed and triangulated. Triangles are near-equilateral, so that a mass-spring cloth behaves alike in
every direction, and the border of a hole keeps its order: it is the true loop.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay, cKDTree

from topokit._validate import as_points, positive

__all__ = ["Garment"]

Array = NDArray[np.float64]
Ids = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Garment:
    """A triangle mesh with its true loops and the two vertices by which grippers hold it.

    Everything that makes a physics engine fail or hang is refused here: vertices in no face, several components, edges
    of three faces, faces that name a vertex twice.

    Attributes
    ----------
    name : str
    vertices : (N, 3) float64
        Rest positions in metres, z up; rest lengths of the springs are taken from them.
    faces : (F, 3) int64
        Vertex ids, counted from 0.
    loops : tuple of (L,) int64
        The true loops: each a closed cycle of vertex ids along edges of the mesh (the last joins the first).
    grips : (2,) int64
        The two vertices that the grippers hold.
    parameters : mapping of str to float
        The sizes it was made from, kept with every episode.

    Raises
    ------
    ValueError
        When the mesh, a loop or a grip is not as described; the message names the vertex, edge or face.

    Examples
    --------
    >>> apron = Garment.apron()
    >>> len(apron.loops), len(apron.vertices) >= 520
    (1, True)
    """

    name: str
    vertices: Array
    faces: Ids
    loops: tuple[Ids, ...]
    grips: Ids
    parameters: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        vertices = as_points(self.vertices, "vertices")
        if vertices.shape[1] != 3:
            raise ValueError(f"vertices must be an (N, 3) array, not of shape {vertices.shape}")
        faces = _as_ids(self.faces, "faces", len(vertices))
        if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
            raise ValueError(
                f"faces must be an (F, 3) array of vertex ids with at least one row, not of shape {faces.shape}"
            )
        grips = _as_ids(self.grips, "grips", len(vertices))
        if grips.shape != (2,) or grips[0] == grips[1]:
            raise ValueError(f"grips must be two different vertex ids, not {grips.tolist()}")
        loops = tuple(_as_ids(loop, f"loops[{i}]", len(vertices)) for i, loop in enumerate(self.loops))
        values = {
            "vertices": vertices.copy(),
            "faces": faces,
            "grips": grips,
            "loops": loops,
            "parameters": dict(self.parameters),
        }
        for key, value in values.items():
            object.__setattr__(self, key, value)
        for array in (self.vertices, self.faces, self.grips, *self.loops):
            array.setflags(write=False)
        _check_mesh(vertices, faces)
        for i, loop in enumerate(loops):
            _check_loop(loop, self.edges, f"loops[{i}]")

    @property
    def edges(self) -> Ids:
        """(E, 2) every edge once, smaller id first, in lexicographic order."""
        return np.unique(_half_edges(self.faces), axis=0)

    @property
    def edge_lengths(self) -> Array:
        """(E,) rest lengths in metres, in the order of `edges`."""
        ends = self.vertices[self.edges]
        return np.asarray(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1))

    @classmethod
    def apron(
        cls,
        *,
        spacing: float = 0.03,
        body_width: float = 0.56,
        body_height: float = 0.46,
        bib_width: float = 0.28,
        bib_height: float = 0.30,
        strap_length: float = 0.62,
        strap_width: float = 0.052,
    ) -> Garment:
        """Return an apron with one loop, its neck strap; all sizes in metres.

        The apron hangs in the plane y = 0 with the top of its bib at z = 0. The strap is three vertices wide at the
        default spacing and runs from one top corner of the bib to the other; the true loop is the border of the neck
        opening. The grips are on the strap, at a third of its length from either end.

        Raises
        ------
        ValueError
            When a size is not positive, the bib is wider than the body, or the strap is too short or too wide to leave
            an opening.
        """
        sizes = {
            "spacing": spacing,
            "body_width": body_width,
            "body_height": body_height,
            "bib_width": bib_width,
            "bib_height": bib_height,
            "strap_length": strap_length,
            "strap_width": strap_width,
        }
        sizes = {name: positive(value, name, zero=False) for name, value in sizes.items()}
        if sizes["bib_width"] > sizes["body_width"]:
            raise ValueError(f"bib_width {bib_width} must not exceed body_width {body_width}")
        if sizes["bib_width"] < 2 * sizes["strap_width"] + 3 * sizes["spacing"]:
            raise ValueError(f"bib_width {bib_width} leaves no opening between straps of strap_width {strap_width}")
        arch = _Arch.of_length(sizes["bib_width"] - sizes["strap_width"], sizes["strap_length"])
        outline, opening, middle = _apron_pattern(sizes, arch)
        flat, faces, (_, loop) = _mesh_pattern(outline, [opening], sizes["spacing"], middle)
        vertices = np.column_stack([flat[:, 0], np.zeros(len(flat)), flat[:, 1]])
        held = arch.points(np.array([1 / 3, 2 / 3]))
        grips = cKDTree(flat).query(held)[1]
        return cls("apron", vertices, faces, (loop,), grips, sizes)


@dataclass(frozen=True)
class _Arch:
    """A half-ellipse over the bib, the middle line of the neck strap: half its span and its height, in metres."""

    half_span: float
    height: float

    @classmethod
    def of_length(cls, span: float, length: float) -> _Arch:
        """Return the arch over `span` whose arc length is `length`."""
        if span <= 0 or length <= 1.3 * span:
            raise ValueError(
                f"strap_length {length} is too short for a span of {span:.3f} between the middles of its ends"
            )
        height = brentq(lambda h: cls(span / 2, h)._polyline_length() - length, 1e-6, length)
        return cls(span / 2, float(height))

    def _polyline_length(self) -> float:
        return float(np.linalg.norm(np.diff(self._dense(0.0), axis=0), axis=1).sum())

    def _dense(self, offset: float) -> Array:
        """(721, 2) points from the right end over the top to the left end, moved outwards by `offset`."""
        angle = np.linspace(0, np.pi, 721)
        points = np.column_stack([self.half_span * np.cos(angle), self.height * np.sin(angle)])
        normal = np.column_stack([self.height * np.cos(angle), self.half_span * np.sin(angle)])
        return points + offset * normal / np.linalg.norm(normal, axis=1, keepdims=True)

    def points(self, share: Array, offset: float = 0.0) -> Array:
        """(k, 2) points at these shares of the arc length of the arch moved outwards by `offset`."""
        dense = self._dense(offset)
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(dense, axis=0), axis=1))])
        return np.column_stack([np.interp(share * length[-1], length, dense[:, i]) for i in range(2)])


def _apron_pattern(sizes: Mapping[str, float], arch: _Arch) -> tuple[list[Array], list[Array], Array]:
    """Return the outline and the neck opening as lists of polylines (x, z), and the points of the strap's middle line."""
    half_body, half_bib, width = sizes["body_width"] / 2, sizes["bib_width"] / 2, sizes["strap_width"]
    waist, hem = -sizes["bib_height"], -sizes["bib_height"] - sizes["body_height"]
    share = np.linspace(0, 1, 181)
    # The armhole leaves the bib vertically and reaches the waist horizontally: a quarter of an ellipse.
    angle = np.pi / 2 * share
    right = np.column_stack([half_body - (half_body - half_bib) * np.sin(angle), waist * np.cos(angle)])
    left = (right * [-1, 1])[::-1]
    outer, inner = arch.points(share, width / 2), arch.points(share, -width / 2)
    hem_right, hem_left = np.array([half_body, hem]), np.array([-half_body, hem])
    sides = [
        np.array([hem_right, right[0]]),
        right,
        outer,
        left,
        np.array([left[-1], hem_left]),
        np.array([hem_left, hem_right]),
    ]
    opening = [inner, np.array([inner[-1], inner[0]])]
    if width < 1.4 * sizes["spacing"]:  # too narrow for a row between its borders
        return sides, opening, np.zeros((0, 2))
    count = max(2, round(sizes["strap_length"] / sizes["spacing"]))
    return sides, opening, arch.points((np.arange(count) + 0.5) / count)


def _mesh_pattern(
    outline: Sequence[Array], holes: Sequence[Sequence[Array]], spacing: float, fixed: Array, rounds: int = 12
) -> tuple[Array, Ids, list[Ids]]:
    """Triangulate a flat pattern; return its vertices (n, 2), faces (f, 3) and borders (ids of the outline and of each hole).

    `outline` and `holes` are closed chains of polylines; the joints between polylines stay vertices. `fixed` are inner
    vertices to keep where they are.
    """
    borders = [np.concatenate([_resample(line, spacing) for line in chain]) for chain in (outline, *holes)]
    kept = np.concatenate([*borders, fixed])
    lattice = _lattice(borders[0].min(axis=0), borders[0].max(axis=0), spacing)
    lattice = lattice[_inside(lattice, borders) & (cKDTree(kept).query(lattice)[0] > 0.75 * spacing)]
    points = np.concatenate([kept, lattice])
    for _ in range(rounds):  # Laplacian relaxation of the lattice towards the border
        faces = _triangulate(points, borders, spacing)
        ends = np.concatenate([_half_edges(faces), _half_edges(faces)[:, ::-1]])
        count = np.bincount(ends[:, 0], minlength=len(points))[:, None]
        mean = np.column_stack([np.bincount(ends[:, 0], points[ends[:, 1], i], len(points)) for i in range(2)]) / count
        points[len(kept) :] = mean[len(kept) :]
    first = np.cumsum([0, *map(len, borders)])
    ids = [np.arange(start, end) for start, end in itertools.pairwise(first)]
    return points, _triangulate(points, borders, spacing), ids


def _triangulate(points: Array, borders: Sequence[Array], spacing: float) -> Ids:
    """Delaunay triangles inside the pattern, counter-clockwise, without the slivers along straight borders."""
    faces = Delaunay(points).simplices.astype(np.int64)
    a, b, c = points[faces].transpose(1, 0, 2)
    area = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    faces = np.where(area[:, None] < 0, faces[:, ::-1], faces)
    return faces[(np.abs(area) > 1e-3 * spacing**2) & _inside((a + b + c) / 3, borders)]


def _resample(line: Array, spacing: float) -> Array:
    """Points at equal arc lengths of about `spacing` along a polyline, without its last point."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    count = max(1, round(length[-1] / spacing))
    at = length[-1] * np.arange(count) / count
    return np.column_stack([np.interp(at, length, line[:, i]) for i in range(2)])


def _lattice(low: Array, high: Array, spacing: float) -> Array:
    """Triangular lattice over a box, symmetric in x about 0."""
    row = spacing * np.sqrt(3) / 2
    half = int(np.ceil(max(-low[0], high[0]) / spacing)) + 1
    across = spacing * np.arange(-half, half + 1)
    heights = np.arange(low[1] + row, high[1], row)
    return np.array([(x + spacing / 2 * (i % 2), z) for i, z in enumerate(heights) for x in across])


def _inside(points: Array, borders: Sequence[Array]) -> NDArray[np.bool_]:
    """Even-odd rule over all borders: inside the outline and in none of the holes."""
    x, y = points[:, :1], points[:, 1:]
    crossings = np.zeros(len(points), dtype=np.int64)
    for border in borders:
        (x0, y0), (x1, y1) = border.T, np.roll(border, -1, axis=0).T
        spans = (y0 > y) != (y1 > y)
        rise = np.where(y1 == y0, 1.0, y1 - y0)
        crossings += (spans & (x < x0 + (y - y0) / rise * (x1 - x0))).sum(axis=1)
    return crossings % 2 == 1


def _half_edges(faces: Ids) -> Ids:
    """(3F, 2) the three edges of every face, smaller id first."""
    return np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)


def _as_ids(values: object, name: str, n_vertices: int) -> Ids:
    ids = np.asarray(values)
    if not np.issubdtype(ids.dtype, np.integer):
        raise TypeError(f"{name} must hold whole numbers (vertex ids), not {ids.dtype}")
    if ids.size and (ids.min() < 0 or ids.max() >= n_vertices):
        bad = int(ids.min()) if ids.min() < 0 else int(ids.max())
        raise ValueError(f"{name} names vertex {bad}; there are {n_vertices}, numbered from 0")
    return ids.astype(np.int64)


def _check_mesh(vertices: Array, faces: Ids) -> None:
    """Raise ValueError unless the faces make one manifold component that uses every vertex."""
    repeats = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    if repeats.any():
        raise ValueError(f"faces[{np.argmax(repeats)}] names a vertex twice: {faces[np.argmax(repeats)].tolist()}")
    unused = np.setdiff1d(np.arange(len(vertices)), faces)
    if len(unused):
        raise ValueError(f"{len(unused)} vertices are in no face, the first is vertex {unused[0]}; remove them")
    edges, count = np.unique(_half_edges(faces), axis=0, return_counts=True)
    if count.max() > 2:
        worst = int(np.argmax(count))
        raise ValueError(
            f"edge {edges[worst].tolist()} is in {count[worst]} faces; a cloth has at most two on each side of an edge"
        )
    graph = coo_matrix((np.ones(len(edges)), edges.T), shape=(len(vertices),) * 2)
    parts = connected_components(graph, directed=False)[0]
    if parts > 1:
        raise ValueError(f"the mesh has {parts} components; weld or keep one of them")
    length = np.linalg.norm(np.diff(vertices[edges], axis=1)[:, 0], axis=1)
    if length.min() <= 0:
        raise ValueError(f"edge {edges[np.argmin(length)].tolist()} has length 0; weld its two vertices")


def _check_loop(loop: Ids, edges: Ids, name: str) -> None:
    """Raise ValueError unless `loop` is a simple closed cycle along edges."""
    if loop.ndim != 1 or len(loop) < 3:
        raise ValueError(f"{name} must be a cycle of at least 3 vertex ids, not of shape {loop.shape}")
    if len(np.unique(loop)) != len(loop):
        raise ValueError(f"{name} passes through a vertex twice")
    known = set(map(tuple, edges.tolist()))
    for a, b in zip(loop.tolist(), np.roll(loop, -1).tolist(), strict=True):
        if (min(a, b), max(a, b)) not in known:
            raise ValueError(
                f"{name} is not a closed cycle of the mesh: vertices {a} and {b} follow each other but share no edge"
            )
