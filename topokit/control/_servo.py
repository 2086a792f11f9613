"""The loop servo: hang a garment by its tracked loops, without a forecast.

Idea: in the frame of the grippers a hanging garment hardly changes. So a loop that was seen there a moment ago is still there,
and the place where its rim should be determines where the grippers should be. The rim goes along a rail that the target's centre
line gives: up to the tip, over it, half the arm in, down. The grippers let go when the loop's cycle has been around the centre
line for five frames. (A loop that is not seen is carried along with the nearest cloth.) Else they lift, back off, and try again.
A garment that shows no loop is turned.

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
_NEAR = 0.025  # metres that are near enough to a stop
_FACING = 7.0  # degrees that are near enough
_NEW = 0.3  # weight of a new look at an opening
_SAME = 0.08  # metres between the openings of one loop in two frames, at most
_GAIN = 0.15  # share of what is missing that is made up for in a frame
TURN = 3.5  # degrees in a frame, at most
_WIDEN = 0.01  # metres by which grippers go apart in a frame, at most
_LEASH = 0.2  # metres by which a goal may lead its gripper along an axis
# The stops of the rail: metres before the tip, or, below 0, above the seat; speed as a share of the largest step.
_RAIL = {"far": (0.35, 0.5), "near": (0.13, 0.3), "over": (-1, 0.2), "down": (-1, 0.25)}
_RAIL |= {"lift": (-1, 0.2), "back": (0.13, 0.3)}
DOWN = list(_RAIL).index("down")
LIFT = list(_RAIL).index("lift")


class _Then(NamedTuple):
    """A frame of the past."""

    grippers: Array  # (2, 3)
    line: Array  # (K, 3) the target's
    goals: Array  # (2, 3) of the grippers before it
    middle: Array  # (3,)
    yaw: float  # degrees


@dataclass(eq=False)
class _Known:
    """A loop that was seen, in the frame of the grippers."""

    cycle: Array  # of edges no longer than at its birth, whose linking number counts; the curve when it is not seen
    curve: Array  # of the same class, tighter; carried along with the cloth when it is not seen
    last: Array  # the curve when it was seen
    opening: Opening
    seen: int = 1  # frames
    around: int = 0  # frames in a row in which it was around the target


class Controller(ABC):
    """The interface of a controller: it begins, acts on observations, and states a reason when it gives up."""

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
        The loop to hang. None: the one that is best to reach. Three numbers: the loop nearest to that place, in metres from
        midway between the grippers at the start, x level from the first to the second, z up. A whole number: so many at once.
    radius : float
        Of the target's rods, metres.
    max_step : float
        Metres that a gripper's goal goes along an axis when an action says 1.
    cloud_delay : int
        Frames by which clouds are known to be late: they show the garment in the frame of the grippers at that time.
    """

    def __init__(
        self, goal: ArrayLike | None = None, *, radius: float = 0.02, max_step: float = 0.0432, cloud_delay: int = 0
    ) -> None:
        self._count = 1  # loops that are to hang
        self._place: Array | None = None  # where the loop that is to hang is
        if goal is not None and np.ndim(goal) == 0:
            self._count = whole(goal, "goal", 1)
        elif goal is not None:
            self._place = as_reals(goal, "goal").astype(np.float64)
            if self._place.shape != (3,) or not np.isfinite(self._place).all():
                raise ValueError(f"goal must be None, a number of loops or a place of three numbers, not {goal!r}")
        self.radius = positive(radius, "radius")
        self.max_step = positive(max_step, "max_step", zero=False)
        self._delay = whole(cloud_delay, "cloud_delay", 0, _LONGEST)

    def reset(self, observation: Mapping[str, Any]) -> None:
        """Forget everything, and begin with a first observation of `topokit.sim.HangEnv`."""
        self.reason = ""
        self._tracker = SeqPH()
        self._goals = np.asarray(observation["grippers"], np.float64)
        self._front = self._goals.mean(axis=0)  # from where a head is approached
        # The loops that were seen, those of them that are to hang, and whether none of them can.
        self._known: list[_Known] = []
        self._chosen: list[_Known] = []
        self._hidden = False
        # The stop on the rail, and how it goes.
        self._frame = 0
        self._stop = 0
        self._waited = 0
        self._tries = 0
        # The last cloud, its age in frames, the frames since, and the motion of the target in a frame.
        self._cloud = np.zeros((0, 3))
        self._age = 0
        self._past = deque[_Then](maxlen=_LONGEST + 1)
        self._drift = np.zeros(3)

    def act(self, observation: Mapping[str, Any]) -> NDArray[np.float32]:
        """Return the next action; nothing moves once there is a `reason` to give up."""
        points = np.asarray(observation["points"], np.float64)
        grippers = np.asarray(observation["grippers"], np.float64)
        line = np.asarray(observation["target"], np.float64)
        arm = Arm.of(line) or Arm.of_head(line, np.asarray(observation["rods"], np.float64), self._front)
        if arm is None:
            self.reason = "the target has neither an arm that runs sideways nor a head on shoulders"
        if arm is None or self.reason or not observation["held"]:
            return np.zeros(7, np.float32)
        self._frame += 1
        self._wide = arm.wide
        self._follow(points, grippers, line)
        # Choose the loops after the first looks.
        arm = arm.drawn_back(self._drift)
        if not self._chosen and self._frame >= _LOOK:
            self._choose(arm, self._inside(points))
        if not self._chosen:
            return self._show(grippers)
        # Count the frames in which each of them is around the target. A loop that is not seen and goes down counts on: the cloth
        # that carries it is pressed through the arm.
        for loop in self._chosen:
            if arm.holds(self._outside(loop.cycle)):
                loop.around += 1
            elif loop.cycle is not loop.curve or self._stop < DOWN:
                loop.around = 0
        return self._along(arm, grippers)

    def _follow(self, points: Array, grippers: Array, line: Array) -> None:
        """Take in a frame: the age of its cloud, the loops of a new cloud, and the motion of the target."""
        # A cloud is new when it differs from the last one, or when nothing moves, so that nothing is old.
        new = not np.array_equal(points, self._cloud)
        if self._past:
            new |= np.array_equal(grippers, self._past[-1].grippers)
            self._drift = (self._drift + line[-1] - self._past[-1].line[-1]) / 2
        self._middle = grippers.mean(axis=0)
        self._yaw = angle(np.eye(3)[0], grippers[1] - grippers[0])
        self._past.append(_Then(grippers, line, self._goals, self._middle, self._yaw))
        self._age = min(self._delay if new else self._age + 1, len(self._past) - 1)
        self._cloud = points
        if new:
            self._look(points)

    @property
    def _then(self) -> _Then:
        """The frame in which the present cloud was taken."""
        return self._past[-1 - self._age]

    def _inside(self, points: Array) -> Array:
        """Return places of the present cloud in the frame of the grippers: from midway between them, x from first to second."""
        return turned(points - self._then.middle, -self._then.yaw)

    def _outside(self, points: Array) -> Array:
        """Return where places in the frame of the grippers are now."""
        return turned(points, self._yaw) + self._middle

    def _look(self, points: Array) -> None:
        """Update the loops that are known; a loop that is not seen goes with the grippers and the cloth about it."""
        unseen = list(self._known)
        points = np.unique(points, axis=0)
        for loop in self._tracker.update(points).loops:
            # Two rings and a bridge between them are no opening.
            if len(np.unique(loop.cycle)) < len(loop.cycle):
                continue
            cycle = self._inside(loop.cycle_points)
            # Once loops are chosen, those far from them do not matter any more, and tightening them takes time.
            gaps = [np.linalg.norm(known.curve.mean(axis=0) - cycle.mean(axis=0)) for known in self._chosen]
            if min(gaps, default=0.0) > 2 * _SAME:
                continue
            curve = self._inside(points[tighten(points, loop.cycle, radius=loop.birth + loop.lifetime / 4)])
            opening = Opening.of(curve)
            if opening is None:
                continue
            # It is the known loop whose opening is nearest, or a new one.
            same = min(unseen, key=lambda known: known.opening.gap(opening), default=None)
            if same is None or same.opening.gap(opening) > _SAME:
                self._known.append(_Known(cycle, curve, curve, opening))
                continue
            same.cycle = cycle
            same.curve = curve
            same.last = curve
            same.seen += 1
            same.opening = same.opening.blended(opening, _NEW)
            unseen.remove(same)
        cloth = as_tree(self._inside(points))
        for known in unseen:
            known.curve = drawn(known.curve, known.last, cloth)
            known.cycle = known.curve
            known.opening = known.opening.blended(Opening.of(known.curve) or known.opening, _NEW)

    def _choose(self, arm: Arm, cloud: Array) -> None:
        """Choose the loops that shall hang, and the side of them that the arm shall come from."""
        if self._count > 1:
            self._add_twins()
        # Fit are loops that were seen twice, do not lie flat, and are large enough.
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
        half = float(np.linalg.norm(self._goals[1] - self._goals[0])) / 2
        front = turned(arm.out, -self._yaw)

        def effort(opening: Opening) -> float:
            """Return what it costs to come in from a side: the turn, and the cloth in the way."""
            return abs(angle(opening.normal, front)) / 1800 + 0.02 * opening.blocked(cloud, arm.reach / 2)

        def distance(loop: _Known) -> float:
            """Return how far a loop is from the goal, or from where the weight hangs on the line between the grippers."""
            if self._place is not None:
                return float(np.linalg.norm(loop.cycle.mean(axis=0) - self._place))
            held = [np.clip(loop.opening.rim[0], -half, half), 0, 0]
            return float(np.linalg.norm(loop.opening.rim - held)) + effort(loop.opening)

        for loop in fit:
            loop.opening = min(loop.opening, loop.opening.along(-loop.opening.normal), key=effort)
        self._chosen = sorted(fit, key=distance)[: self._count]
        self._across = self._chosen[0].opening.normal * [1, 0, 0]

    def _add_twins(self) -> None:
        """Add the mirror image of each loop: of two handles often only one is seen."""
        mirror = np.array([-1, 1, 1])
        for loop in list(self._known):
            twin = Opening(loop.opening.rim * mirror, loop.opening.normal * mirror, loop.opening.size)
            if min(known.opening.gap(twin) for known in self._known) > _SAME / 2:
                curve = loop.curve * mirror
                self._known.append(_Known(curve, curve, curve, twin, loop.seen))

    def _show(self, grippers: Array) -> NDArray[np.float32]:
        """Wait; when no loop is seen for long, turn the garment to both sides: an opening seen from its edge is a line."""
        turns = (self._frame - PATIENCE // 2) // _QUARTER
        if turns < 0 or not self._hidden:
            return np.zeros(7, np.float32)
        step = (-90 if turns else 90) / _QUARTER
        return self._step(turned(self._goals - self._middle, step) + self._middle, grippers)

    def _along(self, arm: Arm, grippers: Array) -> NDArray[np.float32]:
        """Return the action that brings the rim nearer to the stop, and the opening to face the arm; or let go."""
        # What is missing to the stop: a move, and a turn.
        stop = list(_RAIL)[self._stop]
        rim = self._rim(arm, grippers)
        if stop == "down":  # down until nothing can fall any more
            rim[2] = self._middle[2]
        gap = self._goal(stop, arm, rim) - rim
        facing = angle(self._faces(), arm.out)
        arrived = np.linalg.norm(gap) < _NEAR and abs(facing) < _FACING
        # Let go, go on to the next stop, or try again from the second one.
        sure = min(loop.around for loop in self._chosen) >= SURE
        self._waited += 1
        if stop == "down" and sure and (arrived or self._waited > PATIENCE / 2):
            return np.eye(7, dtype=np.float32)[6]
        if (arrived and stop != "down") or self._waited > PATIENCE:
            self._stop += 1
            self._waited = 0
        if self._stop == len(_RAIL):
            self._stop = 1
            self._tries += 1
            for loop in self._chosen:
                loop.around = 0
            if self._tries == _TRIES:
                self.reason = f"in {_TRIES} tries the loop did not come around the target"
        # Make up for a share of what is missing, no faster than the stop allows, and go with the target.
        move = _GAIN * gap
        move *= min(1.0, _RAIL[stop][1] * self.max_step / max(float(np.linalg.norm(move)), 1e-9))
        goals = rim + turned(self._goals - rim, np.clip(_GAIN * facing, -TURN, TURN)) + move + self._drift
        return self._step(goals, grippers)

    def _faces(self) -> Array:
        """Return the direction in which the arm should go in: through several loops from one gripper to the other."""
        normal = self._chosen[0].opening.normal if len(self._chosen) == 1 else self._across
        return turned(normal, self._yaw)

    def _rim(self, arm: Arm, grippers: Array) -> Array:
        """Return the rim of all chosen loops: as low as the lowest, and where the last one to pass the tip is."""
        rims = self._outside(np.array([loop.opening.rim for loop in self._chosen]))
        # Each gripper holds one of several loops, and has to pass the tip, too.
        passing = np.concatenate([rims, grippers]) if len(rims) > 1 else rims
        last = passing @ arm.out
        rim = np.array([*rims.mean(axis=0)[:2], rims[:, 2].min()])
        return np.asarray(rim + (last.max() - rim @ arm.out) * arm.out)

    def _step(self, goals: Array, grippers: Array) -> NDArray[np.float32]:
        """Return the action that brings the goals there, or as near as they may, and apart for a strap that goes over a head."""
        apart = goals[1] - goals[0]
        gap = max(float(np.linalg.norm(apart)), 1e-9)
        goals = goals + np.array([[-0.5], [0.5]]) * apart / gap * np.clip(self._wide - gap, 0, _WIDEN)
        move = np.clip((goals - self._goals) / self.max_step, -1, 1)
        self._goals = np.clip(self._goals + self.max_step * move, grippers - _LEASH, grippers + _LEASH)
        return np.append(move.ravel(), 0.0).astype(np.float32)

    def _needed(self, arm: Arm) -> float:
        """Return half the way around the arm with its tip, or around a head, metres."""
        if arm.wide:
            return 1.3 * arm.wide
        return float(arm.tip[2] - arm.end[2] + 4 * self.radius)

    def _clear(self, arm: Arm) -> float:
        """Return how far above the tip the rim should pass, metres: the tip goes through the middle of the opening."""
        opening = min(loop.opening.size[0] for loop in self._chosen)
        return float(self.radius + np.clip((opening - arm.tip[2] + arm.end[2]) / 2 - self.radius, 0.015, 0.06))

    def _goal(self, stop: str, arm: Arm, rim: Array) -> Array:
        """Return where the rim should be at a stop."""
        if stop == "down":
            return arm.seat + [0, 0, self.radius]
        before = _RAIL[stop][0]
        if stop == "far":
            x, y, _ = arm.before(rim, before)
        elif before > 0:
            x, y, _ = arm.tip + before * arm.out
        else:
            x, y, _ = arm.seat
        return np.array([x, y, arm.tip[2] + self._clear(arm) + 0.02 * self._tries])
