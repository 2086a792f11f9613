"""The clouds of the benchmark of persistence: the same ones in every run."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import topokit as tk
from topokit.io import load_episode

Cloud = NDArray[np.float64]
EPISODE = Path(__file__).parents[2] / "data_small" / "apron_hook_0.npz"


def places_on(corners: Cloud, count: int, rng: np.random.Generator) -> tuple[NDArray[np.int64], Cloud]:
    """Draw places uniformly on triangles (F, 3, 3); return their triangles and their weights (count, 3)."""
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    u, v = np.sort(rng.random((2, count)), axis=0)
    return rng.choice(len(area), count, p=area / area.sum()), np.column_stack([u, v - u, 1 - v])


def apron(n: int, rng: np.random.Generator) -> Cloud:
    """Return a farthest-point sample of a waving sheet with the outline of the recorded apron."""
    episode = load_episode(EPISODE)
    corners = episode.points[60][episode.faces].astype(float)
    triangle, weights = places_on(corners, 6 * n, rng)
    points = np.einsum("ik,ikd->id", weights, corners[triangle])
    return points[tk.farthest_point_sample(points, n)[0]]


def torus(n: int, rng: np.random.Generator) -> Cloud:
    """Draw points of a torus by random angles: denser inside."""
    a, b = 2 * np.pi * rng.random((2, n))
    return np.column_stack([(1 + 0.35 * np.cos(b)) * np.cos(a), (1 + 0.35 * np.cos(b)) * np.sin(a), 0.35 * np.sin(b)])


def sphere(n: int, rng: np.random.Generator) -> Cloud:
    """Draw points uniformly on the unit sphere."""
    points = rng.normal(size=(n, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def cube(n: int, rng: np.random.Generator) -> Cloud:
    """Draw points uniformly in the unit cube."""
    return rng.random((n, 3))


def sheet(n: int, rng: np.random.Generator) -> Cloud:
    """Draw points uniformly on a waving square without a hole."""
    x, y = rng.random((2, n))
    return np.column_stack([x, y, 0.1 * np.sin(7 * x) * np.cos(5 * y)])


SHAPES = {"apron": apron, "torus": torus, "sphere": sphere, "cube": cube, "sheet": sheet}


def cloud(shape: str, n: int, seed: int = 0) -> Cloud:
    """Return `n` points of a shape."""
    return SHAPES[shape](n, np.random.default_rng(seed))


def small_clouds(count: int, n: int = 128) -> list[Cloud]:
    """Return small clouds in space, of all shapes in turn, no two alike."""
    shapes = list(SHAPES)
    return [cloud(shapes[k % len(shapes)], n, seed=k) for k in range(count)]


def rotations(n: int = 1024) -> Cloud:
    """Draw random rotations of space, as points in nine dimensions."""
    return Rotation.random(n, random_state=0).as_matrix().reshape(n, 9)


def projective_plane(n: int = 600) -> Cloud:
    """Return a matrix of distances: angles between random lines in space."""
    lines = sphere(n, np.random.default_rng(0))
    angles = np.arccos(np.clip(np.abs(lines @ lines.T), 0, 1))
    angles = (angles + angles.T) / 2
    np.fill_diagonal(angles, 0)
    return angles


def film(n: int, frames: int) -> list[Cloud]:
    """Return clouds of `n` points: a farthest-point sample of places on the first frame's triangles, carried along."""
    episode = load_episode(EPISODE)
    corners = episode.points[:frames, episode.faces].astype(float)  # (T, F, 3, 3)
    triangle, weights = places_on(corners[0], 6 * n, np.random.default_rng(0))
    points = np.einsum("ik,tikd->tid", weights, corners[:, triangle])
    chosen, _ = tk.farthest_point_sample(points[0], n)
    return list(np.ascontiguousarray(points[:, chosen]))
