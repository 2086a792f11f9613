"""More data from the same data: the room in a mirror.

The scenes are alike left and right of the plane x = 0 in which the targets stand, so that the mirror image of an episode is one
that could have happened, with the grippers' names exchanged.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

__all__ = ["mirrored"]

_PLACES = ("clouds", "grippers", "actions", "triangles", "past_triangles")
_PAIRS = ("grippers", "actions")


def mirrored(window: Mapping[str, Tensor], which: Tensor) -> dict[str, Tensor]:
    """A batch of windows, those where `which` (B,) is true seen in the mirror x -> -x."""
    flipped = dict(window)
    for name in _PLACES:
        places = window[name]
        other = places * places.new_tensor([-1.0, 1.0, 1.0])
        if name in _PAIRS:
            other = other.flip(-2)
        flipped[name] = torch.where(which.reshape(-1, *(1,) * (places.dim() - 1)), other, places)
    return flipped
