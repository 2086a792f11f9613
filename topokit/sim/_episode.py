"""Record an episode: two grippers carry a garment to a target, hang it there and let go.

Everything that varies between episodes is drawn from declared ranges, and the draws are recorded in the episode. Each purpose
(path, physics, cameras, noise) has a generator of its own.

Source: Antonova et al. 2021, section 6 (stiffness and paths are randomised). Taught in chapters 0 and 10.
"""

from __future__ import annotations

import dataclasses
import math
import platform
from collections.abc import Sequence
from importlib import metadata
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topokit._processes import in_fresh_processes
from topokit.io import HISTORY, HORIZON, Episode, wardrobe_names
from topokit.sampling import farthest_point_sample

from ._camera import Camera
from ._garments import Garment
from ._randomisation import Randomisation
from ._surface import Array
from ._targets import Rod, Target
from ._tasks import Task, resolved
from ._wardrobe import WARDROBE
from ._world import SimulationConfig, SimulationError, World, check_stretch

# The arrays of a recording, a row a frame: points (T, N, 3), grippers and actions (T, 2, 3), held (T,), stretch (T, 2), and
# the points observed by cameras (T, M, 3), if there are any.
Recording = dict[str, NDArray[Any]]


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """The whole input of a simulation, so that it can run in another process."""

    garment: Garment
    rods: Sequence[Rod]
    goals: Array  # (steps, 2, 3) where the grippers should be at each physics step, metres
    release: int  # the step at which the grippers let go
    config: SimulationConfig
    cameras: Sequence[Camera]  # the cameras that observe every frame, if any
    n_observed: int  # how many points the cameras observe in a frame
    noise: int  # seed of the noise of the cameras


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
    time_limit: float | None = 600.0,
) -> Episode:
    """Simulate one episode and return it: a garment hangs between two grippers, is carried to a target, and is let go there.

    The episode is a success when, after the release, the loops of the task are on the target and the garment is at rest. A
    `SimulationError` says that the cloth exploded or was over-stretched, or that the simulator crashed or was stopped.

    Parameters
    ----------
    garment, target : optional
        The garment and the target of the task when not given. Without a task either, an apron is hung on a hook.
    task : str or Task, optional
        A name in `TASKS` or a task; when not given, the task of the garment and the target (`Task.of`).
    seed : int
        Seed of everything random. Path, physics, cameras and their noise each have a generator of their own.
    config : SimulationConfig, optional
        When not given, `SimulationConfig()` for a garment of `WARDROBE`, and `SimulationConfig.of(garment)` for any other.
    randomisation : Randomisation, optional
        The ranges from which physics, size and cameras are drawn. Without it nothing varies but the path.
    cameras : sequence of Camera, optional
        The cameras that observe the cloth. Without any, farthest-point samples of the vertices on all sides are observed.
    n_observed : int, optional
        How many points are observed in each frame. When not given: 500, or all vertices if there are fewer.
    time_limit : float, optional
        Seconds that the simulation may take in a fresh process; the same call then gives the same bytes anywhere in a program.
        With None it runs in this process, and only its first simulation gives these bytes.
    """
    task, garment, target = resolved(task, garment, target)
    config = config or usual_config(garment)
    notes: dict[str, Any] = {"randomisation": None}
    if randomisation is not None:
        config, garment, cameras, drawn = randomisation.draw(seed, config, garment, cameras)
        ranges = {name: bounds and list(bounds) for name, bounds in dataclasses.asdict(randomisation).items()}
        notes["randomisation"] = {"version": randomisation.version, "ranges": ranges, "drawn": drawn}
    if n_observed is None:
        n_observed = 500 if cameras else min(500, len(garment.vertices))
    # Plan the path, and turn the garment to its start.
    path = task.path(garment, target, Randomisation.generator(seed, "path"))
    garment = garment.turned(path.table["yaw"][0])
    if path.drawn:
        notes["path"] = dict(path.drawn)
    frames = config.frames or max(HISTORY + HORIZON, math.ceil(path.end / config.frame_time))
    config = dataclasses.replace(config, frames=frames)
    # Simulate the run, and make the recording an episode.
    goals = path.at(np.arange(frames * config.steps_per_frame) * config.dt)
    noise = int(Randomisation.generator(seed, "noise").integers(2**63))
    release = round(path.release / config.dt)
    run = Run(garment, target.rods, goals, release, config, tuple(cameras), n_observed, noise)
    recording = record(run) if time_limit is None else record_afresh(run, time_limit)
    if not cameras:
        chosen = (farthest_point_sample(frame, n_observed)[0] for frame in recording["points"])
        recording["observed"] = np.array([frame[ids] for frame, ids in zip(recording["points"], chosen, strict=True)])
    return as_episode(recording, task, garment, target, config, seed, notes, cameras)


