"""The calls of Ripser, scikit-learn and PyTorch: the same answers as theirs, and what is refused by name."""

from __future__ import annotations

import pickle
import subprocess
import sys

import gudhi
import numpy as np
import pytest
from scipy import sparse
from scipy.spatial.distance import cdist
from sklearn.base import clone
from sklearn.utils.estimator_checks import check_estimator

from topokit import rips_persistence
from topokit.compat import LoopFeatures, births_and_deaths, ripser

from conftest import polygon

torch = pytest.importorskip("torch")

RING = polygon(12)


def random(n: int, d: int = 2, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(n, d))


# -- Ripser -----------------------------------------------------------------------------------------------------------------


def bars_of_gudhi(tree: gudhi.SimplexTree, degree: int) -> np.ndarray:
    """Return bars in the order of Ripser: late births first in degree 1, early deaths first in degree 0."""
    tree.compute_persistence(homology_coeff_field=2)
    pairs = tree.persistence_intervals_in_dimension(degree).reshape(-1, 2)
    return pairs[np.argsort(-pairs[:, 0] if degree else pairs[:, 1])]


@pytest.mark.filterwarnings("ignore:X has shape")
@pytest.mark.parametrize("thresh", [np.inf, 0.8, 3.0])
@pytest.mark.parametrize("n", [2, 3, 5, 40])
def test_ripser_gives_whole_lengths_in_both_degrees(n, thresh):
    points = random(n, 3 if n == 3 else 2)
    tree = gudhi.RipsComplex(points=points, max_edge_length=thresh).create_simplex_tree(max_dimension=2)
    found = ripser(points, thresh=thresh)
    assert len(ripser(points, maxdim=0)["dgms"]) == 1
    for degree in (0, 1):
        np.testing.assert_allclose(found["dgms"][degree], bars_of_gudhi(tree, degree), rtol=1e-12)
    lengths = cdist(points, points)
    within = lengths.max(axis=1).min() if thresh == np.inf else thresh
    assert found["num_edges"] == (lengths[np.triu_indices(n, 1)] <= within).sum()


def test_ripser_locates_the_loops():
    points = random(60)
    found = ripser(points, do_cycles=True, n_perm=50)
    ends = [points[found[name]] for name in ("birth_edge", "killer_edge")]
    lengths = [np.linalg.norm(pair[:, 0] - pair[:, 1], axis=1) for pair in ends]
    np.testing.assert_allclose(np.column_stack(lengths), found["dgms"][1])
    assert len(found["cycles"]) == len(lengths[0]) > 5
    for cycle, edge in zip(found["cycles"], found["birth_edge"], strict=True):
        assert set(edge.tolist()) <= set(cycle.tolist()) <= set(found["idx_perm"].tolist())
    never_dies = ripser(RING, thresh=1.0)
    assert never_dies["killer_edge"].tolist() == [[-1, -1]]
    assert never_dies["dgms"][1][0, 1] == np.inf
    assert ripser(RING)["cycles"] == []


LENGTHS = cdist(random(40), random(40))
SHORT = np.where(LENGTHS <= 0.8, LENGTHS, 0)
MATRICES = {
    "dense": (LENGTHS, np.inf),
    "rounded": (LENGTHS * (1 + 1e-9 * np.tri(40)), np.inf),
    "one triangle": (sparse.coo_array(np.triu(LENGTHS)), np.inf),
    "the upper triangle counts": (sparse.coo_array(np.triu(LENGTHS) + 2 * np.tril(LENGTHS)), np.inf),
    "sparse": (sparse.csr_array(SHORT), 0.8),
    "infinite": (np.where(LENGTHS <= 0.8, LENGTHS, np.inf), 0.8),
    "sparse, one triangle": (sparse.csc_matrix(np.tril(SHORT)), 0.8),
}


@pytest.mark.parametrize("kind", MATRICES)
def test_ripser_reads_matrices(kind):
    matrix, thresh = MATRICES[kind]
    found = ripser(matrix, distance_matrix=True)
    for ours, expected in zip(found["dgms"], ripser(random(40), thresh=thresh)["dgms"], strict=True):
        np.testing.assert_allclose(ours, expected, rtol=1e-12)
    assert found["dperm2all"] is matrix


def test_ripser_takes_metrics_and_farthest_points():
    points = random(40)
    found = ripser(points, metric="manhattan")
    lengths = np.abs(points[:, None] - points).sum(axis=2)
    np.testing.assert_allclose(found["dgms"][1], ripser(lengths, distance_matrix=True)["dgms"][1])
    few = ripser(points, n_perm=15)
    again = ripser(cdist(points, points), distance_matrix=True, n_perm=15)
    assert few["idx_perm"].tolist() == again["idx_perm"].tolist()
    assert few["idx_perm"][0] == 0
    assert few["dperm2all"].shape == (15, 40)
    assert few["r_cover"] == few["dperm2all"].min(axis=0).max() > 0
    np.testing.assert_allclose(few["dgms"][1], again["dgms"][1])


