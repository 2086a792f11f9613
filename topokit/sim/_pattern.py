"""Flat patterns of cloth: cut at a spacing, bent or inflated into space, sewn together.

Idea: the outline and the holes of a piece are sampled at the spacing, the inside is filled with a triangular lattice,
relaxed and triangulated. Two pieces sewn together share the vertices of their seam.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import spsolve
from scipy.spatial import cKDTree

from ._surface import half_edges, joined, strangers, wind
from ._triangulate import arc_length, count_steps, points_at, triangulate

Array = NDArray[np.float64]
Ids = NDArray[np.int64]


@dataclass(frozen=True)
class Panel:
    """A piece of cloth and the vertices along its borders, before it is sewn.

    Attributes
    ----------
    vertices : (n, 3) float64
    faces : (f, 3) int64
    sides : tuple of (k,) int64
        Vertex ids along each polyline of the outline, both ends included.
    holes : tuple of (k,) int64
        Vertex ids around each hole, once.
    """

    vertices: Array
    faces: Ids
    sides: tuple[Ids, ...]
    holes: tuple[Ids, ...]

    def placed(self, place: Callable[[Array], Array]) -> Panel:
        """The panel with its vertices moved by `place`, (n, 3) to (n, 3)."""
        return replace(self, vertices=place(self.vertices))

    def mirrored(self) -> Panel:
        """The panel on the other side of the plane y = 0."""
        return replace(self, vertices=self.vertices * [1, -1, 1])

    def nearest(self, places: Array) -> Ids:
        """The vertices nearest to places (k, 2) of the pattern."""
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
        if span <= 0 or length <= 1.3 * span:
            raise ValueError(f"{name} {length} is too short for a span of {span:.3f} between the middles of its ends")
        steepest = cls(span / 2, 1.25 * span)  # a higher ellipse would be too pointed for a strap of some width
        if length > steepest._polyline_length():
            return cls(span / 2, 1.25 * span, (length - steepest._polyline_length()) / 2)
        height = brentq(lambda h: cls(span / 2, h)._polyline_length() - length, 1e-6, length)
        return cls(span / 2, float(height))

    def _polyline_length(self) -> float:
        return float(np.linalg.norm(np.diff(self._dense(0.0), axis=0), axis=1).sum())

    def _dense(self, offset: float) -> Array:
        """(721, 2) points from the right end over the top to the left end, moved outwards by `offset`; two more with legs."""
        angle = np.linspace(0, np.pi, 721)
        points = np.column_stack([self.half_span * np.cos(angle), self.height * np.sin(angle)])
        normal = np.column_stack([self.height * np.cos(angle), self.half_span * np.sin(angle)])
        curve = points + offset * normal / np.linalg.norm(normal, axis=1, keepdims=True)
        if not self.leg:
            return curve
        return np.vstack([curve[:1], curve + [0, self.leg], curve[-1:]])

    def points(self, share: Array, offset: float = 0.0) -> Array:
        """(k, 2) points at these shares of the arc length of the arch moved outwards by `offset`."""
        dense = self._dense(offset)
        return points_at(dense, share * arc_length(dense)[-1])

    def strap(self, width: float, spacing: float, length: float) -> tuple[Array, list[Array], Array]:
        """Outer border (181, 2), the opening below (its inner border and the way back) and inner vertices of a strap."""
        narrowest = min(self.half_span**2 / self.height, self.height**2 / self.half_span)  # radius of curvature
        if width / 2 >= narrowest:
            raise ValueError(
                f"a strap of width {width} is too wide to bend over a span of {2 * self.half_span:.3f} at a length of {length}; "
                f"its width must be less than {2 * narrowest:.3f}"
            )
        share = np.linspace(0, 1, 181)
        outer, inner = self.points(share, width / 2), self.points(share, -width / 2)
        opening = [inner, *polyline(inner[-1], inner[0])]
        if width < 1.4 * spacing:  # too narrow for a row between its borders
            return outer, opening, np.zeros((0, 2))
        count = max(2, round(length / spacing))
        return outer, opening, self.points((np.arange(count) + 0.5) / count)


def polyline(*corners: Sequence[float] | Array) -> list[Array]:
    """The straight lines between consecutive corners."""
    return [np.array([a, b], dtype=np.float64) for a, b in itertools.pairwise(corners)]


def mirror(line: Array) -> Array:
    """The other side of x = 0, run through backwards."""
    return (line * [-1, 1])[::-1]


def chain(*ids: Ids) -> Ids:
    """Ids along consecutive sides, each joint once."""
    return np.concatenate([ids[0], *(side[1:] for side in ids[1:])])


def ring(one: Ids, other: Ids) -> Ids:
    """The cycle of two paths between the same ends."""
    return np.concatenate([one[:-1], other[:0:-1]])


def cut(
    outline: Sequence[Array], holes: Sequence[Sequence[Array]], spacing: float, fixed: Array | None = None
) -> Panel:
    """Cut a pattern drawn in (x, z) out of the plane y = 0.

    Parameters
    ----------
    outline : sequence of (k, 2) arrays
        A closed chain of polylines, counter-clockwise; the joints between polylines stay vertices.
    holes : sequence of such chains
    spacing : float
        Edge length, metres.
    fixed : (k, 2) array, optional
        Inner vertices to keep where they are.

    Raises
    ------
    ValueError
        When the pattern is too narrow somewhere for this spacing.
    """
    flat, faces, borders = triangulate(outline, holes, spacing, np.zeros((0, 2)) if fixed is None else fixed)
    edges = half_edges(faces)
    lost = next((pair for border in borders for pair in strangers(border, edges)), None)
    if lost is not None:
        x, z = flat[lost[0]]
        raise ValueError(
            f"spacing {spacing} is too coarse for this pattern: its border is lost near x = {x:.3f}, z = {z:.3f} m; "
            "use a smaller spacing or a wider cut"
        )
    starts = np.cumsum([0, *(count_steps(line, spacing) for line in outline)])
    around = np.append(borders[0], borders[0][:1])
    sides = tuple(around[a : b + 1] for a, b in itertools.pairwise(starts))
    vertices = np.column_stack([flat[:, 0], np.zeros(len(flat)), flat[:, 1]])
    return Panel(vertices, faces, sides, tuple(borders[1:]))


@dataclass(frozen=True)
class Band:
    """A straight strip in x from 0 to its length and in z from minus its width to 0, and the ids along its borders."""

    panel: Panel
    low: Ids  # along z = -width, x growing
    high: Ids  # along z = 0, x growing
    start: Ids  # along x = 0, z growing
    end: Ids

    @classmethod
    def cut(cls, lengths: Sequence[float], widths: Sequence[float], spacing: float) -> Band:
        """Cut a band whose borders have joints after these lengths and widths."""
        x, z = np.cumsum([0.0, *lengths]), np.cumsum([-sum(widths), *widths])
        z[-1] = 0.0
        corners = [(x0, z[0]) for x0 in x] + [(x[-1], z0) for z0 in z[1:]] + [(x0, 0) for x0 in x[-2::-1]]
        outline = polyline(*corners, *((0, z0) for z0 in z[-2::-1]))
        panel = cut(outline, [], spacing)
        m, k = len(lengths), len(widths)
        low, end, high, start = (
            chain(*panel.sides[a:b]) for a, b in ((0, m), (m, m + k), (m + k, 2 * m + k), (2 * m + k, None))
        )
        return cls(panel, low, high[::-1], start[::-1], end)


def inflate(panel: Panel, seams: Sequence[int], depth: float, top: float = np.inf) -> Panel:
    """Blow a flat panel up towards -y by `depth`, with the sides of these numbers kept in the plane.

    The height is the square root of a membrane's under even pressure (on all below z = `top`): an ellipse across a tube.
    """
    seam = np.unique(np.concatenate([panel.sides[i] for i in seams]))
    panel = _without_chords(panel, seam)
    edges = np.unique(half_edges(panel.faces), axis=0)
    n = len(panel.vertices)
    graph = coo_matrix((np.ones(len(edges)), edges.T), shape=(n, n)).tocsr()
    graph = graph + graph.T
    laplacian = (diags(np.asarray(graph.sum(axis=1)).ravel()) - graph).tocsr()
    free = np.setdiff1d(np.arange(n), seam)
    pressure = (panel.vertices[:, 2] <= top).astype(float)
    height = np.zeros(n)
    height[free] = spsolve(laplacian[free][:, free], pressure[free])
    height = depth * np.sqrt(height / height.max())
    return panel.placed(lambda vertices: vertices - height[:, None] * [0, 1, 0])


def _without_chords(panel: Panel, seam: Ids) -> Panel:
    """Halve the inner edges between two vertices of the seam, which the panel on its other side would have as well."""
    vertices, faces = panel.vertices, panel.faces
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
    """Sew panels together; return vertices (n, 3), faces (f, 3) and for each panel the new ids of its vertices.

    A seam (i, ids, j, other) makes one vertex, where panel i has it, of each vertex of `ids` and its partner in `other`.
    """
    first = np.cumsum([0, *(len(panel.vertices) for panel in panels)])
    pairs = np.concatenate(
        [np.zeros((0, 2), np.int64)] + [np.column_stack([first[i] + a, first[j] + b]) for i, a, j, b in seams]
    )
    label = joined(pairs, first[-1])
    _, kept, new = np.unique(label, return_index=True, return_inverse=True)
    vertices = np.concatenate([panel.vertices for panel in panels])[kept]
    maps = [new[a:b] for a, b in itertools.pairwise(first)]
    faces = np.concatenate([ids[panel.faces] for ids, panel in zip(maps, panels, strict=True)])
    wound = wind(faces)[0]
    first_turned = bool((wound[0] != faces[0]).any())  # the outside is where the first panel has it
    return vertices, wound[:, ::-1] if first_turned else wound, maps
