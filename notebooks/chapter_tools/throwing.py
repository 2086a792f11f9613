"""Throws: a garment is let go in front of an arm beyond the reach of the grippers, and flies there. Taught in chapter 16.

Idea: while the grippers hold the cloth, a forecast predicts its motion. After that it flies as a thrown body does. Runs up to a
fence are drawn, each with a velocity and a height at its end. The best are those whose loops come nearest to hanging in flight.
Their mean is taken. There is one try.

Source: the cross-entropy method, as in `topokit.control.Planner`.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from topokit.control import Planner, Servo
from topokit.sim import SimulationConfig

Array = NDArray[np.float64]


class Fence(gymnasium.ActionWrapper):
    """Stop the goals of both grippers at a distance before an arm's tip; a goal that is past it goes no farther.

    Parameters
    ----------
    env : HangEnv
    distance : float
        Metres before the tip.
    """

    def __init__(self, env: gymnasium.Env, distance: float) -> None:
        super().__init__(env)
        self._distance = distance

    def action(self, action: Array) -> Array:
        """Return the action, without the part that goes past the fence."""
        scene = self.unwrapped
        line = scene.target.centre_line
        out = (line[-2] - line[-3]) * [1, 1, 0]
        out = out / np.linalg.norm(out)
        before = (scene.goal - line[-1]) @ out
        move = scene.max_step * np.reshape(action[:6], (2, 3))
        missing = np.maximum(np.minimum(before, self._distance) - before - move @ out, 0)
        move = move + missing[:, None] * out
        return np.append(move / scene.max_step, action[6])


class Thrower(Planner):
    """Hang a garment on an arm that the grippers cannot reach, by one throw.

    Parameters
    ----------
    forecast : optional
        The forecaster of the cloth while it is held, as in `Planner`.
    n_loops : int
        As in `Planner`.
    fence : float
        Distance before the arm's tip that the grippers cannot pass, metres.
    frame_time : float
        Seconds between frames.
    **options
        Further parameters of `Planner`.
    """

    # A throw: its level and its upward speed at the release, as shares of the largest; and the metres by which the rim is then
    # above the height at which it should pass the tip.
    LEAST = np.array([0.35, 0.0, -0.05])
    MOST = np.array([1.0, 1.0, 0.08])
    FRAMES = 60  # frames of a forecast

    def __init__(
        self, forecast: Any = None, n_loops: int = 1, *, fence: float, frame_time: float = 0.036, **options: Any
    ) -> None:
        super().__init__(forecast, n_loops, plans=64, rounds=3, best=8, **options)
        self._fence = fence
        self._time = frame_time

    def _rim_goal(self, stop: str, arm: Any, rim: Array) -> Array:
        """Return the place where the run begins, 30 cm before the fence: a throw has no other stop."""
        return np.array([*arm.before(rim, self._fence + 0.3)[:2], self._passing_height(arm) - 0.1])

    def _next_action(self, arm: Any, grippers: Array) -> NDArray[np.float32]:
        """Return the next action: go to the start of a run, choose a run, follow it, and let go."""
        if self._stop == "far":
            return Servo._next_action(self, arm, grippers)
        if not len(self._path):
            self._path = self._best_run(arm, grippers)
        self._followed += 1
        if self._followed > len(self._path):
            return np.eye(7, dtype=np.float32)[6]
        return self._action_towards(self._path[self._followed - 1], grippers)

    def _best_run(self, arm: Any, grippers: Array) -> Array:
        """Return the goals (F, 2, 3) of the best run."""
        options = self.options
        throws = self._random.uniform(self.LEAST, self.MOST, (options.plans, 3))
        cycles, rims = self._curves()
        for _ in range(options.rounds):
            # Forecast the held cloth along each run, and let it fly.
            runs = [self.run_up(throw, arm, grippers) for throw in throws]
            goals = np.array([run for run, _ in runs])
            frames = np.array([count for _, count in runs])
            held = self._moved(goals, np.concatenate([rims, *cycles]))
            flying = self.flight(held, frames + self._age)
            # Draw again about the best.
            order = np.argsort(self._mean_guide(flying, cycles, len(rims), arm, False))
            best = throws[order[: options.best]]
            spread = (best.std(axis=0) + 0.02) * self._random.normal(size=throws.shape)
            throws = np.clip(best.mean(axis=0) + spread, self.LEAST, self.MOST)
        goals, last = self.run_up(best.mean(axis=0), arm, grippers)
        return goals[:last]

    def run_up(self, throw: Array, arm: Any, grippers: Array) -> tuple[Array, int]:
        """Return goals (60, 2, 3), faster and faster up to the fence and then straight on, and the frames up to the fence."""
        speed, up, above = throw.tolist()
        far = max(float(((self._goals - arm.tip) @ arm.out).min()) - self._fence, 0.02)
        frames = min(int(np.ceil(2 * far / (speed * self.max_step))), self.FRAMES)
        rise = self._passing_height(arm) + above - self._rim(arm, grippers)[2]
        # From rest here to the fence, with the velocity of the throw there; straight on after it.
        ends = [np.zeros(3), np.array([0, 0, rise]) - far * arm.out]
        slopes = [np.zeros(3), self.max_step * (np.array([0, 0, up]) - speed * arm.out)]
        run = CubicHermiteSpline([0, frames], ends, slopes)
        time = np.arange(1, self.FRAMES + 1)
        beyond = np.maximum(time - frames, 0)[:, None] * slopes[1]
        return self._goals + (run(np.minimum(time, frames)) + beyond)[:, None], frames

    def flight(self, held: Array, lasts: NDArray[np.int64]) -> Array:
        """Return places (C, 4, n, 3) in flight, 4 to 10 frames after points (C, 60, n, 3) are let go in frames (C,)."""
        ends = np.minimum(lasts, self.FRAMES) - 1
        numbers = np.arange(len(held))
        places = held[numbers, ends][:, None]
        before = held[numbers, ends - 1][:, None]
        # Each point keeps its last velocity, and falls.
        frames = np.array([4, 6, 8, 10])[:, None, None]
        fall = SimulationConfig.GRAVITY / 2 * (frames * self._time) ** 2
        return places + frames * (places - before) - [0, 0, 1] * fall

    def _passing_height(self, arm: Any) -> float:
        """Return the height at which the rim should pass the tip, metres."""
        return float(arm.tip[2] + self._clearance(arm))
