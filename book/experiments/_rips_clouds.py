"""The clouds of the benchmark of persistence: the same ones in every run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import topokit as tk
from topokit.io import load_episode

Cloud = NDArray[np.float64]
EPISODE = Path(__file__).parents[2] / "data_small" / "apron_hook_0.npz"


def apron(n: int, rng: np.random.Generator) -> Cloud:
    """Return farthest-point samples of a waving sheet with the outline of the recorded apron (above 4,096: random points)."""
    episode = load_episode(EPISODE)
    corners = episode.points[60][episode.faces].astype(float)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    many = 6 * n if n <= 4096 else n
    u, v = np.sort(rng.random((2, many)), axis=0)
    weights = np.column_stack([u, v - u, 1 - v])
    points = np.einsum("ik,ikd->id", weights, corners[rng.choice(len(area), many, p=area / area.sum())])
    return points[tk.farthest_point_sample(points, n)[0]] if many > n else points


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


def square(n: int, rng: np.random.Generator) -> Cloud:
    """Draw points uniformly in the unit square of the plane."""
    return rng.random((n, 2))


def sheet(n: int, rng: np.random.Generator) -> Cloud:
    """Draw points uniformly on a waving square without a hole."""
    x, y = rng.random((2, n))
    return np.column_stack([x, y, 0.1 * np.sin(7 * x) * np.cos(5 * y)])


SHAPES = {"apron": apron, "torus": torus, "sphere": sphere, "cube": cube, "sheet": sheet, "square": square}


def cloud(shape: str, n: int, seed: int = 0) -> Cloud:
    """Return `n` points of a shape."""
    return SHAPES[shape](n, np.random.default_rng(seed))


def small_clouds(count: int, n: int = 128) -> list[Cloud]:
    """Return small clouds in space, of all shapes in turn, no two alike."""
    shapes = [shape for shape in SHAPES if shape != "square"]
    return [cloud(shapes[k % len(shapes)], n, seed=k) for k in range(count)]


def plans(count: int, n: int = 500) -> list[Cloud]:
    """Return one scene under many plans: the apron, each time bent by a slow wave, 2 mm at most."""
    rng = np.random.default_rng(0)
    points = apron(n, rng)
    ways = rng.normal(size=(count, 3, 3)) * 5  # radians a metre
    phases = 2 * np.pi * rng.random((count, 1, 3))
    return list(points + 0.002 * np.sin(points @ ways + phases))


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


def in_dimension(axes: int, n: int = 500) -> Cloud:
    """Return a torus of four circles at most, turned into a space of more dimensions, with a little noise."""
    rng = np.random.default_rng(0)
    angles = 2 * np.pi * rng.random((n, min(2, axes // 2)))
    flat = np.hstack([np.cos(angles), np.sin(angles)])
    turned, _ = np.linalg.qr(rng.normal(size=(axes, axes)))
    return flat @ turned[: flat.shape[1]] + 0.02 * rng.normal(size=(n, axes))


def ugly(n: int = 3000) -> dict[str, tuple[Cloud, Cloud]]:
    """Return clouds with what makes persistence slow, each with a cloud of as many points without it."""
    rng = np.random.default_rng(0)
    ring = cloud("torus", n)
    half = cloud("torus", n // 2)
    twice = half[rng.integers(0, len(half), n)]
    some = len(ring) * 3 // 4
    side = int(np.ceil(n ** (1 / 3)))
    grid = np.indices((side, side, side)).reshape(3, -1).T[:n].astype(float)
    return {
        "a quarter of the points in one place": (np.r_[ring[:some], np.zeros((n - some, 3))], ring),
        "points nearly repeated": (twice + 1e-9 * rng.normal(size=twice.shape), ring),
        "two clusters, a million diameters apart": (np.r_[half, half + [2.7e6, 0, 0]], np.r_[half, half + [2.7, 0, 0]]),
        "a cubic grid": (grid, grid + 0.1 * rng.normal(size=grid.shape)),
    }
