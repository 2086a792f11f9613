"""Loops as probability: a Gaussian mixture as the density of a loop's place.

Idea: the triangles around a loop's killer are samples of where the loop closes last. Each triangle gives one Gaussian: its mean
is the barycentre of the triangle, its covariance is that of the three vertices, and its weight is the filtration value.

Source: Antonova et al. 2021, section 5, equation 1. Taught in chapter 12. `topokit.models.loop_mixtures` computes the same
density for batches of tensors, and is differentiable.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ._validate import Array, as_points, own_arrays, positive

if TYPE_CHECKING:
    from .seqph import Loop

__all__ = ["InverseWishart", "LoopMixture", "loop_mixture"]


@dataclass(frozen=True, eq=False)
class InverseWishart:
    """The inverse-Wishart prior of a component's covariance in d dimensions.

    The data are the three vertices of the component's triangle. Their scatter A is the sum of the outer products of their
    offsets from their mean. With a flat prior on the mean, the posterior of the covariance is inverse-Wishart(scale + A,
    dof + 2), whose mean is (scale + A) / (dof + 1 - d).
    """

    #: positive definite matrix (d, d), square metres; a number is that multiple of the identity. The prior's mean is
    #: scale / (dof - d - 1)
    scale: ArrayLike
    #: degrees of freedom, above d - 1. When not given d + 2, the smallest whole number for which the prior has a mean, `scale`
    dof: float | None = None

    def posterior_mean(self, scatter: Array) -> Array:
        """Return the mean covariance (..., d, d), given the scatter (..., d, d) of three vertices."""
        d = scatter.shape[-1]
        dof = d + 2.0 if self.dof is None else self.dof
        if not dof > d - 1:
            raise ValueError(f"dof must be above {d - 1} in {d} dimensions, not {dof}")
        scale = np.asarray(self.scale, dtype=np.float64)
        if scale.ndim == 0:
            scale = scale * np.eye(d)
        np.linalg.cholesky(scale)  # raises unless the scale is positive definite
        return np.asarray((scale + scatter) / (dof + 1 - d))


@dataclass(frozen=True, eq=False)
class LoopMixture:
    """A Gaussian mixture of m components in d dimensions."""

    means: Array  #: (m, d) barycentres of the triangles, killer triangles first
    covariances: Array  #: (m, d, d)
    weights: Array  #: (m,) weights of the components, which sum to one

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            object.__setattr__(self, name, np.asarray(value, dtype=np.float64))
        m, d = self.means.shape
        if self.covariances.shape != (m, d, d) or self.weights.shape != (m,):
            needed = "means (m, d), covariances (m, d, d) and weights (m,)"
            shapes = f"{self.means.shape}, {self.covariances.shape}, {self.weights.shape}"
            raise ValueError(f"a mixture needs {needed}, not {shapes}")
        if not (self.weights >= 0).all() or not np.isclose(self.weights.sum(), 1):
            raise ValueError(f"the weights of a mixture are not negative and sum to 1, not {self.weights.tolist()}")
        own_arrays(self)

    def __repr__(self) -> str:
        mean = np.array2string(self.mean, precision=3, separator=", ")
        return f"LoopMixture({len(self.weights)} components, mean={mean})"

    @property
    def mean(self) -> Array:
        """Return the mean (d,) of the whole mixture."""
        return np.asarray(self.weights @ self.means)

    @property
    def covariance(self) -> Array:
        """Return the covariance (d, d) of the whole mixture: within the components, and between their means."""
        offsets = self.means - self.mean
        between = offsets[:, :, None] * offsets[:, None, :]
        return np.asarray(np.einsum("m,mij->ij", self.weights, self.covariances + between))

    def sample(self, n: int, rng: np.random.Generator | int | None = None) -> Array:
        """Draw `n` points from the mixture and return them, (n, d).

        Parameters
        ----------
        n : int
        rng : numpy.random.Generator or int, optional
        """
        generator = np.random.default_rng(rng)

        # Draw a component for each point, then a standard normal vector, and multiply it by the component's Cholesky factor.
        component = generator.choice(len(self.weights), size=n, p=self.weights)
        white = generator.standard_normal((n, self.means.shape[1], 1))
        factor = np.linalg.cholesky(self.covariances)
        return np.asarray(self.means[component] + (factor[component] @ white)[..., 0])

    def log_prob(self, x: ArrayLike) -> Array:
        """Return the natural logarithm (n,) of the density at points `x` (n, d); for one point (d,) it is a scalar."""
        is_point = np.ndim(x) == 1
        points = as_points(np.atleast_2d(np.asarray(x)), "x")
        d = self.means.shape[1]
        if points.shape[1] != d:
            raise ValueError(f"x must be a ({d},) point or (n, {d}) points, not an array of shape {np.shape(x)}")

        # Whiten the offsets: solve (Cholesky factor) @ white = offset. Then |white|^2 is the squared Mahalanobis distance.
        factor = np.linalg.cholesky(self.covariances)  # (m, d, d)
        offsets = points[:, None] - self.means  # (n, m, d)
        white = np.linalg.solve(factor, offsets.transpose(1, 2, 0))  # (m, d, n)
        log_norm = np.log(np.einsum("mii->mi", factor)).sum(axis=1) + d / 2 * np.log(2 * np.pi)  # (m,)
        with np.errstate(divide="ignore"):  # log 0 = -inf: a component of weight 0 adds nothing
            terms = np.log(self.weights) - log_norm - (white**2).sum(axis=1).T / 2  # (n, m)
        log_density = np.logaddexp.reduce(terms, axis=1)
        return np.asarray(log_density[0] if is_point else log_density)

    def density(self, n: int = 48, *, extent: float = 3.0) -> tuple[tuple[Array, ...], Array]:
        """Return a grid of n places along each of the d axes, d arrays (n,), and the density (n,) * d on it ("ij" of a meshgrid).

        Parameters
        ----------
        n : int
        extent : float
            How many standard deviations of every component, on either side of its mean, the grid covers.
        """
        reach = extent * np.sqrt(np.einsum("mii->mi", self.covariances))
        low = (self.means - reach).min(axis=0)
        high = (self.means + reach).max(axis=0)
        axes = tuple(np.linspace(start, end, n) for start, end in zip(low, high, strict=True))
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        values = np.exp(self.log_prob(grid.reshape(-1, len(axes))))
        return axes, values.reshape(grid.shape[:-1])

    def credibility(self, x: ArrayLike, *, n: int = 4096, rng: np.random.Generator | int | None = 0) -> Array:
        """Return the probability (n,) of the smallest region of highest density that reaches each point of `x`.

        It is 0 at the mode and 1 far away, and is estimated by the share of samples whose density is above that of the point.
        If mixtures are calibrated, the credibilities of true places are uniform: a share q of them lies below q.

        Parameters
        ----------
        x : (n, d) array_like
        n : int
            How many samples the estimate uses.
        rng : numpy.random.Generator or int, optional
        """
        samples = self.sample(n, rng)
        ranked = np.sort(self.log_prob(samples))
        not_above = np.searchsorted(ranked, self.log_prob(x), side="right")
        return np.asarray(1 - not_above / n)


def loop_mixture(loop: Loop, noise: float = 1e-4, prior: InverseWishart | None = None) -> LoopMixture:
    """Return the Gaussian mixture of a loop, with a component for each killer triangle and each neighbouring one.

    Parameters
    ----------
    loop : Loop
    noise : float
        Variance added to the diagonal of every sample covariance, square metres. A triangle is flat: without the noise its
        covariance is singular and the Gaussian has no density. The default is 1 cm squared. A prior replaces the noise.
    prior : InverseWishart, optional
        When given, the covariances are the posterior means under this prior.

    Raises
    ------
    ValueError
        When the shapes of the loop's arrays do not fit each other, or its filtration values are negative or all zero, or the
        noise is not positive.

    Examples
    --------
    >>> import topokit as tk
    >>> loop = tk.SeqPH(alpha=0.1).update([[0, 0], [2, 0], [2, 2], [0, 2]]).loops[0]
    >>> mixture = tk.loop_mixture(loop, noise=0.01)
    >>> mixture.mean.round(6).tolist(), len(mixture.weights)
    ([1.0, 1.0], 6)
    """
    triangles = np.concatenate([loop.killer_triangles, loop.neighbours]).astype(np.float64)
    values = np.concatenate([loop.killer_values, loop.neighbour_values]).astype(np.float64)
    if not (values >= 0).all() or not values.sum() > 0:
        raise ValueError(f"filtration values must be 0 or more, and one of them more, not {values.tolist()}")

    # Equation 1: a component for each triangle. The sample covariance divides by 2: three vertices less one for their mean.
    means, scatter = moments(triangles)
    if prior is None:
        covariances = scatter / 2 + positive(noise, "noise", zero=False) * np.eye(triangles.shape[2])
    else:
        covariances = prior.posterior_mean(scatter)
    return LoopMixture(means, covariances, values / values.sum())


def moments(triangles: Any) -> tuple[Any, Any]:
    """Return the barycentres (..., d) of triangles (..., 3, d), of NumPy or PyTorch, and the scatter (..., d, d) of corners."""
    means = triangles.mean(axis=-2)
    offsets = triangles - means[..., None, :]
    return means, offsets.swapaxes(-1, -2) @ offsets
