"""What makes cloth look like cloth: smooth normals, a check that folds with it, seams, a shadow. Seen first in chapter 0.

Idea: the check runs along the cloth. An episode keeps no pattern, but folding hardly changes distances along a mesh's edges;
landmark multidimensional scaling lays these out in the plane (de Silva and Tenenbaum 2004).
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from topokit._validate import Array, Ids
from topokit.sampling import farthest_point_sample


def cloth_marks(points: Array, faces: Ids, *, smooth: bool) -> list[tuple[Ids, Array, float]]:
    """Check and seams: (L,) faces of lines, (L, 2, 3) the shares of a face's corners in their ends, how bright they are."""
    if not len(faces):
        return []
    halves = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    sewn = seams(halves, face_normals(points[faces]), least_cosine=0.35 if smooth else -2.0)
    return [(*print_lines(checks(points, np.unique(halves, axis=0)), faces), 0.82), (*sewn, 0.5)]


def face_normals(corners: Array) -> Array:
    """(F, 3) unit normals of triangles (F, 3, 3)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    return _unit(np.cross(b - a, c - a))


def smoothed(flat: Array, faces: Ids) -> Array:
    """(F, 3) between the normal of a face and those of its corners, which are none across a sharp fold."""
    around = np.zeros((faces.max(initial=-1) + 1, 3))
    np.add.at(around, faces, flat[:, None])
    return _unit(flat + _unit(around)[faces].mean(axis=1))


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-15))


def checks(points: Array, edges: Ids) -> Array:
    """(N, 2) places along the cloth, one unit from line to line of the check, in its two longest ways as it hangs."""
    size = np.ptp(points, axis=0)
    lengths = np.linalg.norm(np.diff(points[edges], axis=1)[:, 0], axis=1) + 1e-12
    graph = csr_array((lengths, edges.T), shape=(len(points), len(points)))
    chosen, _ = farthest_point_sample(points, min(64, len(points)))
    far = np.minimum(dijkstra(graph, directed=False, indices=chosen), 3 * size.max())  # infinite between pieces
    square = far**2 - (far[:, chosen] ** 2).mean(axis=1)[:, None]
    gram = -0.5 * (square[:, chosen] - square[:, chosen].mean(axis=0))
    values, vectors = np.linalg.eigh((gram + gram.T) / 2)
    landmarks = vectors[:, -3:] * np.sqrt(np.maximum(values[-3:], 0.0))  # in space, since a bag has a depth
    layout = -0.5 * square.T @ np.linalg.pinv(landmarks.T, 0.15)
    longest = (points - points.mean(axis=0))[:, np.argsort(-size)[:2]]
    flat = layout @ np.linalg.qr(np.linalg.lstsq(layout - layout.mean(axis=0), longest)[0])[0]
    return np.asarray(flat / max(float(np.ptp(flat, axis=0).max()) / 12, 2 * float(np.median(lengths))))


def print_lines(places: Array, faces: Ids) -> tuple[Ids, Array]:
    """Where each of the places (N, k) is a whole number: on every face that such a line crosses, a piece of it."""
    parts = [(np.zeros(0, np.int64), np.zeros((0, 2, 3)))]
    for values in places.T:
        for level in np.arange(np.ceil(values.min()), values.max()):
            above = values[faces] > level
            face = np.flatnonzero(above.any(axis=1) & ~above.all(axis=1))
            alone = np.argmax(above[face] == (above[face].sum(axis=1) == 1)[:, None], axis=1)
            start, way = np.eye(3)[alone][:, None], np.eye(3)[(alone[:, None] + [1, 2]) % 3] - np.eye(3)[alone][:, None]
            at = values[faces[face]][:, :, None]
            parts.append((face, start + (level - start @ at) / (way @ at) * way))
    return np.concatenate([face for face, _ in parts]), np.concatenate([ends for _, ends in parts])


def seams(halves: Ids, normals: Array, least_cosine: float) -> tuple[Ids, Array]:
    """Of (3F, 2) edges, face by face: those that one face has alone, and those at which two meet at less than a cosine."""
    _, which, count = np.unique(halves, axis=0, return_inverse=True, return_counts=True)
    by_edge, last = np.argsort(which.ravel(), kind="stable"), np.cumsum(count) - 1
    cosine = (normals[by_edge[last - count + 1] // 3] * normals[by_edge[last] // 3]).sum(axis=1)
    drawn = by_edge[last[(count == 1) | (cosine < least_cosine)]]
    return drawn // 3, np.eye(3)[np.array([[0, 1], [1, 2], [2, 0]])[drawn % 3]]


def shadow(points: Array) -> tuple[Array, float]:
    """(k, 32, 3) ellipses on the floor z = 0, each in the one before, and how dark one is; k = 0 below the floor."""
    size, low = (float(np.ptp(points, axis=0).max()), float(points[:, 2].min())) if len(points) > 1 else (0.0, -1.0)
    if not size or low < -0.02 * size:
        return np.zeros((0, 32, 3)), 0.0
    values, vectors = np.linalg.eigh(np.cov(points[:, :2].T))
    axes = vectors * (2 * np.sqrt(np.maximum(values, 0.0)) + 0.05 * size + 0.3 * max(low, 0.0))
    turn = np.exp(1j * np.linspace(0.0, 2 * np.pi, 32, endpoint=False))
    flat = np.linspace(1.0, 0.06, 16)[:, None, None] * (np.column_stack([turn.real, turn.imag]) @ axes.T)
    darkness = 0.03 * float(np.exp(-max(low, 0.0) / (0.6 * size)))
    return np.pad(flat + points[:, :2].mean(axis=0), ((0, 0), (0, 0), (0, 1))), darkness
