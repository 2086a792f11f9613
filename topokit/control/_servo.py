"""The loop servo: hang what is tracked, without a forecast.

Idea: in the frame of the grippers a hanging garment hardly changes. So a loop that was seen there a moment ago is still there,
and where its rim should be says where the grippers should be. The rim goes along a rail that the target's centre line gives: up
to the tip, over it, half the arm in, down. The grippers let go when the loop's cycle, seen or carried along with the cloth that
is nearest to it, has been around the centre line for five frames; else they lift, back off, try again. What shows none is turned.

Source: visual servoing is from Hutchinson, Hager and Corke 1996, *A tutorial on visual servo control*.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._geometry import turned
from topokit._validate import as_reals, positive, whole
from topokit.rips import tighten
from topokit.sampling import as_tree
from topokit.seqph import SeqPH

from ._arm import Arm, Array, Opening, angle, drawn, lies_flat

_LOOK = 6  # frames in which the loops are looked at before anything moves
SURE = 5  # frames in a row in which the loops must be around the target
PATIENCE = 60  # frames for a stop on the rail, and for a loop to be seen
_QUARTER = 45  # frames in which a garment that shows no loop is turned by 90 degrees
_SHOWN = PATIENCE // 2 + 3 * _QUARTER  # frames after which it has been turned to one side, and to the other
_TRIES = 4
_LONGEST = 30  # frames by which a cloud can be late
_NEAR, _FACING = 0.025, 7.0  # metres and degrees that are near enough to a stop
_NEW = 0.3  # weight of a new look at an opening
_SAME = 0.08  # metres between the openings of one loop in two frames, at most
_GAIN, TURN = 0.15, 3.5  # share of what is missing that is made up for in a frame; degrees in a frame, at most
_WIDEN = 0.01  # metres by which grippers go apart in a frame, at most
_LEASH = 0.2  # metres by which a goal may lead its gripper along an axis
# The stops of the rail: metres before the tip, or, below 0, above the seat; speed as a share of the largest step.
_RAIL = {"far": (0.35, 0.5), "near": (0.13, 0.3), "over": (-1, 0.2), "down": (-1, 0.25)}
_RAIL |= {"lift": (-1, 0.2), "back": (0.13, 0.3)}
DOWN, LIFT = list(_RAIL).index("down"), list(_RAIL).index("lift")


class _Then(NamedTuple):
    """A frame as it was."""

    grippers: Array  # (2, 3)
    line: Array  # (K, 3) the target's
    goals: Array  # (2, 3) that the grippers were told before it
    middle: Array  # (3,)
    yaw: float  # degrees


@dataclass(eq=False)
class _Known:
    """A loop as it is remembered, in the frame of the grippers."""

    cycle: Array  # when it is seen, of edges no longer than at its birth: what is linked
    curve: Array  # of the same class, tighter; when it is not seen, carried along, and the cycle too
    last: Array  # the curve when it was seen
    opening: Opening
    seen: int = 1  # frames
    around: int = 0  # frames in a row in which it was around the target, as far as can be told


class Controller(ABC):
    """What `hang` asks of a controller: it begins, acts on what it sees, and says why it gives up."""

    reason: str = ""  #: why it has given up, in words; empty while it has not

    @abstractmethod
    def reset(self, observation: Mapping[str, Any]) -> None:
        """Forget everything, and begin with a first observation of `topokit.sim.HangEnv`."""

    @abstractmethod
    def act(self, observation: Mapping[str, Any]) -> NDArray[np.float32]:
        """Return the next action (7,) for `topokit.sim.HangEnv`."""


class Servo(Controller):
    """Hang a garment by its tracked loops, without a forecast.

    Parameters
    ----------
    goal : optional
        Which loop shall hang. None: the one that is best to reach. Three numbers: the loop nearest to that place in the frame of
        the grippers at the start, x level from the first to the second, z up, from midway between them, metres. A whole number:
        so many loops at once.
    radius : float
        Of the target's rods, metres.
    max_step : float
        Metres that a gripper's goal goes along an axis when an action says 1.
    cloud_delay : int
        Frames by which clouds are known to be late: what they show was in the frame of the grippers of then.
    """

    def __init__(
        self, goal: ArrayLike | None = None, *, radius: float = 0.02, max_step: float = 0.0432, cloud_delay: int = 0
    ) -> None:
        counts = goal is None or np.ndim(goal) == 0
        self._count = 1 if goal is None or not counts else whole(goal, "goal", 1)
        self._place = None if counts else as_reals(goal, "goal").astype(np.float64)
        if self._place is not None and (self._place.shape != (3,) or not np.isfinite(self._place).all()):
            raise ValueError(f"goal must be None, a number of loops or a place of three numbers, not {goal!r}")
        self.radius, self.max_step = positive(radius, "radius"), positive(max_step, "max_step", zero=False)
        self._delay = whole(cloud_delay, "cloud_delay", 0, _LONGEST)

    def reset(self, observation: Mapping[str, Any]) -> None:
        """Forget everything, and begin with a first observation of `topokit.sim.HangEnv`."""
        self.reason, self._tracker = "", SeqPH()
        self._goals = np.asarray(observation["grippers"], np.float64)
        self._front = self._goals.mean(axis=0)  # from where a head is approached
        self._known: list[_Known] = []
        self._chosen: list[_Known] = []
        self._frame = self._stop = self._waited = self._tries = 0
        self._past = deque[_Then](maxlen=_LONGEST + 1)
        self._cloud, self._age, self._drift, self._hidden = np.zeros((0, 3)), 0, np.zeros(3), False

    def act(self, observation: Mapping[str, Any]) -> NDArray[np.float32]:
        """Return the next action; nothing moves once there is a `reason` to give up."""
        points, grippers, line = (np.asarray(observation[key], np.float64) for key in ("points", "grippers", "target"))
        arm = Arm.of(line) or Arm.of_head(line, np.asarray(observation["rods"], np.float64), self._front)
        if arm is None:
            self.reason = "the target has neither an arm that runs sideways nor a head on shoulders"
        if arm is None or self.reason or not observation["held"]:
            return np.zeros(7, np.float32)
        self._frame, self._wide = self._frame + 1, arm.wide
        self._follow(points, grippers, line)
        arm = arm.drawn_back(self._drift)
        if not self._chosen and self._frame >= _LOOK:
            self._choose(arm, self._inside(points))
        if not self._chosen:
            return self._show(grippers)
        for loop in self._chosen:
            if arm.holds(self._outside(loop.cycle)):
                loop.around += 1
            elif loop.cycle is not loop.curve or self._stop < DOWN:  # what is carried down is pressed through the arm
                loop.around = 0
        return self._along(arm, grippers)

    def _follow(self, points: Array, grippers: Array, line: Array) -> None:
        """Take in a frame: how old its cloud is, what the cloud shows when it is new, and how fast the target goes."""
        new = not np.array_equal(points, self._cloud)
        if self._past:
            new |= np.array_equal(grippers, self._past[-1].grippers)  # nothing moves, so nothing is old
            self._drift = (self._drift + line[-1] - self._past[-1].line[-1]) / 2
        self._middle, self._yaw = grippers.mean(axis=0), angle(np.eye(3)[0], grippers[1] - grippers[0])
        self._past.append(_Then(grippers, line, self._goals, self._middle, self._yaw))
        self._age = min(self._delay if new else self._age + 1, len(self._past) - 1)
        self._cloud = points
        if new:
            self._look(points)

    @property
    def _then(self) -> _Then:
        """When the cloud was taken that is seen now."""
        return self._past[-1 - self._age]

    def _inside(self, points: Array) -> Array:
        """Places of a cloud in the frame of the grippers of then: level, from midway between them, x from first to second."""
        return turned(points - self._then.middle, -self._then.yaw)

    def _outside(self, points: Array) -> Array:
        return turned(points, self._yaw) + self._middle

    def _look(self, points: Array) -> None:
        """Bring what is known of the loops up to date; one that is not seen goes with the grippers and the cloth about it."""
        unseen = list(self._known)
        points = np.unique(points, axis=0)
        for loop in self._tracker.update(points).loops:
            if len(np.unique(loop.cycle)) < len(loop.cycle):  # two rings and a bridge between them are no opening
                continue
            cycle = self._inside(loop.cycle_points)
            gaps = [np.linalg.norm(known.curve.mean(axis=0) - cycle.mean(axis=0)) for known in self._chosen]
            if min(gaps, default=0.0) > 2 * _SAME:  # others do not matter any more, and to tighten them takes time
                continue
            curve = self._inside(points[tighten(points, loop.cycle, radius=loop.birth + loop.lifetime / 4)])
            opening = Opening.of(curve)
            if opening is None:
                continue
            same = min(unseen, key=lambda known: known.opening.gap(opening), default=None)
            if same is None or same.opening.gap(opening) > _SAME:
                self._known.append(_Known(cycle, curve, curve, opening))
                continue
            same.cycle, same.curve, same.last, same.seen = cycle, curve, curve, same.seen + 1
            same.opening = same.opening.blended(opening, _NEW)
            unseen.remove(same)
        cloth = as_tree(self._inside(points))
        for known in unseen:
            known.cycle = known.curve = drawn(known.curve, known.last, cloth)
            known.opening = known.opening.blended(Opening.of(known.curve) or known.opening, _NEW)

    def _choose(self, arm: Arm, cloud: Array) -> None:
        """Choose the loops that shall hang, and the side of them that the arm shall come from."""
        for loop in list(self._known) if self._count > 1 else []:  # of two handles often only one is seen: add its twin
            mirror = np.array([-1, 1, 1])
            twin = Opening(loop.opening.rim * mirror, loop.opening.normal * mirror, loop.opening.size)
            if min(known.opening.gap(twin) for known in self._known) > _SAME / 2:
                curve = loop.curve * mirror
                self._known.append(_Known(curve, curve, curve, twin, loop.seen))
        needed = self._needed(arm)
        seen = [loop for loop in self._known if loop.seen > 1]
        upright = [loop for loop in seen if not lies_flat(loop.curve)]
        fit = [loop for loop in upright if loop.opening.size.sum() >= needed]
        if len(fit) < self._count:
            words = f"{len(seen)} loops are seen, {len(upright)} of them do not lie flat"
            words += f", {len(fit)} of these are as large as this target needs, {2 * needed:.2f} m around"
            self._hidden = len(upright) < self._count
            self.reason = words if self._frame >= (_SHOWN if self._hidden else PATIENCE) else ""
            return
        half, front = float(np.linalg.norm(self._goals[1] - self._goals[0])) / 2, turned(arm.out, -self._yaw)

        def effort(opening: Opening) -> float:
            return abs(angle(opening.normal, front)) / 1800 + 0.02 * opening.blocked(cloud, arm.reach / 2)

        def distance(loop: _Known) -> float:
            if self._place is not None:
                return float(np.linalg.norm(loop.cycle.mean(axis=0) - self._place))
            bears = [np.clip(loop.opening.rim[0], -half, half), 0, 0]  # on the line between the grippers
            return float(np.linalg.norm(loop.opening.rim - bears)) + effort(loop.opening)

        for loop in fit:
            loop.opening = min(loop.opening, loop.opening.along(-loop.opening.normal), key=effort)
        self._chosen = sorted(fit, key=distance)[: self._count]
        self._across = self._chosen[0].opening.normal * [1, 0, 0]

    def _show(self, grippers: Array) -> NDArray[np.float32]:
        """Wait; when no loop is seen for long, turn the garment to and fro: from its edge an opening looks like a line."""
        turns = (self._frame - PATIENCE // 2) // _QUARTER
        if turns < 0 or not self._hidden:
            return np.zeros(7, np.float32)
        step = (-90 if turns else 90) / _QUARTER
        return self._step(turned(self._goals - self._middle, step) + self._middle, grippers)

    def _along(self, arm: Arm, grippers: Array) -> NDArray[np.float32]:
        """Bring the rim nearer to the stop, and the opening to face the arm; then comes the next stop, or they let go."""
        stop = list(_RAIL)[self._stop]
        rim = self._rim(arm, grippers)
        if stop == "down":  # until nothing can fall any more
            rim[2] = self._middle[2]
        gap = self._goal(stop, arm, rim) - rim
        facing = angle(self._faces(), arm.out)
        there = np.linalg.norm(gap) < _NEAR and abs(facing) < _FACING
        sure = min(loop.around for loop in self._chosen) >= SURE
        self._waited += 1
        if stop == "down" and sure and (there or self._waited > PATIENCE / 2):
            return np.eye(7, dtype=np.float32)[6]
        if (there and stop != "down") or self._waited > PATIENCE:
            self._stop, self._waited = self._stop + 1, 0
        if self._stop == len(_RAIL):
            self._stop, self._tries = 1, self._tries + 1
            for loop in self._chosen:
                loop.around = 0
            self.reason = "" if self._tries < _TRIES else f"in {_TRIES} tries the loop did not come around the target"
        way = _GAIN * gap
        way *= min(1.0, _RAIL[stop][1] * self.max_step / max(float(np.linalg.norm(way)), 1e-9))
        goals = rim + turned(self._goals - rim, np.clip(_GAIN * facing, -TURN, TURN)) + way + self._drift
        return self._step(goals, grippers)

    def _faces(self) -> Array:
        """Which way the arm shall go in: of several loops, each held by a gripper, from one gripper to the other."""
        return turned(self._chosen[0].opening.normal if len(self._chosen) == 1 else self._across, self._yaw)

    def _rim(self, arm: Arm, grippers: Array) -> Array:
        """Of all chosen loops: as low as the lowest, and where the last to pass the tip is; each gripper holds one of several."""
        rims = self._outside(np.array([loop.opening.rim for loop in self._chosen]))
        last = (np.concatenate([rims, grippers]) if len(rims) > 1 else rims) @ arm.out
        rim = np.array([*rims.mean(axis=0)[:2], rims[:, 2].min()])
        return np.asarray(rim + (last.max() - rim @ arm.out) * arm.out)

    def _step(self, goals: Array, grippers: Array) -> NDArray[np.float32]:
        """The action that brings the goals there, or as near as may be, and apart when they hold what goes over a head."""
        apart = goals[1] - goals[0]
        gap = max(float(np.linalg.norm(apart)), 1e-9)
        goals = goals + np.array([[-0.5], [0.5]]) * apart / gap * np.clip(self._wide - gap, 0, _WIDEN)
        move = np.clip((goals - self._goals) / self.max_step, -1, 1)
        self._goals = np.clip(self._goals + self.max_step * move, grippers - _LEASH, grippers + _LEASH)
        return np.append(move.ravel(), 0.0).astype(np.float32)

    def _needed(self, arm: Arm) -> float:
        """Half around the arm with its tip, or around a head, metres."""
        return 1.3 * arm.wide if arm.wide else float(arm.tip[2] - arm.end[2] + 4 * self.radius)

    def _clear(self, arm: Arm) -> float:
        """How far above the tip the rim should pass, metres: the tip shall go through the middle of the opening."""
        opening = min(loop.opening.size[0] for loop in self._chosen)
        return float(self.radius + np.clip((opening - arm.tip[2] + arm.end[2]) / 2 - self.radius, 0.015, 0.06))

    def _goal(self, stop: str, arm: Arm, rim: Array) -> Array:
        """Where the rim should be at a stop."""
        before = _RAIL[stop][0]
        x, y, _ = arm.tip + before * arm.out if before > 0 else arm.seat
        if stop == "far":
            x, y, _ = arm.before(rim, before)
        if stop == "down":
            return arm.seat + [0, 0, self.radius]
        return np.array([x, y, arm.tip[2] + self._clear(arm) + 0.02 * self._tries])
