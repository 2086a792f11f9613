"""The paper's fully connected predictor: four hidden layers on flattened clouds and actions, all steps at once.

Source: Antonova et al. 2021, section 5. Taught in chapter 10.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from .base import Context, Normalisation, PredictiveModel, Shape, states_from_numbers
from .states import NUMBERS, States

__all__ = ["MLP"]


class MLP(PredictiveModel):
    """Fully connected network; coordinates are those of the room.

    Parameters
    ----------
    hidden : sequence of int
        Units of the hidden layers.
    cloud_points : int
        How many points of each cloud are read, the first ones (clouds come in farthest-point order).
    """

    def __init__(
        self,
        shape: Shape,
        normalisation: Normalisation,
        hidden: Sequence[int] = (512, 512, 256, 128),
        cloud_points: int = 32,
    ) -> None:
        super().__init__(shape, normalisation)
        self.cloud_points = min(cloud_points, shape.points)
        self.history_layer = nn.Linear(shape.history * self.frame_size(), hidden[0])
        self.action_layer = nn.Linear(7 * shape.horizon, hidden[0], bias=False)
        layers: list[nn.Module] = [nn.ReLU()]
        for n_in, n_out in itertools.pairwise(hidden):
            layers += [nn.Linear(n_in, n_out), nn.ReLU()]
        self.rest = nn.Sequential(*layers, nn.Linear(hidden[-1], shape.horizon * shape.slots * NUMBERS))

    def frame_size(self) -> int:
        """How many numbers `encode_frames` keeps of a frame."""
        return 3 * self.cloud_points

    def encode_frames(self, frames: Context) -> Context:
        """The coordinates of some points."""
        return {"frame": self.normalise(frames["clouds"][:, : self.cloud_points]).flatten(1)}

    def gather(self, kept: Context) -> Context:
        """The history's share of the first layer."""
        return {"first": self.history_layer(kept["frame"].flatten(1))}

    def decode(self, context: Context, actions: Tensor, held: Tensor) -> States:
        """The actions' share of the first layer, and the other layers."""
        plan = torch.cat([self.normalise(actions).flatten(1), held.to(actions)], dim=1)
        numbers = self.rest(context["first"] + self.action_layer(plan))
        numbers = numbers.unflatten(1, (self.shape.horizon, self.shape.slots, NUMBERS))
        return states_from_numbers(numbers, self.origin, self.normalisation.scale, self.normalisation.value)
