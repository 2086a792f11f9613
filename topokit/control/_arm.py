"""The arm of a target, as a servo needs it: the last part of the centre line that runs sideways."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from topokit._geometry import angle, turned
from topokit._validate import Array
from topokit.linking import close_far, linking_number


class Arm(NamedTuple):
    """The part of a target that a loop is put over: it runs sideways, and a tip rises from its end."""

    start: Array  # (3,)
    end: Array  # (3,)
    tip: Array  # (3,) the end of the tip
    out: Array  # (3,) unit, level: the direction in which it points
    reach: float  # metres along `out`
    closed: Array  # the whole centre line, closed far away

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

    @property
    def seat(self) -> Array:
        """Return the place (3,) where the rim of a loop goes down: the middle of the arm."""
        return np.asarray(self.end + 0.5 * (self.start - self.end))

    def holds(self, cycle: Array) -> bool:
        """Return whether a closed curve winds around the target; a curve that touches the centre line does not."""
        try:
            return linking_number(cycle, self.closed) != 0
        except ValueError:
            return False

    def before(self, place: Array, far: float) -> Array:
        """Return a place `far` metres before the tip; for a place beside or behind the target, a stop on the way around it."""
        aside = angle(self.out, place - self.start)
        if abs(aside) < 60:
            return np.asarray(self.tip + far * self.out)
        return np.asarray(self.start + (self.reach + far) * turned(self.out, aside - 30 * np.sign(aside)))
