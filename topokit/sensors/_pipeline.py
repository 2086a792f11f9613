"""The declared pipeline: it removes points from a raw cloud before the search for loops, step by step, and counts them.

Source: planes as in `_planes`; outliers and farthest points as in `topokit.sampling`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import partial
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, Field

from topokit._config import Count, Place, Positive, as_tuple, checked
from topokit._validate import Array, as_reals
from topokit.sampling import farthest_point_sample, inliers

from ._planes import followed, found, near, of_plane

Box = Annotated[tuple[Place, Place], BeforeValidator(as_tuple)]
_SAMPLE = 2000  # points that a plane is fitted to
_REST = 30  # frames until a plane is searched for again that was not there: a search takes half a second
_DOUBT = (
    "parts within the cloth are no farther from the table than the camera errs: they are kept as cloth, and a hole there is "
    "missed; bring the camera nearer, lift the cloth, or remove the table by its colour"
)
_log = logging.getLogger(__name__)


@checked
class Pipeline:
    """The steps that each frame goes through, in this order; a step that is not declared is left out.

    Examples
    --------
    >>> Pipeline(crop=((-1, -1, 0.3), (1, 1, 2)), planes=1, voxel=0.008, outliers=2.5).points
    1000
    """

    finite: bool = True  #: drop points with a NaN or infinite coordinate
    zeros: bool = True  #: drop points at (0, 0, 0): pixels where a depth camera saw nothing
    crop: Box | None = None  #: lowest and highest corner of the box that is kept, metres
    #: walls and tables to remove: planes that are not seen through, the largest first; cloth that lies on them is kept
    planes: Annotated[int, Field(ge=0, le=10)] = 0
    eye: Place = (0.0, 0.0, 0.0)  #: place of the camera
    thickness: Positive = 0.01  #: largest distance from a plane of points that belong to it, metres
    voxel: Positive | None = None  #: edge of cubes, metres: the points in each cube become their mean
    #: drop points that are alone: the factor of `topokit.sampling.inliers`; 2.5 suits cloth
    outliers: Positive | None = None
    points: Count | None = 1000  #: number of farthest points to keep; None keeps all

    def __post_init__(self) -> None:
        if self.crop is not None and not (np.array(self.crop[0]) < self.crop[1]).all():
            raise ValueError(f"crop: {self.crop[0]} is not below {self.crop[1]} in all of x, y and z")


class Cleaner:
    """A pipeline at work on the frames of one film, a call a frame: planes are followed from frame to frame.

    After a call, `removed` holds how many points each step removed. Without a pipeline it is `Pipeline()`.

    Examples
    --------
    >>> clean = Cleaner(Pipeline(points=2))
    >>> clean([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0], [np.nan, 0.0, 1.0], [1.0, 2.0, 3.5]])
    array([[1. , 2. , 3. ],
           [1. , 2. , 3.5]])
    >>> clean.removed
    {'not finite': 1, 'at (0, 0, 0)': 1, 'by farthest points': 0}
    """

    def __init__(self, pipeline: Pipeline | None = None) -> None:
        if not isinstance(pipeline, (Pipeline, type(None))):
            raise TypeError(f"pipeline must be a Pipeline, not {type(pipeline).__name__}: give Pipeline(**options)")
        self.pipeline = Pipeline() if pipeline is None else pipeline
        self.removed: dict[str, int] = {}
        self._frame = 0
        self._search_from = 0  # the frame from which on planes are searched for
        self._warned = False  # whether cloth that may be a plane has been reported
        self._planes: list[Array] = []  # planes of the last frame: unit normal, and its product with the plane's points

    def __call__(self, points: ArrayLike) -> Array:
        """Return the remaining points (k, 3) of a frame, (n, 3) or (h, w, 3) in metres; none of a frame that saw nothing."""
        raw = as_reals(points, "points")
        if raw.ndim not in (2, 3) or raw.shape[-1] != 3:
            raise ValueError(f"points must be (n, 3) or (h, w, 3), not of shape {raw.shape}: pick x, y and z")
        kind = np.float32 if raw.dtype == np.float32 else np.float64
        raw = np.ascontiguousarray(raw.reshape(-1, 3), dtype=kind)
        declared = self.pipeline
        self.removed = {}

        # The first three steps at once, since a frame may have 300,000 points.
        box = np.array(declared.crop or ((-np.inf,) * 3, (np.inf,) * 3))
        left, (not_finite, at_zero, outside) = _sieve(raw, declared.finite, declared.zeros, box)
        if declared.finite:
            self.removed["not finite"] = not_finite
        if declared.zeros:
            self.removed["at (0, 0, 0)"] = at_zero
        if declared.crop is not None:
            self.removed["outside the box"] = outside

        if declared.planes:
            left = self._step("on planes", left, self._off_planes)
        if declared.voxel is not None:
            left = self._step("by voxels", left, partial(_voxel_means, edge=declared.voxel))
        if declared.outliers is not None:
            left = self._step("outliers", left, partial(_without_outliers, factor=declared.outliers))
        if declared.points is not None:
            left = self._step("by farthest points", left, partial(_farthest, n=declared.points))
        self._frame += 1
        return np.asarray(left, dtype=np.float64)

    def _step(self, name: str, points: Array, step: Callable[[Array], Array]) -> Array:
        """Apply a step to the remaining points, and count the points that it removes."""
        self.removed[name] = 0
        if not len(points):
            return points
        left = step(points)
        self.removed[name] = len(points) - len(left)
        return left

    def _off_planes(self, points: Array) -> Array:
        """Return the points that are part of none of the planes, the largest first; what lies on a plane is left."""
        thickness = self.pipeline.thickness
        eye = np.array(self.pipeline.eye)
        sample = points[:: max(1, len(points) // _SAMPLE)].astype(np.float64)
        before = self._planes
        self._planes = []
        for number in range(self.pipeline.planes):
            # A plane of the last frame is followed. When it is lost, or there was none, a new one is searched for.
            plane = None
            if number < len(before):
                plane = followed(sample, before[number], thickness)
            if plane is None and self._frame >= self._search_from:
                plane = found(sample, thickness, eye)
                self._search_from = self._frame
                if plane is None:
                    self._search_from += _REST
            if plane is None:
                break
            self._planes.append(plane)
            on_plane, doubtful = of_plane(points, plane, thickness, eye)
            points = points[~on_plane]
            sample = sample[~near(sample, plane, thickness)]
            if doubtful and not self._warned:
                self._warned = True
                _log.warning("%s", _DOUBT)
        return points


def _sieve(points: Array, finite: bool, zeros: bool, box: Array) -> tuple[Array, list[int]]:
    """Return the points that pass, and how many are not finite, how many at (0, 0, 0), how many outside the box."""
    columns = [np.ascontiguousarray(column) for column in points.T]  # reading one axis at a time is quickest
    not_finite = np.zeros(len(points), np.bool_)
    outside = not_finite.copy()
    if finite:
        not_finite = ~np.logical_and.reduce([np.isfinite(column) for column in columns])
    at_zero = np.logical_and.reduce([column == 0 for column in columns]) & zeros
    if np.isfinite(box).any():
        for column, lowest, highest in zip(columns, *box, strict=True):
            outside |= column < lowest
            outside |= column > highest

    # A point is counted by the first step that removes it.
    left = np.ones(len(points), np.bool_)
    counts = []
    for removed in (not_finite, at_zero, outside):
        removed &= left
        left ^= removed
        counts.append(int(np.count_nonzero(removed)))
    return points.compress(left, axis=0), counts


def _voxel_means(points: Array, edge: float) -> Array:
    """Return the mean of the points in each cube that holds any."""
    from pandas import factorize

    cells = np.floor(points / edge)
    cells -= cells.min(axis=0)
    sizes = cells.max(axis=0).astype(np.float64) + 1
    if sizes.prod() > 2**62:
        raise ValueError(f"voxel: {edge} m is too small for a scene of {sizes.max() * edge:.3g} m; crop it first")
    strides = np.array([sizes[1] * sizes[2], sizes[2], 1], np.int64)
    numbers = factorize(cells.astype(np.int64) @ strides)[0]
    sums = [np.bincount(numbers, points[:, axis]) for axis in range(3)]
    return np.column_stack(sums) / np.bincount(numbers)[:, None]


def _without_outliers(points: Array, factor: float) -> Array:
    return points[inliers(points, factor=factor)]


def _farthest(points: Array, n: int) -> Array:
    chosen, _ = farthest_point_sample(points, min(n, len(points)))
    return points[chosen]