def record(run: Run) -> Recording:
    """Simulate a run in this process and return its recording."""
    garment = run.garment
    config = run.config
    offset = run.goals[0].mean(axis=0) - garment.vertices[garment.grips].mean(axis=0)
    noise = np.random.default_rng(run.noise)
    rows: dict[str, list[Any]] = {"points": [], "grippers": [], "stretch": [], "observed": []}
    with World(garment, offset, config) as world:
        world.add_rods(run.rods)
        world.settle(run.goals[0])
        # Carry it to the target, let go, and record a frame every few steps.
        for step, goal in enumerate(run.goals):
            if step == run.release:
                world.release()
            if step % config.steps_per_frame == 0:
                frame = step // config.steps_per_frame
                points = world.vertices()
                rows["points"].append(points)
                rows["stretch"].append(check_stretch(garment, config, points, f"frame {frame}"))
                rows["grippers"].append(world.grippers())
                if run.cameras:
                    cloud = world.observe(run.cameras, run.n_observed, noise)
                    if not len(cloud):
                        raise ValueError(f"no cloth is in view of the cameras in frame {frame}")
                    rows["observed"].append(cloud)
            world.step(goal)
    recording: Recording = {name: np.array(values, np.float32) for name, values in rows.items()}
    recording["stretch"] = np.array(rows["stretch"])
    recording["actions"] = run.goals[:: config.steps_per_frame].astype(np.float32)
    recording["held"] = np.arange(len(recording["points"])) * config.steps_per_frame < run.release
    return recording


def record_afresh(run: Run, time_limit: float) -> Recording:
    """Simulate a run in a fresh process, which is stopped after `time_limit` seconds."""
    ((_, recording),) = in_fresh_processes(record, [run], time_limit=time_limit)
    if isinstance(recording, RuntimeError):
        raise SimulationError(str(recording)) from recording
    if isinstance(recording, Exception):
        raise recording
    return dict(recording)


def usual_config(garment: Garment) -> SimulationConfig:
    """Return the default physics of a garment: the standard one for the wardrobe, else one for its area and edges."""
    return SimulationConfig() if garment.name in WARDROBE else SimulationConfig.of(garment)


def is_at_rest(before: Array, points: Array, seconds: float) -> bool:
    """Return whether vertices moved below 0.3 m/s in the mean: a hung apron swings more slowly, one that falls is faster."""
    return float(np.linalg.norm(points - before, axis=1).mean()) / seconds < 0.3


def as_episode(
    recording: Recording,
    task: Task,
    garment: Garment,
    target: Target,
    config: SimulationConfig,
    seed: int,
    notes: dict[str, Any],
    cameras: Sequence[Camera] = (),
) -> Episode:
    """Return the episode of a recording, with everything that a repetition needs; the notes are added to its physics."""
    points = recording["points"]
    # Success needs the garment to be at rest, since a loop that flies past the arm links it, too.
    at_rest = len(points) > 1 and not recording["held"][-1] and is_at_rest(points[-2], points[-1], config.frame_time)
    physics = {
        "config": dataclasses.asdict(config),
        "elastic_stiffness": config.elastic_stiffness(len(garment.vertices)),
        "garment": dict(garment.parameters),
        "target": target.describe(),
        **notes,
    }
    if garment.loop_names != wardrobe_names(garment.name, garment.parameters):
        physics["loops"] = list(garment.loop_names)
    physics["stretch"] = dict(zip(("p99", "worst"), recording["stretch"].max(axis=0).tolist(), strict=True))
    described = [dataclasses.asdict(camera) for camera in cameras]
    versions = {name: metadata.version(name) for name in ("topokit", "pybullet")}
    return Episode(
        points=points,
        observed=recording["observed"],
        actions=recording["actions"],
        grippers=recording["grippers"],
        held=recording["held"],
        faces=garment.faces.astype(np.int32),
        loops=tuple(loop.astype(np.int32) for loop in garment.loops),
        centre_line=target.centre_line.astype(np.float32),
        garment=garment.name,
        target=target.name,
        task=task.name,
        success=bool(at_rest and task.succeeds(points[-1], garment.named_loops, target)),
        seed=seed,
        dt=config.frame_time,
        observation={"kind": "cameras" if cameras else "vertices", "cameras": described},
        physics=physics,
        provenance={**versions, "machine": platform.machine()},
    )
