"""Hanging garments as a reinforcement-learning environment, with Gymnasium's interface.

    >>> import gymnasium, topokit.sim
    >>> env = gymnasium.make("topokit/HangApronHook-v1", reward="topological")

Source: Towers et al. 2024, *Gymnasium: a standard interface for reinforcement learning environments*; Ng, Harada and Russell
1999, *Policy invariance under reward transformations*. Taught in chapter 10.
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
_FARTHEST = 4.0  # metres: observed coordinates are clipped to this distance from the origin
_GOAL_SPEED = 1.2  # m/s: the highest speed of a gripper's goal along an axis
_LEASH = 0.2  # metres: a goal leads its gripper by at most this along an axis; taut cloth holds a gripper back
_REST_AFTER = 0.5  # s after the release: by then cloth that the target does not hold falls fast
_PLACE_RANGE = (0.4, 0.4, 0.1, 180.0)  # how far "anywhere" goes either way: metres along x, y and z, degrees of yaw
_START_RANGE = (0.3, 1.5)  # seconds after the first frame: a shift of the target and a push begin between these times
_SHIFT_TIME = 0.6  # seconds that a shift of the target takes
_PUSH_TIME = 0.1  # seconds that a push of the cloth takes


def _checked_place(value: Any, check: ValidatorFunctionWrapHandler) -> Any:
    """Return a checked place of the target; replace pydantic's long error by one sentence."""
    try:
        return check(as_tuple(value))
    except ValidationError as error:
        raise ValueError(
            "must be None, 'anywhere', or four numbers: x, y and z in metres, and a yaw in degrees"
        ) from error


_Place = Annotated[tuple[float, float, float, float] | Literal["anywhere"] | None, WrapValidator(_checked_place)]


@checked
class Options:
    """The options of `HangEnv`: keywords for all its episodes, or options of `reset` for one."""

    place: _Place = None
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
        """Draw the scene of an episode from a generator.

        Every number is drawn, used or not. So the draws for one option do not depend on the other options.
        """
        place = rng.uniform(-1, 1, 4) * _PLACE_RANGE
        shift = rng.normal(size=3)
        shift *= self.target_shift * np.cbrt(rng.random()) / np.linalg.norm(shift)  # uniform in a ball
        shift_start, push_start = rng.uniform(*_START_RANGE, 2).tolist()
        angles = rng.uniform(-np.pi, np.pi, 3)
        push_direction, swing_direction, travel_direction = (np.array([np.cos(a), np.sin(a)]) for a in angles)
        # A shifted target begins aside and ends at its usual place, so that the planned path still leads to it.
        if self.target_shift:
            x, y, z = shift.tolist()
            target = Moving(Placed(target, -x, -y, -z), x, y, z, start=shift_start, seconds=_SHIFT_TIME)
        if self.target_speed:
            vx, vy = (self.target_speed * travel_direction).tolist()
            target = Travelling(target, vx=vx, vy=vy)
        if self.place == "anywhere":
            target = Placed(target, *place.tolist())
        elif self.place is not None:
            target = Placed(target, *self.place)
        # Options give the speed that free cloth would reach; the simulator takes the acceleration that leads to it.
        first = round(push_start / frame_time)
        frames = max(1, round(_PUSH_TIME / frame_time))
        push = self.shove * push_direction / (frames * frame_time)
        swing = self.swing * swing_direction / (frames * frame_time)
        return _Scene(target, range(first, first + frames), push, swing)

    def before_fence(self, goal: Array, before: Array, target: Target) -> Array:
        """Return goals (2, 3) of the grippers, moved back to the fence where they are past it.

        A gripper whose goal `before` was past the fence already goes no farther.
        """
        if not self.fence:
            return goal
        tip = target.centre_line[-1]
        along_arm = (tip - target.seat) * [1, 1, 0]
        length = float(np.linalg.norm(along_arm))
        if length < 1e-6:
            raise ValueError(
                "fence needs a target with an arm that runs sideways, and this target has none: use fence=0"
            )
        # Measure how far before the tip the goals were and are, in metres along the arm.
        distance_before = (before - tip) @ along_arm / length
        distance = (goal - tip) @ along_arm / length
        missing = np.maximum(np.minimum(distance_before, self.fence) - distance, 0)
        return np.asarray(goal + missing[:, None] * along_arm / length)

    def from_start(self, script: PathScript, rng: np.random.Generator) -> PathScript:
        """Return a task's script, changed to begin at the start that the options ask for."""
        if self.start is None:
            return script
        return lambda garment, target, path_rng: from_elsewhere(script(garment, target, path_rng), garment, target, rng)


