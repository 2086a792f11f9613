"""More data from the same data: the room in a mirror, and histories that are seen badly.

The scenes are alike left and right of the plane x = 0 in which the targets stand, so that the mirror image of an episode is one
that could have happened, with the grippers' names exchanged.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from .base import PAST

__all__ = ["Spoiling", "mirrored", "spoilt"]

_PLACES = ("clouds", "grippers", "actions", "triangles", "past_triangles", "seen_triangles")
_PAIRS = ("grippers", "actions")


@dataclass(frozen=True)
class Spoiling:
    """How much worse a model sees the history in training than the labels' tracker did; nothing, when not said.

    Attributes
    ----------
    clouds : float
        Share of windows whose clouds are spoilt, each by an amount of its own, up to the next three.
    noise : float
        Standard deviation on every coordinate, metres.
    outliers : float
        Share of points that are anywhere in the cloud's box and 10 cm around it.
    drop : float
        Share of points that are missing; others stand twice in their place.
    seen : float
        Share of windows whose tracked states are the `seen_` ones.
    lost : float
        Share of windows of which nothing is tracked.
    false : float
        Share of slots, taken or not, that hold a false loop: one of another window, in up to 60 % of the frames, each time
        elsewhere by some 10 cm.
    """

    clouds: float = 0.0
    noise: float = 0.0
    outliers: float = 0.0
    drop: float = 0.0
    seen: float = 0.0
    lost: float = 0.0
    false: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not isinstance(value, (int, float)) or not 0 <= value < 1:
                raise ValueError(f"spoil.{field.name} must be a number from 0 to below 1, not {value!r}")


def mirrored(window: Mapping[str, Tensor], which: Tensor) -> dict[str, Tensor]:
    """A batch of windows, those where `which` (B,) is true seen in the mirror x -> -x."""
    flipped = dict(window)
    for name in (name for name in _PLACES if name in window):
        places = window[name]
        other = places * places.new_tensor([-1.0, 1.0, 1.0])
        if name in _PAIRS:
            other = other.flip(-2)
        flipped[name] = torch.where(which.reshape(-1, *(1,) * (places.dim() - 1)), other, places)
    return flipped


def spoilt(window: Mapping[str, Tensor], how: Spoiling, generator: torch.Generator) -> dict[str, Tensor]:
    """A batch of windows as it is shown to a model; the labels that it is held against are those of `window`."""
    shown, n = dict(window), len(window["clouds"])
    chosen = torch.nonzero(torch.rand(n, generator=generator) < how.clouds)[:, 0]
    if len(chosen):
        clouds = window["clouds"].clone()
        clouds[chosen] = _spoilt_clouds(clouds[chosen].cpu(), how, generator).to(clouds)
        shown["clouds"] = clouds
    if not (how.seen or how.lost or how.false):
        return shown
    seen = torch.rand(n, generator=generator) < how.seen
    tracked = {name: window[name] for name in PAST}
    if seen.any():
        for name, part in tracked.items():
            other = window[name.replace("past_", "seen_")]
            tracked[name] = torch.where(seen.to(part.device).reshape(-1, *(1,) * (part.dim() - 1)), other, part)
    false = _false_loops(tracked, window["grippers"], generator)
    size = n, 1, tracked["past_present"].shape[-1]
    wrong = torch.rand(size, generator=generator) < how.false
    lost = torch.rand(n, 1, 1, generator=generator) < how.lost
    for name, part in tracked.items():
        here, gone = (which.reshape(*which.shape, *(1,) * (part.dim() - 3)).to(part.device) for which in (wrong, lost))
        tracked[name] = torch.where(gone, torch.zeros_like(part), torch.where(here, false[name], part))
    return shown | tracked


def _false_loops(tracked: Mapping[str, Tensor], grippers: Tensor, generator: torch.Generator) -> dict[str, Tensor]:
    """In each slot the first loop of the window before, about these grippers, flickering and leaping."""
    size = tracked["past_present"].shape  # (n, h, slots)
    others = {name: part[:, :, :1].roll(1, dims=0).expand_as(part) for name, part in tracked.items()}
    often = 0.6 * torch.rand(size[0], 1, size[2], generator=generator)
    there = others["past_present"] & (torch.rand(size, generator=generator) < often).to(grippers.device)
    middle = grippers.mean(dim=2)
    leaps = (0.1 * torch.randn(*size, 3, generator=generator)).to(grippers) + (middle - middle.roll(1, dims=0))[
        :, :, None
    ]
    others["past_triangles"] = others["past_triangles"] + leaps[..., None, None, :]
    return {
        name: torch.where(there.reshape(*size, *(1,) * (part.dim() - 3)), part, torch.zeros_like(part))
        for name, part in others.items()
    }


def _spoilt_clouds(clouds: Tensor, how: Spoiling, generator: torch.Generator) -> Tensor:
    """Clouds (n, h, P, 3) with points missing, noise, and outliers, every frame for itself."""
    n, frames, points = clouds.shape[:3]

    def share(most: float) -> Tensor:
        return most * torch.rand(n, 1, 1, generator=generator)

    order = torch.rand(n, frames, points, generator=generator).argsort(dim=-1)
    left = (points * (1 - share(how.drop))).ceil().long().clamp_min(1)
    order = order.gather(2, torch.arange(points).expand_as(order) % left)
    low, high = clouds.amin(dim=2, keepdim=True) - 0.1, clouds.amax(dim=2, keepdim=True) + 0.1
    seen = clouds.gather(2, order[..., None].expand_as(clouds))
    seen = seen + share(how.noise)[..., None] * torch.randn(seen.shape, generator=generator)
    wild = torch.rand(n, frames, points, generator=generator) < share(how.outliers)
    return torch.where(wild[..., None], low + (high - low) * torch.rand(seen.shape, generator=generator), seen)
