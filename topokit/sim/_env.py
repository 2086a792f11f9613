"""Hanging garments as a reinforcement-learning environment, with Gymnasium's interface.

    >>> import gymnasium
    >>> from topokit.sim import HangEnv  # makes the ids known to Gymnasium
    >>> env = gymnasium.make("topokit/HangApronHook-v1", reward="topological")

Source: Towers et al. 2024, *Gymnasium: a standard interface for reinforcement learning environments*; Ng, Harada and Russell
1999, *Policy invariance under reward transformations*. Taught in chapter 10.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from topokit.io import Episode
from topokit.sampling import farthest_point_sample

from ._camera import Camera
from ._episode import as_episode, is_at_rest, usual_config
from ._garments import Garment
from ._targets import Target
from ._tasks import TASKS, Task, resolved
from ._world import SimulationConfig, SimulationError, World, check_stretch

Observation = dict[str, Any]
_FARTHEST = 4.0  # metres: observed coordinates are clipped to this distance from the origin


class HangEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """Carry a garment to its target with two grippers, hang it there, and let go.

    Every task of `TASKS` has an id for `gymnasium.make`, known once this class is imported, which puts the target anywhere: the
    id of "apron2-hook" is "topokit/HangApron2Hook-v1".

    **Observation**: a dict of float32 arrays in metres, and of two whole numbers:

    - `points` (n_points, 3): a farthest-point sample of the vertices, or of what cameras see (while they see no cloth, the last);
    - `grippers` (2, 3): where the grippers are;
    - `target` (K, 3): the target's centre line;
    - `rods` (R, 7): the shapes of the target and of its stand, as capsules: start, end, radius;
    - `wanted` (L, 3): the middles of the loops that the task asks for, measured before the first step, as if pointed at;
    - `needed`: how many of the `wanted` loops must hang: all of them, or any one;
    - `held`: 1 until the grippers let go, then 0.

    **Action**: seven numbers from -1 to 1. The first six are the displacements of the two grippers' goals (x, y, z each), as
    shares of what 1.2 m/s allows in a step. The grippers let go for good when the seventh is above 0.5.

    **Reward**: 1 at success. With `reward="topological"` also the metres by which the task's loops came nearer to the target's
    seat in this step, and the change of the share of them that are around the target, by linking number.

    An episode **terminates** when the garment has been free for half a second and is at rest: with success if the task's
    loops are on the target, otherwise as dropped. It also terminates when the garment is torn, that is, stretched too far. It is
    **truncated** after `max_steps`. `info` holds `success`, `dropped`, `torn`, the share of loops that are `linked`, and their
    `distance` from the seat.

    Parameters
    ----------
    task : str or Task, optional
    garment, target : optional
        As in `simulate`.
    place : str, optional
        With "anywhere", every episode draws a place of the target, and the path to it: up to 0.4 m along x and y, 0.1 m along
        z, and any yaw.
    reward : str
        "sparse" or "topological".
    n_points : int, optional
        How many points are observed. When not given: 256, or all vertices if there are fewer.
    cameras : sequence of Camera
        The cameras that observe the cloth. Without any, the vertices are observed on all sides.
    config : SimulationConfig, optional
        When not given, that of `simulate` without self-collision. With self-collision a seed repeats the motion to a
        micrometre, but not bit by bit.
    max_steps : int
        A step takes `config.frame_time` seconds.
    """

    world: World

    def __init__(
        self,
        task: str | Task | None = None,
        *,
        garment: Garment | None = None,
        target: Target | None = None,
        place: Literal["anywhere"] | None = None,
        reward: Literal["sparse", "topological"] = "sparse",
        n_points: int | None = None,
        cameras: Sequence[Camera] = (),
        config: SimulationConfig | None = None,
        max_steps: int = 200,
    ) -> None:
        self.task, self.garment, self.target = resolved(task, garment, target)
        self.place = place
        self.reward = reward
        self.n_points = n_points or min(256, len(self.garment.vertices))
        self.cameras = tuple(cameras)
        self.config = config or replace(usual_config(self.garment), self_collision=False)
        self.max_step = 1.2 * self.config.frame_time  # metres, at 1.2 m/s along an axis
        self.max_steps = max_steps
        self.action_space = spaces.Box(-1.0, 1.0, (7,), np.float32)
        self._wanted_loops = list(self.task.wanted(self.garment.named_loops).values())
        self._needed = self.task.needed(self.garment.named_loops)
        n_wanted = len(self._wanted_loops)
        sizes = {"points": self.n_points, "grippers": 2, "target": len(self.target.centre_line), "wanted": n_wanted}
        shapes = {name: (size, 3) for name, size in sizes.items()} | {"rods": (len(self.target.rods), 7)}
        places = {name: spaces.Box(-_FARTHEST, _FARTHEST, shape, np.float32) for name, shape in shapes.items()}
        counts = {"needed": spaces.Discrete(n_wanted + 1), "held": spaces.Discrete(2)}
        self.observation_space = spaces.Dict({**places, **counts})

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Hang the garment between the grippers, at the start of a path.

        Parameters
        ----------
        seed : int, optional
            Seed of the place, the path and the noise; when not given, the generator goes on.
        options
            Not used.
        """
        super().reset(seed=seed)
        self.close()
        place_rng, _, self._camera_rng = self.np_random.spawn(3)
        x, y, z, yaw = (place_rng.uniform(-1, 1, 4) * (0.4, 0.4, 0.1, 180.0)).tolist()
        if self.place == "anywhere":
            self.target = replace(self.target, place=(x, y, z), yaw=yaw)
        self._path = self.task.path(self.garment, self.target, self.np_random)
        self.goal = self._path.at(0.0)
        # Hang the garment between the grippers, at the start of the path.
        garment = self.garment.turned(self._path.table["yaw"][0])
        offset = self.goal.mean(axis=0) - garment.vertices[garment.grips].mean(axis=0)
        self.world = World(garment, offset, self.config)
        self.world.add_rods(self.target.rods)
        self.settle(self.world)
        # Begin the record of the episode with its first frame.
        self._steps = 0
        self._release_step = -1
        self.vertices = self.world.vertices()
        self._cloud = np.resize(self.world.grippers(), (self.n_points, 3))
        self._wanted_places = np.array([self.vertices[loop].mean(axis=0) for loop in self._wanted_loops])
        observation = self._observe()
        self._seed = -1 if seed is None else seed
        self._record = [(self.vertices, observation["grippers"], self.goal, True)]
        info = {"success": False, "dropped": False, "torn": False}
        return observation, {**info, "linked": self._linked, "distance": self._distance}

    def settle(self, world: World) -> None:
        """Let the garment settle between the grippers before the first frame."""
        world.settle(self.goal)

    def step(self, action: ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Move the goals of the grippers, let go if the action says so, and simulate one frame."""
        world = self.world
        move = np.clip(np.asarray(action, np.float64), -1, 1)
        before = self.vertices
        linked_before = self._linked
        distance_before = self._distance
        if move[6] > 0.5 and self._release_step < 0:
            world.release()
            self._release_step = self._steps
        # Move the goals of the grippers, but keep them near the grippers: taut cloth holds a gripper back.
        start = self.goal
        grippers = world.grippers()
        self.goal = np.clip(start + self.max_step * move[:6].reshape(2, 3), grippers - 0.2, grippers + 0.2)
        # Simulate the steps of the frame, in which the goals move evenly.
        for share in np.arange(1, self.config.steps_per_frame + 1) / self.config.steps_per_frame:
            world.step(start + share * (self.goal - start))
        self._steps += 1
        self.vertices = world.vertices()
        torn = False
        try:
            check_stretch(self.garment, self.config, self.vertices, "")
        except SimulationError:
            torn = True
            self.vertices = before  # the last vertices that were not torn
        observation = self._observe()
        self._record.append((self.vertices, observation["grippers"], self.goal, self._release_step < 0))
        # The garment can be at rest half a second after the release: cloth that the target does not hold falls fast by then.
        frame_time = self.config.frame_time
        free = self._release_step >= 0 and (self._steps - self._release_step) * frame_time >= 0.5
        rests = not torn and free and is_at_rest(before, self.vertices, frame_time)
        success = rests and self.task.succeeds(self.vertices, self.garment.named_loops, self.target)
        reward = float(success)
        if self.reward == "topological":
            reward += distance_before - self._distance + self._linked - linked_before
        ends = rests or torn
        info: dict[str, Any] = {"success": success, "dropped": rests and not success, "torn": torn}
        info |= {"linked": self._linked, "distance": self._distance}
        return observation, reward, ends, not ends and self._steps >= self.max_steps, info

    def scripted_action(self) -> NDArray[np.float32]:
        """Return the next action along the scripted path of this episode, which usually succeeds as a demonstration."""
        time = (self._steps + 1) * self.config.frame_time
        move = (self._path.at(min(time, self._path.release)) - self.goal) / self.max_step
        let_go = 1.0 if time >= self._path.release else -1.0
        return np.append(np.clip(move, -1, 1), let_go).astype(np.float32)

    def episode(self, controller: str = "") -> Episode:
        """Return what has happened since `reset`, as `simulate` records an episode; its physics name the controller."""
        points, grippers, goals, held = (np.array(column) for column in zip(*self._record, strict=True))
        config = replace(self.config, frames=len(points))
        observed = np.array([frame[farthest_point_sample(frame, self.n_points)[0]] for frame in points])
        recording = {
            "points": points.astype(np.float32),
            "observed": observed.astype(np.float32),
            "grippers": grippers,
            "actions": goals.astype(np.float32),
            "held": held,
            "stretch": np.array([check_stretch(self.garment, config, frame, "hanging") for frame in points]),
        }
        notes = {"randomisation": None, "controller": controller}
        return as_episode(recording, self.task, self.garment, self.target, config, self._seed, notes)

    def close(self) -> None:
        """End the simulation; `reset` starts another."""
        if hasattr(self, "world"):
            self.world.close()

    def _observe(self) -> Observation:
        """Return the observation, and keep the linked share and the distance of this frame."""
        if self.cameras:
            cloud = self.world.observe(self.cameras, self.n_points, self._camera_rng)
            self._cloud = cloud if len(cloud) else self._cloud
        else:
            self._cloud = self.vertices[farthest_point_sample(self.vertices, self.n_points)[0]]
        curves = [self.vertices[loop] for loop in self._wanted_loops]
        linked = [self.target.holds(curve) for curve in curves]
        distances = [float(np.linalg.norm(curve.mean(axis=0) - self.target.seat)) for curve in curves]
        every = self.task.all_loops
        self._linked = sum(linked) / len(linked) if every else float(any(linked))
        self._distance = float(np.mean(distances)) if every else min(distances)
        places = {
            "points": self._cloud,
            "grippers": self.world.grippers(),
            "target": self.target.centre_line,
            "rods": np.array([[*start, *end, radius] for start, end, radius in self.target.rods]),
            "wanted": self._wanted_places,
        }
        clipped = {name: np.clip(place, -_FARTHEST, _FARTHEST).astype(np.float32) for name, place in places.items()}
        return {**clipped, "needed": self._needed, "held": int(self._release_step < 0)}


for _task in TASKS:
    _id = f"topokit/Hang{_task.title().replace('-', '')}-v1"
    gymnasium.register(_id, "topokit.sim:HangEnv", kwargs={"task": _task, "place": "anywhere"})
