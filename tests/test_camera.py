"""Depth cameras: their points lie on the cloth, targets hide it, noise is what it says."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("pybullet")

import trimesh

from topokit.sim import WARDROBE, Camera, SimulationConfig, World

APRON = WARDROBE["apron"](spacing=0.05, strap_width=0.05)
OFFSET = np.array([0.0, -0.2, 1.1])
POST = (np.array([0.1, -0.8, 0.4]), np.array([0.1, -0.8, 1.6]), 0.03)  # before the cloth, touching nothing


EYES = ((0.0, -1.7, 1.45), (1.3, 0.55, 1.45), (-1.3, 0.55, 1.45))
CAMERAS = [Camera(eye, (0.0, -0.2, 0.9)) for eye in EYES]


def hanging_apron(rods=(), steps=200):
    """A world in which the apron hangs between its grippers, one of them pulled back so that the cloth is not flat."""
    world = World(APRON, OFFSET, SimulationConfig())
    world.add_rods(list(rods))
    for step in range(steps):
        world.step(APRON.vertices[APRON.grips] + OFFSET + [[0, 0.1 * step / steps, 0], [0, 0, 0]])
    return world


@pytest.fixture(scope="module")
def world():
    with hanging_apron() as world:
        yield world


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def distances(points, vertices):
    """(n,) distance from each point to the nearest triangle of the apron."""
    return trimesh.proximity.closest_point_naive(trimesh.Trimesh(vertices, APRON.faces, process=False), points)[1]


@pytest.mark.parametrize("camera", [*CAMERAS, Camera((0.4, -1.0, 2.4), (0, -0.2, 1), width=200, height=100, fov=60)])
def test_points_lie_on_the_cloth(world, camera):
    depth, mask = world.image(camera)
    points = camera.unproject(depth, mask)
    assert len(points) > 300
    error = distances(points, world.vertices())
    assert np.median(error) < 1e-5
    assert np.percentile(error, 95) < 5e-5


def test_the_target_hides_the_cloth(world):
    camera = Camera((0, -2, 1), (0, 0, 1))
    depth, mask = world.image(camera)
    with hanging_apron([POST]) as other:
        nearer, visible = other.image(camera)
        np.testing.assert_allclose(other.vertices(), world.vertices(), atol=1e-6)
    hidden = mask & ~visible
    assert hidden.sum() > 50
    assert not (visible & ~mask).any()
    assert (nearer[hidden] < depth[hidden] - 0.3).all()  # what hides it is the post
    np.testing.assert_allclose(nearer[visible], depth[visible], atol=1e-5)
    assert np.isinf(depth[0, 0])


def test_observation_is_a_spread_of_what_is_seen(world, rng):
    points = world.observe(CAMERAS, 200, rng)
    assert points.shape == (200, 3)
    assert len(np.unique(points, axis=0)) == 200
    assert distances(points, world.vertices()).max() < 1e-4
    np.testing.assert_array_equal(points, world.observe(CAMERAS, 200, np.random.default_rng(5)))  # no noise, no chance
    assert world.observe(CAMERAS, 1, rng).shape == (1, 3)


@pytest.mark.parametrize("z", [0.4, 1.0, 2.0])
def test_axial_noise_grows_with_squared_distance(rng, z):
    depth = np.full((300, 300), z)
    for times in (1.0, 2.0):
        noisy, seen = Camera(noise=times).add_noise(depth, np.ones((300, 300), dtype=bool), rng)
        assert seen.all()
        assert np.std(noisy - z) == pytest.approx(times * (0.0012 + 0.0019 * (z - 0.4) ** 2), rel=0.02)
        assert abs(np.mean(noisy - z)) < 2e-4


def test_lateral_noise_makes_outlines_ragged(rng):
    depth = np.where(np.arange(400) < 200, 1.0, np.inf) * np.ones((400, 1))
    mask = np.isfinite(depth)
    moved, ragged = Camera(noise=2.5).add_noise(depth, mask, rng)
    np.testing.assert_array_equal(ragged, np.isfinite(moved))
    edge = ragged[:, 198:202].mean()
    assert 0.3 < edge < 0.7  # near the outline it is a coin toss
    assert ragged[:, :190].all()
    assert not ragged[:, 210:].any()


def test_what_sees_no_cloth_observes_no_points(world, rng):
    assert Camera(width=4, height=3).unproject(np.full((3, 4), np.inf), np.zeros((3, 4), bool)).shape == (0, 3)
    assert world.observe([Camera((0, -2, 1), (0, -3, 1))], 10, rng).shape == (0, 3)
    with pytest.raises(ValueError, match="fov"):
        Camera(fov=180)
