"""States as tensors, every loop as eight corners and a few numbers; their mixtures, and the losses that training minimises.

Idea: the two killer triangles share the killer edge, and a neighbour shares an edge with one of them. So six triangles have
eight corners: the ends x, y of the killer edge, the apexes z1 (thick), z2, and an apex a neighbour. Predicting corners keeps
triangles that share an edge together and is half the size.

Source: Antonova et al. 2021, section 5 (the L2 loss) and equation 1; slots as in Carion et al. 2020. Taught in chapters 10, 11.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.distributions import Categorical, MixtureSameFamily, MultivariateNormal
from torch.nn import functional

from topokit._config import NotNegative, checked
from topokit.mixture import moments

TRIANGLES = ((0, 1, 2), (0, 1, 3), (0, 2, 4), (2, 1, 5), (0, 3, 6), (3, 1, 7))  # x y z1, x y z2, then the neighbours
_OTHER_WAY = ([1, 0, 2, 3, 5, 4, 7, 6], [1, 0, 3, 2])  # corners and neighbours when x and y change places
NUMBERS = 32  # of a loop: 8 corners, 4 neighbour values, birth, lifetime, killer_shift, presence
NOISE = 1e-4  # square metres that a mixture's covariances have more than their triangles', where nobody says otherwise
POSITION, VALUE = 0.1, 0.02  # metres that count as one in the losses: of places, and of filtration values
PAST = tuple(f"past_{name}" for name in ("triangles", "values", "birth", "death", "killer_shift", "present"))
Window = Mapping[str, Tensor]  # a batch of windows, as of `topokit.data.WindowDataset`


@dataclass(frozen=True, eq=False)
class States:
    """States of B sequences, K steps, S slots. Metres; a slot without a loop holds zeros or what the model thinks."""

    corners: Tensor  #: (B, K, S, 8, 3) x, y, z1, z2 and the neighbours' apexes, in the order of `TRIANGLES`
    neighbour_values: Tensor  #: (B, K, S, 4) filtration values, 0 where there is no neighbour; the killers' are `death`
    birth: Tensor  #: (B, K, S)
    death: Tensor  #: (B, K, S)
    killer_shift: Tensor  #: (B, K, S)
    presence: Tensor  #: (B, K, S) logit of the loop being there
    noise: Tensor  #: (B, K, S) square metres, what the mixtures' covariances have more than the triangles'

    @property
    def triangles(self) -> Tensor:
        """(B, K, S, 6, 3, 3) the killer triangles, thick first, and the neighbours."""
        return self.corners[..., torch.tensor(TRIANGLES, device=self.corners.device), :]

    @property
    def values(self) -> Tensor:
        """(B, K, S, 6) filtration values of the triangles."""
        return torch.cat([self.death[..., None], self.death[..., None], self.neighbour_values], dim=-1)

    @property
    def mean(self) -> Tensor:
        """(B, K, S, 3) mean of the mixture; a loop's `centre` is another place, the middle of its killer triangles alone."""
        weights = self.values / self.values.sum(dim=-1, keepdim=True).clamp_min(1e-9)
        shares = functional.one_hot(torch.tensor(TRIANGLES), 8).sum(dim=1).to(weights) / 3  # of corners in barycentres
        return ((weights @ shares)[..., None, :] @ self.corners)[..., 0, :]

    def reversed(self) -> States:
        """The same loops with the ends of their killer edges the other way round."""
        corners, neighbours = _OTHER_WAY
        values = self.neighbour_values[..., neighbours]
        return self.replace(corners=self.corners[..., corners, :], neighbour_values=values)

    def replace(self, **parts: Tensor) -> States:
        """A copy with other parts."""
        return dataclasses.replace(self, **parts)

    def __getitem__(self, index: Any) -> States:
        """Index all parts alike, along the leading dimensions."""
        return self.each(lambda part: part[index])

    def slots(self, order: Tensor) -> States:
        """The slots in another order (B, S) for every sequence."""
        index = order[:, None]
        return self.each(lambda part: part.take_along_dim(index.reshape(*index.shape, *(1,) * (part.dim() - 3)), dim=2))

    def each(self, change: Callable[[Tensor], Tensor]) -> States:
        """Every part changed alike."""
        return States(*(change(part) for part in vars(self).values()))


def corners_of(triangles: Tensor, values: Tensor) -> tuple[Tensor, Tensor]:
    """Corners (..., 8, 3) and neighbour values (..., 4) of labels: triangles (..., 6, 3, 3) and values (..., 6).

    Labels list the neighbours without gaps, so the outer edge says which it is. The apex of an absent one is that edge's middle.
    """
    corners = torch.cat([triangles[..., 0, :, :], triangles[..., 1, 2:, :]], dim=-2)  # x y z1, z2
    edges = torch.tensor([triangle[:2] for triangle in TRIANGLES[2:]], device=triangles.device)
    outer = corners[..., edges, :]  # (..., 4 edges, 2, 3)
    found = triangles[..., 2:, :, :]  # (..., 4 neighbours, 3, 3)
    gap = (found[..., :, None, :2, :] - outer[..., None, :, :, :]).abs().sum(dim=(-1, -2))  # (..., neighbour, edge)
    present = values[..., 2:] > 0
    stands = functional.one_hot(gap.argmin(dim=-1), 4).to(triangles) * present[..., None].to(triangles)
    neighbour_values = (stands * values[..., 2:, None]).sum(dim=-2)
    apexes = stands.transpose(-1, -2) @ found[..., 2, :]
    apexes = torch.where((neighbour_values > 0)[..., None], apexes, outer.mean(dim=-2))
    return torch.cat([corners, apexes], dim=-2), neighbour_values


