"""Spoilt clouds: as many points as are kept, noise of the size asked for, outliers in their number and place."""

from __future__ import annotations

import numpy as np
import pytest

from topokit.sampling import spoil

CLOUDS = np.random.default_rng(0).random((5, 4, 200, 3))


def test_nothing_asked_for_changes_no_point():
    np.testing.assert_array_equal(spoil(CLOUDS, np.random.default_rng(1)), CLOUDS)


def test_kept_points_come_first_and_are_repeated_in_order():
    spoilt = spoil(CLOUDS, np.random.default_rng(1), keep=0.3)
    assert {len(np.unique(cloud, axis=0)) for cloud in spoilt.reshape(-1, 200, 3)} == {60}
    np.testing.assert_array_equal(spoilt, spoilt[:, :, np.arange(200) % 60])
    assert not np.array_equal(spoilt[0, 0, :60], CLOUDS[0, 0, :60])  # at random
    for cloud, kept in zip(CLOUDS.reshape(-1, 200, 3), spoilt.reshape(-1, 200, 3), strict=True):
        places = [int(np.flatnonzero((cloud == point).all(axis=1))[0]) for point in kept[:60]]
        assert places == sorted(places)  # a farthest-point sample stays one: some models read its first points


def test_noise_has_the_deviation_asked_for():
    cloud = np.zeros((3, 5000, 3))
    spoilt = spoil(cloud, np.random.default_rng(1), noise=[0.0, 0.01, 0.1])
    assert spoilt.std(axis=(1, 2)) == pytest.approx([0, 0.01, 0.1], rel=0.03)


def test_outliers_are_a_share_and_lie_in_the_grown_box():
    cloud = np.tile([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]], (500, 1))
    spoilt = spoil(cloud, np.random.default_rng(1), outliers=0.1)
    wild = spoilt[~((spoilt == cloud[0]) | (spoilt == cloud[1])).all(axis=1)]
    assert len(wild) == 100
    assert (wild >= [-0.1, -0.1, -0.1]).all()
    assert (wild <= [1.1, 2.1, 3.1]).all()
    assert (wild.max(axis=0) > [1.0, 2.0, 3.0]).all()  # beyond the box itself
    assert (wild.min(axis=0) < 0).all()
