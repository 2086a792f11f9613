"""What all predictors have in common: their shapes, their units and the three parts of a forward pass."""

from __future__ import annotations

from abc import ABC, abstractmethod

import torch
from torch import Tensor, nn
from torch.nn import functional

from topokit._config import Count, checked
from topokit.io import HISTORY, HORIZON

from ._states import States, Window

PAST = tuple(f"past_{name}" for name in ("triangles", "values", "birth", "death", "step", "present"))

Context = dict[str, Tensor]


@checked
class Shape:
    """Sizes of a window."""

    history: Count = HISTORY  #: frames that are seen
    horizon: Count = HORIZON  #: frames that are forecast
    points: Count = 128  #: of a cloud
    slots: Count = 4  #: loops that are forecast at most


@checked
class Normalisation:
    """Where coordinates and filtration values lie in the training split; models see (x - origin) / scale."""

    origin: tuple[float, float, float] = (0.0, 0.0, 1.0)  #: mean of the clouds, metres
    scale: float = 0.2  #: root mean square distance from it along an axis, metres
    value: float = 0.05  #: mean death of the loops, metres


class PredictiveModel(nn.Module, ABC):
    """From a window (the dict of tensors of `topokit.data.WindowDataset`, a leading axis of B) to its states.

    Three parts: `encode_frames` looks at single frames, so that a frame of a stream is encoded once; `gather` puts a history of
    them together, so that all plans share it; `decode` reads a plan of actions and gives the states of all steps.

    Parameters
    ----------
    shape : Shape
    normalisation : Normalisation
    """

    learns = True  # by gradient descent
    inputs: tuple[str, ...] = ("clouds",)  # what is read of each frame of a window's history
    tracked = False  # whether `gather` is given what a tracker saw, too: `PAST`, of all frames
    plans_at_once = 250  # of many: so that weights are read seldom, and what lies between layers stays in the cache

    def __init__(self, shape: Shape, normalisation: Normalisation) -> None:
        super().__init__()
        self.shape, self.normalisation = shape, normalisation
        self.frames = list(range(shape.history))  # how many frames back is looked, the newest first
        self.register_buffer("origin", torch.tensor(normalisation.origin), persistent=False)
        self.origin: Tensor

    def encode_frames(self, frames: Context) -> Context:
        """What is kept of N frames, each alone; the `inputs` of a window with a leading axis of N."""
        return frames

    @abstractmethod
    def gather(self, kept: Context) -> Context:
        """What the forecast needs of the frames kept, (B, F, ...), and of the tracked states, (B, history, ...) newest first."""

    @abstractmethod
    def decode(self, context: Context, actions: Tensor, held: Tensor) -> States:
        """Forecast the states of all steps.

        Parameters
        ----------
        context : dict of Tensor
            Of `gather`, for B windows.
        actions : (C, horizon, 2, 3)
            Planned targets of the grippers, metres. C is B, or any number when B is 1: one history under C plans.
        held : (C, horizon) bool
        """

    def present_states(self, context: Context) -> States | None:
        """Return the estimate of the present state that the model makes on its way, (B, 1, slots); None when it makes none."""
        return None

    def encode(self, window: Window) -> Context:
        """Everything that does not depend on the plan."""
        look = [self.shape.history - 1 - back for back in self.frames]
        frames = {name: window[name][:, look] for name in self.inputs}
        sizes = next(iter(frames.values())).shape[:2]
        kept = self.encode_frames({name: part.flatten(0, 1) for name, part in frames.items()})
        kept = {name: part.unflatten(0, sizes) for name, part in kept.items()}
        if self.tracked:
            kept |= {name: window[name].flip(1) for name in PAST}
        return self.gather(kept)

    def forward(self, window: Window) -> tuple[States, States | None]:
        """The forecast, and the present state when the model estimates it."""
        context = self.encode(window)
        return self.decode(context, window["actions"], window["actions_held"]), self.present_states(context)

    def normalise(self, points: Tensor) -> Tensor:
        """Coordinates in metres to about the unit cube."""
        return (points - self.origin) / self.normalisation.scale

    def _states(self, numbers: Tensor, about: Tensor) -> States:
        """The last layer of a network (..., NUMBERS) as states: corners are `scale` times the first 24, about places (..., 3)."""
        corners, positive = numbers[..., :24].unflatten(-1, (8, 3)), self._positive(numbers[..., 24:31])
        return States(
            corners=torch.add(about, corners, alpha=self.normalisation.scale),
            neighbour_values=positive[..., :4],
            birth=positive[..., 4],
            death=positive[..., 4] + positive[..., 5],
            step=positive[..., 6],
            presence=numbers[..., 31],
        )

    def _positive(self, raw: Tensor) -> Tensor:
        """Values that are positive whatever the network says, at half the cost of a softplus."""
        return self.normalisation.value / 2 * (raw + (raw.square() + 1).sqrt())


def maximum(codes: Tensor) -> Tensor:
    """(N, width) maximum over the points of codes (N, P, width), as a pooling: its gradient is far quicker than that of amax."""
    return functional.adaptive_max_pool1d(codes.transpose(1, 2), 1)[..., 0]
