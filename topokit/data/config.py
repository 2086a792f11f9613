"""What a dataset is made of: a declared, versioned configuration, and an episode as a pure function of it, a seed and a number.

Source: Antonova et al. 2021, section 6 (garments, paths and physics are randomised). Taught in chapter 8.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from topokit._config import from_mapping
from topokit._validate import positive
from topokit.io import Episode
from topokit.sim import TASKS, DepthNoise, Garment, Randomisation, SimulationConfig, cameras_around, simulate

__all__ = ["DatasetConfig", "Draw", "draw", "garment_of", "make_episode"]

Sizes = Mapping[str, Mapping[str, float]]


def _every_task() -> dict[str, float]:
    return dict.fromkeys(sorted(TASKS), 1.0)


@dataclass(frozen=True)
class DatasetConfig:
    """What is drawn for the episodes of a dataset, and how they are simulated and observed.

    Attributes
    ----------
    tasks : mapping of str to float
        Names in `topokit.sim.TASKS` (a garment and a target) with the weights at which they are drawn.
    simulation : SimulationConfig
        Its `frames` is the length of every episode; None records each path to its end, at least 76 frames.
    randomisation : Randomisation or None
        Ranges of physics, size and cameras; None varies the path alone.
    sizes : mapping of str to mapping of str to float
        Sizes of a garment, by its name, that differ from the default ones, for example ``{"sheet": {"spacing": 0.05}}``.
    n_observed : int
        Points of an observation; all vertices of a garment that has fewer, when all sides are seen.
    cameras : int
        Depth cameras around the target. 0: farthest-point samples of the vertices, all sides seen.
    camera_distance : float
        Metres from the cameras to the seat of the target.
    depth_noise : bool
        Whether the cameras have the noise of a depth sensor.

    Raises
    ------
    TypeError, ValueError
        When a task or a garment is not known, or a number is out of its range; the message names it.

    Examples
    --------
    >>> config = DatasetConfig(tasks={"apron-hook": 1, "tote-hook": 3})
    >>> DatasetConfig.from_json(config.to_json()) == config
    True
    """

    tasks: Mapping[str, float] = field(default_factory=_every_task)
    simulation: SimulationConfig = field(default_factory=SimulationConfig)
    randomisation: Randomisation | None = field(default_factory=Randomisation)
    sizes: Sizes = field(default_factory=dict)
    n_observed: int = 512
    cameras: int = 0
    camera_distance: float = 2.2
    depth_noise: bool = False

    version = 1  # of the meaning of these numbers and of the order of the draws; saved with them

    def __post_init__(self) -> None:
        if not isinstance(self.tasks, Mapping) or not self.tasks:
            raise ValueError(f"tasks must name one task at least with its weight, not {self.tasks!r}")
        unknown = [name for name in self.tasks if name not in TASKS]
        if unknown:
            raise ValueError(f"tasks: there is no {', '.join(map(repr, unknown))}; there are {', '.join(TASKS)}")
        weights = {
            name: positive(self.tasks[name], f"tasks[{name!r}]", zero=False) for name in sorted(self.tasks)
        }  # sorted: what is drawn must not depend on the order in which they were named
        garments = {name.rpartition("-")[0] for name in weights}
        sizes = {}
        for name, values in self.sizes.items():
            if name not in garments:
                raise ValueError(f"sizes: no task has a garment {name!r}; the tasks have {', '.join(sorted(garments))}")
            sizes[name] = {key: positive(value, f"sizes[{name!r}][{key!r}]") for key, value in sorted(values.items())}
        object.__setattr__(self, "tasks", weights)
        object.__setattr__(self, "sizes", sizes)
        for name, least in (("n_observed", 1), ("cameras", 0)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise ValueError(f"{name} must be a whole number, at least {least}, not {value!r}")
        positive(self.camera_distance, "camera_distance", zero=False)
        if self.depth_noise and not self.cameras:
            raise ValueError("depth_noise is of cameras, and cameras is 0")

    def to_json(self) -> dict[str, Any]:
        """Return plain numbers, lists and dictionaries; `from_json` gives the same configuration back."""
        values = {name.name: getattr(self, name.name) for name in dataclasses.fields(self)}
        values["simulation"] = dataclasses.asdict(self.simulation)
        if self.randomisation is not None:
            values["randomisation"] = {"version": self.randomisation.version, **dataclasses.asdict(self.randomisation)}
        plain: dict[str, Any] = json.loads(json.dumps({"version": self.version, **values}))  # tuples become lists
        return plain

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> DatasetConfig:
        """Return the configuration of what `to_json` gave; what is left out has its default.

        Raises
        ------
        TypeError, ValueError
            When a name is not known, the version is another one, or a value is not what it must be.
        """
        parts = dict(values)
        if parts.pop("version", cls.version) != cls.version:
            raise ValueError(f"a configuration of version {values['version']}; this topokit reads {cls.version}")
        _only_known(parts, cls, "the configuration")
        if "simulation" in parts:
            _only_known(parts["simulation"], SimulationConfig, "simulation")
            parts["simulation"] = from_mapping(SimulationConfig, parts["simulation"], "simulation")
        if parts.get("randomisation") is not None:
            ranges = dict(parts["randomisation"])
            if ranges.pop("version", Randomisation.version) != Randomisation.version:
                raise ValueError(f"randomisation is of another version; this topokit has {Randomisation.version}")
            _only_known(ranges, Randomisation, "randomisation")
            parts["randomisation"] = from_mapping(Randomisation, ranges, "randomisation")
        return cls(**parts)


@dataclass(frozen=True)
class Draw:
    """What an episode is before it is simulated: its task and its own seed, of 63 bits."""

    task: str
    seed: int


def draw(config: DatasetConfig, seed: int, index: int) -> Draw:
    """Return task and seed of an episode.

    Examples
    --------
    >>> config = DatasetConfig()
    >>> draw(config, 0, 5) == draw(config, 0, 5) != draw(config, 0, 6)
    True
    """
    if index < 0:
        raise ValueError(f"episodes are numbered from 0; there is no {index}")
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
    names, weights = list(config.tasks), np.cumsum(list(config.tasks.values()))
    place = min(int(np.searchsorted(weights, rng.random() * weights[-1], side="right")), len(names) - 1)
    return Draw(names[place], int(rng.integers(2**63)))


def make_episode(config: DatasetConfig, seed: int, index: int, *, time_limit: float | None = 60.0) -> Episode:
    """Simulate episode `index` of the dataset of that configuration and seed: a pure function of the three.

    Parameters
    ----------
    config : DatasetConfig
    seed : int
        Of the dataset.
    index : int
        Number of the episode, from 0.
    time_limit : float, optional
        As in `topokit.sim.simulate`: None simulates in this process, which must then be a fresh one for the same bytes.

    Raises
    ------
    SimulationError, ImportError
        As `topokit.sim.simulate` does.
    """
    drawn = draw(config, seed, index)
    garment, target = garment_of(config, drawn.task), TASKS[drawn.task].target
    noise = DepthNoise() if config.depth_noise else None
    views = (
        cameras_around(target.seat, config.cameras, distance=config.camera_distance, noise=noise)
        if config.cameras
        else ()
    )
    return simulate(
        garment,
        target,
        task=drawn.task,
        seed=drawn.seed,
        config=config.simulation,
        randomisation=config.randomisation,
        cameras=views,
        n_observed=config.n_observed if views else min(config.n_observed, len(garment.vertices)),
        time_limit=time_limit,
    )


def garment_of(config: DatasetConfig, task: str) -> Garment:
    """Return the garment of a task, of the sizes in the configuration."""
    name = task.rpartition("-")[0]
    try:
        return TASKS[task].garment(**config.sizes.get(name, {}))
    except TypeError as error:
        raise ValueError(f"sizes[{name!r}]: {error}") from error


def _only_known(values: Mapping[str, Any], kind: type, where: str) -> None:
    names = [f.name for f in dataclasses.fields(kind)]
    unknown = [name for name in values if name not in names]
    if unknown:
        raise ValueError(f"{where} has no {', '.join(map(repr, unknown))}; it has {', '.join(names)}")
