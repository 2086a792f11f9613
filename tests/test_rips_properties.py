"""What must hold of every cloud: symmetries, stability, and agreement with GUDHI and the textbook (a slice of the fuzz)."""

from __future__ import annotations

import fuzz_rips
import gudhi
import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis.extra.numpy import arrays

from topokit import rips_persistence

from clouds import DIAGRAM, FAMILIES, compiled, fewer, random_cloud, same

WITHOUT_TIES = ("gaussian", "sphere")


def sampled(family: str, count: int, salt: int, max_points: int = 24):
    """Random clouds of a family."""
    rng = np.random.default_rng([salt, FAMILIES.index(family)])
    for _ in range(fewer(count)):
        yield rng, random_cloud(rng, family, max_points)


@pytest.mark.parametrize("first", range(0, 640, 80))
def test_slice_of_the_fuzz(first):
    """`python tests/fuzz_rips.py --clouds 20000` runs the same checks for longer."""
    counts, reproducer = fuzz_rips.run(fewer(80), seed=1, first=first)
    assert reproducer is None, reproducer
    assert counts["loops"] > 0


@pytest.mark.parametrize("name", [check.__name__ for check in fuzz_rips.CHECKS if check is not fuzz_rips.check_tighten])
def test_fuzz_notices(name):
    """Each check fails on a diagram that is wrong in what the check is about, so a pass means something."""
    case = fuzz_rips.Case(np.array([[0, 0], [2, 0], [2, 2.1], [0, 2], [1.1, 2.9], [3, 4], [5, 2.5]]))
    check = getattr(fuzz_rips, name)
    check(case)
    case.fast = rips_persistence(np.random.default_rng(3).permutation(case.data) * 1.01)
    with pytest.raises((AssertionError, KeyError)):
        check(case)


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


@pytest.mark.parametrize("family", FAMILIES)
def test_permutation(family):
    """The bars are the same to the last bit; without ties the simplices are too, under their new names."""
    for rng, cloud in sampled(family, 60, 1):
        order = rng.permutation(len(cloud))
        one, other = rips_persistence(cloud), rips_persistence(cloud[order])
        same(one, other, ("birth", "death"))
        if family in WITHOUT_TIES:
            np.testing.assert_array_equal(one.birth_edge, np.sort(order[other.birth_edge]))
            np.testing.assert_array_equal(one.killer_edge, np.sort(order[other.killer_edge]))
            np.testing.assert_array_equal(one.killer_triangles[:, :, 2], order[other.killer_triangles[:, :, 2]])


@pytest.mark.parametrize("family", FAMILIES)
def test_rigid_motion(family):
    for rng, cloud in sampled(family, 60, 2):
        d = cloud.shape[1]
        turn, _ = np.linalg.qr(rng.normal(size=(d, d)))
        moved = cloud @ turn + rng.normal(size=d)
        one, other = rips_persistence(cloud), rips_persistence(moved)
        long, long_too = (dgm.lifetime > 1e-9 for dgm in (one, other))  # rounding makes bars where lengths tie
        np.testing.assert_allclose(np.sort(one.birth[long]), np.sort(other.birth[long_too]), atol=1e-9)
        np.testing.assert_allclose(np.sort(one.death[long]), np.sort(other.death[long_too]), atol=1e-9)
        if family in WITHOUT_TIES:
            same(one, other, DIAGRAM[2:])


@pytest.mark.parametrize("family", ["grid", "cocircular", "coplanar"])
def test_motions_of_the_integer_grid_change_nothing(family):
    """Distances are the same to the last bit, so every tie must fall the same way."""
    for rng, cloud in sampled(family, 60, 3):
        moved = cloud[:, rng.permutation(cloud.shape[1])] * rng.choice([-1, 1], cloud.shape[1]) + rng.integers(-9, 9)
        same(rips_persistence(cloud), rips_persistence(moved))
        if cloud.shape[1] < 4:
            same(rips_persistence(cloud), rips_persistence(np.insert(cloud, 0, 7.0, axis=1)))


@pytest.mark.parametrize("family", FAMILIES)
def test_scaling(family):
    for rng, cloud in sampled(family, 60, 4):
        one = rips_persistence(cloud)
        for factor in (2.0**-40, 0.5, 1024.0):  # changes no digit
            other = rips_persistence(cloud * factor)
            same(one, other, DIAGRAM[2:])
            np.testing.assert_array_equal(one.birth * factor, other.birth)
            np.testing.assert_array_equal(one.death * factor, other.death)
        if family in WITHOUT_TIES:
            factor = rng.uniform(0.1, 10)
            other = rips_persistence(cloud * factor)
            same(one, other, DIAGRAM[2:])
            np.testing.assert_allclose(one.death * factor, other.death)


@pytest.mark.parametrize("family", FAMILIES)
def test_far_point(family):
    """A point farther off than all others are from each other is joined last, and in no lune before."""
    for rng, cloud in sampled(family, 60, 5):
        away = np.zeros(cloud.shape[1])
        away[0] = cloud[:, 0].max() + 3 * np.linalg.norm(np.ptp(cloud, axis=0)) + 1
        one = rips_persistence(cloud)
        same(one, rips_persistence(np.vstack([cloud, away])))
        same(one, rips_persistence(np.vstack([cloud, away, rng.normal(size=(3, len(away))) * 1e-3 + 2 * away])))


@pytest.mark.parametrize("family", FAMILIES)
def test_duplicates_change_no_bar(family):
    for rng, cloud in sampled(family, 60, 6):
        again = np.vstack([cloud, cloud[rng.integers(0, len(cloud), size=5)]])
        one, other = rips_persistence(cloud), rips_persistence(rng.permutation(again))
        same(one, other, ("birth", "death"))


@pytest.mark.parametrize("family", FAMILIES)
def test_stability(family):
    """Bottleneck distance is at most the largest displacement of a point, and half the largest change of a distance."""
    for rng, cloud in sampled(family, 60, 7, 40):
        scale = rng.choice([1e-6, 1e-3, 0.05, 0.5])
        moved = cloud + rng.uniform(-scale, scale, size=cloud.shape)
        apart = bottleneck(cloud, moved)
        change = np.abs(distances(cloud) - distances(moved)).max() / 2
        assert apart <= change + 1e-12
        assert change <= np.linalg.norm(cloud - moved, axis=1).max() + 1e-12


def bottleneck(cloud: np.ndarray, other: np.ndarray) -> float:
    """Bottleneck distance of the diagrams of two clouds, by GUDHI."""
    bars = [np.column_stack([dgm.birth, dgm.death]) for dgm in map(rips_persistence, (cloud, other))]
    return gudhi.bottleneck_distance(*bars)


def distances(cloud: np.ndarray) -> np.ndarray:
    return np.linalg.norm(cloud[:, None] - cloud[None], axis=2)


@pytest.mark.parametrize("family", FAMILIES)
def test_subset_is_close(family):
    """A cloud and a subset are within the covering radius: distance of bars at most that, by interleaving."""
    for rng, cloud in sampled(family, 40, 8, 40):
        chosen = rng.permutation(len(cloud))[: rng.integers(1, len(cloud) + 1)]
        radius = distances(cloud)[:, chosen].min(axis=1).max()
        assert bottleneck(cloud, cloud[chosen]) <= radius + 1e-12


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
    theirs = fuzz_rips.sorted_pairs(tree.persistence_intervals_in_dimension(1) / 2)
    ours = fuzz_rips.sorted_pairs(np.column_stack([diagram.birth, diagram.death]))
    np.testing.assert_allclose(ours, theirs, atol=1e-9)
