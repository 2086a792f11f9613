"""The parts of a model that reads windows; and the baselines hold, carry and ridge, which start from the tracked states.

Source: Hoerl and Kennard 1970 (ridge regression). Taught in chapter 13.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Iterable
from typing import Any

import torch
from torch import Tensor, nn

from topokit._config import Count, Place, Positive, checked
from topokit.io import HISTORY, HORIZON

from ._states import NOISE, NUMBERS, StateTensors, Window

Context = dict[str, Tensor]


@checked
class Shape:
    """Sizes of a window."""

    history: Count = HISTORY  #: frames that are observed
    horizon: Count = HORIZON  #: frames that are forecast
    points: Count = 128  #: of a cloud
    slots: Count = 4  #: loops that are forecast at most


@checked
class Normalisation:
    """Means and scales of coordinates and filtration values in the training split; models see (x - origin) / scale."""

    origin: Place = (0.0, 0.0, 1.0)  #: mean of the clouds, metres
    scale: Positive = 0.2  #: root mean square distance from it along an axis, metres
    value: Positive = 0.05  #: mean death of the loops, metres


class Model(nn.Module):
    """A model of `build`, with what its checkpoint describes."""

    learns = True  # by gradient descent

    def __init__(self, shape: Shape, normalisation: Normalisation) -> None:
        super().__init__()
        self.shape = shape
        self.normalisation = normalisation
        self.options: dict[str, Any] = {}


class PredictiveModel(Model, ABC):
    """A model from windows (the dict of tensors of `topokit.data.WindowDataset`, with a leading axis of B) to states.

    `encode` reads the history, once for all plans. `decode` reads a plan of actions and returns the states of all steps.
    """

    tracked = False  # whether it reads the grippers and the tracked states of a history, and not its clouds

    @abstractmethod
    def encode(self, window: Window) -> Context:
        """Return the context of a batch of windows, which does not depend on the plan."""

    @abstractmethod
    def decode(self, context: Context, actions: Tensor, held: Tensor) -> StateTensors:
        """Return the states of all steps under plans (C, horizon, 2, 3), held or not (C, horizon); one history may have any C."""

    def forward(self, window: Window) -> StateTensors:
        """Return the predicted states of a batch of windows."""
        return self.decode(self.encode(window), window["actions"], window["actions_held"])

    @property
    def origin(self) -> Tensor:
        """Return the mean (3,) of the training's clouds, metres."""
        return torch.tensor(self.normalisation.origin)

    def normalise(self, points: Tensor) -> Tensor:
        """Return coordinates in metres as multiples of the scale, about the origin."""
        return (points - self.origin) / self.normalisation.scale

    def _states(self, numbers: Tensor, about: Tensor) -> StateTensors:
        """Return a last layer's numbers (..., NUMBERS) as states; the first 24, times `scale`, are corners about places."""
        corners = numbers[..., :24].unflatten(-1, (8, 3))
        positive = self._positive(numbers[..., 24:31])
        return StateTensors(
            corners=torch.add(about, corners, alpha=self.normalisation.scale),
            neighbour_values=positive[..., :4],
            birth=positive[..., 4],
            death=positive[..., 4] + positive[..., 5],
            killer_shift=positive[..., 6],
            presence=numbers[..., 31],
            noise=torch.full_like(numbers[..., 31], NOISE),
        )

    def _positive(self, raw: Tensor) -> Tensor:
        """Return values that are positive whatever the network's output is; the checkpoints were trained with this function."""
        return self.normalisation.value / 2 * (raw + (raw.square() + 1).sqrt())


class Hold(PredictiveModel):
    """The forecast that each loop stays as at its last appearance; it is present if it was present at the last frame."""

    learns = False
    tracked = True

    def encode(self, window: Window) -> Context:
        """Return each slot as it was last tracked, and the grippers then; one never tracked is between the present grippers."""
        past = StateTensors.from_past(window).map(lambda part: part.flip(1))  # (B, h, slots), the newest frame first
        grippers = window["grippers"].flip(1)  # (B, h, 2, 3)
        present = past.presence > 0  # (B, h, slots)
        known = present.any(dim=1)  # (B, slots)
        last = present.int().argmax(dim=1)  # (B, slots); 0 of one that was never tracked
        batch = torch.arange(len(last))[:, None]
        loops = past[batch, last, torch.arange(last.shape[1])]  # (B, slots)
        now = grippers[:, 0]
        corners = torch.where(known[..., None, None], loops.corners, now.mean(dim=1)[:, None, None])
        loops = loops.replace(corners=corners, presence=torch.where(present[:, 0], 6.0, -6.0))
        return vars(loops) | {"known": known, "grippers": now, "grippers_then": grippers[batch, last]}

    def decode(self, context: Context, actions: Tensor, held: Tensor) -> StateTensors:
        moved = self._moved(context, actions, held)  # (C, K, slots or 1, 3)
        last = StateTensors(*(context[part.name] for part in dataclasses.fields(StateTensors)))
        still = last.map(lambda part: part[:, None].expand(*actions.shape[:2], *part.shape[1:]))
        shift = moved.diff(dim=1, prepend=torch.zeros_like(moved[:, :1])).norm(dim=-1)
        return still.replace(
            corners=still.corners + moved[..., None, :],
            killer_shift=shift.expand_as(still.killer_shift),
        )

    def _moved(self, context: Context, actions: Tensor, held: Tensor) -> Tensor:
        """Return how far each loop has gone by each step, (C, K, slots or 1, 3)."""
        return torch.zeros_like(actions[:, :, :1])


