"""Doors to the neighbours: the same answers as theirs, their own checks, and what is refused by name."""

from __future__ import annotations

import subprocess
import sys

import gudhi
import numpy as np
import pytest
from scipy import sparse
from scipy.spatial.distance import cdist

from topokit import rips_persistence
from topokit.compat import from_gudhi, ripser

from clouds import random_cloud
from conftest import polygon

RING = polygon(12)


def random(n: int, d: int = 2, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(n, d))


def bars(tree: gudhi.SimplexTree, degree: int) -> np.ndarray:
    """Of GUDHI, in the order of Ripser: late births first in degree 1, early deaths first in degree 0."""
    tree.compute_persistence(homology_coeff_field=2)
    pairs = tree.persistence_intervals_in_dimension(degree).reshape(-1, 2)
    return pairs[np.argsort(-pairs[:, 0] if degree else pairs[:, 1])]


# -- Ripser ---------------------------------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore:X has shape")
@pytest.mark.parametrize("thresh", [np.inf, 0.8, 3.0])
@pytest.mark.parametrize("n", [2, 3, 5, 40])
def test_ripser_gives_whole_lengths_in_both_degrees(n, thresh):
    points = random(n, 3 if n == 3 else 2)
    tree = gudhi.RipsComplex(points=points, max_edge_length=thresh).create_simplex_tree(max_dimension=2)
    found = ripser(points, thresh=thresh)
    assert len(ripser(points, maxdim=0)["dgms"]) == 1
    for degree in (0, 1):
        np.testing.assert_allclose(found["dgms"][degree], bars(tree, degree), rtol=1e-12)
    lengths = cdist(points, points)
    within = lengths.max(axis=1).min() if thresh == np.inf else thresh
    assert found["num_edges"] == (lengths[np.triu_indices(n, 1)] <= within).sum()


def test_ripser_says_where_the_loops_are():
    points = random(60)
    found = ripser(points, do_cycles=True, n_perm=50)
    places = points[found["birth_edge"]], points[found["killer_edge"]]
    lengths = [np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) for ends in places]
    np.testing.assert_allclose(np.column_stack(lengths), found["dgms"][1])
    assert len(found["cycles"]) == len(lengths[0]) > 5
    for cycle, edge in zip(found["cycles"], found["birth_edge"], strict=True):
        assert set(edge.tolist()) <= set(cycle.tolist()) <= set(found["idx_perm"].tolist())
    stays = ripser(RING, thresh=1.0)
    assert stays["killer_edge"].tolist() == [[-1, -1]]
    assert stays["dgms"][1][0, 1] == np.inf
    assert ripser(RING)["cycles"] == []


def test_ripser_reads_matrices_sparse_or_with_gaps():
    points = random(40)
    lengths = cdist(points, points)
    whole, cut = ripser(points)["dgms"], ripser(points, thresh=0.8)["dgms"]
    short = np.where(lengths <= 0.8, lengths, 0)
    rounded = lengths * (1 + 1e-9 * np.tri(40))
    matrices = [
        (lengths, whole),
        (rounded, whole),
        (sparse.coo_array(np.triu(lengths)), whole),
        (sparse.csr_array(short), cut),
    ]
    matrices += [(np.where(lengths <= 0.8, lengths, np.inf), cut), (sparse.csc_matrix(np.tril(short)), cut)]
    matrices += [(sparse.coo_array(np.triu(lengths) + 2 * np.tril(lengths)), whole)]  # the upper triangle counts
    for matrix, expected in matrices:
        found = ripser(matrix, distance_matrix=True)
        for ours, theirs in zip(found["dgms"], expected, strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-12)
        assert found["dperm2all"] is matrix


def test_ripser_takes_metrics_and_farthest_points():
    points = random(40)
    found = ripser(points, metric="manhattan")
    lengths = np.abs(points[:, None] - points).sum(axis=2)
    np.testing.assert_allclose(found["dgms"][1], ripser(lengths, distance_matrix=True)["dgms"][1])
    few, again = ripser(points, n_perm=15), ripser(cdist(points, points), distance_matrix=True, n_perm=15)
    assert few["idx_perm"].tolist() == again["idx_perm"].tolist()
    assert few["idx_perm"][0] == 0
    assert few["dperm2all"].shape == (15, 40)
    assert few["r_cover"] == few["dperm2all"].min(axis=0).max() > 0
    np.testing.assert_allclose(few["dgms"][1], again["dgms"][1])


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"coeff": 3}, "coeff=3 is not offered"),
        ({"maxdim": 2}, "maxdim=2 is not offered"),
        ({"do_cocycles": True}, "do_cocycles=True is not offered"),
        ({"thresh": -1.0}, "thresh must be zero or more"),
        ({"n_perm": 13}, "n_perm must be 1 to 12"),
        ({"n_perm": -1}, "n_perm must be 1 to 12"),
        ({"distance_matrix": True}, "Distance matrix is not square"),
        ({"metric": "unheard of"}, "metric"),
    ],
    ids=str,
)
def test_what_ripser_has_and_we_have_not_is_refused_by_name(options, says):
    with pytest.raises(ValueError, match=says):
        ripser(RING, **options)


