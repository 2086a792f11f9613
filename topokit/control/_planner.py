"""A planner: it follows that path of the grippers whose forecast brings the loop nearest to where it hangs.

Idea: the servo uses where a loop's rim is, the planner where it will be. Smooth paths are drawn about a first guess and about
the last plan, the motion of the loop is forecast under each, and the best is followed for a few frames. The cost of a path is a
*guide*: the metres that the rim has to go up to the tip, over it, in, and down, and by how much the opening faces aside. The
linking number of the moved cycle is an integer and guides nothing; it decides which part of the rail is done, and when to let go.

Source: the cross-entropy method of Rubinstein and Kroese 2004, as in Chua et al. 2018, *Deep reinforcement learning in a handful
of trials using probabilistic dynamics models*.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from topokit._geometry import angle, turned
from topokit._validate import Array

from ._arm import Arm
from ._servo import Servo, ServoOptions

# The frames at which a path is described, up to the horizon of the forecast; and those, from 0, at which the guide is computed.
_KNOTS = np.array([0, 8, 18, 30, 44, 60])
_GUIDE_FRAMES = np.array([4, 9, 14, 19, 24, 29, 39, 49, 59])


@dataclass(frozen=True)
class PlannerOptions(ServoOptions):
    """Sizes and thresholds of the planner, besides those of the servo, for the same garments and targets."""

    #: Speed of the rim as a share of the largest step. Fast cloth swings and lags behind. Below 1 the servo hangs a loop that
    #: leaves no room for that.
    pace: float = 0.6
    seed: int = 0  #: seed of the draws
    plans: int = 24  #: paths that are compared at a time
    rounds: int = 2  #: draws about the best
    best: int = 4  #: paths that are kept after each round
    replan_every: int = 3  #: frames after which a new plan is made
    spread: tuple[float, ...] = (0.06, 0.06, 0.04, 15.0)  #: metres and degrees by which paths differ, at first
    corners: int = 24  #: corners of a cycle, at most
    step_change: float = 0.1  #: largest change of the step in a frame, as a share of the largest planned step
    seated: float = 0.03  #: metres from the seat within which a linked rim is let go
    still: float = 0.008  #: metres in a frame below which the rim is at rest
    close: float = 0.25  #: metres from the tip within which frames are counted
    turn_costs: float = 0.0026  #: metres for a degree
    low_costs: float = 2.0  #: metres for a metre below the tip when the arm is near


class Carried:
    """The forecast by which cloth goes with the grippers as a rigid body: with their middle, and about the vertical."""

    def reset(self) -> None:
        """Forget everything observed."""

    def observe(self, points: ArrayLike, grippers: ArrayLike, *others: Any) -> None:
        """Take in the next frame, of which this forecast uses the grippers (2, 3) alone."""
        self._grippers = np.array(grippers, np.float64)

    def move(self, actions: ArrayLike, held: ArrayLike | None, points: ArrayLike) -> tuple[Any, Any]:
        """Return places (C, 60, n, 3) of points (n, 3) under plans (C, 60, 2, 3), and None for their errors."""
        planned = np.asarray(actions, np.float64)
        yaws = _heading(planned) - _heading(self._grippers)
        middle = planned.mean(axis=-2)[..., None, :]
        return middle + turned(np.asarray(points) - self._grippers.mean(axis=0), yaws[..., None]), None


class Planner(Servo):
    """Hang a garment by the best of many paths under a forecast, with the observations of `Servo`.

    Parameters
    ----------
    forecast : optional
        A `topokit.models.Predictor` of a model of motion, or an object of one's own with its methods `reset`, `observe` and
        `move`. By default cloth goes with the grippers as a rigid body.
    n_loops : int
        As in `Servo`.
    **options
        Fields of `PlannerOptions`: those of `ServoOptions`, `pace`, `seed`, the number of paths, and thresholds.
    """

    Options = PlannerOptions
    options: PlannerOptions

    def __init__(self, forecast: Any = None, n_loops: int = 1, **options: Any) -> None:
        super().__init__(n_loops, **options)
        self._forecast = forecast or Carried()

    def reset(self, observation: Mapping[str, Any]) -> None:
        """Forget everything, and begin with a first observation."""
        super().reset(observation)
        self._forecast.reset()
        self._random = np.random.default_rng(self.options.seed)
        # The path that is followed, the number of its frames that are done, and its curve.
        self._path = np.zeros((0, 2, 3))
        self._followed = 0
        self._last: CubicSpline | None = None
        # The last place of the rim, the last step of the goals, and whether the servo acts instead.
        self._last_rim = np.zeros(3)
        self._speed = np.zeros((2, 3))
        self._uses_servo: bool | None = None
        # The last frame that the forecast observed, and its cloud in the grippers' frame.
        self._observed = 0
        self._last_cloud = np.zeros((0, 3))

    def _observe_cloud(self, points: Array) -> None:
        """Let the forecast observe the cloud, too; in frames without one the last cloud is carried along."""
        super()._observe_cloud(points)
        *past, taken = list(self._frames)[: len(self._frames) - self._age]
        frame = self._frame - self._age
        for then in past[len(past) + 1 - frame + self._observed :]:
            self._forecast.observe(then.to_world(self._last_cloud), then.grippers, True, then.line)
        self._forecast.observe(points, taken.grippers, True, taken.line)
        self._observed = frame
        self._last_cloud = taken.to_grippers(points)

    def _to_world(self, points: Array) -> Array:
        """Return the present places of points, by the forecast since they were observed."""
        places = self._cloud_frame.to_world(points)
        if not self._age:
            return places
        return self._moved(np.zeros((1, 0, 2, 3)), places)[0, self._age - 1]

    def _moved(self, goals: Array, points: Array) -> Array:
        """Return (C, 60, n, 3) observed points, moved under the goals since then, and then under goals (C, F, 2, 3)."""
        since = [then.goals for then in self._frames][len(self._frames) - self._age :]
        done = np.broadcast_to(np.reshape(since, (-1, 2, 3)), (len(goals), self._age, 2, 3))
        plans = np.concatenate([done, goals], axis=1)
        plans = plans[:, np.minimum(np.arange(_KNOTS[-1]), plans.shape[1] - 1)]
        return np.asarray(self._forecast.move(plans, np.ones(plans.shape[:2], bool), points)[0], np.float64)

    def _next_action(self, arm: Arm, grippers: Array) -> NDArray[np.float32]:
        """Return the next step of the plan, which is renewed every few frames, or let go."""
        options = self.options
        # A small loop leaves no room for cloth that swings. The servo, which is slow, hangs it.
        if self._uses_servo is None:
            smallest = min(loop.opening.size[0] for loop in self._chosen)
            self._uses_servo = bool(options.pace < 1 and smallest < self._needed_size(arm))
        if self._uses_servo:
            return super()._next_action(arm, grippers)
        rim = self._rim(arm, grippers)
        before = self._goals
        speed = float(np.linalg.norm(rim - self._last_rim))
        self._last_rim = rim
        # The servo's stops: lower the loop; or lift and back off when it did not go in.
        if self._stop != "far":
            self._followed = len(self._path)
            self._speed = np.zeros((2, 3))
            action = super()._next_action(arm, grippers)
            if self._stop in ("near", "over"):
                self._stop = "far"
            return action
        # Let go of a loop that is around the target and seated. A loop that is not seen is first lowered by the servo.
        linked = min(loop.around for loop in self._chosen)
        self._waited += bool(np.linalg.norm(rim - arm.tip) < options.close)
        seated = np.linalg.norm(self._stations(arm)[2] - rim) < options.seated and speed < options.still
        if linked >= options.sure and (seated or self._waited > self._patience / 2):
            if all(loop.is_seen for loop in self._chosen):
                return np.eye(7, dtype=np.float32)[6]
            self._stop = "down"
            self._waited = 0
            return super()._next_action(arm, grippers)
        if self._waited > self._patience:
            self._stop = "lift"
            self._waited = 0
            self._last = None
        # Follow the plan, or make a new one.
        if self._followed in (options.replan_every, len(self._path)):
            self._path = self._best(arm, rim, linked > 0)
            self._followed = 0
        self._followed += 1
        action = self._action_towards(self._path[self._followed - 1], grippers)
        self._speed = self._goals - before
        return action

    # -- paths

    def _curves(self) -> tuple[list[Array], Array]:
        """Return places of corners of the chosen cycles, and of their rims, in the frame in which they were observed."""
        to_world = self._cloud_frame.to_world
        curves = [loop.curve for loop in self._chosen]
        cycles = [to_world(curve[:: -(-len(curve) // self.options.corners)]) for curve in curves]
        return cycles, to_world(np.array([loop.opening.rim for loop in self._chosen]))

    def _best(self, arm: Arm, rim: Array, linked: bool) -> Array:
        """Return the goals (60, 2, 3) of the best path."""
        options = self.options
        cycles, rims = self._curves()
        frames = np.minimum(_GUIDE_FRAMES + self._age, _GUIDE_FRAMES[-1])
        # Begin with a guess and with the rest of the last plan.
        best = self._guess(arm, rim, linked)[None]
        spread = np.array(options.spread)
        if self._last is not None:
            later = np.minimum(_KNOTS[1:] + options.replan_every, _KNOTS[-1])
            rest = self._last(later) - self._last(options.replan_every)
            best = np.concatenate([best, rest[None]])
        # Draw paths about the best, keep the best of them, and draw again with half the spread.
        for _ in range(options.rounds):
            about = best[self._random.integers(len(best), size=options.plans - len(best))]
            paths = np.concatenate([best, about + spread * self._random.normal(size=about.shape)])
            goals = self._goals_of(paths, rim)
            places = self._moved(goals, np.concatenate([rims, *cycles]))[:, frames]
            order = np.argsort(self._mean_guide(places, cycles, len(rims), arm, linked))[: options.best]
            best = paths[order]
            spread = spread / 2
        self._last = _through(best[0])
        return np.asarray(goals[order[0]])

    def _guess(self, arm: Arm, rim: Array, linked: bool) -> Array:
        """Return the moves and turns (knots, 4) of a rim that goes through the stations at an even pace."""
        over, above, seat = self._stations(arm)
        legs = [rim, seat] if linked else [rim, over, above]
        # A rim that is far away or beside the target goes up first, to a place before the tip.
        is_far = abs(angle(arm.out, rim - arm.start)) > 60 or np.linalg.norm((rim - arm.tip)[:2]) > 0.3
        if is_far and not linked:
            legs.insert(1, np.array([*arm.before(rim, 0.13)[:2], over[2]]))
        length = np.append(0, np.linalg.norm(np.diff(legs, axis=0), axis=1).cumsum())
        gone = self.options.pace * self.max_step * _KNOTS[1:]
        places = np.stack([np.interp(gone, length, axis) for axis in np.transpose(legs)], axis=1)
        facing = angle(self._loop_direction(), arm.out)
        most = self.options.turn * _KNOTS[1:]
        return np.column_stack([places - rim, np.clip(facing, -most, most)])

    def _stations(self, arm: Arm) -> tuple[Array, Array, Array]:
        """Return the places of a rim over the tip, above the seat, and at rest on it."""
        over = arm.tip + [0, 0, self._clearance(arm)]
        seat = arm.seat + [0, 0, self.options.radius - 0.02]
        return over, np.array([*seat[:2], over[2]]), seat

    def _goals_of(self, paths: Array, pivot: Array) -> Array:
        """Return goals (C, 60, 2, 3) of paths (C, knots, 4), within the limits of speed and of acceleration."""
        # Move and turn the grippers about the rim along the smooth curve of each path.
        path = _through(paths)(np.arange(1, _KNOTS[-1] + 1))
        goals = turned(self._goals - pivot, path[..., 3, None]) + pivot + path[..., None, :3]
        last = np.broadcast_to(self._goals, goals[:, 0].shape)
        step = np.broadcast_to(self._speed, goals[:, 0].shape)
        fast = self.options.pace * self.max_step
        change = self.options.step_change * fast
        for k in range(goals.shape[1]):
            wanted = np.clip(goals[:, k] - last, -fast, fast)
            step = np.clip(wanted, step - change, step + change)
            last = last + step
            goals[:, k] = last
        return goals

    # -- costs

    def _mean_guide(self, places: Array, cycles: list[Array], n: int, arm: Arm, linked: bool) -> Array:
        """Return the mean guide (C,) over frames, for places (C, F, n + m, 3) of n rims and of the cycles' corners."""
        tops, *moved = np.split(places, np.cumsum([n, *map(len, cycles)])[:-1], axis=2)
        costs = [self._to_go(tops[:, :, i], cycle, arm, linked) for i, cycle in enumerate(moved)]
        return np.asarray(np.max(costs, axis=0).mean(axis=1))

    def _to_go(self, rim: Array, cycle: Array, arm: Arm, linked: bool) -> Array:
        """Return the guide (C, F) for a rim (C, F, 3) of a cycle (C, F, L, 3), which may sink once it is linked."""
        over, above, seat = self._stations(arm)
        # The degrees by which the opening faces aside of the arm, on the chosen side.
        area = np.cross(cycle, np.roll(cycle, -1, axis=2)).sum(axis=2) * [1, 1, 0]
        area = area / np.maximum(np.linalg.norm(area, axis=-1, keepdims=True), 1e-9)
        side = np.sign(area[:, :1] @ self._loop_direction())
        aside = np.degrees(np.arccos(np.clip(side * (area @ arm.out), -1, 1)))
        # The metres below the height of the tip, which cost most near the arm.
        low = np.maximum(over[2] - rim[..., 2], 0) * np.exp(-((((rim - arm.tip) @ arm.out) / 0.13) ** 2))
        # Before the loop is around: the path over the tip, in and down. After that: the rest of the path.
        distance = np.linalg.norm(rim - over, axis=-1) + np.linalg.norm(over - above) + np.linalg.norm(above - seat)
        remaining = distance + self.options.turn_costs * aside
        left = np.linalg.norm(rim - (seat if linked else above), axis=-1)
        around = [[arm.holds(curve) for curve in frames] for frames in cycle]
        guide = np.where(around, left, remaining)
        return guide if linked else guide + self.options.low_costs * low


def _through(paths: Array) -> CubicSpline:
    """Return smooth curves from 0 through paths (..., knots, 4)."""
    table = np.concatenate([np.zeros_like(paths[..., :1, :]), paths], axis=-2)
    return CubicSpline(_KNOTS, table, axis=table.ndim - 2, bc_type="natural")


def _heading(grippers: Array) -> Array:
    """Return the direction from the first gripper to the second, in degrees from x towards y; grippers are (..., 2, 3)."""
    x, y, _ = np.moveaxis(grippers[..., 1, :] - grippers[..., 0, :], -1, 0)
    return np.asarray(np.degrees(np.arctan2(y, x)))
