"""Record an episode: two grippers carry a garment to a target, hang it there and let go.

Everything that varies between episodes is drawn from declared ranges, and the draws are recorded in the episode. Each purpose
(path, physics, cameras, noise) has a generator of its own.

Source: Antonova et al. 2021, section 6 (stiffness and paths are randomised). Taught in chapters 0 and 10.
"""

from __future__ import annotations

import dataclasses
import math
import platform
from collections.abc import Callable, Sequence
from importlib import metadata
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topokit._processes import ProcessError, in_fresh_processes
from topokit._progress import Progress
from topokit._validate import positive, whole
from topokit.io import FEWEST_FRAMES, Episode, wardrobe_names
from topokit.linking import side_lengths
from topokit.sampling import farthest_point_sample

from ._camera import Camera
from ._cloth import usual_config
from ._garments import Garment
from ._randomisation import Randomisation
from ._surface import Array
from ._targets import Rod, Target
from ._tasks import Task, check_loops, planned, resolved, warn_of_floor
from ._world import SimulationConfig, SimulationError, World, check_stretch

# A report is called with the number of each recorded frame, and with -1 now and then while the cloth settles.
Report = Callable[[int], None]
# The arrays of a recording: points (T, N, 3), grippers (T, 2, 3), observed (T, M, 3) by cameras, stretch (T, 2).
Recording = dict[str, NDArray[Any]]
AT_REST = 0.3  # m/s, mean over the vertices: a hung apron swings more slowly, a falling one is faster after 0.03 s
_CHECK_WHILE_SETTLING = 5  # steps between checks: a step of self-collision in exploded cloth can take minutes
_MOST_STEPS = 10_000_000  # physics steps of an episode
_MOST_POINTS = 100_000_000  # vertices and observed points of all frames together


def simulate(
    garment: Garment | None = None,
    target: Target | None = None,
    *,
    task: str | Task | None = None,
    seed: int = 0,
    config: SimulationConfig | None = None,
    randomisation: Randomisation | None = None,
    cameras: Sequence[Camera] = (),
    n_observed: int | None = None,
    time_limit: float | None = 60.0,
    progress: bool = False,
) -> Episode:
    """Simulate one episode and return it: a garment hangs between two grippers, is carried to a target, and is let go there.

    The episode is a success when, after the release, the loops of the task are on the target and the garment is at rest.

    Parameters
    ----------
    garment, target : optional
        The garment and the target of the task when not given. Without a task either, an apron is hung on a hook.
    task : str or Task, optional
        A name in `TASKS` or a task; when not given, the task of the garment and the target (`task_for`).
    seed : int
        Seed of everything random. Path, physics, cameras and their noise each have a generator of their own.
    config : SimulationConfig, optional
        When not given, `SimulationConfig()` for a garment of `WARDROBE`, and `Cloth().config(garment)` for any other.
    randomisation : Randomisation, optional
        The ranges from which physics, size and cameras are drawn. Without it nothing varies but the path.
    cameras : sequence of Camera, optional
        The cameras that observe the cloth. Without any, farthest-point samples of the vertices on all sides are observed.
    n_observed : int, optional
        How many points are observed in each frame, at most as many as the garment has vertices or the cameras have pixels.
        When not given: 500, or all vertices if there are fewer.
    time_limit : float, optional
        Seconds that loading, settling and each frame may take in a fresh process; the same call then gives the same bytes
        anywhere in a program. With None the simulation runs in this process, and only its first simulation gives these bytes.
    progress : bool
        Write the number of frames done to stderr.

    Raises
    ------
    SimulationError
        When the cloth explodes or is over-stretched, or the simulator crashes or is stopped.
    ValueError
        When `n_observed` is too large, `task` is not known or asks for loops that the garment does not have, or no camera sees
        any cloth in some frame.
    """
    whole(seed, "seed")
    task, garment, target = resolved(task, garment, target)
    config = config or usual_config(garment)
    check_loops(task, garment)
    # Draw the physics, the size of the garment and the cameras.
    drawn: dict[str, Any] = {"randomisation": None}
    if randomisation is not None:
        config, garment, cameras, numbers = randomisation.draw(seed, config, garment, cameras)
        drawn = {"randomisation": {**randomisation.describe(), "drawn": numbers}}
    # Decide how many points are observed.
    if n_observed is None:
        n_observed = 500 if cameras else min(500, len(garment.vertices))
    most = sum(camera.width * camera.height for camera in cameras) or len(garment.vertices)
    if not 1 <= n_observed <= most or n_observed % 1:
        available = "pixels of all cameras" if cameras else "vertices of the garment"
        raise ValueError(f"n_observed must be from 1 to {most}, the number of {available}, not {n_observed}")
    # Plan the path, and turn the garment to its start.
    warn_of_floor(garment, target)
    path = planned(task, garment, target, Randomisation.generator(seed, "path"))
    garment = garment.turned(path.vias[0].yaw)
    if path.drawn:
        drawn["path"] = dict(path.drawn)
    # Find the number of frames, and refuse an episode that does not fit into the memory.
    frames = config.frames or max(FEWEST_FRAMES, math.ceil(min(path.end / config.frame_time, _MOST_STEPS)))
    config = dataclasses.replace(config, frames=frames)
    steps = frames * config.steps_per_frame
    n_points = frames * (len(garment.vertices) + n_observed)
    if steps > _MOST_STEPS or n_points > _MOST_POINTS:
        size = f"{frames:,} frames make {steps:,} physics steps and {n_points:,} points"
        bounds = f"at most {_MOST_STEPS:,} steps and {_MOST_POINTS:,} points fit into the memory"
        raise ValueError(f"{size}; {bounds}: lower config.frames or n_observed, or raise config.dt")
    # Simulate the run, and make the recording an episode.
    goals = path.at(np.arange(steps) * config.dt)
    noise = int(Randomisation.generator(seed, "noise").integers(2**63))
    rods, moves = rods_of(target, np.arange(frames + 1) * config.frame_time)
    run = Run(garment, rods, moves, goals, round(path.release / config.dt), config, tuple(cameras), n_observed, noise)
    report = _reporter(frames) if progress else None
    if time_limit is None:
        recording = record(run, report)
    else:
        recording = record_afresh(run, positive(time_limit, "time_limit", zero=False, infinite=True), report)
    return as_episode(run, recording, task, target, seed, drawn)


