"""Hang a garment in a closed loop: a controller looks, acts, looks again, and what happened is an episode like any other.

Taught in chapter 7.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._validate import WrongKindError
from topokit.io import Episode
from topokit.sim import Garment, HangEnv, Hook, Target, Task, task_for
from topokit.sim._cloth import usual_config
from topokit.sim._episode import Run, _episode
from topokit.sim._tasks import as_task, asked, check_loops
from topokit.sim._world import check_stretch

from ._servo import Servo

_POINTS = 256  # that a controller sees, at most


class Controller(Protocol):
    """What `hang` asks of a controller: that it can begin, act, and say why it gives up."""

    reason: str  #: why it has given up, in words; empty while it has not

    def reset(self, observation: Mapping[str, Any]) -> None:
        """Forget everything; begin with a first observation.

        Parameters
        ----------
        observation : mapping
            As `topokit.sim.HangEnv` gives it.
        """

    def act(self, observation: Mapping[str, Any]) -> NDArray[np.float32]:
        """Return the next action (7,), as `topokit.sim.HangEnv` takes it.

        Parameters
        ----------
        observation : mapping
        """


@dataclasses.dataclass(frozen=True, eq=False)
class Hanging:
    """How it went."""

    success: bool  #: whether the task's loops are on the target, and the garment, let go of, is at rest there
    linked: tuple[str, ...]  #: the garment's true loops that are around the target at the end, by their names
    reason: str  #: how it ended, in words
    steps: int  #: frames until then
    seconds_a_decision: float  #: of the controller, on the mean
    episode: Episode  #: all of it, to be saved, played and tracked


def hang(
    task: str | Task | None = None,
    *,
    seed: int = 0,
    garment: Garment | None = None,
    target: Target | None = None,
    model: None = None,
    goal: ArrayLike | None = None,
    max_steps: int = 300,
    progress: bool = False,
) -> Hanging:
    """Hang a garment on a target by what is seen of it, and say how it went.

    Parameters
    ----------
    task : str or Task, optional
        A name in `topokit.sim.TASKS` or a task; when not given, the one of that garment and target. With neither of
        these, a tote is hung on a hook.
    seed : int
        Of where it starts.
    garment, target : optional
        Those of the task when not given.
    model : None
        The servo, which needs no forecast. There is nothing else yet.
    goal : optional
        Which loop shall hang, as `Servo` takes it. When not given, the one that is best to reach; as many at once as the task
        asks for, where it asks for several.
    max_steps : int
        Frames after which it is over.
    progress : bool
        Write the frames done to stderr.

    Raises
    ------
    ValueError
        When there is a model, or the garment has not the loops of the task.

    Examples
    --------
    >>> hang("tote-hook", seed=3).success  # doctest: +SKIP
    True
    """
    if model is not None:
        raise WrongKindError(
            f"model must be None, the servo, not {model!r:.80}: no controller plans with a forecast yet"
        )
    if task is None:
        task = task_for(garment or Garment.tote(), target or Hook())
    task = as_task(task)
    garment, target = garment or task.garment(), target or task.target
    check_loops(task, garment)
    config = dataclasses.replace(usual_config(garment), self_collision=False)
    n_points = min(_POINTS, len(garment.vertices))
    env = HangEnv(task, garment=garment, target=target, n_points=n_points, config=config, max_steps=max_steps)
    if goal is None and task.every:
        goal = len(asked(task, garment.named_loops))
    servo = Servo(goal, radius=max(radius for *_, radius in target.rods), max_step=env.max_step)
    try:
        return _run(env, servo, seed, progress)
    finally:
        env.close()


def _run(env: HangEnv, controller: Controller, seed: int, progress: bool) -> Hanging:
    observation, info = env.reset(seed=seed)
    controller.reset(observation)
    film, seconds, ends = [_frame(env, observation)], [], False
    while not ends:
        started = time.perf_counter()
        action = controller.act(observation)
        seconds.append(time.perf_counter() - started)
        if controller.reason:
            break
        observation, _, terminated, truncated, info = env.step(action)
        film.append(_frame(env, observation))
        ends = terminated or truncated
        if progress:
            print(f"\rhanging: frame {len(seconds)} of at most {env.max_steps}", end="", file=sys.stderr, flush=True)
    if progress:
        print(file=sys.stderr)
    there = env.target.at((len(film) - 1) * env.config.frame_time)
    linked = tuple(name for name, loop in env.garment.named_loops.items() if there.holds(film[-1][0][loop]))
    reason = controller.reason or _ending(info, film[-1][-1], env.max_steps)
    episode = _episode_of(film, env, type(controller).__name__, seed)
    return Hanging(bool(info["success"]), linked, reason, len(film) - 1, float(np.mean(seconds)), episode)


def _ending(info: Mapping[str, Any], held: bool, max_steps: int) -> str:
    if info["success"]:
        return "it hangs"
    if info["torn"]:
        return "the cloth was stretched too far"
    return f"it was not let go within {max_steps} frames" if held else "it was let go, and does not hang"


def _frame(env: HangEnv, observation: Mapping[str, Any]) -> tuple[Any, Any, Any, bool]:
    """What an episode keeps of a frame: vertices, grippers, their goals, whether they hold."""
    return env._points, observation["grippers"], env._goal, bool(observation["held"])


def _episode_of(film: list[tuple[Any, Any, Any, bool]], env: HangEnv, controller: str, seed: int) -> Episode:
    points, grippers, goals, held = (np.array(part) for part in zip(*film, strict=True))
    config = dataclasses.replace(env.config, frames=len(film))
    stretch = np.array([check_stretch(env.garment, config, frame, "hanging") for frame in points])
    goals, release = np.repeat(goals, config.steps_per_frame, axis=0), int(held.sum()) * config.steps_per_frame
    run = Run(env.garment, (), np.zeros((0, 0, 3)), goals, release, config, (), env.n_points, noise=0)
    recording = {"points": points.astype(np.float32), "grippers": grippers, "stretch": stretch}
    return _episode(run, recording, env.task, env.target, seed, {"randomisation": None, "controller": controller})
