"""Where targets stand: elsewhere, on the move, with others about them."""

from __future__ import annotations

from dataclasses import field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from topokit._config import NotNegative, Positive, checked
from topokit._validate import as_points

from ._surface import Array, turned
from ._targets import Rod, Target


@checked
class Placed(Target):
    """Another target elsewhere: turned about the z axis by `yaw`, and then moved by x, y and z.

    Tasks plan for the target as it is and carry the path over, with the garment. What a target of one's own must be to be
    placed is a `Target`: each of its numbers may be of any sign, as its class allows.
    """

    target: Target  #: any, a placed one too
    x: float = 0.0  #: metres, where the origin that the target is described from goes
    y: float = 0.0  #: metres
    z: float = 0.0  #: metres
    yaw: float = 0.0  #: degrees, from x towards y
    distance: float = field(default=0.0, init=False, kw_only=True)  #: not asked for: that of its target counts

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", self.target.name)

    @property
    def place(self) -> Array:
        """(3,) x, y and z."""
        return np.array([self.x, self.y, self.z])

    @property
    def centre_line(self) -> Array:
        return self._there(self.target.centre_line)

    @property
    def rods(self) -> list[Rod]:
        return [(self._there(start), self._there(end), radius) for start, end, radius in self.target.rods]

    @property
    def seat(self) -> Array:
        return self._there(self.target.seat)

    @property
    def lowest(self) -> float:
        return self.target.lowest + self.z

    def holds(self, loop: ArrayLike) -> bool:
        """Whether its target holds the loop moved back."""
        return self.target.holds(turned(as_points(loop, "loop") - self.place, -self.yaw))

    def at(self, time: float) -> Target:
        return replace(self, target=self.target.at(time))

    def describe(self) -> dict[str, Any]:
        own = self.target.describe()
        position = self._there(own["position"]).tolist()
        return {**own, "position": position, "yaw": own.get("yaw", 0.0) + self.yaw}

    def _there(self, places: ArrayLike) -> Array:
        return turned(places, self.yaw) + self.place


@checked
class Moving(Placed):
    """A target that goes from where it is described to x, y and z from there, and stands still before and after.

    It goes as a reaching hand does, by a polynomial of degree five. What it is after its way counts for scripts, for success and
    for an episode's centre line.
    """

    start: NotNegative = 0.5  #: seconds after the first frame when it sets off
    seconds: Positive = 1.0  #: that it takes

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.yaw:
            raise ValueError(f"yaw is {self.yaw}: a target that moves does not turn; place it turned, and move that")

    def at(self, time: float) -> Target:
        share = min(max((time - self.start) / self.seconds, 0.0), 1.0)
        x, y, z = (share**3 * (10 - 15 * share + 6 * share**2) * self.place).tolist()
        return Placed(self.target.at(time), x, y, z)

    def describe(self) -> dict[str, Any]:
        way = {"by": self.place.tolist(), "start": self.start, "seconds": self.seconds}
        return {**super().describe(), "moves": way}


@checked
class Travelling(Placed):
    """A target that goes on and on at one speed, level; what is planned and described is where it was at first."""

    vx: float = 0.0  #: m/s
    vy: float = 0.0  #: m/s

    def at(self, time: float) -> Target:
        return Placed(self.target.at(time), self.x + self.vx * time, self.y + self.vy * time, self.z, self.yaw)

    def describe(self) -> dict[str, Any]:
        return {**super().describe(), "velocity": [self.vx, self.vy]}


@checked
class Among(Target):
    """A target with others about it, which are in the way: nothing counts that hangs on those."""

    target: Target  #: the one that is asked for
    others: tuple[Target, ...]  #: placed where they stand
    distance: float = field(default=0.0, init=False, kw_only=True)  #: not asked for: that of its target counts

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", self.target.name)

    @property
    def centre_line(self) -> Array:
        return self.target.centre_line

    @property
    def rods(self) -> list[Rod]:
        return [rod for one in (self.target, *self.others) for rod in one.rods]

    @property
    def seat(self) -> Array:
        return self.target.seat

    @property
    def lowest(self) -> float:
        return self.target.lowest

    def holds(self, loop: ArrayLike) -> bool:
        """Whether the one that is asked for does."""
        return self.target.holds(loop)

    def at(self, time: float) -> Target:
        return Among(self.target.at(time), tuple(one.at(time) for one in self.others))

    def describe(self) -> dict[str, Any]:
        return {**self.target.describe(), "others": [{"name": one.name, **one.describe()} for one in self.others]}
