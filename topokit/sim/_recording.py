"""Run a simulation, here or in a fresh process, and record its frames; refuse what is not physical."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topokit._config import from_mapping

from ._camera import Camera
from ._garments import Garment
from ._physics import SimulationConfig
from ._process import Forge, SimulationError
from ._targets import Rod
from ._world import World, observe

Array = NDArray[np.float64]
Report = Callable[[int], None]

_CHECK_WHILE_SETTLING = 5  # steps: in cloth that has exploded a single step of self-collision can take minutes
_JOB = "topokit.sim._recording:record_job"
_ERRORS = {error.__name__: error for error in (SimulationError, ValueError, ImportError)}


@dataclass(frozen=True, eq=False)
class Run:
    """All that a process needs to know in order to simulate."""

    garment: Garment
    rods: Sequence[Rod]  # the target
    goals: Array  # (steps, 2, 3) metres, where the grippers should be at every physics step
    release: int  # the step at which they let go
    config: SimulationConfig
    cameras: Sequence[Camera]  # that observe every frame; there may be none
    n_observed: int  # points that the cameras give together
    noise: int  # seed of the noise of the cameras


@dataclass(frozen=True, eq=False)
class Recording:
    """The frames of a run."""

    points: NDArray[np.float32]  # (T, N, 3)
    grippers: NDArray[np.float32]  # (T, 2, 3)
    observed: NDArray[np.float32]  # (T, M, 3), and M is 0 without cameras
    stretch: Array  # (T, 2) the 99th percentile and the maximum of edge length over rest length


def record(run: Run, report: Report | None = None) -> Recording:
    """Simulate in this process; `report` is called with -1 now and then while the cloth settles, and with every frame.

    Raises
    ------
    SimulationError
        When the cloth explodes or is over-stretched; the message names frame, edge and stretch.
    """
    garment, config = run.garment, run.config
    report = report or (lambda _: None)
    check = StretchCheck(garment, config)
    offset = run.goals[0].mean(axis=0) - garment.vertices[garment.grips].mean(axis=0)
    noise = np.random.default_rng(run.noise)
    points, grippers, observed, stretch = [], [], [], []
    with World(garment, offset, config) as world:
        world.add_rods(run.rods)
        for step in range(round(config.settle / config.dt)):
            if step % _CHECK_WHILE_SETTLING == 0 and step:
                check(world.vertices(), "settling")
                report(-1)
            world.step(run.goals[0])
        for step, goal in enumerate(run.goals):
            if step == run.release:
                world.release()
            if step % config.steps_per_frame == 0:
                points.append(world.vertices())
                stretch.append(check(points[-1], f"frame {len(points) - 1}"))
                grippers.append(world.grippers())
                if run.cameras:
                    observed.append(observe(world, run.cameras, run.n_observed, noise))
                report(len(points) - 1)
            world.step(goal)
    views = np.array(observed, dtype=np.float32) if observed else np.empty((len(points), 0, 3), np.float32)
    return Recording(np.array(points, np.float32), np.array(grippers, np.float32), views, np.array(stretch))


def record_afresh(run: Run, time_limit: float, report: Report | None = None) -> Recording:
    """Simulate in a fresh process; it is stopped when loading, settling or a frame takes longer than `time_limit` seconds.

    Raises
    ------
    SimulationError
        As `record`, and when the process crashes or is stopped; the message says where it was.
    ImportError
        When PyBullet is not installed.
    """
    stage = "loading the garment"

    def note(frame: int) -> None:
        nonlocal stage
        stage = "settling" if frame < 0 else f"after frame {frame}"
        if report is not None:
            report(frame)

    with tempfile.TemporaryDirectory() as folder, contextlib.closing(Forge(_JOB, once=True)) as forge:
        result = forge.run(_as_job(run, folder), math.inf, silence=time_limit, report=note)
        if "error" in result:
            raise SimulationError(f"{stage}: {result['message']}")
        if result["answer"] is not None:
            error, message = result["answer"]
            raise _ERRORS[error](message)
        with np.load(f"{folder}/recording.npz") as arrays:
            return Recording(**arrays)


def record_job(job: dict[str, Any], report: Report) -> tuple[str, str] | None:
    """What the fresh process does: simulate and save the recording; return the error and its message, if there is one."""
    try:
        recording = record(_as_run(job), report)
    except tuple(_ERRORS.values()) as error:
        return type(error).__name__, str(error)
    np.savez(f"{job['folder']}/recording.npz", **vars(recording))
    return None


def _as_job(run: Run, folder: str) -> dict[str, Any]:
    """What JSON holds of a run; its arrays are saved in the folder."""
    arrays = {name: getattr(run.garment, name) for name in ("vertices", "faces", "grips")}
    rods = np.array([[*start, *end, radius] for start, end, radius in run.rods]).reshape(-1, 7)
    np.savez(f"{folder}/run.npz", rods=rods, goals=run.goals, **arrays)
    numbers = {name: getattr(run, name) for name in ("release", "n_observed", "noise")}
    views = [dataclasses.asdict(camera) for camera in run.cameras]
    return {"folder": folder, "config": dataclasses.asdict(run.config), "cameras": views, "numbers": numbers}


def _as_run(job: dict[str, Any]) -> Run:
    with np.load(f"{job['folder']}/run.npz") as arrays:
        garment = Garment("", arrays["vertices"], arrays["faces"], (), arrays["grips"])
        rods = [(rod[:3], rod[3:6], float(rod[6])) for rod in arrays["rods"]]
        goals = arrays["goals"]
    config = from_mapping(SimulationConfig, job["config"], "config")
    cameras = [from_mapping(Camera, camera, "camera") for camera in job["cameras"]]
    return Run(garment, rods, goals, config=config, cameras=cameras, **job["numbers"])


class StretchCheck:
    """Refuses frames that are not physical."""

    def __init__(self, garment: Garment, config: SimulationConfig) -> None:
        self._edges, self._rest, self._config = garment.edges, garment.edge_lengths, config

    def __call__(self, points: Array, where: str) -> tuple[float, float]:
        lost = ~np.isfinite(points).all(axis=1)
        if lost.any():
            vertex = int(np.argmax(lost))
            raise SimulationError(f"{where}: vertex {vertex} is at {points[vertex]}: the cloth exploded")
        ends = points[self._edges]
        stretch = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) / self._rest
        most, worst = float(np.percentile(stretch, 99)), int(np.argmax(stretch))
        edge = f"{self._edges[worst].tolist()}, {stretch[worst]:.2f} times its length"
        if most > self._config.max_stretch:
            raise SimulationError(
                f"{where}: one edge in a hundred is stretched beyond {most:.2f} times its length "
                f"(max_stretch is {self._config.max_stretch:g}), most of all {edge}"
            )
        if stretch[worst] > self._config.max_edge_stretch:
            raise SimulationError(
                f"{where}: one edge is over-stretched (max_edge_stretch is {self._config.max_edge_stretch:g}): {edge}"
            )
        return most, float(stretch[worst])
