"""Hang a garment in a closed loop: a controller observes, acts and observes again; the result is an ordinary episode."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from topokit.io import Episode
from topokit.sim import Garment, HangEnv, Hanger, Hook, Mannequin, Task

from ._planner import Planner
from ._servo import Servo


@dataclass(frozen=True, eq=False)
class Outcome:
    """The outcome of `hang`."""

    success: bool  #: the task's loops are on the target, and the garment, let go of, is at rest there
    linked: tuple[str, ...]  #: the garment's true loops that are around the target at the end, by their names
    reason: str  #: how the episode ended, in words
    steps: int  #: number of frames until the end
    seconds_a_decision: float  #: mean time that the controller takes for an action
    episode: Episode  #: the whole episode, to be saved, played and tracked


def hang(
    task: str | Task | gymnasium.Env[Any, Any] | None = None,
    *,
    seed: int = 0,
    garment: Garment | None = None,
    target: Hook | Hanger | Mannequin | None = None,
    model: str | Path | None = None,
    controller: Any = None,
    max_steps: int = 300,
    **options: Any,
) -> Outcome:
    """Hang a garment on a target by its observations, and return the outcome.

    Parameters
    ----------
    task : str, Task or gymnasium.Env, optional
        As in `topokit.sim.simulate`; or a `topokit.sim.HangEnv`, also in wrappers of Gymnasium.
    seed : int
        Seed of the environment, and of the controller's draws.
    garment, target : optional
        As in `topokit.sim.simulate`.
    model : str or Path, optional
        The forecast by which a `Planner` plans: "carry" for a rigid one, or the checkpoint of a model of motion. With None the
        `Servo` acts.
    controller : optional
        The controller that acts in place of these: an object with the members of a `Servo`, such as a `Planner` of your own.
    max_steps : int
        Frames after which the episode ends.
    **options
        Options of `topokit.sim.HangEnv`, such as ``place="anywhere"``.
    """
    if isinstance(task, gymnasium.Env):
        env = task
    else:
        env = HangEnv(task, garment=garment, target=target, max_steps=max_steps, **options)
    scene: HangEnv = env.unwrapped  # type: ignore[assignment]
    n_loops = scene.task.needed(scene.garment.named_loops) or 1
    sizes = {"radius": scene.target.rods[0][2], "max_step": scene.max_step}
    try:
        if controller is None and model is None:
            controller = Servo(n_loops, **sizes)
        elif model is not None and controller is None:
            forecast = None
            if str(model) != "carry":
                from topokit.models import Predictor

                forecast = Predictor.load(model)
            controller = Planner(forecast, n_loops, seed=seed, **sizes)
        return _run(env, scene, controller, seed, max_steps)
    finally:
        env.close()


def _run(env: gymnasium.Env[Any, Any], scene: HangEnv, controller: Any, seed: int, max_steps: int) -> Outcome:
    """Run an episode under a controller and return its outcome."""
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
            ends = terminated or truncated or len(seconds) >= max_steps
    episode = scene.episode(type(controller).__name__)
    loops = scene.garment.named_loops
    linked = tuple(name for name, loop in loops.items() if scene.target.holds(scene.vertices[loop]))
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
    return Outcome(bool(info["success"]), linked, reason, len(episode) - 1, float(np.mean(seconds)), episode)
