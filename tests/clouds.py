"""Random clouds where distances tie, and an oracle that shares no code with topokit."""

from __future__ import annotations

import gudhi
import numpy as np
import pytest

from topokit.rips import _engine

try:
    from numba import config
except ImportError:  # the core works without it
    config = None

# The tests of persistence use the engine from the first cloud on; `fuzz_rips` compares it with plain Python.
INTERPRETED = config is None or bool(config.DISABLE_JIT)
_engine._Engine.ready = config is not None

FAMILIES = (
    "gaussian",
    "grid",
    "polygon",
    "duplicates",
    "collinear",
    "sphere",
    "cocircular",
    "coplanar",
    "far apart",
    "nearly repeated",
)

compiled = pytest.mark.skipif(INTERPRETED, reason="takes long where numba does not compile")

DIAGRAM = ("birth", "death", "birth_edge", "killer_edge", "killer_triangles")


def same(one: object, other: object, names: tuple[str, ...] = DIAGRAM) -> None:
    """Assert that two diagrams agree to the last bit."""
    for name in names:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


def fewer(count: int) -> int:
    """A count of clouds, or a fifth of it where numba does not compile (a mutation run, say)."""
    return count // 5 if INTERPRETED else count


def random_cloud(rng: np.random.Generator, family: str, max_points: int = 24) -> np.ndarray:
    """One cloud of a family, 1 to `max_points` points in 1 to 4 dimensions."""
    n, d = int(rng.integers(1, max_points + 1)), int(rng.integers(1, 5))
    if family == "gaussian":
        return rng.normal(size=(n, d))
    if family == "grid":
        return rng.integers(0, rng.integers(2, 6), size=(n, d)).astype(float)
    if family == "polygon":
        angle = 2 * np.pi * np.arange(n) / n
        return np.column_stack([np.cos(angle), np.sin(angle)])
    if family == "duplicates":
        return rng.normal(size=(n, d))[rng.integers(0, n, size=n)]
    if family == "collinear":
        return rng.permutation(np.linspace(0, 1, n))[:, None] * rng.integers(-2, 3, size=d)
    if family == "sphere":
        points = rng.normal(size=(n, 3))
        return points / np.linalg.norm(points, axis=1, keepdims=True)
    if family == "cocircular":  # integer points on circles through many lattice points: exact ties
        ring = np.array([(a, b) for a in range(-8, 9) for b in range(-8, 9) if a * a + b * b in (25, 50, 65)], float)
        return rng.permutation(ring)[:n]
    if family == "coplanar":
        plane = rng.integers(0, 6, size=(n, 2)).astype(float)
        return np.column_stack([plane, plane.sum(axis=1)])
    if family == "far apart":
        return rng.normal(size=(n, d)) + 1e6 * rng.integers(0, 2, size=(n, 1))
    if family == "nearly repeated":
        points = random_cloud(rng, "duplicates", max_points)
        return points + 1e-7 * rng.normal(size=points.shape)
    raise ValueError(family)


def gudhi_pairs(points: np.ndarray) -> np.ndarray:
    """(k, 2) births and deaths of the degree-1 bars by GUDHI, half-diameter units, sorted; bars of length zero left out."""
    tree = gudhi.RipsComplex(points=points).create_simplex_tree(max_dimension=2)
    tree.compute_persistence(homology_coeff_field=2)
    return sorted_pairs(tree.persistence_intervals_in_dimension(1).reshape(-1, 2) / 2)


def sorted_pairs(pairs: np.ndarray) -> np.ndarray:
    """Bars in lexical order, rounding noise out of the keys; those shorter than 1e-12 left out."""
    pairs = pairs[pairs[:, 1] - pairs[:, 0] > 1e-12]
    keys = pairs.round(9)
    return pairs[np.lexsort((keys[:, 1], keys[:, 0]))]
