"""LoopCast, our predictor: find the loops, carry them with the grippers, learn the rest.

Idea, five choices against the paper's networks:

1. *Relative coordinates.* Points are seen from the middle between the grippers; the network is told where that middle is.
2. *Pointing.* A corner of a loop's triangles is an average of the cloud's own points under learned attention, plus a little.
3. *Carrying.* The forecast is the present loop moved with the grippers for as long as they hold, in learned shares, plus
   what the network adds. Untrained it is already the baseline `carry`.
4. *Slots.* Each loop has its own code; a step of the plan has one too (from the actions up to that step, none after it). A
   small network of the two gives the state. Frames are encoded once, when they arrive, and plans share the history.
5. *Belief.* If `tracked`, every loop that seqPH tracks is given to the slot that points nearest to it, and pulls it to where
   seqPH sees it, as far as such a loop has deserved it in training. For a plan of no steps the network adds nothing.

Source: attention as in Vaswani et al. 2017; slots as in Locatello et al. 2020 and Carion et al. 2020. Taught in chapter 10.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from ._base import Context, Normalisation, PredictiveModel, Shape, maximum
from ._baselines import last_appearance
from ._states import NUMBERS, States, cheapest_order

FRAMES = (0, 3, 8, 15)  # that are looked at, counted back from the present
HEADS = 8  # one a corner
RELIABLE = 11  # numbers that say how far a tracked loop can be believed
FRAME = 10  # numbers of a frame beside its cloud: the grippers from their middle, that middle in the room, held


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

    def __init__(
        self,
        shape: Shape,
        normalisation: Normalisation,
        width: int = 128,
        step_width: int = 48,
        tracked: bool = False,
    ) -> None:
        super().__init__(shape, normalisation)
        self.frames, self.tracked = [back for back in FRAMES if back < shape.history], tracked
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
        if tracked:
            score = nn.Linear(32, 2)
            score.bias.data = torch.tensor([3.0, 3.0])
            self.belief = nn.Sequential(nn.Linear(RELIABLE, 32), nn.GELU(), score)
            self.notice = nn.Linear(3 + 2 + 1, width)
            nn.init.zeros_(self.notice.weight)
            nn.init.zeros_(self.notice.bias)

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
        present = self.present(slot) + functional.pad(corners, (0, NUMBERS - corners.shape[-1]))
        context = {"slot": slot, "anchor": anchor, "start": present, "pointed": anchor, "present": present}
        if self.tracked:
            context |= self._corrected(context, kept)
            context["slot"] = slot + self.notice(context["noticed"])
            standing = self._changes(self._standing(kept), context["slot"])[:, 0]
            context["start"] = context["start"] - standing  # a plan of no steps changes nothing
        return context | {"hold": self.hold(context["slot"]).softmax(dim=-1)[..., :2], "grippers": grippers}

    def _corrected(self, context: Context, kept: Context) -> Context:
        """Where the loops start when the tracked ones pull them: `anchor` and `start`, and the `belief` in each (B, slots).

        A tracked loop has no say in the shape: the killer edge leaps from frame to frame, and its ends have no order. Belief is
        learned from the present alone: the forecast has no say in it, and may take back over the steps what it is told here.
        """
        pointed, present = context["pointed"], context["present"]
        scale, value = self.normalisation.scale, self.normalisation.value
        last = last_appearance(kept)
        since = (kept["past_grippers"][:, :1] - last["grippers_then"]).mean(dim=2)  # how far it was carried
        found = States.among(last).mean + since
        guessed = self._states(present, pointed[..., None, :]).mean
        apart = torch.cdist(guessed.detach(), found)  # (B, slots, tracked)
        order = cheapest_order(apart * last["known"][:, None])
        row = torch.arange(len(order), device=order.device)[:, None]
        score = self.belief(self._reliability(last, kept)).float()[row, order]
        belief = score[..., :1].sigmoid() * last["known"][row, order][..., None]
        values = torch.stack([last["birth"], last["death"] - last["birth"]], dim=-1)[row, order]
        off, wrong = found[row, order] - guessed, _numbers_of(values / value) - present[..., 28:30]
        believed = belief.detach()
        surer = believed * (score[..., 1:] - present[..., 31:])  # that it is tracked speaks for its being there
        none = torch.zeros_like(present[..., :28])
        return {
            "anchor": pointed + believed * off,
            "start": present + torch.cat([none, believed * wrong, none[..., :1], surer], dim=-1),
            "noticed": torch.cat([believed * off / scale, believed * wrong, believed], dim=-1),
            "belief": belief[..., 0],
            "believed": pointed.detach() + belief * off.detach(),
        }

    def _reliability(self, last: Context, kept: Context) -> Tensor:
        """Values, how often it was there and how far it strayed from the grippers, of each tracked loop (B, slots, RELIABLE)."""
        # Not how far it is from where a slot points: on unknown garments that is far, and the tracker needed most.
        grippers, there = kept["past_grippers"], kept["past_present"].to(kept["past_grippers"])  # (B, h, loops)
        beside = kept["past_triangles"][..., :2, :, :].mean(dim=(-3, -2)) - grippers.mean(dim=2)[:, :, None]
        times = there.sum(dim=1).clamp_min(1)
        mean = (beside * there[..., None]).sum(dim=1) / times[..., None]
        stray = ((beside - mean[:, None]).square().sum(dim=-1) * there).sum(dim=1) / times
        values = torch.stack([last["birth"], last["death"], *last["neighbour_values"].unbind(dim=-1)], dim=-1)
        often = torch.stack([last["known"].to(there), there[:, 0], there[:, :4].mean(dim=1), there.mean(dim=1)], dim=-1)
        far = (stray + 1e-8).sqrt()[..., None] * (10 / self.normalisation.scale)
        return torch.cat([values / self.normalisation.value, often, far], dim=-1)

    def present_states(self, context: Context) -> States:
        """The present loops, about the places pointed at; if `tracked`, in a second step, about those that they are pulled to."""
        numbers, about = context["present"][:, None], context["pointed"][:, None]
        if self.tracked:  # for the belief alone: the same loops elsewhere
            numbers = torch.cat([numbers, numbers.detach()], dim=1)
            about = torch.cat([about, context["believed"][:, None]], dim=1)
        return self._states(numbers, about[..., None, :])

    def decode(self, context: Context, actions: Tensor, held: Tensor) -> States:
        code, carried = self._plan(context["grippers"], actions, held)
        change = self._changes(code, context["slot"])
        moved = context["hold"][:, None] @ carried  # (C, K, slots, 3): each loop follows the grippers in its own shares
        return self._states(context["start"][:, None] + change, (context["anchor"][:, None] + moved)[..., None, :])

    def _changes(self, code: Tensor, slot: Tensor) -> Tensor:
        """What the network adds (C, K, slots, NUMBERS), of codes of steps (C, K, step_width) and of slots."""
        hidden = code[:, :, None] + self.from_slot(slot)[:, None]
        return self.change(functional.relu(hidden, inplace=True))

    def _plan(self, grippers: Tensor, actions: Tensor, held: Tensor) -> tuple[Tensor, Tensor]:
        """Codes (C, K, step_width) of the steps, causal, and how far each gripper has carried by then (C, K, 2, 3), metres."""
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
        return self._code(torch.cat(numbers, dim=-1)), carried

    def _standing(self, kept: Context) -> Tensor:
        """The code (B, 1, step_width) of a step before the first: nothing has moved."""
        frame = kept["frame"][:, 0]  # with the middle of the grippers in the room, and held, at the end
        numbers = functional.pad(frame[:, None, 6:], (18, 2))
        return self._code(numbers)

    def _code(self, numbers: Tensor) -> Tensor:
        """Codes (C, K, step_width) of the numbers (C, K, 24) of steps, each with the mean over those up to it."""
        h = functional.gelu(self.step_in(numbers))
        count = torch.arange(1, numbers.shape[1] + 1, device=numbers.device)[:, None]
        mean = functional.gelu(self.step_past(h)).cumsum(dim=1) / count
        return self.from_step(torch.cat([h, mean], dim=-1))


def _numbers_of(values: Tensor) -> Tensor:
    """The inverse of `PredictiveModel._positive`, in units of `value`; small ones are cut off."""
    y = (2 * values).clamp_min(0.1)
    return (y.square() - 1) / (2 * y)
