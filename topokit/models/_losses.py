"""What training minimises: the paper's L2, the mixture's negative log-likelihood, presence, and the place of the mean.

Source: Antonova et al. 2021, section 5 (the L2 loss); slots are matched as in Carion et al. 2020 (DETR). Taught in chapter 10.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from topokit._config import NotNegative, checked

from ._states import States, Window, cheapest_order, loop_mixtures, past_states, sigma_points, target_states

POSITION, VALUE = 0.1, 0.02  # metres that count as one in the losses: of places, and of filtration values


@checked
class LossWeights:
    """Weights of the parts of the loss, and whether slots may be matched."""

    #: Squared errors of corners, values, birth, death, step of loops that are there (the paper's L2), the better way round.
    features: NotNegative = 1.0
    presence: NotNegative = 1.0  #: binary cross-entropy of the presence of each slot
    centre: NotNegative = 0.0  #: distance of the mixtures' means, with the square below 2 cm: jumps of labels pull less
    nll: NotNegative = 0.0  #: negative log-likelihood of the target mixture under the predicted one, nats
    now: NotNegative = 0.0  #: `features` of the present state, for a model that estimates it on its way
    #: Take the cheapest order of the slots for the whole horizon, not that of the labels: by mean lifetime over the history.
    match: bool = False


def forecast_loss(
    predicted: States,
    window: Window,
    weights: LossWeights,
    *,
    present: States | None = None,
    generator: torch.Generator | None = None,
) -> tuple[Tensor, dict[str, Tensor]]:
    """Loss of a batch; and for the log the same, its parts, and the mean distance of the mixtures' means in metres.

    Parameters
    ----------
    predicted : States
    window : mapping of str to Tensor
        The batch, labels included.
    weights : LossWeights
    present : States, optional
        A model's estimate of the present state, or a few of them, as steps.
    generator : torch.Generator, optional
        Draws the eight steps on which the log-likelihood is taken.
    """
    target = target_states(window)
    past = past_states(window)[:, [-1] * (1 if present is None else present.birth.shape[1])]
    if weights.match:
        order = match_slots(predicted, target)
        target, past = target.slots(order), past.slots(order)
    there = target.presence > 0
    gap = (predicted.mean - target.mean)[there].norm(dim=-1)
    parts = {
        "features": _features(predicted, target, there),
        "presence": functional.binary_cross_entropy_with_logits(predicted.presence, there.to(predicted.presence)),
        "centre": _mean(functional.huber_loss(gap / POSITION, torch.zeros_like(gap), delta=0.2, reduction="none")),
    }
    if weights.nll:
        steps = torch.randperm(there.shape[1], generator=generator)[:8].to(there.device)
        parts["nll"] = _nll(predicted[:, steps][there[:, steps]], target[:, steps][there[:, steps]])
    if weights.now and present is not None:
        parts["now"] = _features(present, past, past.presence > 0)
    total = torch.stack([getattr(weights, name) * part for name, part in parts.items()]).sum()
    parts = {"loss": total, **parts, "distance": _mean(gap)}
    return total, {name: part.detach() for name, part in parts.items()}


@torch.no_grad()
def match_slots(predicted: States, target: States) -> Tensor:
    """(B, S) which target slot each predicted slot should have, the same for all steps; the cheapest of all orders.

    Parameters
    ----------
    predicted, target : States
    """
    there = (target.presence > 0).to(predicted.presence)  # (B, K, S)
    apart = torch.cdist(predicted.mean, target.mean) / POSITION  # (B, K, predicted, target)
    logit = predicted.presence[..., :, None]
    wrong = functional.softplus(logit) - logit * there[..., None, :]  # cross-entropy of every pair
    return cheapest_order((apart.clamp_max(5.0) * there[..., None, :] + wrong).mean(dim=1))


def _features(predicted: States, target: States, there: Tensor) -> Tensor:
    """Mean over the loops that are there of the mean squared errors of their features."""
    predicted, target = predicted[there], target[there]
    numbers, truth = (torch.stack([part.birth, part.death, part.step], dim=-1) for part in (predicted, target))
    error = ((numbers - truth) / VALUE).square().mean(dim=-1)
    return _mean(error + torch.minimum(_edge_errors(predicted, target), _edge_errors(predicted, target.reversed())))


def _edge_errors(predicted: States, target: States) -> Tensor:
    counts = torch.cat([torch.ones_like(target.corners[..., :4, 0]), (target.neighbour_values > 0).float()], dim=-1)
    places = ((predicted.corners - target.corners) / POSITION).square().sum(dim=-1)
    values = ((predicted.neighbour_values - target.neighbour_values) / VALUE).square().mean(dim=-1)
    return (places * counts).sum(dim=-1) / counts.sum(dim=-1) + values


def _nll(predicted: States, target: States) -> Tensor:
    """Cross-entropy of the target mixtures relative to the predicted ones, by the targets' sigma points."""
    if not len(target.birth):
        return predicted.birth.sum()
    points, weight = sigma_points(target.triangles, target.values)  # (n, 18, 3), (n, 18)
    mixtures = loop_mixtures(predicted.triangles, predicted.values)
    return _mean(-(weight * mixtures.log_prob(points.transpose(0, 1)).transpose(0, 1)).sum(dim=-1))


def _mean(errors: Tensor) -> Tensor:
    """Mean, and zero (with a gradient) of nothing: a batch may have no loop."""
    return errors.sum() / max(errors.numel(), 1)
