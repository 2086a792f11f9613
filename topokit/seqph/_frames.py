"""What a tracker takes from a cloud, and what may follow what in a sequence of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from topokit.rips import Diagram
from topokit.sampling import inliers_and_tree, spacing

from ._evidence import Gaps, evidence, significance

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

Array = NDArray[np.float64]
_SCENE = 0.95  # share of the points that have a neighbour within 2 alpha, estimated from what is not alone
_MOVED = 0.9  # share of the points that move no farther than epsilon, estimated likewise
_FITS = 0.25  # share of the points that tell whether the scene has moved; the others may have come in
_NO_GAPS = Gaps(0.0, 1.0)  # of a single place, and where alpha decides which bars are loops
_OTHER_UNITS = 20.0  # times as large: cloth does not grow so between two frames


@dataclass(frozen=True, eq=False)
class Frame:
    """A cloud, the points of it that count, and how far apart they are."""

    tree: cKDTree  #: of the points that count
    ids: NDArray[np.int64]  #: (n,) their numbers in the cloud
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
        return cls(tree, np.arange(tree.n), spacing(tree) if alpha is None else alpha)

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
        return cls(places, ids, float(np.quantile(nearest[:, 0], _SCENE)) / 2, Gaps.of(nearest))

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
        return evidence(birth, death, self.gaps, self.tree.n)

    def motion_since(self, before: Frame) -> tuple[Array, float]:
        """(d,) how far the scene has moved as a whole since, and how far its points beside that: a partial Hausdorff distance.

        The middle of a still scene moves when a part of it is hidden or another comes in. So its motion counts when the nearest
        quarter of the points fits better to where the scene was with it than without. One way only, since what is hidden now
        has not moved.
        """
        shift = self.tree.data.mean(axis=0) - before.tree.data.mean(axis=0)
        still, moved = (before.tree.query(self.tree.data - by)[0] for by in (0.0, shift))
        if np.quantile(still, _FITS) <= np.quantile(moved, _FITS):
            shift, moved = np.zeros_like(shift), still
        return shift, float(np.quantile(moved, _MOVED))


def check_follows(frame: int, before: tuple[Frame | None, float | None], after: tuple[Frame, float | None]) -> None:
    """Raise ValueError unless a frame and its time can follow those before."""
    (frame_before, time_before), (tree, time) = before, (after[0].tree, after[1])
    if tree.n == 0:
        raise ValueError(f"frame {frame} has no points: nothing seen is not the same as no loops; skip the frame")
    seconds = time.item() if isinstance(time, np.generic) else time
    if time is not None and not (isinstance(seconds, (int, float)) and abs(seconds) < 1e300):
        raise ValueError(f"frame {frame} has time {time}; it must be a finite number of seconds")
    if frame_before is None:
        return
    tree_before = frame_before.tree
    _check_time(frame, time_before, time)
    if tree.m != tree_before.m:
        raise ValueError(f"frame {frame} has {tree.m} dimensions, the frames before it {tree_before.m}")
    size, size_before = (float((one.maxes - one.mins).max()) for one in (tree, tree_before))
    if _differ_in_units(size, size_before) and _differ_in_units(spacing(tree), spacing(tree_before)):
        what = f"frame {frame} is {size:.4g} across, the frame before it {size_before:.4g}"
        why = "its points are as much farther apart or nearer: is it in other units?"
        raise ValueError(f"{what}, and {why} Convert it, or start a new tracker")


def _check_time(frame: int, before: float | None, time: float | None) -> None:
    if (before is None) != (time is None):
        has = ("no time", "one") if time is None else (f"time {time} s", "none")
        raise ValueError(f"frame {frame} has {has[0]}, the frame before it {has[1]}: give all frames a time, or none")
    if before is not None and time is not None and time <= before:
        what = "is repeated" if time == before else "is out of order"
        why = f"its time {time} s is not later than {before} s, that of the frame before"
        raise ValueError(f"frame {frame} {what}: {why}; sort the frames by time and drop repeated ones")


def check_diagram(frame: int, diagram: Diagram, n_points: int) -> None:
    if diagram.n_points != n_points:
        raise ValueError(f"frame {frame} has {n_points} points, its diagram is of {diagram.n_points}")
    still_open = int(np.isinf(diagram.death).sum())
    if still_open:
        what = f"{still_open} loops of its diagram do not die below max_radius = {diagram.max_radius:g}"
        why = "a tracked loop needs its killer: compute the diagram without max_radius"
        raise ValueError(f"frame {frame}: {what}, and {why}")


def _differ_in_units(size: float, before: float) -> bool:
    """Whether a length and the same one before differ as metres and inches do (39), or centimetres, or millimetres."""
    return min(size, before) > 0 and max(size, before) > _OTHER_UNITS * min(size, before)
