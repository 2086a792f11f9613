"""A throw: a garment is let go in front of an arm beyond the reach of the grippers, and flies there.

Idea: while the grippers hold the cloth, a forecast predicts its motion. After that it flies as a thrown body does. Runs up to a
fence are drawn, each with a velocity and a height at its end. The best are those whose loops come nearest to hanging in flight.
Their mean is taken. There is one try.

Source: the cross-entropy method, as in `Planner`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicHermiteSpline

from topokit._validate import positive
from topokit.sim import SimulationConfig

from ._arm import Arm, Array
from ._planner import FRAMES, MotionForecaster, Planner
from ._servo import Servo

_RUN = 0.3  # metres before the fence at which a run begins
_LOW = 0.1  # metres by which a run begins below the height at which the rim should pass the tip
_FLIGHT_FRAMES = np.array([4, 6, 8, 10])  # frames after the release at which the guide is computed
# A throw: its level and its upward speed at the release, as shares of the largest; and the metres by which the rim is then
# above the height at which it should pass the tip.
_LEAST = np.array([0.35, 0.0, -0.05])
_MOST = np.array([1.0, 1.0, 0.08])
_BEST = 8  # throws whose mean is taken


class ThrowController(Planner):
    """Hang a garment on an arm that the hands cannot reach: a `Controller` that throws once.

    Parameters
    ----------
    forecast : MotionForecaster
    goal : optional
        The parameters of `Planner`; the forecast predicts the cloth while it is held.
    fence : float
        Distance before the arm's tip that the grippers cannot pass, metres.
    frame_time : float
        Seconds between frames.
    plans, rounds : int
        Number of throws that are compared at a time, and of draws about the best.
    **options
        Further parameters of `Planner`.
    """

    def __init__(
        self,
        forecast: MotionForecaster,
        goal: ArrayLike | None = None,
        *,
        fence: float,
        frame_time: float = 0.036,
        plans: int = 64,
        rounds: int = 3,
        **options: Any,
    ) -> None:
        super().__init__(forecast, goal, plans=plans, rounds=rounds, **options)
        self._fence = positive(fence, "fence")
        self._time = positive(frame_time, "frame_time", zero=False)

    def _rim_goal(self, stop: str, arm: Arm, rim: Array) -> Array:
        """Return the place where the run begins: a throw has no other stop."""
        return np.array([*arm.before(rim, self._fence + _RUN)[:2], self._passing_height(arm) - _LOW])

    def _next_action(self, arm: Arm, grippers: Array) -> NDArray[np.float32]:
        """Return the next action: go to the start of a run, choose a run, follow it, and let go."""
        if self._stop == 0:
            return Servo._next_action(self, arm, grippers)
        if not len(self._path):
            self._path = self._best_run(arm, grippers)
        self._followed += 1
        if self._followed > len(self._path):
            return np.eye(7, dtype=np.float32)[6]
        return self._action_towards(self._path[self._followed - 1], grippers)

    def _best_run(self, arm: Arm, grippers: Array) -> Array:
        """Return the goals (F, 2, 3) of the best run."""
        throws = self._random.uniform(_LEAST, _MOST, (self._plans, 3))
        cycles, rims = self._curves()
        for _ in range(self._rounds):
            # Forecast the held cloth along each run, and let it fly.
            runs = [self._run(throw, arm, grippers) for throw in throws]
            goals = np.array([run for run, _ in runs])
            frames = np.array([count for _, count in runs])
            held = self._moved(goals, np.concatenate([rims, *cycles]))
            flying = self._flight(held, frames + self._age)
            # Draw again about the best.
            best = throws[np.argsort(self._mean_guide(flying, cycles, len(rims), arm, False))[:_BEST]]
            spread = (best.std(axis=0) + 0.02) * self._random.normal(size=throws.shape)
            throws = np.clip(best.mean(axis=0) + spread, _LEAST, _MOST)
        goals, last = self._run(best.mean(axis=0), arm, grippers)
        return goals[:last]

    def _run(self, throw: Array, arm: Arm, grippers: Array) -> tuple[Array, int]:
        """Return goals (60, 2, 3), faster and faster up to the fence and then straight on, and the frames up to the fence."""
        speed, up, above = throw.tolist()
        far = max(float(((self._goals - arm.tip) @ arm.out).min()) - self._fence, 0.02)
        frames = min(int(np.ceil(2 * far / (speed * self.max_step))), FRAMES)
        rise = self._passing_height(arm) + above - self._rim(arm, grippers)[2]
        # From rest here to the fence, with the velocity of the throw there; straight on after it.
        ends = [np.zeros(3), np.array([0, 0, rise]) - far * arm.out]
        slopes = [np.zeros(3), self.max_step * (np.array([0, 0, up]) - speed * arm.out)]
        run = CubicHermiteSpline([0, frames], ends, slopes)
        time = np.arange(1, FRAMES + 1)
        beyond = np.maximum(time - frames, 0)[:, None] * slopes[1]
        return self._goals + (run(np.minimum(time, frames)) + beyond)[:, None], frames

    def _flight(self, held: Array, lasts: NDArray[np.int64]) -> Array:
        """Return places (C, F, n, 3) in flight of points (C, 60, n, 3) that are let go after their last frames (C,)."""
        ends = np.minimum(lasts, FRAMES) - 1
        numbers = np.arange(len(held))
        places = held[numbers, ends][:, None]
        before = held[numbers, ends - 1][:, None]
        # Each point keeps its last velocity, and falls.
        frames = _FLIGHT_FRAMES[:, None, None]
        return np.asarray(
            places + frames * (places - before) - [0, 0, SimulationConfig.GRAVITY / 2] * (frames * self._time) ** 2
        )

    def _passing_height(self, arm: Arm) -> float:
        """Return the height at which the rim should pass the tip, metres."""
        return float(arm.tip[2] + self._clearance(arm))
