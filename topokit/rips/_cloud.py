"""The kernel's form of a cloud: points or distances, checked, and scaled by a power of two."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._validate import Array, as_points, as_reals

MEMORY = 4 << 30  # bytes that the tables for one cloud may take
_SMALLEST_NORMAL = 2.0**-1022  # the smallest number with all its digits
_TINY = 2.0**-450  # share of the largest coordinate: squares of larger differences have all their digits


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points or distances. Squared lengths order edges of points, because roots may hide a difference.

    The scale is a power of two that brings all numbers to at most 1. It saves squares from overflow and underflow, and it costs
    no digit.
    """

    data: Array  # (n, 3) coordinates times `scale`; or (n, n) distances times `scale`
    axes: tuple[int, ...]  # three zeros; none for distances, as which more than three dimensions are read
    scale: float

    @classmethod
    def of(cls, points: ArrayLike, metric: str = "euclidean") -> Cloud:
        """Check and copy (n, d) coordinates, or with ``metric="precomputed"`` the (n, n) distances."""
        if metric not in ("euclidean", "precomputed"):
            raise ValueError(f'metric must be "euclidean" or "precomputed", not {metric!r}')
        if metric == "precomputed":
            return cls._of_distances(_finite_distances(points))
        return cls.of_points(as_points(points))

    @classmethod
    def _of_distances(cls, matrix: Array) -> Cloud:
        _check_distances(matrix)
        largest = matrix.max(initial=0.0)
        scale = _power_of_two_below(largest)
        scaled = matrix * scale
        # Scaling down must not take digits, or a small distance would become 0.
        if scale < 1 and np.count_nonzero(scaled < _SMALLEST_NORMAL) > np.count_nonzero(matrix == 0):
            smallest = matrix[matrix > 0].min()
            raise ValueError(
                f"the matrix of distances holds {smallest:.3g} and {largest:.3g}: beside the larger one the smaller cannot be "
                "distinguished from 0; give distances so small as 0"
            )
        return cls(scaled, (), scale)

    @classmethod
    def of_points(cls, points: Array) -> Cloud:
        """Check and copy coordinates that `as_points` has returned."""
        n, d = points.shape
        sizes = np.abs(points)
        largest = sizes.max(initial=0.0)
        scale = _power_of_two_below(largest)
        scaled = points * scale
        if largest > 1e307 and np.linalg.norm(np.ptp(points / 4, axis=0) / 2**1000) > 2**23:
            raise ValueError(f"points reach {largest:.3g}, and half their distances overflow; divide them by ten")
        tiny = sizes < _TINY * largest
        if np.count_nonzero(tiny) and (points[tiny] != 0).any():
            _check_near(points, tiny)

        # On a line and in a plane, points have a third coordinate that is 0.
        if d <= 3:
            if d < 3:
                scaled = np.hstack([scaled, np.zeros((n, 3 - d))])
            return cls(scaled, (0, 0, 0), scale)

        # In more dimensions their distances are read.
        if 8 * n**2 > MEMORY:
            raise too_large(n, f"{8 * n**2 / 1e9:.1f} GB for distances in {d} dimensions")
        from scipy.spatial.distance import pdist, squareform  # SciPy takes a while to import

        return cls(squareform(pdist(scaled)), (), scale)

    def __len__(self) -> int:
        return len(self.data)

    def keys(self, i: int | NDArray[np.int64], j: NDArray[np.int64] | slice) -> Array:
        """Return the keys that order edges from i to j, in scaled units: distances of a matrix, squared lengths of points."""
        if self.axes:
            return squares(self.data[i], self.data[j])
        return self.data[i, j]

    def radii(self, i: int | NDArray[np.int64], j: NDArray[np.int64] | slice) -> Array:
        """Return half the lengths of edges from i to j, times `scale`: tiny ones would lose digits in the unit of the points."""
        keys = self.keys(i, j)
        lengths = np.sqrt(keys) if self.axes else keys
        return np.asarray(lengths) / 2

    def key_of(self, radius: float) -> float:
        """Return the key of an edge of a scaled radius, rounded up rather than down."""
        length = 2 * radius * (1 + 1e-15)
        return length * length if self.axes else length


def squares(points: Array, others: Array) -> Array:
    """Return squared distances of points, summed axis by axis as the kernel does; NumPy's `sum` pairs the terms."""
    terms = (points - others) ** 2
    total = terms[..., 0]
    for axis in range(1, terms.shape[-1]):
        total = total + terms[..., axis]
    return total


def too_large(n: int, needs: str) -> MemoryError:
    """Return the error for a cloud of n points that needs more memory than it may have."""
    return MemoryError(
        f"persistence may take {MEMORY / 1e9:.1f} GB for one cloud, and these {n} points need {needs}; "
        "take a subset (topokit.farthest_point_sample), or stop earlier (max_radius)"
    )


def _power_of_two_below(largest: float) -> float:
    """Return the power of two that scales numbers up to `largest` to at most 1."""
    return 2.0 ** -max(math.frexp(largest)[1], -1022)


def _check_near(points: Array, tiny: NDArray[np.bool_]) -> None:
    """Raise ValueError when two points differ in tiny coordinates alone: the square of their distance may be 0."""
    coarse = np.where(tiny, 0.0, points)
    _, first, place = np.unique(coarse, axis=0, return_index=True, return_inverse=True)
    same = first[place.ravel()]
    rows = np.flatnonzero((points != points[same]).any(axis=1))
    if len(rows):
        raise ValueError(
            f"points[{same[rows[0]]}] and points[{rows[0]}] are nearer to each other than 1e-135 of the cloud's extent, which "
            "floating point cannot distinguish from 0 in a square: round the coordinates, np.round(points, 100) for example"
        )


def _check_distances(matrix: Array) -> None:
    """Raise ValueError when the matrix cannot be one of distances; the message names the entry."""
    if matrix.shape[0] != matrix.shape[1]:
        raise ValueError(f"the matrix of distances must be square, not of shape {matrix.shape}")
    for wrong, what in (
        (matrix < 0, "negative"),
        (matrix != matrix.T, "not symmetric"),
        (np.diag(np.diag(matrix) != 0), "not zero on the diagonal"),
    ):
        if wrong.any():
            i, j = np.argwhere(wrong)[0].tolist()
            raise ValueError(f"the matrix of distances is {what} at [{i}, {j}]: {matrix[i, j]} and {matrix[j, i]}")


def _finite_distances(points: ArrayLike) -> Array:
    """Return a matrix of distances, or raise ValueError when one of them is no number."""
    matrix = as_reals(points, "points")
    missing = np.argwhere(~np.isfinite(matrix))
    if matrix.ndim == 2 and len(missing):
        i, j = missing[0].tolist()
        problem = f"the matrix of distances is {matrix[i, j]} at [{i}, {j}], and at {len(missing)} places in all"
        advice = "for pairs that never meet put a number above all others, and give max_radius below half of it"
        raise ValueError(f"{problem}; {advice}")
    return as_points(matrix)
