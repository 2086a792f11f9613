"""The arm of a target, as a servo needs it: the last part of the centre line that runs sideways."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.spatial import cKDTree

from topokit._geometry import angle, turned
from topokit.linking import close_far, linking_number

Array = NDArray[np.float64]
_BEHIND = 0.05  # metres behind a head, and above its shoulders, where a neck strap is let go
_RETREATS = 0.003  # metres in a frame by which an arm retreats, at least
_NEAR = 0.06  # metres from a curve within which cloth can belong to it


def drawn(cycle: Array, last: Array, cloth: cKDTree) -> Array:
    """Return a curve that is not seen, moved evenly to the nearest cloth, and a little to its place when last seen."""
    distance, nearest = cloth.query(cycle)
    pull = np.where((distance < _NEAR)[:, None], cloth.data[nearest] - cycle, 0)
    pull = uniform_filter1d(pull, max(3, len(cycle) // 3), axis=0, mode="wrap")
    return np.asarray(0.9 * (cycle + pull / 2) + 0.1 * last)


class Arm(NamedTuple):
    """The part of a target that a loop is put over: it runs sideways, and a tip rises from its end.

    A head is an arm, too: it rises from the neck, and a loop that is drawn over it from the front lies behind it in the end.
    """

    start: Array  # (3,) the place where it begins
    end: Array  # (3,) the place where it ends
    tip: Array  # (3,) the end of the tip
    out: Array  # (3,) unit, level: the direction in which it points
    reach: float  # metres along `out`
    closed: Array  # the whole centre line, closed far away
    depth: float = 0.5  # share of the reach at which the rim goes down
    under: float = np.inf  # metres, the height below which the middle of a loop that hangs lies
    wide: float = 0.0  # metres between the grippers that a loop needs to go over it

    @classmethod
    def of(cls, line: Array) -> Arm | None:
        """Return the arm of a centre line (K, 3) from the floor to the tip; None when no part of it runs sideways."""
        steps = np.diff(line, axis=0)
        level = np.linalg.norm(steps[:, :2], axis=1)
        sideways = np.flatnonzero(level > np.abs(steps[:, 2]))
        if not len(sideways):
            return None
        k = sideways[-1]
        return cls(line[k], line[k + 1], line[-1], steps[k] * [1, 1, 0] / level[k], float(level[k]), close_far(line))

    @classmethod
    def of_head(cls, line: Array, rods: Array, place: Array) -> Arm | None:
        """Return the head of a mannequin's line and rods (R, 7), approached from a place; None when it has no shoulders."""
        # The head is the highest rod, a shoulder the one that reaches farthest sideways.
        head = rods[rods[:, 5].argmax()]
        radius = float(head[6])
        across = rods[:, 3:5] - rods[:, :2]
        shoulder = across[np.linalg.norm(across, axis=1).argmax()]
        width = float(np.linalg.norm(shoulder))
        if width < radius / 2:
            return None
        # It points level, across the shoulders, towards that place.
        out = np.array([-shoulder[1], shoulder[0], 0]) / width
        if out @ (place - line[-1]) <= 0:
            out = -out
        # A strap goes over the front of the head, and lies at the nape in the end.
        front = line[-1] + radius * out
        nape = line[-2] - (radius + _BEHIND) * out + [0, 0, _BEHIND - radius]
        end = np.array([*front[:2], nape[2]])
        middle = float(head[[2, 5]].mean())
        reach = 2 * radius + _BEHIND
        return cls(nape, end, front, out, reach, close_far(line), 1.0, middle, 2 * radius + 0.06)

    def drawn_back(self, drift: Array) -> Arm:
        """Return the arm for a target that moves by `drift` in a frame.

        Cloth lags behind an arm that retreats and slips over its tip, so its rim goes down near the post.
        """
        if drift @ self.out < -_RETREATS:
            return self._replace(depth=max(self.depth, 0.85))
        return self

    @property
    def seat(self) -> Array:
        """Return the place (3,) where the rim goes down: on the centre line, or behind the neck."""
        return np.asarray(self.end + self.depth * (self.start - self.end))

    def holds(self, cycle: Array) -> bool:
        """Return whether a closed curve winds around the target; a curve that touches the centre line does not."""
        try:
            return linking_number(cycle, self.closed) != 0 and cycle[:, 2].mean() < self.under
        except ValueError:
            return False

    def before(self, place: Array, far: float) -> Array:
        """Return a place `far` metres before the tip; for a place beside or behind the target, a stop on the way around it."""
        aside = angle(self.out, place - self.start)
        if abs(aside) < 60:
            return np.asarray(self.tip + far * self.out)
        return np.asarray(self.start + (self.reach + far) * turned(self.out, aside - 30 * np.sign(aside)))
