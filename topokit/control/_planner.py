"""A planner: of many paths of the grippers the one whose forecast brings the loop nearest to where it hangs.

Idea: the servo asks where a loop's rim is, the planner where it will be. Smooth paths are drawn about a first guess and about
the last plan, the motion of the loop is forecast under each, and a mean of the best is followed for a few frames, until the
next look. What a path is worth is a *guide*: the metres that the rim has to go up to the tip, over it, in, and down, and by how
much the opening looks aside. Whether the loop is around the target is no guide but an integer, the linking number of its moved
cycle; it says which part of the way is done, and it alone lets go.

Source: the cross-entropy method of Rubinstein and Kroese 2004, as in Chua et al. 2018, *Deep reinforcement learning in a handful
of trials using probabilistic dynamics models*.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from topokit._geometry import turned
from topokit._validate import positive, whole
from topokit.linking import linking_numbers

from ._arm import Arm, Array, angle
from ._servo import DOWN, LIFT, PATIENCE, SURE, TURN, Servo

_KNOTS = np.array([0, 8, 18, 30, 44, 60])  # frames at which a path is described
FRAMES = 60  # of a forecast
_SEEN = np.array([4, 9, 14, 19, 24, 29, 39, 49, 59])  # frames of a path, from 0, at which the guide is asked
_SPREAD = np.array([0.06, 0.06, 0.04, 15.0])  # metres and degrees by which paths differ, at first
_BEST = 4  # paths whose mean is followed
_CORNERS = 24  # of a cycle, at most
_HARDER = 0.1  # share of the largest planned step by which it changes in a frame
_SEATED, _STILL = 0.03, 0.008  # metres from the seat, and metres in a frame, below which a linked rim is let go
_CHASE = 1.6  # of the speed of a target that comes, by which the way to it is slower: cloth that is turned round swings
_CLOSE = 0.25  # metres from the tip within which frames are counted
_TURN_COSTS = 0.0026  # metres for a degree
_LOW_COSTS = 2.0  # metres for a metre below the tip when the arm is near


class MotionForecaster(Protocol):
    """What a planner asks of a forecast; `Carried` tells of its methods."""

    def reset(self) -> None: ...

    def observe(self, points: ArrayLike, grippers: ArrayLike, held: bool, target: ArrayLike) -> None: ...

    def move(self, actions: ArrayLike, held: ArrayLike | None, points: ArrayLike) -> tuple[Any, Any]: ...


class Carried:
    """The forecast that the cloth goes with the grippers as a rigid body does: with their middle, and about the vertical."""

    def reset(self) -> None:
        """Forget everything observed."""
        self._hands = np.zeros((2, 3))

    def observe(
        self, points: ArrayLike, grippers: ArrayLike, held: bool = True, target: ArrayLike | None = None
    ) -> None:
        """Take in the next frame; this forecast looks at the grippers alone.

        Parameters
        ----------
        points : (n, 3) array_like
        grippers : (2, 3) array_like
        held : bool
        target : (L, 3) array_like, optional
            A centre line.
        """
        self._hands = np.asarray(grippers, np.float64)

    def move(self, actions: ArrayLike, held: ArrayLike | None, points: ArrayLike) -> tuple[Any, Any]:
        """Return places (C, 60, n, 3) of points under plans, and what is said of their errors, here None.

        Parameters
        ----------
        actions : (C, 60, 2, 3) array_like
            Where the grippers are told to be at each of the next frames, metres.
        held : (C, 60) array_like of bool, optional
        points : (n, 3) array_like
            Where they are now.
        """
        there = np.asarray(actions, np.float64)
        yaws = _heading(there) - _heading(self._hands)
        middle = there.mean(axis=-2)[..., None, :]
        return middle + turned(np.asarray(points) - self._hands.mean(axis=0), yaws[..., None]), None


class Planner(Servo):
    """Hang a garment by the best of many paths under a forecast: a `Controller` that sees as `Servo` does.

    Parameters
    ----------
    forecast : MotionForecaster
        `Carried()`, a `topokit.models.MotionPredictor`, or one's own with the methods of these.
    goal : optional
    radius : float
    max_step : float
    cloud_delay : int
        As in `Servo`.
    pace : float
        Share of the largest step at which the rim shall go; fast cloth swings, and lags behind. Below 1 a loop that leaves no
        room for that is left to the servo.
    plans : int
        Paths that are compared at a time.
    rounds : int
        How often new ones are drawn about the best.
    replan_every : int
        Frames that a plan is followed for.
    seed : int
        Of the draws.
    """

    def __init__(
        self,
        forecast: MotionForecaster,
        goal: ArrayLike | None = None,
        *,
        radius: float = 0.02,
        max_step: float = 0.0432,
        cloud_delay: int = 0,
        pace: float = 0.6,
        plans: int = 24,
        rounds: int = 2,
        replan_every: int = 3,
        seed: int = 0,
    ) -> None:
        super().__init__(goal, radius=radius, max_step=max_step, cloud_delay=cloud_delay)
        self._forecast, self._seed = forecast, seed
        self._pace = positive(pace, "pace", zero=False)
        self._plans, self._rounds = whole(plans, "plans", _BEST), whole(rounds, "rounds", 1)
        self._replan_every = whole(replan_every, "replan_every", 1)

    def reset(self, observation: Mapping[str, Any]) -> None:
        """Forget everything, and begin with a first observation of `topokit.sim.HangEnv`."""
        super().reset(observation)
        self._forecast.reset()
        self._random = np.random.default_rng(self._seed)
        self._path, self._followed = np.zeros((0, 2, 3)), 0
        self._last: CubicSpline | None = None
        self._was, self._speed = np.zeros(3), np.zeros((2, 3))
        self._slow: bool | None = None
        self._told, self._carried = 0, np.zeros((0, 3))

    def _look(self, points: Array) -> None:
        """Tell the forecast too; what was not seen since it was told, it is told carried."""
        super()._look(points)
        frame = self._frame - self._age
        for then in list(self._past)[len(self._past) - self._age - frame + self._told : -1 - self._age]:
            self._forecast.observe(turned(self._carried, then.yaw) + then.middle, then.grippers, True, then.line)
        self._forecast.observe(points, self._then.grippers, True, self._then.line)
        self._told, self._carried = frame, self._inside(points)

    def _outside(self, points: Array) -> Array:
        """Where the points are now, by the forecast for what was done since they were seen."""
        there = self._seen(points)
        return self._moved(np.zeros((1, 0, 2, 3)), there)[0, self._age - 1] if self._age else there

    def _seen(self, points: Array) -> Array:
        """Where the points were when they were seen."""
        return turned(points, self._then.yaw) + self._then.middle

    def _moved(self, goals: Array, points: Array) -> Array:
        """(C, 60, n, 3) points that were seen, under what the grippers were told since, and then under goals (C, F, 2, 3)."""
        since = [then.goals for then in self._past][len(self._past) - self._age :]
        past = np.broadcast_to(np.reshape(since, (-1, 2, 3)), (len(goals), self._age, 2, 3))
        plans = np.concatenate([past, goals], axis=1)
        plans = plans[:, np.minimum(np.arange(FRAMES), plans.shape[1] - 1)]
        return np.asarray(self._forecast.move(plans, np.ones(plans.shape[:2], bool), points)[0], np.float64)

    def _along(self, arm: Arm, grippers: Array) -> NDArray[np.float32]:
        """The next step of the plan, which is made anew every few frames; or they let go."""
        if self._slow is None:
            self._slow = self._pace < 1 and min(loop.opening.size[0] for loop in self._chosen) < self._needed(arm)
        if self._slow:  # there is no room for cloth that swings
            return super()._along(arm, grippers)
        rim, before = self._rim(arm, grippers), self._goals
        speed, self._was = float(np.linalg.norm(rim - self._was - self._drift)), rim
        if self._stop:  # down for certain; or it did not go in: lift, back off
            self._followed, self._speed = len(self._path), np.zeros((2, 3))
            action = super()._along(arm, grippers)
            self._stop = self._stop if self._stop >= DOWN else 0
            return action
        linked = min(loop.around for loop in self._chosen)
        self._waited += bool(np.linalg.norm(rim - arm.tip) < _CLOSE)
        seated = np.linalg.norm(self._seat(arm) - rim) < _SEATED and speed < _STILL
        if linked >= SURE and (seated or self._waited > PATIENCE / 2):
            if all(loop.cycle is not loop.curve for loop in self._chosen):
                return np.eye(7, dtype=np.float32)[6]
            self._stop, self._waited = DOWN, 0  # what is not seen is let go when it cannot fall any more
            return super()._along(arm, grippers)
        if self._waited > PATIENCE:
            self._stop, self._waited, self._last = LIFT, 0, None
        if self._followed in (self._replan_every, len(self._path)):
            self._path, self._followed = self._best(arm, rim, linked > 0), 0
        self._followed += 1
        action = self._step(self._path[self._followed - 1], grippers)
        self._speed = self._goals - before
        return action

    # -- paths

    def _curves(self) -> tuple[list[Array], Array]:
        """Where corners of the chosen cycles, and their rims, were when they were seen."""
        cycles = [self._seen(loop.curve[:: -(-len(loop.curve) // _CORNERS)]) for loop in self._chosen]
        return cycles, self._seen(np.array([loop.opening.rim for loop in self._chosen]))

    def _best(self, arm: Arm, rim: Array, linked: bool) -> Array:
        """The goals (60, 2, 3) of the path that is followed now."""
        cycles, rims = self._curves()
        kept, spread = self._guess(arm, rim, linked)[None], _SPREAD
        if self._last is not None:  # from where it is now
            last = self._last(np.minimum(_KNOTS[1:] + self._replan_every, _KNOTS[-1])) - self._last(self._replan_every)
            kept = np.concatenate([kept, last[None]])
        for _ in range(self._rounds):
            about = kept[self._random.integers(len(kept), size=self._plans - len(kept))]
            ways = np.concatenate([kept, about + spread * self._random.normal(size=about.shape)])
            goals = self._goals_of(ways, rim, arm.out)
            order = np.argsort(self._costs(goals, cycles, rims, arm, linked))[:_BEST]
            kept, spread = ways[order], spread / 2
        self._last = _through(kept[0])
        return np.asarray(goals[order[0]])

    def _guess(self, arm: Arm, rim: Array, linked: bool) -> Array:
        """(knots, 4) where the rim would be on its way at an even pace, from here, and how far turned, if all went with it."""
        legs = np.array([rim, *([self._seat(arm)] if linked else self._stops(arm, rim))])
        length = np.append(0, np.linalg.norm(np.diff(legs, axis=0), axis=1).cumsum())
        gone = self._pace * self.max_step * _KNOTS[1:]
        places = np.stack([np.interp(gone, length, axis) for axis in legs.T], axis=1)
        facing = angle(self._faces(), arm.out)
        return np.column_stack([places - rim, np.clip(facing, -TURN * _KNOTS[1:], TURN * _KNOTS[1:])])

    def _stops(self, arm: Arm, rim: Array) -> list[Array]:
        """Places that the rim shall pass before it sinks: up beside the target, before it, above the tip, above the seat."""
        seat, over = self._seat(arm), arm.tip + [0, 0, self._clear(arm)]
        far = abs(angle(arm.out, rim - arm.start)) > 60 or np.linalg.norm((rim - arm.tip)[:2]) > 0.3
        before = [np.array([*arm.before(rim, 0.13)[:2], over[2]])] if far else []
        return [*before, over, np.array([*seat[:2], over[2]])]

    def _seat(self, arm: Arm) -> Array:
        return np.asarray(arm.seat + [0, 0, self.radius - 0.02])

    def _goals_of(self, ways: Array, pivot: Array, out: Array) -> Array:
        """Goals (C, 60, 2, 3) of ways (C, knots, 4), no faster, and speeding up no harder, than can be."""
        frames = np.arange(1, _KNOTS[-1] + 1)
        path = _through(ways)(frames)
        path[..., :3] += frames[:, None] * self._drift
        goals = turned(self._goals - pivot, path[..., 3, None]) + pivot + path[..., None, :3]
        last, step = (np.broadcast_to(part, goals[:, 0].shape) for part in (self._goals, self._speed))
        fast = self._pace * self.max_step
        beside = max(fast - _CHASE * max(float(self._drift @ out), 0), fast / 5)
        for k in range(goals.shape[1]):
            way = self._drift + np.clip(goals[:, k] - last - self._drift, -beside, beside)
            step = np.clip(way, step - _HARDER * fast, step + _HARDER * fast)
            goals[:, k] = last = last + step
        return goals

    def _costs(self, goals: Array, cycles: list[Array], rims: Array, arm: Arm, linked: bool) -> Array:
        """(C,) what is missing to a hanging loop along paths, in metres, in the mean over the frames that are looked at."""
        frames = np.minimum(_SEEN + self._age, _SEEN[-1])
        gone = (frames + 1 - self._age)[:, None, None] * self._drift  # by the target, until then
        places = self._moved(goals, np.concatenate([rims, *cycles]))[:, frames] - gone
        return self._missing(places, cycles, len(rims), arm, linked)

    def _missing(self, places: Array, cycles: list[Array], n: int, arm: Arm, linked: bool) -> Array:
        """(C,) the guide in the mean over frames at which n rims and the cycles' corners are at these places (C, F, n + m, 3)."""
        tops, *moved = np.split(places, np.cumsum([n, *map(len, cycles)])[:-1], axis=2)
        costs = [self._to_go(tops[:, :, i], cycle, arm, linked) for i, cycle in enumerate(moved)]
        return np.asarray(np.max(costs, axis=0).mean(axis=1))

    def _to_go(self, rim: Array, cycle: Array, arm: Arm, linked: bool) -> Array:
        """(C, F) the guide for a rim (C, F, 3) of a cycle (C, F, L, 3); it shall not sink before the loop is seen around."""
        seat, over = self._seat(arm), arm.tip + [0, 0, self._clear(arm)]
        above = np.array([*seat[:2], over[2]])
        area = np.cross(cycle, np.roll(cycle, -1, axis=2)).sum(axis=2) * [1, 1, 0]
        area = area / np.maximum(np.linalg.norm(area, axis=-1, keepdims=True), 1e-9)
        side = np.sign(area[:, :1] @ self._faces())  # the one that was chosen
        aside = np.degrees(np.arccos(np.clip(side * (area @ arm.out), -1, 1)))
        low = np.maximum(over[2] - rim[..., 2], 0) * np.exp(-((((rim - arm.tip) @ arm.out) / 0.13) ** 2))
        way = np.linalg.norm(rim - over, axis=-1) + np.linalg.norm(over - above) + np.linalg.norm(above - seat)
        missing = way + _TURN_COSTS * aside
        left = np.linalg.norm(rim - (seat if linked else above), axis=-1)
        return np.where(self._around(cycle, arm), left, missing) + (0 if linked else _LOW_COSTS * low)

    def _around(self, cycle: Array, arm: Arm) -> Array:
        """(C, F) whether cycles (C, F, L, 3) wind around the target."""
        try:
            numbers, _ = linking_numbers(cycle.reshape(-1, *cycle.shape[2:]), arm.closed)
        except ValueError:  # one of them touches the centre line
            return np.zeros(cycle.shape[:2], bool)
        return numbers.reshape(cycle.shape[:2]) != 0


def _through(ways: Array) -> CubicSpline:
    """The smooth curves from 0 through ways (..., knots, 4)."""
    table = np.concatenate([np.zeros_like(ways[..., :1, :]), ways], axis=-2)
    return CubicSpline(_KNOTS, table, axis=table.ndim - 2, bc_type="natural")


def _heading(hands: Array) -> Array:
    """Degrees from x towards y, of the ways (..., 2, 3) from the first gripper to the second."""
    x, y, _ = np.moveaxis(hands[..., 1, :] - hands[..., 0, :], -1, 0)
    return np.asarray(np.degrees(np.arctan2(y, x)))
