"""Flat patterns of cloth: cut at a spacing, bent or inflated into space, sewn together.

Idea: the outline and the holes of a piece are sampled at the spacing, the inside is filled with a triangular lattice,
relaxed and triangulated. Two pieces sewn together share the vertices of their seam.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import laplacian
from scipy.sparse.linalg import spsolve
from scipy.spatial import Delaunay, cKDTree

from ._surface import Array, Ids, component_of, half_edges, is_cycle, wind


@dataclass(frozen=True)
class Panel:
    """A piece of cloth and the vertices along its borders, before it is sewn."""

    vertices: Array  # (n, 3)
    faces: Ids  # (f, 3)
    sides: tuple[Ids, ...]  # vertex ids along each polyline of the outline, both ends included
    holes: tuple[Ids, ...]  # vertex ids around each hole, once

    def mirrored(self) -> Panel:
        """Return the panel on the other side of the plane y = 0."""
        return replace(self, vertices=self.vertices * [1, -1, 1])

    def nearest(self, places: Array) -> Ids:
        """Return the vertices nearest to places (k, 2) of the pattern."""
        return np.asarray(cKDTree(self.vertices[:, [0, 2]]).query(places)[1], dtype=np.int64)


@dataclass(frozen=True)
class Arch:
    """A half-ellipse, on straight legs when it is long, over a straight edge: the middle line of a strap. Metres."""

    half_span: float
    height: float
    leg: float = 0.0

    @classmethod
    def of_length(cls, span: float, length: float, name: str = "strap_length") -> Arch:
        """Return the arch over `span` whose arc length is `length`."""
        from scipy.optimize import brentq  # a process that only records starts sooner without it

        fits = 0 < 1.3 * span < length
        demand(fits, f"{name} {length} is too short for a span of {span:.3f} between the middles of its ends")
        steepest = cls(span / 2, 1.25 * span)  # a higher ellipse would be too pointed for a strap of some width
        if length > steepest._polyline_length():
            return cls(span / 2, 1.25 * span, (length - steepest._polyline_length()) / 2)
        height = brentq(lambda h: cls(span / 2, h)._polyline_length() - length, 1e-6, length)
        return cls(span / 2, float(height))

    def _polyline_length(self) -> float:
        return float(np.linalg.norm(np.diff(self._dense(0.0), axis=0), axis=1).sum())

    def _dense(self, offset: float) -> Array:
        """Return (721, 2) points from the right end over the top to the left, moved outwards by `offset`; two more with legs."""
        angle = np.linspace(0, np.pi, 721)
        points = np.column_stack([self.half_span * np.cos(angle), self.height * np.sin(angle)])
        normal = np.column_stack([self.height * np.cos(angle), self.half_span * np.sin(angle)])
        curve = points + offset * normal / np.linalg.norm(normal, axis=1, keepdims=True)
        if not self.leg:
            return curve
        return np.vstack([curve[:1], curve + [0, self.leg], curve[-1:]])

    def points(self, share: ArrayLike, offset: float = 0.0) -> Array:
        """Return (k, 2) points at these shares of the arc length of the arch moved outwards by `offset`."""
        dense = self._dense(offset)
        return points_at(dense, np.asarray(share) * arc_length(dense)[-1])

    def strap(self, width: float, spacing: float, length: float) -> tuple[Array, list[Array], Array]:
        """Return a strap: its outer border (181, 2), the opening below (inner border and line back), its inner vertices."""
        narrowest = min(self.half_span**2 / self.height, self.height**2 / self.half_span)  # radius of curvature
        demand(width / 2 < narrowest, f"a strap of length {length} must be less wide than {2 * narrowest:.3f}: {width}")
        share = np.linspace(0, 1, 181)
        outer = self.points(share, width / 2)
        inner = self.points(share, -width / 2)
        opening = [inner, *polyline(inner[-1], inner[0])]
        if width < 1.4 * spacing:  # too narrow for a row between its borders
            return outer, opening, np.zeros((0, 2))
        count = max(2, round(length / spacing))
        return outer, opening, self.points((np.arange(count) + 0.5) / count)


def demand(holds: bool, otherwise: str) -> None:
    """Raise ValueError with these words unless a condition holds."""
    if not holds:
        raise ValueError(otherwise)


def polyline(*corners: Sequence[float] | Array) -> list[Array]:
    """Return the segments between consecutive corners."""
    return [np.array([a, b], dtype=np.float64) for a, b in itertools.pairwise(corners)]


def circle(x: float, z: float, radius: float) -> list[Array]:
    """Return the border of a round hole about (x, z)."""
    angle = np.linspace(0, 2 * np.pi, 361)
    return [np.column_stack([x + radius * np.cos(angle), z + radius * np.sin(angle)])]


def mirror(line: Array) -> Array:
    """Return a line on the other side of x = 0, run through backwards."""
    return (line * [-1, 1])[::-1]


def chain(*ids: Ids) -> Ids:
    """Return the ids along consecutive sides, each joint once."""
    return np.concatenate([ids[0], *(side[1:] for side in ids[1:])])


def ring(one: Ids, other: Ids) -> Ids:
    """Return the cycle of two paths between the same ends."""
    return np.concatenate([one[:-1], other[:0:-1]])


def cut(
    outline: Sequence[Array], holes: Sequence[Sequence[Array]], spacing: float, fixed: Sequence[Array] = ()
) -> Panel:
    """Cut a pattern drawn in (x, z) out of the plane y = 0; `fixed` are inner vertices, each (k, 2), to keep where they are.

    Outline and holes are closed chains of polylines, counter-clockwise, whose joints stay vertices.
    """
    # Vertices: the borders at the spacing, those that are fixed, and a lattice inside that keeps clear of both.
    lines = [[_resample(line, spacing) for line in border] for border in (outline, *holes)]
    borders = [np.concatenate(parts) for parts in lines]
    kept = np.concatenate([*borders, *fixed])
    lattice = _lattice(borders[0].min(axis=0), borders[0].max(axis=0), spacing)
    lattice = lattice[_inside(lattice, borders) & (cKDTree(kept).query(lattice)[0] > 0.75 * spacing)]
    points = np.concatenate([kept, lattice])
    # Laplacian relaxation: each vertex of the lattice goes to the mean of its neighbours.
    for _ in range(12):
        edges = half_edges(_faces(points, borders, spacing))
        ends = np.concatenate([edges, edges[:, ::-1]])
        count = np.bincount(ends[:, 0], minlength=len(points))[:, None]
        mean = np.column_stack([np.bincount(ends[:, 0], points[ends[:, 1], i], len(points)) for i in range(2)]) / count
        points[len(kept) :] = mean[len(kept) :]
    faces = _faces(points, borders, spacing)
    # At a coarse spacing Delaunay triangles can cut across a border.
    around, *rims = (np.arange(a, b) for a, b in itertools.pairwise(np.cumsum([0, *map(len, borders)])))
    edges = half_edges(faces)
    demand(all(is_cycle(ids, edges) for ids in (around, *rims)), f"spacing {spacing} is too coarse: a border is lost")
    # Each polyline of the outline has its own share of the vertices around it.
    around = np.append(around, 0)
    sides = tuple(around[a : b + 1] for a, b in itertools.pairwise(np.cumsum([0, *map(len, lines[0])])))
    vertices = np.column_stack([points[:, 0], np.zeros(len(points)), points[:, 1]])
    return Panel(vertices, faces, sides, tuple(rims))


def band(lengths: Sequence[float], widths: Sequence[float], spacing: float) -> tuple[Panel, Ids, Ids, Ids, Ids]:
    """Return a straight strip in x from 0 to its length and in z from minus its width to 0, with joints after these.

    Returned are also the ids along its borders: low and high (z = 0) with x growing, start (x = 0) and end with z growing.
    """
    x = np.cumsum([0.0, *lengths])
    z = np.cumsum([-sum(widths), *widths])
    z[-1] = 0.0
    # The outline runs along the low border, up the end, back along the high border, and down the start.
    corners = [(x0, z[0]) for x0 in x] + [(x[-1], z0) for z0 in z[1:]] + [(x0, 0) for x0 in x[-2::-1]]
    panel = cut(polyline(*corners, *((0, z0) for z0 in z[-2::-1])), [], spacing)
    joints = itertools.pairwise(np.cumsum([0, *(len(lengths), len(widths)) * 2]))
    low, end, high, start = (chain(*panel.sides[a:b]) for a, b in joints)
    return panel, low, high[::-1], start[::-1], end


def inflate(panel: Panel, seams: Sequence[int], depth: float, top: float = np.inf) -> Panel:
    """Blow a flat panel up towards -y by `depth`, with the sides of these numbers kept in the plane.

    The height is the square root of a membrane's under even pressure (on all below z = `top`): an ellipse across a tube.
    """
    seam = np.unique(np.concatenate([panel.sides[i] for i in seams]))
    panel = _without_chords(panel, seam)
    # Solve the graph Laplacian of the panel for even pressure, with height 0 along the seam.
    edges = np.unique(half_edges(panel.faces), axis=0)
    n = len(panel.vertices)
    graph = coo_matrix((np.ones(len(edges)), edges.T), shape=(n, n)).tocsr()
    matrix = laplacian(graph + graph.T).tocsr()
    free = np.setdiff1d(np.arange(n), seam)
    pressure = (panel.vertices[:, 2] <= top).astype(float)
    height = np.zeros(n)
    height[free] = spsolve(matrix[free][:, free], pressure[free])
    height = depth * np.sqrt(height / height.max())
    return replace(panel, vertices=panel.vertices - height[:, None] * [0, 1, 0])


def _without_chords(panel: Panel, seam: Ids) -> Panel:
    """Halve the inner edges between two vertices of the seam, which the panel on its other side would have as well."""
    vertices = panel.vertices
    faces = panel.faces
    while True:
        edges, count = np.unique(half_edges(faces), axis=0, return_counts=True)
        chords = edges[(count == 2) & np.isin(edges, seam).all(axis=1)]
        if not len(chords):
            return replace(panel, vertices=vertices, faces=faces)
        a, b = chords[0]
        beside = np.isin(faces, [a, b]).sum(axis=1) == 2
        halves = [np.where(faces[beside] == end, len(vertices), faces[beside]) for end in (a, b)]
        faces = np.concatenate([faces[~beside], *halves])
        vertices = np.vstack([vertices, (vertices[a] + vertices[b]) / 2])


def sew(panels: Sequence[Panel], seams: Sequence[tuple[int, Ids, int, Ids]]) -> tuple[Array, Ids, list[Ids]]:
    """Sew panels; return vertices (n, 3), faces (f, 3) and the new ids by panel. A seam is (panel, ids, other panel, its ids)."""
    # Vertices that a seam joins are one component of a graph, of which the first vertex stays.
    first = np.cumsum([0, *(len(panel.vertices) for panel in panels)])
    pairs = np.concatenate([np.column_stack([first[i] + a, first[j] + b]) for i, a, j, b in seams])
    component = component_of(pairs, first[-1])
    _, first_of_each, new = np.unique(component, return_index=True, return_inverse=True)
    vertices = np.concatenate([panel.vertices for panel in panels])[first_of_each]
    maps = [new[a:b] for a, b in itertools.pairwise(first)]
    faces = np.concatenate([ids[panel.faces] for ids, panel in zip(maps, panels, strict=True)])
    return vertices, wind(faces), maps


def _faces(points: Array, borders: Sequence[Array], spacing: float) -> Ids:
    """Return the Delaunay triangles inside the pattern, counter-clockwise, without the slivers along straight borders."""
    faces = Delaunay(points).simplices.astype(np.int64)
    a, b, c = points[faces].transpose(1, 0, 2)
    area = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    faces = np.where(area[:, None] < 0, faces[:, ::-1], faces)
    return faces[(np.abs(area) > 1e-3 * spacing**2) & _inside((a + b + c) / 3, borders)]


def arc_length(line: Array) -> Array:
    """Return (k,) the arc length at each point of a polyline (k, d)."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])


