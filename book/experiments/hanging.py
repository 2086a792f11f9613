"""Measure how often garments are hung in a closed loop, and how soon: book/results/hanging.json.

    python book/experiments/hanging.py

Takes many hours on two cores; `--help` tells how to ask for less.

Every controller gets the same starts: the target anywhere and at any yaw, the garment before it (`HangEnv`, place="anywhere").
Each episode is appended to the results when it is done, and not done again. Success is that of the environment: the task's true
loops are around the target when the garment is at rest there, let go of. Read *straight* first: where that succeeds, a success
proves nothing. *rigid* throws where the others do, and knows of no flight. *oracle* tries plans in the simulator itself, which no
robot has.
"""

import argparse
import itertools
import json
import sys
import time
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from disturbances import Faults, Pushed, Release
from scipy.stats import binomtest
from tqdm import tqdm

sys.path.append(str(Path(__file__).parents[2] / "notebooks"))
from chapter_tools.dressing import PullOver
from chapter_tools.throwing import Fence, Thrower
from topokit._archive import atomic_file
from topokit.control import Planner, Servo, hang
from topokit.models import Predictor
from topokit.sim import TASKS as KNOWN
from topokit.sim import Camera, SimulationConfig

GARMENTS = ("apron", "apron2", "tote", "tote2", "backpack", "mask", "sheet")
TASKS = [*(f"{garment}-{target}" for target in ("hook", "hanger") for garment in GARMENTS)]
TASKS += [f"{garment}-mannequin" for garment in ("shirt", "vest")]
WHO = ("random", "straight", "servo", "hold", "rigid", "carry", "motion", "script", "ppo", "oracle")
MOTION = Path(__file__).parents[2] / "data_small" / "checkpoints" / "motion.safetensors"
CAMERA = Camera((-1.3, -1.6, 1.6), (0.0, 0.3, 1.1), width=160, height=120)
TRIES = 8
# Options of the environment, of the wrappers in `disturbed`, and of the controllers (pace and cloud_delay).
SCENES: dict[str, dict[str, Any]] = {
    "still": {},
    "all vertices": {"n_points": 10_000},
    "128 points": {"n_points": 128},
    "one camera": {"cameras": [CAMERA]},
    "noise": {"faults": {"noise": 0.003, "keep": 0.9, "outliers": 0.02}},
    "shove": {"shove": 1.0},
    "let go at 1.2 s": {"release": 1.2, "pace": 1.0},
    "swings, let go at 1.2 s": {"swing": 2.0, "release": 1.2, "pace": 1.0},
    "one gripper": {"n_grippers": 1},
    "late by 200 ms": {"faults": {"delay": 6}, "cloud_delay": 6},
    "out of reach by 15 cm": {"fence": 0.15},
    "out of reach by 25 cm": {"fence": 0.25},
    "10 clouds a second": {"faults": {"interval": 3}},
    "other cloth": {"config": SimulationConfig(self_collision=False, mass=0.6, friction=0.3, bending=0.01)},
}


class Hold:
    """The forecast that the cloth stays where it is: `topokit.control.Planner` can be asked what that is worth."""

    def reset(self) -> None:
        """Do nothing: there is nothing to forget."""

    def observe(self, *_: Any) -> None:
        """Do nothing: there is nothing to take in."""

    def move(self, actions: Any, held: Any, points: Any) -> tuple[Any, None]:
        """Return the points as they are, at all frames of all plans."""
        return np.broadcast_to(np.asarray(points), (*np.shape(actions)[:2], *np.shape(points))), None


class Rigid(Thrower):
    """A planner that throws as if nothing flew: what is let go stays where it was."""

    def flight(self, held: Any, lasts: Any) -> Any:
        """Return the places at the release, at all frames of the flight."""
        return np.repeat(held[np.arange(len(held)), lasts - 1][:, None], 4, axis=1)


class Controller:
    """A controller that remembers nothing of the frames before."""

    reason = ""

    def reset(self, observation: Mapping[str, Any]) -> None:
        """Begin an episode."""


