"""Triangulate flat patterns: a border sampled at the spacing, filled with a triangular lattice, relaxed."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, cKDTree

from ._surface import half_edges

Array = NDArray[np.float64]
Ids = NDArray[np.int64]


def triangulate(
    outline: Sequence[Array], holes: Sequence[Sequence[Array]], spacing: float, fixed: Array, rounds: int = 12
) -> tuple[Array, Ids, list[Ids]]:
    """Triangulate a flat pattern; return its vertices (n, 2), faces (f, 3) and borders (ids of the outline and of each hole)."""
    borders = [np.concatenate([_resample(line, spacing) for line in chain]) for chain in (outline, *holes)]
    kept = np.concatenate([*borders, fixed])
    lattice = _lattice(borders[0].min(axis=0), borders[0].max(axis=0), spacing)
    lattice = lattice[_inside(lattice, borders) & (cKDTree(kept).query(lattice)[0] > 0.75 * spacing)]
    points = np.concatenate([kept, lattice])
    for _ in range(rounds):  # Laplacian relaxation of the lattice towards the border
        one = half_edges(_faces(points, borders, spacing))
        ends = np.concatenate([one, one[:, ::-1]])
        count = np.bincount(ends[:, 0], minlength=len(points))[:, None]
        mean = np.column_stack([np.bincount(ends[:, 0], points[ends[:, 1], i], len(points)) for i in range(2)]) / count
        points[len(kept) :] = mean[len(kept) :]
    first = np.cumsum([0, *map(len, borders)])
    ids = [np.arange(start, end) for start, end in itertools.pairwise(first)]
    return points, _faces(points, borders, spacing), ids


def _faces(points: Array, borders: Sequence[Array], spacing: float) -> Ids:
    """Delaunay triangles inside the pattern, counter-clockwise, without the slivers along straight borders."""
    faces = Delaunay(points).simplices.astype(np.int64)
    a, b, c = points[faces].transpose(1, 0, 2)
    area = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    faces = np.where(area[:, None] < 0, faces[:, ::-1], faces)
    return faces[(np.abs(area) > 1e-3 * spacing**2) & _inside((a + b + c) / 3, borders)]


def arc_length(line: Array) -> Array:
    """(k,) arc length of a polyline (k, 2) up to each of its points."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])


def points_at(line: Array, at: Array) -> Array:
    """(n, 2) points of a polyline (k, 2) at arc lengths (n,)."""
    length = arc_length(line)
    return np.column_stack([np.interp(at, length, line[:, i]) for i in range(2)])


def count_steps(line: Array, spacing: float) -> int:
    """How many edges a polyline is cut into."""
    return max(1, round(float(arc_length(line)[-1]) / spacing))


def _resample(line: Array, spacing: float) -> Array:
    """Points at equal arc lengths of about `spacing` along a polyline, without its last point."""
    count = count_steps(line, spacing)
    return points_at(line, arc_length(line)[-1] * np.arange(count) / count)


def _lattice(low: Array, high: Array, spacing: float) -> Array:
    """Triangular lattice over a box, symmetric in x about 0."""
    row = spacing * np.sqrt(3) / 2
    half = int(np.ceil(max(-low[0], high[0]) / spacing)) + 1
    across = spacing * np.arange(-half, half + 1)
    heights = np.arange(low[1] + row, high[1], row)
    return np.array([(x + spacing / 2 * (i % 2), z) for i, z in enumerate(heights) for x in across]).reshape(-1, 2)


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
