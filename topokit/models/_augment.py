"""More data from the same data: the room in a mirror, and histories that are seen badly.

Scenes are alike left and right of the plane x = 0 in which the targets stand: the mirror image of an episode could have happened.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from topokit._config import checked
from topokit.data import spoil

from ._base import PAST
from ._states import Window

_PLACES = ("clouds", "grippers", "actions", "triangles", "past_triangles", "seen_triangles")
_PAIRS = ("grippers", "actions")
_Part = Annotated[float, Field(ge=0, lt=1)]


@checked
class Spoiling:
    """How much worse a model sees the history in training than the labels' tracker did; nothing, when not said."""

    clouds: _Part = 0.0  #: share of windows whose clouds are spoilt, each by an amount of its own, up to the next three
    noise: _Part = 0.0  #: standard deviation on every coordinate, metres
    outliers: _Part = 0.0  #: share of points that are anywhere in the cloud's box and 10 cm around it
    drop: _Part = 0.0  #: share of points that are missing; others stand twice in their place
    seen: _Part = 0.0  #: share of windows whose tracked states are the `seen_` ones
    lost: _Part = 0.0  #: share of windows of which nothing is tracked
    #: Share of slots, taken or not, that hold a false loop: another window's, flickering, each time elsewhere by some 10 cm.
    false: _Part = 0.0


def mirrored(window: Window, which: Tensor) -> dict[str, Tensor]:
    """A batch of windows, those where `which` (B,) is true seen in the mirror x -> -x, where the grippers change names."""
    flipped = dict(window)
    for name in (name for name in _PLACES if name in window):
        image = window[name] * window[name].new_tensor([-1.0, 1.0, 1.0])
        flipped[name] = _chosen(which, image.flip(-2) if name in _PAIRS else image, window[name])
    return flipped


def spoilt(window: Window, how: Spoiling, generator: torch.Generator) -> dict[str, Tensor]:
    """A batch of windows as it is shown to a model; the labels that it is held against are those of `window`."""
    shown, n = dict(window), len(window["clouds"])
    chosen = torch.rand(n, generator=generator) < how.clouds
    if chosen.any():
        shown["clouds"] = window["clouds"].clone()
        shown["clouds"][chosen] = _spoilt_clouds(window["clouds"][chosen], how, generator)
    if how.seen or how.lost or how.false:
        shown |= _spoilt_tracks(window, how, generator)
    return shown


def _spoilt_clouds(clouds: Tensor, how: Spoiling, generator: torch.Generator) -> Tensor:
    """Clouds (n, h, P, 3) with points missing, noise, and outliers, every window by amounts of its own."""
    rng = np.random.default_rng(int(torch.randint(2**62, (), generator=generator)))
    noise, outliers, drop = (most * rng.random((len(clouds), 1)) for most in (how.noise, how.outliers, how.drop))
    return torch.from_numpy(spoil(clouds.cpu().numpy(), rng, noise=noise, outliers=outliers, keep=1 - drop)).to(clouds)


def _spoilt_tracks(window: Window, how: Spoiling, generator: torch.Generator) -> dict[str, Tensor]:
    """What is tracked in the history: by a worse tracker, nothing at all, or false loops."""
    n, _, slots = window["past_present"].shape
    tracked = {name: window[name] for name in PAST}
    worse = torch.rand(n, generator=generator) < how.seen
    if worse.any():
        tracked = {name: _chosen(worse, window[name.replace("past_", "seen_")], part) for name, part in tracked.items()}
    false = _false_loops(tracked, window["grippers"], generator)
    wrong = torch.rand(n, 1, slots, generator=generator) < how.false
    kept = torch.rand(n, generator=generator) >= how.lost
    return {
        name: _chosen(kept, _chosen(wrong, false[name], part), torch.zeros_like(part)) for name, part in tracked.items()
    }


def _false_loops(tracked: Window, grippers: Tensor, generator: torch.Generator) -> dict[str, Tensor]:
    """In each slot the first loop of the window before, about these grippers, flickering and leaping."""
    size = tracked["past_present"].shape  # (n, h, slots)
    others = {name: part[:, :, :1].roll(1, dims=0).expand_as(part) for name, part in tracked.items()}
    often = 0.6 * torch.rand(size[0], 1, size[2], generator=generator)
    there = others["past_present"] & (torch.rand(size, generator=generator) < often).to(grippers.device)
    middle = grippers.mean(dim=2)
    beside = (middle - middle.roll(1, dims=0))[:, :, None]
    leaps = (0.1 * torch.randn(*size, 3, generator=generator)).to(grippers)
    others["past_triangles"] = others["past_triangles"] + (beside + leaps)[..., None, None, :]
    return {name: _chosen(there, part, torch.zeros_like(part)) for name, part in others.items()}


def _chosen(which: Tensor, part: Tensor, other: Tensor) -> Tensor:
    """One of two parts of windows, as `which` says for their leading axes."""
    return torch.where(which.reshape(*which.shape, *(1,) * (part.dim() - which.dim())).to(part.device), part, other)
