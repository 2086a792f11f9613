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
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._geometry import turned

from ._garments import Garment
from ._surface import Array, EdgeGraph
from ._targets import Target, gap

# A place on a path as a row of a table; the fields are those of `Via`.
_ROW = np.dtype([("time", "f8"), ("place", "f8", 3), ("opening", "f8"), ("yaw", "f8"), ("rest", "?")])
Table = NDArray[Any]


class Via(NamedTuple):
    """A place on a path. At the first and the last place the grippers always stand still."""

    time: float  # seconds since the first frame
    place: ArrayLike  # (3,) the middle between the grippers, metres
    opening: float = 1.0  # distance between the grippers as a multiple of their distance at the start
    yaw: float = 0.0  # degrees by which the grippers are turned about the vertical through their middle, x towards y
    rest: bool = False  # whether the grippers stand still there


@dataclass(frozen=True, eq=False)
class GripperPath:
    """The path of two grippers, and the time when they let go."""

    vias: Sequence[Via] | Table  #: at least two places, in the order of time; kept as a table of rows
    spread: Array  #: (2, 3) places of the grippers relative to their middle, at an opening of 1, metres
    release: float  #: seconds until the grippers let go
    end: float  #: seconds until the episode ends, long enough for the garment to come to rest
    #: The draws of `off_script` by their names; they are recorded in an episode's physics. Empty for a path on its script.
    drawn: Mapping[str, float] = field(default_factory=dict)

    @functools.cached_property
    def table(self) -> Table:
        """Return the places as a structured array: time, place, opening, yaw and rest of each."""
        return np.array(self.vias, dtype=_ROW)

    def at(self, time: ArrayLike) -> Array:
        """Return the places (..., 2, 3) of the two grippers at some times (...).

        `scipy.interpolate.BPoly.from_derivatives` gives the same places to 9e-16 m. Cloth is chaotic, so that this rounding would
        change recorded episodes by up to 0.3 mm. Therefore the sum is written out.
        """
        t = np.asarray(time, dtype=np.float64)
        times, places, velocities, accelerations = self._spline
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

    def placed(self, target: Target) -> GripperPath:
        """Return the path turned and moved as a target is."""
        table = self.table.copy()
        table["place"] = target.placed(table["place"])
        table["yaw"] += target.yaw
        return replace(self, vias=table)

    @property
    def widest(self) -> float:
        """Return the largest distance between the grippers, metres."""
        first, second = np.moveaxis(self.at(np.arange(0, self.end, 0.02)), -2, 0)
        return float(np.linalg.norm(first - second, axis=-1).max())

    @functools.cached_property
    def _spline(self) -> tuple[Array, Array, Array, Array]:
        """Return the times (k,), and rows (k, 5) of middle, opening and yaw: places, velocities and accelerations."""
        from scipy.interpolate import make_interp_spline  # a process that only records starts sooner without it

        table = self.table
        times = table["time"].copy()
        places = np.column_stack([table["place"], table["opening"], table["yaw"]])
        velocities = np.zeros_like(places)
        accelerations = np.zeros_like(places)
        # Each part from one rest to the next has a spline of its own, with velocity and acceleration 0 at both ends.
        still = ([(1, np.zeros(5)), (2, np.zeros(5))],) * 2
        rests = [0, *(np.flatnonzero(table["rest"][1:-1]) + 1), len(table) - 1]
        for first, last in itertools.pairwise(rests):
            if last - first > 1:
                stroke = slice(first, last + 1)
                spline = make_interp_spline(times[stroke], places[stroke], k=5, bc_type=still)
                inner = slice(first + 1, last)
                velocities[inner] = spline(times[inner], 1)
                accelerations[inner] = spline(times[inner], 2)
        return times, places, velocities, accelerations


def drawn_about(rng: np.random.Generator, place: ArrayLike, *ranges: tuple[float, float]) -> Array:
    """Return a place (3,) moved along each axis by a draw from its range, in metres."""
    return np.asarray(place + rng.uniform(*np.transpose(ranges)))