@pytest.mark.parametrize(
    "options",
    [{"coeff": 3}, {"maxdim": 2}, {"do_cocycles": True}, {"thresh": -1.0}, {"n_perm": 13}, {"n_perm": -1}],
    ids=str,
)
def test_what_ripser_has_and_we_have_not_is_refused_by_name(options):
    with pytest.raises(ValueError, match=next(iter(options))):
        ripser(RING, **options)


def test_a_matrix_that_is_none_is_refused_and_asked_about():
    lopsided = cdist(RING, RING)
    lopsided[3, 2] = 9
    for matrix in (lopsided, np.eye(12), -cdist(RING, RING), np.full((3, 3), np.nan), RING):
        with pytest.raises(ValueError, match=r"matrix|NaN"):
            ripser(matrix, distance_matrix=True)
    with pytest.raises(ValueError, match="n_perm"):
        ripser(sparse.csr_array(cdist(RING, RING)), distance_matrix=True, n_perm=3)
    with pytest.raises(ValueError, match="metric"):
        ripser(RING, metric="unheard of")
    with pytest.warns(UserWarning, match="distance_matrix=True"):
        ripser(cdist(RING, RING))
    with pytest.warns(UserWarning, match="transpose"):
        ripser(RING.T)


@pytest.mark.parametrize(
    ("n", "options"),
    [(100, {}), (60, {"thresh": 0.7}), (60, {"thresh": 3.0}), (80, {"n_perm": 30}), (50, {"metric": "manhattan"})],
)
def test_ripsers_own_answers_where_it_is_installed(n, options):
    theirs = pytest.importorskip("ripser").ripser
    points = random(n, 3)
    expected = theirs(points, **options)
    found = ripser(points, **options)
    assert expected.keys() <= found.keys()
    assert expected["num_edges"] == found["num_edges"]
    for degree in (0, 1):  # Ripser's lengths are float32
        np.testing.assert_allclose(expected["dgms"][degree], found["dgms"][degree], rtol=1e-5)


# -- scikit-learn -----------------------------------------------------------------------------------------------------------


def failed_checks(estimator: LoopFeatures) -> dict[str, BaseException]:
    """Return what does not pass of scikit-learn's own checks, by name."""
    rows = check_estimator(estimator, on_fail=None, on_skip=None)
    assert len(rows) > 40
    failed = {row["check_name"]: row["exception"] for row in rows if row["status"] != "passed"}
    failed.pop("check_array_api_input", None)  # scikit-learn itself skips it where SCIPY_ARRAY_API is not set
    return failed


@pytest.mark.filterwarnings("ignore")
def test_scikit_learns_checks_pass():
    assert not failed_checks(LoopFeatures(n_dims=1, n_jobs=1))
    # In space those checks fail alone whose rows hold no whole number of points.
    for error in failed_checks(LoopFeatures(n_jobs=1)).values():
        messages = []
        cause: BaseException | None = error
        while cause is not None:
            messages.append(str(cause))
            cause = cause.__cause__ or cause.__context__
        assert "n_dims=3" in " ".join(messages)


def test_features_are_births_and_lifetimes_of_the_longest_loops():
    clouds = [random(n, 3, seed=n) for n in (20, 30, 40)] + [np.zeros((2, 3))]
    features = LoopFeatures(n_loops=3, n_jobs=1)
    rows = features.fit_transform(clouds)
    assert rows.shape == (4, 6)
    assert rows.any()
    for cloud, row, bars in zip(clouds, rows, features.diagrams(clouds), strict=True):
        known = rips_persistence(cloud)
        n = min(3, len(known))
        np.testing.assert_array_equal(bars, np.column_stack([known.birth, known.death]))
        np.testing.assert_array_equal(row[: 2 * n : 2], known.birth[:n])
        np.testing.assert_array_equal(row[1 : 2 * n : 2], known.lifetime[:n])
        assert not row[2 * n :].any()
    assert features.get_feature_names_out().tolist() == [
        f"{kind}{i}" for i in range(3) for kind in ("birth", "lifetime")
    ]


def test_clouds_in_rows_are_the_same_clouds():
    clouds = np.random.default_rng(0).normal(size=(4, 20, 3))
    features = LoopFeatures(n_jobs=1)
    expected = features.fit_transform(clouds)
    np.testing.assert_array_equal(features.fit_transform(clouds.reshape(4, 60)), expected)
    assert features.n_features_in_ == 60
    assert clone(features).get_params() == pickle.loads(pickle.dumps(features)).get_params()


@pytest.mark.parametrize(
    ("clouds", "options", "names"),
    [
        ([[1.0, 2, 3, 4]], {}, "n_dims=3"),
        ([np.eye(3), np.eye(2)], {}, r"X\[1\]"),
        ([np.full((3, 2), np.nan)], {}, r"X\[0\]"),
        ([np.eye(3)], {"n_loops": 0}, "n_loops"),
        ([[1.0, 2, 3]], {"n_dims": 0.5}, "n_dims"),
    ],
)
def test_what_holds_no_clouds_is_refused(clouds, options, names):
    with pytest.raises(ValueError, match=names):
        LoopFeatures(**options).fit(clouds).transform(clouds)


