"""Loops in scikit-learn's pipelines and in PyTorch's gradients."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from topokit import rips_persistence

from clouds import random_cloud
from conftest import DATA, polygon

pytest.importorskip("sklearn")
pytest.importorskip("torch")

import torch
from sklearn.base import clone
from sklearn.ensemble import RandomForestClassifier
from sklearn.model_selection import StratifiedGroupKFold, cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.utils.estimator_checks import check_estimator

from topokit.compat import LoopFeatures, births_and_deaths

# -- scikit-learn -----------------------------------------------------------------------------------------------------------

ARRAY_API = "check_array_api_input"  # scikit-learn itself skips it where SCIPY_ARRAY_API is not set


def checked(estimator: LoopFeatures) -> dict[str, list[BaseException | str | None]]:
    """What does not pass of scikit-learn's checks, by name, with the error."""
    rows = check_estimator(estimator, on_fail=None, on_skip=None)
    assert len(rows) > 40
    return {row["check_name"]: row["exception"] for row in rows if row["status"] != "passed"}


@pytest.mark.filterwarnings("ignore")
def test_scikit_learns_checks_pass():
    assert set(checked(LoopFeatures(n_dims=1, n_jobs=1))) <= {ARRAY_API}


@pytest.mark.filterwarnings("ignore")
def test_of_clouds_in_space_those_checks_fail_whose_rows_are_no_clouds():
    failed = checked(LoopFeatures(n_jobs=1))
    failed.pop(ARRAY_API, None)
    for name, error in failed.items():
        words = []
        while error is not None:
            words.append(str(error))
            error = error.__cause__ or error.__context__
        assert "no points of n_dims=3 coordinates" in " ".join(words), name


def test_features_are_births_and_lifetimes_of_the_longest_loops():
    clouds = [random_cloud(np.random.default_rng(seed), "gaussian") for seed in range(5)]
    clouds = [cloud for cloud in clouds if cloud.shape[1] == clouds[0].shape[1]] + [np.zeros((2, clouds[0].shape[1]))]
    features = LoopFeatures(n_loops=3, n_jobs=1)
    rows, diagrams = features.fit_transform(clouds), features.diagrams(clouds)
    assert rows.shape == (len(clouds), 6)
    for cloud, row, bars in zip(clouds, rows, diagrams, strict=True):
        known = rips_persistence(cloud)
        n = min(3, len(known))
        np.testing.assert_array_equal(bars, np.column_stack([known.birth, known.death]))
        np.testing.assert_array_equal(row[: 2 * n : 2], known.birth[:n])
        np.testing.assert_array_equal(row[1 : 2 * n : 2], known.lifetime[:n])
        assert not row[2 * n :].any()
    assert features.get_feature_names_out().tolist() == [
        "birth0",
        "lifetime0",
        "birth1",
        "lifetime1",
        "birth2",
        "lifetime2",
    ]
    assert rows.any()


def test_clouds_in_rows_are_the_same_clouds():
    clouds = np.random.default_rng(0).normal(size=(4, 20, 3))
    features = LoopFeatures(n_jobs=1)
    expected = features.fit_transform(clouds)
    np.testing.assert_array_equal(features.fit_transform(clouds.reshape(4, 60)), expected)
    assert features.n_features_in_ == 60
    assert clone(features).get_params() == pickle.loads(pickle.dumps(features)).get_params()


@pytest.mark.parametrize(
    ("clouds", "options", "says"),
    [
        ([[1.0, 2, 3, 4]], {}, "a row of X has 4 numbers: no points of n_dims=3"),
        ([np.eye(3), np.eye(2)], {}, r"X\[1\] has 2 dimensions"),
        ([np.full((3, 2), np.nan)], {}, r"X\[0\] has 3 of 3 points with a NaN"),
        ([np.eye(3)], {"n_loops": 0}, "n_loops must be 1 or more"),
        ([[1.0, 2, 3]], {"n_dims": 0.5}, "n_dims must be 1 or more"),
    ],
)
def test_what_holds_no_clouds_is_refused(clouds, options, says):
    with pytest.raises(ValueError, match=says):
        LoopFeatures(**options).fit(clouds).transform(clouds)


def test_persim_takes_the_diagrams():
    bottleneck = pytest.importorskip("persim").bottleneck
    one, other = LoopFeatures(n_jobs=1).diagrams([polygon(12), polygon(12, radius=1.1)])
    assert bottleneck(one, other) == pytest.approx(0.1 * one[0, 1], rel=1e-6)


