"""Depth cameras: images of the cloth, and their pixels as points in metres.

A camera draws the whole scene, so that near surfaces hide what is behind them. Only the pixels of the cloth become points.

Source: Hartley and Zisserman 2004, chapter 6 (the pinhole camera); Nguyen, Izadi and Lovell 2012, *Modeling Kinect sensor
noise for improved 3D reconstruction and tracking* (the noise). Taught in chapter 10.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from topokit._config import Count, NotNegative, Place, Positive, checked

from ._surface import Array

Mask = NDArray[np.bool_]


@checked
class Camera:
    """A pinhole depth camera; lengths are in metres."""

    eye: Place = (0.0, -1.6, 1.2)  #: (3,) the place of the camera
    target: Place = (0.0, 0.0, 1.0)  #: (3,) the place that is seen in the middle of the picture
    up: Place = (0.0, 0.0, 1.0)  #: (3,) the direction that is up in the picture; it may not be that of the view
    fov: Annotated[float, Field(gt=0, lt=180)] = 50.0  #: vertical angle of view, degrees
    width: Count = 128  #: width of the picture, pixels
    height: Count = 128  #: height of the picture, pixels
    near: Positive = 0.1  #: the least depth that is seen
    far: Positive = 6.0  #: the largest depth that is seen
    #: The errors of the depths and of the outlines, as a multiple of those of a Kinect (Nguyen et al. 2012); 0 for none.
    noise: NotNegative = 0.0

    @property
    def axes(self) -> Array:
        """Return the unit vectors (3, 3) that point right, up and forward in the picture."""
        forward = np.subtract(self.target, self.eye)
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, self.up)
        right /= np.linalg.norm(right)
        return np.array([right, np.cross(right, forward), forward])

    def add_noise(self, depth: Array, mask: Mask, rng: np.random.Generator) -> tuple[Array, Mask]:
        """Return a noisy copy of a depth image and of the mask of the cloth in it.

        Parameters
        ----------
        depth, mask : (h, w) arrays
            Metres, and bool.
        rng : numpy.random.Generator
        """
        # Lateral noise, 0.8 pixels: each pixel takes the value of a pixel near it, so that outlines become ragged.
        rows, columns = np.indices(depth.shape)
        shift = np.rint(0.8 * self.noise * rng.standard_normal((2, *depth.shape))).astype(np.int64)
        rows = np.clip(rows + shift[0], 0, depth.shape[0] - 1)
        columns = np.clip(columns + shift[1], 0, depth.shape[1] - 1)
        depth = depth[rows, columns]
        mask = mask[rows, columns]
        # Axial noise, metres: its deviation grows with the square of the distance from the best depth, 0.4 m.
        deviation = 0.0012 + 0.0019 * (np.where(mask, depth, 0.4) - 0.4) ** 2
        return depth + self.noise * deviation * rng.standard_normal(depth.shape), mask

    def unproject(self, depth: ArrayLike, mask: ArrayLike) -> Array:
        """Return the points (n, 3) in metres that the pixels of `mask` see, row by row.

        Parameters
        ----------
        depth, mask : (h, w) array_like
            Metres along the direction of view, not along the ray; and bool.
        """
        metres = np.asarray(depth, dtype=np.float64)
        rows, columns = np.nonzero(np.asarray(mask, dtype=bool))
        # PyBullet's TinyRenderer samples a pixel at its left lower corner, not at its middle.
        half = np.tan(np.radians(self.fov) / 2)
        x = (2 * columns / self.width - 1) * half * self.width / self.height
        y = (1 - 2 * (rows + 1) / self.height) * half
        rays = np.column_stack([x, y, np.ones(len(x))]) * metres[rows, columns][:, None]
        return np.asarray(self.eye + rays @ self.axes)
