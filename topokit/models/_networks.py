"""Networks: the two of the paper, and LoopCast, ours, which finds the loops, carries them with the grippers, learns the rest.

Idea of LoopCast, four choices against the paper's networks:

1. *Relative coordinates.* Points are seen from the middle between the grippers; the network is told where that middle is.
2. *Pointing.* A corner of a loop's triangles is an average of the cloud's own points under learned attention, plus a little.
3. *Carrying.* The forecast is the present loop moved with the grippers for as long as they hold, in learned shares, plus
   what the network adds. Untrained it is already the baseline `carry`.
4. *Slots.* Each loop has its own code; a step of the plan has one too (from the actions up to that step, none after it). A
   small network of the two gives the state. Frames are encoded once, when they arrive, and plans share the history.

Source: Antonova et al. 2021, section 5; Qi, Su, Mo, Guibas 2017, *PointNet* (a network shared by all points, then the maximum
over them), without its transforms of the input; attention as in Vaswani et al. 2017; slots as in Locatello et al. 2020 and
Carion et al. 2020. Taught in chapter 10.
"""

import itertools
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

from ._baselines import Context, Normalisation, PredictiveModel, Shape
from ._states import NUMBERS, States

HIDDEN, POINTS = (512, 512, 256, 128), (64, 64, 96)  # units of the paper's hidden layers, and of those for every point
FIRST = 32  # points of a cloud that the fully connected network reads: clouds come in farthest-point order
FRAMES = (0, 3, 8, 15)  # that are looked at, counted back from the present
HEADS = 8  # one a corner
FRAME = 10  # numbers of a frame beside its cloud: the grippers from their middle, that middle in the room, held


def maximum(codes: Tensor) -> Tensor:
    """(N, width) maximum over the points of codes (N, P, width), as a pooling: its gradient is far quicker than that of amax."""
    return functional.adaptive_max_pool1d(codes.transpose(1, 2), 1)[..., 0]


class MLP(PredictiveModel):
    """Fully connected network of `hidden` units, in the coordinates of the room."""

    def __init__(self, shape: Shape, normalisation: Normalisation, hidden: Sequence[int] = HIDDEN) -> None:
        super().__init__(shape, normalisation)
        _check_units("hidden", hidden)
        self.history_layer = nn.Linear(shape.history * self._frame_size(), hidden[0])
        self.action_layer = nn.Linear(7 * shape.horizon, hidden[0], bias=False)
        last = nn.Linear(hidden[-1], shape.horizon * shape.slots * NUMBERS)
        self.rest = nn.Sequential(nn.ReLU(), *_layers(hidden), last)

    def _frame_size(self) -> int:
        return 3 * min(FIRST, self.shape.points)

    def encode_frames(self, frames: Context) -> Context:
        return {"frame": self.normalise(frames["clouds"][:, :FIRST]).flatten(1)}

    def gather(self, kept: Context) -> Context:
        return {"first": self.history_layer(kept["frame"].flatten(1))}

    def decode(self, context: Context, actions: Tensor, held: Tensor) -> States:
        plan = torch.cat([self.normalise(actions).flatten(1), held.to(actions)], dim=1)
        numbers = self.rest(context["first"] + self.action_layer(plan))
        return self._states(numbers.unflatten(1, (self.shape.horizon, self.shape.slots, NUMBERS)), self.origin)


class PointNet(MLP):
    """PointNet a cloud, shared by all frames, in front of the fully connected network."""

    def __init__(self, shape: Shape, normalisation: Normalisation, hidden: Sequence[int] = HIDDEN) -> None:
        super().__init__(shape, normalisation, hidden)
        self.points = nn.Sequential(*_layers((3, *POINTS)))

    def _frame_size(self) -> int:
        return POINTS[-1]

    def encode_frames(self, frames: Context) -> Context:
        return {"frame": maximum(self.points(self.normalise(frames["clouds"])))}


def _check_units(name: str, units: Sequence[int]) -> None:
    if not 1 <= len(units) <= 32 or not all(type(n) is int and 1 <= n <= 100_000 for n in units):
        raise ValueError(f"{name} must be numbers of units, 1 to 32 of them, each 1 to 100,000, not {units!r:.80}")


def _layers(widths: Sequence[int]) -> list[nn.Module]:
    return [layer for n_in, n_out in itertools.pairwise(widths) for layer in (nn.Linear(n_in, n_out), nn.ReLU())]


class FrameEncoder(nn.Module):
    """A code and a place for each corner of each slot: of a cloud whose points see the whole, the means that attentions take."""

    def __init__(self, slots: int, width: int = 128) -> None:
        super().__init__()
        self.slots, heads = slots, HEADS
        self.first, self.frame = nn.Linear(3, 64), nn.Linear(FRAME, 64)
        self.second = nn.Linear(64, width)
        self.alone, self.whole = nn.Linear(width, width), nn.Linear(width, width)
        self.look, self.value = nn.Linear(width, slots * heads), nn.Linear(width, 16 * heads)
        self.code = nn.Linear((16 + 3) * heads + width, width)

    def forward(self, cloud: Tensor, frame: Tensor) -> tuple[Tensor, Tensor]:
        """Codes (N, slots, width) and places (N, slots, heads, 3) of clouds (N, P, 3) and frames (N, FRAME)."""
        h = functional.gelu(self.first(cloud) + self.frame(frame)[:, None])
        h = functional.gelu(self.second(h))
        h = functional.gelu(self.alone(h) + self.whole(maximum(h))[:, None])  # (N, P, width)
        attention = self.look(h).softmax(dim=1).transpose(1, 2).unflatten(1, (self.slots, HEADS))  # (N, S, H, P)
        places = attention @ cloud[:, None]  # (N, S, H, 3)
        values = self.value(h).unflatten(-1, (HEADS, 16)).transpose(1, 2)  # (N, H, P, 16)
        mean = (attention.transpose(1, 2) @ values).transpose(1, 2).flatten(2)  # (N, S, H * 16)
        whole = maximum(h)[:, None].expand(-1, self.slots, -1)
        return functional.gelu(self.code(torch.cat([mean, places.flatten(2), whole], dim=-1))), places


