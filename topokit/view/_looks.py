"""What makes cloth look like cloth in every picture: smooth normals, a check that folds with it, seams, a shadow.

Idea: the check runs along the cloth itself. An episode keeps no pattern, but folding hardly changes distances along the
edges of a mesh, so these, laid out in the plane by landmark multidimensional scaling, stand in for it.

Source: de Silva and Tenenbaum 2004 (landmark multidimensional scaling). Seen first in chapter 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from topokit.sampling import farthest_point_sample

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
_LANDMARKS, _CHECKS = 64, 12  # of the layout; lines of the check along the longer side of a garment
_PRINTED, _SEWN = 0.82, 0.5  # brightness of the check and of seams on cloth of brightness one
_SHARP = 0.35  # cosine between faces beside a seam


@dataclass(frozen=True, eq=False)
class Marks:
    """Short straight lines on the faces of a mesh, which move with it."""

    face: Ids  #: (L,) the face that a line lies on
    ends: Ids  #: (L, 2, 2) each end lies between two vertices
    share: Array  #: (L, 2) how far from the first of the two to the second

    def on(self, points: Array) -> Array:
        """(L, 2, 3) the lines on a mesh with these vertices."""
        start, stop = points[self.ends[..., 0]], points[self.ends[..., 1]]
        return np.asarray(start + self.share[..., None] * (stop - start))


def face_normals(corners: Array) -> Array:
    """(F, 3) unit normals of triangles (F, 3, 3)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    return _unit(np.cross(b - a, c - a))


def vertex_normals(points: Array, faces: Ids) -> Array:
    """(N, 3) unit normals, each the mean over the faces around a vertex, weighted by area; zero where there are none."""
    a, b, c = np.moveaxis(points[faces], 1, 0)
    normals = np.zeros_like(points)
    np.add.at(normals, faces, np.cross(b - a, c - a)[:, None])
    return _unit(normals)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-15))


def cloth_marks(points: Array, faces: Ids, *, smooth: bool) -> list[tuple[Marks, float]]:
    """What is drawn on a mesh, and how bright where the cloth is one: a check and the seams, folds too where it lies `smooth`."""
    if not len(faces):
        return []
    return [(print_lines(checks(points, faces), faces), _PRINTED), (seams(faces, points if smooth else None), _SEWN)]


def checks(points: Array, faces: Ids) -> Array:
    """(N, 2) places along the cloth, one unit from line to line of the check, along the two longest ways."""
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])), axis=0)
    lengths = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    graph = csr_array((np.maximum(lengths, 1e-12), edges.T), shape=(len(points), len(points)))
    chosen, _ = farthest_point_sample(points, min(_LANDMARKS, len(points)))
    far = dijkstra(graph, directed=False, indices=chosen)
    far[np.isinf(far)] = far[np.isfinite(far)].max()  # pieces that do not hang together
    square = far**2 - (far[:, chosen] ** 2).mean(axis=1)[:, None]
    gram = -0.5 * (square[:, chosen] - square[:, chosen].mean(axis=0))
    values, vectors = np.linalg.eigh((gram + gram.T) / 2)
    kept = np.flatnonzero(values > 0.02 * values[-1])[-3:]  # a bag has a depth too
    layout = -0.5 * square.T @ (vectors[:, kept] / np.sqrt(values[kept]))
    layout -= layout.mean(axis=0)
    centred = points - points.mean(axis=0)
    centred[:, :2] @= np.linalg.svd(centred[:, :2], full_matrices=False)[2].T
    axes = np.linalg.lstsq(layout, centred[:, [2, 0, 1]])[0][:, np.argsort(-np.ptp(centred[:, [2, 0, 1]], axis=0))[:2]]
    axes = np.linalg.qr(axes)[0]
    flat = layout @ axes
    step = max(float(np.ptp(flat, axis=0).max()) / _CHECKS, 2 * float(np.median(lengths)), 1e-9)
    return np.asarray(flat / step)


def print_lines(places: Array, faces: Ids) -> Marks:
    """Where each of the places (N, k) is a whole number: on every face that such a line crosses, a piece of it."""
    parts = [(np.zeros(0, np.int64), np.zeros((0, 2, 2), np.int64), np.zeros((0, 2)))]
    for values in places.T:
        for level in np.arange(np.ceil(values.min()), values.max()):
            above = values[faces] > level
            face = np.flatnonzero(above.any(axis=1) & ~above.all(axis=1))
            alone = np.argmax(above[face] == (above[face].sum(axis=1) == 1)[:, None], axis=1)
            corner, after, last = (faces[face, (alone + k) % 3] for k in range(3))
            ends = np.stack([np.column_stack([corner, after]), np.column_stack([corner, last])], axis=1)
            start, stop = values[ends[..., 0]], values[ends[..., 1]]
            parts.append((face, ends, (level - start) / (stop - start)))
    return Marks(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def seams(faces: Ids, rest: Array | None = None) -> Marks:
    """The edges that one face has alone, and those at which the mesh is sharply folded at rest."""
    halves = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, which, count = np.unique(halves, axis=0, return_inverse=True, return_counts=True)
    by_edge = np.argsort(which.ravel(), kind="stable") // 3
    first, last = by_edge[np.cumsum(count) - count], by_edge[np.cumsum(count) - 1]
    drawn = count == 1
    if rest is not None:
        normals = face_normals(rest[faces])
        drawn |= (normals[first] * normals[last]).sum(axis=1) < _SHARP
    return Marks(last[drawn], np.repeat(edges[drawn][..., None], 2, axis=2), np.zeros((int(drawn.sum()), 2)))


def shadow(points: Array) -> tuple[Array, Array, float] | None:
    """Centre (3,), half-axes (2, 3) and darkness of a soft ellipse on the floor z = 0; None for cloth that reaches below it."""
    if len(points) < 2 or (low := float(points[:, 2].min())) < -0.02 * (size := float(np.ptp(points, axis=0).max())):
        return None
    values, vectors = np.linalg.eigh(np.cov(points[:, :2].T))
    reach = 2 * np.sqrt(np.maximum(values, 0.0)) + 0.05 * size + 0.3 * max(low, 0.0)
    axes = np.column_stack([vectors.T * reach[:, None], np.zeros(2)])
    return np.append(points.mean(axis=0)[:2], 0.0), axes, 0.5 * float(np.exp(-max(low, 0.0) / (0.6 * size + 1e-9)))


def ellipse(centre: Array, axes: Array, size: float = 1.0) -> Array:
    """(32, 3) the outline of an ellipse with these half-axes (2, 3), made larger or smaller."""
    turn = np.linspace(0.0, 2 * np.pi, 32, endpoint=False)
    return np.asarray(centre + size * np.column_stack([np.cos(turn), np.sin(turn)]) @ axes)
