"""The paper's second predictor: every cloud through a PointNet, then the fully connected network.

Source: Qi, Su, Mo, Guibas 2017, *PointNet* (a network shared by all points, then the maximum over them, so that the order of
the points does not count), without its transforms of the input; Antonova et al. 2021, section 5. Taught in chapter 10.
"""

from __future__ import annotations

from collections.abc import Sequence

from torch import nn

from .base import Context, Normalisation, Shape, maximum
from .mlp import MLP

__all__ = ["PointNet"]


class PointNet(MLP):
    """PointNet a cloud, shared by all frames, in front of the fully connected network.

    Parameters
    ----------
    hidden : sequence of int
        Units of the hidden layers after the encoder.
    per_point : sequence of int
        Units of the layers shared by all points; the last is the size of a cloud's code.
    """

    def __init__(
        self,
        shape: Shape,
        normalisation: Normalisation,
        hidden: Sequence[int] = (512, 512, 256, 128),
        per_point: Sequence[int] = (64, 64, 96),
    ) -> None:
        self.code = per_point[-1]
        super().__init__(shape, normalisation, hidden)
        layers: list[nn.Module] = []
        for n_in, n_out in zip((3, *per_point), per_point):  # noqa: B905
            layers += [nn.Linear(n_in, n_out), nn.ReLU()]
        self.points = nn.Sequential(*layers)

    def frame_size(self) -> int:
        """The size of a cloud's code."""
        return self.code

    def encode_frames(self, frames: Context) -> Context:
        """The codes of the clouds."""
        return {"frame": maximum(self.points(self.normalise(frames["clouds"])))}
