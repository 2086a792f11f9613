"""What a garment is hung on: collision shapes, and the centre line that decides whether it hangs there."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._validate import positive
from topokit.linking import linking_number

__all__ = ["Hook"]

Array = NDArray[np.float64]
_FAR = 100.0  # metres: where an open centre line is closed


@dataclass(frozen=True)
class Hook:
    """A pole with an arm towards the grippers and an upturned tip. Metres, z up; the arm points along -y.

    Attributes
    ----------
    height : float
        Of the arm's axis above the floor.
    reach : float
        Length of the arm from the pole to the tip.
    tip : float
        Height of the tip over the arm's axis.
    radius : float
        Of all three rods. Cloth tunnels through thin rods; 0.02 and more is reliable.
    distance : float
        y of the pole.
    """

    height: float = 1.2
    reach: float = 0.2
    tip: float = 0.06
    radius: float = 0.02
    distance: float = 0.3

    name = "hook"

    def __post_init__(self) -> None:
        for name in ("height", "reach", "tip", "radius"):
            positive(getattr(self, name), name, zero=False)

    @property
    def centre_line(self) -> Array:
        """(4, 3) foot of the pole, pole and arm, arm and tip, end of the tip."""
        near = self.distance - self.reach
        return np.array(
            [
                [0, self.distance, 0],
                [0, self.distance, self.height],
                [0, near, self.height],
                [0, near, self.height + self.tip],
            ]
        )

    @property
    def seat(self) -> Array:
        """(3,) where a strap should come to rest: the middle of the arm."""
        return np.array([0, self.distance - self.reach / 2, self.height])

    @property
    def rods(self) -> list[tuple[Array, Array, float]]:
        """Capsules as (start, end, radius)."""
        line = self.centre_line
        return [(start, end, self.radius) for start, end in itertools.pairwise(line)]

    def closed_centre_line(self) -> Array:
        """Close the centre line far away, always alike: up from the tip, behind the pole, down and back to its foot.

        A loop around the arm links it once; one that has slipped off, or lies on the floor, does not.
        """
        line = self.centre_line
        up = line[-1] + [0, 0, _FAR]
        return np.vstack([line, up, up + [0, _FAR, 0], line[0] + [0, _FAR, -_FAR], line[0] - [0, 0, _FAR]])

    def holds(self, loop: ArrayLike) -> bool:
        """Whether a closed curve (L, 3) winds around the hook: its linking number with the closed centre line is not 0."""
        return linking_number(loop, self.closed_centre_line()) != 0
