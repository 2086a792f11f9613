"""The paper's predictors: fully connected, on flattened clouds and actions, all steps at once, without and with a PointNet.

Source: Antonova et al. 2021, section 5; Qi, Su, Mo, Guibas 2017, *PointNet* (a network shared by all points, then the maximum
over them, so that the order of the points does not count), without its transforms of the input. Taught in chapter 10.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from ._base import Context, Normalisation, PredictiveModel, Shape, maximum
from ._states import NUMBERS, States


def _layers(widths: Sequence[int]) -> list[nn.Module]:
    return [layer for n_in, n_out in itertools.pairwise(widths) for layer in (nn.Linear(n_in, n_out), nn.ReLU())]


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
        self.history_layer = nn.Linear(shape.history * self._frame_size(), hidden[0])
        self.action_layer = nn.Linear(7 * shape.horizon, hidden[0], bias=False)
        last = nn.Linear(hidden[-1], shape.horizon * shape.slots * NUMBERS)
        self.rest = nn.Sequential(nn.ReLU(), *_layers(hidden), last)

    def _frame_size(self) -> int:
        """How many numbers `encode_frames` keeps of a frame."""
        return 3 * self.cloud_points

    def encode_frames(self, frames: Context) -> Context:
        """The coordinates of some points."""
        return {"frame": self.normalise(frames["clouds"][:, : self.cloud_points]).flatten(1)}

    def gather(self, kept: Context) -> Context:
        """The history's share of the first layer."""
        return {"first": self.history_layer(kept["frame"].flatten(1))}

    def decode(self, context: Context, actions: Tensor, held: Tensor) -> States:
        plan = torch.cat([self.normalise(actions).flatten(1), held.to(actions)], dim=1)
        numbers = self.rest(context["first"] + self.action_layer(plan))
        return self._states(numbers.unflatten(1, (self.shape.horizon, self.shape.slots, NUMBERS)), self.origin)


class PointNet(MLP):
    """PointNet a cloud, shared by all frames, in front of the fully connected network.

    Parameters
    ----------
    hidden : sequence of int
        Units of the hidden layers after the encoder.
    per_point : sequence of int
        Units of the layers shared by all points; the last is the size of a cloud's code.
    """

    def __init__(
        self,
        shape: Shape,
        normalisation: Normalisation,
        hidden: Sequence[int] = (512, 512, 256, 128),
        per_point: Sequence[int] = (64, 64, 96),
    ) -> None:
        self.code = per_point[-1]
        super().__init__(shape, normalisation, hidden)
        self.points = nn.Sequential(*_layers((3, *per_point)))

    def _frame_size(self) -> int:
        return self.code

    def encode_frames(self, frames: Context) -> Context:
        """The codes of the clouds."""
        return {"frame": maximum(self.points(self.normalise(frames["clouds"])))}
