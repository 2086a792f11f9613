"""Mixtures against scikit-learn's and SciPy's densities, and against their own samples."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.stats import invwishart, multivariate_normal

import topokit as tk
from topokit.io import load_episode
from topokit.mixture import InverseWishart, LoopMixture, loop_mixture


@pytest.fixture(scope="module")
def loop(episode_path):
    """The neck loop of the recorded apron."""
    return tk.SeqPH().update(load_episode(episode_path).observed[40]).loops[0]


def test_components_are_those_of_equation_1(loop):
    mixture = loop_mixture(loop, noise=2e-4)
    triangles = np.concatenate([loop.killer_triangles, loop.neighbours])
    for triangle, mean, covariance in zip(triangles, mixture.means, mixture.covariances, strict=True):
        assert np.allclose(mean, triangle.sum(axis=0) / 3)
        assert np.allclose(covariance, np.cov(triangle.T) + 2e-4 * np.eye(3))
    values = np.concatenate([loop.killer_values, loop.neighbour_values])
    assert np.allclose(mixture.weights * values.sum(), values)
    assert np.isclose(mixture.weights.sum(), 1)
    assert np.allclose(mixture.mean, mixture.weights @ triangles.mean(axis=1))
    assert mixture.mean.tolist() != loop.centre.tolist()  # neighbours count


def test_log_prob_is_that_of_scikit_learn(loop):
    from sklearn.mixture import GaussianMixture

    mixture = loop_mixture(loop)
    x = np.random.default_rng(0).normal(mixture.mean, 0.2, size=(200, 3))
    peer = GaussianMixture(len(mixture.weights))
    peer.weights_, peer.means_, peer.covariances_ = mixture.weights, mixture.means, mixture.covariances
    peer.precisions_cholesky_ = np.linalg.cholesky(np.linalg.inv(mixture.covariances))
    assert np.allclose(mixture.log_prob(x), peer.score_samples(x), atol=1e-8)


def test_log_prob_is_that_of_scipy(loop):
    mixture = loop_mixture(loop)
    x = np.random.default_rng(1).normal(mixture.mean, 0.05, size=(50, 3))
    parts = [
        w * multivariate_normal(m, c).pdf(x)
        for w, m, c in zip(mixture.weights, mixture.means, mixture.covariances, strict=True)
    ]
    assert np.allclose(mixture.log_prob(x), np.log(sum(parts)))
    assert mixture.log_prob(x[0]).shape == ()
    assert np.isclose(mixture.log_prob(x[0]), mixture.log_prob(x)[0])


def test_far_away_the_logarithm_stays_finite(loop):
    assert np.isfinite(loop_mixture(loop).log_prob([1e3, 0, 0]))


def test_samples_have_the_moments_and_repeat(loop):
    mixture = loop_mixture(loop)
    samples = mixture.sample(200_000, rng=0)
    assert np.allclose(samples.mean(axis=0), mixture.mean, atol=1e-3)
    assert np.allclose(np.cov(samples.T), mixture.covariance, atol=3e-5)
    assert np.array_equal(mixture.sample(5, rng=3), mixture.sample(5, rng=np.random.default_rng(3)))
    assert mixture.sample(0).shape == (0, 3)


def test_density_on_a_grid_sums_to_one(loop):
    mixture = loop_mixture(loop, noise=4e-4)
    axes, values = mixture.density(40, extent=4.0)
    assert values.shape == (40, 40, 40)
    cell = np.prod([axis[1] - axis[0] for axis in axes])
    assert np.isclose(values.sum() * cell, 1, atol=0.01)
    assert np.isclose(np.log(values[3, 20, 7]), mixture.log_prob([axes[0][3], axes[1][20], axes[2][7]]))


def test_credibility_of_own_samples_is_uniform(loop):
    mixture = loop_mixture(loop)
    level = mixture.credibility(mixture.sample(4000, rng=1), rng=2)
    assert np.allclose(np.quantile(level, [0.25, 0.5, 0.75]), [0.25, 0.5, 0.75], atol=0.03)
    assert mixture.credibility([[9.0, 9.0, 9.0]]) == 1


@pytest.mark.parametrize("dof", [None, 4.0, 11.5])
def test_the_prior_gives_scipys_posterior_mean(loop, dof):
    scale = np.diag([1e-4, 2e-4, 3e-4])
    mixture = loop_mixture(loop, prior=InverseWishart(scale, dof))
    away = loop.killer_triangles[0] - loop.killer_triangles[0].mean(axis=0)
    posterior = invwishart(df=(dof or 5) + 2, scale=scale + away.T @ away)
    assert np.allclose(mixture.covariances[0], posterior.mean())


def test_the_posterior_is_bayes_rule():
    """Weights of prior draws by the likelihood of three vertices (mean integrated out) give the same mean covariance."""
    triangle = np.array([[0.0, 0.0], [1.0, 0.2], [0.3, 0.8]])
    away = triangle - triangle.mean(axis=0)
    scatter = away.T @ away
    draws = invwishart(df=6, scale=0.5 * np.eye(2)).rvs(200_000, random_state=0)
    inverse = np.linalg.inv(draws)
    log_likelihood = -np.log(np.linalg.det(draws)) - 0.5 * np.einsum("nij,ji->n", inverse, scatter)  # 3 - 1 data
    weight = np.exp(log_likelihood - log_likelihood.max())
    expected = np.einsum("n,nij->ij", weight / weight.sum(), draws)
    assert np.allclose(InverseWishart(0.5, 6).posterior_mean(scatter), expected, atol=1e-3)


def test_loops_in_the_plane():
    state = tk.SeqPH(alpha=0.1).update([[0, 0], [2, 0], [2, 2], [0, 2]])
    mixture = tk.loop_mixture(state.loops[0])
    assert isinstance(mixture, LoopMixture)
    assert mixture.covariances.shape == (6, 2, 2)  # two killer triangles, four neighbours
    assert np.allclose(mixture.mean, [1, 1])


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"noise": 0}, "noise must be more than zero"),
        ({"noise": float("nan")}, "noise must be more than zero"),
        ({"prior": InverseWishart(1e-4, 2.0)}, "dof must be above 2 in 3 dimensions"),
        ({"prior": InverseWishart(-1.0)}, "positive definite"),
        ({"prior": InverseWishart(np.eye(2))}, r"\(3, 3\) matrix"),
    ],
)
def test_bad_input_is_named(loop, options, says):
    with pytest.raises(ValueError, match=says):
        loop_mixture(loop, **options)


def test_points_of_another_dimension_are_refused(loop):
    with pytest.raises(ValueError, match=r"x must be a \(3,\) point or \(n, 3\) points"):
        loop_mixture(loop).log_prob([[0.0, 0.0]])


def test_a_mixture_does_not_freeze_or_share_what_it_was_made_of():
    means, covariances, weights = np.zeros((1, 3)), np.eye(3)[None], np.ones(1)
    mixture = LoopMixture(means, covariances, weights)
    means += 1
    assert mixture.mean.tolist() == [0, 0, 0]
    with pytest.raises(ValueError, match="read-only"):
        mixture.means[0, 0] = 5


def two_places() -> LoopMixture:
    return LoopMixture(np.array([[0.0, 0.0], [4.0, 0.0]]), np.stack([np.eye(2), 4 * np.eye(2)]), np.array([0.25, 0.75]))


def test_the_grid_reaches_three_deviations_from_every_mean():
    axes, values = two_places().density()
    assert [len(axis) for axis in axes] == [48, 48]
    assert [(axis[0], axis[-1]) for axis in axes] == [(-3.0, 10.0), (-6.0, 6.0)]
    assert values.shape == (48, 48)
    place = np.array([axes[0][20], axes[1][30]])
    assert values[20, 30] == pytest.approx(np.exp(two_places().log_prob(place)), rel=1e-12)


def test_credibility_is_the_share_of_samples_that_are_likelier():
    mixture = two_places()
    samples = mixture.sample(4096, 0)
    order = np.argsort(-mixture.log_prob(samples))
    places = samples[order[[0, 1, 100, 4095]]]
    np.testing.assert_allclose(mixture.credibility(places), np.array([0, 1, 100, 4095]) / 4096)
    np.testing.assert_array_equal(
        mixture.credibility(places), mixture.credibility(places)
    )  # the same samples every time
    other = mixture.credibility(places, n=512, rng=9)
    assert (other * 512 == np.round(other * 512)).all()
    assert not np.array_equal(other, mixture.credibility(places, n=512, rng=8))


def test_samples_lie_where_the_mixture_says():
    mixture = two_places()
    samples = mixture.sample(40_000, np.random.default_rng(3))
    np.testing.assert_allclose(samples.mean(axis=0), mixture.mean, atol=0.05)
    np.testing.assert_allclose(np.cov(samples.T), mixture.covariance, atol=0.15)
    np.testing.assert_array_equal(mixture.sample(3, 5), mixture.sample(3, np.random.default_rng(5)))
    with pytest.raises(ValueError, match="n must be 0 or more, a whole number, not -1"):
        mixture.sample(-1)


@dataclass
class Given:
    """A loop of any arrays."""

    killer_triangles: np.ndarray
    killer_values: np.ndarray
    neighbours: np.ndarray
    neighbour_values: np.ndarray


def given(values: list[float], corners: int = 3, entry: float = 1.0) -> Given:
    triangles = np.zeros((len(values), corners, 3))
    triangles[0, 0, 0] = entry
    return Given(triangles[:2], np.array(values[:2]), triangles[2:], np.array(values[2:]))


@pytest.mark.parametrize(
    ("loop", "says"),
    [
        (given([1.0, 1.0, 1.0], corners=4), r"\(m, 3, d\) triangles and m values, not \(3, 4, 3\) and \(3,\)"),
        (replace(given([1.0, 1.0, 1.0]), neighbour_values=np.ones(2)), r"not \(3, 3, 3\) and \(4,\)"),
        (replace(given([1.0, 1.0]), killer_triangles=np.ones((2, 3)), neighbours=np.ones((0, 3))), r"not \(2, 3\) and"),
        (given([1.0, 1.0], entry=np.nan), "triangles has 1 of 2 points with a NaN"),
        (given([1.0, np.nan]), "finite and not negative"),
        (given([1.0, np.inf]), "finite and not negative"),
        (given([3.0, -1.0]), "finite and not negative"),
        (given([0.0, 0.0]), "one of them positive"),
    ],
)
def test_loops_that_give_no_mixture_say_why(loop, says):
    with pytest.raises(ValueError, match=says):
        loop_mixture(loop)


def test_a_value_of_zero_weighs_nothing():
    assert loop_mixture(given([2.0, 0.0, 2.0])).weights.tolist() == [0.5, 0.0, 0.5]
    with pytest.raises(ValueError, match="noise must be more than zero"):
        loop_mixture(given([1.0, 1.0]), noise=0.0)


@pytest.mark.parametrize(
    "scale", [np.diag([1.0, 1.0, 0.0]), np.diag([-1.0, 1.0, 1.0]), np.array([[1.0, 2, 0]] * 3), np.eye(2), 0.0]
)
def test_a_prior_needs_a_positive_definite_scale(scale):
    with pytest.raises(ValueError, match="scale must be positive, or a positive definite"):
        loop_mixture(given([1.0, 1.0]), prior=InverseWishart(scale))
