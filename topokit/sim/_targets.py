"""Targets: collision shapes to hang a garment on, and the centre line that decides whether it hangs there.

Idea: every target is on the floor z = 0 at y = `distance` and faces the grippers, which come from smaller y; `place` and `yaw`
put all of it elsewhere. Its centre line starts at the floor and is closed far away (`topokit.linking.close_far`), so that the
linking number of a garment's loop with it is defined. The number is not 0 for a loop on the target. It is 0 for a loop that
slipped off, lies against it or was never on it.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from dataclasses import KW_ONLY, asdict
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from topokit._config import Place, Positive, checked
from topokit._geometry import turned
from topokit.linking import close_far, linking_number, to_segment

from ._surface import Array

Rod = tuple[Array, Array, float]  # a capsule: start, end, radius


@checked
class _Target(ABC):
    """A target: its shape, its centre line and its place."""

    _: KW_ONLY
    distance: float = 0.3  #: y coordinate of the pole or axis, metres
    place: Place = (0.0, 0.0, 0.0)  #: (3,) the place to which the origin moves, metres
    yaw: float = 0.0  #: degrees by which it is turned about the origin first, from x towards y

    name: ClassVar[str]

    @abstractmethod
    def _shape(self) -> tuple[Array, Array, list[Rod]]:
        """Return centre line, seat and rods before the target is placed."""

    @property
    def centre_line(self) -> Array:
        """Return an open polyline (K, 3) from the floor to the tip, in metres."""
        return self.placed(self._shape()[0])

    @property
    def seat(self) -> Array:
        """Return the middle (3,) of the place where a strap should come to rest."""
        return self.placed(self._shape()[1])

    @property
    def rods(self) -> list[Rod]:
        """Return the shape: capsules as (start, end, radius)."""
        return [(self.placed(start), self.placed(end), radius) for start, end, radius in self._shape()[2]]

    @property
    def lowest(self) -> float:
        """Return the z below which a loop around the target has slid down and does not hang; by default that of the seat."""
        return float(self.seat[2])

    def placed(self, places: ArrayLike) -> Array:
        """Return places (..., 3) of the target after it is turned and moved."""
        return turned(places, self.yaw) + self.place

    def holds(self, loop: ArrayLike) -> bool:
        """Return whether a closed curve (L, 3) winds around the target: it links the closed centre line."""
        return self._links(loop, self._shape()[0])

    def _links(self, loop: ArrayLike, line: Array) -> bool:
        """Return whether a loop links an open line of the target before it is placed, closed far away."""
        return linking_number(loop, close_far(self.placed(line))) != 0

    def describe(self) -> dict[str, Any]:
        """Return the target's sizes and position in the form that an episode records."""
        sizes = {name: size for name, size in asdict(self).items() if name not in ("place", "yaw")}
        return {**sizes, "position": self.placed([0.0, self.distance, 0.0]).tolist(), "yaw": self.yaw}


@checked
class Hook(_Target):
    """A pole with an arm towards the grippers (-y) and an upturned tip. A loop around arm, tip or pole links the centre line."""

    height: Positive = 1.2  #: height of the arm's axis above the floor
    reach: Positive = 0.2  #: length of the arm, from the pole to the tip
    tip: Positive = 0.06  #: height of the tip over the arm's axis
    radius: Positive = 0.02  #: radius of all three rods; cloth tunnels through thinner rods

    name = "hook"

    def _shape(self) -> tuple[Array, Array, list[Rod]]:
        pole = self.distance
        near = pole - self.reach
        # The foot and the top of the pole, the end of the arm, and the end of the tip.
        line = _upright((pole, 0), (pole, self.height), (near, self.height), (near, self.height + self.tip))
        return line, np.array([0, pole - self.reach / 2, self.height]), _tube(line, self.radius)


