"""Forecasters of paper.py that the library does not have: two controls, an opponent of Motion, and a rule that sees no cloud.

`GivenLoops` starts from the tracked loops, as Motion does, but it is told nothing of how points of the cloth move.
`AlignedPointNet` has the transform of the input, which the library's PointNet leaves out. `Graph` passes messages between
neighbouring points. It is given what Motion is given, it is trained on the same scenes by the same loss, and its loops are read
off the moved cloud likewise.

Source: Qi, Su, Mo, Guibas 2017, *PointNet* (input transform); Sanchez-Gonzalez et al. 2020, *Learning to simulate complex physics
with graph networks* (encode, pass messages, decode). Used in chapter 15.
"""

from collections.abc import Mapping
from typing import Any

import torch
from forecasts import Forecaster, states_at
from torch import Tensor, nn

from topokit._config import checked
from topokit.models import StateTensors, TrainConfig, _motion
from topokit.models._baselines import Carry, Context, Model, Normalisation, Shape
from topokit.models._checkpoint import MODELS
from topokit.models._motion import CARRIERS, KNOTS, UNIT, Codes, Motion, Scene, carried, world
from topokit.models._networks import MLP, PointNet, _layers
from topokit.models._states import Window

AT = 3 + 1  # coordinates and distance of an offset
INPUTS = 3 + 9 + 5 + 2 + 2 + 12 + 2 + 16  # of a point: those of Motion
STEP = 6 + 5 + 2 + 3 + 1 + 1  # inputs of a point at a knot


@checked
class AnyConfig(TrainConfig):
    """The configuration of the training of any model of `MODELS`, those below included."""

    model: str


class GivenLoops(MLP):
    """The paper's fully connected network, given the tracked loops as well: its outputs are corrections of carry's forecast."""

    def __init__(self, shape: Shape, normalisation: Normalisation, **options: Any) -> None:
        super().__init__(shape, normalisation, **options)
        self.carry = Carry(shape, normalisation)
        width = self.history_layer.out_features
        self.loop_layer = nn.Linear(shape.slots * (24 + 4 + 2 + 2), width, bias=False)
        start_at_zero(self.rest[-1])

    def encode(self, window: Window) -> Context:
        last = self.carry.encode(window)  # each slot as it was last tracked
        value = self.normalisation.value
        values = (
            torch.cat([last["neighbour_values"], last["birth"][..., None], last["death"][..., None]], dim=2) / value
        )
        flags = torch.stack([last["known"], last["presence"] > 0], dim=2).to(values)
        inputs = torch.cat([self.normalise(last["corners"]).flatten(2), values, flags], dim=2)
        return last | {"first": super().encode(window)["first"] + self.loop_layer(inputs.flatten(1))}

    def decode(self, context: Context, actions: Tensor, held: Tensor) -> StateTensors:
        plan = torch.cat([self.normalise(actions).flatten(1), held.to(actions)], dim=1)
        numbers = self.rest(context["first"] + self.action_layer(plan)).unflatten(
            1, (*actions.shape[1:2], self.shape.slots, -1)
        )
        # The numbers that would give carry's forecast; the inverse of `_positive` for values that are not too small.
        states = self.carry.decode(context, actions, held)
        values = torch.stack([states.birth, states.lifetime, states.killer_shift], dim=3)
        doubled = 2 / self.normalisation.value * torch.cat([states.neighbour_values, values], dim=3)
        doubled = doubled.clamp_min(0.2)
        start = [torch.zeros_like(numbers[..., :24]), (doubled - 1 / doubled) / 2, states.presence[..., None] / 2]
        return self._states(numbers + torch.cat(start, dim=3), states.corners)


class AlignedPointNet(PointNet):
    """A PointNet with a transform of its input: the points of each cloud are multiplied by a matrix that a network finds."""

    def __init__(self, shape: Shape, normalisation: Normalisation, **options: Any) -> None:
        super().__init__(shape, normalisation, **options)
        self.shared = nn.Sequential(*_layers((3, 32, 64)))
        self.matrix = nn.Sequential(*_layers((64, 32)), nn.Linear(32, 9))
        start_at_zero(self.matrix[-1])

    def frame_codes(self, clouds: Tensor) -> Tensor:
        places = self.normalise(clouds)
        matrix = self.matrix(self.shared(places).amax(dim=-2)).unflatten(-1, (3, 3)) + torch.eye(3)
        return self.points(places @ matrix).amax(dim=-2)


