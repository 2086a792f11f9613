"""Disturb `topokit.sim.HangEnv`: a bad sensor, an early release, cloth that is pushed or held by one gripper."""

from collections import deque
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from spoilt import spoil

from topokit.sim import HangEnv, World

PUSH = 3  # frames that a push of the cloth takes, about 0.1 s


class Faults(gymnasium.ObservationWrapper):
    """A bad sensor: late clouds, clouds that come seldom, noise, lost points, and points that are moved anywhere in the box.

    Parameters
    ----------
    env : HangEnv
    delay : int
        Steps by which clouds are late; the first cloud is repeated until then.
    interval : int
        Steps from one new cloud to the next.
    **errors
        Errors of `spoilt.spoil`.
    """

    def __init__(self, env: gymnasium.Env, delay: int = 0, interval: int = 1, **errors: float) -> None:
        super().__init__(env)
        self._delay = delay
        self._interval = interval
        self._errors = errors

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Begin an episode without clouds of the past."""
        self._random = np.random.default_rng(seed)
        self._clouds: deque[NDArray[Any]] = deque(maxlen=self._delay + 1)
        self._step = 0
        return super().reset(seed=seed, options=options)

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Return the observation with the points that the sensor gives now."""
        cloud = observation["points"]
        if self._step % self._interval:
            cloud = self._clouds[-1]
        elif self._errors:
            cloud = spoil(cloud, self._random, **self._errors).astype(np.float32)
        self._clouds.append(cloud)
        self._step += 1
        return {**observation, "points": self._clouds[0]}


class Release(gymnasium.ActionWrapper):
    """Let go after some seconds, whatever the action says."""

    def __init__(self, env: gymnasium.Env, seconds: float) -> None:
        super().__init__(env)
        self._last = seconds / self.unwrapped.config.frame_time

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Begin an episode at time 0."""
        self._step = 0
        return super().reset(seed=seed, options=options)

    def action(self, action: NDArray[Any]) -> NDArray[Any]:
        """Return the action, which lets go when the time has come."""
        let_go = action[6]
        if self._step >= self._last:
            let_go = 1.0
        self._step += 1
        return np.append(action[:6], let_go)


class Pushed(HangEnv):
    """An environment in which the cloth is pushed sideways or swings, or one gripper alone holds it.

    Parameters
    ----------
    *arguments, **options
        Those of `HangEnv`.
    shove : float
        Metres a second that a push would give to free cloth, at some time from 0.3 to 1.5 s.
    swing : float
        The same for a push just before the first observation.
    n_grippers : int
        With 1 the second gripper lets go before the first observation.
    """

    def __init__(
        self, *arguments: Any, shove: float = 0.0, swing: float = 0.0, n_grippers: int = 2, **options: Any
    ) -> None:
        super().__init__(*arguments, **options)
        self._shove = shove
        self._swing = swing
        self._n_grippers = n_grippers

    def settle(self, world: World) -> None:
        """Let the garment settle, held by two grippers and then, if asked for, by one. Then swing it."""
        super().settle(world)
        if self._n_grippers == 1:
            world.release(keep=1)
            super().settle(world)
        random = np.random.default_rng(self.np_random_seed)
        self._first = int(random.uniform(0.3, 1.5) / self.config.frame_time)
        shove_angle, swing_angle = random.uniform(-np.pi, np.pi, 2)
        self._push = self._acceleration(self._shove, shove_angle)
        if self._swing:
            self._accelerate(world, self._acceleration(self._swing, swing_angle))
            for _ in range(PUSH * self.config.steps_per_frame):
                world.step(self.goal)
            self._accelerate(world, np.zeros(2))

    def step(self, action: Any) -> Any:
        """Begin or end the push, and simulate one frame."""
        if self._shove and self._steps in (self._first, self._first + PUSH):
            self._accelerate(self.world, self._push * (self._steps == self._first))
        return super().step(action)

    def _acceleration(self, speed: float, angle: float) -> NDArray[Any]:
        """Return the acceleration (2,) along x and y with which free cloth reaches a speed in a push."""
        return speed / (PUSH * self.config.frame_time) * np.array([np.cos(angle), np.sin(angle)])

    def _accelerate(self, world: World, by: NDArray[Any]) -> None:
        """Accelerate the cloth by (x, y) m/s^2 from now on."""
        world._bullet("setGravity", *by.tolist(), -self.config.GRAVITY)
