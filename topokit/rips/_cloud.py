"""A checked cloud: points or distances, and what orders its edges."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._validate import Array, as_points, as_reals

MEMORY = 4 << 30  # bytes that the tables for one cloud may take


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points or distances. Squared lengths order edges of points, because roots may hide a difference."""

    data: Array  # (n, 3) coordinates; or (n, n) distances
    is_matrix: bool  # more than three dimensions are read as a matrix of distances

    @classmethod
    def of(cls, points: ArrayLike, metric: str = "euclidean") -> Cloud:
        """Check and copy (n, d) coordinates, or with ``metric="precomputed"`` the (n, n) distances."""
        if metric not in ("euclidean", "precomputed"):
            raise ValueError(f'metric must be "euclidean" or "precomputed", not {metric!r}')
        if metric == "precomputed":
            return cls(_as_distances(points), True)
        cloud = as_points(points, copy=True)
        if len(cloud) == cloud.shape[1] > 3 and not np.diag(cloud).any() and (cloud == cloud.T).all():
            question = (
                'points are a symmetric matrix with a zero diagonal: if they are distances, give metric="precomputed"'
            )
            warnings.warn(question, stacklevel=3)
        return cls.of_points(cloud)

    @classmethod
    def of_points(cls, points: Array) -> Cloud:
        """Take coordinates that `as_points` has copied."""
        n, d = points.shape
        if d > 3:
            check_memory(n, is_matrix=True)
            from scipy.spatial.distance import pdist, squareform  # SciPy takes a while to import

            return cls(squareform(pdist(points)), True)
        if d < 3:
            points = np.hstack([points, np.zeros((n, 3 - d))])
        return cls(points, False)

    def __len__(self) -> int:
        return len(self.data)

    def keys(self, i: int | NDArray[np.int64], j: NDArray[np.int64] | slice) -> Array:
        """Return what orders the edges from i to j: distances of a matrix, squared lengths of points."""
        if self.is_matrix:
            return self.data[i, j]
        return squares(self.data[i], self.data[j])

    def radii(self, i: int | NDArray[np.int64], j: NDArray[np.int64] | slice) -> Array:
        """Return half the lengths of edges from i to j."""
        keys = self.keys(i, j)
        return np.asarray(keys if self.is_matrix else np.sqrt(keys)) / 2

    def key_of(self, radius: float) -> float:
        """Return the key of an edge of a radius, rounded up rather than down."""
        length = min(2 * radius * (1 + 1e-15), 1e154)
        return length if self.is_matrix else length * length


def squares(points: Array, others: Array) -> Array:
    """Return squared distances of points, summed axis by axis as the engine does; NumPy's `sum` pairs the terms."""
    x, y, z = np.moveaxis(points - others, -1, 0)
    return x * x + y * y + z * z


def check_memory(n: int, *, is_matrix: bool) -> None:
    """Raise MemoryError when the tables for n points take too much: a bit for each pair, and a number in a matrix."""
    needed = n**2 // 8 + 8 * n**2 * is_matrix
    if needed > MEMORY:
        raise MemoryError(
            f"the tables for {n} points take {needed / 1e9:.1f} GB, and may take {MEMORY / 1e9:.1f} GB: take a subset of the "
            "points by topokit.farthest_point_sample; births and deaths change by at most its covering radius"
        )


def _as_distances(points: ArrayLike) -> Array:
    """Return a symmetric matrix with a zero diagonal, or raise ValueError, which names the entry, when it is not near one.

    Distances by scalar products are inexact. So squares may be off by 1e-10 of the largest one, by 1e-5 in single precision.
    """
    given = as_reals(points, "points")
    rounding = 1e-5 if given.dtype.kind == "f" and given.dtype.itemsize < 8 else 1e-10
    matrix = given.astype(np.float64)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
        raise ValueError(f"the matrix of distances must be square, not of shape {matrix.shape}")
    finite = np.where(np.isfinite(matrix), matrix, 0)
    share = finite / (np.abs(finite).max(initial=0.0) or 1.0)
    squared = share * np.abs(share)
    for wrong, what in (
        (~np.isfinite(matrix) | (squared < -rounding), "no finite number of zero or more"),
        (abs(squared - squared.T) > rounding, "not symmetric"),
        (np.diag(np.diag(squared) > rounding), "not zero on the diagonal"),
    ):
        if wrong.any():
            i, j = np.argwhere(wrong)[0].tolist()
            raise ValueError(f"the matrix of distances is {what} at [{i}, {j}]: {matrix[i, j]}")
    matrix = np.maximum(matrix + matrix.T, 0) / 2
    np.fill_diagonal(matrix, 0)
    return matrix