def _reporter(frames: int) -> Report:
    """Return a report that writes the number of frames done to stderr."""
    show = Progress("simulating", f"of {frames}")
    return lambda frame: show(frame + 1, frame + 1 == frames)


def as_episode(
    run: Run,
    recording: Recording,
    task: Task,
    target: Target,
    seed: int,
    drawn: dict[str, Any],
    first: int | None = None,  # the vertex at which farthest-point sampling begins, as in `farthest_point_sample`
) -> Episode:
    """Return the episode of a run and its recording; what was `drawn` is noted in its physics."""
    garment = run.garment
    config = run.config
    points = recording["points"]
    # Success needs the garment to be at rest, since a loop that flies past the arm links it, too.
    held = np.arange(len(points)) * config.steps_per_frame < run.release
    speed = float(np.linalg.norm(points[-1] - points[-2:][0], axis=1).mean()) / config.frame_time
    at_rest = len(points) > 1 and not held[-1] and speed < AT_REST
    # Note everything that a repetition needs.
    physics = {
        "config": dataclasses.asdict(config),
        "elastic_stiffness": config.elastic_stiffness(len(garment.vertices)),
        "garment": dict(garment.parameters),
        "target": target.describe(),
        **drawn,
    }
    if garment.loop_names != wardrobe_names(garment.name, garment.parameters):
        physics["loops"] = list(garment.loop_names)
    physics["stretch"] = dict(zip(("p99", "worst"), recording["stretch"].max(axis=0).tolist(), strict=True))
    # Without cameras, farthest-point samples of the vertices are observed.
    if run.cameras:
        observed = recording["observed"]
    else:
        observed = np.array([frame[farthest_point_sample(frame, run.n_observed, first)[0]] for frame in points])
    versions = {name: _version(name) for name in ("topokit", "pybullet")}
    return Episode(
        points=points,
        observed=observed,
        actions=run.goals[:: config.steps_per_frame].astype(np.float32),
        grippers=recording["grippers"],
        held=held,
        faces=garment.faces.astype(np.int32),
        loops=tuple(loop.astype(np.int32) for loop in garment.loops),
        centre_line=target.centre_line.astype(np.float32),
        garment=garment.name,
        target=target.name,
        task=task.name,
        success=bool(at_rest and task.hangs(points[-1], garment.named_loops, target)),
        seed=seed,
        dt=config.frame_time,
        observation={
            "kind": "cameras" if run.cameras else "vertices",
            "cameras": [dataclasses.asdict(camera) for camera in run.cameras],
        },
        physics=physics,
        provenance={**versions, "machine": platform.machine()},
    )


