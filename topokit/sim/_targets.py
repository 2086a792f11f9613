"""Targets: collision shapes to hang a garment on, and the centre line that decides whether it hangs there.

Idea: every target is on the floor z = 0 at y = `distance` and faces the grippers, which come from smaller y. `Placed` puts it
elsewhere. Its centre line starts at the floor and is closed far away (`topokit.linking.close_far`), so that the linking number of
a garment's loop with it is defined. The number is not 0 for a loop on the target. It is 0 for a loop that slipped off, lies
against it or was never on it.
"""

from __future__ import annotations

import itertools
import logging
from abc import ABC, abstractmethod
from dataclasses import asdict, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from topokit._config import NotNegative, Positive, checked
from topokit._geometry import turned
from topokit._validate import as_points
from topokit.linking import close_far, linking_number, to_segment

from ._garments import Garment
from ._surface import Array

Rod = tuple[Array, Array, float]  # a capsule: start, end, radius
_CLEAR = 0.1  # metres from the floor to the lowest vertex of a garment that hangs
_log = logging.getLogger("topokit.sim")
_SHOULDER = 0.3  # radius of the shoulders as a share of the depth of the chest


@checked
class Target(ABC):
    """The interface of a target. Subclass it, as a frozen dataclass, to hang garments on something else."""

    distance: float = field(default=0.3, kw_only=True)  #: y coordinate of the pole or axis, metres

    name: ClassVar[str]

    def at(self, time: float) -> Target:
        """Return the target at a time in seconds after the first frame: itself, unless it moves.

        Parameters
        ----------
        time : float
        """
        return self

    @property
    @abstractmethod
    def centre_line(self) -> Array:
        """Return an open polyline (K, 3) from the floor to the tip, in metres."""

    @property
    @abstractmethod
    def rods(self) -> list[Rod]:
        """Return the shape: capsules as (start, end, radius)."""

    @property
    @abstractmethod
    def seat(self) -> Array:
        """Return the middle (3,) of the place where a strap should come to rest."""

    @property
    def lowest(self) -> float:
        """Return the z below which a loop around the target has slid down and does not hang; by default that of the seat."""
        return float(self.seat[2])

    def holds(self, loop: ArrayLike) -> bool:
        """Return whether a closed curve (L, 3) winds around the target: it links the closed centre line.

        Raises
        ------
        ValueError
            When the curve touches the centre line, or is no closed curve in space.
        """
        return _linked(loop, close_far(self.centre_line))

    def raised_for(self, garment: Garment) -> Target:
        """Return a hook or a hanger raised until this garment hangs clear of the floor; return other targets unchanged.

        Parameters
        ----------
        garment : Garment
        """
        return self

    def describe(self) -> dict[str, Any]:
        """Return the target's sizes and position in the form that an episode records."""
        return {**asdict(self), "position": [0.0, self.distance, 0.0]}


@checked
class Hook(Target):
    """A pole with an arm towards the grippers and an upturned tip. Metres, z up; the arm points along -y.

    A loop around the arm links the centre line. So does a loop around the tip or the pole, which is not off yet.
    """

    height: Positive = 1.2  #: height of the arm's axis above the floor
    reach: Positive = 0.2  #: length of the arm, from the pole to the tip
    tip: Positive = 0.06  #: height of the tip over the arm's axis
    radius: Positive = 0.02  #: radius of all three rods; cloth tunnels through thinner rods

    name = "hook"

    def raised_for(self, garment: Garment) -> Target:
        return _raised(self, garment)

    @property
    def centre_line(self) -> Array:
        """Return the foot and the top of the pole, the end of the arm, and the end of the tip: (4, 3)."""
        pole = self.distance
        near = self.distance - self.reach
        top = self.height + self.tip
        return _upright((pole, 0), (pole, self.height), (near, self.height), (near, top))

    @property
    def seat(self) -> Array:
        return np.array([0, self.distance - self.reach / 2, self.height])

    @property
    def rods(self) -> list[Rod]:
        return _tube(self.centre_line, self.radius)


