"""What a dataset is made of: a declared, versioned configuration, and an episode as a pure function of it, a seed and a number.

Source: Antonova et al. 2021, section 6 (garments, paths and physics are randomised). Taught in chapter 8.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
from collections.abc import Mapping
from dataclasses import field
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import BeforeValidator, Field

from topokit._config import Count, Positive, checked, from_mapping
from topokit.io import FEWEST_FRAMES, HISTORY, Episode
from topokit.sim import (
    TASKS,
    DepthNoise,
    Garment,
    Mannequin,
    Placed,
    Randomisation,
    SimulationConfig,
    Target,
    Task,
    cameras_around,
    off_script,
    simulate,
)
from topokit.sim._off_script import LONGEST
from topokit.sim._randomisation import MOST, generator, varied_garment, varied_target

_LATER = ("scarf", "belt", "net")  # than version 1, whose default tasks stay what they were
_OF_TWO = ("off_script", "places", "vary")
_FINEST = 0.005  # metres between vertices; no garment is asked for that would take hours to mesh


class Draw(NamedTuple):
    """What an episode is before it is simulated."""

    task: str
    seed: int  # its own, of 63 bits


def _ranges(values: Any) -> Any:
    """The ranges of a JSON document: without the version that `to_json` notes beside them, and its lists as tuples."""
    if not isinstance(values, Mapping):
        return values
    if values.get("version", Randomisation.version) != Randomisation.version:
        raise ValueError(f"of another version; this topokit has {Randomisation.version}")
    plain = {name: value for name, value in values.items() if name != "version"}
    return {name: tuple(value) if isinstance(value, list) else value for name, value in plain.items()}


@checked
class DatasetConfig:
    """What is drawn for the episodes of a dataset, and how they are simulated and observed.

    Raises
    ------
    ValueError
        When a task or a garment is not known, or a value is not what it must be; the message names it.
    """

    #: Of the meaning of these numbers and of the order of the draws; saved with them. What needs 2 says so.
    version: Literal[1, 2] = 1
    #: Names in `topokit.sim.TASKS` (a garment and a target) with the weights at which they are drawn.
    tasks: Annotated[Mapping[str, Positive], Field(min_length=1)] = field(
        default_factory=lambda: {task: 1.0 for task in TASKS if task.partition("-")[0] not in _LATER}
    )
    #: Its `frames` is the length of every episode; None records each path to its end, at least 76 frames.
    simulation: SimulationConfig = field(default_factory=SimulationConfig)
    #: Ranges of physics, size and cameras; None varies the path alone.
    randomisation: Annotated[Randomisation | None, BeforeValidator(_ranges)] = field(default_factory=Randomisation)
    #: Sizes of a garment, by its name, that differ from the default ones: ``{"sheet": {"spacing": 0.05}}``.
    sizes: Mapping[str, Mapping[str, Annotated[float, Field(ge=0, le=10)]]] = field(default_factory=dict)
    n_observed: Count = 512  #: points of an observation; all vertices of a garment with fewer, when all sides are seen
    #: Depth cameras around the target. 0: farthest-point samples of the vertices, all sides seen.
    cameras: Annotated[int, Field(ge=0, le=100)] = 0
    camera_distance: Positive = 2.2  #: metres from the cameras to the seat of the target
    depth_noise: bool = False  #: whether the cameras have the noise of a depth sensor
    #: Share of the episodes whose path leaves its script (`topokit.sim.off_script`). This and what follows: version 2.
    off_script: Annotated[float, Field(ge=0, le=1)] = 0.0
    #: Half the side, in metres, of the square in which the target's place is drawn, and any yaw; 0: all stand where they do.
    places: Annotated[float, Field(ge=0, le=1)] = 0.0
    #: By how much sizes vary: each of the garment's is multiplied by 1 / (1 + vary) to 1 + vary. By half of it those of the
    #: target, and of what a mannequin wears, which must fit.
    vary: Annotated[float, Field(ge=0, le=1)] = 0.0

    def __post_init__(self) -> None:
        new = [name for name in _OF_TWO if getattr(self, name) and self.version == 1]
        if new:
            raise ValueError(f"{new[0]} is of version 2 of the configuration, and version is 1: say version 2")
        unknown = [name for name in self.tasks if name not in TASKS]
        if unknown:
            raise ValueError(f"tasks: there is no {', '.join(map(repr, unknown))}; there are {', '.join(TASKS)}")
        garments = sorted({name.rpartition("-")[0] for name in self.tasks})
        for name in self.sizes:
            if name not in garments:
                raise ValueError(f"sizes: no task has a garment {name!r}; the tasks have {', '.join(garments)}")
            if self.sizes[name].get("spacing", 1.0) < _FINEST:
                raise ValueError(f"sizes: spacing of {name!r} must be at least {_FINEST} m: a finer one fits none")
        if self.depth_noise and not self.cameras:
            raise ValueError("depth_noise is of cameras, and cameras is 0")
        # Sorted: what is drawn must not depend on the order in which tasks were named.
        object.__setattr__(self, "tasks", dict(sorted(self.tasks.items())))
        object.__setattr__(self, "sizes", {name: dict(sorted(sizes.items())) for name, sizes in self.sizes.items()})

    def to_json(self) -> dict[str, Any]:
        """Return plain numbers, lists and dictionaries; `from_json` gives the same configuration back."""
        values = dataclasses.asdict(self)
        if self.randomisation is not None:
            values["randomisation"] = {"version": Randomisation.version, **values["randomisation"]}
        plain: dict[str, Any] = json.loads(json.dumps(values))  # tuples become lists
        return {name: value for name, value in plain.items() if self.version > 1 or name not in _OF_TWO}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> DatasetConfig:
        """Return the configuration of what `to_json` gave; what is left out has its default."""
        return from_mapping(cls, values, "the configuration")

    def draw(self, seed: int, index: int) -> Draw:
        """Return task and seed of an episode.

        Parameters
        ----------
        seed, index : int
            Of the dataset, and number of the episode, from 0.
        """
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
        names, weights = list(self.tasks), np.cumsum(list(self.tasks.values()))
        place = min(int(np.searchsorted(weights, rng.random() * weights[-1], side="right")), len(names) - 1)
        return Draw(names[place], int(rng.integers(2**63)))

    def garment(self, task: str) -> Garment:
        """Return the garment of a task, of its size in this configuration.

        Raises
        ------
        ValueError
            When the garment has no such size.
        """
        name = task.rpartition("-")[0]
        try:
            return TASKS[task].garment(**self.sizes.get(name, {}))
        except TypeError as error:
            raise ValueError(f"sizes[{name!r}]: {error}") from error


def _scene(config: DatasetConfig, name: str, seed: int) -> tuple[Task, Garment, Target]:
    """Task, garment and target of an episode; sizes, place and script have each a generator of their own."""
    task, garment, ranges = TASKS[name], config.garment(name), config.randomisation
    plan, target = task.plan, task.target
    if config.vary:
        rng, largest = generator(seed, "sizes"), ranges.scale[1] if ranges and ranges.scale else 1.0
        vary = config.vary / (2 if isinstance(target, Mannequin) else 1)
        target = varied_target(target, config.vary / 2, rng)
        make = functools.partial(task.garment, **config.sizes.get(name.rpartition("-")[0], {}))
        garment = varied_garment(make, garment, vary, rng, target.seat[2] / largest)
    rng = generator(seed, "script")
    if rng.random() < config.off_script:
        task = dataclasses.replace(task, plan=lambda g, t, own: off_script(plan(g, t, own), g, t, rng))
    if config.places:
        x, y, turn = generator(seed, "place").uniform(-1, 1, 3).tolist()
        target = Placed(target, x=config.places * x, y=config.places * y, yaw=180 * turn)
    return task, garment, target


def make_episode(config: DatasetConfig, seed: int, index: int, *, time_limit: float | None = 60.0) -> Episode:
    """Simulate episode `index` of the dataset of that configuration and seed: a pure function of the three.

    Parameters
    ----------
    config : DatasetConfig
    seed, index : int
        Of the dataset, and number of the episode, from 0.
    time_limit : float, optional
        As in `topokit.sim.simulate`: None simulates in this process, which must then be a fresh one for the same bytes.
    """
    name, episode_seed = config.draw(seed, index)
    task, garment, target = _scene(config, name, episode_seed)
    cameras, noise = config.cameras, DepthNoise() if config.depth_noise else None
    return simulate(
        garment,
        target,
        task=task,
        seed=episode_seed,
        config=config.simulation,
        randomisation=config.randomisation,
        cameras=cameras_around(target.seat, cameras, distance=config.camera_distance, noise=noise) if cameras else (),
        n_observed=config.n_observed if cameras else min(config.n_observed, len(garment.vertices)),
        time_limit=time_limit,
    )


def room(config: DatasetConfig) -> dict[str, int]:
    """Return how many frames, vertices, faces and so on the largest episode of a configuration has: its tasks decide."""
    garments = [config.garment(task) for task in config.tasks]
    tasks = [TASKS[task] for task in config.tasks]
    frames, loops = config.simulation.frames, [loop for garment in garments for loop in garment.loops]
    if frames is None:
        plans = [task.plan(own, task.target, generator(0, "path")) for task, own in zip(tasks, garments, strict=True)]
        least = LONGEST if config.off_script else 0.0
        longest = max([least, *(plan.end for plan in plans)]) / config.simulation.frame_time
        frames = max(FEWEST_FRAMES, math.ceil(min(longest, 2**62)))
    more = MOST if config.vary else 1.0
    vertices = int(more * max(len(garment.vertices) for garment in garments))
    return {
        "frames": -(-frames // HISTORY) * HISTORY,
        "vertices": vertices,
        "observed": min(config.n_observed, vertices),
        "seen": config.n_observed if config.cameras else 0,
        "faces": int(more * max(len(garment.faces) for garment in garments)),
        "loops": max([1, *(len(garment.loops) for garment in garments)]),
        "loop": int(more * max([1, *map(len, loops)])),
        "line": max(len(task.target.centre_line) for task in tasks),
    }
