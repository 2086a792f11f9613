"""Hang a garment in a closed loop: a controller observes, acts, and observes again; the result is an episode like any other."""

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
from topokit.sim import Garment, HangEnv, Mannequin, Target, Task

from ._dress import PullOverController, StrapController
from ._planner import Carried, MotionForecaster, Planner
from ._servo import Controller, Servo
from ._thrower import ThrowController


@dataclasses.dataclass(frozen=True, eq=False)
class Hanging:
    """The outcome of `hang`."""

    success: bool  #: the task's loops are on the target, and the garment, let go of, is at rest there
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
    """Hang a garment on a target by what is seen of it, and return the outcome.

    Parameters
    ----------
    task : str or Task, optional
        As of `topokit.sim.simulate`; a tote is hung on a hook when neither this nor what follows is given.
    seed : int
        Of where it starts.
    garment, target : optional
        Those of the task when not given.
    model : optional
        The forecaster that plans are made by (`Planner`, or with a `fence` `ThrowController`): "carry", the checkpoint of a
        `topokit.models.Motion`, or an object with the methods of `Carried`. With None the `Servo` acts, which needs none. What
        is worn is put on a mannequin by `PullOverController` or `StrapController`, which need none either.
    goal : optional
        As of `Servo`; when not given, as many loops at once as the task asks for.
    controller : Controller, optional
        Acts in place of those.
    pace : float
        As of `Planner`, for those that plan.
    max_steps : int
        Frames after which the episode ends.
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
    if task is None and garment is None:
        garment = Garment.tote()
    env = HangEnv(task, garment=garment, target=target, max_steps=max_steps, **options)
    try:
        if controller is None:
            controller = _usual(env, forecast, goal, pace, seed, options)
        return _run(env, controller, seed, progress)
    finally:
        env.close()


def _usual(
    env: HangEnv,
    forecast: MotionForecaster | None,
    goal: ArrayLike | None,
    pace: float,
    seed: int,
    options: dict[str, Any],
) -> Servo:
    """Return the usual controller of a task."""
    how = {"max_step": env.max_step, "cloud_delay": options.get("cloud_delay", 0)}
    # What is worn is put on a mannequin, whatever the goal and the model.
    if env.task.all_loops and env.target.name == Mannequin.name:
        if {"neck", "hem"} <= {*env.task.loops}:
            return PullOverController(**how)
        if all(loop.startswith("strap") for loop in env.task.loops):
            return StrapController(**how)
    # Everything else is hung: by the servo, by plans, or by a throw over a fence.
    if goal is None:
        goal = env.task.needed(env.garment.named_loops) or None
    how["radius"] = env.target.rods[0][2]
    if forecast is None:
        return Servo(goal, **how)
    if options.get("fence"):
        frame_time = env.config.frame_time
        return ThrowController(forecast, goal, fence=options["fence"], frame_time=frame_time, seed=seed, **how)
    return Planner(forecast, goal, pace=pace, seed=seed, **how)


def _forecast(model: Any) -> MotionForecaster | None:
    """Return the forecaster for a model, given as `hang` takes it."""
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
    """Return what becomes of a garment under a controller."""
    observation, info = env.reset(seed=seed)
    controller.reset(observation)
    seconds: list[float] = []
    ends = False
    while not ends:
        started = time.perf_counter()
        action = controller.act(observation)
        seconds.append(time.perf_counter() - started)
        ends = bool(controller.reason)
        if not ends:
            observation, _, terminated, truncated, info = env.step(action)
            ends = terminated or truncated
        if progress:
            words = f"\rhanging: frame {len(seconds)} of at most {env.max_steps}"
            print(words, end="\n" * ends, file=sys.stderr, flush=True)
    # What came of it.
    episode = env.episode(type(controller).__name__)
    loops = env.garment.named_loops
    linked = tuple(name for name, loop in loops.items() if env.standing.holds(env.vertices[loop]))
    if controller.reason:
        reason = controller.reason
    elif info["success"]:
        reason = "it hangs"
    elif info["torn"]:
        reason = "the cloth was stretched too far"
    elif observation["held"]:
        reason = "it was not let go in time"
    else:
        reason = "it was let go, and does not hang"
    return Hanging(bool(info["success"]), linked, reason, len(episode) - 1, float(np.mean(seconds)), episode)
