"""Hang a garment in a closed loop: a controller observes, acts and observes again; the result is an ordinary episode."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from topokit._progress import Progress
from topokit._validate import WrongKindError
from topokit.io import Episode
from topokit.linking import side_lengths
from topokit.sim import WARDROBE, Garment, HangEnv, Mannequin, Target, Task, explain

from ._dress import PullOverController, StrapController
from ._planner import Carried, MotionForecaster, Planner
from ._servo import Controller, Servo
from ._thrower import ThrowController

_POINTS = (256, 512)  # observed points: the usual number, and the largest


@dataclasses.dataclass(frozen=True, eq=False)
class Hanging:
    """The outcome of `hang`."""

    success: bool  #: the task's loops are on the target, and the garment, let go of, is at rest there
    linked: tuple[str, ...]  #: the garment's true loops that are around the target at the end, by their names
    reason: str  #: how the episode ended, in words
    steps: int  #: number of frames until the end
    seconds_a_decision: float  #: mean time that the controller takes for an action
    episode: Episode  #: the whole episode, to be saved, played and tracked


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
    """Hang a garment on a target by its observations, and return the outcome.

    Parameters
    ----------
    task : str or Task, optional
        As in `topokit.sim.simulate`. When neither a task nor a garment is given, a tote is hung.
    seed : int
        Seed of the environment, and of the controller's draws.
    garment, target : optional
        The garment and the target of the task when not given.
    model : optional
        The forecaster with which `Planner` plans (`ThrowController` when there is a `fence`): "carry", the checkpoint of a
        `topokit.models.Motion`, or an object with the methods of `Carried`. With None the `Servo` acts, which needs no forecast.
        A garment that is worn is put on a mannequin by `PullOverController` or `StrapController`, which need no forecast
        either.
    goal : optional
        As in `Servo`; when not given, as many loops at once as the task asks for.
    controller : Controller, optional
        The controller that acts in place of these.
    pace : float
        As in `Planner`; other controllers do not use it.
    max_steps : int
        Frames after which the episode ends.
    progress : bool
        Write the number of frames done to stderr.
    **options
        Options of `topokit.sim.HangEnv`, such as ``place="anywhere"``: place, disturbances and observation.

    Raises
    ------
    TypeError, ValueError
        When the model does not forecast motion, an option is not known, or the garment lacks loops of the task.
    """
    forecast = _forecast(model)
    if task is None and garment is None:
        garment = WARDROBE["tote"]()
    elif garment is not None:
        options.setdefault("n_points", _points_that_show(garment))
    env = HangEnv(task, garment=garment, target=target, max_steps=max_steps, **options)
    try:
        if controller is None:
            controller = _usual(env, forecast, goal, pace, seed, options)
        return _run(env, controller, seed, progress)
    finally:
        env.close()


def _points_that_show(garment: Garment) -> int:
    """Return how many observed points show the loop to hang a garment by: twelve around it, between the usual 256 and 512."""
    if garment.hanging_loop is None:
        return min(_POINTS[0], len(garment.vertices))
    spacing = float(side_lengths(garment.vertices[garment.hanging_loop]).sum()) / 12
    return min(int(np.clip(garment.area / spacing**2, *_POINTS)), len(garment.vertices))


def _usual(
    env: HangEnv,
    forecast: MotionForecaster | None,
    goal: ArrayLike | None,
    pace: float,
    seed: int,
    options: dict[str, Any],
) -> Servo:
    """Return the usual controller of a task."""
    shared = {"max_step": env.max_step, "cloud_delay": options.get("cloud_delay", 0)}
    # A garment that is worn is put on a mannequin, whatever the goal and the model.
    if env.task.all_loops and env.target.name == Mannequin.name:
        if {"neck", "hem"} <= {*env.task.loops}:
            return PullOverController(**shared)
        if all(loop.startswith("strap") for loop in env.task.loops):
            return StrapController(**shared)
    # Any other garment is hung: by the servo, by plans, or by a throw over a fence.
    if goal is None:
        goal = env.task.needed(env.garment.named_loops) or None
    shared["radius"] = env.target.rods[0][2]
    if forecast is None:
        return Servo(goal, **shared)
    if options.get("fence"):
        frame_time = env.config.frame_time
        return ThrowController(forecast, goal, fence=options["fence"], frame_time=frame_time, seed=seed, **shared)
    return Planner(forecast, goal, pace=pace, seed=seed, **shared)


def _forecast(model: Any) -> MotionForecaster | None:
    """Return the forecaster for the argument `model` of `hang`."""
    if model == "carry":
        return Carried()
    if isinstance(model, str | Path):
        from topokit.models import Predictor

        model = Predictor.load(model)
    if model is not None and not callable(getattr(model, "move", None)):
        kinds = "None for the servo, 'carry', the checkpoint of a motion model, or a forecaster with the method `move`"
        raise WrongKindError(f"model must be {kinds}, not {model!r:.80}")
    return model


def _run(env: HangEnv, controller: Controller, seed: int, progress: bool) -> Hanging:
    """Run an episode under a controller and return its outcome."""
    observation, info = env.reset(seed=seed)
    controller.reset(observation)
    seconds: list[float] = []
    ends = False
    show = Progress("hanging", f"of at most {env.max_steps}")
    while not ends:
        started = time.perf_counter()
        action = controller.act(observation)
        seconds.append(time.perf_counter() - started)
        ends = bool(controller.reason)
        if not ends:
            observation, _, terminated, truncated, info = env.step(action)
            ends = terminated or truncated
        if progress:
            show(len(seconds), ends)
    # Record the outcome, and how the episode ended.
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
        reason = f"it was let go, and does not hang: {explain(episode, env.task, env.standing)}"
    return Hanging(bool(info["success"]), linked, reason, len(episode) - 1, float(np.mean(seconds)), episode)
