"""Samples and distances: small clouds with literal answers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from topokit import SeqPH, covering_radius, farthest_point_sample, hausdorff
from topokit.sampling import inliers, spacing

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
    ],
)
def test_the_farthest_comes_next_and_ties_go_to_the_first(n, start, idx, radius):
    found, covered = farthest_point_sample(LINE, n, start)
    assert (found.tolist(), covered) == (idx, radius)
    assert covering_radius(LINE, LINE[found]) == radius
    if start == 0:
        assert farthest_point_sample(LINE, n)[0].tolist() == idx


def slowly(points, n, start):
    """Farthest points by their definition."""
    idx = [start]
    nearest = ((points - points[start]) ** 2).sum(axis=1)
    while len(idx) < n:
        idx.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, ((points - points[idx[-1]]) ** 2).sum(axis=1))
    return idx, np.sqrt(nearest.max())


@pytest.mark.parametrize("dimension", [1, 2, 3, 4, 7, 9])
def test_farthest_points_are_those_of_the_definition(dimension):
    """Of points strewn about, and of a grid, where most choices are ties and places are taken several times."""
    rng = np.random.default_rng(dimension)
    for points in (rng.random((250, dimension)), rng.integers(0, 3, (250, dimension)).astype(float)):
        found, covered = farthest_point_sample(points, 220, 7)
        expected, radius = slowly(points, 220, 7)
        assert found.tolist() == expected
        assert covered == pytest.approx(radius, rel=1e-12)


def test_without_a_start_the_order_of_points_has_no_say():
    points = np.random.default_rng(0).normal(size=(200, 3))
    first, covered = farthest_point_sample(points, 40, None)
    assert first[0] == np.linalg.norm(points - points.mean(axis=0), axis=1).argmax()
    for seed in range(5):
        order = np.random.default_rng(seed).permutation(200)
        again, radius = farthest_point_sample(points[order], 40, start=None)
        assert (points[order][again] == points[first]).all()
        assert radius == covered
    with pytest.raises(ValueError, match="1 to 0"):
        farthest_point_sample(np.zeros((0, 3)), 1, None)


def test_the_inliers_of_a_cloud_are_those_of_the_definition():
    """Outliers are left out twice; what lost none of its neighbours is not asked again."""
    rng = np.random.default_rng(0)
    for n, few in [(300, 20), (40, 9), (7, 3), (6, 2), (5, 2)]:
        points = np.concatenate([rng.random((n, 2)), rng.uniform(-9, 9, (few, 2))])
        ids = np.arange(len(points))
        for _ in range(2):
            if len(ids) > 5:
                fifth = np.sort(cdist(points[ids], points[ids]), axis=1)[:, 5]
                ids = ids[fifth <= 2.5 * np.median(fifth)]
        assert inliers(points).tolist() == ids.tolist()
        assert len(ids) < len(points) or n < 10


@pytest.mark.parametrize(
    ("n", "start", "says"),
    [(0, 0, "n must be 1 to 5"), (6, 0, "n must be 1 to 5, .* not 6"), (1, 5, "start must"), (1, -6, "start must")],
)
def test_numbers_out_of_range_are_named(n, start, says):
    with pytest.raises(ValueError, match=says):
        farthest_point_sample(LINE, n, start)


def test_the_covering_radius_has_a_direction_and_hausdorff_has_none():
    assert covering_radius([[0.0], [7.0]], [[1.0]]) == 6.0
    assert covering_radius([[1.0]], [[0.0], [7.0]]) == 1.0
    assert hausdorff([[0.0], [7.0]], [[1.0]]) == hausdorff([[1.0]], [[0.0], [7.0]]) == 6.0


@pytest.mark.parametrize(
    ("dense", "sample", "says"),
    [
        (np.empty((0, 2)), [[0, 0]], "at least one point each"),
        ([[0, 0]], np.empty((0, 2)), "at least one point each"),
        ([[0, 0]], [[0, 0, 0]], "dense has 2 dimensions, sample 3"),
        ([[np.nan, 0]], [[0, 0]], "dense has 1 of 1 points with a NaN"),
        ([[0, 0]], [[0, np.nan]], "sample has 1 of 1 points with a NaN"),
    ],
)
def test_clouds_that_cannot_be_compared_are_named(dense, sample, says):
    with pytest.raises(ValueError, match=says):
        covering_radius(dense, sample)


@pytest.mark.parametrize(
    ("cloud", "half"),
    [
        ([[5.0]], 0.0),
        ([[5.0], [5.0]], 0.0),
        ([[5.0], [8.0]], 1.5),
        ([[5.0], [8.0], [5.0]], 1.5),
        ([[0.0], [-0.0], [0.0]], 0.0),
        ([[0.0], [-0.0], [3.0]], 1.5),
        ([[0.0], [1.0], [3.0], [9.0]], 3.0),
        ([[0.0], [0.0], [1.0], [3.0], [3.0], [9.0], [9.0]], 3.0),
        ([[1e-17], [0.0], [4.0], [4.0]], 2.0),
    ],
)
def test_spacing_is_half_the_widest_gap_between_different_points(cloud, half):
    assert spacing(np.array(cloud)) == half


@pytest.mark.parametrize("d", [1, 2, 3, 5, 9])
@pytest.mark.parametrize("motion", [0.0, 0.01, 1.0])
def test_distances_that_search_for_few_points_are_those_of_all(d, motion):
    rng = np.random.default_rng(0)
    for n, power in ((2, 1), (7, 1), (300, 3), (300, 1), (1000, 0)):
        before = rng.normal(size=(n, d)) ** power + np.arange(n)[:, None] * (power == 0)  # evenly on a line, when 0
        after = before + motion * rng.random((n, d))
        for a, b in ((before, after), (before, rng.permutation(after)), (before, after[: n // 2])):
            apart = cdist(a, b)
            expected = max(apart.min(axis=0).max(), apart.min(axis=1).max())
            assert hausdorff(a, b) == pytest.approx(expected, rel=1e-14)
        own = cdist(after, after) + np.diag(np.full(n, np.inf))
        for cloud in (after, np.concatenate([after, after[: n // 2]])):
            assert spacing(cloud) == pytest.approx(own.min(axis=1).max() / 2, rel=1e-14)


@pytest.mark.parametrize("size", [1e-320, 1e-170, 1e160, 1e300])
def test_no_distance_becomes_zero_or_infinite(size):
    cloud = np.random.default_rng(0).random((20, 3)) * size
    for call in (spacing, lambda c: farthest_point_sample(c, 5), lambda c: hausdorff(c, c[:5]), SeqPH().update):
        with pytest.raises(ValueError, match=r"coordinates of up to .* another unit"):
            call(cloud)
    with pytest.raises(ValueError, match="coordinates of up to"):
        covering_radius(cloud, np.zeros((1, 3)))
    with pytest.raises(ValueError, match="differ so little"):
        spacing([[1, 0], [1, 1e-170], [2, 0], [2, 1e-170]])
