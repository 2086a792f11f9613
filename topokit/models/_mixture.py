"""The mixture of a loop, batched and differentiable: `topokit.loop_mixture` in torch.

Source: Antonova et al. 2021, equation 1. Taught in chapter 9.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.distributions import Categorical, MixtureSameFamily, MultivariateNormal

from topokit.mixture import moments


def loop_mixtures(triangles: Tensor, values: Tensor, noise: float = 1e-4) -> MixtureSameFamily:
    """Mixtures of a batch of loops, by the formula of `topokit.loop_mixture`.

    Parameters
    ----------
    triangles : (..., m, 3, 3)
    values : (..., m)
        Filtration values of the triangles, not negative; 0 for one that is absent.
    noise : float
        Added to the diagonal of every sample covariance, square metres.
    """
    means, scatter = moments(triangles)
    covariances = scatter / 2 + noise * torch.eye(triangles.shape[-1]).to(triangles)
    components = MultivariateNormal(means, covariances, validate_args=False)
    weights = Categorical(probs=values.clamp_min(1e-12), validate_args=False)
    return MixtureSameFamily(weights, components, validate_args=False)


def sigma_points(triangles: Tensor, values: Tensor) -> tuple[Tensor, Tensor]:
    """Points (..., 3 m, 3) and weights (..., 3 m) that have mean and covariance (without noise) of each component.

    The vertices drawn away from the barycentre by sqrt(3/2): their population covariance is then the sample covariance.
    """
    mean = triangles.mean(dim=-2, keepdim=True)
    points = (mean + 1.5**0.5 * (triangles - mean)).flatten(-3, -2)
    weights = (values / values.sum(dim=-1, keepdim=True).clamp_min(1e-12)).repeat_interleave(3, dim=-1) / 3
    return points, weights
