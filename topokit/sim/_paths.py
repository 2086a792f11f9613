"""Where the grippers go: minimum-jerk splines through via points, then letting go.

Idea: people's reaching movements minimise the integral of squared jerk. Through given places at given times, at rest at both
ends, the minimiser is the quintic spline of four continuous derivatives; between two rests it is
start + (10 s^3 - 15 s^4 + 6 s^5) (end - start) with s the share of the time.

Source: Flash and Hogan 1985, *The coordination of arm movements*; Antonova et al. 2021, section 6 (randomised trajectories of
two anchors). Taught in chapter 7.
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
    """A place on a path.

    Parameters
    ----------
    time : float
        Seconds since the first frame.
    place : (3,) array_like
        Of the middle between the grippers, metres.
    opening : float
        Distance between the grippers as a multiple of the one at the start.
    rest : bool
        Whether the grippers stand still there; the first and the last place of a path are rests anyway.
    """

    time: float
    place: ArrayLike
    opening: float = 1.0
    rest: bool = False


@dataclass(frozen=True, eq=False)
class GripperPath:
    """The path of two grippers, and when they let go.

    Parameters
    ----------
    vias : sequence of Via
        Two at least, in the order of time. Before the first and after the last the grippers stand still.
    spread : (2, 3) float64
        The grippers relative to their middle, at an opening of 1.
    release : float
        Seconds; when they let go.
    end : float
        Seconds; how long an episode lasts that gives the garment time to come to rest.

    Raises
    ------
    ValueError
        When there are fewer than two places, times do not increase, an opening is not positive, or a number is not finite.

    Examples
    --------
    >>> path = GripperPath([Via(0, [0, 0, 1]), Via(2, [0, 0.4, 1])], np.array([[-0.1, 0, 0], [0.1, 0, 0]]), 2.1, 3.0)
    >>> path.at(1.0).tolist()
    [[-0.1, 0.2, 1.0], [0.1, 0.2, 1.0]]
    """

    vias: Sequence[Via]
    spread: Array
    release: float
    end: float

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
            raise ValueError(
                f"the end ({self.end} s) must come after the release ({self.release} s), and that not before 0"
            )

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
