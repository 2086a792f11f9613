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
from typing import Annotated, Any, Literal, NamedTuple

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
_MOVING = 0.6  # seconds that the move takes
_PUSHING = 0.1  # seconds that the push takes


def _somewhere(value: Any, check: ValidatorFunctionWrapHandler) -> Any:
    """Return a checked place; the error says in a sentence what a place is."""
    try:
        return check(as_tuple(value))
    except ValidationError as error:
        raise ValueError("must be 'anywhere', or x, y and z in metres and a yaw in degrees") from error


@checked
class Options:
    """The options of `HangEnv`: keywords for all its episodes, or options of `reset` for one."""

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

    def scene(self, target: Target, frame_time: float, rng: np.random.Generator) -> _Scene:
        """Draw a scene. Every number is drawn whether or not it is used, so that one option does not change the others."""
        place = rng.uniform(-1, 1, 4) * _AWAY
        shift = rng.normal(size=3)
        shift *= self.target_shift * np.cbrt(rng.random()) / np.linalg.norm(shift)  # anywhere in a ball
        sets_off, begins = rng.uniform(*_SOON, 2).tolist()
        pushed, swung, gone = (np.array([np.cos(a), np.sin(a)]) for a in rng.uniform(-np.pi, np.pi, 3))
        # A target that moves arrives where it stands otherwise, so that the plan stays as it is.
        if self.target_shift:
            x, y, z = shift.tolist()
            target = Moving(Placed(target, -x, -y, -z), x, y, z, start=sets_off, seconds=_MOVING)
        if self.target_speed:
            vx, vy = (self.target_speed * gone).tolist()
            target = Travelling(target, vx=vx, vy=vy)
        if self.place == "anywhere":
            target = Placed(target, *place.tolist())
        elif self.place is not None:
            target = Placed(target, *self.place)
        # Pushes are accelerations that give free cloth these speeds.
        first = round(begins / frame_time)
        frames = max(1, round(_PUSHING / frame_time))
        push = self.shove * pushed / (frames * frame_time)
        swing = self.swing * swung / (frames * frame_time)
        return _Scene(target, range(first, first + frames), push, swing)

    def before_fence(self, goal: Array, before: Array, target: Target) -> Array:
        """Return a goal (2, 3) of the grippers, or the nearest one before the fence; a gripper behind it may only go back."""
        if not self.fence:
            return goal
        tip = target.centre_line[-1]
        out = (tip - target.seat) * [1, 1, 0]
        far = float(np.linalg.norm(out))
        if far < 1e-6:
            raise ValueError("fence: it stands before an arm, and this target has none that runs sideways")
        # Metres before the tip, now and at the goal.
        distance_now = (before - tip) @ out / far
        distance = (goal - tip) @ out / far
        return np.asarray(goal + np.maximum(np.minimum(distance_now, self.fence) - distance, 0)[:, None] * out / far)

    def plan(self, plan: PathScript, rng: np.random.Generator) -> PathScript:
        """Return a task's script, from the start that is asked for."""
        if self.start is None:
            return plan
        return lambda garment, target, own: from_elsewhere(plan(garment, target, own), garment, target, rng)


