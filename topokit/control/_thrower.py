"""A throw: a garment is let go in front of an arm beyond the reach of the grippers, and flies there.

Idea: as long as the grippers hold the cloth, a forecast predicts how it moves; after that it flies as a thrown body does. Runs up
to a fence are drawn, each with its velocity and its height at the end. The best are those whose loops come nearest to hanging
while they fly; their mean is taken. There is one try.

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
_LOW = 0.1  # metres below the height at which the rim should pass the tip, at which a run begins
_FLIES = np.array([4, 6, 8, 10])  # frames after the release at which the guide is asked
# Speed at the release, level and up, as shares of the largest; and metres by which the rim is then above where it should pass.
_LEAST = np.array([0.35, 0.0, -0.05])
_MOST = np.array([1.0, 1.0, 0.08])
_BEST = 8  # throws whose mean is taken


class ThrowController(Planner):
    """Hang a garment on an arm that the hands cannot reach: a `Controller` that throws once.

    Parameters
    ----------
    forecast : MotionForecaster
    goal : optional
        As in `Planner`; the forecast predicts the cloth while it is held.
    fence : float
        Metres before the arm's tip that the grippers cannot pass.
    frame_time : float
        Seconds between frames.
    plans, rounds : int
        Throws that are compared at a time, and how often new ones are drawn about the best.
    **options
        Of `Planner`.
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
        """Return where the run begins: a throw has no other stop."""
        return np.array([*arm.before(rim, self._fence + _RUN)[:2], self._passes(arm) - _LOW])

    def _next_action(self, arm: Arm, grippers: Array) -> NDArray[np.float32]:
        """Return the next action: go to where a run begins, choose a run, follow it, and let go."""
        if self._stop == 0:
            return Servo._next_action(self, arm, grippers)
        if not len(self._path):
            self._path = self._aimed(arm, grippers)
        self._followed += 1
        if self._followed > len(self._path):
            return np.eye(7, dtype=np.float32)[6]
        return self._action_towards(self._path[self._followed - 1], grippers)

    def _aimed(self, arm: Arm, grippers: Array) -> Array:
        """Return the run (F, 2, 3) that is taken."""
        throws = self._random.uniform(_LEAST, _MOST, (self._plans, 3))
        cycles, rims = self._curves()
        for _ in range(self._rounds):
            # Forecast the held cloth along each run, and let it fly.
            runs = [self._run(throw, arm, grippers) for throw in throws]
            goals = np.array([run for run, _ in runs])
            frames = np.array([count for _, count in runs])
            held = self._moved(goals, np.concatenate([rims, *cycles]))
            flying = self._flown(held, frames + self._age)
            # Draw again about the best.
            best = throws[np.argsort(self._missing(flying, cycles, len(rims), arm, False))[:_BEST]]
            spread = (best.std(axis=0) + 0.02) * self._random.normal(size=throws.shape)
            throws = np.clip(best.mean(axis=0) + spread, _LEAST, _MOST)
        goals, last = self._run(best.mean(axis=0), arm, grippers)
        return goals[:last]

    def _run(self, throw: Array, arm: Arm, grippers: Array) -> tuple[Array, int]:
        """Return goals (60, 2, 3), ever faster up to the fence and on beyond it, and the frames up to the fence."""
        speed, up, above = throw.tolist()
        far = max(float(((self._goals - arm.tip) @ arm.out).min()) - self._fence, 0.02)
        frames = min(int(np.ceil(2 * far / (speed * self.max_step))), FRAMES)
        rise = self._passes(arm) + above - self._rim(arm, grippers)[2]
        # From rest here to the fence, with the velocity of the throw there; straight on after it.
        ends = [np.zeros(3), np.array([0, 0, rise]) - far * arm.out]
        slopes = [np.zeros(3), self.max_step * (np.array([0, 0, up]) - speed * arm.out)]
        run = CubicHermiteSpline([0, frames], ends, slopes)
        time = np.arange(1, FRAMES + 1)
        beyond = np.maximum(time - frames, 0)[:, None] * slopes[1]
        return self._goals + (run(np.minimum(time, frames)) + beyond)[:, None], frames

    def _flown(self, held: Array, lasts: NDArray[np.int64]) -> Array:
        """Return (C, F, n, 3) places of points in flight that are let go after so many frames, from (C, 60, n, 3) places held."""
        ends = np.minimum(lasts, FRAMES) - 1
        numbers = np.arange(len(held))
        places = held[numbers, ends][:, None]
        before = held[numbers, ends - 1][:, None]
        # Each point keeps its last velocity, and falls.
        frames = _FLIES[:, None, None]
        return np.asarray(
            places + frames * (places - before) - [0, 0, SimulationConfig.GRAVITY / 2] * (frames * self._time) ** 2
        )

    def _passes(self, arm: Arm) -> float:
        """Return the height at which the rim should pass the tip, metres."""
        return float(arm.tip[2] + self._clearance(arm))
