"""Where the grippers go: minimum-jerk splines through via points, then letting go.

Idea: people's reaching movements minimise the integral of squared jerk. Through given places at given times, at rest at both
ends, the minimiser is the quintic spline of four continuous derivatives; between two rests it is
start + (10 s^3 - 15 s^4 + 6 s^5) (end - start) with s the share of the time.

Source: Flash and Hogan 1985, *The coordination of arm movements*; Antonova et al. 2021, section 6. Taught in chapter 7.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import make_interp_spline

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Via:
    """A place on a path. At the first and the last one the grippers stand still anyway."""

    time: float  #: seconds since the first frame
    place: ArrayLike  #: (3,) of the middle between the grippers, metres
    opening: float = 1.0  #: distance between the grippers as a multiple of the one at the start
    rest: bool = False  #: whether the grippers stand still there


@dataclass(frozen=True, eq=False)
class GripperPath:
    """The path of two grippers, and when they let go."""

    vias: Sequence[Via]  #: two at least, in the order of time; before and after them the grippers stand still
    spread: Array  #: (2, 3) the grippers relative to their middle, at an opening of 1
    release: float  #: seconds; when they let go
    end: float  #: seconds; how long an episode lasts that gives the garment time to come to rest

    def __post_init__(self) -> None:
        if len(self.vias) < 2:
            raise ValueError(f"a path needs two places at least, not {len(self.vias)}")
        places, times, spread = self._places, self._times, np.asarray(self.spread)
        if not np.isfinite(places).all() or places.shape[1] != 4:
            raise ValueError(f"the places of a path must be (3,) and finite, its openings finite: {list(self.vias)}")
        if not (np.isfinite(times).all() and (np.diff(times) > 0).all()):
            raise ValueError(f"the times of a path must increase, not {times.tolist()}")
        if places[:, 3].min() <= 0:
            raise ValueError(f"openings must be more than zero, not {places[:, 3].tolist()}")
        if spread.shape != (2, 3) or not np.isfinite(spread).all():
            raise ValueError(f"spread must be a finite (2, 3) array, not of shape {spread.shape}")
        if not self.end >= self.release >= 0:
            raise ValueError(f"the release ({self.release} s) must lie between 0 and the end ({self.end} s)")

    def at(self, time: ArrayLike) -> Array:
        """(..., 2, 3) where the two grippers should be at these times (...)."""
        t, times, places = np.asarray(time, dtype=np.float64), self._times, self._places
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
        return np.asarray(value[..., None, :3] + value[..., None, 3:] * self.spread)

    @functools.cached_property
    def _times(self) -> Array:
        return np.array([via.time for via in self.vias], dtype=np.float64)

    @functools.cached_property
    def _places(self) -> Array:
        """(k, 4) middle and opening."""
        return np.array([[*np.asarray(via.place, dtype=np.float64), via.opening] for via in self.vias])

    @functools.cached_property
    def _derivatives(self) -> tuple[Array, Array]:
        """(k, 4) velocities and accelerations at the places: 0 at a rest, the minimum-jerk spline's between two rests."""
        velocities, accelerations = np.zeros_like(self._places), np.zeros_like(self._places)
        still = ([(1, np.zeros(4)), (2, np.zeros(4))],) * 2
        rests = [0, *(i for i in range(1, len(self.vias) - 1) if self.vias[i].rest), len(self.vias) - 1]
        for first, last in itertools.pairwise(rests):
            if last - first > 1:
                stroke = slice(first, last + 1)
                spline = make_interp_spline(self._times[stroke], self._places[stroke], k=5, bc_type=still)
                inner = slice(first + 1, last)
                velocities[inner] = spline(self._times[inner], 1)
                accelerations[inner] = spline(self._times[inner], 2)
        return velocities, accelerations