def target_states(window: Window) -> States:
    """What should be predicted for a batch of windows."""
    shift, presence = torch.nan_to_num(window["killer_shift"]), torch.where(window["present"], 20.0, -20.0)
    corners, neighbour_values = corners_of(window["triangles"], window["values"])
    birth = window["birth"]
    return States(corners, neighbour_values, birth, window["death"], shift, presence, torch.full_like(birth, NOISE))


def past_states(window: Window) -> States:
    """What the tracker saw in the history of a batch of windows."""
    return target_states({name.removeprefix("past_"): window[name] for name in PAST})


def loop_mixtures(triangles: Tensor, values: Tensor, noise: float | Tensor = NOISE) -> MixtureSameFamily:
    """Mixtures of a batch of loops, by the formula of `topokit.loop_mixture`.

    Parameters
    ----------
    triangles : (..., m, 3, 3)
    values : (..., m)
        Filtration values of the triangles, not negative; 0 for one that is absent.
    noise : float or Tensor (...)
        Added to the diagonal of every sample covariance, square metres.
    """
    means, scatter = moments(triangles)
    more = torch.as_tensor(noise, dtype=triangles.dtype, device=triangles.device)[..., None, None, None]
    covariances = scatter / 2 + more * torch.eye(triangles.shape[-1]).to(triangles)
    components = MultivariateNormal(means, covariances, validate_args=False)
    weights = Categorical(probs=values.clamp_min(1e-12), validate_args=False)
    return MixtureSameFamily(weights, components, validate_args=False)


@checked
class LossWeights:
    """Weights of the parts of the loss, and whether slots may be matched."""

    #: Squared errors of corners, values, birth, death and killer_shift of loops that are there (the paper's L2), the better
    #: way round.
    features: NotNegative = 1.0
    presence: NotNegative = 1.0  #: binary cross-entropy of the presence of each slot
    centre: NotNegative = 0.0  #: distance of the mixtures' means, with the square below 2 cm: jumps of labels pull less
    #: Take the cheapest order of the slots for the whole horizon, not that of the labels: by mean lifetime over the history.
    match: bool = False


def forecast_loss(predicted: States, window: Window, weights: LossWeights) -> tuple[Tensor, dict[str, Tensor]]:
    """Loss of a batch; and for the log the same, its parts, and the mean distance of the mixtures' means in metres.

    Parameters
    ----------
    predicted : States
    window : mapping of str to Tensor
        The batch, labels included.
    weights : LossWeights
    """
    target = target_states(window)
    if weights.match:
        target = target.slots(match_slots(predicted, target))
    there = target.presence > 0
    gap = (predicted.mean - target.mean)[there].norm(dim=-1)
    parts = {
        "features": _features(predicted, target, there),
        "presence": functional.binary_cross_entropy_with_logits(predicted.presence, there.to(predicted.presence)),
        "centre": _mean(functional.huber_loss(gap / POSITION, torch.zeros_like(gap), delta=0.2, reduction="none")),
    }
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
    cost = (apart.clamp_max(5.0) * there[..., None, :] + wrong).mean(dim=1)  # (B, predicted, target)
    slots = cost.shape[-1]
    orders = torch.tensor(list(itertools.permutations(range(slots))), device=cost.device)  # (S!, S)
    totals = cost[:, torch.arange(slots, device=cost.device), orders].sum(dim=-1)  # (B, S!)
    return orders[totals.argmin(dim=-1)]


def _features(predicted: States, target: States, there: Tensor) -> Tensor:
    """Mean over the loops that are there of the mean squared errors of their features."""
    predicted, target = predicted[there], target[there]
    numbers, truth = (torch.stack([part.birth, part.death, part.killer_shift], dim=-1) for part in (predicted, target))
    error = ((numbers - truth) / VALUE).square().mean(dim=-1)
    return _mean(error + torch.minimum(_edge_errors(predicted, target), _edge_errors(predicted, target.reversed())))


def _edge_errors(predicted: States, target: States) -> Tensor:
    counts = torch.cat([torch.ones_like(target.corners[..., :4, 0]), (target.neighbour_values > 0).float()], dim=-1)
    places = ((predicted.corners - target.corners) / POSITION).square().sum(dim=-1)
    values = ((predicted.neighbour_values - target.neighbour_values) / VALUE).square().mean(dim=-1)
    return (places * counts).sum(dim=-1) / counts.sum(dim=-1) + values


def _mean(errors: Tensor) -> Tensor:
    """Mean, and zero (with a gradient) of nothing: a batch may have no loop."""
    return errors.sum() / max(errors.numel(), 1)
