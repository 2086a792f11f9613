"""What must hold of every cloud: symmetries, stability, and agreement with GUDHI and the textbook (a slice of the fuzz)."""

from __future__ import annotations

import fuzz_rips
import gudhi
import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis.extra.numpy import arrays

from topokit import Diagram, rips_persistence

from clouds import DIAGRAM, FAMILIES, compiled, fewer, random_cloud, same, sorted_pairs

WITHOUT_TIES = ("gaussian", "sphere")


def sampled(family: str, count: int, salt: int, max_points: int = 24):
    """Random clouds of a family."""
    rng = np.random.default_rng([salt, FAMILIES.index(family)])
    for _ in range(fewer(count)):
        yield rng, random_cloud(rng, family, max_points)


@pytest.mark.parametrize("first", range(0, 640, 80))
def test_slice_of_the_fuzz(first):
    for index in range(first, first + fewer(80)):
        for data, metric in fuzz_rips.clouds(1, index):
            assert (found := fuzz_rips.failure(data, metric)) is None, found


@pytest.mark.parametrize("family", FAMILIES)
def test_engine_and_plain_python_agree_on_larger_clouds(family):
    """Several words of bits, and a deep tree."""
    for _, cloud in sampled(family, 5, 9, 200):
        fuzz_rips.same_by(fuzz_rips.PATHS, cloud)


coordinates = st.integers(0, 4).map(float)


@given(st.data())
@settings(max_examples=fewer(600), deadline=None, derandomize=True, database=None)
def test_integer_clouds_and_matrices(data):
    """Points with small integers for coordinates; symmetric matrices of them, most of them no metric."""
    if data.draw(st.booleans()):
        points = arrays(float, st.tuples(st.integers(1, 11), st.integers(1, 3)), elements=coordinates)
        assert fuzz_rips.failure(data.draw(points), "euclidean") is None
    else:
        n = data.draw(st.integers(1, 8))
        upper = np.triu(data.draw(arrays(float, (n, n), elements=coordinates)), 1)
        assert fuzz_rips.failure(upper + upper.T, "precomputed") is None


def permuted(rng, cloud, one, *, ties):
    """The bars are the same to the last bit; without ties the simplices are too, under their new names."""
    order = rng.permutation(len(cloud))
    other = rips_persistence(cloud[order])
    same(one, other, ("birth", "death"))
    if not ties:
        np.testing.assert_array_equal(one.birth_edge, np.sort(order[other.birth_edge]))
        np.testing.assert_array_equal(one.killer_edge, np.sort(order[other.killer_edge]))
        np.testing.assert_array_equal(one.killer_triangles[:, :, 2], order[other.killer_triangles[:, :, 2]])


def moved(rng, cloud, one, *, ties):
    """A rigid motion, which rounds, changes little, and nothing without ties."""
    d = cloud.shape[1]
    turn, _ = np.linalg.qr(rng.normal(size=(d, d)))
    other = rips_persistence(cloud @ turn + rng.normal(size=d))
    long, long_too = (dgm.lifetime > 1e-9 for dgm in (one, other))  # rounding makes bars where lengths tie
    np.testing.assert_allclose(np.sort(one.birth[long]), np.sort(other.birth[long_too]), atol=1e-9)
    np.testing.assert_allclose(np.sort(one.death[long]), np.sort(other.death[long_too]), atol=1e-9)
    if not ties:
        same(one, other, DIAGRAM[2:])


def moved_on_the_grid(rng, cloud, one, *, ties):
    """Distances of integers are the same to the last bit, so every tie must fall the same way."""
    if (cloud == np.rint(cloud)).all() and np.abs(cloud).max() < 100:
        shift = rng.integers(-9, 9)
        same(
            one,
            rips_persistence(cloud[:, rng.permutation(cloud.shape[1])] * rng.choice([-1, 1], cloud.shape[1]) + shift),
        )


def scaled(rng, cloud, one, *, ties):
    """A power of two changes no digit."""
    for factor in (2.0**-40, 0.5, 1024.0):
        other = rips_persistence(cloud * factor)
        same(one, other, DIAGRAM[2:])
        np.testing.assert_array_equal(one.birth * factor, other.birth)
        np.testing.assert_array_equal(one.death * factor, other.death)


def with_a_far_point(rng, cloud, one, *, ties):
    """A point farther off than all others are from each other is joined last, and in no lune before."""
    away = np.zeros(cloud.shape[1])
    away[0] = cloud[:, 0].max() + 3 * np.linalg.norm(np.ptp(cloud, axis=0)) + 1
    same(one, rips_persistence(np.vstack([cloud, away])))
    same(one, rips_persistence(np.vstack([cloud, away, rng.normal(size=(3, len(away))) * 1e-3 + 2 * away])))


def with_repeated_points(rng, cloud, one, *, ties):
    """They change no bar."""
    again = np.vstack([cloud, cloud[rng.integers(0, len(cloud), size=5)]])
    same(one, rips_persistence(rng.permutation(again)), ("birth", "death"))


def shaken(rng, cloud, one, *, ties):
    """Bottleneck distance is at most the largest displacement of a point, and half the largest change of a distance."""
    scale = rng.choice([1e-6, 1e-3, 0.05, 0.5])
    other = cloud + rng.uniform(-scale, scale, size=cloud.shape)
    change = np.abs(distances(cloud) - distances(other)).max() / 2
    assert bottleneck(one, rips_persistence(other)) <= change + 1e-12
    assert change <= np.linalg.norm(cloud - other, axis=1).max() + 1e-12


def a_subset(rng, cloud, one, *, ties):
    """Bars differ by at most the covering radius, by interleaving."""
    chosen = rng.permutation(len(cloud))[: rng.integers(1, len(cloud) + 1)]
    radius = distances(cloud)[:, chosen].min(axis=1).max()
    assert bottleneck(one, rips_persistence(cloud[chosen])) <= radius + 1e-12


PROPERTIES = (permuted, moved, moved_on_the_grid, scaled, with_a_far_point, with_repeated_points, shaken, a_subset)


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("check", PROPERTIES)
def test_what_a_change_of_the_cloud_does(check, family):
    for rng, cloud in sampled(family, 50, PROPERTIES.index(check), 32):
        check(rng, cloud, rips_persistence(cloud), ties=family not in WITHOUT_TIES)


def bottleneck(one: Diagram, other: Diagram) -> float:
    """Bottleneck distance of two diagrams, by GUDHI."""
    return gudhi.bottleneck_distance(*(np.column_stack([dgm.birth, dgm.death]) for dgm in (one, other)))


def distances(cloud: np.ndarray) -> np.ndarray:
    return np.linalg.norm(cloud[:, None] - cloud[None], axis=2)


@pytest.mark.parametrize("n", [60, pytest.param(300, marks=compiled)])
@pytest.mark.parametrize("d", [2, 3])
def test_larger_clouds_against_gudhi(n, d):
    """Beyond one word of the bitsets, and up to more leaves of the tree."""
    rng = np.random.default_rng([n, d])
    cloud = rng.normal(size=(n, d))
    cloud /= np.linalg.norm(cloud, axis=1, keepdims=True) ** 0.7
    tree = gudhi.RipsComplex(points=cloud).create_simplex_tree(max_dimension=1)
    tree.collapse_edges()
    tree.expansion(2)
    tree.compute_persistence(homology_coeff_field=2)
    diagram = rips_persistence(cloud)
    theirs = sorted_pairs(tree.persistence_intervals_in_dimension(1) / 2)
    ours = sorted_pairs(np.column_stack([diagram.birth, diagram.death]))
    np.testing.assert_allclose(ours, theirs, atol=1e-9)
