"""Mixtures against scikit-learn's and SciPy's densities, and against their own samples."""

from __future__ import annotations

from dataclasses import replace

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


TWO_PLACES = LoopMixture(
    means=np.array([[0.0, 0.0], [4.0, 0.0]]),
    covariances=np.stack([np.eye(2), 4 * np.eye(2)]),
    weights=np.array([0.25, 0.75]),
)


def test_components_are_those_of_equation_1(loop):
    mixture = loop_mixture(loop, noise=2e-4)
    triangles = np.concatenate([loop.killer_triangles, loop.neighbours])
    for triangle, mean, covariance in zip(triangles, mixture.means, mixture.covariances, strict=True):
        np.testing.assert_allclose(mean, triangle.sum(axis=0) / 3)
        np.testing.assert_allclose(covariance, np.cov(triangle.T) + 2e-4 * np.eye(3))
    values = np.concatenate([loop.killer_values, loop.neighbour_values])
    np.testing.assert_allclose(mixture.weights, values / values.sum())
    np.testing.assert_allclose(mixture.mean, mixture.weights @ triangles.mean(axis=1))
    assert mixture.mean.tolist() != loop.centre.tolist()  # neighbours count


def test_log_prob_is_that_of_scikit_learn_and_scipy(loop):
    from sklearn.mixture import GaussianMixture

    mixture = loop_mixture(loop)
    x = np.random.default_rng(0).normal(mixture.mean, 0.1, size=(200, 3))
    peer = GaussianMixture(len(mixture.weights))
    peer.weights_ = mixture.weights
    peer.means_ = mixture.means
    peer.precisions_cholesky_ = np.linalg.cholesky(np.linalg.inv(mixture.covariances))
    np.testing.assert_allclose(mixture.log_prob(x), peer.score_samples(x), atol=1e-8)

    components = zip(mixture.weights, mixture.means, mixture.covariances, strict=True)
    density = sum(weight * multivariate_normal(mean, covariance).pdf(x) for weight, mean, covariance in components)
    near = density > 1e-200
    np.testing.assert_allclose(mixture.log_prob(x)[near], np.log(density[near]))
    assert mixture.log_prob(x[0]).shape == ()
    assert mixture.log_prob(x[0]) == pytest.approx(mixture.log_prob(x)[0])
    assert np.isfinite(mixture.log_prob([1e3, 0, 0]))


@pytest.mark.parametrize("which", ["a loop", "two places"])
def test_samples_have_the_moments_and_repeat(loop, which):
    mixture = {"a loop": loop_mixture(loop), "two places": TWO_PLACES}[which]
    samples = mixture.sample(200_000, rng=0)
    size = np.sqrt(np.trace(mixture.covariance))
    np.testing.assert_allclose(samples.mean(axis=0), mixture.mean, atol=0.02 * size)
    np.testing.assert_allclose(np.cov(samples.T), mixture.covariance, atol=0.02 * size**2)
    np.testing.assert_array_equal(mixture.sample(5, rng=3), mixture.sample(5, rng=np.random.default_rng(3)))


def test_the_density_on_a_grid_is_that_at_its_places_and_sums_to_one(loop):
    mixture = loop_mixture(loop, noise=4e-4)
    axes, values = mixture.density(40, extent=4.0)
    cell = np.prod([axis[1] - axis[0] for axis in axes])
    assert values.sum() * cell == pytest.approx(1, abs=0.01)
    assert np.log(values[3, 20, 7]) == pytest.approx(mixture.log_prob([axes[0][3], axes[1][20], axes[2][7]]))

    axes, values = TWO_PLACES.density()  # three deviations from every mean
    assert [(axis[0], axis[-1]) for axis in axes] == [(-3.0, 10.0), (-6.0, 6.0)]
    assert values.shape == (48, 48)


