"""Run a simulation in this process and record its frames; refuse what is not physical."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .camera import Camera, observe
from .config import SimulationConfig
from .garments import Garment
from .targets import Rod
from .world import World

__all__ = ["Recording", "Report", "Run", "SimulationError", "record"]

Array = NDArray[np.float64]
Report = Callable[[int], None]

_CHECK_WHILE_SETTLING = 5  # steps: in cloth that has exploded a single step of self-collision can take minutes


class SimulationError(RuntimeError):
    """A run that failed: cloth that exploded or was stretched too far, a simulator that crashed or does not get on."""


@dataclass(frozen=True, eq=False)
class Run:
    """All that a process needs to know in order to simulate.

    Attributes
    ----------
    garment : Garment
    rods : sequence of (start, end, radius)
        The target.
    goals : (steps, 2, 3) float64
        Where the grippers should be at every physics step, metres.
    release : int
        The step at which they let go.
    config : SimulationConfig
    cameras : sequence of Camera
        That observe every frame; none when empty.
    n_observed : int
        Points that the cameras give together.
    noise : int
        Seed of the noise of the cameras.
    """

    garment: Garment
    rods: Sequence[Rod]
    goals: Array
    release: int
    config: SimulationConfig
    cameras: Sequence[Camera] = ()
    n_observed: int = 0
    noise: int = 0


@dataclass(frozen=True, eq=False)
class Recording:
    """The frames of a run: points (T, N, 3), grippers (T, 2, 3), observed (T, M, 3), and stretch (T, 2).

    `stretch` is the 99th percentile and the maximum of edge length over rest length. M is 0 without cameras.
    """

    points: NDArray[np.float32]
    grippers: NDArray[np.float32]
    observed: NDArray[np.float32]
    stretch: Array


def record(run: Run, report: Report | None = None) -> Recording:
    """Simulate in this process.

    Parameters
    ----------
    run : Run
    report : callable, optional
        Called with -1 now and then while the loaded garment settles, and with the number of every recorded frame.

    Raises
    ------
    SimulationError
        When the cloth explodes or is over-stretched; the message names frame, edge and stretch.
    ImportError
        When PyBullet is not installed.
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
    seen = np.array(observed, dtype=np.float32) if observed else np.empty((len(points), 0, 3), np.float32)
    return Recording(np.array(points, np.float32), np.array(grippers, np.float32), seen, np.array(stretch))


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
