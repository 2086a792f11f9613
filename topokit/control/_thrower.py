"""A throw: what hangs beyond the reach of the hands is let go on the way to it, and flies there.

Idea: as long as hands hold the cloth, a forecast says how it moves; once they have let go, it flies, and falls as all things do.
Runs up to a fence are drawn with the speeds at their ends and the height there, and the middle of those whose loops come
nearest to hanging, while they fly, is taken. There is one try.

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

_RUN, _LOW = 0.3, 0.1  # metres before the fence, and below where the rim shall pass the tip, from where it is thrown
_FLIES = np.array([4, 6, 8, 10])  # frames after the release at which the guide is asked
# Speed at the release, level and up, as shares of the largest; and metres by which the rim is then above where it shall pass.
_LEAST, _MOST = np.array([0.35, 0.0, -0.05]), np.array([1.0, 1.0, 0.08])
_BEST = 8


class ThrowController(Planner):
    """Hang a garment on an arm that the hands cannot reach: a `Controller` that sees as `Servo` does, and throws once.

    Parameters
    ----------
    forecast : MotionForecaster
    goal : optional
        As in `Planner`; the forecast tells of the cloth while it is held.
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
        self._fence, self._time = positive(fence, "fence"), positive(frame_time, "frame_time", zero=False)

    def _goal(self, stop: str, arm: Arm, rim: Array) -> Array:
        """Where the run begins: a throw has no other stop."""
        return np.array([*arm.before(rim, self._fence + _RUN)[:2], self._passes(arm) - _LOW])

    def _along(self, arm: Arm, grippers: Array) -> NDArray[np.float32]:
        """Go to where the run begins; choose one; run, and let go."""
        if self._stop == 0:
            return Servo._along(self, arm, grippers)
        if not len(self._path):
            self._path = self._aimed(arm, grippers)
        self._followed += 1
        if self._followed > len(self._path):
            return np.eye(7, dtype=np.float32)[6]
        return self._step(self._path[self._followed - 1], grippers)

    def _aimed(self, arm: Arm, grippers: Array) -> Array:
        """The run (F, 2, 3) that is taken."""
        throws = self._random.uniform(_LEAST, _MOST, (self._plans, 3))
        cycles, rims = self._curves()
        for _ in range(self._rounds):
            runs = [self._run(throw, arm, grippers) for throw in throws]
            goals, frames = (np.array(part) for part in zip(*runs, strict=True))
            held = self._moved(goals, np.concatenate([rims, *cycles]))
            flying = self._flown(held, frames + self._age)
            best = throws[np.argsort(self._missing(flying, cycles, len(rims), arm, False))[:_BEST]]
            spread = (best.std(axis=0) + 0.02) * self._random.normal(size=throws.shape)
            throws = np.clip(best.mean(axis=0) + spread, _LEAST, _MOST)
        goals, last = self._run(best.mean(axis=0), arm, grippers)
        return goals[:last]

    def _run(self, throw: Array, arm: Arm, grippers: Array) -> tuple[Array, int]:
        """Goals (60, 2, 3), evenly faster up to the fence, and on as if there were none; and frames up to the fence."""
        speed, up, above = throw.tolist()
        far = max(float(((self._goals - arm.tip) @ arm.out).min()) - self._fence, 0.02)
        frames = min(int(np.ceil(2 * far / (speed * self.max_step))), FRAMES)
        rise = self._passes(arm) + above - self._rim(arm, grippers)[2]
        ends = [np.zeros(3), np.array([0, 0, rise]) - far * arm.out]
        slopes = [np.zeros(3), self.max_step * (np.array([0, 0, up]) - speed * arm.out)]
        way, time = CubicHermiteSpline([0, frames], ends, slopes), np.arange(1, FRAMES + 1)
        beyond = np.maximum(time - frames, 0)[:, None] * slopes[1]
        return self._goals + (way(np.minimum(time, frames)) + beyond)[:, None], frames

    def _flown(self, held: Array, lasts: NDArray[np.int64]) -> Array:
        """(C, F, n, 3) places of points in flight, from where (C, 60, n, 3) they would be, held: let go after so many frames."""
        ends = np.minimum(lasts, FRAMES) - 1
        places, before = (held[np.arange(len(held)), ends - back][:, None] for back in (0, 1))
        frames = _FLIES[:, None, None]
        return np.asarray(
            places + frames * (places - before) - [0, 0, SimulationConfig.GRAVITY / 2] * (frames * self._time) ** 2
        )

    def _passes(self, arm: Arm) -> float:
        return float(arm.tip[2] + self._clear(arm))