def off_script(path: GripperPath, garment: Garment, target: Target, rng: np.random.Generator) -> GripperPath:
    """Return a path that differs from the script, which was planned for the garment and the target before it is placed.

    One path in seven wanders about the target, and one in ten pushes the cloth against it. The others follow the script at
    another pace, with changes: a miss, other openings, a detour, a stop, another start and yaw, another release or none.
    """
    table = path.table.copy()
    drawn: dict[str, float] = {}
    kind = rng.random()
    longest = max(4.5, path.end)  # seconds of an episode
    # The grippers are so high that the cloth is 5 cm above the floor.
    drop = float(garment.vertices[garment.grips, 2].mean() - garment.vertices[:, 2].min()) + 0.05
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
        table["place"][approach:] += shift
        table["yaw"][approach:] += turn
        drawn["miss"] = float(np.linalg.norm(shift))
        drawn["turn"] = turn
    if rng.random() < 0.5:
        drawn["openings"] = 1.0
        table["opening"][1:] *= rng.uniform(0.6, 1.4, len(table) - 1)
    # Take a detour: insert a place, and do what follows a quarter of a second later.
    if rng.random() < 0.3:
        i = int(rng.integers(1, len(table)))
        aside = rng.normal(0, 0.1, 3)
        time = (table["time"][i - 1] + table["time"][i] + 0.25) / 2
        place, opening, yaw = ((table[name][i - 1] + table[name][i]) / 2 for name in ("place", "opening", "yaw"))
        table["time"][i:] += 0.25
        table = np.insert(table, i, np.array(Via(time, place + aside, opening, yaw), dtype=_ROW))
        drawn["detour"] = float(np.linalg.norm(aside))
    if rng.random() < 0.25:
        i = int(rng.integers(1, len(table)))
        drawn["stop"] = float(table["time"][i])
        table["rest"][i] = True
        table = np.insert(table, i, table[i])
        table["time"][i + 1 :] += 0.3
    if rng.random() < 0.6:
        drawn["elsewhere"] = _start_elsewhere(table, garment, target, rng)
    # Draw the pace, and the time of the release: as scripted, early, late, or never.
    drawn["pace"] = min(float(0.7 * 2 ** rng.random()), (longest - 0.4) / float(table["time"][-1]))
    table["time"] *= drawn["pace"]
    last = float(table["time"][-1])
    releases = (last + 0.05, rng.uniform(0.35, 1) * last, last + rng.uniform(0.2, 0.7), longest)
    release = float(releases[int(rng.choice(4, p=(0.35, 0.3, 0.15, 0.2)))])
    end = min(longest, max(3.0, release + path.end - path.release))
    drawn["release"] = end if release == longest else min(release, longest - 0.25)
    # Shrink the openings until the grippers do not tear the cloth (2 % longer is taut), or are as near as in the script.
    along_cloth = float(EdgeGraph(garment.vertices, garment.edges).distances(garment.grips)[0, 1])
    most = max(1.02 * along_cloth, path.widest)
    while True:
        changed = GripperPath(table, path.spread, release=drawn["release"], end=end, drawn=drawn)
        if changed.widest <= most:
            return changed
        table["opening"][1:] = table["opening"][1:] * 0.99 * most / changed.widest


def _wander(start: Any, seat: Array, drop: float, rng: np.random.Generator) -> Table:
    """Return a table of random places around the seat, high enough for the garment to clear the floor."""
    low = max(float(seat[2]) - 0.1, drop)
    vias = [Via(*start)]
    for _ in range(int(rng.integers(3, 6))):
        before = vias[-1]
        place = np.array([*rng.uniform((-0.35, -0.5), (0.35, 0.15)), 0]) + [seat[0], seat[1], low + rng.uniform(0, 0.4)]
        time = before.time + 0.3 + float(np.linalg.norm(place - before.place)) / rng.uniform(0.6, 1.2)
        vias.append(Via(time, place, yaw=before.yaw + rng.normal(0, 40)))
    return np.array(vias, dtype=_ROW)


def _push(start: Any, seat: Array, drop: float, rng: np.random.Generator) -> Table:
    """Return a table of a straight path that pushes the cloth against the target; half of them come back again."""
    x, beyond, z = rng.uniform((-0.15, -0.05, 0.0), (0.15, 0.2, 0.25))
    times = np.cumsum([start["time"] + 1.0, (beyond + 0.35) / rng.uniform(0.35, 0.8) + 0.2, 0.9])
    ahead = (seat[1] - 0.35, seat[1] + beyond, seat[1] - 0.35)
    vias = [Via(time, [x, y, max(seat[2] + z, drop)]) for time, y in zip(times, ahead, strict=True)]
    return np.array([Via(*start), *vias[: rng.integers(2, 4)]], dtype=_ROW)


def _start_elsewhere(table: Table, garment: Garment, target: Target, rng: np.random.Generator) -> float:
    """Change the start of a table to a free place before or beside the target, at any yaw; return its distance from the seat.

    The cloth is then 5 cm or more above the floor, and 30 cm or more from the rods. The distance is 0 when none is found.
    """
    cloth = garment.vertices - garment.vertices[garment.grips].mean(axis=0)
    start = table[0]
    after = table[1]
    for _ in range(30):
        yaw = float(rng.uniform(-180, 180))
        distance = float(rng.uniform(0.5, 1.0))
        place = target.seat + turned([0, -distance, 0], rng.uniform(-100, 100))
        place[2] = start["place"][2] + rng.uniform(-0.15, 0.15)
        cloth_there = turned(cloth, yaw) + place
        if cloth_there[:, 2].min() > 0.05 and gap(cloth_there, target) > 0.3:
            # A start that is farther off or turned by more leaves more time for the way to the second place.
            seconds = max(float(np.linalg.norm(place - after["place"])), abs(yaw - after["yaw"]) / 120)
            table["time"][1:] += max(0.0, seconds - after["time"] + start["time"])
            start["place"] = place
            start["yaw"] = yaw
            return distance
    return 0.0
