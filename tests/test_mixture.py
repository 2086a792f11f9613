"""Mixtures against scikit-learn's and SciPy's densities, and against their own samples."""

from __future__ import annotations

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
