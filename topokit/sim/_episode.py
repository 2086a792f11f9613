"""Record an episode: two grippers carry a garment to a target, hang it there and let go.

What varies between episodes is drawn from declared ranges, with a generator for every purpose, and recorded.

Source: Antonova et al. 2021, section 6 (stiffness and paths are randomised). Taught in chapters 0 and 8.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import platform
import sys
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topokit._processes import ProcessError, in_fresh_processes
from topokit._validate import WrongKindError, positive
from topokit.io import FEWEST_FRAMES, Episode, wardrobe_names
from topokit.sampling import farthest_point_sample

from ._camera import Camera
from ._cloth import usual_config
from ._garments import Garment
from ._randomisation import Randomisation
from ._surface import Array
from ._targets import Rod, Target
from ._tasks import Task, check_loops, planned, resolved, warn_of_floor
from ._world import SimulationConfig, SimulationError, World, check_stretch

Report = Callable[[int], None]
# points (T, N, 3), grippers (T, 2, 3), observed (T, M, 3) by cameras, stretch (T, 2)
Recording = dict[str, NDArray[Any]]
AT_REST = 0.3  # m/s, mean over the vertices: a hung apron still swings a little, a falling one is faster within 0.03 s
_CHECK_WHILE_SETTLING = 5  # steps: in cloth that has exploded a single step of self-collision can take minutes
_MOST_STEPS, _MOST_PLACES = 10_000_000, 100_000_000


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
    """Record one episode: a garment hung between two grippers, carried to a target, let go there.

    It is a success when, after release, the loops of the task are on the target and the garment is at rest there.

    Parameters
    ----------
    garment, target : optional
        Those of the task when not given. With neither a task nor these, an apron is hung on a hook.
    task : str or Task, optional
        A name in `TASKS` or a task; when not given, the one of that garment and target (`task_for`).
    seed : int
        Of everything random: path, physics, cameras and their noise each have a generator of their own.
    config : SimulationConfig, optional
        When not given, `SimulationConfig()` for what is in `WARDROBE`, and `Cloth().config(garment)` for a garment of one's own.
    randomisation : Randomisation, optional
        Without it nothing varies but the path.
    cameras : sequence of Camera, optional
        What the observer has. Without any it sees all sides: farthest-point samples of the vertices.
    n_observed : int, optional
        Points of the observation in each frame: 500, or all vertices of a garment that has fewer, when not given. It may not
        exceed the vertices, nor the pixels of the cameras.
    time_limit : float, optional
        Seconds for loading, settling and each frame in a fresh process; the same call then gives the same bytes anywhere
        in a program. None: in this process, repeatable bit by bit only as its first simulation.
    progress : bool
        Write the share done to stderr.

    Raises
    ------
    SimulationError
        When the cloth explodes or is over-stretched, or the simulator crashes or is stopped.
    ValueError
        When `n_observed` exceeds the number of vertices, `task` is not known or asks for loops that the garment has not, or
        no camera sees any cloth in some frame.
    """
    if garment is not None and not isinstance(garment, Garment):
        how = "make one"
        if isinstance(garment, str | Path):
            how = f"Garment.from_mesh({garment!r}) makes one of a mesh"
        raise WrongKindError(f"garment must be a Garment, not {type(garment).__name__}: {how}")
    task, garment, target = resolved(task, garment, target)
    config = config or usual_config(garment)
    check_loops(task, garment)
    # Draw physics, size and cameras.
    drawn: dict[str, Any] = {"randomisation": None}
    if randomisation is not None:
        config, garment, cameras, numbers = randomisation.draw(seed, config, garment, cameras)
        drawn = {"randomisation": {**randomisation.describe(), "drawn": numbers}}
    # How many points are observed.
    if n_observed is None:
        n_observed = 500 if cameras else min(500, len(garment.vertices))
    most = sum(camera.width * camera.height for camera in cameras) or len(garment.vertices)
    if not 1 <= n_observed <= most:
        what = "pixels of the cameras" if cameras else "vertices of the garment"
        raise ValueError(f"n_observed must be 1 to {most}, the {what}, not {n_observed}")
    # Plan the path, and turn the garment to its start.
    warn_of_floor(garment, target)
    path = planned(task, garment, target, Randomisation.generator(seed, "path"))
    garment = garment.turned(path.vias[0].yaw)
    if path.drawn:
        drawn["path"] = dict(path.drawn)
    # How long it takes; what does not fit into the memory is refused.
    frames = config.frames or max(FEWEST_FRAMES, math.ceil(min(path.end / config.frame_time, _MOST_STEPS)))
    config = dataclasses.replace(config, frames=frames)
    steps = frames * config.steps_per_frame
    places = frames * (len(garment.vertices) + n_observed)
    if steps > _MOST_STEPS or places > _MOST_PLACES:
        bounds = f"at most {_MOST_STEPS:,} steps and {_MOST_PLACES:,} places of points fit into the memory"
        raise ValueError(f"{frames:,} frames of {steps:,} steps and {places:,} places of points: {bounds}")
    goals = path.at(np.arange(steps) * config.dt)
    noise = int(Randomisation.generator(seed, "noise").integers(2**63))
    rods, moves = rods_of(target, np.arange(frames + 1) * config.frame_time)
    run = Run(garment, rods, moves, goals, round(path.release / config.dt), config, tuple(cameras), n_observed, noise)
    report = functools.partial(_show, frames) if progress else None
    if time_limit is None:
        recording = record(run, report)
    else:
        recording = record_afresh(run, positive(time_limit, "time_limit", zero=False, infinite=True), report)
    return as_episode(run, recording, task, target, seed, drawn)


def as_episode(
    run: Run,
    recording: Recording,
    task: Task,
    target: Target,
    seed: int,
    drawn: dict[str, Any],
    first: int | None = None,  # vertex of the samples: a world that is controlled shows the first one of the mesh
) -> Episode:
    """Return the episode of a run and of what was recorded; `drawn` is noted in its physics."""
    garment = run.garment
    config = run.config
    points = recording["points"]
    # At rest: a loop that flies past the arm links it, too.
    held = np.arange(len(points)) * config.steps_per_frame < run.release
    speed = float(np.linalg.norm(points[-1] - points[-2:][0], axis=1).mean()) / config.frame_time
    rests = len(points) > 1 and not held[-1] and speed < AT_REST
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
    # Without cameras all sides are observed.
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
        success=bool(rests and task.hangs(points[-1], garment.named_loops, target)),
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
    """Return the version of a package that is installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:  # run from a source tree that is not installed
        return "0+unknown"


