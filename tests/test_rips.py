"""Rips persistence: known shapes, GUDHI as an oracle where distances tie, and what the killers must satisfy."""

from __future__ import annotations

import numpy as np
import pytest

from topokit import rips_persistence

from clouds import FAMILIES, fewer, gudhi_pairs, random_cloud, sorted_pairs
from conftest import polygon


def pairs(diagram) -> np.ndarray:
    return sorted_pairs(np.column_stack([diagram.birth, diagram.death]))


def test_square_by_hand():
    diagram = rips_persistence([[0, 0], [2, 0], [2, 2], [0, 2]])
    assert diagram.birth.tolist() == [1.0]
    assert diagram.death[0] == pytest.approx(np.sqrt(2))
    assert diagram.birth_edge.tolist() == [[2, 3]]  # the last side in the order (length, index, index)
    assert diagram.killer_edge.tolist() == [[0, 2]]  # the first diagonal
    assert sorted(map(sorted, diagram.killer_triangles[0].tolist())) == [[0, 1, 2], [0, 2, 3]]
    # The second diagonal is as long as the first, so its two triangles are in the complex at death: each is next to two sides.
    assert {tuple(sorted(t)) for t in diagram.neighbours(0).tolist()} == {(0, 1, 3), (1, 2, 3)}
    assert len(diagram.neighbours(0)) == 4


@pytest.mark.parametrize("n", [5, 6, 7, 12, 24])
def test_regular_polygon(n):
    """A regular n-gon dies with its first chord that spans at least a third of the circle."""
    diagram = rips_persistence(polygon(n))
    assert len(diagram) == 1
    assert diagram.birth[0] == pytest.approx(np.sin(np.pi / n))
    assert diagram.death[0] == pytest.approx(np.sin(np.pi * np.ceil(n / 3) / n))


def test_round_loop_dies_at_0866_of_its_radius():
    assert rips_persistence(polygon(300, 2.0)).death[0] == pytest.approx(np.sqrt(3) / 2 * 2.0, rel=1e-3)


@pytest.mark.parametrize("family", FAMILIES)
def test_equals_gudhi(family):
    rng = np.random.default_rng(FAMILIES.index(family))
    for _ in range(fewer(400)):
        cloud = random_cloud(rng, family)
        ours, theirs = pairs(rips_persistence(cloud)), gudhi_pairs(cloud)
        assert ours.shape == theirs.shape, cloud.tolist()
        np.testing.assert_allclose(ours, theirs, atol=1e-9, err_msg=str(cloud.tolist()))


@pytest.mark.parametrize("family", FAMILIES)
def test_killers_are_what_they_say(family):
    """Half lengths give birth and death; the triangles share the killer edge, hold no longer one, and lie on two sides."""
    rng = np.random.default_rng(100 + FAMILIES.index(family))
    for _ in range(fewer(100)):
        cloud = random_cloud(rng, family)
        diagram = rips_persistence(cloud)
        for i in range(len(diagram)):
            (a, b), (x, y) = diagram.birth_edge[i], diagram.killer_edge[i]
            assert np.linalg.norm(cloud[a] - cloud[b]) / 2 == pytest.approx(diagram.birth[i])
            assert np.linalg.norm(cloud[x] - cloud[y]) / 2 == pytest.approx(diagram.death[i])
            thick, thin = diagram.killer_triangles[i]
            assert thick[:2].tolist() == thin[:2].tolist() == [x, y]
            assert thick[2] != thin[2]
            assert value(cloud, thick) == value(cloud, thin) == diagram.death[i]
            reach = [
                max(np.linalg.norm(cloud[t[2]] - cloud[x]), np.linalg.norm(cloud[t[2]] - cloud[y]))
                for t in (thick, thin)
            ]
            assert reach[0] >= reach[1] - 1e-12
            for triangle in diagram.neighbours(i):
                assert len(set(triangle.tolist())) == 3
                assert value(cloud, triangle) <= diagram.death[i]


def value(cloud: np.ndarray, triangle: np.ndarray) -> float:
    """Half the longest edge."""
    return max(np.sqrt(sum((cloud[a] - cloud[b]) ** 2)) for a in triangle for b in triangle) / 2


def test_death_ends_the_class():
    """Just before the killer edge arrives the loop is there, with it the loop is gone: counted by ranks over GF(2)."""
    rng = np.random.default_rng(7)
    for _ in range(30):
        cloud = rng.normal(size=(12, 2))
        for birth, death in pairs(rips_persistence(cloud)):
            assert betti_1(cloud, birth) > betti_1(cloud, np.nextafter(birth, 0) - 1e-12)
            assert betti_1(cloud, death - 1e-12) > betti_1(cloud, death + 1e-12)


def betti_1(cloud: np.ndarray, radius: float) -> int:
    """Dimension of H_1 of the Rips complex by Gaussian elimination over GF(2)."""
    near = np.linalg.norm(cloud[:, None] - cloud[None], axis=2) <= 2 * radius
    n = len(cloud)
    edges = {(i, j): k for k, (i, j) in enumerate((i, j) for i in range(n) for j in range(i + 1, n) if near[i, j])}
    triangles = [(i, j, k) for i, j in edges for k in range(j + 1, n) if (i, k) in edges and (j, k) in edges]
    boundary_1 = [(1 << i) | (1 << j) for i, j in edges]
    boundary_2 = [sum(1 << edges[e] for e in ((i, j), (i, k), (j, k))) for i, j, k in triangles]
    return len(edges) - rank(boundary_1) - rank(boundary_2)


