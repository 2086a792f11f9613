"""The textbook reduction: by hand, by its own algebra, and against GUDHI in degrees 0, 1 and 2."""

from __future__ import annotations

from itertools import combinations

import gudhi
import numpy as np
import pytest

from topokit import rips_persistence
from topokit.rips import reduction
from topokit.rips.reduction import Reduction, filtration, persistence, reduce

from clouds import FAMILIES, random_cloud, sorted_pairs

SQUARE = [[0, 0], [2, 0], [2, 2], [0, 2]]


def test_square_by_hand():
    complex_ = filtration(SQUARE, 2)
    assert [simplex.vertices for simplex in complex_] == [
        *[(0,), (1,), (2,), (3,)],
        *[(0, 1), (0, 3), (1, 2), (2, 3)],  # the sides: equal lengths go by index
        *[(0, 2), (0, 1, 2), (0, 2, 3)],  # the first diagonal and the triangles whose latest edge it is
        *[(1, 3), (0, 1, 3), (1, 2, 3)],
    ]
    assert [simplex.value for simplex in complex_[7:9]] == [1.0, np.sqrt(8) / 2]
    assert complex_[9].latest_edge == complex_[10].latest_edge == (0, 2)
    reduced = reduce(complex_)
    assert reduced.columns[7] == set()  # side (2, 3) closes the loop
    assert reduced.chains[7] == {4, 5, 6, 7}
    assert reduced.columns[10] == {4, 5, 6, 7}  # the second triangle, plus the first, has the loop as its boundary
    assert reduced.killer[7] == 10
    (loop,) = persistence(SQUARE)
    assert (loop.birth_simplex, loop.death_simplex) == ((2, 3), (0, 2, 3))
    assert (loop.birth_edge, loop.killer_edge) == ((2, 3), (0, 2))
    assert (loop.degree, loop.lifetime) == (1, np.sqrt(8) / 2 - 1)
    assert loop.cycle == ((0, 1), (0, 3), (1, 2), (2, 3))


def test_simplices_of_higher_dimension():
    """Nine facets of the Rips complex of an octahedron in four dimensions: a 3-sphere."""
    cross = np.vstack([np.eye(4), -np.eye(4)])
    assert [len(persistence(cross, degree)) for degree in (1, 2, 3)] == [0, 0, 1]
    simplices = filtration(cross[:5], 4)
    assert len(simplices) == 2**5 - 1


@pytest.mark.parametrize("family", FAMILIES)
def test_filtration_keeps_its_order(family):
    rng = np.random.default_rng(40 + FAMILIES.index(family))
    for _ in range(10):
        cloud = random_cloud(rng, family, 12)
        simplices = filtration(cloud, 3)
        vertices = [simplex.vertices for simplex in simplices]
        assert sorted(vertices) == sorted(c for k in range(1, 5) for c in combinations(range(len(cloud)), k))
        edges = [v for v in vertices if len(v) == 2]
        squares = [sum((float(a) - float(b)) ** 2 for a, b in zip(cloud[i], cloud[j], strict=True)) for i, j in edges]
        assert [(s, *e) for s, e in zip(squares, edges, strict=True)] == sorted(
            (s, *e) for s, e in zip(squares, edges, strict=True)
        )
        place = {edge: k for k, edge in enumerate(edges)}
        latest = [max((place[e] for e in combinations(v, 2)), default=-1) for v in vertices]
        keys = [(late, len(v), v) for late, v in zip(latest, vertices, strict=True)]
        assert keys == sorted(keys)
        assert [s.latest_edge for s in simplices] == [edges[late] if late >= 0 else None for late in latest]


def boundary(chain: set[int], reduced: Reduction) -> set[int]:
    """Boundary of a chain of simplices, by definition."""
    position = {simplex.vertices: i for i, simplex in enumerate(reduced.simplices)}
    total: set[int] = set()
    for i in chain:
        vertices = reduced.simplices[i].vertices
        for v in vertices if len(vertices) > 1 else ():
            total ^= {position[tuple(w for w in vertices if w != v)]}
    return total


