"""Record an episode: two grippers carry a garment to a target, hang it there and let go.

Source: Antonova et al. 2021, section 6 (two anchors, a PD controller, randomised paths). Taught in chapter 0.
"""

from __future__ import annotations

import dataclasses
import platform
import sys
from dataclasses import dataclass
from importlib import metadata

import numpy as np
from numpy.typing import NDArray

from topokit.io import Episode
from topokit.sampling import farthest_point_sample

from .config import SimulationConfig
from .garments import Garment
from .targets import Hook
from .world import World

__all__ = ["SimulationError", "simulate"]

Array = NDArray[np.float64]
_AT_REST = 0.3  # m/s, mean over the vertices: a hung apron still swings a little, a falling one is faster within 0.03 s


class SimulationError(RuntimeError):
    """A run that is not physical: cloth that exploded or was stretched too far. The message says when and where."""


@dataclass(frozen=True)
class _Path:
    """Where the middle between the grippers is meant to be: minimum-jerk moves between places."""

    places: Array  # (k, 3)
    times: Array  # (k,) seconds, increasing; a move ends when the next begins

    def at(self, time: float) -> Array:
        """(3,) at rest at every place, and before the first and after the last time."""
        i = int(np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(self.times) - 2))
        s = float(np.clip((time - self.times[i]) / (self.times[i + 1] - self.times[i]), 0, 1))
        share = s**3 * (10 - 15 * s + 6 * s * s)
        return np.asarray(self.places[i] + share * (self.places[i + 1] - self.places[i]))


def simulate(
    garment: Garment | None = None,
    target: Hook | None = None,
    *,
    seed: int = 0,
    config: SimulationConfig | None = None,
    n_observed: int = 500,
    progress: bool = False,
) -> Episode:
    """Record one episode: `garment` hung between two grippers, carried to `target`, let go there.

    Parameters
    ----------
    garment : Garment, optional
        `Garment.apron()` when not given.
    target : Hook, optional
    seed : int
        Of the start and of the path. The same seed and options give the same bytes in a fresh process.
    config : SimulationConfig, optional
    n_observed : int
        Size of the observation: farthest-point samples of the vertices of each frame.
    progress : bool
        Write the share done to stderr.

    Returns
    -------
    Episode
        With `success` when, after release, the garment's loop winds around the target and the garment is at rest there.

    Raises
    ------
    SimulationError
        When the cloth explodes or is over-stretched; the message names frame, edge and stretch.
    ImportError
        When PyBullet is not installed.
    ValueError
        When `n_observed` exceeds the number of vertices.
    """
    garment, target, config = garment or Garment.apron(), target or Hook(), config or SimulationConfig()
    if not 1 <= n_observed <= len(garment.vertices):
        raise ValueError(f"n_observed must be 1 to {len(garment.vertices)}, the garment's vertices, not {n_observed}")
    path, release_time = _plan(target, config, np.random.default_rng(seed))
    grips = garment.vertices[garment.grips]
    middle = grips.mean(axis=0)
    spread = grips - middle
    recorder = _Recorder(garment, config, progress)
    with World(garment, path.at(0.0) - middle, config) as world:
        world.add_rods(target.rods)
        for _ in range(round(config.settle / config.dt)):
            world.step(path.at(0.0) + spread)
        held = True
        for step in range(config.frames * config.steps_per_frame):
            time = step * config.dt
            if held and time >= release_time:
                world.release()
                held = False
            goal = path.at(min(time, release_time)) + spread
            if step % config.steps_per_frame == 0:
                recorder.record(world, goal, held)
            world.step(goal)
    return recorder.episode(target, seed, n_observed)