@checked
class Hanger(Target):
    """A clothes hanger on a rail, as in a wardrobe: the rail runs along x, one arm of the hanger points at the grippers.

    Two arms slope down from the stem, each with an upturned end. A strap hangs when it is around an arm; a strap around
    the stem is around both. Two posts carry the rail.
    """

    height: Positive = 1.3  #: height above the floor of the place where the arms' axes meet under the stem
    width: Positive = 0.44  #: distance between the ends of the arms
    drop: Positive = 0.06  #: height of the meeting of the arms over their ends, less than half the width
    tip: Positive = 0.04  #: height of the upturned ends over the arms' axes there
    stem: Positive = 0.22  #: length of the stem, from the meeting of the arms up to the rail
    radius: Positive = 0.02  #: radius of hanger and rail, see `Hook`
    span: Positive = 1.4  #: distance between the posts, to the left and right of the hanger

    name = "hanger"

    def __post_init__(self) -> None:
        if self.drop >= self.width / 2:
            raise ValueError(f"drop {self.drop} makes the arms steeper than 45 degrees: width is {self.width}")

    def raised_for(self, garment: Garment) -> Target:
        return _raised(self, garment)

    @property
    def centre_line(self) -> Array:
        """Return the centre line (6, 3) through the near arm.

        Its places are the foot and the top of a post, the rail over the hanger, the meeting of the arms, and the end and the tip
        of the near arm.
        """
        return self._line(-1)

    @property
    def seat(self) -> Array:
        return np.array([0, self.distance - self.width / 4, self.height - self.drop / 2])

    @property
    def rods(self) -> list[Rod]:
        """Return one post, half of the rail, the stem and the near arm; then the far arm and the rest of the rail."""
        far_arm = self._line(1)[3:]
        rest_of_rail = self._line(1)[2::-1] * [-1, 1, 1]
        return [rod for line in (self.centre_line, far_arm, rest_of_rail) for rod in _tube(line, self.radius)]

    @property
    def lowest(self) -> float:
        return self.height - self.drop

    def holds(self, loop: ArrayLike) -> bool:
        """Return whether a closed curve (L, 3) winds around either arm."""
        return _linked(loop, *(close_far(self._line(side)) for side in (-1, 1)))

    def _line(self, side: int) -> Array:
        """Return the line from the foot of a post to the tip of the near (-1) or the far arm (1)."""
        pole = self.distance
        top = self.height + self.stem
        end = self.distance + side * self.width / 2
        post = _upright((pole, 0), (pole, top)) + [self.span / 2, 0, 0]
        arm = _upright((pole, top), (pole, self.height), (end, self.lowest), (end, self.lowest + self.tip))
        return np.concatenate([post, arm])


@checked
class Mannequin(Target):
    """A tailor's dummy on a stand: torso, shoulders without arms, neck and head, of an adult's proportions.

    Its centre line is the axis from the floor through the head. A loop hangs when it is around the axis and lower than the
    middle of the head (a neck hole that lies on the crown like a wreath is around the axis too), or when it is around a
    shoulder, as a backpack's straps are.
    """

    height: Positive = 1.6  #: height of the top of the head above the floor
    head_radius: Positive = 0.08  #: half of the breadth of the head
    head_height: Positive = 0.22  #: height of the head, from the chin to the top
    neck_radius: Positive = 0.055  #: radius of the neck, less than the head's
    neck_length: Positive = 0.07  #: distance between head and shoulders
    shoulder_width: Positive = 0.42  #: distance between the ends of the shoulders
    depth: Positive = 0.16  #: depth of the chest, front to back
    torso_length: Positive = 0.5  #: distance from the top of the shoulders to the hips

    name = "mannequin"

    def __post_init__(self) -> None:
        for name, part in (("head_height", "head_radius"), ("shoulder_width", "depth"), ("torso_length", "depth")):
            value = getattr(self, name)
            least = 2 * getattr(self, part)
            if value < least:
                raise ValueError(f"{name} {value} must be at least twice {part}, {least}")
        if self.neck_radius >= self.head_radius:
            raise ValueError(f"neck_radius {self.neck_radius} must be less than head_radius {self.head_radius}")
        if self.lowest <= 0:
            raise ValueError(f"height {self.height} puts the hips below the floor")

    @property
    def shoulder_height(self) -> float:
        """Return the height of the shoulders beside the neck, metres."""
        return self.height - self.head_height - self.neck_length

    @property
    def head_centre(self) -> Array:
        """Return the middle (3,) of the head."""
        return np.array([0, self.distance, self.height - self.head_height / 2])

    @property
    def shoulder(self) -> Array:
        """Return the middle (3,) of the right shoulder's end (x > 0)."""
        radius = _SHOULDER * self.depth
        return np.array([self.shoulder_width / 2 - radius, self.distance, self.shoulder_height - radius - 0.035])

    @property
    def centre_line(self) -> Array:
        """Return foot, hips, shoulders, and top of the head: (4, 3)."""
        return _upright(*((self.distance, z) for z in (0, self.lowest, self.shoulder_height, self.height)))

    @property
    def seat(self) -> Array:
        """Return the place (3,) on the axis at the top of the shoulders, where a neck strap lies."""
        return np.array([0, self.distance, self.shoulder_height])

    @property
    def lowest(self) -> float:
        return self.shoulder_height - self.torso_length

    @property
    def rods(self) -> list[Rod]:
        foot, hips, neck, top = self.centre_line
        # Head, neck, stand and the middle of the torso lie on the axis.
        ball = np.array([0, 0, self.head_radius])
        low = neck - [0, 0, _SHOULDER * self.depth]
        radius = self.depth / 2
        chest = neck - [0, 0, 1.4 * radius]
        hip = hips + [0, 0, radius]
        aside = np.array([self.shoulder_width / 2 - radius - 0.02, 0, 0])
        head = (top - [0, 0, self.head_height] + ball, top - ball, self.head_radius)
        rods = [head, (low, top - ball, self.neck_radius), (foot, hips, 0.02), (chest, hip, radius)]
        # A shoulder and a side of the torso on the right and on the left.
        for side in (1, -1):
            rods.append((low, self.shoulder * [side, 1, 1], _SHOULDER * self.depth))
            rods.append((chest + side * aside, hip + 0.75 * side * aside, radius))
        return rods

    def holds(self, loop: ArrayLike) -> bool:
        """Return whether a closed curve (L, 3) is around the axis and below the middle of the head, or around a shoulder."""
        curve = as_points(loop, "loop")
        foot = self.centre_line[0]
        if curve[:, 2].mean() < self.head_centre[2] and super().holds(curve):
            return True
        # Two more lines go up the axis and out through a shoulder.
        ends = {side: self.shoulder * [side, 1, 1] for side in (-1, 1)}
        return _linked(curve, *(close_far([foot, x * [0, 1, 1], x], end=(side, 0, 0)) for side, x in ends.items()))


