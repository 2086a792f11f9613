"""Paths of two grippers: through given places at given times, at rest at both ends.

Idea: people's reaching movements minimise the integral of squared jerk. The minimiser through the places is the quintic spline
with four continuous derivatives. Between two rests it is start + (10 s^3 - 15 s^4 + 6 s^5) (end - start), where s is the share
of the time that is over.

Films of plans that succeed do not show how the cloth moves under other plans. So `off_script` changes a path as hands do that
miss, hesitate, take a detour, let go too early, push, or wander. Each change has its own probability, and several can come
together; the draws are noted in `GripperPath.drawn`.

Source: Flash and Hogan 1985, *The coordination of arm movements*. Taught in chapter 10.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import make_interp_spline

from topokit._geometry import turned

from ._garments import Garment
from ._surface import Array, EdgeGraph
from ._targets import Target, gap

_CLEAR = 0.3  # metres: the least distance of the cloth from the rods at a start
_ABOVE = 0.05  # metres: the least distance of the cloth from the floor at a start
_TAUT = 1.02  # the largest distance between the grippers, as a multiple of their distance along the cloth
# Columns of the table that `off_script` changes.
_TIME = 0
_PLACE = slice(1, 4)
_OPENING = 4
_YAW = 5
_REST = 6


@dataclass(frozen=True)
class Via:
    """A place on a path. At the first and the last place the grippers always stand still."""

    time: float  #: seconds since the first frame
    place: ArrayLike  #: (3,) the middle between the grippers, metres
    opening: float = 1.0  #: distance between the grippers as a multiple of their distance at the start
    rest: bool = False  #: whether the grippers stand still there
    yaw: float = 0.0  #: degrees by which the grippers are turned about the vertical through their middle, x towards y

    def __post_init__(self) -> None:
        if np.shape(self.place) != (3,):
            raise ValueError(f"place must be three numbers, x, y and z in metres, not {self.place!r:.80}")


@dataclass(frozen=True, eq=False)
class GripperPath:
    """The path of two grippers, and the time when they let go."""

    LONGEST = 4.5  # seconds that an episode off its script lasts at most, unless the script lasts longer

    vias: Sequence[Via]  #: at least two places, in the order of time; before and after them the grippers stand still
    spread: Array  #: (2, 3) places of the grippers relative to their middle, at an opening of 1, metres
    release: float  #: seconds until the grippers let go
    end: float  #: seconds until the episode ends, long enough for the garment to come to rest
    #: The draws of `off_script` by their names; they are recorded in an episode's physics. Empty for a path on its script.
    drawn: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if len(self.vias) < 2:
            raise ValueError(f"vias must hold at least two places, not {len(self.vias)}")
        table = self._table
        checks = (("vias", table, (len(self.vias), 6)), ("spread", np.asarray(self.spread), (2, 3)))
        for name, values, shape in checks:
            if values.shape != shape or not np.isfinite(values).all():
                raise ValueError(f"{name} must be finite numbers of shape {shape}, not {values.tolist()}")
        if not ((np.diff(table[:, 0]) > 0).all() and (table[:, 4] > 0).all()):
            raise ValueError(f"the times of vias must increase and their openings be above 0: {self.vias}")
        if not self.end >= self.release >= 0:
            raise ValueError(
                f"release must be 0 or later and end not before release, but release is {self.release} s and end {self.end} s"
            )

    def at(self, time: ArrayLike) -> Array:
        """Return the places (..., 2, 3) of the two grippers at some times (...).

        `scipy.interpolate.BPoly.from_derivatives` gives the same places to 9e-16 m. Cloth is chaotic, so that this rounding would
        change recorded episodes by up to 0.3 mm. Therefore the sum is written out.
        """
        t = np.asarray(time, dtype=np.float64)
        times = self._table[:, 0]
        places = self._table[:, 1:]
        velocities, accelerations = self._derivatives
        # Find the segment i of the path at each time, its duration h, and the share s of the duration that is over.
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
        # The grippers stand at their opening on either side of the middle, turned by the yaw.
        spread = np.stack([turned(gripper, value[..., 4]) for gripper in self.spread], -2)
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
        """Return the largest distance between the grippers, metres."""
        first, second = np.moveaxis(self.at(np.arange(0, self.end, 0.02)), -2, 0)
        return float(np.linalg.norm(first - second, axis=-1).max())

    @functools.cached_property
    def _table(self) -> Array:
        """Return the places of the path as rows (k, 6): time, middle, opening, yaw."""
        rows = [[via.time, *np.asarray(via.place), via.opening, via.yaw] for via in self.vias]
        return np.array(rows, dtype=np.float64)

    @functools.cached_property
    def _derivatives(self) -> tuple[Array, Array]:
        """Return the velocities (k, 5) and accelerations (k, 5) at the places: 0 at a rest, else those of the spline."""
        times = self._table[:, 0]
        places = self._table[:, 1:]
        velocities = np.zeros_like(places)
        accelerations = np.zeros_like(places)
        # Each part from one rest to the next has a spline of its own, with velocity and acceleration 0 at both ends.
        still = ([(1, np.zeros(places.shape[1])), (2, np.zeros(places.shape[1]))],) * 2
        rests = [0, *(i for i in range(1, len(self.vias) - 1) if self.vias[i].rest), len(self.vias) - 1]
        for first, last in itertools.pairwise(rests):
            if last - first > 1:
                stroke = slice(first, last + 1)
                spline = make_interp_spline(times[stroke], places[stroke], k=5, bc_type=still)
                inner = slice(first + 1, last)
                velocities[inner] = spline(times[inner], 1)
                accelerations[inner] = spline(times[inner], 2)
        return velocities, accelerations


def drawn_about(rng: np.random.Generator, place: ArrayLike, *ranges: tuple[float, float]) -> Array:
    """Return a place (3,) moved along each axis by a draw from its range, in metres."""
    return np.asarray(place + rng.uniform(*np.transpose(ranges)))


def off_script(path: GripperPath, garment: Garment, target: Target, rng: np.random.Generator) -> GripperPath:
    """Return a path that differs from the script.

    One path in seven wanders about the target, and one in ten pushes the cloth against it. The others follow the script at
    another pace, with some of these changes: a miss, other openings, a detour, a stop, another start and yaw. The release may
    be early, late, or never.

    Parameters
    ----------
    path : GripperPath
        The script, planned for the garment and the target.
    garment : Garment
    target : Target
        The target in the coordinates of the script.
    rng : numpy.random.Generator
    """
    table = _table(path)
    drawn: dict[str, float] = {}
    kind = rng.random()
    longest = max(path.LONGEST, path.end)
    drop = float(garment.vertices[garment.grips, 2].mean() - garment.vertices[:, 2].min()) + _ABOVE
    # Wander, push, miss, or follow the script.
    if kind < 0.15:
        drawn["wander"] = 1.0
        table = _wander(table[0], target.seat, drop, rng)
    elif kind < 0.25:
        drawn["push"] = 1.0
        table = _push(table[0], target.seat, drop, rng)
    elif kind < 0.65:
        approach = max(1, len(table) - 3)
        shift = rng.normal(0, 0.08, 3)
        turn = float(rng.normal(0, 15))
        table[approach:, _PLACE] += shift
        table[approach:, _YAW] += turn
        drawn["miss"] = float(np.linalg.norm(shift))
        drawn["turn"] = turn
    # Change the openings along the path.
    if rng.random() < 0.5:
        drawn["openings"] = 1.0
        table[1:, _OPENING] *= rng.uniform(0.6, 1.4, len(table) - 1)
    # Take a detour: insert a place, and do what follows a quarter of a second later.
    if rng.random() < 0.3:
        i = int(rng.integers(1, len(table)))
        aside = rng.normal(0, 0.1, 3)
        between = (table[i - 1] + table[i] + [0.25, 0, 0, 0, 0, 0, 0]) / 2 + [0, *aside, 0, 0, 0]
        between[_REST] = 0
        table[i:, _TIME] += 0.25
        drawn["detour"] = float(np.linalg.norm(aside))
        table = np.insert(table, i, between, axis=0)
    # Stop at a place for 0.3 s.
    if rng.random() < 0.25:
        i = int(rng.integers(1, len(table)))
        drawn["stop"] = float(table[i, _TIME])
        table[i, _REST] = 1
        table = np.insert(table, i, table[i], axis=0)
        table[i + 1 :, _TIME] += 0.3
    if rng.random() < 0.6:
        drawn["elsewhere"] = _elsewhere(table, garment, target, rng)
    # Draw the pace, and the time of the release: as scripted, early, late, or never.
    drawn["pace"] = min(float(0.7 * 2 ** rng.random()), (longest - 0.4) / float(table[-1, _TIME]))
    table[:, _TIME] *= drawn["pace"]
    last = float(table[-1, _TIME])
    releases = (last + 0.05, rng.uniform(0.35, 1) * last, last + rng.uniform(0.2, 0.7), longest)
    release = float(releases[int(rng.choice(4, p=(0.35, 0.3, 0.15, 0.2)))])
    end = min(longest, max(3.0, release + path.end - path.release))
    drawn["release"] = end if release == longest else min(release, longest - 0.25)
    # Shrink the openings until the grippers do not tear the cloth, or are as near as in the script.
    along_cloth = float(EdgeGraph(garment.vertices, garment.edges).distances(garment.grips)[0, 1])
    most = max(_TAUT * along_cloth, path.widest)
    while True:
        changed = replace(path, vias=_vias(table), release=drawn["release"], end=end, drawn=drawn)
        if changed.widest <= most:
            return changed
        table[1:, _OPENING] = table[1:, _OPENING] * 0.99 * most / changed.widest


def from_elsewhere(path: GripperPath, garment: Garment, target: Target, rng: np.random.Generator) -> GripperPath:
    """Return the script with another start at any yaw; unchanged when no free place is found."""
    table = _table(path)
    _elsewhere(table, garment, target, rng)
    later = float(table[-1, _TIME]) - path.vias[-1].time
    return replace(path, vias=_vias(table), release=path.release + later, end=path.end + later)


def _table(path: GripperPath) -> Array:
    """Return the places of a path as rows (k, 7): time, middle, opening, yaw, rest."""
    rows = [[via.time, *np.asarray(via.place), via.opening, via.yaw, via.rest] for via in path.vias]
    return np.array(rows, dtype=np.float64)


def _vias(table: Array) -> list[Via]:
    """Return the places of a path, given its table."""
    return [Via(row[_TIME], row[_PLACE], row[_OPENING], bool(row[_REST]), row[_YAW]) for row in table]


def _wander(start: Array, seat: Array, drop: float, rng: np.random.Generator) -> Array:
    """Return a table of random places around the seat, high enough for the garment to clear the floor."""
    low = max(float(seat[2]) - 0.1, drop)
    rows = [start]
    for _ in range(int(rng.integers(3, 6))):
        place = np.array([*rng.uniform((-0.35, -0.5), (0.35, 0.15)), 0]) + [seat[0], seat[1], low + rng.uniform(0, 0.4)]
        time = rows[-1][_TIME] + 0.3 + float(np.linalg.norm(place - rows[-1][_PLACE])) / rng.uniform(0.6, 1.2)
        rows.append(np.array([time, *place, 1, rows[-1][_YAW] + rng.normal(0, 40), 0]))
    return np.array(rows)


def _push(start: Array, seat: Array, drop: float, rng: np.random.Generator) -> Array:
    """Return a table of a straight path that pushes the cloth against the target; half of them come back again."""
    x, beyond, z = rng.uniform((-0.15, -0.05, 0.0), (0.15, 0.2, 0.25))
    times = np.cumsum([start[_TIME] + 1.0, (beyond + 0.35) / rng.uniform(0.35, 0.8) + 0.2, 0.9])
    ahead = (seat[1] - 0.35, seat[1] + beyond, seat[1] - 0.35)
    rows = [[time, x, y, max(seat[2] + z, drop), 1, 0, 0] for time, y in zip(times, ahead, strict=True)]
    return np.array([start, *rows[: rng.integers(2, 4)]])


def _elsewhere(table: Array, garment: Garment, target: Target, rng: np.random.Generator) -> float:
    """Change the start of a table to a free place before or beside the target, at any yaw.

    Return the distance of the start from the target's seat, or 0 when no free place is found.
    """
    cloth = garment.vertices - garment.vertices[garment.grips].mean(axis=0)
    for _ in range(30):
        yaw = float(rng.uniform(-180, 180))
        distance = float(rng.uniform(0.5, 1.0))
        place = target.seat + turned([0, -distance, 0], rng.uniform(-100, 100))
        place[2] = table[0, _PLACE][2] + rng.uniform(-0.15, 0.15)
        hanging = turned(cloth, yaw) + place
        if hanging[:, 2].min() > _ABOVE and gap(hanging, target) > _CLEAR:
            # A start that is farther off or turned by more leaves more time for the way to the second place.
            seconds = max(float(np.linalg.norm(place - table[1, _PLACE])), abs(yaw - table[1, _YAW]) / 120)
            table[1:, _TIME] += max(0.0, seconds - table[1, _TIME] + table[0, _TIME])
            table[0, _PLACE] = place
            table[0, _YAW] = yaw
            return distance
    return 0.0
