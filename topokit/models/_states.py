"""States as tensors, every loop as eight corners and a few numbers; their mixtures, and the losses that training minimises.

Idea: the two killer triangles share the killer edge, and each neighbour shares an edge with one of them. So six triangles have
eight corners: the ends x, y of the killer edge, the apexes z1 (thick) and z2 of the killer triangles, and one apex for each of
the four neighbours. Triangles that share an edge stay together when corners are predicted, and there are half as many numbers.

Source: Antonova et al. 2021, section 5 (the L2 loss) and equation 1; slots as in Carion et al. 2020. Taught in chapters 12, 13.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.distributions import Categorical, MixtureSameFamily, MultivariateNormal
from torch.nn import functional

from topokit.mixture import LoopMixture, moments
from topokit.seqph import TopologicalState

TRIANGLES = ((0, 1, 2), (0, 1, 3), (0, 2, 4), (2, 1, 5), (0, 3, 6), (3, 1, 7))  # x y z1, x y z2, then the neighbours
NUMBERS = 32  # numbers that describe a loop: 8 corners, 4 neighbour values, birth, lifetime, killer_shift, presence
NOISE = 1e-4  # square metres; added to the covariances of a mixture's triangles when a forecast gives no other value
Window = Mapping[str, Tensor]  # a batch of windows, as `topokit.data.WindowDataset` makes them


@dataclass(frozen=True, eq=False)
class StateTensors:
    """States of B sequences, K steps, S slots, in metres. An empty slot holds zeros, or the predictions of a model for it.

    The forecast of a `Predictor` under a single plan has no leading axis of B.
    """

    corners: Tensor  #: corners (B, K, S, 8, 3): x, y, z1, z2 and the neighbours' apexes
    #: Filtration values (B, K, S, 4) of the neighbours, 0 where there is none; the value of the killers is `death`.
    neighbour_values: Tensor
    birth: Tensor  #: births (B, K, S)
    death: Tensor  #: deaths (B, K, S)
    killer_shift: Tensor  #: Hausdorff distances (B, K, S) between the killer edge and that of the step before
    presence: Tensor  #: logits (B, K, S) of the presence of the loop
    noise: Tensor  #: variances (B, K, S) added to the covariances of the mixture's triangles, square metres

    @classmethod
    def from_labels(cls, window: Window) -> StateTensors:
        """Return the states to predict for a batch of windows."""
        # Most slots are empty: only loops that are present have corners to compute.
        present = window["present"]
        triangles = window["triangles"]
        corners = triangles.new_zeros(*present.shape, 8, 3)
        neighbour_values = triangles.new_zeros(*present.shape, 4)
        corners[present], neighbour_values[present] = corners_of(triangles[present], window["values"][present])
        return cls(
            corners=corners,
            neighbour_values=neighbour_values,
            birth=window["birth"],
            death=window["death"],
            killer_shift=torch.nan_to_num(window["killer_shift"]),
            presence=torch.where(present, 20.0, -20.0),
            noise=torch.full_like(window["birth"], NOISE),
        )

    @classmethod
    def from_past(cls, window: Window) -> StateTensors:
        """Return the states that the tracker found in the history of a batch of windows."""
        names = ("triangles", "values", "birth", "death", "killer_shift", "present")
        return cls.from_labels({name: window[f"past_{name}"] for name in names})

    @property
    def lifetime(self) -> Tensor:
        """Return death - birth (B, K, S)."""
        return self.death - self.birth

    @property
    def triangles(self) -> Tensor:
        """Return the triangles (B, K, S, 6, 3, 3): the killer triangles, thick first, and the neighbours."""
        return self.corners[..., torch.tensor(TRIANGLES), :]

    @property
    def values(self) -> Tensor:
        """Return the filtration values (B, K, S, 6) of the triangles."""
        return torch.cat([self.death[..., None], self.death[..., None], self.neighbour_values], dim=-1)

    @property
    def mean(self) -> Tensor:
        """Return the mean (B, K, S, 3) of the mixture; a loop's `centre` is another place, the middle of its killer triangles."""
        weights = self.values / self.values.sum(dim=-1, keepdim=True).clamp_min(1e-9)  # (B, K, S, 6)
        # Compute each corner's share in the barycentres of the six triangles.
        shares = functional.one_hot(torch.tensor(TRIANGLES), 8).sum(dim=1).to(weights) / 3  # (6, 8)
        return ((weights @ shares)[..., None, :] @ self.corners)[..., 0, :]  # (B, K, S, 3)

    def mixtures(self, step: int) -> dict[int, LoopMixture]:
        """Return by slot the mixtures of the loops of a step that are more likely present than not, longest lifetime first.

        The states are those of a single sequence. Step 0 is the next frame.
        """
        now = self[step].map(Tensor.double)
        mixtures: Any = loop_mixtures(now.triangles, now.values, now.noise)
        weights = mixtures.mixture_distribution.probs
        components = mixtures.component_distribution
        order = now.lifetime.argsort(descending=True, stable=True).tolist()
        return {
            slot: LoopMixture(components.loc[slot], components.covariance_matrix[slot], weights[slot])
            for slot in order
            if now.presence[slot] > 0
        }

    def reversed(self) -> StateTensors:
        """Return the same loops with the ends of their killer edges exchanged."""
        return self.replace(
            corners=self.corners[..., [1, 0, 2, 3, 5, 4, 7, 6], :],
            neighbour_values=self.neighbour_values[..., [1, 0, 3, 2]],
        )

    def replace(self, **parts: Tensor) -> StateTensors:
        """Return a copy with other parts."""
        return dataclasses.replace(self, **parts)

    def padded(self, slots: int) -> StateTensors:
        """Return the states (K, S) of a single sequence with empty slots after the others, so many in all."""
        parts = {}
        for name, part in vars(self).items():
            empty = {"presence": -20.0, "noise": NOISE}.get(name, 0.0)
            missing = part.new_full((len(part), slots - part.shape[1], *part.shape[2:]), empty)
            parts[name] = torch.cat([part, missing], dim=1)
        return StateTensors(**parts)

    def __getitem__(self, index: Any) -> StateTensors:
        """Index all parts alike, along the leading dimensions."""
        return self.map(lambda part: part[index])

    def map(self, change: Callable[[Tensor], Tensor]) -> StateTensors:
        """Return a copy with every part changed alike."""
        return StateTensors(*(change(part) for part in vars(self).values()))

    @torch.no_grad()
    def matched_to(self, predicted: StateTensors) -> StateTensors:
        """Return these target states with their slots in the order that fits a prediction best over all steps."""
        present = (self.presence > 0).to(predicted.presence)[..., None, :]  # (B, K, 1, S)
        distance = torch.cdist(predicted.mean, self.mean) / 0.1  # (B, K, predicted, target)
        # The cross-entropy of the presence of every pair.
        logit = predicted.presence[..., None]
        entropy = functional.softplus(logit) - logit * present
        cost = (distance.clamp_max(5.0) * present + entropy).mean(dim=1)  # (B, predicted, target)

        # Take the cheapest of all orders.
        slots = torch.arange(cost.shape[-1])
        orders = torch.tensor(list(itertools.permutations(slots.tolist())))  # (S!, S)
        best = orders[cost[:, slots, orders].sum(dim=-1).argmin(dim=-1)]  # (B, S)
        sequence = torch.arange(len(best))[:, None, None]
        step = torch.arange(self.birth.shape[1])[:, None]
        return self.map(lambda part: part[sequence, step, best[:, None]])


