"""Put a garment on a mannequin: over its head from above, or by two straps over its shoulders.

Idea: cloth that two grippers hold moves with them. So a fixed row of stops suffices, relative to the body and to the observed
size of the cloth. A shirt hangs below the grippers as an open tube: its flat loops show where the middle of the tube is, and its
lowest point shows how high it must be lifted. Straps go past the ends of the shoulders, one on either side, and are drawn
together behind them. The grippers let go when the loops are seen around the neck or around both shoulders; otherwise they try
again.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from topokit._geometry import angle, turned
from topokit._opening import lies_flat
from topokit.linking import close_far, curve_centroid, linking_number

from ._arm import Arm, Array
from ._servo import SURE, TURN, USUAL_STEP, Servo, entry

_NEW_WEIGHT = 0.1  # weight of a new measurement of the middle of the cloth
_CLEAR = 0.06  # metres between the head and cloth that is carried over it
_RELEASE_HEIGHT = 0.03  # metres above the shoulders at which a shirt is let go
_ASIDE = 0.11  # metres that grippers pass above and beside the ends of the shoulders
_STRETCH = 1.1  # how far cloth between the grippers can be stretched, as a multiple of its length
_NEAR = 0.025  # metres that are near enough to a stop
_FACING = 7.0  # degrees between cloth and body that are near enough
_APART = 0.03  # metres by which the distance between the grippers may differ from the wanted one
_GAIN = 0.15  # share of the remaining move and turn that is made in a frame
_WIDEN = 0.012  # metres by which grippers go apart in a frame, at most
_SEEN = 2  # frames in which each shoulder must be seen to have a strap around it
_TRIES = 4  # runs along the stops before the controller gives up


class _Body(NamedTuple):
    """The body of a mannequin: its axis and its shoulders."""

    arm: Arm
    line: Array  # (4, 3) from the floor to the top of the head
    ends: Array  # (2, 3) ends of the shoulders, the right one first as seen from where the body is approached
    shoulders: tuple[Array, ...]  # for each shoulder a closed line, from the floor up the axis and out through it

    @classmethod
    def of(cls, line: Array, rods: Array, place: Array) -> _Body | None:
        """Return the body of a centre line and rods (R, 7), approached from a place; None without a head on shoulders."""
        arm = Arm.of_head(line, rods, place)
        if arm is None or Arm.of(line):  # a target with an arm is no mannequin
            return None
        # The shoulders are the two rods that reach farthest sideways.
        across = rods[:, 3:6] - rods[:, :3]
        wide = np.linalg.norm(across[:, :2], axis=1)
        ends = rods[np.argsort(-wide, kind="stable")[:2], 3:6]
        right = np.cross(arm.out, [0, 0, -1.0])
        ends = ends[np.argsort(ends @ right)[::-1]]
        # For each shoulder, a line goes up the axis and out through the shoulder, and is closed far away.
        lines = []
        for end in ends:
            axis = np.array([*line[-1, :2], end[2]])
            lines.append(close_far(np.array([line[0], axis, end]), end=end - axis))
        return cls(arm, line, ends, tuple(lines))


class _Wearing(Servo):
    """A controller that goes along stops relative to a body, and lets go when the loops are around it."""

    _SPEEDS: ClassVar[dict[str, float]]  # the stops, and the shares of the largest step on the way to them

    def __init__(self, *, max_step: float = USUAL_STEP, cloud_delay: int = 0) -> None:
        super().__init__(max_step=max_step, cloud_delay=cloud_delay)

    def reset(self, observation: Mapping[str, Any]) -> None:
        """Forget everything, and begin with a first observation of `topokit.sim.HangEnv`."""
        super().reset(observation)
        self._loops: list[Array] = []
        # The distance between the grippers at the start, metres.
        self._start_width = float(np.linalg.norm(self._goals[1] - self._goals[0]))

    def act(self, observation: Mapping[str, Any]) -> NDArray[np.float32]:
        """Return the next action; nothing moves once there is a `reason` to give up."""
        self._check_begun()
        nothing = np.zeros(7, np.float32)
        if self.reason:
            return nothing
        points = entry(observation, "points")
        grippers = entry(observation, "grippers")
        line = entry(observation, "target")
        body = _Body.of(line, entry(observation, "rods"), self._approach_from)
        if body is None:
            self.reason = "the target has no head on shoulders, so nothing can be put on it"
        if body is None or not observation["held"]:
            return nothing
        self._frame += 1
        self._least_width = 0.0
        self._follow(points, grippers, line)
        self.reason = self._unfit(body)
        return nothing if self.reason else self._onward(body, grippers)

    def _observe_cloud(self, points: Array) -> None:
        """Track the loops of a new cloud, and measure the cloth."""
        loops = self._tracker.update(np.unique(points, axis=0)).loops
        self._loops = [self._to_gripper_frame(loop.cycle_points) for loop in loops]
        self._measure(self._to_gripper_frame(points))

    def _onward(self, body: _Body, grippers: Array) -> NDArray[np.float32]:
        """Return the action that brings the grippers nearer to their stop, or that lets go."""
        # Find the move, the turn and the change of the distance between the grippers that are missing to the stop.
        stop = list(self._SPEEDS)[self._stop]
        here = self._here()
        goal, gap = self._goal_of(stop, here, body)
        move = goal - here
        facing = self._facing(stop, body, grippers)
        apart = gap - float(np.linalg.norm(self._goals[1] - self._goals[0]))
        arrived = np.linalg.norm(move) < _NEAR and abs(facing) < _FACING and abs(apart) < _APART
        # Let go, go on to the next stop, or begin again at the first one.
        self._waited += 1
        if self._worn(stop, body) and stop == "down" and (arrived or self._waited > self._patience):
            return np.eye(7, dtype=np.float32)[6]
        if (arrived and stop != "down") or self._waited > 2 * self._patience:
            self._stop += 1
            self._waited = 0
        if self._stop == len(self._SPEEDS):
            self._stop = 0
            self._tries += 1
            if self._tries == _TRIES:
                self.reason = f"in {_TRIES} tries the garment was not seen to be worn"
        # Make a share of the missing move, turn and distance, no faster than the stop allows.
        move = _GAIN * move
        move *= min(1.0, self._SPEEDS[stop] * self.max_step / max(float(np.linalg.norm(move)), 1e-9))
        goals = here + turned(self._goals - here, np.clip(_GAIN * facing, -TURN, TURN)) + move + self._drift
        across = (goals[1] - goals[0]) / np.linalg.norm(goals[1] - goals[0])
        goals = goals + np.array([[-0.5], [0.5]]) * across * np.clip(apart, -_WIDEN, _WIDEN)
        return self._action_towards(goals, grippers)

    def _unfit(self, body: _Body) -> str:
        """Return why the garment cannot be put on this body; "" when it can."""
        return ""

    def _here(self) -> Array:
        """Return the place that is brought to the stops: midway between the grippers."""
        return self._middle

    @abstractmethod
    def _measure(self, cloth: Array) -> None:
        """Measure the cloth (n, 3) and the loops, in the frame of the grippers."""

    @abstractmethod
    def _goal_of(self, stop: str, here: Array, body: _Body) -> tuple[Array, float]:
        """Return where the place of `_here` should be at a stop, and how far apart the grippers should be, metres."""

    @abstractmethod
    def _facing(self, stop: str, body: _Body, grippers: Array) -> float:
        """Return the degrees by which the garment has to turn."""

    @abstractmethod
    def _worn(self, stop: str, body: _Body) -> bool:
        """Return whether the loops were seen around the body in enough frames."""


class PullOverController(_Wearing):
    """Put a shirt on a mannequin from above: a `Controller` with the observations of `Servo`.

    Parameters
    ----------
    max_step, cloud_delay
        As in `Servo`.
    """

    _SPEEDS: ClassVar[dict[str, float]] = {"up": 0.5, "above": 0.45, "down": 0.35, "lift": 0.4}

    def reset(self, observation: Mapping[str, Any]) -> None:
        """Forget everything, and begin with a first observation of `topokit.sim.HangEnv`."""
        super().reset(observation)
        self._centre = np.zeros(3)  # the middle of the tube, in the frame of the grippers
        self._length = 0.0  # how far the garment hangs below the grippers, metres
        self._around = 0  # frames in a row in which a loop was around the neck

    def _measure(self, cloth: Array) -> None:
        self._length = -float(cloth[:, 2].min())
        for loop in self._loops:
            if lies_flat(loop):
                self._centre = (1 - _NEW_WEIGHT) * self._centre + _NEW_WEIGHT * curve_centroid(loop) * [1, 1, 0]

    def _here(self) -> Array:
        return self._to_world(self._centre[None])[0]

    def _goal_of(self, stop: str, here: Array, body: _Body) -> tuple[Array, float]:
        top = body.line[-1]
        shoulders = body.line[-2]
        above = top[2] + _CLEAR + self._length
        places = {
            "up": [*here[:2], max(above, here[2])],
            "above": [*top[:2], above],
            "down": [*top[:2], shoulders[2] + _RELEASE_HEIGHT],
            "lift": [*here[:2], above],
        }
        return np.array(places[stop]), self._start_width

    def _facing(self, stop: str, body: _Body, grippers: Array) -> float:
        """Return the degrees from the line of the grippers to that of the shoulders, either way round; 0 at the stop "up"."""
        if stop == "up":
            return 0.0
        aside = angle(grippers[1] - grippers[0], body.ends[1] - body.ends[0])
        return (aside + 90) % 180 - 90

    def _worn(self, stop: str, body: _Body) -> bool:
        if any(body.arm.holds(self._to_world(loop)) for loop in self._loops):
            self._around += 1
        else:
            self._around = 0
        return self._around >= SURE


class StrapController(_Wearing):
    """Put two straps over the shoulders of a mannequin: a `Controller` with the observations of `Servo`.

    Parameters
    ----------
    max_step, cloud_delay
        As in `Servo`.
    """

    _SPEEDS: ClassVar[dict[str, float]] = {"far": 0.4, "before": 0.25}
    _SPEEDS |= dict.fromkeys(["past", "together", "down", "lift", "apart", "back"], 0.2)

    def reset(self, observation: Mapping[str, Any]) -> None:
        """Forget everything, and begin with a first observation of `topokit.sim.HangEnv`."""
        super().reset(observation)
        # Metres from the middle of the cloth to the straps, along the left of the way from gripper to gripper.
        self._ahead = 0.0
        self._seen = np.zeros(2, np.int64)  # frames in which a strap was around each shoulder

    def _unfit(self, body: _Body) -> str:
        needed = 2 * (_half_width(body) + _ASIDE)
        if _STRETCH * self._start_width >= needed:
            return ""
        return f"the straps are held {self._start_width:.2f} m apart, and need {needed:.2f} m to pass the shoulders"

    def _measure(self, cloth: Array) -> None:
        self._ahead = (1 - _NEW_WEIGHT) * self._ahead - _NEW_WEIGHT * float(cloth[:, 1].mean())

    def _goal_of(self, stop: str, here: Array, body: _Body) -> tuple[Array, float]:
        end = body.ends.mean(axis=0)
        half_width = _half_width(body)
        # For each stop: metres before the shoulders, metres above them, half the distance between the grippers.
        away, up, half = {
            "far": (0.45, _ASIDE, self._start_width / 2),
            "before": (0.1, _ASIDE, half_width + _ASIDE),
            "past": (-0.13, _ASIDE, half_width + _ASIDE),
            "together": (-0.13, _ASIDE, half_width - 0.08),
            "down": (-0.1, -0.07, half_width - 0.08),
            "lift": (-0.13, _ASIDE, half_width - 0.08),
            "apart": (-0.13, _ASIDE, half_width + _ASIDE),
            "back": (0.3, _ASIDE, half_width + _ASIDE),
        }[stop]
        return end + away * body.arm.out + [0, 0, up], 2 * half

    def _facing(self, stop: str, body: _Body, grippers: Array) -> float:
        """Return the degrees by which the straps have to turn to be on the side of the body."""
        ahead = turned(np.array([0, np.sign(self._ahead), 0]), self._yaw)
        return angle(ahead, -body.arm.out)

    def _worn(self, stop: str, body: _Body) -> bool:
        curves = [self._to_world(loop) for loop in self._loops]
        around = [any(_around(curve, line) for curve in curves) for line in body.shoulders]
        self._seen = (self._seen + around) * (stop == "down")
        return bool((self._seen >= _SEEN).all())


def _half_width(body: _Body) -> float:
    """Return half the width of the shoulders, metres."""
    return float(np.linalg.norm(body.ends[1] - body.ends[0])) / 2


def _around(curve: Array, line: Array) -> bool:
    """Return whether a curve links a closed line; a curve that touches the line does not."""
    try:
        return linking_number(curve, line) != 0
    except ValueError:
        return False
