"""Samples and distances: small clouds with literal answers, and the definitions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import cdist
from spoilt import spoil

from topokit import covering_radius, farthest_point_sample, hausdorff
from topokit.sampling import as_tree, hausdorff_table, inliers, spacing

LINE = np.array([[3.0], [4.0], [5.0], [9.0], [4.5]])


@pytest.mark.parametrize(
    ("n", "start", "idx", "radius"),
    [
        (1, 0, [0], 6.0),
        (2, 0, [0, 3], 2.0),
        (3, 0, [0, 3, 2], 1.0),
        (5, 0, [0, 3, 2, 1, 4], 0.0),
        (2, -2, [3, 0], 2.0),
        (2, -5, [0, 3], 2.0),
        (2, 4, [4, 3], 1.5),
        (2, None, [3, 0], 2.0),
    ],
)
def test_the_farthest_comes_next_and_ties_go_to_the_first(n, start, idx, radius):
    found, covered = farthest_point_sample(LINE, n, start)
    assert (found.tolist(), covered) == (idx, radius)
    assert covering_radius(LINE, LINE[found]) == radius
    if start == 0:
        assert farthest_point_sample(LINE, n)[0].tolist() == idx


@pytest.mark.parametrize("dimension", [1, 3, 9])
def test_farthest_points_are_those_of_the_definition(dimension):
    """Of points strewn about, and of a grid, where most choices are ties and places are taken several times."""
    rng = np.random.default_rng(dimension)
    for points in (rng.random((250, dimension)), rng.integers(0, 3, (250, dimension)).astype(float)):
        found, covered = farthest_point_sample(points, 220, 7)
        expected = [7]
        nearest = ((points - points[7]) ** 2).sum(axis=1)
        while len(expected) < 220:
            expected.append(int(np.argmax(nearest)))
            nearest = np.minimum(nearest, ((points - points[expected[-1]]) ** 2).sum(axis=1))
        assert found.tolist() == expected
        assert covered == pytest.approx(np.sqrt(nearest.max()), rel=1e-12)


def test_the_inliers_of_a_cloud_are_those_of_the_definition():
    """Outliers are left out twice; places that coincide are one."""
    rng = np.random.default_rng(0)
    for n, few in [(300, 20), (40, 9), (7, 3), (6, 2), (5, 2)]:
        points = np.concatenate([rng.random((n, 2)), rng.uniform(-9, 9, (few, 2))])
        ids = np.arange(len(points))
        for _ in range(2):
            if len(ids) > 5:
                fifth = np.sort(cdist(points[ids], points[ids]), axis=1)[:, 5]
                ids = ids[fifth <= 2.5 * np.median(fifth)]
        assert inliers(points).tolist() == inliers(as_tree(points)).tolist() == ids.tolist()
        twice = np.concatenate([points, points])
        assert inliers(twice).tolist() == [*ids, *(ids + len(points))]
        assert len(ids) < len(points) or n < 10
    assert inliers(np.zeros((3, 2))).tolist() == [0, 1, 2]
    assert inliers(points, factor=100.0).tolist() == list(range(len(points)))


@pytest.mark.parametrize(
    ("cloud", "half"),
    [
        ([[5.0]], 0.0),
        ([[5.0], [5.0]], 0.0),
        ([[5.0], [8.0], [5.0]], 1.5),
        ([[0.0], [-0.0], [3.0]], 1.5),
        ([[0.0], [0.0], [1.0], [3.0], [3.0], [9.0], [9.0]], 3.0),
    ],
)
def test_spacing_is_half_the_widest_gap_between_different_points(cloud, half):
    assert spacing(np.array(cloud)) == half


@pytest.mark.parametrize("d", [1, 3])
def test_distances_are_those_of_the_definitions(d):
    rng = np.random.default_rng(d)
    for n, power in ((2, 1), (7, 1), (300, 3), (1000, 0)):
        a = rng.normal(size=(n, d)) ** power + np.arange(n)[:, None] * (power == 0)  # evenly on a line, when 0
        for b in (a + 0.01 * rng.random((n, d)), rng.permutation(a), a[: n // 2] + 1.0):
            table = cdist(a, b)
            assert covering_radius(a, b) == pytest.approx(table.min(axis=1).max(), rel=1e-14)
            assert covering_radius(b, a) == pytest.approx(table.min(axis=0).max(), rel=1e-14)
            assert hausdorff(a, b) == max(covering_radius(a, b), covering_radius(b, a))
            assert hausdorff(as_tree(a), b) == hausdorff(a, b)
        own = cdist(a, a) + np.diag(np.full(n, np.inf))
        for cloud in (a, np.concatenate([a, a[: n // 2]])):
            assert spacing(cloud) == pytest.approx(own.min(axis=1).max() / 2, rel=1e-14)
    sets = rng.normal(size=(2, 5, 2, d))
    assert hausdorff_table(*sets) == pytest.approx(np.array([[hausdorff(a, b) for b in sets[1]] for a in sets[0]]))


@pytest.mark.parametrize(
    ("call", "names"),
    [
        (lambda: farthest_point_sample(LINE, 0), "n must be 1 to 5"),
        (lambda: farthest_point_sample(LINE, 6), "n must be 1 to 5"),
        (lambda: farthest_point_sample(LINE, 1, 5), "start"),
        (lambda: farthest_point_sample(np.zeros((0, 3)), 1), "points"),
        (lambda: covering_radius(np.empty((0, 2)), [[0, 0]]), "dense and sample"),
        (lambda: hausdorff([[0, 0]], [[0, 0, 0]]), "length 3"),
        (lambda: inliers(LINE, factor=0), "factor"),
    ],
)
def test_what_is_out_of_range_is_named(call, names):
    with pytest.raises(ValueError, match=names):
        call()


# Spoilt clouds: as many points as are kept, noise of the size asked for, outliers in their number and place.
CLOUDS = np.random.default_rng(0).random((5, 4, 200, 3))


def test_kept_points_come_first_and_are_repeated_in_order():
    spoilt = spoil(CLOUDS, np.random.default_rng(1), keep=0.3)
    assert {len(np.unique(cloud, axis=0)) for cloud in spoilt.reshape(-1, 200, 3)} == {60}
    np.testing.assert_array_equal(spoilt, spoilt[:, :, np.arange(200) % 60])
    assert not np.array_equal(spoilt[0, 0, :60], CLOUDS[0, 0, :60])  # at random
    for cloud, kept in zip(CLOUDS.reshape(-1, 200, 3), spoilt.reshape(-1, 200, 3), strict=True):
        places = [int(np.flatnonzero((cloud == point).all(axis=1))[0]) for point in kept[:60]]
        assert places == sorted(places)  # a farthest-point sample stays one: some models read its first points