def _plan(target: Hook, config: SimulationConfig, rng: np.random.Generator) -> tuple[_Path, float]:
    """A path of the middle between the grippers, and when they let go; both vary with the seed.

    The strap between the grippers is carried over the tip, so that the arm comes into the opening below it, then lowered
    until it rests on the arm.
    """
    over = target.seat + [0, 0, target.tip + 0.045]
    start = over + [rng.uniform(-0.12, 0.12), rng.uniform(-0.55, -0.42), rng.uniform(-0.06, 0.10)]
    before = over + [rng.uniform(-0.015, 0.015), -target.reach / 2 - 0.12, rng.uniform(0.0, 0.02)]
    over[0] = rng.uniform(-0.015, 0.015)
    down = over * [1, 1, 0] + [0, rng.uniform(-0.01, 0.02), target.height + target.radius + 0.005]
    whole = config.frames * config.frame_time
    times = whole * np.array([0.06, 0.32, 0.55, 0.69])
    return _Path(np.array([start, before, over, down]), times), float(times[-1] + 0.02 * whole)


class _Recorder:
    """Collects frames and refuses a run that is not physical."""

    def __init__(self, garment: Garment, config: SimulationConfig, progress: bool) -> None:
        self.garment, self.config, self.progress = garment, config, progress
        self.points: list[Array] = []
        self.actions: list[Array] = []
        self.grippers: list[Array] = []
        self.held: list[bool] = []

    def record(self, world: World, goal: Array, held: bool) -> None:
        """Take a frame of the world."""
        points = world.vertices()
        self._check(points)
        self.points.append(points)
        self.actions.append(goal)
        self.grippers.append(world.grippers())
        self.held.append(held)
        if self.progress:
            end = "\n" if len(self.points) == self.config.frames else ""
            print(
                f"\rsimulating: frame {len(self.points)} of {self.config.frames}", end=end, file=sys.stderr, flush=True
            )

    def _check(self, points: Array) -> None:
        frame = len(self.points)
        lost = ~np.isfinite(points).all(axis=1)
        if lost.any():
            raise SimulationError(
                f"frame {frame}: vertex {np.argmax(lost)} is at {points[np.argmax(lost)]}: the cloth exploded"
            )
        edges = self.garment.edges
        stretch = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1) / self.garment.edge_lengths
        if np.percentile(stretch, 99) > self.config.max_stretch:
            worst = int(np.argmax(stretch))
            raise SimulationError(
                f"frame {frame}: one edge in a hundred is stretched beyond {np.percentile(stretch, 99):.2f} times its length "
                f"(limit {self.config.max_stretch}), the worst, {edges[worst].tolist()}, {stretch[worst]:.2f} times"
            )

    def episode(self, target: Hook, seed: int, n_observed: int) -> Episode:
        """Everything recorded, with its truth and its parameters."""
        points = np.array(self.points, dtype=np.float32)
        observed = np.array([frame[farthest_point_sample(frame, n_observed)[0]] for frame in points])
        loops = tuple(loop.astype(np.int32) for loop in self.garment.loops)
        return Episode(
            points=points,
            observed=observed,
            actions=np.array(self.actions, dtype=np.float32),
            grippers=np.array(self.grippers, dtype=np.float32),
            held=np.array(self.held),
            faces=self.garment.faces.astype(np.int32),
            loops=loops,
            centre_line=target.centre_line.astype(np.float32),
            garment=self.garment.name,
            target=target.name,
            success=_hangs(points, self.held[-1], loops, target, self.config.frame_time),
            seed=seed,
            dt=self.config.frame_time,
            physics={
                "config": dataclasses.asdict(self.config),
                "elastic_stiffness": self.config.elastic_stiffness(len(self.garment.vertices)),
                "garment": dict(self.garment.parameters),
                "target": dataclasses.asdict(target),
            },
            provenance={
                "topokit": _version("topokit"),
                "pybullet": _version("pybullet"),
                "machine": platform.machine(),
            },
        )


def _hangs(
    frames: NDArray[np.float32], held: bool, loops: tuple[NDArray[np.int32], ...], target: Hook, frame_time: float
) -> bool:
    """Whether the garment, let go, is at rest with a true loop around the target and not on the floor.

    A loop that flies past the arm links it too: hence the rest.
    """
    if held or len(frames) < 2:
        return False
    points = frames[-1]
    speed = float(np.linalg.norm(points - frames[-2], axis=1).mean()) / frame_time
    hung = [loop for loop in loops if target.holds(points[loop])]
    return speed < _AT_REST and any(points[loop][:, 2].max() > target.height for loop in hung)


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:  # run from a source tree that is not installed
        return "0+unknown"
