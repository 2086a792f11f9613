"""Hang a garment in a closed loop: a controller looks, acts, looks again; what happened is an episode like any other."""

from __future__ import annotations

import dataclasses
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from topokit._validate import WrongKindError
from topokit.io import Episode
from topokit.sim import Garment, HangEnv, Hook, Target, Task, task_for
from topokit.sim._cloth import usual_config
from topokit.sim._episode import Run, _episode
from topokit.sim._tasks import as_task, dress, how_many, put_on_shoulders
from topokit.sim._world import check_stretch

from ._dress import PullOverController, StrapController
from ._planner import Carried, MotionForecaster, Planner
from ._servo import Controller, Servo
from ._thrower import ThrowController

_WORN: dict[Any, type[Servo]] = {dress: PullOverController, put_on_shoulders: StrapController}


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
    model: Any = None,
    goal: ArrayLike | None = None,
    controller: Controller | None = None,
    pace: float = 0.6,
    max_steps: int = 300,
    progress: bool = False,
    **options: Any,
) -> Hanging:
    """Hang a garment on a target by what is seen of it, and say how it went.

    Parameters
    ----------
    task : str or Task, optional
        As of `topokit.sim.simulate`; a tote is hung on a hook when neither this nor what follows is given.
    seed : int
        Of where it starts.
    garment, target : optional
        Those of the task when not given.
    model : optional
        Which forecast plans are made by (`Planner`, or with a `fence` `ThrowController`): "carry", the checkpoint of a
        `topokit.models.Motion`, or one of one's own.
        None is for the servo, which needs none; so do `PullOverController` and `StrapController`, which put on a mannequin
        what is worn.
    goal : optional
        As of `Servo`; when not given and the task asks for several loops, so many at once.
    controller : Controller, optional
        One of one's own, in place of those.
    pace : float
        As of `Planner`, for those that plan.
    max_steps : int
        Frames after which it is over.
    progress : bool
        Write the frames done to stderr.
    **options
        Where the target stands, what disturbs, what is seen: those of `topokit.sim.HangEnv`, as ``place="anywhere"``.

    Raises
    ------
    TypeError, ValueError
        When the model forecasts no motion, an option is not known, or the garment has not the loops of the task.
    """
    forecast = _forecast(model)
    task = task_for(garment or Garment.tote(), target or Hook()) if task is None else as_task(task)
    garment, target = garment or task.garment(), target or task.target
    usual = {
        "n_points": min(256, len(garment.vertices)),
        "config": dataclasses.replace(usual_config(garment), self_collision=False),
    }
    env = HangEnv(task, garment=garment, target=target, max_steps=max_steps, **{**usual, **options})
    goal = how_many(task, garment) if goal is None else goal
    try:
        how = {"radius": target.rods[0][2], "max_step": env.max_step, "cloud_delay": options.get("cloud_delay", 0)}
        usually: Servo = _WORN.get(task.plan, Servo)(goal, **how)
        if forecast is not None and type(usually) is Servo:
            usually = Planner(forecast, goal, pace=pace, seed=seed, **how)
            if fence := options.get("fence"):
                usually = ThrowController(
                    forecast, goal, fence=fence, frame_time=env.config.frame_time, seed=seed, **how
                )
        return _run(env, controller or usually, seed, progress)
    finally:
        env.close()


def _forecast(model: Any) -> MotionForecaster | None:
    """The forecast that was asked for."""
    if model == "carry":
        return Carried()
    if isinstance(model, str | Path):
        from topokit.models import Predictor

        model = Predictor.load(model)
    if model is not None and not callable(getattr(model, "move", None)):
        ways = "None for the servo, 'carry', the checkpoint of a motion model, or a forecast that has `move`"
        raise WrongKindError(f"model must be {ways}, not {model!r:.80}")
    return model


def _run(env: HangEnv, controller: Controller, seed: int, progress: bool) -> Hanging:
    observation, info = env.reset(seed=seed)
    controller.reset(observation)
    film, seconds, ends = [(env.vertices, observation["grippers"], env.goal, True)], [], False
    while not ends:
        started = time.perf_counter()
        action = controller.act(observation)
        seconds.append(time.perf_counter() - started)
        ends = bool(controller.reason)
        if not ends:
            observation, _, terminated, truncated, info = env.step(action)
            film.append((env.vertices, observation["grippers"], env.goal, bool(observation["held"])))
            ends = terminated or truncated
        if progress:
            words = f"\rhanging: frame {len(film)} of at most {env.max_steps}"
            print(words, end="\n" * ends, file=sys.stderr, flush=True)
    points, grippers, goals, held = (np.array(part) for part in zip(*film, strict=True))
    config, steps = dataclasses.replace(env.config, frames=len(film)), env.config.steps_per_frame
    release, nothing = int(held.sum()) * steps, np.zeros((0, 0, 3))
    run = Run(env.garment, (), nothing, np.repeat(goals, steps, axis=0), release, config, (), env.n_points, noise=0)
    stretch = np.array([check_stretch(env.garment, config, frame, "hanging") for frame in points])
    recording = {"points": points.astype(np.float32), "grippers": grippers, "stretch": stretch}
    told = {"randomisation": None, "controller": type(controller).__name__}
    episode = _episode(run, recording, env.task, env.standing, seed, told, first=0)
    linked = tuple(name for name, loop in env.garment.named_loops.items() if env.standing.holds(points[-1][loop]))
    reason = "it was not let go in time" if held[-1] else "it was let go, and does not hang"
    reason = "it hangs" if info["success"] else "the cloth was stretched too far" if info["torn"] else reason
    outcome = (bool(info["success"]), linked, controller.reason or reason)
    return Hanging(*outcome, len(film) - 1, float(np.mean(seconds)), episode)