def test_garments_are_told_apart_by_their_loops():
    """Two kinds, a few frames: the whole table is `book/experiments/doors.py`."""
    pytest.importorskip("zarr")
    from topokit.data import Dataset

    data = Dataset(DATA / "dataset")
    films = [data[i] for i in (1, 2, 3, 4, 5, 7, 10, 15)]  # sheets and a tote have one loop, aprons of this kind two
    frames = [(film.observed[t], film.garment == "apron2", i) for i, film in enumerate(films) for t in (0, 30, 60, 90)]
    clouds, kinds, episodes = map(list, zip(*frames, strict=True))
    model = make_pipeline(LoopFeatures(n_loops=4, n_jobs=1), RandomForestClassifier(n_estimators=20, random_state=0))
    scores = cross_val_score(model, clouds, kinds, groups=episodes, cv=StratifiedGroupKFold(4))
    assert scores.mean() > 0.8  # a coin gets half


# -- PyTorch ----------------------------------------------------------------------------------------------------------------


def cloud(*shape: int, seed: int = 0, **how: object):
    return torch.tensor(np.random.default_rng(seed).normal(size=shape), requires_grad=True, **how)


def test_births_and_deaths_are_those_of_the_diagram():
    points = cloud(3, 20, 2)
    bars = births_and_deaths(points)
    known = [rips_persistence(one.detach().numpy()) for one in points]
    assert bars.shape == (3, max(map(len, known)), 2)
    for found, diagram in zip(bars.detach().numpy(), known, strict=True):
        n = len(diagram)
        np.testing.assert_allclose(found[:n], np.column_stack([diagram.birth, diagram.death]), rtol=1e-14)
        assert not found[n:].any()
    np.testing.assert_array_equal(births_and_deaths(points[1], 3).detach(), bars[1, :3].detach())


@pytest.mark.parametrize("shape", [(14, 2), (3, 12, 2), (2, 10, 4)])
def test_gradcheck_passes(shape):
    assert torch.autograd.gradcheck(lambda points: births_and_deaths(points, 3, n_jobs=1), cloud(*shape))


def test_gradients_flow_to_the_ends_of_two_edges():
    points = cloud(12, 2, dtype=torch.float32)
    diagram = rips_persistence(points.detach().numpy())
    birth, death = births_and_deaths(points)[0]
    birth.backward(retain_graph=True)
    assert set(torch.nonzero(points.grad.abs().sum(dim=1)).ravel().tolist()) == set(diagram.birth_edge[0].tolist())
    points.grad = None
    death.backward()
    assert set(torch.nonzero(points.grad.abs().sum(dim=1)).ravel().tolist()) == set(diagram.killer_edge[0].tolist())
    assert birth.dtype == torch.float32


def test_what_is_not_there_has_no_gradient():
    points = cloud(3, 3, 2)
    bars = births_and_deaths(points, 2)
    assert bars.shape == (3, 2, 2)
    bars.sum().backward()
    assert not points.grad.any()
    assert births_and_deaths(points[0]).shape == (0, 2)


def test_a_loop_is_opened_by_gradient_descent():
    points = torch.tensor(polygon(24), requires_grad=True)
    first = births_and_deaths(points, 1)
    descent = torch.optim.SGD([points], lr=0.1)
    for _ in range(60):
        birth, death = births_and_deaths(points, 1)[0]
        if death == birth:  # there is no loop any more
            break
        descent.zero_grad()
        (death - birth).backward()
        descent.step()
    assert (first[0, 1] - first[0, 0]) > 0.6
    assert len(births_and_deaths(points)) == 0


@pytest.mark.parametrize(
    ("points", "says"),
    [
        (polygon(4), "must be a tensor of floating point, not ndarray"),
        (torch.zeros((4, 2), dtype=torch.int64), "must be a tensor of floating point, not torch.int64"),
        (torch.zeros(4), r"must be of shape \(n, d\) or \(batch, n, d\), not \(4,\)"),
        (torch.zeros((0, 4, 2)), "holds no cloud"),
        (torch.full((4, 2), torch.nan), "NaN or infinite coordinate"),
    ],
    ids=str,
)
def test_what_is_no_tensor_of_clouds_is_refused(points, says):
    with pytest.raises(ValueError, match=says):
        births_and_deaths(points)
