"""LoopCast, our predictor: find the loops now, carry them with the grippers, learn the rest.

Idea, four choices against the paper's networks:

1. *Relative coordinates.* Points are seen from the middle between the grippers, so that what is learned at one place of the
   room holds near it. (Not everywhere: the network is told where that middle is, or it could not know where the hook is.)
2. *Pointing.* A corner of a loop's triangles is an average of the cloud's own points under learned attention, plus a little,
   not a number that a network has to make up: a centimetre is then easy.
3. *Carrying.* The forecast is the present loop moved with the grippers for as long as they hold, in learned shares, plus
   what the network adds. Untrained it is already the baseline `carry`.
4. *Slots.* Each loop has its own code; a step of the plan has one too (from the actions up to that step, none after it). A
   small network of the two gives the state. Frames are encoded once, when they arrive, and plans share the history.
5. *Trust.* If `tracked`, a slot also knows what seqPH saw of its loop, on all the points there are. It starts from there or
   from where it points, in a share that it learns: a tracker is exact on a good cloud and lost on a bad one.

Source: attention as in Vaswani et al. 2017; slots as in Locatello et al. 2020 and Carion et al. 2020. Taught in chapter 10.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

from .base import Context, Normalisation, PredictiveModel, Shape, numbers_of_values, states_from_numbers
from .baselines import last_appearance
from .states import NUMBERS, States

__all__ = ["FrameEncoder", "LoopCast"]

HEADS = 8  # one a corner
TRACKED = 35  # numbers of a tracked loop
FRAME = 10  # numbers of a frame beside its cloud: the grippers from their middle, that middle in the room, held


class FrameEncoder(nn.Module):
    """A code and a place for each corner of each slot, from one cloud.

    Every point sees the whole cloud through its maximum (PointNet's segmentation network), then each slot looks at the points
    with eight attentions: it takes the mean of their values, and the mean of their places.
    """

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
        h = functional.gelu(self.alone(h) + self.whole(h.amax(dim=1))[:, None])  # (N, P, width)
        attention = self.look(h).softmax(dim=1).transpose(1, 2).unflatten(1, (self.slots, HEADS))  # (N, S, H, P)
        places = attention @ cloud[:, None]  # (N, S, H, 3)
        values = self.value(h).unflatten(-1, (HEADS, 16)).transpose(1, 2)  # (N, H, P, 16)
        seen = (attention.transpose(1, 2) @ values).transpose(1, 2).flatten(2)  # (N, S, H * 16)
        whole = h.amax(dim=1)[:, None].expand(-1, self.slots, -1)
        return functional.gelu(self.code(torch.cat([seen, places.flatten(2), whole], dim=-1))), places


class LoopCast(PredictiveModel):
    """See the head of this file.

    Parameters
    ----------
    frames : sequence of int
        How many frames back the history is looked at; 0 is now.
    width : int
        Of the codes of points, frames and slots.
    step_width : int
        Of the codes of the plan's steps.
    tracked : bool
        Whether what seqPH saw in the history is looked at too.
    """

    inputs = ("clouds", "grippers", "held")
    plans_at_once = 20

    def __init__(
        self,
        shape: Shape,
        normalisation: Normalisation,
        frames: Sequence[int] = (0, 3, 8, 15),
        width: int = 128,
        step_width: int = 48,
        tracked: bool = False,
    ) -> None:
        super().__init__(shape, normalisation)
        if not frames or frames[0] != 0 or max(frames) >= shape.history or len(set(frames)) != len(frames):
            raise ValueError(f"frames must be different, begin with 0 and be below {shape.history}, not {list(frames)}")
        self.frames, self.tracked = list(frames), tracked
        self.encoder = FrameEncoder(shape.slots, width)
        self.slot_name = nn.Parameter(0.1 * torch.randn(shape.slots, width))
        self.join = nn.Linear((width + 3 * HEADS + FRAME) * len(frames), width)
        if tracked:
            self.state, self.trust = nn.Linear(TRACKED, width), nn.Linear(width, 1)
            nn.init.zeros_(self.trust.weight)
            nn.init.constant_(self.trust.bias, 2.0)
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

    # -- the history --------------------------------------------------------------------------------------------------------

    def encode_frames(self, frames: Context) -> Context:
        """Codes and places of the slots, from clouds, grippers and held."""
        grippers, scale = frames["grippers"], self.normalisation.scale
        middle = grippers.mean(dim=1)
        sides = ((grippers - middle[:, None]) / scale).flatten(1)
        frame = torch.cat([sides, self.normalise(middle), frames["held"].to(sides)[:, None]], dim=1)
        code, places = self.encoder((frames["clouds"] - middle[:, None]) / scale, frame)
        return {"code": code, "places": places * scale + middle[:, None, None], "frame": frame, "grippers": grippers}

    def gather(self, kept: Context) -> Context:
        """The slots' codes, the places that they point at now, and the present loops."""
        grippers = kept["grippers"][:, 0]
        places = kept["places"]  # (B, F, slots, heads, 3)
        middle = grippers.mean(dim=1)[:, None]  # (B, 1, 3)
        seen = ((places - middle[:, None, None]) / self.normalisation.scale).flatten(3)
        frame = kept["frame"][:, :, None].expand(-1, -1, self.shape.slots, -1)
        history = torch.cat([kept["code"], seen, frame], dim=-1).transpose(1, 2).flatten(2)  # (B, slots, ...)
        joined = self.join(history) + self.slot_name
        last = last_appearance(kept) if self.tracked else None
        if last is not None:
            since = (grippers[:, None] - last["seen_at"]).mean(dim=2)  # (B, slots, 3): how far it was carried
            last["corners"] = last["corners"] + since[..., None, :]
            joined = joined + self.state(self.numbers_of(last, kept))
        slot = functional.gelu(joined)
        slot = slot + functional.gelu(self.mix(slot))  # (B, slots, width)
        anchor, start = self.around(places[:, 0])
        if last is not None:
            trust = self.trust(slot).sigmoid() * last["known"][..., None]
            seen_at, numbers = self.around(last["corners"])
            values = [last["neighbour_values"], last["birth"][..., None], (last["death"] - last["birth"])[..., None]]
            numbers[..., 24:30] = numbers_of_values(torch.cat(values, dim=-1), self.normalisation.value)
            anchor, start = anchor + trust * (seen_at - anchor), start + trust * (numbers - start)
        return {
            "slot": slot,
            "anchor": anchor,
            "present": self.present(slot) + start,
            "hold": self.hold(slot).softmax(dim=-1)[..., :2],
            "grippers": grippers,
        }

    def around(self, corners: Tensor) -> tuple[Tensor, Tensor]:
        """The middle (B, slots, 3) of the killer triangles' corners, and the corners about it as numbers (B, slots, NUMBERS)."""
        middle = corners[..., :4, :].mean(dim=-2)
        numbers = ((corners - middle[..., None, :]) / self.normalisation.scale).flatten(-2)
        return middle, functional.pad(numbers, (0, NUMBERS - numbers.shape[-1]))

    def numbers_of(self, last: Context, kept: Context) -> Tensor:
        """What a tracker saw of each loop, (B, slots, TRACKED): its last state, how often it was there, how far it strayed."""
        scale, value, grippers = self.normalisation.scale, self.normalisation.value, kept["past_grippers"]
        seen = kept["past_present"].to(grippers)  # (B, h, slots)
        times = seen.sum(dim=1)
        beside = kept["past_triangles"][..., :2, :, :].mean(dim=(-3, -2)) - grippers.mean(dim=2)[:, :, None]
        mean = (beside * seen[..., None]).sum(dim=1) / times[..., None].clamp_min(1)
        wander = ((beside - mean[:, None]).square().sum(dim=-1) * seen).sum(dim=1) / times.clamp_min(1)
        values = [last["birth"], last["death"], *last["neighbour_values"].unbind(dim=-1)]
        numbers = [
            ((last["corners"] - grippers[:, 0].mean(dim=1)[:, None, None]) / scale).flatten(2),
            torch.stack(values, dim=-1) / value,
            torch.stack([last["known"].to(seen), seen[:, 0], seen[:, :4].mean(dim=1), seen.mean(dim=1)], dim=-1),
            (wander + 1e-8).sqrt()[..., None] * (10 / scale),
        ]
        return torch.cat(numbers, dim=-1)

    def now(self, context: Context) -> States:
        """The present loops: about the places pointed at."""
        numbers, anchor = context["present"][:, None], context["anchor"][:, None]
        return states_from_numbers(numbers, anchor, self.normalisation.scale, self.normalisation.value)

    # -- the plan -----------------------------------------------------------------------------------------------------------

    def decode(self, context: Context, actions: Tensor, held: Tensor) -> States:
        """The present loops carried along, and what the network adds."""
        code, carried = self.plan(context["grippers"], actions, held)
        hidden = code[:, :, None] + self.from_slot(context["slot"])[:, None]
        change = self.change(functional.relu(hidden, inplace=True))  # (C, K, slots, NUMBERS)
        moved = context["hold"][:, None] @ carried  # (C, K, slots, 3): each loop follows the grippers in its own shares
        about = context["anchor"][:, None] + moved
        numbers = context["present"][:, None] + change
        return states_from_numbers(numbers, about, self.normalisation.scale, self.normalisation.value)

    def plan(self, grippers: Tensor, actions: Tensor, held: Tensor) -> tuple[Tensor, Tensor]:
        """Codes (C, K, step_width) of the steps, and how far each gripper has carried by then (C, K, 2, 3), metres.

        Causal: a step knows the plan up to itself.
        """
        scale, (n, steps) = self.normalisation.scale, actions.shape[:2]
        before = torch.cat([grippers[:, None].expand(n, -1, -1, -1), actions[:, :-1]], dim=1)
        velocity = actions - before
        holds = held.to(actions)
        carried = (velocity * holds[..., None, None]).cumsum(dim=1)
        since = torch.linspace(1 / steps, 1, steps).to(actions).expand(n, -1)
        free = (1 - holds).cumsum(dim=1) / steps
        middle = self.normalise(actions.mean(dim=2))
        numbers = [
            ((actions - grippers[:, None]) / scale).flatten(2),
            (10 / scale * velocity).flatten(2),
            (carried / scale).flatten(2),
            middle,
            torch.stack([holds, since, free], dim=-1),
        ]
        h = functional.gelu(self.step_in(torch.cat(numbers, dim=-1)))
        mean = functional.gelu(self.step_past(h)).cumsum(dim=1) / (since[..., None] * steps)
        return self.from_step(torch.cat([h, mean], dim=-1)), carried
