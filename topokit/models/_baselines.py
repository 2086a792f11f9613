"""Predictors to beat: hold, carry and ridge, which start from the last tracked states, and the two networks of the paper.

Source: Hoerl and Kennard 1970 (ridge regression); Antonova et al. 2021, section 5; Qi, Su, Mo, Guibas 2017, *PointNet* (a network
shared by all points, then the maximum over them), without its transforms of the input. Taught in chapter 10.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections import defaultdict
from collections.abc import Iterable, Sequence

import numpy as np
import torch
from torch import Tensor, nn

from topokit.state import TopologicalState

from ._base import PAST, Context, Normalisation, PredictiveModel, Shape, maximum
from ._states import NUMBERS, States, Window, past_states, target_states

HIDDEN, POINTS = (512, 512, 256, 128), (64, 64, 96)  # units of the paper's hidden layers, and of those for every point


class Hold(PredictiveModel):
    """Every loop stays as it was at its last appearance in the history; it is there if it was there at the last frame."""

    learns = False
    inputs = ("grippers",)
    tracked = True

    def gather(self, kept: Context) -> Context:
        """Each slot as it was last tracked, and the grippers then; one that never was has its corners between the grippers."""
        present = kept["past_present"]  # (B, h, slots), the newest frame first
        last = present.int().argmax(dim=1)  # (B, slots); 0 of one that was never tracked
        batch, slot = torch.arange(len(last))[:, None], torch.arange(last.shape[1])
        loops = past_states({name: kept[name][batch, last, slot] for name in PAST})  # (B, slots)
        known, now = present.any(dim=1), kept["grippers"][:, 0]
        corners = torch.where(known[..., None, None], loops.corners, now.mean(dim=1)[:, None, None])
        loops = loops.replace(corners=corners, presence=torch.where(present[:, 0], 6.0, -6.0))
        return vars(loops) | {"known": known, "grippers": now, "grippers_then": kept["grippers"][batch, last]}

    def decode(self, context: Context, actions: Tensor, held: Tensor) -> States:
        moved = self._moved(context, actions, held)  # (C, K, slots or 1, 3)
        last = States(*(context[part.name] for part in dataclasses.fields(States)))
        still = last.each(lambda part: part[:, None].expand(*actions.shape[:2], *part.shape[1:]))
        step = moved.diff(dim=1, prepend=torch.zeros_like(moved[:, :1])).norm(dim=-1)
        return still.replace(corners=still.corners + moved[..., None, :], step=step.expand_as(still.step))

    def _moved(self, context: Context, actions: Tensor, held: Tensor) -> Tensor:
        """How far each loop has gone by each step."""
        return torch.zeros_like(actions[:, :, :1])


class Carry(Hold):
    """Every loop goes with the middle between the grippers for as long as they hold, and is then at rest."""

    def _moved(self, context: Context, actions: Tensor, held: Tensor) -> Tensor:
        """Since its last appearance with the grippers as they went, from the present on as planned."""
        start = context["grippers"].expand(len(actions), -1, -1)
        steps = torch.cat([start[:, None], actions], dim=1).diff(dim=1).mean(dim=2)  # (C, K, 3)
        ahead = (steps * held[..., None].to(steps)).cumsum(dim=1)
        since = (context["grippers"][:, None] - context["grippers_then"]).mean(dim=2)  # (B, slots, 3)
        return ahead[:, :, None] + since[:, None]


class Ridge(Hold):
    """Linear regression with a `penalty` on squared coefficients, from the last states and the plan to those of all steps.

    The corners' change since the last appearance, the values and the presence are regressed on the last state of the slot, the
    grippers and the plan, all relative to the middle between the grippers. A loop that is not there has no say in its place.
    """

    def __init__(self, shape: Shape, normalisation: Normalisation, penalty: float = 100.0) -> None:
        super().__init__(shape, normalisation)
        if not penalty > 0:
            raise ValueError(f"penalty must be more than zero, not {penalty!r}")
        self.penalty = penalty
        inputs = 1 + 24 + 4 + 4 + 9 + 7 * shape.horizon + shape.slots
        self.coefficients = nn.Parameter(torch.zeros(inputs, shape.horizon * NUMBERS), requires_grad=False)

    def decode(self, context: Context, actions: Tensor, held: Tensor) -> States:
        kept = {name: part.expand(len(actions), *part.shape[1:]) for name, part in context.items()}
        numbers = (self._inputs(kept, actions, held) @ self.coefficients).unflatten(-1, (self.shape.horizon, NUMBERS))
        states = self._states(numbers.transpose(1, 2), kept["corners"][:, None])
        return states.replace(presence=12 * (states.presence - 0.5))

    def _positive(self, raw: Tensor) -> Tensor:
        return self.normalisation.value * raw.clamp_min(0)

    def fit(self, batches: Iterable[Window]) -> None:
        """Solve the normal equations, summed over batches of windows: one system for places, one for the rest."""
        size = len(self.coefficients)
        gram, there_gram = torch.zeros(2, size, size, dtype=torch.float64)
        moments = torch.zeros(size, self.shape.horizon, NUMBERS, dtype=torch.float64)
        for window in batches:
            kept, target = self.encode(window), target_states(window)
            x = self._inputs(kept, window["actions"], window["actions_held"]).double()  # (B, slots, inputs)
            scale, value = self.normalisation.scale, self.normalisation.value
            values = torch.stack([target.birth, target.death - target.birth, target.step], dim=-1)
            places = ((target.corners - kept["corners"][:, None]) / scale).flatten(3)
            there = (target.presence > 0)[..., None]
            whole = (there.all(dim=1) & kept["known"][..., None]).double()  # slots seen and there at every step
            rest = torch.cat([target.neighbour_values / value, values / value, there.to(values)], dim=-1)
            known = x * whole
            gram += torch.einsum("bsi,bsj->ij", x, x)
            there_gram += torch.einsum("bsi,bsj->ij", known, known)
            moments[..., :24] += torch.einsum("bsi,bksn->ikn", known, places.double())
            moments[..., 24:] += torch.einsum("bsi,bksn->ikn", x, rest.double())
        penalty = self.penalty * torch.eye(size, dtype=torch.float64)
        penalty[0, 0] = 1e-6
        for part, matrix in ((moments[..., :24], there_gram), (moments[..., 24:], gram)):
            part[:] = torch.linalg.solve(matrix + penalty, part.flatten(1)).view_as(part)
        self.coefficients.data = moments.flatten(1).to(self.coefficients)

    def _inputs(self, kept: Context, actions: Tensor, held: Tensor) -> Tensor:
        """(C, slots, inputs): a constant, the slot's last state, the grippers, the plan, which slot it is."""
        scale, value, slots = self.normalisation.scale, self.normalisation.value, self.shape.slots
        middle = kept["grippers"].mean(dim=1)  # (C, 3)
        state = ((kept["corners"] - middle[:, None, None]) / scale).flatten(2)
        values = torch.stack([kept["birth"], kept["death"]], dim=-1) / value
        flags = torch.stack([kept["known"].to(values), (kept["presence"] > 0).to(values)], dim=-1)
        grippers = torch.cat([(kept["grippers"] - middle[:, None]).flatten(1) / scale, self.normalise(middle)], dim=1)
        plan = torch.cat([(actions - kept["grippers"][:, None]).flatten(1) / scale, held.to(values)], dim=1)
        each = torch.cat([torch.ones_like(plan[:, :1]), grippers, plan], dim=1)[:, None].expand(-1, slots, -1)
        name = torch.eye(slots).to(plan).expand(len(plan), -1, -1)
        return torch.cat([each, state, kept["neighbour_values"] / value, values, flags, name], dim=-1)