@checked
class Hanger(_Target):
    """A clothes hanger on a rail, as in a wardrobe: the rail runs along x, one arm of the hanger points at the grippers.

    A strap hangs when it is around one of the two sloping arms, which have upturned ends; one around the stem is around both.
    """

    height: Positive = 1.3  #: height above the floor of the place where the arms' axes meet under the stem
    width: Positive = 0.44  #: distance between the ends of the arms
    drop: Positive = 0.06  #: height of the meeting of the arms over their ends, less than half the width
    tip: Positive = 0.04  #: height of the upturned ends over the arms' axes there
    stem: Positive = 0.22  #: length of the stem, from the meeting of the arms up to the rail
    radius: Positive = 0.02  #: radius of hanger and rail, see `Hook`
    span: Positive = 1.4  #: distance between the posts, to the left and right of the hanger

    name = "hanger"

    def _shape(self) -> tuple[Array, Array, list[Rod]]:
        line = self._line_of(-1)
        seat = np.array([0, self.distance - self.width / 4, self.height - self.drop / 2])
        # One post, half of the rail, the stem and the near arm; then the far arm and the rest of the rail.
        far_arm = self._line_of(1)[3:]
        rest_of_rail = line[2::-1] * [-1, 1, 1]
        return line, seat, [rod for part in (line, far_arm, rest_of_rail) for rod in _tube(part, self.radius)]

    @property
    def lowest(self) -> float:
        """Return the height of the ends of the arms."""
        return self.height - self.drop + self.place[2]

    def holds(self, loop: ArrayLike) -> bool:
        """Return whether a closed curve (L, 3) winds around either arm."""
        return any(self._links(loop, self._line_of(side)) for side in (-1, 1))

    def _line_of(self, side: int) -> Array:
        """Return the line (6, 3) from the foot of a post over rail and stem to the tip of the near (-1) or the far arm (1)."""
        pole = self.distance
        top = self.height + self.stem
        end = self.distance + side * self.width / 2
        low = self.height - self.drop
        post = _upright((pole, 0), (pole, top)) + [self.span / 2, 0, 0]
        arm = _upright((pole, top), (pole, self.height), (end, low), (end, low + self.tip))
        return np.concatenate([post, arm])


@checked
class Mannequin(_Target):
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

    @property
    def shoulder_height(self) -> float:
        """Return the height of the shoulders beside the neck over the foot, metres."""
        return self.height - self.head_height - self.neck_length

    @property
    def head_centre(self) -> Array:
        """Return the middle (3,) of the head."""
        return self.placed([0, self.distance, self.height - self.head_height / 2])

    @property
    def shoulders(self) -> Array:
        """Return the middles (2, 3) of the ends of the shoulders, the right one (x > 0) first."""
        return self.placed(self._shoulder * [[1, 1, 1], [-1, 1, 1]])

    @property
    def _shoulder(self) -> Array:
        """Return the middle (3,) of the right shoulder's end before the target is placed."""
        radius = 0.3 * self.depth
        return np.array([self.shoulder_width / 2 - radius, self.distance, self.shoulder_height - radius - 0.035])

    @property
    def lowest(self) -> float:
        """Return the height of the hips."""
        return self.shoulder_height - self.torso_length + self.place[2]

    def _shape(self) -> tuple[Array, Array, list[Rod]]:
        hips_height = self.shoulder_height - self.torso_length
        line = _upright(*((self.distance, z) for z in (0, hips_height, self.shoulder_height, self.height)))
        foot, hips, neck, top = line  # a neck strap lies on the axis at the top of the shoulders, which is the seat
        # Head, neck, stand and the middle of the torso lie on the axis.
        shoulder_radius = 0.3 * self.depth
        ball = np.array([0, 0, self.head_radius])
        low = neck - [0, 0, shoulder_radius]
        radius = self.depth / 2
        chest = neck - [0, 0, 1.4 * radius]
        hip = hips + [0, 0, radius]
        aside = np.array([self.shoulder_width / 2 - radius - 0.02, 0, 0])
        head = (top - [0, 0, self.head_height] + ball, top - ball, self.head_radius)
        rods = [head, (low, top - ball, self.neck_radius), (foot, hips, 0.02), (chest, hip, radius)]
        # A shoulder and a side of the torso on the right and on the left.
        for side in (1, -1):
            rods.append((low, self._shoulder * [side, 1, 1], shoulder_radius))
            rods.append((chest + side * aside, hip + 0.75 * side * aside, radius))
        return line, neck, rods

    def holds(self, loop: ArrayLike) -> bool:
        """Return whether a closed curve (L, 3) is around the axis and below the middle of the head, or around a shoulder."""
        curve = np.asarray(loop, dtype=np.float64)
        if curve[:, 2].mean() < self.head_centre[2] and super().holds(curve):
            return True
        # Two more lines go up the axis and out through a shoulder.
        foot = self.centre_line[0]
        axis = self.placed(self._shoulder * [0, 1, 1])
        lines = [close_far([foot, axis, end], end=end - axis) for end in self.shoulders]
        return any(linking_number(curve, line) != 0 for line in lines)


Target = Hook | Hanger | Mannequin


def gap(points: Array, target: Target) -> float:
    """Return the least distance of points (N, 3) from the surface of the target."""
    return min(float(to_segment(points, start, end).min()) - radius for start, end, radius in target.rods)


def _upright(*places: tuple[float, float]) -> Array:
    """Return points (y, z) of the plane x = 0."""
    return np.array([[0.0, y, z] for y, z in places])


def _tube(line: Array, radius: float) -> list[Rod]:
    """Return a rod along each segment of a line."""
    return [(start, end, radius) for start, end in itertools.pairwise(line)]