def test_a_matrix_that_is_none_is_refused_and_asked_about():
    lopsided = cdist(RING, RING)
    lopsided[3, 2] = 9
    for matrix in (lopsided, np.eye(12), -cdist(RING, RING), np.full((3, 3), np.nan)):
        with pytest.raises(ValueError, match=r"matrix|NaN"):
            ripser(matrix, distance_matrix=True)
    with pytest.raises(ValueError, match="not supported for sparse"):
        ripser(sparse.csr_array(cdist(RING, RING)), distance_matrix=True, n_perm=3)
    with pytest.warns(UserWarning, match="distance_matrix=True"):
        ripser(cdist(RING, RING))
    with pytest.warns(UserWarning, match="transpose"):
        ripser(RING.T)


def test_ripsers_own_answers_where_it_is_installed():
    theirs = pytest.importorskip("ripser").ripser
    for n, options in (
        (100, {}),
        (60, {"thresh": 0.7}),
        (60, {"thresh": 3.0}),
        (80, {"n_perm": 30}),
        (50, {"metric": "manhattan"}),
    ):
        points = random(n, 3)
        one, other = theirs(points, **options), ripser(points, **options)
        assert one.keys() <= other.keys()
        assert one["num_edges"] == other["num_edges"]
        for degree in (0, 1):  # Ripser's lengths are float32
            np.testing.assert_allclose(one["dgms"][degree], other["dgms"][degree], rtol=1e-5)


# -- GUDHI ----------------------------------------------------------------------------------------------------------------


def as_sets(rows: np.ndarray, width: int) -> set[tuple[int, ...]]:
    return {tuple(row) for row in np.asarray(rows).reshape(-1, width).tolist()}


@pytest.mark.parametrize("longest", [np.inf, 1.0])
@pytest.mark.parametrize("d", [2, 3])
def test_to_gudhi_is_what_gudhi_gives(d, longest):
    for seed in range(4):
        points = random(30, d, seed)
        tree = gudhi.RipsComplex(points=points, max_edge_length=longest).create_simplex_tree(max_dimension=2)
        tree.compute_persistence()
        theirs = tree.flag_persistence_generators()
        ours = rips_persistence(points, max_radius=longest / 2).to_gudhi()
        for mine, other in zip((ours[1], ours[3]), (theirs[1], theirs[3]), strict=True):
            assert len(mine) == len(other)
            assert all(as_sets(a, a.shape[1]) == as_sets(b, a.shape[1]) for a, b in zip(mine, other, strict=True))
        np.testing.assert_array_equal(ours[0][:, 1:], theirs[0][:, 1:])
        assert len(ours[2]) == len(theirs[2])
        assert sorted([*ours[0][:, 0], *ours[2]]) == list(range(30))  # which of two dies is GUDHI's own choice


def test_to_gudhi_merges_repeated_points_without_a_pair():
    components, loops, stays, open_ = rips_persistence(np.repeat(RING, 2, axis=0)).to_gudhi()
    assert (components.shape, stays.tolist(), len(loops), open_) == ((11, 3), [0], 1, [])
    empty = rips_persistence(np.zeros((1, 2))).to_gudhi()
    assert [len(part) for part in empty] == [0, 0, 1, 0]


@pytest.mark.parametrize("longest", [np.inf, 1.0])
@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_a_simplex_tree_comes_in(dimension, longest):
    for family in ("gaussian", "grid", "cocircular"):
        points = random_cloud(np.random.default_rng(4), family)
        tree = gudhi.RipsComplex(points=points, max_edge_length=longest).create_simplex_tree(max_dimension=dimension)
        ours, known = from_gudhi(tree), rips_persistence(points, max_radius=longest / 2)
        np.testing.assert_allclose(np.sort(ours.birth), np.sort(known.birth), rtol=1e-12)
        np.testing.assert_allclose(np.sort(ours.death), np.sort(known.death), rtol=1e-12)


def holed() -> gudhi.SimplexTree:
    tree = gudhi.RipsComplex(points=RING).create_simplex_tree(max_dimension=2)
    tree.remove_maximal_simplex([0, 4, 8])
    return tree


def tree_of(simplex: list[int], value: float, late: float | None = None) -> gudhi.SimplexTree:
    tree = gudhi.SimplexTree()
    tree.insert(simplex, value)
    if late is not None:
        tree.assign_filtration(simplex, late)
    return tree


BAD_TREES = {
    "some simplex is missing": holed,
    "enters later than its longest edge": lambda: tree_of([0, 1, 2], 0.0, late=5.0),
    "must enter at 0": lambda: tree_of([0, 1], 1.0),
    "vertices 0 to n - 1": lambda: tree_of([3, 7], 0.0),
    "must be a gudhi.SimplexTree, not ndarray": lambda: RING,
}


@pytest.mark.parametrize("says", BAD_TREES)
def test_a_tree_that_is_no_rips_complex_is_refused(says):
    with pytest.raises(ValueError, match=says):
        from_gudhi(BAD_TREES[says]())


# -- what is not installed ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "missing"), [("LoopFeatures", "sklearn"), ("births_and_deaths", "torch")])
def test_a_neighbour_that_is_missing_is_named_and_the_others_work(name, missing):
    code = (
        f"import sys; sys.modules['{missing}'] = sys.modules['gudhi'] = sys.modules['ripser'] = None\n"
        "from topokit.compat import ripser; assert len(ripser([[0, 0], [1, 0], [1, 1], [0, 1]])['dgms'][1]) == 1\n"
        f"from topokit.compat import {name}"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 1
    assert f"topokit.compat.{name} needs {missing}: pip install 'topokit[{missing}]'" in done.stderr