class _Scene(NamedTuple):
    """The draws of an episode from its options: the target and the pushes of the cloth."""

    target: Target
    push_frames: range  # the frames in which the cloth is pushed; a swing takes as many
    push: Array  # (2,) acceleration along x and y, m/s^2
    swing: Array  # (2,) acceleration before the first observation, m/s^2


class HangEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """Carry a garment to its target with two grippers, hang it there, and let go.

    Every task of `TASKS` has an id for `gymnasium.make`, which puts the target anywhere: the id of "apron2-hook" is
    "topokit/HangApron2Hook-v1". Under one version of an id, a seed gives every agent the same start.

    **Observation**: a dict of float32 arrays in metres, and of two whole numbers:

    - `points` (n_points, 3): farthest-point samples of the garment's vertices, or points that the cameras see of it. While the
      cameras see no cloth, these are the last points they saw; before any were seen, they are the places of the grippers;
    - `grippers` (2, 3): where the grippers are;
    - `target` (K, 3): the target's centre line;
    - `rods` (R, 7): the shapes of the target and of its stand, as capsules: start, end, radius;
    - `wanted` (L, 3): the middles of the loops that the task asks for, measured before the first step, as if pointed at;
    - `needed`: how many of the `wanted` loops must hang: all of them, or any one;
    - `held`: 1 until the grippers let go, then 0.

    **Action**: seven numbers from -1 to 1. The first six are the displacements of the two grippers' goals (x, y, z each), as
    shares of what 1.2 m/s allows in a step. The grippers let go for good when the seventh is above 0.5.

    **Reward**: 1 at success. The option `reward` adds differences of a potential, so that going back and forth earns nothing:

    - `"sparse"`: adds nothing;
    - `"dense"`: adds the metres by which the task's loops came nearer to the target's seat in this step;
    - `"topological"`: adds to `"dense"` the change of the share of the task's loops that are around the target, by linking
      number;
    - `"topological-observed"`: as `"topological"`, for the longest-lived loops of the observed points, as many as the garment
      has.

    An episode **terminates** when the garment has been free for half a second and is at rest: with success if the task's
    loops are on the target, otherwise as dropped. It also terminates when the garment is torn, that is, stretched too far. It is
    **truncated** after `max_steps`. `info` holds `success`, `dropped`, `torn`, and the two parts of the potential: the share of
    loops that are `linked`, and the `distance`.

    **Options** are keywords of `HangEnv` for all episodes, and entries of `reset(options={...})` for one episode. The seed draws
    what the options leave open. Shifts and shoves begin 0.3 to 1.5 s after the first step. The last five options spoil `points`
    alone: success is judged on the vertices.

    ================ ========== ========================================================================================
    option           usual      what it does
    ================ ========== ========================================================================================
    `place`          None       moves the target and the path to it by (x, y, z, yaw), metres and degrees about the z
                                axis, or "anywhere": up to 0.4 m along x and y, 0.1 m along z, any yaw
    `start`          None       "anywhere": the garment starts 0.5 to 1 m before or beside the target, at any yaw
    `target_shift`   0.0        metres, at most, by which the target begins aside; it comes to its place within 0.6 s
    `target_speed`   0.0        m/s of the target, level and steady; "at rest" is then relative to the target
    `shove`          0.0        m/s that a push sideways, of 0.1 s, would give to free cloth
    `swing`          0.0        m/s that such a push would give, just before the first observation
    `n_grippers`     2          grippers that hold the garment; with 1 the second lets go before the first observation
    `fence`          0.0        metres before an arm's tip where the grippers must stop, so that they have to throw
    `release_after`  0.0        seconds after which the grippers let go, whatever the action says; 0 for never
    `cloud_delay`    0          steps by which `points` are late; the first cloud is repeated until then
    `cloud_interval` 1          steps from one new cloud to the next
    `noise`          0.0        metres, the standard deviation of each coordinate of a point
    `dropout`        0.0        share of points that are lost; copies of other points replace them
    `outliers`       0.0        share of points that are moved anywhere in the cloud's box, grown by 10 cm a side
    ================ ========== ========================================================================================

    The attributes `vertices` (V, 3), `goal` (2, 3) of the grippers, and `standing`, the target where it is now, are for
    evaluation, not for agents.

    Parameters
    ----------
    task : str or Task, optional
    garment, target : optional
        As in `simulate`.
    reward : str
        One of the four names above.
    n_points : int, optional
        How many points are observed, at most as many as the garment has vertices. When not given: 256, or all vertices if
        there are fewer.
    cameras : sequence of Camera
        The cameras that observe the cloth. Without any, the vertices are observed on all sides.
    config : SimulationConfig, optional
        When not given, that of `simulate` without self-collision. With self-collision a seed repeats the motion to a
        micrometre, but not bit by bit.
    max_steps : int
        A step takes `config.frame_time` seconds.
    render_mode : str, optional
        With `"rgb_array"`, `render()` returns a picture (360, 480, 3) uint8.
    **options
        The options in the table above.
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
        self._default_options = Options(**options)
        self.task, self.garment, self._given_target = resolved(task, garment, target)
        self.target = self._given_target
        check_loops(self.task, self.garment)
        self.config = config or replace(usual_config(self.garment), self_collision=False)
        n_vertices = len(self.garment.vertices)
        self.n_points = min(256, n_vertices) if n_points is None else whole(n_points, "n_points", 1, n_vertices)
        self.reward = reward
        self.cameras = tuple(cameras)
        self.render_mode = render_mode
        self.max_step = _GOAL_SPEED * self.config.frame_time
        self.max_steps = whole(max_steps, "max_steps", 1)
        self._world: World | None = None
        # The spaces of actions and of observations.
        self.action_space = spaces.Box(-1.0, 1.0, (7,), np.float32)
        self._wanted_loops = list(self.task.wanted(self.garment.named_loops).values())
        n_wanted = len(self._wanted_loops)
        self._needed = self.task.needed(self.garment.named_loops)
        sizes = {"points": self.n_points, "grippers": 2, "target": len(self.target.centre_line), "wanted": n_wanted}
        places = {name: spaces.Box(-_FARTHEST, _FARTHEST, (size, 3), np.float32) for name, size in sizes.items()}
        places["rods"] = spaces.Box(-_FARTHEST, _FARTHEST, (len(self.target.rods), 7), np.float32)
        counts = {"needed": spaces.Discrete(n_wanted + 1), "held": spaces.Discrete(2)}
        self.observation_space = spaces.Dict({**places, **counts})

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Hang the garment between the grippers, at the start of a path.

        Parameters
        ----------
        seed : int, optional
            Seed of the scene, the path and the noise; when not given, the generator goes on.
        options : dict, optional
            Options for this episode, in place of the environment's own.

        Raises
        ------
        ValueError
            When an option is not known or has an impossible value; the message names it.
        """
        if seed is not None:
            whole(seed, "seed")
        chosen = Options(**{**asdict(self._default_options), **(options or {})})
        # A fence before a target without an arm is refused here, before anything is simulated.
        chosen.before_fence(np.zeros((2, 3)), np.zeros((2, 3)), self._given_target)
        super().reset(seed=seed)
        self.close()
        # Draw the scene and the path.
        scene_rng, start_rng, self._sensor_rng = self.np_random.spawn(3)
        self._options = chosen
        self._scene = chosen.scene(self._given_target, self.config.frame_time, scene_rng)
        self.target = self._scene.target
        task = replace(self.task, plan=chosen.from_start(self.task.plan, start_rng))
        self._path = planned(task, self.garment, self.target, self.np_random)
        self.goal = self._path.at(0.0)
        garment = self.garment.turned(self._path.vias[0].yaw)
        # Hang the garment between the grippers, at the start of the path.
        offset = self.goal.mean(axis=0) - garment.vertices[garment.grips].mean(axis=0)
        self._world = World(garment, offset, self.config)
        self.standing = self.target.at(0.0)
        self._rods = self.standing.rods
        self._world.add_rods(self._rods)
        # Let the garment settle, held by two grippers and then, if the options ask for it, by one. Then swing it.
        for n_grippers in range(2, chosen.n_grippers - 1, -1):
            self._world.release(keep=n_grippers)
            for _ in range(round(self.config.settle / self.config.dt)):
                self._world.step(self.goal)
        if self._scene.swing.any():
            self._world.push(self._scene.swing)
            for _ in range(len(self._scene.push_frames) * self.config.steps_per_frame):
                self._world.step(self.goal)
            self._world.push(np.zeros(2))
        # Begin the record of the episode with its first frame.
        self._steps = 0
        self._release_step = -1
        self.vertices = self._world.vertices()
        self._cloud = self._world.grippers()
        self._clouds = deque[Array](maxlen=chosen.cloud_delay + 1)
        self._wanted_places = np.array([self.vertices[loop].mean(axis=0) for loop in self._wanted_loops]).reshape(-1, 3)
        observation = self._observe()
        self._seed = -1 if seed is None else seed
        self._record = [(self.vertices, observation["grippers"], self.goal, True)]
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
            raise ValueError(f"action must be seven finite numbers, not {action!r}")
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
            self.vertices = before  # the last vertices that were not torn
        observation = self._observe()
        self._record.append((self.vertices, observation["grippers"], self.goal, self._release_step < 0))
        # The garment is at rest when it has been free for long enough, and is slow relative to a target that travels.
        travel = np.zeros(3)
        if self._options.target_speed:
            travel = self.standing.seat - standing_before.seat
        speed = np.linalg.norm(self.vertices - before - travel, axis=1).mean() / self.config.frame_time
        free = self._release_step >= 0 and (self._steps - self._release_step) * self.config.frame_time >= _REST_AFTER
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
        release_after = self._options.release_after
        if self._release_step < 0 and (release or 0 < release_after <= self._steps * self.config.frame_time):
            world.release()
            self._release_step = self._steps
        if self._scene.push.any():
            world.push(self._scene.push * (self._steps in self._scene.push_frames))
        # Move the goals of the grippers, but keep them near the grippers (the leash) and before the fence.
        before = self.goal
        grippers = world.grippers()
        goal = np.clip(before + move, grippers - _LEASH, grippers + _LEASH)
        self.goal = self._options.before_fence(goal, before, self.standing)
        # Simulate the steps of the frame, in which the goals and the target move evenly.
        _, moves = rods_of(self.target, (self._steps + np.arange(2)) * self.config.frame_time)
        self.standing = self.target.at((self._steps + 1) * self.config.frame_time)
        rod_shifts = np.array([start for start, *_ in self.standing.rods]) - [start for start, *_ in self._rods]
        for share in np.arange(1, self.config.steps_per_frame + 1) / self.config.steps_per_frame:
            if len(moves):
                world.move_rods(rod_shifts - (1 - share) * moves[1])
            world.step(before + share * (self.goal - before))
        self._steps += 1
        self.vertices = world.vertices()

    def scripted_action(self) -> NDArray[np.float32]:
        """Return the next action along the scripted path of this episode, which usually succeeds as a demonstration."""
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
            Name of the controller that acted; it is noted in the episode's physics.
        """
        self._running()
        points, grippers, goals, held = (np.array(column) for column in zip(*self._record, strict=True))
        # Goals are kept once a frame here; a `Run` has them for every step of physics.
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
            raise gymnasium.error.ResetNeeded("call reset() first: the environment has not begun, or was closed")
        return self._world

    def _observe(self) -> Observation:
        """Return the observation, and keep the linked share and the distance of this frame."""
        world = self._running()
        standing = self.standing
        points = self._observed_points(world)
        self._linked, self._distance = self._progress(points)
        places = {
            "points": points,
            "grippers": world.grippers(),
            "target": standing.centre_line,
            "wanted": self._wanted_places,
        }
        places["rods"] = np.array([[*start, *end, radius] for start, end, radius in standing.rods])
        clipped = {name: np.clip(place, -_FARTHEST, _FARTHEST).astype(np.float32) for name, place in places.items()}
        return {**clipped, "needed": self._needed, "held": int(self._release_step < 0)}

    def _observed_points(self, world: World) -> Array:
        """Return the points that are observed now: a new cloud or the last one, spoiled and late as the options ask."""
        # Between two clouds the last one is repeated.
        if self._steps % self._options.cloud_interval:
            self._clouds.append(self._clouds[-1])
            return self._clouds[0]
        if self.cameras:
            cloud = world.seen(self.cameras, self.n_points, self._sensor_rng)
            self._cloud = cloud if len(cloud) else np.resize(self._cloud, (self.n_points, 3))
        else:
            self._cloud = self.vertices[farthest_point_sample(self.vertices, self.n_points)[0]]
        options = self._options
        errors = {"noise": options.noise, "outliers": options.outliers, "keep": 1 - options.dropout}
        cloud = spoil(self._cloud, self._sensor_rng, **errors)
        self._clouds.append(cloud)
        return self._clouds[0]

    def _progress(self, observed: Array) -> tuple[float, float]:
        """Return the share of the task's loops that are around the target, and their distance from its seat."""
        # The curves are true loops, or loops of the observed points. Each is a list of its simple cycles.
        if self.reward == "topological-observed":
            cloud = np.unique(observed, axis=0)  # cameras that see few points repeat them
            diagram = rips_persistence(cloud)
            n_loops = min(len(self.garment.loops), len(diagram))
            cycles = [simple_cycles(diagram.cycle(i).tolist()) for i in range(n_loops)]
            curves = [[cloud[ids] for ids in simple] for simple in cycles]
        else:
            curves = [[self.vertices[loop]] for loop in self._wanted_loops]
        if not curves:
            return 0.0, float(np.linalg.norm(observed.mean(axis=0) - self.standing.seat))
        linked = [any(self.standing.holds(points) for points in curve) for curve in curves]
        distances = [float(np.linalg.norm(np.concatenate(curve).mean(axis=0) - self.standing.seat)) for curve in curves]
        if self.task.all_loops:
            return sum(linked) / len(linked), float(np.mean(distances))
        return float(any(linked)), min(distances)

    def _info(self, success: bool = False, dropped: bool = False, torn: bool = False) -> dict[str, Any]:
        """Return the `info` of Gymnasium: how the episode ended, if it did, and the parts of the potential."""
        return {
            "success": success,
            "dropped": dropped,
            "torn": torn,
            "linked": self._linked,
            "distance": self._distance,
        }


def _shaded(world: World, camera: Camera) -> NDArray[np.uint8]:
    """Return a picture drawn from the depth image: surfaces that face the camera are light, and the cloth is blue."""
    depth, cloth = world.image(camera)
    seen = np.isfinite(depth)
    places = np.full((*depth.shape, 3), np.nan)
    places[seen] = camera.unproject(depth, seen)
    # The gradients of the places along rows and columns span the surface.
    normal = np.cross(np.gradient(places, axis=1), np.gradient(places, axis=0))
    facing = np.abs(normal @ camera.axes[2]) / np.linalg.norm(normal, axis=-1)
    light = 0.35 + 0.65 * np.nan_to_num(facing, nan=0.3)[..., None]
    colour = np.where(cloth[..., None], [60, 150, 215], [190, 190, 190])
    return np.where(seen[..., None], light * colour, 255).astype(np.uint8)
