"""The two networks of the paper, as far as it describes them: inputs and outputs are in the coordinates of the room.

Source: Antonova et al. 2021, section 5; Qi, Su, Mo, Guibas 2017, *PointNet* (a network shared by all points, then the maximum
over them), without its transforms of the input. Taught in chapter 13.
"""

import itertools
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from ._baselines import Context, Normalisation, PredictiveModel, Shape
from ._states import NUMBERS, StateTensors, Window


class MLP(PredictiveModel):
    """Fully connected network of `hidden` units, in the coordinates of the room, on the first `points` of a cloud.

    With `skip` its outputs are offsets from the planned middle of the grippers, and it need not learn to copy the plan.
    """

    def __init__(
        self,
        shape: Shape,
        normalisation: Normalisation,
        hidden: Sequence[int] = (512, 512, 256, 128),
        points: int = 32,
        skip: bool = False,
    ) -> None:
        super().__init__(shape, normalisation)
        self.first = min(points, shape.points)
        self.skip = skip
        self.history_layer = nn.Linear(shape.history * self._frame_size(), hidden[0])
        self.action_layer = nn.Linear(7 * shape.horizon, hidden[0], bias=False)
        last = nn.Linear(hidden[-1], shape.horizon * shape.slots * NUMBERS)
        self.rest = nn.Sequential(nn.ReLU(), *_layers(hidden), last)

    def _frame_size(self) -> int:
        return 3 * self.first

    def frame_codes(self, clouds: Tensor) -> Tensor:
        """Return the numbers (..., size) of clouds (..., P, 3), each alone."""
        return self.normalise(clouds[..., : self.first, :]).flatten(-2)

    def encode(self, window: Window) -> Context:
        codes = self.frame_codes(window["clouds"].flip(1))  # (B, h, size), the newest frame first
        return {"first": self.history_layer(codes.flatten(1))}

    def decode(self, context: Context, actions: Tensor, held: Tensor) -> StateTensors:
        plan = torch.cat([self.normalise(actions).flatten(1), held.to(actions)], dim=1)
        numbers = self.rest(context["first"] + self.action_layer(plan))
        about = self.origin
        if self.skip:
            about = carried_middle(actions, held)[:, :, None, None]  # (C, K, 1, 1, 3)
        return self._states(numbers.unflatten(1, (self.shape.horizon, self.shape.slots, NUMBERS)), about)


class PointNet(MLP):
    """A PointNet, with layers of these `units` that all points share, in front of the fully connected network."""

    def __init__(
        self,
        shape: Shape,
        normalisation: Normalisation,
        hidden: Sequence[int] = (512, 512, 256, 128),
        units: Sequence[int] = (64, 64, 96),
        skip: bool = False,
    ) -> None:
        self.units = tuple(units)
        super().__init__(shape, normalisation, hidden, skip=skip)
        self.points = nn.Sequential(*_layers((3, *units)))

    def _frame_size(self) -> int:
        return self.units[-1]

    def frame_codes(self, clouds: Tensor) -> Tensor:
        return self.points(self.normalise(clouds)).amax(dim=-2)


def _layers(widths: Sequence[int]) -> list[nn.Module]:
    layers: list[nn.Module] = []
    for n_in, n_out in itertools.pairwise(widths):
        layers += [nn.Linear(n_in, n_out), nn.ReLU()]
    return layers


def carried_middle(actions: Tensor, held: Tensor) -> Tensor:
    """Return the planned middle (C, K, 3) of the grippers, which stays where they let go of the cloth, or at the first step."""
    steps = torch.arange(held.shape[1], device=held.device).expand(held.shape)
    last_held = torch.where(held, steps, 0).cummax(dim=1).values
    return actions.mean(dim=2).take_along_dim(last_held[..., None], dim=1)