def _version(package: str) -> str:
    """Return the version of an installed package."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:  # run from a source tree that is not installed
        return "0+unknown"


def explain(episode: Episode, task: Task, target: Target | None = None) -> str:
    """Return in a sentence why a garment does not hang at the end of an episode; "" when it hangs.

    Parameters
    ----------
    episode : Episode
    task : Task
        The task that the episode was to do.
    target : Target, optional
        Where the target is at the end; the task's own when not given.
    """
    if episode.success:
        return ""
    target = target or task.target
    wanted = task.wanted(episode.named_loops)
    if not wanted:
        return f"none of its loops is one that {task.name} asks for"
    if episode.held[-1]:
        return "it is still held at the end"
    released = int(episode.held.sum())
    around = {name: [_is_around(target, frame[loop]) for frame in episode.points[1:]] for name, loop in wanted.items()}
    # Name the loop that stayed on longest, or of several that must all hang, the one that did not.
    sort = min if task.all_loops else max
    name = sort(around, key=lambda name: (around[name][-1], sum(around[name])))
    last = len(around[name]) - around[name][::-1].index(True) if any(around[name]) else 0
    where = f"the {target.name}"
    if not last:
        loop = episode.points[0][wanted[name]]
        size = f"it is {side_lengths(loop).sum():.2f} m around"
        return f"the loop {name!r} never came around {where}; {size}"
    if last < len(around[name]):
        when = "while it was held" if last < released else "after it was let go"
        return f"the loop {name!r} was around {where} until {last * episode.dt:.1f} s, and slipped off {when}"
    if episode.points[-1][:, 2].max() <= target.lowest:
        return f"the loop {name!r} is around {where}, but the garment slid down to its foot"
    return "it hangs, but does not come to rest before the end"


def _is_around(target: Target, curve: Array) -> bool:
    """Return whether a closed curve winds around a target; one that touches its centre line does not."""
    try:
        return target.holds(curve)
    except ValueError:
        return False


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """The whole input of a simulation, so that it can run in another process."""

    garment: Garment
    rods: Sequence[Rod]  # the R rods of the target in the first frame
    moves: Array  # (frames + 1, R, 3) how far each rod has moved by each frame, metres; (0, R, 3) when the target stands still
    goals: Array  # (steps, 2, 3) where the grippers should be at each physics step, metres
    release: int  # the step at which the grippers let go
    config: SimulationConfig
    cameras: Sequence[Camera]  # the cameras that observe every frame, if any
    n_observed: int  # how many points are observed in a frame
    noise: int  # seed of the noise of the cameras


def record(run: Run, report: Report | None = None) -> Recording:
    """Simulate a run in this process and return its recording."""
    garment = run.garment
    config = run.config
    if report is None:
        report = _silence
    offset = run.goals[0].mean(axis=0) - garment.vertices[garment.grips].mean(axis=0)
    noise = np.random.default_rng(run.noise)
    points = []
    grippers = []
    observed = []
    stretch = []
    with World(garment, offset, config) as world:
        world.add_rods(run.rods)
        # Let the garment settle between the grippers.
        for step in range(round(config.settle / config.dt)):
            if step % _CHECK_WHILE_SETTLING == 0 and step:
                check_stretch(garment, config, world.vertices(), "settling")
                report(-1)
            world.step(run.goals[0])
        # Carry it to the target, let go, and record a frame every few steps.
        for step, goal in enumerate(run.goals):
            if step == run.release:
                world.release()
            if step % config.steps_per_frame == 0:
                points.append(world.vertices())
                stretch.append(check_stretch(garment, config, points[-1], f"frame {len(points) - 1}"))
                grippers.append(world.grippers())
                if run.cameras:
                    observed.append(world.observe(run.cameras, run.n_observed, noise))
                report(len(points) - 1)
            # A moving target moves evenly between two frames.
            if len(run.moves):
                frame, share = divmod(step / config.steps_per_frame, 1)
                world.move_rods((1 - share) * run.moves[int(frame)] + share * run.moves[int(frame) + 1])
            world.step(goal)
    return {
        "points": np.array(points, np.float32),
        "grippers": np.array(grippers, np.float32),
        "observed": np.array(observed, np.float32),
        "stretch": np.array(stretch),
    }


def _silence(_: int) -> None:
    """Report nothing."""


def record_afresh(run: Run, time_limit: float, report: Report | None = None) -> Recording:
    """Simulate a run in a fresh process and return its recording.

    The process is stopped when loading, settling or a frame takes longer than `time_limit` seconds.
    """
    stage = "loading the garment"  # for the error of a process that fails

    def note(frame: int) -> None:
        nonlocal stage
        stage = "settling" if frame < 0 else f"after frame {frame}"
        if report is not None:
            report(frame)

    answers = in_fresh_processes(record, [run], time_limit=time_limit, report=note, preload=[__name__])
    ((_, recording),) = answers
    if isinstance(recording, ProcessError):
        raise SimulationError(f"{stage}: {recording}")
    if isinstance(recording, Exception):
        raise recording
    return dict(recording)


def rods_of(target: Target, times: NDArray[np.floating]) -> tuple[list[Rod], Array]:
    """Return the R rods of a target at the first time, and how far each has moved (T, R, 3) by each of the times.

    For a target that stands still the second array is empty, (0, R, 3).
    """
    first = target.at(times[0]).rods
    if target.at(times[-1]) == target.at(times[0]):
        return first, np.zeros((0, len(first), 3))
    starts = np.array([[start for start, _, _ in target.at(time).rods] for time in times])
    return first, starts - starts[0]
