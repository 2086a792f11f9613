"""The look of cloth and loops: smooth normals, a check that folds with the cloth, seams, a shadow, and colours of identities.

Idea: the check runs along the cloth. An episode keeps no pattern, but folding hardly changes distances along a mesh's edges;
landmark multidimensional scaling lays these out in the plane (de Silva and Tenenbaum 2004).
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from topokit._validate import Array, Ids
from topokit.sampling import farthest_point_sample

_OKABE_ITO = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # colours that everybody can tell apart


def loop_colour(loop_id: int) -> str:
    """Return the colour of an identity as `#RRGGBB`; identities six apart share one."""
    return _OKABE_ITO[int(loop_id) % len(_OKABE_ITO)]


def cloth_marks(points: Array, faces: Ids, *, smooth: bool) -> list[tuple[Ids, Array, float]]:
    """Return check and seams: (L,) faces of lines, (L, 2, 3) ends as shares of the face's corners, and the brightness."""
    if not len(faces):
        return []
    halves = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    check_faces, check_ends = _check_lines(_check_places(points, np.unique(halves, axis=0)), faces)
    # cloth that hangs has folds everywhere; only cloth at rest has seams at its sharp folds
    least_cosine = 0.35 if smooth else -2.0
    seam_faces, seam_ends = _seams(halves, face_normals(points[faces]), least_cosine)
    return [(check_faces, check_ends, 0.82), (seam_faces, seam_ends, 0.5)]


def face_normals(corners: Array) -> Array:
    """Return (F, 3) unit normals of triangles (F, 3, 3)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    return _unit(np.cross(b - a, c - a))


def smoothed(flat: Array, faces: Ids) -> Array:
    """Return (F, 3) normals between those of the faces and those of their corners, which vanish across a sharp fold."""
    around = np.zeros((faces.max(initial=-1) + 1, 3))
    np.add.at(around, faces, flat[:, None])
    return _unit(flat + _unit(around)[faces].mean(axis=1))


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-15))


def _check_places(points: Array, edges: Ids) -> Array:
    """Return (N, 2) places along the cloth, one unit between lines of the check, in its two longest directions."""
    size = np.ptp(points, axis=0)

    # distances along edges from landmarks to all vertices; infinite between pieces
    lengths = np.linalg.norm(np.diff(points[edges], axis=1)[:, 0], axis=1) + 1e-12
    graph = csr_array((lengths, edges.T), shape=(len(points), len(points)))
    landmarks, _ = farthest_point_sample(points, min(64, len(points)))
    distances = np.minimum(dijkstra(graph, directed=False, indices=landmarks), 3 * size.max())

    # classical scaling of the landmarks, in space because a bag has a depth
    centred = distances**2 - (distances[:, landmarks] ** 2).mean(axis=1)[:, None]
    gram = -0.5 * (centred[:, landmarks] - centred[:, landmarks].mean(axis=0))
    values, vectors = np.linalg.eigh((gram + gram.T) / 2)
    landmark_places = vectors[:, -3:] * np.sqrt(np.maximum(values[-3:], 0.0))
    layout = -0.5 * centred.T @ np.linalg.pinv(landmark_places.T, 0.15)

    # the plane of the layout that fits the cloth's two longest directions
    longest = (points - points.mean(axis=0))[:, np.argsort(-size)[:2]]
    fit = np.linalg.lstsq(layout - layout.mean(axis=0), longest)[0]
    flat = layout @ np.linalg.qr(fit)[0]
    line_distance = max(float(np.ptp(flat, axis=0).max()) / 12, 2 * float(np.median(lengths)))
    return np.asarray(flat / line_distance)


def _check_lines(places: Array, faces: Ids) -> tuple[Ids, Array]:
    """Return where each of the places (N, k) is a whole number: a piece of line on every face that such a line crosses."""
    pieces = [(np.zeros(0, np.int64), np.zeros((0, 2, 3)))]
    for values in places.T:
        for level in np.arange(np.ceil(values.min()), values.max()):
            above = values[faces] > level
            face = np.flatnonzero(above.any(axis=1) & ~above.all(axis=1))
            # one corner lies alone on its side; the line cuts the two sides that leave it
            alone_above = above[face].sum(axis=1) == 1
            alone = np.argmax(above[face] == alone_above[:, None], axis=1)
            start = np.eye(3)[alone][:, None]
            side = np.eye(3)[(alone[:, None] + [1, 2]) % 3] - start
            corner_values = values[faces[face]][:, :, None]
            share = (level - start @ corner_values) / (side @ corner_values)
            pieces.append((face, start + share * side))
    return np.concatenate([face for face, _ in pieces]), np.concatenate([ends for _, ends in pieces])


def _seams(halves: Ids, normals: Array, least_cosine: float) -> tuple[Ids, Array]:
    """Return the edges of one face alone, and those at which two faces meet at less than a cosine; `halves` are face by face."""
    _, which, count = np.unique(halves, axis=0, return_inverse=True, return_counts=True)
    by_edge = np.argsort(which.ravel(), kind="stable")
    last = np.cumsum(count) - 1
    first = last - count + 1
    cosine = (normals[by_edge[first] // 3] * normals[by_edge[last] // 3]).sum(axis=1)
    drawn = by_edge[last[(count == 1) | (cosine < least_cosine)]]
    ends = np.eye(3)[np.array([[0, 1], [1, 2], [2, 0]])[drawn % 3]]
    return drawn // 3, ends


def shadow(points: Array, *, seen_from_above: bool) -> tuple[Array, float]:
    """Return (k, 32, 3) ellipses on the floor z = 0, each inside the one before, and the darkness of one; k = 0 below it."""
    nothing = np.zeros((0, 32, 3)), 0.0
    if len(points) < 2 or not seen_from_above:
        return nothing
    size = float(np.ptp(points, axis=0).max())
    height = float(points[:, 2].min())
    if not size or height < -0.02 * size:
        return nothing
    height = max(height, 0.0)

    # the ellipse of the points seen from above, wider and fainter the higher they are
    values, vectors = np.linalg.eigh(np.cov(points[:, :2].T))
    axes = vectors * (2 * np.sqrt(np.maximum(values, 0.0)) + 0.05 * size + 0.3 * height)
    angle = np.linspace(0.0, 2 * np.pi, 32, endpoint=False)
    ellipse = np.column_stack([np.cos(angle), np.sin(angle)]) @ axes.T
    rings = np.linspace(1.0, 0.06, 16)[:, None, None] * ellipse + points[:, :2].mean(axis=0)
    darkness = 0.03 * float(np.exp(-height / (0.6 * size)))
    return np.pad(rings, ((0, 0), (0, 0), (0, 1))), darkness