class LoopCast(PredictiveModel):
    """Our predictor: codes of points, frames and slots have `width`, those of the plan's steps `step_width`."""

    inputs = ("clouds", "grippers", "held")
    plans_at_once = 20

    def __init__(self, shape: Shape, normalisation: Normalisation, width: int = 128, step_width: int = 48) -> None:
        super().__init__(shape, normalisation)
        _check_units("width and step_width", (width, step_width))
        self.frames = [back for back in FRAMES if back < shape.history]
        self.encoder = FrameEncoder(shape.slots, width)
        self.slot_name = nn.Parameter(0.1 * torch.randn(shape.slots, width))
        self.join = nn.Linear((width + 3 * HEADS + FRAME) * len(self.frames), width)
        self.mix = nn.Linear(width, width)
        self.present = nn.Linear(width, NUMBERS)
        self.hold = nn.Linear(width, 3)
        self.step_in, self.step_past = nn.Linear(24, step_width), nn.Linear(step_width, step_width)
        self.from_step, self.from_slot = nn.Linear(2 * step_width, step_width), nn.Linear(width, step_width, bias=False)
        self.change = nn.Linear(step_width, NUMBERS)
        nn.init.normal_(self.change.weight, std=0.01)
        nn.init.zeros_(self.change.bias)
        nn.init.normal_(self.present.weight, std=0.01)
        nn.init.zeros_(self.hold.weight)
        self.hold.bias.data = torch.tensor([0.0, 0.0, -4.0])  # as the baseline `carry`

    def encode_frames(self, frames: Context) -> Context:
        grippers, scale = frames["grippers"], self.normalisation.scale
        middle = grippers.mean(dim=1)
        sides = ((grippers - middle[:, None]) / scale).flatten(1)
        frame = torch.cat([sides, self.normalise(middle), frames["held"].to(sides)[:, None]], dim=1)
        code, places = self.encoder((frames["clouds"] - middle[:, None]) / scale, frame)
        return {"code": code, "places": places * scale + middle[:, None, None], "frame": frame, "grippers": grippers}

    def gather(self, kept: Context) -> Context:
        """The slots' codes, the present loops, and where they start."""
        grippers = kept["grippers"][:, 0]
        places = kept["places"]  # (B, F, slots, heads, 3)
        middle = grippers.mean(dim=1)[:, None]  # (B, 1, 3)
        beside = ((places - middle[:, None, None]) / self.normalisation.scale).flatten(3)
        frame = kept["frame"][:, :, None].expand(-1, -1, self.shape.slots, -1)
        history = torch.cat([kept["code"], beside, frame], dim=-1).transpose(1, 2).flatten(2)  # (B, slots, ...)
        slot = functional.gelu(self.join(history) + self.slot_name)
        slot = slot + functional.gelu(self.mix(slot))  # (B, slots, width)
        anchor = places[:, 0, :, :4].mean(dim=2)  # (B, slots, 3): of the killer triangles
        corners = ((places[:, 0] - anchor[:, :, None]) / self.normalisation.scale).flatten(2)
        start = self.present(slot) + functional.pad(corners, (0, NUMBERS - corners.shape[-1]))
        hold = self.hold(slot).softmax(dim=-1)[..., :2]
        return {"slot": slot, "anchor": anchor, "start": start, "hold": hold, "grippers": grippers}

    def present_states(self, context: Context) -> States:
        """The present loops, (B, 1, slots)."""
        return self._states(context["start"][:, None], context["anchor"][:, None, :, None])

    def decode(self, context: Context, actions: Tensor, held: Tensor) -> States:
        code, carried = self._plan(context["grippers"], actions, held)
        hidden = code[:, :, None] + self.from_slot(context["slot"])[:, None]
        change = self.change(functional.relu(hidden, inplace=True))  # (C, K, slots, NUMBERS): what the network adds
        moved = context["hold"][:, None] @ carried  # (C, K, slots, 3): each loop follows the grippers in its own shares
        return self._states(context["start"][:, None] + change, (context["anchor"][:, None] + moved)[..., None, :])

    def _plan(self, grippers: Tensor, actions: Tensor, held: Tensor) -> tuple[Tensor, Tensor]:
        """Codes (C, K, step_width) of the steps, causal, and how far each gripper has carried by then (C, K, 2, 3), metres."""
        scale, (n, steps) = self.normalisation.scale, actions.shape[:2]
        before = torch.cat([grippers[:, None].expand(n, -1, -1, -1), actions[:, :-1]], dim=1)
        velocity = actions - before
        holds = held.to(actions)
        carried = (velocity * holds[..., None, None]).cumsum(dim=1)
        since = torch.linspace(1 / steps, 1, steps).to(actions).expand(n, -1)
        free = (1 - holds).cumsum(dim=1) / steps
        numbers = [
            ((actions - grippers[:, None]) / scale).flatten(2),
            (10 / scale * velocity).flatten(2),
            (carried / scale).flatten(2),
            self.normalise(actions.mean(dim=2)),
            torch.stack([holds, since, free], dim=-1),
        ]
        h = functional.gelu(self.step_in(torch.cat(numbers, dim=-1)))
        count = torch.arange(1, steps + 1, device=h.device)[:, None]
        mean = functional.gelu(self.step_past(h)).cumsum(dim=1) / count
        return self.from_step(torch.cat([h, mean], dim=-1)), carried
