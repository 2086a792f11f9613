"""Clouds made ready for the tracker: points are removed step by step, and counted.

Source: the plane by RANSAC (Fischler and Bolles 1981); outliers and farthest points as in `topokit.sampling`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._validate import Array, as_reals, positive
from topokit.sampling import farthest_point_sample, inliers


class Cleaner:
    """Steps that clean a cloud, in this order; a step that is not asked for is left out.

    Points that are not finite, or at (0, 0, 0), where a depth camera sees nothing, are always removed. After a call, `removed`
    has the number of points that each step removed.

    Parameters
    ----------
    crop : ((3,), (3,)) floats, optional
        Lowest and highest corner of the box that is kept, metres.
    plane : float, optional
        Remove the plane with the most points, such as a table or a wall: all points within this distance of it, metres. It
        removes cloth that lies on it too.
    voxel : float, optional
        Edge of cubes, metres: the points in each cube become their mean.
    outliers : float, optional
        Remove points that are alone: the factor of `topokit.sampling.inliers`. 2.5 suits cloth.
    points : int, optional
        Number of farthest points to keep; None keeps all.

    Examples
    --------
    >>> clean = Cleaner(points=2)
    >>> clean([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0], [np.nan, 0.0, 1.0], [1.0, 2.0, 3.5]])
    array([[1. , 2. , 3. ],
           [1. , 2. , 3.5]])
    >>> clean.removed
    {'not finite': 1, 'at (0, 0, 0)': 1, 'by farthest points': 0}
    """

    def __init__(
        self,
        *,
        crop: Sequence[Sequence[float]] | None = None,
        plane: float | None = None,
        voxel: float | None = None,
        outliers: float | None = None,
        points: int | None = 1000,
    ) -> None:
        self.crop = None if crop is None else np.asarray(crop, dtype=np.float64)
        if self.crop is not None and not (self.crop.shape == (2, 3) and (self.crop[0] < self.crop[1]).all()):
            raise ValueError(f"crop must be a lower and a higher corner, (2, 3), not {self.crop.tolist()}")
        self.plane = None if plane is None else positive(plane, "plane")
        self.voxel = None if voxel is None else positive(voxel, "voxel", zero=False)
        self.outliers = outliers
        self.points = points
        self.removed: dict[str, int] = {}

    def __call__(self, points: ArrayLike) -> Array:
        """Return the remaining points (k, 3) of a frame, (n, 3) or (h, w, 3) in metres; none of a frame that saw nothing."""
        cloud = as_reals(points, "points").astype(np.float64)
        if cloud.ndim not in (2, 3) or cloud.shape[-1] != 3:
            raise ValueError(f"points must be (n, 3) or (h, w, 3), not of shape {cloud.shape}: pick x, y and z")
        cloud = cloud.reshape(-1, 3)
        self.removed = {}
        cloud = self._left("not finite", cloud, cloud[np.isfinite(cloud).all(axis=1)])
        cloud = self._left("at (0, 0, 0)", cloud, cloud[cloud.any(axis=1)])
        if self.crop is not None:
            inside = ((cloud >= self.crop[0]) & (cloud <= self.crop[1])).all(axis=1)
            cloud = self._left("outside the box", cloud, cloud[inside])
        if self.plane is not None and len(cloud) > 3:
            cloud = self._left("on the plane", cloud, cloud[~_on_largest_plane(cloud, self.plane)])
        if self.voxel is not None:
            if np.abs(cloud).max(initial=0.0) > 2**52 * self.voxel:
                raise ValueError(f"voxel is {self.voxel:g}: too small to tell cubes apart at these coordinates")
            _, cells = np.unique(np.floor(cloud / self.voxel), axis=0, return_inverse=True)
            sums = np.stack([np.bincount(cells.ravel(), column) for column in cloud.T], axis=-1)
            cloud = self._left("by voxels", cloud, sums / np.bincount(cells.ravel())[:, None])
        if self.outliers is not None and len(cloud):
            cloud = self._left("outliers", cloud, cloud[inliers(cloud, factor=self.outliers)])
        if self.points is not None and len(cloud):
            ids, _ = farthest_point_sample(cloud, min(self.points, len(cloud)))
            cloud = self._left("by farthest points", cloud, cloud[ids])
        return cloud

    def _left(self, step: str, before: Array, after: Array) -> Array:
        """Note how many points a step removed, and return what is left."""
        self.removed[step] = len(before) - len(after)
        return after


def _on_largest_plane(points: Array, thickness: float) -> NDArray[np.bool_]:
    """Return which points (n, 3) are within a distance of the plane that has the most of them, by RANSAC on 2,000 of them."""
    sample = points[:: max(1, len(points) // 2000)]
    rng = np.random.default_rng(0)
    best = np.zeros(len(sample), dtype=bool)
    for _ in range(300):
        corner, second, third = sample[rng.choice(len(sample), 3, replace=False)]
        normal = np.cross(second - corner, third - corner)
        near = np.abs((sample - corner) @ normal) <= thickness * np.linalg.norm(normal)
        if near.sum() > best.sum() and normal.any():
            best = near
    # The plane of least squares of what is near the best one.
    middle = sample[best].mean(axis=0)
    normal = np.linalg.svd(sample[best] - middle, full_matrices=False)[2][2]
    return np.asarray(np.abs((points - middle) @ normal) <= thickness)
