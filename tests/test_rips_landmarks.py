"""The engine with landmarks, which large clouds have, finds the pairs that it finds without."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("numba")

from topokit.rips._cloud import Cloud
from topokit.rips.engine import pairing

from clouds import FAMILIES, random_cloud


def torus(n: int, seed: int) -> np.ndarray:
    """Points of a torus by random angles."""
    a, b = 2 * np.pi * np.random.default_rng(seed).random((2, n))
    return np.column_stack([(1 + 0.35 * np.cos(b)) * np.cos(a), (1 + 0.35 * np.cos(b)) * np.sin(a), 0.35 * np.sin(b)])


def check(points: np.ndarray, max_length: float = np.inf) -> None:
    """Pairs with and without landmarks are the same."""
    data = Cloud.of_points(points).data
    stop = np.zeros(1, np.int64)
    without = pairing.pair_with(data, max_length, stop, np.empty((0, 2)))
    for ours, theirs in zip(pairing.pair_edges(data, max_length, stop), without, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_skipped_edges_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pairing, "LARGE", 4)
    for index in range(400):
        rng = np.random.default_rng([7, index])
        cloud = random_cloud(rng, FAMILIES[index % len(FAMILIES)])
        if len(cloud) >= 4 and cloud.shape[1] <= 3:
            check(cloud)
    for seed in range(20):
        check(torus(300, seed), 4.0 if seed % 2 else np.inf)
        check(np.round(8 * torus(300, seed)) / 8)  # many edges of one length


def test_a_large_cloud() -> None:
    check(torus(4000, 0))
