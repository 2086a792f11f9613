"""The frame of a tracker: the points of a cloud that count, how far apart they are, and how they have moved."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from topokit._validate import Array, Ids
from topokit.sampling import inliers_and_tree, spacing

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


@dataclass(frozen=True, eq=False)
class Frame:
    """The points of a cloud that are used, and how far apart they are."""

    tree: cKDTree  #: search tree of the points that are used
    ids: Ids  #: (n,) ids of these points in the cloud
    alpha: float  #: how far a place of the scene may be from the nearest of these points
    #: median distance of a point from its fifth nearest neighbour; 0 where alpha decides which bars are loops
    spacing: float = 0.0
    unevenness: float = 1.0  #: 1.4 for a grid, 2.6 for points strewn at random on a surface

    @classmethod
    def of_all_points(cls, tree: cKDTree, alpha: float | None = None) -> Frame:
        """Return the frame that uses all points; alpha is by default half the largest distance to a nearest neighbour."""
        if alpha is None:
            alpha = spacing(tree)
        return cls(tree, np.arange(tree.n), alpha)

    @classmethod
    def without_outliers(cls, tree: cKDTree, alpha: float | None = None) -> Frame:
        """Return the frame without points far from all others; by default 95 % of its points have a neighbour within 2 alpha."""
        ids, places, nearest = inliers_and_tree(tree)
        if places.n == 1:
            return cls(places, ids, alpha or 0.0)
        if alpha is None:
            alpha = float(np.quantile(nearest[:, 0], 0.95)) / 2

        # Points strewn at random have far fifth neighbours, and some far nearest ones. On a curve only the fifth are far,
        # where a mesh is irregular only the nearest. So the smaller of the two measures counts.
        first, fifth = np.median(nearest[:, [0, -1]], axis=0).tolist()
        by_fifth = fifth / first
        by_nearest = 1.4 * float(np.quantile(nearest[:, 0], 0.9)) / first
        return cls(places, ids, alpha, fifth, min(by_fifth, by_nearest))

    def motion_since(self, before: Frame) -> tuple[Array, float]:
        """Return the shift (d,) since an earlier frame, and the partial Hausdorff distance beyond it, of 90 % of these points."""
        # The centroid of a still scene moves when a part of the scene is hidden or comes into view. So the shift of the centroid
        # is used only when the nearest quarter of the points fits the earlier scene better with the shift than without it.
        shift = self.tree.data.mean(axis=0) - before.tree.data.mean(axis=0)
        distance = before.tree.query(self.tree.data)[0]
        shifted_distance = before.tree.query(self.tree.data - shift)[0]
        if np.quantile(distance, 0.25) <= np.quantile(shifted_distance, 0.25):
            return np.zeros_like(shift), float(np.quantile(distance, 0.9))
        return shift, float(np.quantile(shifted_distance, 0.9))
