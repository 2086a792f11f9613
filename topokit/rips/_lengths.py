"""Lengths of edges, the same to the last bit wherever they are computed: they decide ties."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["power_of_two", "squares_from"]


def power_of_two(points: NDArray[np.float64]) -> float:
    """A factor for coordinates that saves squared distances from overflow and underflow, and changes no digit."""
    return 2.0 ** -int(np.frexp(np.ptp(points, axis=0).max())[1]) if len(points) else 1.0


def squares_from(points: NDArray[np.float64], i: int) -> NDArray[np.float64]:
    """(n,) squared distances from point i, summed axis by axis, as the kernels do; NumPy's `sum` pairs the terms."""
    total = np.zeros(len(points))
    for axis in range(points.shape[1]):
        total += (points[:, axis] - points[i, axis]) ** 2
    return total
