"""Depth cameras: images of the cloth, and their pixels as points in metres.

A camera draws the whole scene, so that what is in front hides what is behind; only the cloth's pixels become points.

Source: Hartley and Zisserman 2004, chapter 6 (the pinhole camera); Nguyen, Izadi and Lovell 2012, *Modeling Kinect sensor
noise for improved 3D reconstruction and tracking* (the noise). Taught in chapter 8.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from topokit._config import NotNegative, Place, Positive, checked

from ._surface import Array

Mask = NDArray[np.bool_]
Pixels = Annotated[int, Field(ge=1, le=4096)]


@checked
class DepthNoise:
    """The errors of a structured-light depth sensor, after Nguyen, Izadi and Lovell 2012."""

    axial: NotNegative = 0.0012  #: standard deviation of the depth at `best` metres, in metres
    axial_growth: NotNegative = 0.0019  #: the deviation at depth z is `axial + axial_growth * (z - best)**2`; 1/m
    best: NotNegative = 0.4  #: depth of least noise, metres
    lateral: NotNegative = 0.8  #: standard deviation, in pixels, of the place a pixel reads: outlines become ragged
    dropout: Annotated[float, Field(ge=0, lt=1)] = 0.0  #: share of pixels that are lost, each by itself

    def add_to(self, depth: Array, mask: Mask, rng: np.random.Generator) -> tuple[Array, Mask]:
        """Return a noisy copy of a depth image and of the mask of the cloth in it.

        Parameters
        ----------
        depth : (h, w) array
            Metres.
        mask : (h, w) array of bool
        rng : numpy.random.Generator
        """
        # Across the view: each pixel reads the place of a neighbour, so that outlines become ragged.
        rows, columns = np.indices(depth.shape)
        shift = np.rint(self.lateral * rng.standard_normal((2, *depth.shape))).astype(np.int64)
        rows = np.clip(rows + shift[0], 0, depth.shape[0] - 1)
        columns = np.clip(columns + shift[1], 0, depth.shape[1] - 1)
        depth = depth[rows, columns]
        mask = mask[rows, columns] & (rng.random(mask.shape) >= self.dropout)
        # Along the view: a deviation that grows with the square of the distance.
        deviation = self.axial + self.axial_growth * (np.where(mask, depth, self.best) - self.best) ** 2
        return depth + deviation * rng.standard_normal(depth.shape), mask


@checked
class Camera:
    """A pinhole depth camera. Metres, degrees, pixels."""

    eye: Place = (0.0, -1.6, 1.2)  #: (3,) where it is
    target: Place = (0.0, 0.0, 1.0)  #: (3,) the place in the middle of its picture
    up: Place = (0.0, 0.0, 1.0)  #: (3,) the direction that points up in the picture, not along the view
    fov: Annotated[float, Field(gt=0, lt=180)] = 50.0  #: vertical angle of view, degrees
    width: Pixels = 128  #: of the picture, pixels
    height: Pixels = 128  #: of the picture, pixels
    near: Positive = 0.1  #: nothing nearer is seen
    far: Positive = 6.0  #: nothing farther is seen
    noise: DepthNoise | None = None  #: added by `observe`; none when not given

    def __post_init__(self) -> None:
        if self.near >= self.far:
            raise ValueError(f"near ({self.near} m) must be less than far ({self.far} m)")
        forward = np.subtract(self.target, self.eye)
        scale = float(np.linalg.norm(forward) * np.linalg.norm(self.up))
        if np.linalg.norm(np.cross(forward, self.up)) <= 1e-9 * scale:
            raise ValueError(f"the camera at {self.eye} must look at another place than itself, not along up {self.up}")

    @property
    def axes(self) -> Array:
        """Unit vectors (3, 3) to the right, up and forward in the picture."""
        forward = np.subtract(self.target, self.eye)
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, self.up)
        right /= np.linalg.norm(right)
        return np.array([right, np.cross(right, forward), forward])

    @property
    def matrices(self) -> tuple[list[float], list[float]]:
        """OpenGL's view and projection matrices, column by column, as PyBullet's renderer takes them."""
        axes = self.axes * [[1], [1], [-1]]  # OpenGL looks along -z
        view = np.eye(4)
        view[:3, :3] = axes
        view[:3, 3] = -axes @ self.eye
        scale = 1 / np.tan(np.radians(self.fov) / 2)
        reach = self.near - self.far
        projection = np.diag([scale * self.height / self.width, scale, (self.near + self.far) / reach, 0.0])
        projection[2, 3] = 2 * self.near * self.far / reach
        projection[3, 2] = -1.0
        return view.T.ravel().tolist(), projection.T.ravel().tolist()

    def depths(self, buffer: ArrayLike) -> Array:
        """Turn a depth buffer, 0 at `near` and 1 at `far`, into (h, w) metres along the view; inf where nothing is."""
        values = np.asarray(buffer, dtype=np.float64).reshape(self.height, self.width)
        metres = self.near * self.far / (self.far - (self.far - self.near) * values)
        return np.where(values < 1 - 1e-6, metres, np.inf)

    def unproject(self, depth: ArrayLike, mask: ArrayLike) -> Array:
        """Return the points (n, 3) in metres that the pixels of `mask` see, row by row.

        Parameters
        ----------
        depth : (h, w) array_like
            Metres along the direction of view, not along the ray.
        mask : (h, w) array_like of bool

        Raises
        ------
        ValueError
            When a shape is not the camera's, or a pixel of the mask has no depth.
        """
        metres = np.asarray(depth, dtype=np.float64)
        chosen = np.asarray(mask, dtype=bool)
        for name, image in (("depth", metres), ("mask", chosen)):
            if image.shape != (self.height, self.width):
                raise ValueError(f"{name} must be of shape {(self.height, self.width)}, not {image.shape}")
        rows, columns = np.nonzero(chosen & np.isfinite(metres))
        if len(rows) < chosen.sum():
            row, column = np.argwhere(chosen & ~np.isfinite(metres))[0]
            raise ValueError(f"pixel ({row}, {column}) of the mask sees nothing: its depth is {metres[row, column]}")
        # PyBullet's TinyRenderer samples a pixel at its left edge and its lower edge, not at its middle.
        half = np.tan(np.radians(self.fov) / 2)
        x = (2 * columns / self.width - 1) * half * self.width / self.height
        y = (1 - 2 * (rows + 1) / self.height) * half
        rays = np.column_stack([x, y, np.ones(len(x))]) * metres[rows, columns][:, None]
        return np.asarray(self.eye + rays @ self.axes)

    @staticmethod
    def around(
        place: ArrayLike = (0.0, 0.1, 1.0), n: int = 3, *, distance: float = 1.6, noise: DepthNoise | None = None
    ) -> tuple[Camera, ...]:
        """Return `n` cameras evenly around a place, 20 degrees over its horizon, the first in front of it (towards -y).

        Parameters
        ----------
        place : (3,) array_like
        n : int
        distance : float
            From the place, metres.
        noise : DepthNoise, optional
            Of every camera.

        Raises
        ------
        ValueError
            When there would be more than a hundred.
        """
        if not 0 <= n <= 100:
            raise ValueError(f"n must be 0 to 100 cameras, not {n}")
        middle = np.asarray(place, dtype=np.float64)
        turn = 2 * np.pi * np.arange(n) / n - np.pi / 2
        tilt = np.radians(20)
        around = np.column_stack([np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), np.full(n, np.sin(tilt))])
        x, y, z = middle.tolist()
        return tuple(Camera(tuple(eye), (x, y, z), noise=noise) for eye in (middle + distance * around).tolist())
