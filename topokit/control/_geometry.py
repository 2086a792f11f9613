"""What the servo measures: the frame of the grippers, the arm of a target, the opening of a loop.

Idea: a loop is hung by passing its *rim*, the place that will lie on the arm, over the tip. All that this takes of a loop is
where its rim is, which way its opening looks, and how large it is; of a target, the last part that runs sideways.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.spatial import cKDTree

from topokit.linking import close_far, curve_centroid, linking_number, side_lengths

Array = NDArray[np.float64]
_NEAR = 0.06  # metres at which cloth can still be that of a curve
_BLEND = ("rim", "normal", "height", "width", "length")


def turned(points: Array, angle: float) -> Array:
    """Points or directions (..., 3) turned about the z axis, from x towards y, by radians."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.asarray(points @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]))


def heading(direction: Array) -> float:
    """The angle of a direction from x towards y, radians."""
    return float(np.arctan2(direction[1], direction[0]))


def wrapped(angle: float) -> float:
    """The same angle between -pi and pi."""
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


def drawn(cycle: Array, last: Array, cloth: cKDTree) -> Array:
    """A closed curve that is not seen, drawn to the cloth nearest to it, evenly, and a little to where it was seen last."""
    distance, nearest = cloth.query(cycle)
    pull = np.where((distance < _NEAR)[:, None], cloth.data[nearest] - cycle, 0)
    pull = uniform_filter1d(pull, max(3, len(cycle) // 3), axis=0, mode="wrap")
    return np.asarray(0.9 * (cycle + pull / 2) + 0.1 * last)


@dataclass(frozen=True)
class Hands:
    """The frame of two grippers: its origin is midway between them, its x axis runs from the first to the second, level."""

    middle: Array  # (3,)
    yaw: float

    @classmethod
    def of(cls, grippers: Array) -> Hands:
        return cls(grippers.mean(axis=0), heading(grippers[1] - grippers[0]))

    def inside(self, points: Array) -> Array:
        """Places of the world in this frame."""
        return turned(points - self.middle, -self.yaw)

    def outside(self, points: Array) -> Array:
        """Places of this frame in the world."""
        return turned(points, self.yaw) + self.middle


@dataclass(frozen=True)
class Arm:
    """The last part of a centre line that runs sideways, and the tip that rises from its end."""

    out: Array  # (3,) unit, level: where it points
    start: Array  # (3,)
    end: Array  # (3,) where the tip begins
    tip: Array  # (3,)
    closed: Array  # the whole centre line, closed far away

    @classmethod
    def of(cls, line: Array) -> Arm | None:
        """Of a centre line (K, 3) from the floor to the tip; None when no part of it runs sideways."""
        level = np.linalg.norm(np.diff(line[:, :2], axis=0), axis=1)
        sideways = np.flatnonzero(level > np.abs(np.diff(line[:, 2])))
        if not len(sideways):
            return None
        start, end = line[sideways[-1] : sideways[-1] + 2]
        return cls((end - start) * [1, 1, 0] / level[sideways[-1]], start, end, line[-1], close_far(line))

    @property
    def reach(self) -> float:
        """Metres, level."""
        return float((self.end - self.start) @ self.out)

    @property
    def rise(self) -> float:
        """Metres from the arm's end up to the tip."""
        return float(self.tip[2] - self.end[2])

    def holds(self, cycle: Array) -> bool:
        """Whether a closed curve winds around the target; one that touches its centre line does not, yet."""
        try:
            return linking_number(cycle, self.closed) != 0
        except ValueError:
            return False

    def around(self, place: Array, far: float) -> Array:
        """Where to go next, level, from a place beside or behind the target so as to come before it."""
        here = (place - self.start) * [1, 1, 0]
        angle = wrapped(heading(here) - heading(self.out))
        if abs(angle) < np.pi / 3:
            return self.tip + far * self.out
        return self.start + (self.reach + far) * turned(self.out, angle - 0.5 * np.sign(angle))


@dataclass(frozen=True)
class Opening:
    """What is to be known of a loop in order to hang it."""

    rim: Array  # (3,) the highest place of the curve above its centroid
    normal: Array  # (3,) unit, level: the direction that the arm shall have, from its pole to its tip
    height: float  # metres from the rim down to the curve
    width: float  # metres, level, across
    length: float  # metres along the curve

    @classmethod
    def of(cls, cycle: Array) -> Opening | None:
        """Of a closed curve (L, 3), its normal either of two; None when it lies flat, or in one line."""
        after = np.roll(cycle, -1, axis=0)
        area = np.cross(cycle - cycle[0], after - cycle[0]).sum(axis=0) * [1, 1, 0]
        size = float(np.linalg.norm(area))
        if size < 1e-6:
            return None
        across = (cycle - curve_centroid(cycle)) @ np.cross([0, 0, 1], area / size)
        step = np.roll(across, -1) - across
        crossed = np.flatnonzero((across < 0) != (across + step < 0))
        share = -(across[crossed] / step[crossed])[:, None]
        places = (1 - share) * cycle[crossed] + share * after[crossed]
        height, length = np.ptp(places[:, 2]), side_lengths(cycle).sum()
        return cls(places[places[:, 2].argmax()], area / size, float(height), float(np.ptp(across)), float(length))

    @property
    def flipped(self) -> Opening:
        """The same, to be hung with the other side ahead."""
        return replace(self, normal=-self.normal)

    @property
    def mirrored(self) -> Opening:
        """Its mirror image, left and right exchanged."""
        return replace(self, rim=self.rim * [-1, 1, 1], normal=self.normal * [-1, 1, 1])

    def gap(self, other: Opening) -> float:
        """How far two openings are from being one, metres."""
        return float(np.linalg.norm(self.rim - other.rim)) + abs(self.height - other.height) / 2

    def outside(self, hands: Hands) -> Opening:
        """The same in the world."""
        return replace(self, rim=hands.outside(self.rim), normal=turned(self.normal, hands.yaw))

    def blended(self, new: Opening, weight: float) -> Opening:
        """The mean of this and of a later look, which counts by its weight; the normal keeps its side."""
        new = new if new.normal @ self.normal > 0 else new.flipped
        mixed = {name: (1 - weight) * getattr(self, name) + weight * getattr(new, name) for name in _BLEND}
        return Opening(**{**mixed, "normal": mixed["normal"] / np.linalg.norm(mixed["normal"])})

    def blocked(self, cloud: Array, depth: float) -> int:
        """How many points (n, 3) lie ahead of the opening, or within that depth behind it."""
        there = cloud - self.rim
        across, behind = there @ np.cross([0, 0, 1], self.normal), there @ self.normal
        framed = (np.abs(across) < 0.3 * self.width) & (np.abs(there[:, 2] / self.height + 0.5) < 0.3)
        return int((framed & (np.abs(behind) > 0.03) & (behind < depth)).sum())
