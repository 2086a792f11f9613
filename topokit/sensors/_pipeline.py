"""The declared pipeline: it removes points from a raw cloud before the search for loops, step by step, and counts them.

Source: Fischler and Bolles 1981 (RANSAC); outliers and farthest points as in `topokit.sampling`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from functools import partial
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BeforeValidator, Field

from topokit._config import Count, Place, Positive, as_tuple, checked
from topokit._validate import Array, as_reals
from topokit.sampling import farthest_point_sample, inliers

Box = Annotated[tuple[Place, Place], BeforeValidator(as_tuple)]
_SAMPLE = 2000  # points that a plane is fitted to
_SHARE = 0.1  # least share of the points that are on a table or a wall
_BEHIND = 0.03  # largest share of the points behind it: otherwise it is cloth with the room behind
_REST = 30  # frames until a plane is searched for again that was not there: a search takes half a second
_TURN = np.cos(np.radians(10))  # a plane turns less from one frame to the next


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
    #: walls and tables to remove: planes that are not seen through, the largest first
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
        self.pipeline = Pipeline() if pipeline is None else pipeline
        self.removed: dict[str, int] = {}
        self._frame = 0
        self._search_from = 0  # the frame from which on planes are searched for
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
        if not len(points):
            return points
        left = step(points)
        self.removed[name] = len(points) - len(left)
        return left

    def _off_planes(self, points: Array) -> Array:
        """Return the points that are on none of the planes, the largest first."""
        thickness = self.pipeline.thickness
        sample = points[:: max(1, len(points) // _SAMPLE)].astype(np.float64)
        before = self._planes
        self._planes = []
        for number in range(self.pipeline.planes):
            # A plane of the last frame is followed. When it is lost, or there was none, a new one is searched for.
            plane = None
            if number < len(before):
                plane = _followed(sample, before[number], thickness)
            if plane is None and self._frame >= self._search_from:
                plane = _found(sample, thickness, np.array(self.pipeline.eye))
                self._search_from = self._frame
                if plane is None:
                    self._search_from += _REST
            if plane is None:
                break
            self._planes.append(plane)
            points = points[~_on(points, plane, thickness)]
            sample = sample[~_on(sample, plane, thickness)]
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


def _fitted(points: Array) -> Array:
    """Return the plane of least squares."""
    middle = points.mean(axis=0)
    normal = np.linalg.eigh((points - middle).T @ (points - middle))[1][:, 0]
    return np.array([*normal, normal @ middle])


def _on(points: Any, plane: Array, thickness: float) -> NDArray[np.bool_]:
    plane = plane.astype(points.dtype)
    return np.abs(points @ plane[:3] - plane[3]) <= thickness


def _followed(points: Array, plane: Array, thickness: float) -> Array | None:
    """Return the present place of a plane of the last frame; None when it is gone."""
    for width in (3 * thickness, thickness):
        near = _on(points, plane, width)
        if near.sum() < max(3, _SHARE * len(points)):
            return None
        before = plane
        plane = _fitted(points[near])
        if abs(before[:3] @ plane[:3]) < _TURN:
            return None
    return plane


def _found(sample: Array, thickness: float, eye: Array) -> Array | None:
    """Return the plane with the most points, among the planes that are not seen through.

    RANSAC looks for it along each axis, and least squares refine it.
    """
    from sklearn.linear_model import RANSACRegressor

    points = sample[::4]
    best = np.zeros(len(points), bool)
    for axis in range(3):
        # Along this axis the plane is a function of the other two coordinates.
        others = np.delete(points, axis, axis=1)
        search = RANSACRegressor(
            residual_threshold=thickness,
            max_trials=300,
            random_state=0,
            is_model_valid=partial(_is_opaque, points=points, axis=axis, thickness=thickness, eye=eye),
        )
        with contextlib.suppress(ValueError):  # none of its trials was valid
            on_plane = search.fit(others, points[:, axis]).inlier_mask_
            if on_plane.sum() > best.sum():
                best = on_plane
    if not best.any():
        return None
    return _followed(sample, _fitted(points[best]), thickness)


def _is_opaque(
    model: Any, _others: Array, _values: Array, *, points: Array, axis: int, thickness: float, eye: Array
) -> bool:
    """Return True if few points lie behind the plane of a linear model, from the eye, and some lie on it."""
    normal = np.insert(model.coef_, axis, -1.0)
    offsets = points @ normal + model.intercept_
    side_of_eye = np.sign(eye @ normal + model.intercept_)
    behind = offsets * side_of_eye < -3 * thickness * np.linalg.norm(normal)
    on_plane = np.abs(offsets) <= thickness
    return bool(behind.mean() <= _BEHIND and on_plane.sum() > 10)


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