@pytest.mark.parametrize("family", FAMILIES)
def test_reduced_matrix_is_what_it_says(family):
    """R = D V, V is upper triangular with ones on the diagonal, pivots differ, and every cycle is one."""
    rng = np.random.default_rng(50 + FAMILIES.index(family))
    for _ in range(10):
        reduced = reduce(filtration(random_cloud(rng, family, 10), 3))
        for j, (column, chain) in enumerate(zip(reduced.columns, reduced.chains, strict=True)):
            assert boundary(chain, reduced) == column
            assert max(chain) == j
        pivots = [max(column) for column in reduced.columns if column]
        assert len(set(pivots)) == len(pivots)
        assert reduced.killer == {max(column): j for j, column in enumerate(reduced.columns) if column}
        for degree in (1, 2):
            for pair in reduced.pairs(degree):
                assert pair.cycle[-1] == pair.birth_simplex
                position = {simplex.vertices: i for i, simplex in enumerate(reduced.simplices)}
                assert boundary({position[simplex] for simplex in pair.cycle}, reduced) == set()


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("degree", [0, 1, 2])
def test_equals_gudhi(family, degree):
    rng = np.random.default_rng([60 + FAMILIES.index(family), degree])
    for _ in range(15):
        cloud = random_cloud(rng, family, 14)
        tree = gudhi.RipsComplex(points=cloud).create_simplex_tree(max_dimension=degree + 1)
        tree.compute_persistence(homology_coeff_field=2, persistence_dim_max=True)
        theirs = sorted_pairs(tree.persistence_intervals_in_dimension(degree).reshape(-1, 2) / 2)
        ours = sorted_pairs(np.array([(p.birth, p.death) for p in persistence(cloud, degree)]).reshape(-1, 2))
        np.testing.assert_allclose(ours, theirs, atol=1e-9, err_msg=str(cloud.tolist()))


def test_order_is_that_of_the_diagram():
    cloud = np.random.default_rng(8).normal(size=(40, 2))
    slow, fast = persistence(cloud), rips_persistence(cloud)
    assert [p.birth_edge for p in slow] == list(map(tuple, fast.birth_edge.tolist()))
    assert [p.killer_edge for p in slow] == list(map(tuple, fast.killer_edge.tolist()))
    assert [p.death for p in slow] == fast.death.tolist()


def test_max_radius_leaves_classes_open():
    (loop,) = persistence(SQUARE, max_radius=1.0)
    assert loop.death == np.inf
    assert loop.death_simplex is loop.killer_edge is None
    assert loop.cycle == ((0, 1), (0, 3), (1, 2), (2, 3))
    assert persistence(SQUARE, max_radius=0.9) == []
    assert [p.death for p in persistence(SQUARE, 0, max_radius=0.9)] == [np.inf] * 4


@pytest.mark.parametrize(
    ("call", "error", "names"),
    [
        (lambda: persistence(SQUARE, -1), ValueError, "degree"),
        (lambda: persistence([[0, 1], [2, 0]], metric="precomputed"), ValueError, "symmetric"),
        (lambda: filtration(SQUARE, -2), ValueError, "dimension"),
        (lambda: persistence(np.zeros((500_000, 1))), ValueError, "100000"),
    ],
)
def test_bad_input_is_refused(call, error, names):
    with pytest.raises(error, match=names):
        call()


def test_limit_is_one_of_simplices_not_of_points(monkeypatch):
    monkeypatch.setattr(reduction, "MAX_SIMPLICES", 14)
    assert len(filtration(SQUARE, 2)) == 14
    monkeypatch.setattr(reduction, "MAX_SIMPLICES", 13)
    with pytest.raises(ValueError, match="farthest_point_sample"):
        filtration(SQUARE, 2)
    assert len(filtration(SQUARE, 2, max_radius=1)) == 8


@pytest.mark.parametrize("points", [np.empty((0, 3)), [[0.0, 0.0]], np.zeros((6, 3))], ids=["none", "one", "equal"])
def test_tiny_clouds(points):
    assert persistence(points, 1) == []
    assert [p.death for p in persistence(points, 0)] == [np.inf] * bool(len(points))
