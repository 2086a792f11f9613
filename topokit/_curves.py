"""Closed polygonal curves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def side_lengths(curve: Array) -> Array:
    """Lengths of the sides of closed curves, (..., n) of (..., n, d); the last side joins the last corner to the first."""
    return np.asarray(np.linalg.norm(np.roll(curve, -1, axis=-2) - curve, axis=-1))


def curve_centroid(curve: Array) -> Array:
    """(d,) centroid of a closed curve (n, d) by length: its corners may crowd on one side."""
    middles = (curve + np.roll(curve, -1, axis=0)) / 2
    return np.asarray(np.average(middles, axis=0, weights=side_lengths(curve)))