def points_at(line: Array, at: Array) -> Array:
    """Return (n, 2) points of a polyline (k, 2) at arc lengths (n,)."""
    length = arc_length(line)
    return np.column_stack([np.interp(at, length, line[:, i]) for i in range(2)])


def _resample(line: Array, spacing: float) -> Array:
    """Return points at equal arc lengths of about `spacing` along a polyline, without its last point."""
    length = float(arc_length(line)[-1])
    count = max(1, round(length / spacing))
    return points_at(line, length * np.arange(count) / count)


def _lattice(low: Array, high: Array, spacing: float) -> Array:
    """Return the points (n, 2) of a triangular lattice in a box, symmetric about x = 0."""
    row = spacing * np.sqrt(3) / 2
    half = int(np.ceil(max(-low[0], high[0]) / spacing)) + 1
    across = spacing * np.arange(-half, half + 1)
    heights = np.arange(low[1] + row, high[1], row)
    return np.array([(x + spacing / 2 * (i % 2), z) for i, z in enumerate(heights) for x in across]).reshape(-1, 2)


def _inside(points: Array, borders: Sequence[Array]) -> NDArray[np.bool_]:
    """Return whether points (n, 2) are inside the outline and in none of the holes, by the even-odd rule."""
    x = points[:, :1]
    y = points[:, 1:]
    crossings = np.zeros(len(points), dtype=np.int64)
    for border in borders:
        # Count the edges of the border that a ray from each point towards +x crosses.
        x0, y0 = border.T
        x1, y1 = np.roll(border, -1, axis=0).T
        spans = (y0 > y) != (y1 > y)
        rise = np.where(y1 == y0, 1.0, y1 - y0)
        crossings += (spans & (x < x0 + (y - y0) / rise * (x1 - x0))).sum(axis=1)
    return crossings % 2 == 1