def test_persim_takes_the_diagrams():
    bottleneck = pytest.importorskip("persim").bottleneck
    diagram, larger = LoopFeatures(n_jobs=1).diagrams([RING, 1.1 * RING])
    assert bottleneck(diagram, larger) == pytest.approx(0.1 * diagram[0, 1], rel=1e-6)


# -- PyTorch ----------------------------------------------------------------------------------------------------------------


def tensor(*shape: int, **options: object):
    return torch.tensor(np.random.default_rng(0).normal(size=shape), requires_grad=True, **options)


def test_births_and_deaths_are_those_of_the_diagram():
    points = tensor(3, 20, 2)
    bars = births_and_deaths(points)
    known = [rips_persistence(cloud.detach().numpy()) for cloud in points]
    assert bars.shape == (3, max(map(len, known)), 2)
    for found, diagram in zip(bars.detach().numpy(), known, strict=True):
        n = len(diagram)
        np.testing.assert_allclose(found[:n], np.column_stack([diagram.birth, diagram.death]), rtol=1e-14)
        assert not found[n:].any()
    np.testing.assert_array_equal(births_and_deaths(points[1], 3).detach(), bars[1, :3].detach())


@pytest.mark.parametrize("check", [torch.autograd.gradcheck, torch.autograd.gradgradcheck])
@pytest.mark.parametrize("shape", [(14, 2), (3, 12, 2), (2, 10, 4)])
def test_gradcheck_passes(check, shape):
    """First and second derivatives are those of differences, of bars that fill up the three as well."""
    assert check(lambda points: births_and_deaths(points, 3, n_jobs=1), tensor(*shape))


@pytest.mark.parametrize(("column", "name"), [(0, "birth_edge"), (1, "killer_edge")])
def test_gradients_flow_to_the_ends_of_an_edge(column, name):
    points = tensor(12, 2, dtype=torch.float32)
    diagram = rips_persistence(points.detach().numpy())
    bar = births_and_deaths(points)[0, column]
    bar.backward()
    moved = torch.nonzero(points.grad.abs().sum(dim=1)).ravel().tolist()
    assert set(moved) == set(getattr(diagram, name)[0].tolist())
    assert bar.dtype == torch.float32


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("far", [1.0, 1e-30])
def test_loops_that_are_not_there_have_no_derivatives(dtype, far):
    """Neither a first nor a second one, also where points are repeated, or so near that a square of single precision is 0."""
    square = far * torch.tensor([[0, 0], [2, 0], [2, 2], [0, 2], [2, 2]], dtype=dtype)
    for points in (tensor(3, 3, 2, dtype=dtype), square[:3, :], square[[1, 1, 1, 1]]):
        points = points.detach().requires_grad_()
        bars = births_and_deaths(points, 2)
        assert not bars.any()
        (first,) = torch.autograd.grad(bars.sum() + (bars**2).sum(), points, create_graph=True)
        (second,) = torch.autograd.grad(first.sum(), points)
        assert not first.any()
        assert not second.any()
    assert births_and_deaths(square[:3]).shape == (0, 2)

    # Beside a loop that is there, whose derivatives are finite.
    points = square.detach().requires_grad_()
    bars = births_and_deaths(points, 3)
    (first,) = torch.autograd.grad(bars.sum(), points, create_graph=True)
    (second,) = torch.autograd.grad((first**2).sum(), points)
    assert torch.isfinite(first).all()
    assert torch.isfinite(second).all()
    assert not bars[1:].any()


@pytest.mark.parametrize(
    "points",
    [
        polygon(4),
        torch.zeros((4, 2), dtype=torch.int64),
        torch.zeros(4),
        torch.zeros((0, 4, 2)),
        torch.full((4, 2), torch.nan),
    ],
    ids=["an array", "whole numbers", "one axis", "no cloud", "NaN"],
)
def test_what_is_no_tensor_of_clouds_is_refused(points):
    with pytest.raises(ValueError, match="points"):
        births_and_deaths(points)


@pytest.mark.parametrize(("name", "missing"), [("LoopFeatures", "sklearn"), ("births_and_deaths", "torch")])
def test_a_neighbour_that_is_missing_is_named_and_the_others_work(name, missing):
    code = (
        f"import sys; sys.modules['{missing}'] = sys.modules['gudhi'] = sys.modules['ripser'] = None\n"
        "from topokit.compat import ripser; assert len(ripser([[0, 0], [1, 0], [1, 1], [0, 1]])['dgms'][1]) == 1\n"
        f"from topokit.compat import {name}"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 1
    assert f"topokit.compat.{name} needs {missing}: pip install" in done.stderr
