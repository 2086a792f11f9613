"""The opening of a loop, as an arm that is to go through it needs it.

Idea: a loop is hung by passing its *rim*, the place that will lie on the arm, over the tip. Three measures of a loop suffice:
where its rim is, which direction its opening faces, and how large it is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from topokit._validate import Array
from topokit.linking import curve_centroid


def lies_flat(curve: Array) -> bool:
    """Return whether 70 % of a closed curve's area faces up or down, as the tube of a shirt does; no arm goes through it."""
    area = _area(curve)
    return bool(abs(area[2]) > 0.7 * np.linalg.norm(area))


def _area(curve: Array) -> Array:
    """Return twice the vector area (3,) of a closed curve."""
    corners = curve - curve[0]
    return np.asarray(np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0))


class Opening(NamedTuple):
    """The measures of a loop that is to hang."""

    rim: Array  # (3,) the highest place of the curve above its centroid
    normal: Array  # (3,) unit, level: the direction for the arm, from its pole to its tip
    size: Array  # (2,) metres: from the rim down to the curve, and level from side to side

    @classmethod
    def of(cls, cycle: Array) -> Opening | None:
        """Return the opening of a closed curve (L, 3), with either of its normals; None when it lies flat or in one line."""
        after = np.roll(cycle, -1, axis=0)
        area = _area(cycle) * [1, 1, 0]
        if len(cycle) < 3 or np.linalg.norm(area) < 1e-6:
            return None
        normal = area / np.linalg.norm(area)
        # Find the places where the curve crosses the upright line through its centroid. The rim is the highest of them.
        across = (cycle - curve_centroid(cycle)) @ np.cross([0, 0, 1], normal)
        step = np.roll(across, -1) - across
        crossed = np.flatnonzero((across < 0) != (across + step < 0))
        share = -(across[crossed] / step[crossed])[:, None]
        places = (1 - share) * cycle[crossed] + share * after[crossed]
        return cls(places[places[:, 2].argmax()], normal, np.array([np.ptp(places[:, 2]), np.ptp(across)]))

    def along(self, direction: Array) -> Opening:
        """Return the opening with that of its two normals that is nearer to a direction."""
        return self if self.normal @ direction > 0 else self._replace(normal=-self.normal)

    def blended(self, new: Opening, weight: float) -> Opening:
        """Return the weighted mean of this and a later opening; the normal keeps its side."""
        mixed = Opening(*((1 - weight) * a + weight * b for a, b in zip(self, new.along(self.normal), strict=True)))
        return mixed._replace(normal=mixed.normal / np.linalg.norm(mixed.normal))

    def gap(self, other: Opening) -> float:
        """Return the difference of two openings, metres."""
        return float(np.linalg.norm(self.rim - other.rim) + abs(self.size[0] - other.size[0]) / 2)

    def blocked(self, cloud: Array, depth: float) -> int:
        """Return the number of points (n, 3) before the opening, or within a depth behind it."""
        from_rim = cloud - self.rim
        across = from_rim @ np.cross([0, 0, 1], self.normal)
        behind = from_rim @ self.normal
        # A point is framed when it is within the middle of the opening, as seen along the normal.
        framed = (np.abs(across) < 0.3 * self.size[1]) & (np.abs(from_rim[:, 2] / self.size[0] + 0.5) < 0.3)
        return int((framed & (np.abs(behind) > 0.03) & (behind < depth)).sum())
