"""The loop servo: hang what is tracked, without a forecast.

Idea: in the frame of the grippers a hanging garment hardly changes. So a loop that was seen there a moment ago is still there,
and where its rim should be says where the grippers should be. The rim goes along a rail that the target's centre line gives: up
to the tip, over it, half the arm in, down. The grippers let go when the loop's cycle, as it is seen or carried along, has been
around the centre line for five frames; when it never is, they lift, back off, and try again.

Source: visual servoing is from Hutchinson, Hager and Corke 1996, *A tutorial on visual servo control*; that a linking number
tells what hangs is chapter 7's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._validate import as_reals, positive, whole
from topokit.sampling import as_tree
from topokit.seqph import SeqPH

from ._geometry import Arm, Array, Hands, Opening, drawn, heading, turned, wrapped

_LOOK = 6  # frames in which the loops are looked at before anything moves
SURE = 5  # frames in a row in which the loops must be around the target
_TRIES = 4
_PATIENCE = 60  # frames for a stop on the rail
_NEAR, _FACING = 0.025, 0.12  # metres and radians that are near enough to a stop
_NEW = 0.3  # weight of a new look at an opening
_SAME = 0.08  # metres between the rims of one loop in two frames, at most
_GAIN, _TURN = 0.15, 0.06  # share of what is missing that is made up for in a frame; radians in a frame, at most
_LEASH = 0.2  # metres by which a goal may lead its gripper


class _Stop(NamedTuple):
    """A place on the rail."""

    name: str
    before: float  # metres before the tip; if less than 0, in shares of the arm behind it
    pace: float  # share of the largest step


_RAIL = (
    _Stop("far", 0.35, 0.5),
    _Stop("near", 0.13, 0.3),
    _Stop("over", -0.5, 0.2),
    _Stop("down", -0.5, 0.2),
    _Stop("lift", -0.5, 0.2),
    _Stop("back", 0.13, 0.3),
)


@dataclass(eq=False)
class _Known:
    """A loop as it is remembered, in the frame of the grippers."""

    cycle: Array
    last: Array  # where it was when it was seen
    opening: Opening
    seen: int = 1  # frames
    around: int = 0  # frames in a row in which it was around the target


class Servo:
    """Hang a garment by its tracked loops, without a forecast: a `Controller`.

    Parameters
    ----------
    goal : optional
        Which loop shall hang. None: the one that is best to reach. Three numbers: the loop nearest to that place in the frame of
        the grippers at the start, x from the first to the second, z up, from midway between them, metres. A whole number: so
        many loops at once.
    radius : float
        Of the target's rods, metres.
    max_step : float
        Metres that a gripper's goal goes along an axis when an action says 1.
    """

    def __init__(self, goal: ArrayLike | None = None, *, radius: float = 0.02, max_step: float = 0.0432) -> None:
        self._place: Array | None = None
        self._count = 1
        if isinstance(goal, int):
            self._count = whole(goal, "goal", 1)
        elif goal is not None:
            self._place = as_reals(goal, "goal").astype(np.float64)
            if self._place.shape != (3,) or not np.isfinite(self._place).all():
                raise ValueError(f"goal must be None, a number of loops or a place of three numbers, not {goal!r}")
        self.radius, self.max_step = positive(radius, "radius"), positive(max_step, "max_step", zero=False)
        self.reason = ""

    def reset(self, observation: Mapping[str, Any]) -> None:
        """Forget everything; begin with a first observation.

        Parameters
        ----------
        observation : mapping
            As `topokit.sim.HangEnv` gives it.
        """
        self.reason = ""
        self._tracker = SeqPH()
        self._goals = np.asarray(observation["grippers"], np.float64)
        self._known: list[_Known] = []
        self._chosen: list[_Known] = []
        self._frame, self._stop, self._waited, self._tries = 0, 0, 0, 0

    def act(self, observation: Mapping[str, Any]) -> NDArray[np.float32]:
        """Return the next action (7,); none moves anything once there is a `reason` to give up.

        Parameters
        ----------
        observation : mapping
        """
        points, grippers, line = (np.asarray(observation[name], float) for name in ("points", "grippers", "target"))
        arm, hands = Arm.of(line), Hands.of(grippers)
        if arm is None:
            self.reason = "the target has no arm that runs sideways"
        if arm is None or self.reason or not observation["held"]:
            return np.zeros(7, np.float32)
        self._look(points, hands)
        self._frame += 1
        if not self._chosen and self._frame >= _LOOK:
            self._choose(arm, hands, hands.inside(points))
        if not self._chosen:
            return np.zeros(7, np.float32)
        for loop in self._chosen:
            loop.around = loop.around + 1 if arm.holds(hands.outside(loop.cycle)) else 0
        return self._along(arm, hands, grippers)

    # -- which loops there are, and which of them shall hang

    def _look(self, points: Array, hands: Hands) -> None:
        """Bring what is known of the loops up to date; one that is not seen goes with the grippers and the cloth about it."""
        unseen = list(self._known)
        for loop in self._tracker.update(np.unique(points, axis=0)).loops:
            cycle = hands.inside(loop.cycle_points)
            opening = Opening.of(cycle)
            if opening is None:
                continue
            same = min(unseen, key=lambda known: known.opening.gap(opening), default=None)
            if same is None or same.opening.gap(opening) > _SAME:
                self._known.append(_Known(cycle, cycle, opening))
                continue
            same.cycle = same.last = cycle
            same.opening, same.seen = same.opening.blended(opening, _NEW), same.seen + 1
            unseen.remove(same)
        cloth = as_tree(hands.inside(points))
        for known in unseen:
            known.cycle = drawn(known.cycle, known.last, cloth)
            known.opening = known.opening.blended(Opening.of(known.cycle) or known.opening, _NEW)

    def _choose(self, arm: Arm, hands: Hands, cloud: Array) -> None:
        """Choose the loops that shall hang, and the side of them that the arm shall come out of."""
        section = 2 * (arm.rise + 4 * self.radius)  # around the arm with its tip, at the least
        if self._count > 1:
            self._mirror()
        seen = [loop for loop in self._known if loop.seen > 1]
        fit = [loop for loop in seen if loop.opening.length >= section]
        if len(fit) < self._count:
            if self._frame < _PATIENCE:
                return
            largest = max((loop.opening.length for loop in seen), default=0.0)
            self.reason = f"{len(fit)} loops are seen that fit over the tip, and {self._count} are wanted"
            self.reason += f"; the longest is {largest:.2f} m around, and {section:.2f} m are needed" if seen else ""
            return

        def turn(opening: Opening) -> float:
            return abs(self._facing(opening.outside(hands), arm)) / np.pi + 0.2 * opening.blocked(cloud, arm.reach / 2)

        for loop in fit:
            loop.opening = min(loop.opening, loop.opening.flipped, key=turn)
        self._chosen = sorted(fit, key=lambda loop: self._distance(loop) + 0.1 * turn(loop.opening))[: self._count]
        lead, *others = self._chosen
        for loop in others:
            loop.opening = loop.opening if loop.opening.normal @ lead.opening.normal > 0 else loop.opening.flipped

    def _mirror(self) -> None:
        """Take it that a loop has a twin between the grippers where none is seen: of two handles often only one is."""
        for loop in list(self._known):
            twin = loop.opening.mirrored
            if min(known.opening.gap(twin) for known in self._known) > _SAME / 2:
                curve = loop.cycle * [-1, 1, 1]
                self._known.append(_Known(curve, curve, twin, loop.seen))

    def _distance(self, loop: _Known) -> float:
        """Metres from the place that was asked for, or of the rim from the line between the grippers, which bears the weight."""
        if self._place is not None:
            return float(np.linalg.norm(loop.cycle.mean(axis=0) - self._place))
        half, rim = float(np.linalg.norm(self._goals[1] - self._goals[0])) / 2, loop.opening.rim
        return float(np.linalg.norm(rim - [np.clip(rim[0], -half, half), 0, 0]))

    # -- where the grippers go

    def _along(self, arm: Arm, hands: Hands, grippers: Array) -> NDArray[np.float32]:
        """Bring the rim nearer to the stop, and the opening to face the arm; then comes the next stop."""
        stop, opening = _RAIL[self._stop], self._opening(arm, hands, grippers)
        gap, facing = self._goal(stop, arm, opening) - opening.rim, self._facing(opening, arm)
        there = float(np.linalg.norm(gap)) < _NEAR and abs(facing) < _FACING
        self._waited += 1
        if stop.name == "down":
            sure = min(loop.around for loop in self._chosen) >= SURE
            if sure and (there or self._waited > _PATIENCE // 2):
                return np.eye(7, dtype=np.float32)[6]
            there = False  # it may take a few frames to be sure
        if there or self._waited > _PATIENCE:
            self._next()
        way = _GAIN * gap
        way *= min(1.0, stop.pace * self.max_step / max(float(np.linalg.norm(way)), 1e-9))
        goals = opening.rim + turned(self._goals - opening.rim, float(np.clip(_GAIN * facing, -_TURN, _TURN))) + way
        return self._step(goals, grippers)

    def _step(self, goals: Array, grippers: Array) -> NDArray[np.float32]:
        """The action that brings the goals there, or as near as may be."""
        move = np.clip((goals - self._goals) / self.max_step, -1, 1)
        self._goals = np.clip(self._goals + self.max_step * move, grippers - _LEASH, grippers + _LEASH)
        return np.append(move.ravel(), 0.0).astype(np.float32)

    def _next(self) -> None:
        """Go on to the next stop; from the last one to the second, a few times."""
        self._stop, self._waited = self._stop + 1, 0
        if self._stop == len(_RAIL):
            self._stop, self._tries = 1, self._tries + 1
        if self._tries == _TRIES:
            self.reason = f"the loop was not around the target after {_TRIES} tries"

    def _opening(self, arm: Arm, hands: Hands, grippers: Array) -> Opening:
        """Of all chosen loops together, in the world: as low as the lowest rim, and where the last to pass the tip is."""
        first, *others = openings = [loop.opening.outside(hands) for loop in self._chosen]
        rims = np.array([opening.rim for opening in openings])
        last = (np.concatenate([rims, grippers]) if others else rims) @ arm.out  # each gripper holds one of several
        rim = rims.mean(axis=0) * [1, 1, 0] + [0, 0, rims[:, 2].min()]
        rim = rim + (last.max() - rim @ arm.out) * arm.out
        return replace(first, rim=rim, height=min(opening.height for opening in openings))

    def _goal(self, stop: _Stop, arm: Arm, opening: Opening) -> Array:
        """Where the rim should be."""
        if stop.name == "far":
            place = arm.around(opening.rim, stop.before)
        else:
            place = arm.tip + (stop.before if stop.before > 0 else stop.before * arm.reach) * arm.out
        if stop.name == "down":
            return np.array([*place[:2], (arm.start[2] + arm.end[2]) / 2 + self.radius - 0.02])
        slack = (opening.height - arm.rise - 2 * self.radius) / 2  # of the opening, above and below arm and tip
        clear = float(np.clip(slack, 0.015, 0.06)) + 0.02 * self._tries
        return np.array([*place[:2], arm.tip[2] + self.radius + clear])

    def _facing(self, opening: Opening, arm: Arm) -> float:
        """The turn, in radians, that would bring the opening to face the arm."""
        return wrapped(heading(arm.out) - heading(opening.normal))
