"""The frame of a tracker: a cloud with its measures; and the checks that one frame can follow another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from topokit._validate import Array, Ids
from topokit.rips import Diagram
from topokit.sampling import inliers_and_tree, spacing

from ._evidence import Gaps, evidence, needed, significance

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_SHARE_WITHIN_ALPHA = 0.95  # share of the points that have a neighbour within 2 alpha, when alpha is estimated
_SHARE_WITHIN_EPSILON = 0.9  # share of the points that move no farther than epsilon, when epsilon is estimated
_SHARE_THAT_FITS = 0.25  # share of the points that decide whether the scene has moved; the others may be new in view
_NO_GAPS = Gaps(0.0, 1.0)  # for a cloud of one place, and where alpha decides which bars are loops
_OTHER_UNITS = 20.0  # factor of size between two frames above which their units differ: cloth does not grow so


@dataclass(frozen=True, eq=False)
class Frame:
    """The points of a cloud that are used, and how far apart they are."""

    tree: cKDTree  #: search tree of the points that are used
    ids: Ids  #: (n,) ids of these points in the cloud
    alpha: float  #: how far a place of the scene may be from the nearest of these points
    gaps: Gaps = _NO_GAPS  #: how wide the gaps between these points are

    @classmethod
    def of_all_points(cls, tree: cKDTree, alpha: float | None = None) -> Frame:
        """Return the frame that uses all points, as in the paper.

        Parameters
        ----------
        tree : cKDTree
            Search tree of the points.
        alpha : float, optional
            When not given, half the largest distance from a point to its nearest neighbour.
        """
        if alpha is None:
            alpha = spacing(tree)
        return cls(tree, np.arange(tree.n), alpha)

    @classmethod
    def without_outliers(cls, tree: cKDTree) -> Frame:
        """Return the frame that leaves out points far from all others.

        Parameters
        ----------
        tree : cKDTree
            Search tree of all points.
        """
        if tree.n == 0:
            return cls(tree, np.arange(0), 0.0)
        ids, places, nearest = inliers_and_tree(tree)
        if places.n == 1:
            return cls(places, ids, 0.0)
        alpha = float(np.quantile(nearest[:, 0], _SHARE_WITHIN_ALPHA)) / 2
        return cls(places, ids, alpha, Gaps.of(nearest))

    def significance(self, birth: Array, death: Array) -> Array:
        """Return how much bars stand out from the sampling of this frame: a loop has more than 1.

        Parameters
        ----------
        birth, death : (m,) float64
            Of bars of these points.
        """
        return significance(birth, death, self.gaps, self.tree.n)

    def loop_evidence(self, birth: Array, death: Array) -> Array:
        """Return the log-odds that each bar is a loop, by this frame alone, whatever its other bars.

        Parameters
        ----------
        birth, death : (m,) float64
            Of bars of these points.
        """
        return evidence(self.significance(birth, death))

    def diagram_evidence(self, diagram: Diagram) -> Array:
        """Return the log-odds that each bar of a diagram is a loop, by this frame alone; each is judged beside the others.

        Parameters
        ----------
        diagram : Diagram
            Of these points.
        """
        strength = self.significance(diagram.birth, diagram.death)
        return evidence(strength, needed(strength, diagram.birth, self.gaps))

    def check_follows(self, before: Frame, number: int) -> None:
        """Check that this frame has the dimension of the frame before, and seems to be in its unit.

        Parameters
        ----------
        before : Frame
        number : int
            Of this frame, for the message.

        Raises
        ------
        ValueError
            When they differ; the message names both sizes.
        """
        if self.tree.m != before.tree.m:
            raise ValueError(f"frame {number} has {self.tree.m} dimensions, the frames before it have {before.tree.m}")

        # A scene may grow, and a cloud may become coarser. Both at once by the same large factor is a change of units.
        size = _extent(self.tree)
        size_before = _extent(before.tree)
        if _differ_in_units(size, size_before) and _differ_in_units(spacing(self.tree), spacing(before.tree)):
            sizes = f"frame {number} is {size:.4g} across, and the frame before it {size_before:.4g}"
            reason = "the gaps between points changed as much, so the frames seem to be in different units"
            raise ValueError(f"{sizes}; {reason}: convert one of them, or start a new tracker")

    def motion_since(self, before: Frame) -> tuple[Array, float]:
        """Return the shift (d,) of the scene since an earlier frame, and how far its points have moved in addition.

        The second number is a partial Hausdorff distance, from the points of this frame to those of the earlier one only: a
        point that is hidden now has not moved.

        Parameters
        ----------
        before : Frame
        """
        # The centroid of a still scene moves when a part of the scene is hidden or comes into view. So the shift of the centroid
        # is used only when the nearest quarter of the points fits the earlier scene better with the shift than without it.
        shift = self.tree.data.mean(axis=0) - before.tree.data.mean(axis=0)
        distance = before.tree.query(self.tree.data)[0]
        shifted_distance = before.tree.query(self.tree.data - shift)[0]
        if np.quantile(distance, _SHARE_THAT_FITS) <= np.quantile(shifted_distance, _SHARE_THAT_FITS):
            return np.zeros_like(shift), float(np.quantile(distance, _SHARE_WITHIN_EPSILON))
        return shift, float(np.quantile(shifted_distance, _SHARE_WITHIN_EPSILON))


def check_follows(
    number: int, frame: Frame, time: float | None, before: Frame | None, time_before: float | None
) -> None:
    """Raise ValueError unless a frame and its time can follow the frame before and its time."""
    if frame.tree.n == 0:
        raise ValueError(f"frame {number} has no points, so that its loops are not known: call skip() for it")
    check_time(number, time, time_before)
    if before is not None:
        frame.check_follows(before, number)


def check_time(number: int, time: float | None, before: float | None) -> None:
    """Raise ValueError unless all frames have a time or none has, and times increase."""
    seconds = time.item() if isinstance(time, np.generic) else time
    if time is not None and not (isinstance(seconds, (int, float)) and abs(seconds) < 1e300):
        raise ValueError(f"frame {number} has time {time}; a time must be a finite number of seconds")
    if number == 0 or (before is None and time is None):
        return
    advice = "give all frames a time, or none"
    if time is None:
        raise ValueError(f"frame {number} has no time, but the frame before it has one: {advice}")
    if before is None:
        raise ValueError(f"frame {number} has time {time} s, but the frame before it has none: {advice}")
    if time <= before:
        problem = "is repeated" if time == before else "is out of order"
        reason = f"its time {time} s is not later than the time {before} s of the frame before"
        raise ValueError(f"frame {number} {problem}: {reason}; sort the frames by time and drop repeated ones")


def check_diagram(number: int, diagram: Diagram, n_points: int) -> None:
    """Raise ValueError unless a diagram is that of a cloud of so many points, and all its loops die."""
    if diagram.n_points != n_points:
        raise ValueError(f"frame {number} has {n_points} points, but its diagram was computed from {diagram.n_points}")
    still_open = int(np.isinf(diagram.death).sum())
    if still_open:
        problem = f"{still_open} loops of the diagram do not die below max_radius = {diagram.max_radius:g}"
        reason = "a loop without a killer cannot be tracked; compute the diagram without max_radius"
        raise ValueError(f"frame {number}: {problem}: {reason}")


def _extent(tree: cKDTree) -> float:
    """Return the longest extent of a cloud along an axis."""
    return float((tree.maxes - tree.mins).max())


def _differ_in_units(size: float, before: float) -> bool:
    """Return whether two lengths differ by a factor as between metres and inches (39), centimetres or millimetres."""
    smaller = min(size, before)
    larger = max(size, before)
    return smaller > 0 and larger > _OTHER_UNITS * smaller