class Carry(Hold):
    """The forecast that each loop goes with the middle between the grippers while they hold, and then rests."""

    def _moved(self, context: Context, actions: Tensor, held: Tensor) -> Tensor:
        # From the present on as planned, while they hold.
        start = context["grippers"].expand(len(actions), -1, -1)
        steps = torch.cat([start[:, None], actions], dim=1).diff(dim=1).mean(dim=2)  # (C, K, 3)
        ahead = (steps * held[..., None].to(steps)).cumsum(dim=1)
        # Since its last appearance, as the grippers went.
        since = (context["grippers"][:, None] - context["grippers_then"]).mean(dim=2)  # (B, slots, 3)
        return ahead[:, :, None] + since[:, None]


class Ridge(Hold):
    """Linear regression with a `penalty` on squared coefficients, from the last states and the plan to those of all steps.

    Places are relative to the middle between the grippers; for corners it is their change since the last appearance, of present
    loops alone.
    """

    def __init__(self, shape: Shape, normalisation: Normalisation, penalty: float = 100.0) -> None:
        super().__init__(shape, normalisation)
        self.penalty = penalty
        inputs = 1 + 24 + 4 + 4 + 9 + 7 * shape.horizon + shape.slots
        self.coefficients = nn.Parameter(torch.zeros(inputs, shape.horizon * NUMBERS), requires_grad=False)

    def decode(self, context: Context, actions: Tensor, held: Tensor) -> StateTensors:
        kept = {name: part.expand(len(actions), *part.shape[1:]) for name, part in context.items()}
        numbers = (self._inputs(kept, actions, held) @ self.coefficients).unflatten(-1, (self.shape.horizon, NUMBERS))
        states = self._states(numbers.transpose(1, 2), kept["corners"][:, None])
        return states.replace(presence=12 * (states.presence - 0.5))

    def _positive(self, raw: Tensor) -> Tensor:
        return self.normalisation.value * raw.clamp_min(0)

    def fit(self, batches: Iterable[Window]) -> None:
        """Solve the normal equations, summed over batches of windows: one system for corners, one for the other numbers."""
        size = len(self.coefficients)
        scale = self.normalisation.scale
        value = self.normalisation.value
        gram = torch.zeros(size, size, dtype=torch.float64)
        corner_gram = torch.zeros(size, size, dtype=torch.float64)
        moments = torch.zeros(size, self.shape.horizon, NUMBERS, dtype=torch.float64)
        for window in batches:
            kept = self.encode(window)
            target = StateTensors.from_labels(window)
            inputs = self._inputs(kept, window["actions"], window["actions_held"]).double()  # (B, slots, inputs)

            # The other numbers, of all slots.
            present = (target.presence > 0)[..., None]  # (B, K, slots, 1)
            values = torch.stack([target.birth, target.death - target.birth, target.killer_shift], dim=-1)
            others = torch.cat([target.neighbour_values / value, values / value, present.to(values)], dim=-1)
            gram += torch.einsum("bsi,bsj->ij", inputs, inputs)
            moments[..., 24:] += torch.einsum("bsi,bksn->ikn", inputs, others.double())

            # Corners, of the slots that were tracked and are present at every step.
            corners = ((target.corners - kept["corners"][:, None]) / scale).flatten(3)  # (B, K, slots, 24)
            whole = inputs * (present.all(dim=1) & kept["known"][..., None]).double()
            corner_gram += torch.einsum("bsi,bsj->ij", whole, whole)
            moments[..., :24] += torch.einsum("bsi,bksn->ikn", whole, corners.double())

        penalty = self.penalty * torch.eye(size, dtype=torch.float64)
        penalty[0, 0] = 1e-6  # the constant is hardly penalised
        for part, matrix in ((moments[..., :24], corner_gram), (moments[..., 24:], gram)):
            part[:] = torch.linalg.solve(matrix + penalty, part.flatten(1)).view_as(part)
        self.coefficients.data = moments.flatten(1).to(self.coefficients)

    def _inputs(self, kept: Context, actions: Tensor, held: Tensor) -> Tensor:
        """Return (C, slots, inputs): a constant, the grippers, the plan, the slot's last state, and which slot it is."""
        scale = self.normalisation.scale
        value = self.normalisation.value
        middle = kept["grippers"].mean(dim=1)  # (C, 3)

        # The same for all slots.
        constant = torch.ones_like(middle[:, :1])
        apart = (kept["grippers"] - middle[:, None]).flatten(1) / scale  # (C, 6)
        moves = (actions - kept["grippers"][:, None]).flatten(1) / scale  # (C, 6 horizon)
        shared = torch.cat([constant, apart, self.normalise(middle), moves, held.to(moves)], dim=1)
        shared = shared[:, None].expand(-1, self.shape.slots, -1)

        # Of each slot.
        corners = ((kept["corners"] - middle[:, None, None]) / scale).flatten(2)
        values = torch.stack([kept["birth"], kept["death"]], dim=-1) / value
        flags = torch.stack([kept["known"].to(values), (kept["presence"] > 0).to(values)], dim=-1)
        slot = torch.eye(self.shape.slots).expand(len(middle), -1, -1)
        return torch.cat([shared, corners, kept["neighbour_values"] / value, values, flags, slot], dim=-1)
