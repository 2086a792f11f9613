"""What varies between episodes: declared ranges, drawn with a generator for every purpose and recorded.

Source: Antonova et al. 2021, section 6 (stiffness and paths are randomised). Taught in chapter 7.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from topokit._validate import positive

from .camera import Camera
from .config import SimulationConfig
from .garments import Garment

__all__ = ["PURPOSES", "Randomisation", "generator"]

PURPOSES = ("path", "physics", "cameras", "noise")
Range = tuple[float, float]
_CONFIGURED = ("stiffness", "bending", "damping", "friction", "mass")


def generator(seed: int, purpose: str) -> np.random.Generator:
    """Return the random generator of an episode for one purpose; the purposes are independent of each other.

    Examples
    --------
    >>> generator(7, "path").random() == generator(7, "path").random() != generator(7, "physics").random()
    True
    """
    if purpose not in PURPOSES:
        raise ValueError(f"purpose must be one of {', '.join(PURPOSES)}, not {purpose!r}")
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(PURPOSES.index(purpose),)))


@dataclass(frozen=True)
class Randomisation:
    """Ranges (low, high) from which every episode draws its own physics, size and cameras. None leaves a number as it is.

    Attributes
    ----------
    stiffness, bending, damping, friction, mass : (2,) float, optional
        Of `SimulationConfig`, in its units; bending is drawn on a logarithmic scale.
    scale : (2,) float, optional
        Factor on all sizes of the garment.
    camera_distance : (2,) float, optional
        Factor on the distance of a camera from the place it looks at.
    camera_turn, camera_tilt : (2,) float, optional
        Degrees by which a camera is turned about the vertical through that place, and raised.

    Raises
    ------
    TypeError, ValueError
        When a range is not two finite numbers, low first, or leaves what its number may be.
    """

    stiffness: Range | None = (0.6, 1.0)
    bending: Range | None = (0.0001, 0.003)
    damping: Range | None = (0.15, 0.4)
    friction: Range | None = (0.6, 1.4)
    mass: Range | None = (0.2, 0.4)
    scale: Range | None = (0.92, 1.08)
    camera_distance: Range | None = (0.9, 1.1)
    camera_turn: Range | None = (-15.0, 15.0)
    camera_tilt: Range | None = (-8.0, 8.0)

    version = 1  # of the meaning of these numbers; recorded with them

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value is None:
                continue
            try:
                low, high = (float(number) for number in value)
            except (TypeError, ValueError) as error:
                raise TypeError(f"{field.name} must be two numbers (low, high) or None, not {value!r}") from error
            if not (np.isfinite([low, high]).all() and low <= high):
                raise ValueError(f"{field.name} must be finite, low before high, not {value!r}")
            if field.name not in ("camera_turn", "camera_tilt"):
                positive(low, f"{field.name}[0]", zero=field.name in ("damping", "friction"))
            object.__setattr__(self, field.name, (low, high))

    def draw(
        self, seed: int, config: SimulationConfig, garment: Garment, cameras: Sequence[Camera] = ()
    ) -> tuple[SimulationConfig, Garment, tuple[Camera, ...], dict[str, Any]]:
        """Return config, garment and cameras of the episode `seed`, and the numbers drawn.

        Every number has its own draw, made whether or not its range is None: leaving one out does not move the others.
        """
        shares = dict(
            zip((*_CONFIGURED, "scale"), generator(seed, "physics").random(len(_CONFIGURED) + 1), strict=True)
        )
        drawn: dict[str, Any] = {
            name: _between(getattr(self, name), share, logarithmic=name == "bending")
            for name, share in shares.items()
            if getattr(self, name) is not None
        }
        config = dataclasses.replace(config, **{name: drawn[name] for name in _CONFIGURED if name in drawn})
        if "scale" in drawn:
            parameters = {**garment.parameters, "scale": drawn["scale"]}
            garment = dataclasses.replace(garment, vertices=drawn["scale"] * garment.vertices, parameters=parameters)
        rng = generator(seed, "cameras")
        moved = []
        for camera in cameras:
            share = rng.random(3)
            distance = 1.0 if self.camera_distance is None else _between(self.camera_distance, share[0])
            turn = 0.0 if self.camera_turn is None else _between(self.camera_turn, share[1])
            tilt = 0.0 if self.camera_tilt is None else _between(self.camera_tilt, share[2])
            moved.append(_moved(camera, distance, np.radians(turn), np.radians(tilt)))
        if cameras:
            drawn["camera_eyes"] = [list(camera.eye) for camera in moved]
        return config, garment, tuple(moved), drawn

    def describe(self) -> dict[str, Any]:
        """The version and the ranges, as an episode records them."""
        return {"version": self.version, "ranges": {k: v and list(v) for k, v in dataclasses.asdict(self).items()}}


def _between(bounds: Range, share: float, logarithmic: bool = False) -> float:
    low, high = bounds
    return float(low * (high / low) ** share if logarithmic else low + share * (high - low))


def _moved(camera: Camera, distance: float, turn: float, tilt: float) -> Camera:
    """The camera moved on the sphere about the place it looks at; it is never raised to the zenith."""
    x, y, z = np.subtract(camera.eye, camera.target)
    radius = distance * float(np.sqrt(x * x + y * y + z * z))
    azimuth = np.arctan2(y, x) + turn
    elevation = np.clip(np.arctan2(z, np.hypot(x, y)) + tilt, -1.5, 1.5)
    flat = np.cos(elevation)
    eye = camera.target + radius * np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
    return dataclasses.replace(camera, eye=tuple(eye.tolist()))
