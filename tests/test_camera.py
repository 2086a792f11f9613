"""Depth cameras: their points lie on the cloth, targets hide it, noise is what it says."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

pytest.importorskip("pybullet")

import pybullet

from topokit import rips_persistence
from topokit._config import from_mapping
from topokit.sampling import spacing
from topokit.sim import WARDROBE, Camera, DepthNoise, SimulationConfig, World

APRON = WARDROBE["apron"](spacing=0.05, strap_width=0.05)
OFFSET = np.array([0.0, -0.2, 1.1])
POST = (np.array([0.1, -0.8, 0.4]), np.array([0.1, -0.8, 1.6]), 0.03)  # before the cloth, touching nothing


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


def distances(points, triangles):
    """(n,) distance from each point to the nearest of the triangles (f, 3, 3)."""
    a, b, c = triangles.transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    nearest, above = np.full(len(points), np.inf), np.ones((len(points), len(a)), dtype=bool)
    for start, end in ((a, b), (b, c), (c, a)):
        along, to = end - start, points[:, None] - start
        t = np.clip((to * along).sum(-1) / (along**2).sum(-1), 0, 1)
        nearest = np.minimum(nearest, np.linalg.norm(to - t[..., None] * along, axis=-1).min(axis=1))
        above &= (np.cross(along, to) * normal).sum(-1) >= 0
    height = np.abs(((points[:, None] - a) * normal).sum(-1))
    return np.minimum(nearest, np.where(above, height, np.inf).min(axis=1))


def test_matrices_are_pybullets_own():
    camera = Camera(
        (0.3, -2.0, 1.4), (0.1, 0.2, 0.9), up=(0.1, 0.0, 1.0), fov=40, width=160, height=90, near=0.2, far=5
    )
    view, projection = camera.matrices
    np.testing.assert_allclose(view, pybullet.computeViewMatrix(camera.eye, camera.target, camera.up), atol=1e-6)
    np.testing.assert_allclose(projection, pybullet.computeProjectionMatrixFOV(40, 160 / 90, 0.2, 5), atol=1e-6)


@pytest.mark.parametrize(
    "camera", [*Camera.around((0, -0.2, 0.9)), Camera((0.4, -1.0, 2.4), (0, -0.2, 1), width=200, height=100, fov=60)]
)
def test_points_lie_on_the_cloth(world, camera):
    depth, mask = world.image(camera)
    points = camera.unproject(depth, mask)
    assert len(points) > 300
    error = distances(points, world.vertices()[APRON.faces])
    assert np.median(error) < 1e-5
    assert np.percentile(error, 95) < 5e-5


def test_a_shifted_pixel_would_not_lie_on_the_cloth(world):
    """The pixel's place matters: read at its middle, points leave the cloth by a millimetre and more."""
    camera = Camera.around((0, -0.2, 0.9))[1]
    depth, mask = world.image(camera)
    moved = dataclasses.replace(camera, width=2 * camera.width, height=2 * camera.height)
    rows, columns = np.nonzero(mask)
    fine = np.zeros((moved.height, moved.width), dtype=bool)
    values = np.full(fine.shape, np.inf)
    fine[2 * rows, 2 * columns + 1], values[2 * rows, 2 * columns + 1] = True, depth[mask]
    points = moved.unproject(values, fine)  # (rows + 1/2, columns + 1/2) of the coarse picture
    assert np.median(distances(points, world.vertices()[APRON.faces])) > 1e-3


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
    cameras = Camera.around((0, -0.2, 0.9))
    points = world.observe(cameras, 200, rng)
    assert points.shape == (200, 3)
    assert len(np.unique(points, axis=0)) == 200
    assert distances(points, world.vertices()[APRON.faces]).max() < 1e-4
    np.testing.assert_array_equal(points, world.observe(cameras, 200, np.random.default_rng(5)))  # no noise, no chance
    assert world.observe(cameras, 1, rng).shape == (1, 3)


def test_fewer_pixels_than_points_are_repeated(world, rng):
    camera = Camera((0, -2, 1), (0, 0, 1), width=16, height=16)
    seen = int(world.image(camera)[1].sum())
    points = world.observe([camera], 300, rng)
    assert points.shape == (300, 3)
    assert len(np.unique(points, axis=0)) == seen < 150
    once, repeated = rips_persistence(points[:seen]), rips_persistence(points)
    keep = repeated.lifetime > 0
    np.testing.assert_allclose(repeated.death[keep], once.death)
    np.testing.assert_allclose(repeated.birth[keep], once.birth)
    assert spacing(points) == pytest.approx(spacing(points[:seen]))  # the scale below which loops are noise