def past_of(states: Sequence[TopologicalState], slots: int) -> Window:
    """Return the states' loops with the longest mean lifetimes as the entries `past_...` of a window, (1, h, slots, ...)."""
    total: defaultdict[int, float] = defaultdict(float)
    for state in states:
        for loop in state.loops:
            total[loop.id] += loop.lifetime
    longest = sorted(total, key=total.__getitem__, reverse=True)[:slots]

    sizes = {"triangles": (6, 3, 3), "values": (6,), "birth": (), "death": (), "killer_shift": ()}
    past = {name: torch.zeros(1, len(states), slots, *size) for name, size in sizes.items()}
    past["present"] = torch.zeros(1, len(states), slots, dtype=torch.bool)
    for frame, state in enumerate(states):
        for loop in state.loops:
            if loop.id not in longest:
                continue
            place = (0, frame, longest.index(loop.id))
            n = 2 + len(loop.neighbours)
            past["triangles"][place][:n] = torch.tensor(np.concatenate([loop.killer_triangles, loop.neighbours]))
            past["values"][place][:n] = torch.tensor(np.concatenate([loop.killer_values, loop.neighbour_values]))
            for name in ("birth", "death", "killer_shift"):
                past[name][place] = getattr(loop, name)
            past["present"][place] = True
    return {f"past_{name}": part for name, part in past.items()}


def corners_of(triangles: Tensor, values: Tensor) -> tuple[Tensor, Tensor]:
    """Return corners (N, 8, 3) and neighbour values (N, 4) of labels: triangles (N, 6, 3, 3) and values (N, 6).

    A neighbour is identified by the edge that it shares. The apex of an absent neighbour is the middle of that edge.
    """
    corners = torch.cat([triangles[:, 0], triangles[:, 1, 2:]], dim=1)  # (N, 4, 3): x, y, z1, z2
    outer = corners[:, [triangle[:2] for triangle in TRIANGLES[2:]]]  # (N, 4 edges, 2, 3)

    # Assign each listed neighbour to the outer edge that its first two vertices are.
    listed = triangles[:, 2:]  # (N, 4 neighbours, 3, 3)
    gap = (listed[:, :, None, :2] - outer[:, None]).abs().sum(dim=(-2, -1))  # (N, neighbour, edge)
    present = (values[:, 2:] > 0).to(triangles)
    assigned = functional.one_hot(gap.argmin(dim=-1), 4).to(triangles) * present[..., None]

    neighbour_values = (assigned * values[:, 2:, None]).sum(dim=1)  # (N, 4)
    apexes = assigned.mT @ listed[:, :, 2]  # (N, 4, 3)
    apexes = torch.where((neighbour_values > 0)[..., None], apexes, outer.mean(dim=2))
    return torch.cat([corners, apexes], dim=1), neighbour_values