class MLP(PredictiveModel):
    """Fully connected network of `hidden` units, in the coordinates of the room.

    Of each cloud the first `cloud_points` points are read: clouds come in farthest-point order.
    """

    def __init__(
        self, shape: Shape, normalisation: Normalisation, hidden: Sequence[int] = HIDDEN, cloud_points: int = 32
    ) -> None:
        super().__init__(shape, normalisation)
        self.cloud_points = min(cloud_points, shape.points)
        self.history_layer = nn.Linear(shape.history * self._frame_size(), hidden[0])
        self.action_layer = nn.Linear(7 * shape.horizon, hidden[0], bias=False)
        last = nn.Linear(hidden[-1], shape.horizon * shape.slots * NUMBERS)
        self.rest = nn.Sequential(nn.ReLU(), *_layers(hidden), last)

    def _frame_size(self) -> int:
        return 3 * self.cloud_points

    def encode_frames(self, frames: Context) -> Context:
        return {"frame": self.normalise(frames["clouds"][:, : self.cloud_points]).flatten(1)}

    def gather(self, kept: Context) -> Context:
        return {"first": self.history_layer(kept["frame"].flatten(1))}

    def decode(self, context: Context, actions: Tensor, held: Tensor) -> States:
        plan = torch.cat([self.normalise(actions).flatten(1), held.to(actions)], dim=1)
        numbers = self.rest(context["first"] + self.action_layer(plan))
        return self._states(numbers.unflatten(1, (self.shape.horizon, self.shape.slots, NUMBERS)), self.origin)