class Random(Controller):
    """A controller by chance: it draws a way for every half second, and lets go at some time."""

    def reset(self, observation: Mapping[str, Any]) -> None:
        """Begin an episode with draws of its own."""
        self._frame = 0
        self._random = np.random.default_rng(np.frombuffer(observation["grippers"].tobytes(), np.uint32))

    def act(self, observation: Mapping[str, Any]) -> Any:
        """Return the way of this half second."""
        if self._frame % 14 == 0:
            self._move = np.tile(self._random.uniform(-0.6, 0.6, 3), 2)
        self._frame += 1
        return np.append(self._move, float(self._random.random() < 1 / 60)).astype(np.float32)


class Straight(Controller):
    """A controller without loops: it moves the middle of the cloud to the middle of the arm, and lets go there."""

    def act(self, observation: Mapping[str, Any]) -> Any:
        """Return a step towards the arm."""
        line = np.asarray(observation["target"], np.float64)
        way = (line[-3] + line[-2]) / 2 - np.asarray(observation["points"], np.float64).mean(axis=0)
        arrived = np.linalg.norm(way) < 0.03
        move = np.clip(0.15 * way / 0.0432, -0.4, 0.4)
        return np.append(np.tile(move, 2), float(arrived)).astype(np.float32)


class Learned(Controller):
    """An agent of Stable-Baselines3 as it comes: PPO, rewarded by linking numbers, for so many steps on seeds below 1000."""

    def __init__(self, task: str, steps: int) -> None:
        self._agent = agent(task, steps)

    def act(self, observation: Mapping[str, Any]) -> Any:
        """Return the agent's action."""
        return self._agent.predict(dict(observation), deterministic=True)[0]


class Script(Controller):
    """The script, which is given mesh, loop and target: it acts in a twin of the environment."""

    def __init__(self, twin: Any, seed: int) -> None:
        self._twin = twin
        self._seed = seed

    def reset(self, observation: Mapping[str, Any]) -> None:
        """Begin the same episode in the twin."""
        self._twin.reset(seed=self._seed)

    def act(self, observation: Mapping[str, Any]) -> Any:
        """Return what the script does in the twin."""
        action = self._twin.unwrapped.scripted_action()
        self._twin.step(action)
        return action


class Starts(gymnasium.Wrapper):
    """Starts for learners: the seeds from 0 to 999 in a row, and again."""

    def __init__(self, env: Any) -> None:
        super().__init__(env)
        self._seeds = itertools.cycle(range(1000))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        return self.env.reset(seed=next(self._seeds), options=options)


@cache
def agent(task: str, steps: int) -> Any:
    """Return a trained agent; it is trained once for a task."""
    from stable_baselines3 import PPO  # pip install stable-baselines3

    name = "".join(part.capitalize() for part in task.split("-"))
    env = Starts(gymnasium.make(f"topokit/Hang{name}-v1", reward="topological"))
    try:
        return PPO("MultiInputPolicy", env, n_steps=1024, batch_size=256, seed=0, device="cpu").learn(steps)
    finally:
        env.close()


def disturbed(task: str, options: dict[str, Any]) -> Any:
    """Return the environment of a task with the disturbances of a scene."""
    wrappers = {"faults": lambda env, faults: Faults(env, **faults), "release": Release, "fence": Fence}
    own = {name: value for name, value in options.items() if name not in wrappers}
    env: Any = Pushed(task, place="anywhere", max_steps=300, **own)
    for name, wrapper in wrappers.items():
        if name in options:
            env = wrapper(env, options[name])
    return env


def run(task: str, who: str, scene: str, seed: int, steps: int = 0) -> Any:
    """Return the outcome of a controller in a scene, from the start of a seed."""
    options = dict(SCENES[scene])
    how = {"pace": options.pop("pace", 0.6), "cloud_delay": options.pop("cloud_delay", 0)}
    if "n_points" in options:
        options["n_points"] = min(options["n_points"], len(KNOWN[task].garment().vertices))
    if who == "oracle":
        return foreseen(task, seed, options, how)
    env = disturbed(task, options)
    if who == "script":
        twin = disturbed(task, options)
        try:
            return hang(env, seed=seed, controller=Script(twin, seed))
        finally:
            twin.close()
    how |= {"max_step": env.unwrapped.max_step, "seed": seed}
    if who == "ppo":
        controller: Any = Learned(task, steps)
    else:
        controller = controller_of(task, who, options.get("fence"), how)
    return hang(env, seed=seed, controller=controller)


