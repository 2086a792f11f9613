"""What a tracker takes from a cloud, and which frames may follow each other in a sequence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from topokit._validate import Array, Ids
from topokit.rips import Diagram
from topokit.sampling import inliers_and_tree, spacing

from ._evidence import Gaps, evidence, significance

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_SCENE = 0.95  # share of the points that have a neighbour within 2 alpha, for an estimate of alpha
_MOVED = 0.9  # share of the points that move no farther than epsilon, for an estimate of epsilon
_FITS = 0.25  # share of the points that decide whether the scene has moved; the others may have come in
_NO_GAPS = Gaps(0.0, 1.0)  # of a single place, and where alpha decides which bars are loops
_OTHER_UNITS = 20.0  # times as large: cloth does not grow so between two frames


@dataclass(frozen=True, eq=False)
class Frame:
    """A cloud, the points of it that count, and how far apart they are."""

    tree: cKDTree  #: of the points that count
    ids: Ids  #: (n,) their numbers in the cloud
    alpha: float  #: how far the scene may be from the nearest of them
    gaps: Gaps = _NO_GAPS  #: how wide the gaps between them are

    @classmethod
    def of_all_points(cls, tree: cKDTree, alpha: float | None = None) -> Frame:
        """Return the frame in which all points count, as in the paper.

        Parameters
        ----------
        tree : cKDTree
            Of the points.
        alpha : float, optional
            Half the largest distance of a point from its nearest other one, when not given.
        """
        if alpha is None:
            alpha = spacing(tree)
        return cls(tree, np.arange(tree.n), alpha)

    @classmethod
    def without_outliers(cls, tree: cKDTree) -> Frame:
        """Return the frame in which points that are alone do not count.

        Parameters
        ----------
        tree : cKDTree
            Of the points.
        """
        if tree.n == 0:
            return cls(tree, np.arange(0), 0.0)
        ids, places, nearest = inliers_and_tree(tree)
        if places.n == 1:
            return cls(places, ids, 0.0)
        alpha = float(np.quantile(nearest[:, 0], _SCENE)) / 2
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
        """Return the log-odds that each bar is a loop, by this frame alone.

        Parameters
        ----------
        birth, death : (m,) float64
            Of bars of these points.
        """
        return evidence(self.significance(birth, death))

    def motion_since(self, before: Frame) -> tuple[Array, float]:
        """Return how far the scene has moved since another frame, and how far its points have moved beside that.

        The first is a vector (d,); the second is a partial Hausdorff distance. It is measured one way only, since a point that
        is hidden now has not moved.

        Parameters
        ----------
        before : Frame
        """
        # The middle of a still scene moves when a part of it is hidden or another comes in. So the motion of the middle
        # counts only when the nearest quarter of the points fits the scene before better with it than without.
        shift = self.tree.data.mean(axis=0) - before.tree.data.mean(axis=0)
        distance = before.tree.query(self.tree.data)[0]
        shifted_distance = before.tree.query(self.tree.data - shift)[0]
        if np.quantile(distance, _FITS) <= np.quantile(shifted_distance, _FITS):
            return np.zeros_like(shift), float(np.quantile(distance, _MOVED))
        return shift, float(np.quantile(shifted_distance, _MOVED))


def check_follows(
    number: int, frame: Frame, time: float | None, before: Frame | None, time_before: float | None
) -> None:
    """Raise ValueError unless a frame and its time can follow those before."""
    if frame.tree.n == 0:
        raise ValueError(f"frame {number} has no points: nothing seen is not the same as no loops; skip the frame")
    seconds = time.item() if isinstance(time, np.generic) else time
    if time is not None and not (isinstance(seconds, (int, float)) and abs(seconds) < 1e300):
        raise ValueError(f"frame {number} has time {time}; it must be a finite number of seconds")
    if before is None:
        return

    _check_time(number, time_before, time)
    if frame.tree.m != before.tree.m:
        raise ValueError(f"frame {number} has {frame.tree.m} dimensions, the frames before it {before.tree.m}")

    # A scene may grow, and a cloud may become coarser. Both at once by the same large factor is a change of units.
    size = _extent(frame.tree)
    size_before = _extent(before.tree)
    if _differ_in_units(size, size_before) and _differ_in_units(spacing(frame.tree), spacing(before.tree)):
        sizes = f"frame {number} is {size:.4g} across, the frame before it {size_before:.4g}"
        reason = "its points are as much farther apart or nearer: is it in other units?"
        raise ValueError(f"{sizes}, and {reason} Convert it, or start a new tracker")


def _check_time(number: int, before: float | None, time: float | None) -> None:
    """Raise ValueError unless all frames have a time or none has, and times increase."""
    if before is None and time is None:
        return
    advice = "give all frames a time, or none"
    if time is None:
        raise ValueError(f"frame {number} has no time, the frame before it one: {advice}")
    if before is None:
        raise ValueError(f"frame {number} has time {time} s, the frame before it none: {advice}")
    if time <= before:
        problem = "is repeated" if time == before else "is out of order"
        reason = f"its time {time} s is not later than {before} s, that of the frame before"
        raise ValueError(f"frame {number} {problem}: {reason}; sort the frames by time and drop repeated ones")


def check_diagram(number: int, diagram: Diagram, n_points: int) -> None:
    """Raise ValueError unless a diagram is of so many points and all its loops die."""
    if diagram.n_points != n_points:
        raise ValueError(f"frame {number} has {n_points} points, its diagram is of {diagram.n_points}")
    still_open = int(np.isinf(diagram.death).sum())
    if still_open:
        problem = f"{still_open} loops of its diagram do not die below max_radius = {diagram.max_radius:g}"
        reason = "a tracked loop needs its killer: compute the diagram without max_radius"
        raise ValueError(f"frame {number}: {problem}, and {reason}")


def _extent(tree: cKDTree) -> float:
    """Return the longest extent of a cloud along an axis."""
    return float((tree.maxes - tree.mins).max())


def _differ_in_units(size: float, before: float) -> bool:
    """Return whether two lengths differ as much as metres and inches (39), centimetres or millimetres."""
    smaller = min(size, before)
    larger = max(size, before)
    return smaller > 0 and larger > _OTHER_UNITS * smaller
