"""The figures of chapter 5: what the nudge's page holds and computes, and that a lens shows what topokit.lemmas decides."""

from __future__ import annotations

from itertools import pairwise

import matplotlib.pyplot as plt
import numpy as np
import pytest
from scipy.spatial.distance import cdist

from topokit import hausdorff, lemmas, rips_persistence, view
from topokit.lemmas._measures import is_critical
from topokit.view._lunes import _witness

from conftest import polygon
from pages import by_script, check_small_and_whole, needs_node, page_data

HEXAGON = lemmas.COUNTEREXAMPLES["the sides of a hexagon"].before
SQUARE = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]


@pytest.fixture(autouse=True)
def no_figures_left():
    yield
    plt.close("all")


# ---- the page of the nudge


def test_nudge_holds_clouds_to_the_last_digit():
    points = np.random.default_rng(0).normal(size=(24, 2)) / 3
    data = page_data(view.nudge({"third </script>": points, "square": SQUARE}))
    assert list(data["shapes"]) == ["third </script>", "square"]
    np.testing.assert_array_equal(data["shapes"]["third </script>"], points)
    assert list(page_data(view.nudge(SQUARE))["shapes"].values()) == [SQUARE]


def test_nudge_asks_nothing_of_the_network():
    figure = view.nudge({"square": SQUARE, "hexagon": HEXAGON})
    check_small_and_whole(figure)
    assert repr(figure).startswith("Framed('Loop of 4 or 6 points, nudged'")


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((5, 3)), "points must lie in the plane, not in 3 dimensions"),
        ({"cube": np.zeros((8, 3))}, "cube must lie in the plane"),
        (np.zeros((25, 2)), "points must be 1 to 24 points, not 25; see topokit.farthest_point_sample"),
        (np.zeros((0, 2)), "points must be 1 to 24 points, not 0"),
        ({}, "points names no cloud"),
        ([[0.0, np.nan]], "NaN or infinite"),
    ],
)
def test_nudge_refuses_what_it_cannot_show(points, message):
    with pytest.raises(ValueError, match=message):
        view.nudge(points)


# ---- its script, run by node


PLACES = ["rips.js", "places.js"]


def planar_clouds(seed: int) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    rings = [polygon(int(n), 1.5) + rng.normal(0, 0.1, (n, 2)) for n in rng.integers(4, 25, 60)]
    return rings + [rng.normal(size=(int(n), 2)) for n in rng.integers(1, 25, 60)]


@needs_node
def test_script_finds_the_places_that_topokit_finds():
    clouds = planar_clouds(1)
    seen = 0
    for cloud, found in zip(clouds, by_script(PLACES, "places", [c.tolist() for c in clouds]), strict=True):
        diagram = rips_persistence(cloud)
        if len(diagram) == 0:
            assert found is None
            continue
        assert (found["birth"], found["death"]) == (diagram.birth[0], diagram.death[0])
        assert found["ids"] == diagram.killer_edge[0].tolist()
        np.testing.assert_array_equal(found["edge"], cloud[diagram.killer_edge[0]])
        np.testing.assert_allclose(found["thick"], cloud[diagram.killer_triangles[0, 0]].mean(axis=0), atol=1e-12)
        walk = cloud[diagram.cycle(0)]
        after = np.roll(walk, -1, axis=0)
        weight = np.linalg.norm(after - walk, axis=1)
        centroid = np.average((walk + after) / 2, axis=0, weights=weight)
        np.testing.assert_allclose(found["centroid"], centroid, atol=1e-12)
        seen += 1
    assert seen > 80


@needs_node
def test_script_measures_moves_as_topokit_does():
    clouds = [c for c in planar_clouds(2) if len(rips_persistence(c))]
    pairs = [(a.tolist(), b.tolist()) for a, b in pairwise(clouds)]
    for (a, b), (edge, thick, _) in zip(
        pairs, by_script(PLACES, "([a, b]) => moved(places(a), places(b))", pairs), strict=True
    ):
        first, second = (rips_persistence(c) for c in (a, b))
        a, b = np.array(a), np.array(b)
        assert edge == pytest.approx(hausdorff(a[first.killer_edge[0]], b[second.killer_edge[0]]))
        centres = [p[d.killer_triangles[0, 0]].mean(axis=0) for p, d in ((a, first), (b, second))]
        assert thick == pytest.approx(np.linalg.norm(centres[1] - centres[0]))