class _Scene(NamedTuple):
    """The scene of an episode."""

    target: Target
    frames: range  # in which the cloth is pushed; a swing takes as many frames
    push: Array  # (2,) m/s^2 along x and y
    swing: Array  # (2,) m/s^2, before the first observation


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
    - `wanted` (L, 3): the middles of the loops that the task asks for, before the first step, as if pointed at;
    - `needed`: how many of these must hang: all of them, or any one;
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

    **Options** are keywords here, for all episodes, and entries of `reset(options={...})` for one. The seed draws what they leave
    open. Shifts and shoves begin 0.3 to 1.5 s after the first step. The last five spoil `points` alone: success is judged on the
    vertices.

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

    `vertices` (V, 3), `goal` (2, 3) of the grippers, and `standing`, the target where it is now, are not meant for agents.

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
        self.reward = reward
        self.cameras = tuple(cameras)
        self.render_mode = render_mode
        self.max_step = _SPEED * self.config.frame_time
        self.max_steps = whole(max_steps, "max_steps", 1)
        self._world: World | None = None
        # What comes in and what goes out.
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
            Of the path; the generator goes on when not given.
        options : dict, optional
            For this episode, in place of the environment's own; a ValueError names an option that is not known or cannot be.
        """
        now = Options(**{**asdict(self._usual), **(options or {})})
        now.before_fence(np.zeros((2, 3)), np.zeros((2, 3)), self._described)  # raises for a target without an arm
        super().reset(seed=seed)
        self.close()
        # Draw the scene and the path.
        drawn, start, self._sensor = self.np_random.spawn(3)
        self._options = now
        self._scene = now.scene(self._described, self.config.frame_time, drawn)
        self.target = self._scene.target
        task = replace(self.task, plan=now.plan(self.task.plan, start))
        self._path = planned(task, self.garment, self.target, self.np_random)
        self.goal = self._path.at(0.0)
        garment = self.garment.turned(self._path.vias[0].yaw)
        # Hang the garment between the grippers, at the start of the path.
        offset = self.goal.mean(axis=0) - garment.vertices[garment.grips].mean(axis=0)
        self._world = World(garment, offset, self.config)
        self.standing = self.target.at(0.0)
        self._rods = self.standing.rods
        self._world.add_rods(self._rods)
        # It settles, held by two grippers and then perhaps by one, and may be pushed.
        for n_grippers in range(2, now.n_grippers - 1, -1):
            self._world.release(keep=n_grippers)
            for _ in range(round(self.config.settle / self.config.dt)):
                self._world.step(self.goal)
        if self._scene.swing.any():
            self._world.push(self._scene.swing)
            for _ in range(len(self._scene.frames) * self.config.steps_per_frame):
                self._world.step(self.goal)
            self._world.push(np.zeros(2))
        # Nothing has happened yet.
        self._steps = 0
        self._released = -1
        self.vertices = self._world.vertices()
        self._cloud = self._world.grippers()
        self._clouds = deque[Array](maxlen=now.cloud_delay + 1)
        self._wanted = np.array([self.vertices[loop].mean(axis=0) for loop in self._asked]).reshape(-1, 3)
        observation = self._observe()
        self._seed = -1 if seed is None else seed
        self._film = [(self.vertices, observation["grippers"], self.goal, True)]
        return observation, self._info()

    def step(self, action: ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Move the goals of the grippers, let go if the action says so, and simulate one frame.

        Raises
        ------
        ValueError
            When the action is not seven finite numbers.
        """
        self._running()
        move = as_reals(action, "action").astype(np.float64)
        if move.shape != (7,) or not np.isfinite(move).all():
            raise ValueError(f"an action is seven finite numbers, not {action!r}")
        before = self.vertices
        linked_before = self._linked
        distance_before = self._distance
        standing_before = self.standing
        self._advance(self.max_step * np.clip(move[:6], -1, 1).reshape(2, 3), release=move[6] > 0.5)
        torn = False
        try:
            check_stretch(self.garment, self.config, self.vertices, f"step {self._steps}")
        except SimulationError:
            torn = True
            self.vertices = before  # the last that made sense
        observation = self._observe()
        self._film.append((self.vertices, observation["grippers"], self.goal, self._released < 0))
        # At rest: free for long enough, and slow relative to a target that travels.
        gone = np.zeros(3)
        if self._options.target_speed:
            gone = self.standing.seat - standing_before.seat
        speed = np.linalg.norm(self.vertices - before - gone, axis=1).mean() / self.config.frame_time
        free = self._released >= 0 and (self._steps - self._released) * self.config.frame_time >= _REST_AFTER
        rests = not torn and free and speed < AT_REST
        hangs = rests and self.task.hangs(self.vertices, self.garment.named_loops, self.standing)
        reward = float(hangs)
        if self.reward != "sparse":
            reward += distance_before - self._distance
        if self.reward.startswith("topological"):
            reward += self._linked - linked_before
        ends = rests or torn
        info = self._info(success=hangs, dropped=rests and not hangs, torn=torn)
        return observation, reward, ends, not ends and self._steps >= self.max_steps, info

    def _advance(self, move: Array, release: bool) -> None:
        """Simulate one frame."""
        world = self._running()
        limit = self._options.release_after
        if self._released < 0 and (release or 0 < limit <= self._steps * self.config.frame_time):
            world.release()
            self._released = self._steps
        if self._scene.push.any():
            world.push(self._scene.push * (self._steps in self._scene.frames))
        # The goals of the grippers: on a leash, and before the fence.
        before = self.goal
        grippers = world.grippers()
        goal = np.clip(before + move, grippers - _LEASH, grippers + _LEASH)
        self.goal = self._options.before_fence(goal, before, self.standing)
        # Goals and target move evenly within the frame.
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
        # Goals are noted once a frame, and recorded for every step of physics.
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
        """Return the world, or raise ResetNeeded."""
        if self._world is None:
            raise gymnasium.error.ResetNeeded("reset the environment first: it has not begun, or was closed")
        return self._world

    def _observe(self) -> Observation:
        """Return what is observed, and note how far the task has come."""
        world = self._running()
        standing = self.standing
        points = self._look(world)
        self._linked, self._distance = self._progress(points)
        places = {
            "points": points,
            "grippers": world.grippers(),
            "target": standing.centre_line,
            "wanted": self._wanted,
        }
        places["rods"] = np.array([[*start, *end, radius] for start, end, radius in standing.rods])
        clipped = {name: np.clip(place, -_ROOM, _ROOM).astype(np.float32) for name, place in places.items()}
        return {**clipped, "needed": self._needed, "held": int(self._released < 0)}

    def _look(self, world: World) -> Array:
        """Return the points that are observed now."""
        if self._steps % self._options.cloud_interval:
            self._clouds.append(self._clouds[-1])
            return self._clouds[0]
        if self.cameras:
            cloud = world.seen(self.cameras, self.n_points, self._sensor)
            self._cloud = cloud if len(cloud) else np.resize(self._cloud, (self.n_points, 3))
        else:
            self._cloud = self.vertices[farthest_point_sample(self.vertices, self.n_points)[0]]
        options = self._options
        errors = {"noise": options.noise, "outliers": options.outliers, "keep": 1 - options.dropout}
        cloud = spoil(self._cloud, self._sensor, **errors)
        self._clouds.append(cloud)
        return self._clouds[0]

    def _progress(self, observed: Array) -> tuple[float, float]:
        """Return the share of the task's loops that are around the target, and their distance from its seat."""
        # The curves: true loops, or loops of the observed points, each as its simple cycles.
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
        """Return how the episode goes."""
        return {
            "success": success,
            "dropped": dropped,
            "torn": torn,
            "linked": self._linked,
            "distance": self._distance,
        }


def _shaded(world: World, camera: Camera) -> NDArray[np.uint8]:
    """Return a picture from the depth image: surfaces are lighter the more they face the camera; the cloth is blue."""
    depth, cloth = world.image(camera)
    seen = np.isfinite(depth)
    places = np.full((*depth.shape, 3), np.nan)
    places[seen] = camera.unproject(depth, seen)
    normal = np.cross(np.gradient(places, axis=1), np.gradient(places, axis=0))
    facing = np.abs(normal @ camera.axes[2]) / np.linalg.norm(normal, axis=-1)
    light = 0.35 + 0.65 * np.nan_to_num(facing, nan=0.3)[..., None]
    colour = np.where(cloth[..., None], [60, 150, 215], [190, 190, 190])
    return np.where(seen[..., None], light * colour, 255).astype(np.uint8)