class Graph(Motion):
    """Motion of points by a graph network with codes of `width` units.

    Nodes are the points of the last cloud, with their motion, and the points asked for. Edges lead to each of them from its
    nearest points of the cloud. Nodes know the whole plan, and messages are passed `rounds` times. Then, for each knot, a last
    network takes a node's code and the place to which the node would be carried, and returns how it moves besides.
    """

    def __init__(
        self, shape: Shape, normalisation: Normalisation, width: int = 64, rounds: int = 3, neighbours: int = 10
    ) -> None:
        Model.__init__(self, shape, normalisation)  # without the layers of Motion
        self.neighbours = neighbours
        self.point = _motion._two_layers(INPUTS, width, width)
        self.plan = _motion._two_layers(len(KNOTS) * (6 + 1 + 16), width, width)
        self.offset = nn.ModuleList(nn.Linear(AT, width) for _ in range(rounds))
        self.sender = nn.ModuleList(nn.Linear(width, width, bias=False) for _ in range(rounds))
        self.receiver = nn.ModuleList(nn.Linear(width, width, bias=False) for _ in range(rounds))
        self.update = nn.ModuleList(_motion._two_layers(2 * width, width, width) for _ in range(rounds))
        self.norm = nn.ModuleList(nn.LayerNorm(width) for _ in range(rounds))
        self.out = _motion._two_layers(width + STEP, width, 4)
        start_at_zero(self.out[-1])

    def encode(self, scene: Scene) -> Codes:
        """Return the inputs of all points as codes; they do not depend on the plan."""
        swapped = _motion._behind(scene["grippers"][:, 0], scene["target"][:, -1])
        grippers = _motion._renamed(scene["grippers"], swapped)
        origin, axes = _motion._frame(grippers[:, 0])
        hands = _motion._local(grippers, origin, axes)  # (B, 4, 2, 3)
        target = _motion._local(scene["target"], origin, axes)
        floor = (scene["floor"] - origin[:, 2]) / UNIT
        seen = _motion._local(torch.cat([scene["cloud"], scene["points"]], dim=1), origin, axes)  # (B, M + n, 3)
        flow = (2 / UNIT * scene["flow"].flatten(1, 2) @ axes.mT).view(*seen.shape[:2], 9)
        velocity = (10 * (hands[:, :1] - hands[:, 1:3])).flatten(1)
        opening = (hands[:, 0, 0] - hands[:, 0, 1]).norm(dim=1, keepdim=True)
        held = scene["held"].to(seen)[:, None]
        shared = torch.cat([velocity, held, opening, _motion._reach(hands[:, 0], target).flatten(1)], dim=1)
        shared = shared[:, None].expand(-1, seen.shape[1], -1)
        inputs = [
            seen,
            flow,
            _motion._beside(seen, target),
            _motion._above(seen, floor),
            torch.cdist(seen, hands[:, 0]),
            shared,
        ]
        size = scene["cloud"].shape[1]
        carriers = min(CARRIERS, size)
        place = torch.cat([seen[:, :carriers], seen[:, size:]], dim=1)
        return Codes(torch.cat(inputs, dim=2), place, hands[:, 0], target, floor, origin, axes, carriers, swapped)

    def under(self, codes: Codes, actions: Tensor, held: Tensor) -> tuple[Tensor, Tensor]:
        """Return places (C, 13, carriers + n, 3) in metres and scales (C, 13, carriers + n) of errors, under plans."""
        plans = len(actions)
        place = codes.place.expand(plans, -1, -1)  # (C, N, 3)
        target = codes.target.expand(plans, -1, -1)
        floor = codes.floor.expand(plans)
        start = codes.hands.expand(plans, -1, -1)

        # Give the plan to every node: grippers at the knots, shares of frames held, and how near the target they come.
        hands, shares = _motion._hands(
            _motion._local(_motion._renamed(actions, codes.swapped), codes.origin, codes.axes), held, codes.hands
        )
        reach = _motion._reach(hands.flatten(1, 2), target).unflatten(1, hands.shape[1:3]).flatten(2)  # (C, 13, 16)
        plan = torch.cat([(hands - start[:, None]).flatten(2), shares[..., None], reach], dim=2)
        code = self.point(codes.code) + self.plan(plan.flatten(1))[:, None]  # (C, M + n, width)

        # Pass messages from the nearest points of the cloud.
        seen = codes.code[..., :3]
        size = seen.shape[1] - place.shape[1] + codes.carriers
        near = torch.cdist(seen, seen[:, :size]).topk(min(self.neighbours, size), largest=False).indices
        batch = torch.arange(len(seen))[:, None, None]
        offset = 2 * (seen[batch, near] - seen[:, :, None])
        offset = torch.cat([offset, offset.norm(dim=-1, keepdim=True)], dim=-1)  # (B, M + n, neighbours, 4)
        every = torch.arange(plans)[:, None, None]
        near = near.expand(plans, -1, -1)
        for of_offset, sender, receiver, update, norm in zip(
            self.offset, self.sender, self.receiver, self.update, self.norm, strict=True
        ):
            sent = sender(code[:, :size])[every, near]  # (C, M + n, neighbours, width)
            message = nn.functional.gelu(sent + receiver(code)[:, :, None] + of_offset(offset)).mean(dim=2)
            code = norm(code + update(torch.cat([code, message], dim=2)))

        # Decode the points asked for, at every knot.
        code = torch.cat([code[:, : codes.carriers], code[:, size:]], dim=1)  # (C, N, width)
        ahead = [carried(place, start, hands[:, k]) for k in range(len(KNOTS))]
        changes = []
        for k, moved in enumerate(ahead):
            to_hands = [hand[:, None] - moved for hand in hands[:, k].unbind(dim=1)]
            of_step = torch.stack([shares[:, : k + 1].mean(dim=1), torch.full_like(shares[:, 0], KNOTS[k] / 60)], dim=1)
            of_step = of_step[:, None].expand(-1, place.shape[1], -1)
            inputs = [
                code,
                *to_hands,
                _motion._beside(moved, target),
                _motion._above(moved, floor),
                moved - place,
                of_step,
            ]
            changes.append(self.out(torch.cat(inputs, dim=2)))
        change = torch.stack(changes, dim=1)  # (C, 13, N, 4)
        ahead_at = torch.stack(ahead, dim=1) + torch.tensor(KNOTS)[:, None, None] / 15 * change[..., :3]
        return world(ahead_at, codes.origin, codes.axes), 0.01 * (change[..., 3] + 1).exp()


def blind(height: float, slots: int) -> Forecaster:
    """Return the forecaster that reads no cloud: every loop is `height` metres below the planned middle of the grippers.

    The middle stays where they let go of the cloth. All slots are present, and at the same place.
    """

    def forecast(window: Mapping[str, Tensor]) -> StateTensors:
        held = window["actions_held"]
        last_held = torch.where(held, torch.arange(held.shape[1]), 0).cummax(dim=1).values
        middle = window["actions"].mean(dim=2).take_along_dim(last_held[..., None], dim=1)  # (B, K, 3)
        place = (middle - torch.tensor([0.0, 0.0, height]))[:, :, None].expand(-1, -1, slots, -1)
        ones = torch.ones_like(place[..., 0])
        return states_at(place, 6 * ones, 0.025 * ones)

    return forecast


def start_at_zero(last: nn.Linear) -> None:
    """Make a network's last layer give nearly nothing, so that an untrained network predicts what it corrects."""
    nn.init.normal_(last.weight, std=0.01)
    nn.init.zeros_(last.bias)


MODELS.update({kind.__name__.lower(): kind for kind in (GivenLoops, AlignedPointNet, Graph)})
