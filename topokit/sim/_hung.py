"""The path of a garment that is no pattern of ours: planned for its loop as it hangs between the grippers.

Idea: how a loop lies on a mesh shows little of how it will hang. Ear loops that point backwards hang sideways, and a strap that
was modelled upright falls. So the garment is held still for a moment in a world of its own. Of its loops as they hang there, the
one whose opening an arm enters with least effort is carried to it, with its normal along the arm and its rim over the tip.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np

from topokit._geometry import angle, turned
from topokit._opening import Opening, lies_flat

from ._cloth import usual_config
from ._garments import Garment
from ._names import kind, to_hang_by
from ._path import GripperPath, Via, drawn_about
from ._surface import Array
from ._targets import Target
from ._world import World, check_stretch

_CHECKS = 5  # steps between two checks of the stretch
_ROOM = 0.015  # metres of air that the arm needs in an opening
_NECK = 0.1  # metres that a neck may be farther from the grips than another loop


class Choice(NamedTuple):
    """A loop that is to hang, as the garment hangs between the grippers."""

    name: str
    opening: Opening  # relative to the middle between the grips; its normal is the arm's direction, from pole to tip
    effort: float  # metres


@functools.lru_cache(maxsize=4)
def hung(garment: Garment) -> Array:
    """Return the vertices (N, 3) of a garment that hangs still, relative to the middle between its grips.

    Self-collision is off, so that the result is the same anywhere in a program.
    """
    config = usual_config(garment, self_collision=False)
    grips = garment.vertices[garment.grips]
    middle = grips.mean(axis=0)
    up = np.array([0, 0, 1 + np.ptp(garment.vertices[:, 2])])  # above the floor
    with World(garment, up - middle, config) as world:
        for step in range(round(config.settle / config.dt)):
            if step % _CHECKS == 0 and step:
                check_stretch(garment, config, world.vertices(), "settling")
            world.step(grips - middle + up)
        return world.vertices() - up


def choose(garment: Garment, target: Target) -> Choice | None:
    """Return the loop that goes over the target's arm with least effort, or None when the arm fits into none."""
    shape = hung(garment)
    radius = target.rods[0][2]
    out, reach = _arm(target)
    half = abs(float(np.ptp(shape[garment.grips, 0]))) / 2
    choices = []
    for name in to_hang_by(garment.loop_names):
        curve = shape[garment.named_loops[name]]
        opening = Opening.of(curve)
        if opening is None or lies_flat(curve) or opening.size.min() < 2 * radius + _ROOM:
            continue
        # The rim shall be near the grips, the arm's way through the opening free, and the turn small.
        nearest = [np.clip(opening.rim[0], -half, half), 0, 0]
        far = float(np.linalg.norm(opening.rim - nearest)) - _NECK * (kind(name) == "neck")
        for side in (opening, opening.along(-opening.normal)):
            turn = abs(angle(side.normal, out))
            choices.append(Choice(name, side, far + turn / 1800 + 0.002 * side.blocked(shape, reach / 2)))
    return min(choices, key=lambda choice: choice.effort, default=None)


def hang_by_opening(garment: Garment, target: Target, choice: Choice, rng: np.random.Generator) -> GripperPath:
    """Return the path that carries the rim of the chosen loop over the tip, along the arm, and down to the seat."""
    shape = hung(garment)
    line = target.centre_line
    tip = line[-1]
    seat = target.seat
    radius = target.rods[0][2]
    out, _ = _arm(target)
    opening = choice.opening
    yaw = angle(opening.normal, out)
    rim = turned(_fallen(opening, *shape[garment.grips]), yaw)
    # The tip goes through the middle of the opening, as far as there is room.
    clear = radius + float(np.clip((opening.size[0] - tip[2] + line[-2][2]) / 2 - radius, 0.015, 0.06))
    height = tip[2] + clear
    ahead = -float(((shape - opening.rim) @ opening.normal).min())
    # Stations of the rim: far before the tip, before it, above the seat. Then the grippers go down to the seat themselves.
    start = drawn_about(rng, tip + (0.37 + ahead) * out + [0, 0, clear], (-0.1, 0.1), (-0.05, 0.05), (-0.08, 0.08))
    before = drawn_about(rng, tip + 0.13 * out + [0, 0, clear], (-0.01, 0.01), (-0.02, 0.02), (-0.005, 0.005))
    over = drawn_about(rng, [*seat[:2], height], (-0.01, 0.01), (-0.01, 0.01), (0, 0))
    middle = drawn_about(rng, (start + before) / 2, (-0.05, 0.05), (-0.03, 0.03), (-0.04, 0.04))
    stations = [start - rim, middle - rim, before - rim, over - rim]
    down = [*stations[-1][:2], min(seat[2] + radius + 0.005, stations[-1][2])]
    timed = zip((0.1, 0.8, 1.4), stations, strict=False)
    vias = [Via(time, place, yaw=yaw) for time, place in timed]
    vias += [Via(2.2, stations[-1], rest=True, yaw=yaw), Via(2.8, down, yaw=yaw)]
    grips = garment.vertices[garment.grips]
    return GripperPath(vias, grips - grips.mean(axis=0), release=2.85, end=4.6)


def _fallen(opening: Opening, first: Array, second: Array) -> Array:
    """Return the rim (3,) for a path: a strap that stands out from the line between the grips may fall on the way.

    It then hangs below that line, as far as it stands out now. The path is high enough for both, and level between them.
    """
    rim = opening.rim
    line = second - first
    nearest = first + np.clip((rim - first) @ line / (line @ line), 0, 1) * line
    low = nearest[2] - float(np.linalg.norm(rim - nearest))
    drop = float(np.clip(rim[2] - low, 0, opening.size[0] / 4))
    return np.array([*((rim + nearest)[:2] / 2), rim[2] - drop])


def _arm(target: Target) -> tuple[Array, float]:
    """Return the level direction (3,) of the target's arm, from the pole to the tip, and its length in metres."""
    line = target.centre_line
    arm = (line[-2] - line[-3]) * [1, 1, 0]
    length = float(np.linalg.norm(arm))
    return arm / length, length