@checked
class Placed(Target):
    """Another target at another place: turned about the z axis by `yaw`, and then moved by x, y and z.

    A task plans for the target before it is placed, and moves the path and the garment with it. Any `Target` can be placed.
    """

    target: Target  #: target that is placed; it may be placed already
    x: float = 0.0  #: x of the place to which the origin of the target moves, metres
    y: float = 0.0  #: y of that place, metres
    z: float = 0.0  #: z of that place, metres
    yaw: float = 0.0  #: angle from x towards y, degrees
    distance: float = field(default=0.0, init=False, kw_only=True)  #: zero, since the distance of its target counts

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", self.target.name)

    @property
    def place(self) -> Array:
        """Return the place (3,): x, y and z."""
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
        """Return whether its target holds the loop when both are moved back."""
        return self.target.holds(turned(as_points(loop, "loop") - self.place, -self.yaw))

    def at(self, time: float) -> Target:
        return replace(self, target=self.target.at(time))

    def describe(self) -> dict[str, Any]:
        own = self.target.describe()
        # Positions of nested placements add up.
        position = self._there(own["position"]).tolist()
        return {**own, "position": position, "yaw": own.get("yaw", 0.0) + self.yaw}

    def _there(self, places: ArrayLike) -> Array:
        """Return places of the target after it is placed."""
        return turned(places, self.yaw) + self.place


@checked
class Moving(Placed):
    """A target that moves by x, y and z once, and is at rest before and after.

    It moves by a polynomial of degree five, as a reaching hand does. Scripts, success and an episode's centre line refer to the
    place where it arrives.
    """

    start: NotNegative = 0.5  #: time after the first frame at which it starts to move, seconds
    seconds: Positive = 1.0  #: duration of the motion

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.yaw:
            raise ValueError(f"yaw is {self.yaw}: a moving target does not turn; place it with this yaw, then move it")

    def at(self, time: float) -> Target:
        share = min(max((time - self.start) / self.seconds, 0.0), 1.0)
        x, y, z = (share**3 * (10 - 15 * share + 6 * share**2) * self.place).tolist()
        return Placed(self.target.at(time), x, y, z)

    def describe(self) -> dict[str, Any]:
        move = {"by": self.place.tolist(), "start": self.start, "seconds": self.seconds}
        return {**super().describe(), "moves": move}


@checked
class Travelling(Placed):
    """A target that moves on at a constant level velocity; plans and descriptions refer to its first place."""

    vx: float = 0.0  #: velocity along x, m/s
    vy: float = 0.0  #: velocity along y, m/s

    def at(self, time: float) -> Target:
        return Placed(self.target.at(time), self.x + self.vx * time, self.y + self.vy * time, self.z, self.yaw)

    def describe(self) -> dict[str, Any]:
        return {**super().describe(), "velocity": [self.vx, self.vy]}


def gap(points: Array, target: Target) -> float:
    """Return the least distance of points (N, 3) from the surface of the target."""
    return min(float(to_segment(points, start, end).min()) - radius for start, end, radius in target.rods)


def _raised(target: Hook | Hanger, garment: Garment) -> Target:
    """Return a hook or a hanger that is at least as high as the garment is long; one that was raised leaves `_CLEAR`."""
    short = garment.hangs_down - float(target.seat[2])
    if short <= 0:
        return target
    height = round(target.height + short + _CLEAR, 2)
    _log.warning("the %s is now %.2f m high, because the %s is long", target.name, height, garment.name)
    return replace(target, height=height)


def _linked(loop: ArrayLike, *lines: Array) -> bool:
    """Return whether a loop links any of some closed lines."""
    return any(linking_number(loop, line) != 0 for line in lines)


def _upright(*places: tuple[float, float]) -> Array:
    """Return points (y, z) of the plane x = 0."""
    return np.array([[0.0, y, z] for y, z in places])


def _tube(line: Array, radius: float) -> list[Rod]:
    """Return a rod along each segment of a line."""
    return [(start, end, radius) for start, end in itertools.pairwise(line)]