@needs_node
def test_script_nudges_one_point_outward_or_along():
    moved = by_script(
        PLACES,
        "([along, by]) => nudged([[1, 0], [0, 1], [-1, 0], [0, -1]], 0, along, by)",
        [[False, 0.25], [True, 0.25]],
    )
    np.testing.assert_allclose(moved[0], [[1.25, 0], [0, 1], [-1, 0], [0, -1]])
    np.testing.assert_allclose(moved[1], [[1, 0.25], [0, 1], [-1, 0], [0, -1]])


@needs_node
def test_a_billionth_makes_the_edge_of_the_hexagon_leap_and_nothing_else():
    call = "(points) => moved(places(nudged(points, 0, true, -1e-9)), places(nudged(points, 0, true, 1e-9)))"
    [[edge, thick, cycle]] = by_script(PLACES, call, [HEXAGON.tolist()])
    assert edge == pytest.approx(2 * rips_persistence(HEXAGON).death[0], rel=1e-6)
    assert max(thick, cycle) < 1e-8


# ---- the lens


def edges_of(cloud: np.ndarray, rng: np.random.Generator, count: int) -> np.ndarray:
    pairs = np.column_stack(np.triu_indices(len(cloud), 1))
    killers = rips_persistence(cloud).killer_edge
    return np.vstack([killers[:3], pairs[rng.integers(len(pairs), size=count)]])


def test_a_lens_shows_what_beta_critical_decides():
    rng = np.random.default_rng(3)
    axes, verdicts = plt.figure().add_subplot(), []
    for _ in range(12):
        grid = np.mgrid[-2:2.1:0.5, -2:2.1:0.5].reshape(2, -1).T
        cloud = grid[np.linalg.norm(grid, axis=1) > 0.9] + rng.uniform(-0.1, 0.1, (1, 2))
        cloud = cloud + rng.normal(0, 0.08, cloud.shape)
        distances = cdist(cloud, cloud)
        for alpha, epsilon in ((0.0, 0.0), (0.15, 0.0), (0.1, 0.02)):
            for x, y in edges_of(cloud, rng, 12).tolist():
                expected = is_critical(distances, x, y, alpha, epsilon)
                axes.clear()
                assert view.plot_lens(cloud, (x, y), alpha, epsilon, ax=axes) is axes
                assert axes.get_title() == ("critical" if expected else "not critical")
                verdicts.append(expected)
    assert 50 < sum(verdicts) < len(verdicts) - 50


def test_the_path_that_a_lens_shows_survives():
    rng = np.random.default_rng(4)
    alpha, epsilon, paths = 0.05, 0.01, 0
    for _ in range(20):
        cloud = rng.uniform(-1, 1, (60, 2))
        distances = cdist(cloud, cloud)
        for x, y in edges_of(cloud, rng, 10).tolist():
            length, farther = distances[x, y], np.maximum(distances[x], distances[y])
            pair, path, inner = _witness(distances, x, y, alpha, epsilon)
            assert (farther[inner] < length - alpha - 4 * epsilon).all()
            if len(pair):
                assert distances[pair[0], pair[1]] >= length - 4 * epsilon
                assert (farther[pair] <= length + 4 * epsilon).all()
            if len(path):
                steps = distances[path[:-1], path[1:]]
                assert [path[0], path[-1]] == pair.tolist()
                assert set(path[1:-1]) <= set(inner)
                assert steps[[0, -1]].max() < length - alpha - 4 * epsilon
                assert steps[1:-1].max(initial=0) < length - 2 * alpha - 4 * epsilon
                paths += 1
    assert paths > 30


@pytest.mark.parametrize(
    ("points", "edge", "alpha", "message"),
    [
        (np.eye(3), (0, 1), 0.1, r"points must lie in the plane"),
        (SQUARE, (0, 4), 0.1, "ids of two different vertices from 0 to 3"),
        (SQUARE, (0, 1.5), 0.1, "edge must be the ids of two different vertices from 0 to 3, not"),
        (SQUARE, (0, 2), -0.1, "alpha must be zero or more"),
    ],
)
def test_a_lens_refuses_what_it_cannot_show(points, edge, alpha, message):
    with pytest.raises(ValueError, match=message):
        view.plot_lens(points, edge, alpha)