def test_credibility_is_the_share_of_samples_that_are_likelier(loop):
    samples = TWO_PLACES.sample(4096, 0)
    order = np.argsort(-TWO_PLACES.log_prob(samples))
    places = samples[order[[0, 1, 100, 4095]]]
    np.testing.assert_allclose(TWO_PLACES.credibility(places), np.array([0, 1, 100, 4095]) / 4096)
    other = TWO_PLACES.credibility(places, n=512, rng=9)
    np.testing.assert_array_equal(other * 512, np.round(other * 512))
    assert not np.array_equal(other, TWO_PLACES.credibility(places, n=512, rng=8))

    mixture = loop_mixture(loop)
    levels = mixture.credibility(mixture.sample(4000, rng=1), rng=2)  # calibrated, so uniform
    np.testing.assert_allclose(np.quantile(levels, [0.25, 0.5, 0.75]), [0.25, 0.5, 0.75], atol=0.03)
    assert mixture.credibility([[9.0, 9.0, 9.0]]) == 1


@pytest.mark.parametrize("dof", [None, 4.0, 11.5])
def test_the_prior_gives_the_posterior_mean_of_scipy(loop, dof):
    scale = np.diag([1e-4, 2e-4, 3e-4])
    mixture = loop_mixture(loop, prior=InverseWishart(scale, dof))
    offsets = loop.killer_triangles[0] - loop.killer_triangles[0].mean(axis=0)
    posterior = invwishart(df=(dof or 5) + 2, scale=scale + offsets.T @ offsets)
    np.testing.assert_allclose(mixture.covariances[0], posterior.mean())


def test_the_posterior_is_bayes_rule():
    """Weights of prior draws by the likelihood of three vertices (mean integrated out) give the same mean covariance."""
    triangle = np.array([[0.0, 0.0], [1.0, 0.2], [0.3, 0.8]])
    offsets = triangle - triangle.mean(axis=0)
    scatter = offsets.T @ offsets
    draws = invwishart(df=6, scale=0.5 * np.eye(2)).rvs(200_000, random_state=0)
    traces = np.einsum("nij,ji->n", np.linalg.inv(draws), scatter)
    log_likelihood = -np.log(np.linalg.det(draws)) - 0.5 * traces  # 3 - 1 data
    weight = np.exp(log_likelihood - log_likelihood.max())
    expected = np.einsum("n,nij->ij", weight / weight.sum(), draws)
    np.testing.assert_allclose(InverseWishart(0.5, 6).posterior_mean(scatter), expected, atol=1e-3)


def test_a_value_of_zero_weighs_nothing(loop):
    weightless = loop_mixture(replace(loop, neighbour_values=0 * loop.neighbour_values))
    assert (weightless.weights[2:] == 0).all()
    assert np.isfinite(weightless.log_prob(loop.centre))


@pytest.mark.parametrize(
    ("call", "names"),
    [
        (lambda loop: LoopMixture([[0.0, 0.0]], [np.eye(3)], [1.0]), "mixture"),
        (lambda loop: LoopMixture([[0.0, 0.0]], [np.eye(2)], [0.4]), "mixture"),
        (lambda loop: LoopMixture([[0.0, 0.0]], [np.eye(2)], [0.5, 0.5]), "mixture"),
        (lambda loop: loop_mixture(replace(loop, killer_values=-loop.killer_values)), "-"),
        (lambda loop: loop_mixture(replace(loop, killer_values=np.full(2, np.nan))), "nan"),
        (lambda loop: loop_mixture(loop, noise=0), "noise"),
        (lambda loop: loop_mixture(loop, prior=InverseWishart(1e-4, 2.0)), "dof must be above 2"),
        (lambda loop: loop_mixture(loop, prior=InverseWishart(np.diag([1.0, 1.0, 0.0]))), "positive definite"),
        (lambda loop: loop_mixture(loop).log_prob([[0.0, 0.0]]), r"\(1, 2\)"),
    ],
)
def test_what_gives_no_density_is_named(loop, call, names):
    with pytest.raises(ValueError, match=names):  # an error of NumPy's Cholesky factors is a ValueError, too
        call(loop)
