"""The two networks of the paper, as far as it describes them: inputs and outputs are in the coordinates of the room.

Source: Antonova et al. 2021, section 5; Qi, Su, Mo, Guibas 2017, *PointNet* (a network shared by all points, then the maximum
over them), without its transforms of the input. Taught in chapter 13.
"""

import itertools
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from ._baselines import Context, Normalisation, PredictiveModel, Shape, carried_middle
from ._states import NUMBERS, StateTensors

HIDDEN = (512, 512, 256, 128)  # units of the paper's hidden layers
POINT_UNITS = (64, 64, 96)  # units of the layers that all points share; as published 64, 64, 64, 128, 1024
_CLOUDS_AT_ONCE = 8


class _LinearMaximum(torch.autograd.Function):
    """A linear layer and the maximum of its codes over the points of each cloud: (N, P, in) to (N, out).

    Idea: of all points of a cloud, one has the largest code in a unit, and the gradient of that unit passes through this point
    alone. So the gradient costs a P-th of the one that a linear layer and a maximum have, one after the other.
    """

    @staticmethod
    def forward(ctx: Any, codes: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        units = (codes @ weight.t()).transpose(1, 2)
        # As a pooling, which is far quicker than `max`.
        largest, chosen = functional.adaptive_max_pool1d(units, 1, return_indices=True)
        ctx.save_for_backward(codes, weight, chosen[..., 0])
        return largest[..., 0] + bias

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        codes, weight, chosen = ctx.saved_tensors
        of_codes = torch.zeros_like(codes)
        of_weight = torch.zeros_like(weight)
        for cloud in range(len(codes)):
            points = chosen[cloud]
            along = gradient[cloud][:, None].to(weight)
            of_weight += along * codes[cloud, points].to(weight)
            of_codes[cloud].index_add_(0, points, (along * weight).to(codes))
        return of_codes, of_weight, gradient.sum(dim=0).to(weight)


class MLP(PredictiveModel):
    """Fully connected network of `hidden` units, in the coordinates of the room.

    It reads the first `points` of a cloud: clouds come in farthest-point order. With `skip` its outputs are offsets from the
    planned middle of the grippers (`carried_middle`), and it need not learn to copy the plan.
    """

    def __init__(
        self,
        shape: Shape,
        normalisation: Normalisation,
        hidden: Sequence[int] = HIDDEN,
        points: int = 32,
        skip: bool = False,
    ) -> None:
        super().__init__(shape, normalisation)
        if type(points) is not int or not 1 <= points <= 100_000:
            raise ValueError(f"points must be a whole number from 1 to 100,000, not {points!r:.80}")
        self.first = min(points, shape.points)
        self.skip = skip
        _check_units("hidden", hidden)
        self.history_layer = nn.Linear(shape.history * self._frame_size(), hidden[0])
        self.action_layer = nn.Linear(7 * shape.horizon, hidden[0], bias=False)
        last = nn.Linear(hidden[-1], shape.horizon * shape.slots * NUMBERS)
        self.rest = nn.Sequential(nn.ReLU(), *_layers(hidden), last)

    def _frame_size(self) -> int:
        return 3 * self.first

    def encode_frames(self, frames: Context) -> Context:
        return {"frame": self.normalise(frames["clouds"][:, : self.first]).flatten(1)}

    def gather(self, kept: Context) -> Context:
        return {"first": self.history_layer(kept["frame"].flatten(1))}

    def decode(self, context: Context, actions: Tensor, held: Tensor) -> StateTensors:
        plan = torch.cat([self.normalise(actions).flatten(1), held.to(actions)], dim=1)
        numbers = self.rest(context["first"] + self.action_layer(plan))
        about = self.origin
        if self.skip:
            about = carried_middle(actions, held)[:, :, None, None]  # (C, K, 1, 1, 3)
        return self._states(numbers.unflatten(1, (self.shape.horizon, self.shape.slots, NUMBERS)), about)


class PointNet(MLP):
    """A PointNet that all frames share, in front of the fully connected network; `units` are those of its own layers."""

    def __init__(
        self,
        shape: Shape,
        normalisation: Normalisation,
        hidden: Sequence[int] = HIDDEN,
        units: Sequence[int] = POINT_UNITS,
        skip: bool = False,
    ) -> None:
        _check_units("units", units)
        self.units = tuple(units)
        super().__init__(shape, normalisation, hidden, skip=skip)
        self.points = nn.Sequential(*_layers((3, *units)))

    def _frame_size(self) -> int:
        return self.units[-1]

    def encode_frames(self, frames: Context) -> Context:
        # A cloud that several windows share is encoded once. The last ReLU comes after the maximum, which is the same.
        clouds, cloud_of_frame = torch.unique(frames["clouds"], dim=0, return_inverse=True)
        places = self.normalise(clouds)
        shared, last, rectified = self.points[:-2], self.points[-2], self.points[-1]
        if places.device.type == "cpu":
            # A few clouds at a time, whose codes stay in the processor's cache.
            parts = places.split(_CLOUDS_AT_ONCE)
            codes = torch.cat([_LinearMaximum.apply(shared(part), last.weight, last.bias) for part in parts])
        else:
            codes = last(shared(places)).amax(dim=1)
        return {"frame": rectified(codes)[cloud_of_frame]}


def _check_units(name: str, units: Sequence[int]) -> None:
    """Refuse numbers of units that no network has."""
    if (
        not isinstance(units, Sequence)
        or not 1 <= len(units) <= 32
        or not all(type(n) is int and 1 <= n <= 100_000 for n in units)
    ):
        raise ValueError(f"{name} must be numbers of units, 1 to 32 of them, each 1 to 100,000, not {units!r:.80}")


def _layers(widths: Sequence[int]) -> list[nn.Module]:
    layers: list[nn.Module] = []
    for n_in, n_out in itertools.pairwise(widths):
        layers += [nn.Linear(n_in, n_out), nn.ReLU()]
    return layers