def test_noise_is_repeatable_and_small(world):
    cameras = Camera.around((0, -0.2, 0.9), noise=DepthNoise(dropout=0.1))
    one, again, other = (world.observe(cameras, 200, np.random.default_rng(seed)) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one, again)
    assert not np.array_equal(one, other)
    assert 0.001 < np.median(distances(one, world.vertices()[APRON.faces])) < 0.02


@pytest.mark.parametrize("z", [0.4, 1.0, 2.0])
def test_axial_noise_grows_with_squared_distance(rng, z):
    depth, mask = np.full((300, 300), z), np.ones((300, 300), dtype=bool)
    noisy, seen = DepthNoise().add_to(depth, mask, rng)
    assert seen.all()
    assert np.std(noisy - z) == pytest.approx(0.0012 + 0.0019 * (z - 0.4) ** 2, rel=0.02)
    assert abs(np.mean(noisy - z)) < 1e-4


def test_lateral_noise_and_dropout(rng):
    depth = np.where(np.arange(400) < 200, 1.0, np.inf) * np.ones((400, 1))
    mask = np.isfinite(depth)
    none = DepthNoise(axial=0, axial_growth=0, lateral=0)
    for before, after in zip((depth, mask), none.add_to(depth, mask, rng), strict=True):
        np.testing.assert_array_equal(before, after)
    moved, ragged = dataclasses.replace(none, lateral=2.0).add_to(depth, mask, rng)
    np.testing.assert_array_equal(ragged, np.isfinite(moved))
    edge = ragged[:, 198:202].mean()
    assert 0.3 < edge < 0.7  # near the outline it is a coin toss
    assert ragged[:, :190].all()
    assert not ragged[:, 210:].any()
    _, kept = dataclasses.replace(none, dropout=0.25).add_to(depth, mask, rng)
    assert kept[:, :200].mean() == pytest.approx(0.75, abs=0.01)


def test_places_may_be_arrays():
    camera = Camera((0.0, -2.0, 1.0), (0.0, 0.0, 0.0), noise=DepthNoise())
    assert Camera(np.array([0, -2, 1]), np.zeros(3), noise=DepthNoise()) == camera
    assert from_mapping(Camera, dataclasses.asdict(camera), "a camera") == camera  # and lists, as JSON has them


@pytest.mark.parametrize(
    ("make", "options", "named"),
    [
        (Camera, {"eye": (0, 0)}, "eye"),
        (Camera, {"target": (0, 0, np.nan)}, "target"),
        (Camera, {"eye": (0, 0, 2), "target": (0, 0, 1)}, "up"),
        (Camera, {"eye": (0, 0, 1), "target": (0, 0, 1)}, "eye"),
        (Camera, {"fov": 180}, "fov"),
        (Camera, {"fov": 0}, "fov"),
        (Camera, {"width": 12.5}, "width"),
        (Camera, {"width": 10**9}, "width"),
        (Camera, {"near": 2, "far": 1}, "near"),
        (Camera.around, {"n": 10**9}, "1000000000"),
        (DepthNoise, {"axial": -1}, "axial"),
        (DepthNoise, {"dropout": 1.0}, "dropout"),
        (DepthNoise, {"lateral": np.nan}, "lateral"),
    ],
)
def test_bad_cameras_and_noise_are_named(make, options, named):
    with pytest.raises(ValueError, match=named):
        make(**options)


def test_bad_images_and_observations(world, rng):
    camera = Camera(width=4, height=3)
    depth = np.full((3, 4), np.inf)
    mask = np.zeros((3, 4), dtype=bool)
    assert camera.unproject(depth, mask).shape == (0, 3)
    with pytest.raises(ValueError, match=r"depth .*\(4, 3\)"):
        camera.unproject(depth.T, mask)
    mask[2, 1] = True
    with pytest.raises(ValueError, match=r"pixel \(2, 1\)"):
        camera.unproject(depth, mask)
    away = Camera((0, -2, 1), (0, -3, 1))
    for cameras, n, named in (([away], 10, r"\(0.0, -2.0, 1.0\)"), ([], 10, "camera"), ([camera], 0, "n must be")):
        with pytest.raises(ValueError, match=named):
            world.observe(cameras, n, rng)