class PointNet(MLP):
    """PointNet a cloud, of `per_point` units, shared by all frames, in front of the fully connected network."""

    def __init__(
        self,
        shape: Shape,
        normalisation: Normalisation,
        hidden: Sequence[int] = HIDDEN,
        per_point: Sequence[int] = POINTS,
    ) -> None:
        self.code = per_point[-1]
        super().__init__(shape, normalisation, hidden)
        self.points = nn.Sequential(*_layers((3, *per_point)))

    def _frame_size(self) -> int:
        return self.code

    def encode_frames(self, frames: Context) -> Context:
        return {"frame": maximum(self.points(self.normalise(frames["clouds"])))}


def _layers(widths: Sequence[int]) -> list[nn.Module]:
    return [layer for n_in, n_out in itertools.pairwise(widths) for layer in (nn.Linear(n_in, n_out), nn.ReLU())]


def past_window(states: Sequence[TopologicalState], slots: int) -> dict[str, Tensor]:
    """The `past_` fields of a window (1, h, ...) from tracked states: slots by mean lifetime over the history, longest first."""
    total: defaultdict[int, float] = defaultdict(float)
    for loop in (loop for state in states for loop in state.loops):
        total[loop.id] += loop.lifetime
    longest = sorted(total, key=total.__getitem__, reverse=True)[:slots]
    slot_of = {identity: slot for slot, identity in enumerate(longest)}
    size = len(states), slots
    past = {
        "triangles": np.zeros((*size, 6, 3, 3), np.float32),
        "values": np.zeros((*size, 6), np.float32),
        **{name: np.zeros(size, np.float32) for name in ("birth", "death", "step")},
        "present": np.zeros(size, bool),
    }
    for frame, state in enumerate(states):
        for loop in (loop for loop in state.loops if loop.id in slot_of):
            place, n = (frame, slot_of[loop.id]), 2 + len(loop.neighbours)
            past["triangles"][place] = loop.killer_triangles[0]  # stands for neighbours that are absent
            past["triangles"][place][:n] = np.concatenate([loop.killer_triangles, loop.neighbours])
            past["values"][place][:n] = np.concatenate([loop.killer_values, loop.neighbour_values])
            for name in ("birth", "death", "step"):
                past[name][place] = np.nan_to_num(getattr(loop, name))
            past["present"][place] = True
    return {f"past_{name}": torch.from_numpy(part)[None] for name, part in past.items()}