def loop_mixtures(triangles: Tensor, values: Tensor, noise: float | Tensor = NOISE) -> MixtureSameFamily:
    """Return the mixtures of a batch of loops: `topokit.loop_mixture`, batched and differentiable.

    Parameters
    ----------
    triangles : (..., m, 3, 3)
    values : (..., m)
        Filtration values of the triangles, not negative; 0 for one that is absent.
    noise : float or Tensor (...)
        Variance added to the diagonal of every sample covariance, square metres.
    """
    means, scatter = moments(triangles)  # (..., m, 3), (..., m, 3, 3)
    noise = torch.as_tensor(noise, dtype=triangles.dtype, device=triangles.device)
    covariances = scatter / 2 + noise[..., None, None, None] * torch.eye(triangles.shape[-1]).to(triangles)
    components = MultivariateNormal(means, covariances, validate_args=False)
    weights = Categorical(probs=values.clamp_min(1e-12), validate_args=False)
    return MixtureSameFamily(weights, components, validate_args=False)


def forecast_loss(
    predicted: StateTensors,
    window: Window,
    *,
    centre: float = 0.0,
    match: bool = False,
) -> tuple[Tensor, dict[str, Tensor]]:
    """Return the loss of a batch, and for the log the loss, its parts, and the mean distance of the mixtures' means in metres.

    The *features* are the squared errors of corners, values, birth, death and killer shift of the present loops (the paper's L2).
    The ends of a killer edge are taken in the order that fits better. Lengths of 10 cm, and filtration values of 2 cm, count as
    one. Added to these is the binary cross-entropy of the *presence* of each slot.

    Parameters
    ----------
    predicted : StateTensors
    window : mapping of str to Tensor
        Batch with its labels.
    centre : float
        Weight of the Huber loss of the distance of the mixtures' means, quadratic below 2 cm.
    match : bool
        Whether to compare with the target slots in the cheapest order over the whole horizon, instead of the labels' order.
    """
    target = StateTensors.from_labels(window)
    if match:
        target = target.matched_to(predicted)
    present = target.presence > 0  # (B, K, S)
    distance = (predicted.mean - target.mean)[present].norm(dim=-1)
    off = functional.huber_loss(distance / 0.1, torch.zeros_like(distance), delta=0.2, reduction="none")
    parts = {
        "features": _features_error(predicted[present], target[present]),
        "presence": functional.binary_cross_entropy_with_logits(predicted.presence, present.to(predicted.presence)),
        "centre": _mean(off),
    }
    total = parts["features"] + parts["presence"] + centre * parts["centre"]
    logged = {"loss": total, **parts, "distance": _mean(distance)}
    return total, {name: part.detach() for name, part in logged.items()}


def _features_error(predicted: StateTensors, target: StateTensors) -> Tensor:
    """Return the mean over N loops of the mean squared errors of their features."""
    numbers = torch.stack([predicted.birth, predicted.death, predicted.killer_shift], dim=-1)  # (N, 3)
    truth = torch.stack([target.birth, target.death, target.killer_shift], dim=-1)
    error = ((numbers - truth) / 0.02).square().mean(dim=-1)
    # A killer edge has no direction: take the order of its ends that fits better.
    forwards = _corners_error(predicted, target)
    backwards = _corners_error(predicted, target.reversed())
    return _mean(error + torch.minimum(forwards, backwards))


def _corners_error(predicted: StateTensors, target: StateTensors) -> Tensor:
    """Return the mean squared errors of N loops' corners and neighbour values; apexes of absent neighbours do not count."""
    killers = torch.ones_like(target.corners[..., :4, 0])
    neighbours = (target.neighbour_values > 0).float()
    counts = torch.cat([killers, neighbours], dim=-1)  # (N, 8)
    squares = ((predicted.corners - target.corners) / 0.1).square().sum(dim=-1)  # (N, 8)
    values = ((predicted.neighbour_values - target.neighbour_values) / 0.02).square().mean(dim=-1)
    return (squares * counts).sum(dim=-1) / counts.sum(dim=-1) + values


def _mean(errors: Tensor) -> Tensor:
    """Return the mean; for a batch without a loop, a zero that has a gradient."""
    return errors.sum() / max(errors.numel(), 1)
