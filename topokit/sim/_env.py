"""Hanging garments as a reinforcement-learning environment, with Gymnasium's interface.

    >>> import gymnasium, topokit.sim
    >>> env = gymnasium.make("topokit/HangApronHook-v1", reward="topological")

Source: Towers et al. 2024, *Gymnasium: a standard interface for reinforcement learning environments*; Ng, Harada and Russell
1999, *Policy invariance under reward transformations*. Taught in chapter 8.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Annotated, Any, Literal

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, ValidationError, ValidatorFunctionWrapHandler, WrapValidator

from topokit._config import NotNegative, as_tuple, checked
from topokit._validate import as_reals, whole
from topokit.io import Episode
from topokit.rips import rips_persistence
from topokit.sampling import farthest_point_sample, spoil

from ._camera import Camera
from ._cloth import usual_config
from ._episode import AT_REST, Run, as_episode, rods_of
from ._garments import Garment
from ._path import from_elsewhere
from ._surface import Array, simple_cycles
from ._targets import Moving, Placed, Target, Travelling
from ._tasks import PathScript, Task, check_loops, planned, resolved
from ._world import SimulationConfig, SimulationError, World, check_stretch

Observation = dict[str, Any]
REWARDS = ("sparse", "dense", "topological", "topological-observed")
_ROOM = 4.0  # metres: nothing that is observed is farther from the origin along an axis
_SPEED = 1.2  # m/s of the grippers' goals along each axis, at most
_LEASH = 0.2  # metres by which a goal may lead its gripper along an axis: taut cloth holds a gripper back
_REST_AFTER = 0.5  # s after the release: cloth that is not held by the target is fast by then


_AWAY = (0.4, 0.4, 0.1, 180.0)  # metres along x, y and z, and degrees: as far at most is "anywhere"
_SOON = (0.3, 1.5)  # seconds after the first frame between which a target sets off and a push begins
_MOVING, _PUSHING = 0.6, 0.1  # seconds that they take


def _somewhere(value: Any, check: ValidatorFunctionWrapHandler) -> Any:
    try:
        return check(as_tuple(value))
    except ValidationError as error:
        raise ValueError("must be 'anywhere', or x, y and z in metres and a yaw in degrees") from error


@checked
class Options:
    """What `HangEnv` takes as keywords for all its episodes, and `reset` as options for one."""

    place: Annotated[tuple[float, float, float, float] | Literal["anywhere"] | None, WrapValidator(_somewhere)] = None
    start: Literal["anywhere"] | None = None
    target_shift: NotNegative = 0.0
    shove: NotNegative = 0.0
    cloud_delay: Annotated[int, Field(ge=0)] = 0
    noise: NotNegative = 0.0
    dropout: Annotated[float, Field(ge=0, lt=1)] = 0.0
    outliers: Annotated[float, Field(ge=0, le=1)] = 0.0
    release_after: NotNegative = 0.0
    swing: NotNegative = 0.0
    target_speed: NotNegative = 0.0
    fence: NotNegative = 0.0
    n_grippers: Annotated[int, Field(ge=1, le=2)] = 2
    cloud_interval: Annotated[int, Field(ge=1)] = 1

    def scene(self, target: Target, frame_time: float, rng: np.random.Generator) -> tuple[Target, range, Array, Array]:
        """The target, the frames and the acceleration (x, y) of the push, and that of the swing, which takes as many frames.

        All is drawn, whether or not it is asked for.
        """
        place, way = rng.uniform(-1, 1, 4) * _AWAY, rng.normal(size=3)
        way *= self.target_shift * np.cbrt(rng.random()) / np.linalg.norm(way)  # anywhere in a ball
        sets_off, begins = rng.uniform(*_SOON, 2).tolist()
        pushed, swung, gone = (np.array([np.cos(a), np.sin(a)]) for a in rng.uniform(-np.pi, np.pi, 3))
        if self.target_shift:  # to where it stands otherwise: what is planned stays as it is
            x, y, z = way.tolist()
            target = Moving(Placed(target, -x, -y, -z), x, y, z, start=sets_off, seconds=_MOVING)
        if self.target_speed:
            vx, vy = (self.target_speed * gone).tolist()
            target = Travelling(target, vx=vx, vy=vy)
        if self.place is not None:
            target = Placed(target, *(place.tolist() if self.place == "anywhere" else self.place))
        first, frames = round(begins / frame_time), max(1, round(_PUSHING / frame_time))
        push, swing = self.shove * pushed, self.swing * swung
        return target, range(first, first + frames), push / (frames * frame_time), swing / (frames * frame_time)

    def before_fence(self, goal: Array, before: Array, target: Target) -> Array:
        """A goal (2, 3) of the grippers, or the nearest one before the fence; who was behind it already may not go on."""
        if not self.fence:
            return goal
        tip = target.centre_line[-1]
        out = (tip - target.seat) * [1, 1, 0]
        far = float(np.linalg.norm(out))
        if far < 1e-6:
            raise ValueError("fence: it stands before an arm, and this target has none that runs sideways")
        here, there = ((hands - tip) @ out / far for hands in (before, goal))
        return np.asarray(goal + np.maximum(np.minimum(here, self.fence) - there, 0)[:, None] * out / far)

    def plan(self, plan: PathScript, rng: np.random.Generator) -> PathScript:
        """A task's plan, from the start that is asked for."""
        return plan if self.start is None else lambda g, t, own: from_elsewhere(plan(g, t, own), g, t, rng)


class HangEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """Carry a garment to its target with two grippers, hang it there, let go.

    Every task of `TASKS` has an id for `gymnasium.make`: that of "apron2-hook" is "topokit/HangApron2Hook-v1", with the
    target anywhere. A seed gives the same start to every agent as long as the version of the id is the same.

    **Observation**, a dict of float32 arrays in metres, and of two numbers:

    - `points` (n_points, 3): farthest-point samples of the garment's vertices, or of what the cameras see of it. While they
      see none of it: the last that they saw, and before that the grippers;
    - `grippers` (2, 3): where the grippers are;
    - `target` (K, 3): the target's centre line;
    - `rods` (R, 7): its shape and that of all that stands about it, capsules: start, end, radius;
    - `wanted` (L, 3): the middles of the loops that the task asks for, before the first step: somebody points at them;
    - `needed`: how many of these must hang: all of them, or one, whichever it is;
    - `held`: 1 until the release, then 0.

    **Action**, seven numbers from -1 to 1: the displacements of the first and of the second gripper's goal (x, y, z each) as
    shares of what 1.2 m/s allows in a step; the garment is let go, for good, when the last is above 0.5.

    **Reward**: 1 at success, and by `reward` differences of a potential, so that going back and forth earns nothing:

    - `"sparse"`: nothing else;
    - `"dense"`: the metres by which the task's loop came nearer to the target's seat in this step;
    - `"topological"`: also the change of the share of the task's loops that are around the target, by linking number;
    - `"topological-observed"`: the same for the longest-lived loops of the observed points, as many as the garment has.

    An episode **terminates** when the garment has been free for half a second and is at rest, with success if the task's
    loops are on the target (else it was dropped), and when it is torn: stretched too far. It is **truncated** after
    `max_steps`. `info` holds `success`, `dropped`, `torn`, and the `linked` share and the `distance` of the potential.

    **Options** are keywords here, for all episodes, and entries of `reset(options={...})` for one. What they leave open is
    drawn by the seed, for each apart from the others. Moves and shoves begin 0.3 to 1.5 s after the first step. The last five
    spoil `points` alone: success is judged on the vertices.

    ================ ========== ========================================================================================
    option           usual      what it does
    ================ ========== ========================================================================================
    `place`          None       takes the target, and all that goes to it, to (x, y, z, yaw), metres and degrees about
                                the z axis, or "anywhere": up to 0.4 m along x and y, 0.1 m along z, any yaw
    `start`          None       "anywhere": the garment starts 0.5 to 1 m before or beside the target, at any yaw
    `target_shift`   0.0        metres from which, at most, the target comes to its place, within 0.6 s
    `target_speed`   0.0        m/s of the target, level and steady; "at rest" is then relative to it
    `shove`          0.0        m/s that a push sideways, of 0.1 s, would give to free cloth
    `swing`          0.0        m/s of such a push just before the first observation
    `n_grippers`     2          grippers that hold the garment; with 1 the second lets go before the first observation
    `fence`          0.0        metres before the tip of an arm that the grippers cannot pass: they may throw
    `release_after`  0.0        seconds after which the grippers let go, whatever the action says; 0 for never
    `cloud_delay`    0          steps by which `points` are late; the first cloud stays until then
    `cloud_interval` 1          steps from one new cloud to the next
    `noise`          0.0        metres, the standard deviation of each coordinate of a point
    `dropout`        0.0        share of points that are lost; repeats of others take their place
    `outliers`       0.0        share of points that are anywhere in the cloud's box, grown by 10 cm on each side
    ================ ========== ========================================================================================

    `vertices` (V, 3), `goal` (2, 3) of the grippers, and `standing`, the target where it is now, are for who records, not agents.

    Parameters
    ----------
    task : str or Task, optional
    garment, target : optional
        As of `simulate`.
    reward : str
    n_points : int, optional
        At most the garment's vertices; 256, or all of them if fewer, when not given.
    cameras : sequence of Camera
        What the observer has; without any it sees the vertices on all sides.
    config : SimulationConfig, optional
        When not given that of `simulate`, but without self-collision: with it, a seed repeats to a micrometre but not bit by
        bit.
    max_steps : int
        A step takes `config.frame_time` seconds.
    render_mode : str, optional
        `"rgb_array"`: `render()` gives a picture (360, 480, 3) uint8.
    **options
        See above.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 28}  # noqa: RUF012

    def __init__(
        self,
        task: str | Task | None = None,
        *,
        garment: Garment | None = None,
        target: Target | None = None,
        reward: str = "sparse",
        n_points: int | None = None,
        cameras: Sequence[Camera] = (),
        config: SimulationConfig | None = None,
        max_steps: int = 200,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        if reward not in REWARDS:
            raise ValueError(f"reward must be one of {', '.join(REWARDS)}, not {reward!r}")
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode must be None or 'rgb_array', not {render_mode!r}")
        self._usual = Options(**options)
        self.task, self.garment, self._described = resolved(task, garment, target)
        self.target = self._described
        check_loops(self.task, self.garment)
        self.config = config or replace(usual_config(self.garment), self_collision=False)
        n_vertices = len(self.garment.vertices)
        self.n_points = min(256, n_vertices) if n_points is None else whole(n_points, "n_points", 1, n_vertices)
        self.reward, self.cameras, self.render_mode = reward, tuple(cameras), render_mode
        self.max_step = _SPEED * self.config.frame_time
        self.max_steps = whole(max_steps, "max_steps", 1)
        self._world: World | None = None
        self.action_space = spaces.Box(-1.0, 1.0, (7,), np.float32)
        self._asked = list(self.task.wanted(self.garment.named_loops).values())
        n = len(self._asked)
        self._needed = self.task.needed(self.garment.named_loops)
        sizes = {"points": self.n_points, "grippers": 2, "target": len(self.target.centre_line), "wanted": n}
        places = {name: spaces.Box(-_ROOM, _ROOM, (size, 3), np.float32) for name, size in sizes.items()}
        places["rods"] = spaces.Box(-_ROOM, _ROOM, (len(self.target.rods), 7), np.float32)
        counts = {"needed": spaces.Discrete(n + 1), "held": spaces.Discrete(2)}
        self.observation_space = spaces.Dict({**places, **counts})

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Hang the garment between the grippers, at the start of a path.

        Parameters
        ----------
        seed : int, optional
            That the path is drawn with; the generator goes on when not given.
        options : dict, optional
            For this episode, in place of the environment's own; a ValueError tells what is not known or cannot be.
        """
        now = Options(**{**asdict(self._usual), **(options or {})})
        now.before_fence(np.zeros((2, 3)), np.zeros((2, 3)), self._described)  # or it has no arm
        super().reset(seed=seed)
        self.close()
        drawn, start, self._sensor = self.np_random.spawn(3)
        self.target, self._frames, self._push, swing = now.scene(self._described, self.config.frame_time, drawn)
        task = replace(self.task, plan=now.plan(self.task.plan, start))
        self._path = planned(task, self.garment, self.target, self.np_random)
        self.goal = self._path.at(0.0)
        garment = self.garment.turned(self._path.vias[0].yaw)
        offset = self.goal.mean(axis=0) - garment.vertices[garment.grips].mean(axis=0)
        self._world = World(garment, offset, self.config)
        self._rods, self.standing = self.target.at(0.0).rods, self.target.at(0.0)
        self._world.add_rods(self._rods)
        for n_grippers in range(2, now.n_grippers - 1, -1):
            self._world.release(keep=n_grippers)
            for _ in range(round(self.config.settle / self.config.dt)):
                self._world.step(self.goal)
        if swing.any():
            self._world.push(swing)
            for _ in range(len(self._frames) * self.config.steps_per_frame):
                self._world.step(self.goal)
            self._world.push(0 * swing)
        self._steps, self._released = 0, -1
        self.vertices, self._options = self._world.vertices(), now
        self._cloud, self._clouds = self._world.grippers(), deque[Array](maxlen=now.cloud_delay + 1)
        self._wanted = np.array([self.vertices[loop].mean(axis=0) for loop in self._asked]).reshape(-1, 3)
        observation = self._observe()
        self._seed = -1 if seed is None else seed
        self._film = [(self.vertices, observation["grippers"], self.goal, True)]
        return observation, self._info()

    def step(self, action: ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Move the goals of the grippers, and let go if told to; simulate one frame.

        Raises
        ------
        ValueError
            When the action is not seven finite numbers.
        """
        self._running()
        move = as_reals(action, "action").astype(np.float64)
        if move.shape != (7,) or not np.isfinite(move).all():
            raise ValueError(f"an action is seven finite numbers, not {action!r}")
        points, linked, distance, there = self.vertices, self._linked, self._distance, self.standing
        self._advance(self.max_step * np.clip(move[:6], -1, 1).reshape(2, 3), release=move[6] > 0.5)
        torn = False
        try:
            check_stretch(self.garment, self.config, self.vertices, f"step {self._steps}")
        except SimulationError:
            torn, self.vertices = True, points  # the last that made sense
        observation = self._observe()
        self._film.append((self.vertices, observation["grippers"], self.goal, self._released < 0))
        gone = self.standing.seat - there.seat if self._options.target_speed else np.zeros(3)
        speed = np.linalg.norm(self.vertices - points - gone, axis=1).mean() / self.config.frame_time
        free = self._released >= 0 and (self._steps - self._released) * self.config.frame_time >= _REST_AFTER
        rests = not torn and free and speed < AT_REST
        hangs = rests and self.task.hangs(self.vertices, self.garment.named_loops, self.standing)
        reward = float(hangs)
        if self.reward != "sparse":
            reward += distance - self._distance
        if self.reward.startswith("topological"):
            reward += self._linked - linked
        ends = rests or torn
        info = self._info(success=hangs, dropped=rests and not hangs, torn=torn)
        return observation, reward, ends, not ends and self._steps >= self.max_steps, info

    def _advance(self, move: Array, release: bool) -> None:
        world, limit = self._running(), self._options.release_after
        if self._released < 0 and (release or 0 < limit <= self._steps * self.config.frame_time):
            world.release()
            self._released = self._steps
        if self._push.any():
            world.push(self._push * (self._steps in self._frames))
        before, here = self.goal, world.grippers()
        self.goal = self._options.before_fence(
            np.clip(before + move, here - _LEASH, here + _LEASH), before, self.standing
        )
        _, moves = rods_of(self.target, (self._steps + np.arange(2)) * self.config.frame_time)
        self.standing = self.target.at((self._steps + 1) * self.config.frame_time)
        gone = np.array([start for start, *_ in self.standing.rods]) - [start for start, *_ in self._rods]
        for share in np.arange(1, self.config.steps_per_frame + 1) / self.config.steps_per_frame:
            if len(moves):
                world.move_rods(gone - (1 - share) * moves[1])
            world.step(before + share * (self.goal - before))
        self._steps += 1
        self.vertices = world.vertices()

    def scripted_action(self) -> NDArray[np.float32]:
        """Return the next action of the scripted path of this episode: a demonstration that usually succeeds."""
        self._running()
        time = (self._steps + 1) * self.config.frame_time
        move = (self._path.at(min(time, self._path.release)) - self.goal) / self.max_step
        let_go = 1.0 if time >= self._path.release else -1.0
        return np.append(np.clip(move, -1, 1), let_go).astype(np.float32)

    def episode(self, controller: str = "") -> Episode:
        """Return what has happened since `reset`, as `simulate` records an episode.

        Parameters
        ----------
        controller : str
            The name of what acted, which is noted in the episode's physics.
        """
        self._running()
        points, grippers, goals, held = (np.array(column) for column in zip(*self._film, strict=True))
        config = replace(self.config, frames=len(points))
        goals = np.repeat(goals, config.steps_per_frame, axis=0)
        release = int(held.sum()) * config.steps_per_frame
        run = Run(self.garment, (), np.zeros((0, 0, 3)), goals, release, config, (), self.n_points, noise=0)
        stretch = [check_stretch(self.garment, config, frame, "hanging") for frame in points]
        recording = {"points": points.astype(np.float32), "grippers": grippers, "stretch": np.array(stretch)}
        notes = {"randomisation": None, "controller": controller}
        return as_episode(run, recording, self.task, self.standing, self._seed, notes, first=0)

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture of the scene (360, 480, 3), the cloth in blue; None without a render mode."""
        if self.render_mode is None:
            return None
        x, y, z = self.target.seat.tolist()
        camera = Camera((x - 0.9, y - 1.9, z + 0.2), (x, y - 0.2, z - 0.2), width=480, height=360)
        return _shaded(self._running(), camera)

    def close(self) -> None:
        """End the simulation; `reset` starts another."""
        if self._world is not None:
            self._world.close()
            self._world = None

    def _running(self) -> World:
        if self._world is None:
            raise gymnasium.error.ResetNeeded("reset the environment first: it has not begun, or was closed")
        return self._world

    def _observe(self) -> Observation:
        """Look at the scene, and take note of how far the task has come."""
        world, there = self._running(), self.standing
        points = self._look(world)
        self._linked, self._distance = self._progress(points)
        places = {"points": points, "grippers": world.grippers(), "target": there.centre_line, "wanted": self._wanted}
        places["rods"] = np.array([[*start, *end, radius] for start, end, radius in there.rods])
        clipped = {name: np.clip(place, -_ROOM, _ROOM).astype(np.float32) for name, place in places.items()}
        return {**clipped, "needed": self._needed, "held": int(self._released < 0)}

    def _look(self, world: World) -> Array:
        """The points that are observed now."""
        if self._steps % self._options.cloud_interval:
            self._clouds.append(self._clouds[-1])
            return self._clouds[0]
        if self.cameras:
            cloud = world.seen(self.cameras, self.n_points, self._sensor)
            self._cloud = cloud if len(cloud) else np.resize(self._cloud, (self.n_points, 3))
        else:
            self._cloud = self.vertices[farthest_point_sample(self.vertices, self.n_points)[0]]
        how, keep = self._options, 1 - self._options.dropout
        cloud = spoil(self._cloud, self._sensor, noise=how.noise, outliers=how.outliers, keep=keep)
        self._clouds.append(cloud)
        return self._clouds[0]

    def _progress(self, observed: Array) -> tuple[float, float]:
        """Share of the task's loops that are around the target, and their distance from its seat."""
        if self.reward == "topological-observed":
            cloud = np.unique(observed, axis=0)  # cameras that see little repeat points
            diagram = rips_persistence(cloud)
            n = min(len(self.garment.loops), len(diagram))
            curves = [[cloud[part] for part in simple_cycles(diagram.cycle(i).tolist())] for i in range(n)]
        else:
            curves = [[self.vertices[loop]] for loop in self._asked]
        if not curves:
            return 0.0, float(np.linalg.norm(observed.mean(axis=0) - self.standing.seat))
        on = [any(self.standing.holds(part) for part in parts) for parts in curves]
        gaps = [float(np.linalg.norm(np.concatenate(parts).mean(axis=0) - self.standing.seat)) for parts in curves]
        if self.task.all_loops:
            return sum(on) / len(on), float(np.mean(gaps))
        return float(any(on)), min(gaps)

    def _info(self, success: bool = False, dropped: bool = False, torn: bool = False) -> dict[str, Any]:
        progress = {"linked": self._linked, "distance": self._distance}
        return {"success": success, "dropped": dropped, "torn": torn, **progress}


def _shaded(world: World, camera: Camera) -> NDArray[np.uint8]:
    """A picture from the depth image: surfaces are lighter the more they face the camera; the cloth is blue."""
    depth, cloth = world.image(camera)
    seen = np.isfinite(depth)
    places = np.full((*depth.shape, 3), np.nan)
    places[seen] = camera.unproject(depth, seen)
    normal = np.cross(np.gradient(places, axis=1), np.gradient(places, axis=0))
    facing = np.abs(normal @ camera.axes[2]) / np.linalg.norm(normal, axis=-1)
    light = 0.35 + 0.65 * np.nan_to_num(facing, nan=0.3)[..., None]
    colour = np.where(cloth[..., None], [60, 150, 215], [190, 190, 190])
    return np.where(seen[..., None], light * colour, 255).astype(np.uint8)