def _show(frames: int, frame: int) -> None:
    """Write to stderr which frame of how many is done."""
    end = "\n" if frame + 1 == frames else ""
    print(f"\rsimulating: frame {frame + 1} of {frames}", end=end, file=sys.stderr, flush=True)


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """The whole input of a simulation, which may run in another process."""

    garment: Garment
    rods: Sequence[Rod]  # the target, as it stands at first
    moves: Array  # (frames + 1, R, 3) metres that each has gone by every frame; (0, R, 3) when it stands still
    goals: Array  # (steps, 2, 3) metres, where the grippers should be at every physics step
    release: int  # the step at which they let go
    config: SimulationConfig
    cameras: Sequence[Camera]  # that observe every frame; there may be none
    n_observed: int  # points that the cameras give together
    noise: int  # seed of the noise of the cameras


def record(run: Run, report: Report | None = None) -> Recording:
    """Simulate in this process; `report` is called with -1 now and then while the cloth settles, and with every frame."""
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
        # The garment settles between the grippers.
        for step in range(round(config.settle / config.dt)):
            if step % _CHECK_WHILE_SETTLING == 0 and step:
                check_stretch(garment, config, world.vertices(), "settling")
                report(-1)
            world.step(run.goals[0])
        # It is carried to the target, let go, and recorded.
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
    """Simulate in a fresh process; it is stopped when loading, settling or a frame takes longer than `time_limit` seconds."""
    stage = "loading the garment"

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
    """Return the rods of a target at the first of some times, and how far each has moved by each time; (0, R, 3) if it stands."""
    first = target.at(times[0]).rods
    if target.at(times[-1]) == target.at(times[0]):
        return first, np.zeros((0, len(first), 3))
    starts = np.array([[start for start, _, _ in target.at(time).rods] for time in times])
    return first, starts - starts[0]