def controller_of(task: str, who: str, fence: float | None, how: dict[str, Any]) -> Any:
    """Return a controller by its name; `how` has pace, delay of the clouds, largest step and seed."""
    if who == "straight":
        return Straight()
    if who == "random":
        return Random()
    if task.endswith("-mannequin"):
        return PullOver(max_step=how["max_step"])
    loops = needed(task)
    if who == "servo":
        return Servo(loops, radius=radius(task), cloud_delay=how["cloud_delay"])

    # The others plan with a forecast, or throw over a fence.
    forecast: Any = None
    if who == "hold":
        forecast = Hold()
    if who == "motion":
        forecast = Predictor.load(MOTION)
    if fence is None:
        return Planner(forecast, loops, radius=radius(task), **how)
    kind = Rigid if who == "rigid" else Thrower
    return kind(forecast, loops, fence=fence, radius=radius(task), **how)


def needed(task: str) -> int:
    """Return the number of loops that must hang."""
    return KNOWN[task].needed(KNOWN[task].garment().named_loops)


def radius(task: str) -> float:
    """Return the radius of the target's rods."""
    return KNOWN[task].target.rods[0][2]


def foreseen(task: str, seed: int, options: dict[str, Any], how: dict[str, Any]) -> Any:
    """Simulate a start with other draws of plans until one hangs, and return that one: the simulator as oracle.

    PyBullet cannot save and restore cloth, so that an oracle cannot be asked under way.
    """
    for draws in range(TRIES):
        planner = Planner(None, needed(task), radius=radius(task), seed=draws, **how)
        result = hang(disturbed(task, options), seed=seed, controller=planner)
        if result.success:
            break
    return result


def main() -> None:
    """Run the episodes that are missing, and print a line for every task, scene and controller."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tasks", nargs="+", default=TASKS)
    parser.add_argument("--who", nargs="+", choices=WHO, default=["straight", "servo", "carry", "motion"])
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=["still"])
    parser.add_argument("--starts", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1000, help="of the first start")
    parser.add_argument(
        "--steps", type=int, default=30_000, help="that ppo learns for, before its first episode of a task"
    )
    parser.add_argument("--out", type=Path, default=Path("book/results/hanging.json"))
    options = parser.parse_args()
    rows = []
    if options.out.exists():
        rows = json.loads(options.out.read_text())["episodes"]
    done = {(row["task"], row["who"], row["scene"], row["seed"]) for row in rows}
    seeds = range(options.seed, options.seed + options.starts)
    todo = [(t, w, s, n) for n in seeds for s in options.scenes for t in options.tasks for w in options.who]
    for task, who, scene, seed in tqdm([one for one in todo if one not in done], unit="episode"):
        began = time.perf_counter()
        result = run(task, who, scene, seed, options.steps)
        row = {"task": task, "who": who, "scene": scene, "seed": seed, "success": result.success}
        row |= {"frames": result.steps, "reason": result.reason, "linked": list(result.linked)}
        if who == "ppo":
            row["learned_for"] = options.steps
        row["decision_ms"] = round(1000 * result.seconds_a_decision, 1)
        rows.append(row | {"seconds": time.perf_counter() - began})
        with atomic_file(options.out) as file:
            file.write(json.dumps({"command": "python book/experiments/hanging.py", "episodes": rows}).encode())
    show(rows)


def show(rows: list[dict[str, Any]]) -> None:
    """Print a line for every task, scene and controller: successes with Wilson's 95 % interval, median of frames."""
    for key in sorted({(row["scene"], row["task"], row["who"]) for row in rows}):
        mine = [row for row in rows if (row["scene"], row["task"], row["who"]) == key]
        hung = [row["frames"] for row in mine if row["success"]]
        interval = binomtest(len(hung), len(mine)).proportion_ci(method="wilson")
        share = f"{len(hung):3d} of {len(mine):3d} ({100 * interval.low:3.0f} to {100 * interval.high:3.0f} %)"
        frames = ""
        if hung:
            frames = f"{np.median(hung):4.0f} frames"
        print(f"{key[0]:26} {key[1]:16} {key[2]:9} {share} {frames}")


if __name__ == "__main__":
    main()
