"""The variation between episodes: declared ranges, and a random generator for every purpose."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator

from topokit._config import as_tuple, checked

from ._camera import Camera
from ._garments import Garment
from ._world import SimulationConfig

Range = Annotated[tuple[float, float], BeforeValidator(as_tuple)]


@checked
class Randomisation:
    """Ranges (low, high) from which every episode draws its physics, size and cameras; None leaves a number as it is."""

    stiffness: Range | None = (0.6, 1.0)  #: (2,)
    bending: Range | None = (0.0001, 0.003)  #: (2,) drawn on a logarithmic scale
    damping: Range | None = (0.15, 0.4)  #: (2,)
    friction: Range | None = (0.6, 1.4)  #: (2,)
    mass: Range | None = (0.2, 0.4)  #: (2,)
    scale: Range | None = (0.92, 1.08)  #: (2,) factor on all sizes of the garment
    camera_distance: Range | None = (0.9, 1.1)  #: (2,) factor on a camera's distance from the place it looks at
    camera_turn: Range | None = (-15.0, 15.0)  #: (2,) degrees about the vertical through that place
    camera_tilt: Range | None = (-8.0, 8.0)  #: (2,) degrees by which a camera is raised

    PHYSICS = ("stiffness", "bending", "damping", "friction", "mass")  # the fields of `SimulationConfig` that are drawn
    version = 1  # of the meaning of these numbers; recorded with them

    @staticmethod
    def generator(seed: int, purpose: str) -> np.random.Generator:
        """Return the random generator of an episode for one purpose; the purposes are independent of each other.

        Parameters
        ----------
        seed : int
        purpose : {"path", "physics", "cameras", "noise", "sizes", "place", "script"}
        """
        purposes = ("path", "physics", "cameras", "noise", "sizes", "place", "script")  # new ones at the end
        return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(purposes.index(purpose),)))

    def draw(
        self, seed: int, config: SimulationConfig, garment: Garment, cameras: Sequence[Camera] = ()
    ) -> tuple[SimulationConfig, Garment, tuple[Camera, ...], dict[str, Any]]:
        """Return config, garment and cameras of the episode `seed`, and the numbers drawn.

        Every number has its own draw, made whether or not its range is None: leaving one out does not move the others.

        Parameters
        ----------
        seed, config, garment, cameras
            As in `simulate`.
        """
        # The physics, and the scale of the garment.
        drawn: dict[str, Any] = {}
        shares = self.generator(seed, "physics").random(len(self.PHYSICS) + 1)
        for name, share in zip((*self.PHYSICS, "scale"), shares, strict=True):
            bounds = getattr(self, name)
            if bounds is not None:
                drawn[name] = _between(bounds, share, logarithmic=name == "bending")
        config = dataclasses.replace(config, **{name: drawn[name] for name in self.PHYSICS if name in drawn})
        if "scale" in drawn:
            parameters = {**garment.parameters, "scale": drawn["scale"]}
            garment = dataclasses.replace(garment, vertices=drawn["scale"] * garment.vertices, parameters=parameters)
        rng = self.generator(seed, "cameras")
        moved = tuple(self._moved(camera, *rng.random(3)) for camera in cameras)
        if cameras:
            drawn["camera_eyes"] = [list(camera.eye) for camera in moved]
        return config, garment, moved, drawn

    def _moved(self, camera: Camera, *shares: float) -> Camera:
        """Return the camera moved on the sphere about the place it looks at; it is never raised to the zenith."""
        ranges = (self.camera_distance or (1.0, 1.0), self.camera_turn or (0.0, 0.0), self.camera_tilt or (0.0, 0.0))
        distance, turn, tilt = map(_between, ranges, shares)
        # In spherical coordinates about that place.
        x, y, z = np.subtract(camera.eye, camera.target)
        radius = distance * float(np.sqrt(x * x + y * y + z * z))
        azimuth = np.arctan2(y, x) + np.radians(turn)
        elevation = np.clip(np.arctan2(z, np.hypot(x, y)) + np.radians(tilt), -1.5, 1.5)
        flat = np.cos(elevation)
        eye = camera.target + radius * np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
        return dataclasses.replace(camera, eye=tuple(eye.tolist()))


def _between(bounds: tuple[float, float], share: float, logarithmic: bool = False) -> float:
    """Return the number at a share of the way from the low to the high end of a range."""
    low, high = bounds
    if logarithmic:
        return float(low * (high / low) ** share)
    return float(low + share * (high - low))
