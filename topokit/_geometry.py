"""Turns about the vertical: z points up everywhere in this library."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def turned(places: ArrayLike, degrees: ArrayLike) -> NDArray[np.float64]:
    """Return places (..., 3) turned about the z axis by degrees, from x towards y."""
    x, y, z = np.moveaxis(np.asarray(places, dtype=np.float64), -1, 0)
    cos = np.cos(np.radians(degrees))
    sin = np.sin(np.radians(degrees))
    return np.stack(np.broadcast_arrays(cos * x - sin * y, sin * x + cos * y, z), axis=-1)


def angle(start: NDArray[np.float64], end: NDArray[np.float64]) -> float:
    """Return the angle from one level direction to another, -180 to 180 degrees, from x towards y."""
    return float(np.degrees(np.arctan2(start[0] * end[1] - start[1] * end[0], start[:2] @ end[:2])))