def rank(columns: list[int]) -> int:
    pivots: dict[int, int] = {}
    for column in columns:
        while column and column.bit_length() in pivots:
            column ^= pivots[column.bit_length()]
        if column:
            pivots[column.bit_length()] = column
    return len(pivots)


def test_order_of_points_does_not_matter():
    rng = np.random.default_rng(3)
    cloud = rng.normal(size=(60, 3))
    order = rng.permutation(60)
    one, other = rips_persistence(cloud), rips_persistence(cloud[order])
    np.testing.assert_array_equal(one.birth, other.birth)
    np.testing.assert_array_equal(one.death, other.death)
    np.testing.assert_array_equal(np.sort(one.killer_edge), np.sort(order[other.killer_edge]))
    np.testing.assert_array_equal(one.killer_triangles[:, :, 2], order[other.killer_triangles[:, :, 2]])


def test_distance_matrix_gives_the_same():
    cloud = np.random.default_rng(5).normal(size=(40, 3))
    matrix = np.linalg.norm(cloud[:, None] - cloud[None], axis=2)
    one, other = rips_persistence(cloud), rips_persistence(matrix, metric="precomputed")
    np.testing.assert_allclose(one.death, other.death)
    np.testing.assert_array_equal(one.killer_triangles, other.killer_triangles)
    np.testing.assert_array_equal(one.neighbours(0), other.neighbours(0))


def test_max_radius_leaves_loops_open_and_min_lifetime_leaves_them_out():
    circle = polygon(30)
    cut = rips_persistence(circle, max_radius=0.5)
    assert cut.death.tolist() == [np.inf]
    assert cut.killer_edge.tolist() == [[-1, -1]]
    assert cut.killer_triangles.tolist() == [[[-1] * 3] * 2]
    assert cut.neighbours(0).shape == (0, 3)
    assert len(rips_persistence(circle, max_radius=0.05)) == 0
    whole = rips_persistence(circle)
    assert len(rips_persistence(circle, min_lifetime=whole.lifetime[0])) == 1
    assert len(rips_persistence(circle, min_lifetime=np.nextafter(whole.lifetime[0], 9))) == 0


@pytest.mark.parametrize(
    "points",
    [np.empty((0, 3)), [[0.0, 0.0]], [[0, 0], [1, 0], [0, 1]], np.zeros((50, 3)), np.arange(9.0)[:, None]],
    ids=["no points", "one", "three", "all equal", "on a line"],
)
def test_no_loops_is_an_answer(points):
    diagram = rips_persistence(points)
    assert len(diagram) == 0
    assert diagram.killer_triangles.shape == (0, 2, 3)
    assert "0 loops" in repr(diagram)


@pytest.mark.parametrize(
    ("points", "error", "says"),
    [
        ([[0, 0], [1, np.nan], [1, 1], [0, 1]], ValueError, r"points has 1 of 4 points with a NaN.*row 1"),
        ([[0, 0], [np.inf, 1]], ValueError, "row 1"),
        ([1.0, 2.0, 3.0], ValueError, r"shape \(3,\)"),
        (np.zeros((3, 4, 2)), ValueError, "topokit.track"),
        ([[0, 0], [1]], ValueError, "rows differ in length"),
        ([["a", "b"]], TypeError, "real numbers"),
        ([[1 + 1j, 0]], TypeError, "complex"),
        (np.empty((4, 0)), ValueError, "shape"),
    ],
)
def test_bad_points(points, error, says):
    with pytest.raises(error, match=says):
        rips_persistence(points)


@pytest.mark.parametrize(
    ("matrix", "says"),
    [
        (np.zeros((3, 4)), "square"),
        ([[0, 1], [2, 0]], r"not symmetric at \[0, 1\]"),
        ([[0, -1], [-1, 0]], "negative"),
        ([[0, 1], [1, 3]], r"not zero on the diagonal at \[1, 1\]"),
    ],
)
def test_bad_distance_matrix(matrix, says):
    with pytest.raises(ValueError, match=says):
        rips_persistence(matrix, metric="precomputed")


@pytest.mark.parametrize(
    ("option", "error"),
    [
        ({"max_radius": -1}, ValueError),
        ({"min_lifetime": np.nan}, ValueError),
        ({"max_radius": "x"}, TypeError),
        ({"metric": "l1"}, ValueError),
    ],
)
def test_bad_options(option, error):
    with pytest.raises(error, match=next(iter(option))):
        rips_persistence(np.zeros((5, 2)), **option)


def test_diagram_is_read_only_and_knows_its_loops():
    diagram = rips_persistence(polygon(8))
    with pytest.raises(ValueError, match="read-only"):
        diagram.birth[0] = 0
    with pytest.raises(IndexError, match="has 1"):
        diagram.neighbours(1)
