"""Paths of two grippers: through given places at given times, at rest at both ends.

Idea: people's reaching movements minimise the integral of squared jerk. Through given places at given times, at rest at both
ends, the minimiser is the quintic spline of four continuous derivatives; between two rests it is
start + (10 s^3 - 15 s^4 + 6 s^5) (end - start) with s the share of the time.

Source: Flash and Hogan 1985, *The coordination of arm movements*. Taught in chapter 8.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import make_interp_spline

from ._surface import Array, turned


@dataclass(frozen=True)
class Via:
    """A place on a path. At the first and the last one the grippers stand still anyway."""

    time: float  #: seconds since the first frame
    place: ArrayLike  #: (3,) of the middle between the grippers, metres
    opening: float = 1.0  #: distance between the grippers as a multiple of the one at the start
    rest: bool = False  #: whether the grippers stand still there
    yaw: float = 0.0  #: degrees by which the grippers are turned about the vertical through their middle, x towards y


@dataclass(frozen=True, eq=False)
class GripperPath:
    """The path of two grippers, and when they let go."""

    vias: Sequence[Via]  #: two at least, in the order of time; before and after them the grippers stand still
    spread: Array  #: (2, 3) the grippers relative to their middle, at an opening of 1
    release: float  #: seconds; when they let go
    end: float  #: seconds; how long an episode lasts that gives the garment time to come to rest
    #: What was drawn for a path that is off its script, by name (`off_script`); an episode's physics records it.
    drawn: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if len(self.vias) < 2:
            raise ValueError(f"a path needs two places at least, not {len(self.vias)}")
        table, spread = self._table, np.asarray(self.spread)
        for name, values, shape in (("vias", table, (len(self.vias), 6)), ("spread", spread, (2, 3))):
            if values.shape != shape or not np.isfinite(values).all():
                raise ValueError(f"{name} must be finite numbers of shape {shape}, not {values.tolist()}")
        if not ((np.diff(table[:, 0]) > 0).all() and (table[:, 4] > 0).all()):
            raise ValueError(f"times must increase and openings be more than zero: {self.vias}")
        if not self.end >= self.release >= 0:
            raise ValueError(f"the end ({self.end} s) must come after the release ({self.release} s), and that after 0")

    def at(self, time: ArrayLike) -> Array:
        """(..., 2, 3) where the two grippers should be at these times (...)."""
        t, times, places = np.asarray(time, dtype=np.float64), self._table[:, 0], self._table[:, 1:]
        velocities, accelerations = self._derivatives
        i = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
        h = (times[i + 1] - times[i])[..., None]
        s = np.clip((t - times[i])[..., None] / h, 0, 1)
        cube = s * s * s
        # Quintic Hermite interpolation: place, velocity and acceleration at either end.
        value = places[i] + cube * (10 - 15 * s + 6 * s * s) * (places[i + 1] - places[i])
        value = value + h * (s - cube * (6 - 8 * s + 3 * s * s)) * velocities[i]
        value = value - h * cube * (4 - 7 * s + 3 * s * s) * velocities[i + 1]
        value = value + h * h / 2 * (s * s - cube * (3 - 3 * s + s * s)) * accelerations[i]
        value = value + h * h / 2 * cube * (1 - 2 * s + s * s) * accelerations[i + 1]
        spread = np.stack([turned(one, value[..., 4]) for one in self.spread], -2)
        return np.asarray(value[..., None, :3] + value[..., None, 3:4] * spread)

    def moved(self, place: ArrayLike, yaw: float) -> GripperPath:
        """Return the path turned about the z axis, by degrees from x towards y, and then moved.

        Parameters
        ----------
        place : (3,) array_like
            Where the origin goes, metres.
        yaw : float
        """
        origin = np.asarray(place, dtype=np.float64)
        vias = [replace(via, place=turned(via.place, yaw) + origin, yaw=via.yaw + yaw) for via in self.vias]
        return replace(self, vias=vias)

    @property
    def widest(self) -> float:
        """How far the grippers are apart at most, metres."""
        one, other = np.moveaxis(self.at(np.arange(0, self.end, 0.02)), -2, 0)
        return float(np.linalg.norm(one - other, axis=-1).max())

    @functools.cached_property
    def _table(self) -> Array:
        """(k, 6) times, middles, openings, yaws."""
        return np.array([[v.time, *np.asarray(v.place), v.opening, v.yaw] for v in self.vias], dtype=np.float64)

    @functools.cached_property
    def _derivatives(self) -> tuple[Array, Array]:
        """(k, 5) velocities and accelerations at the places: 0 at a rest, the minimum-jerk spline's between two rests."""
        times, places = self._table[:, 0], self._table[:, 1:]
        velocities, accelerations = np.zeros_like(places), np.zeros_like(places)
        still = ([(1, np.zeros(places.shape[1])), (2, np.zeros(places.shape[1]))],) * 2
        rests = [0, *(i for i in range(1, len(self.vias) - 1) if self.vias[i].rest), len(self.vias) - 1]
        for first, last in itertools.pairwise(rests):
            if last - first > 1:
                stroke = slice(first, last + 1)
                spline = make_interp_spline(times[stroke], places[stroke], k=5, bc_type=still)
                inner = slice(first + 1, last)
                velocities[inner], accelerations[inner] = spline(times[inner], 1), spline(times[inner], 2)
        return velocities, accelerations
