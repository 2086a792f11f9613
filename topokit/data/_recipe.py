"""The configuration of a dataset, and an episode as a pure function of the configuration, a seed and a number.

Source: Antonova et al. 2021, section 6 (garments, paths and physics are randomised). Taught in chapter 11.
"""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import field
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from topokit._config import Count, Positive, checked, from_mapping
from topokit.io import Episode
from topokit.sim import (
    TASKS,
    Camera,
    Garment,
    Hanger,
    Hook,
    Mannequin,
    Randomisation,
    SimulationConfig,
    Task,
    simulate,
)

Target = Hook | Hanger | Mannequin


@checked
class DatasetConfig:
    """The configuration of a dataset: the random draws of its episodes, their simulation and their observation.

    A mesh of one's own has the physics of `topokit.sim.SimulationConfig.of`. Numbers of `simulation` that differ from
    the default replace them. Its time step is the smaller of the two, and its frame time is given by `simulation`. The ranges
    of `randomisation` are then factors: a mass twice as large as in `simulation` is drawn from twice the range. A ValueError
    names a task or a garment that is unknown, or a value that is not allowed.
    """

    #: Names in `topokit.sim.TASKS` (a garment and a target) with the weights at which they are drawn.
    tasks: Annotated[Mapping[str, Positive], Field(min_length=1)] = field(
        default_factory=lambda: dict.fromkeys(TASKS, 1.0)
    )
    #: Physics and length: `frames` is the length of every episode; None records each path to its end, at least 76 frames.
    simulation: SimulationConfig = field(default_factory=SimulationConfig)
    #: Ranges of physics, size and cameras; None varies the path alone.
    randomisation: Randomisation | None = field(default_factory=Randomisation)
    #: Sizes of a garment, by its name, that differ from the default ones: ``{"sheet": {"spacing": 0.05}}``.
    sizes: Mapping[str, Mapping[str, Annotated[float, Field(ge=0, le=10)]]] = field(default_factory=dict)
    n_observed: Count = 512  #: points of an observation; all vertices of a garment with fewer, when all sides are seen
    #: Depth cameras around the target. 0: farthest-point samples of the vertices, all sides seen.
    cameras: Annotated[int, Field(ge=0, le=100)] = 0
    camera_distance: Positive = 2.2  #: metres from the cameras to the seat of the target
    depth_noise: bool = False  #: True gives the cameras the noise of a depth sensor
    #: Share of the episodes whose path leaves its script (`topokit.sim.Task.off_script`).
    off_script: Annotated[float, Field(ge=0, le=1)] = 0.0
    #: Half the side, in metres, of the square in which the target's place is drawn, with any yaw; 0 draws neither.
    places: Annotated[float, Field(ge=0, le=1)] = 0.0
    #: Variation of sizes: each size of the garment is multiplied by 1 / (1 + vary) to 1 + vary. Sizes of the target, and of
    #: a mannequin's garment, which must fit, vary by half as much.
    vary: Annotated[float, Field(ge=0, le=1)] = 0.0
    #: Meshes of one's own by their names, which `tasks` may then name, each with the options of `Garment.from_mesh`:
    #: ``{"bag": {"file": "bag.obj", "up": "z", "size": 0.6, "grips": [3, 9]}}`` allows "bag-hook" and "bag-hanger". Sizes of
    #: a mesh do not vary, but for the `scale` of `randomisation`.
    meshes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        known = [*TASKS, *(f"{mesh}-{target}" for mesh in self.meshes for target in ("hook", "hanger"))]
        unknown = [name for name in self.tasks if name not in known]
        if unknown:
            raise ValueError(f"tasks: there is no {', '.join(map(repr, unknown))}; there are {', '.join(known)}")
        garments = sorted({name.rpartition("-")[0] for name in self.tasks})
        for name in self.sizes:
            if name in self.meshes or name not in garments:
                raise ValueError(
                    f"sizes: there is no garment {name!r} of the wardrobe in the tasks: {', '.join(garments)}"
                )
        if self.depth_noise and not self.cameras:
            raise ValueError("depth_noise needs cameras, and cameras is 0")
        # Sorted: the draws must not depend on the order of the tasks.
        object.__setattr__(self, "tasks", dict(sorted(self.tasks.items())))

    def to_json(self) -> dict[str, Any]:
        """Return plain numbers, lists and dictionaries; `from_json` gives the same configuration back."""
        plain: dict[str, Any] = json.loads(json.dumps(dataclasses.asdict(self)))  # tuples become lists
        return plain

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> DatasetConfig:
        """Return the configuration of a dictionary from `to_json`; missing fields get their defaults."""
        return from_mapping(cls, values, "the configuration")

    def draw(self, seed: int, index: int) -> tuple[str, int]:
        """Return the task and the seed (63 bits) of an episode.

        Parameters
        ----------
        seed, index : int
            As in `make_episode`.
        """
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
        names = list(self.tasks)
        weights = np.cumsum(list(self.tasks.values()))
        place = min(int(np.searchsorted(weights, rng.random() * weights[-1], side="right")), len(names) - 1)
        return names[place], int(rng.integers(2**63))

    def task(self, name: str) -> Task:
        """Return a task by its name, with its garment in the size of this configuration; a mesh is read from its file."""
        garment, _, target = name.rpartition("-")
        if garment in self.meshes:
            options = dict(self.meshes[garment])
            mesh = Garment.from_mesh(options.pop("file"), **options, name=garment)
            return Task.of(mesh, Hook() if target == "hook" else Hanger())
        task = TASKS[name]
        return dataclasses.replace(task, garment=functools.partial(task.garment, **self.sizes.get(garment, {})))


def _physics(config: DatasetConfig, garment: Garment) -> tuple[SimulationConfig, Randomisation | None]:
    """Return physics and its ranges; those of a mesh of one's own follow its area and edges."""
    usual = config.simulation
    ranges = config.randomisation
    if garment.name not in config.meshes:
        return usual, ranges
    cloth = SimulationConfig.of(garment)
    default = SimulationConfig()

    # Numbers of the configuration that differ from the default are kept.
    chosen = {name: value for name, value in dataclasses.asdict(usual).items() if value != getattr(default, name)}
    steps = max(usual.steps_per_frame, round(usual.frame_time / cloth.dt))
    chosen |= {"dt": usual.frame_time / steps, "steps_per_frame": steps}
    physics = dataclasses.replace(cloth, **chosen)
    if ranges is None:
        return physics, None

    # The ranges of all other numbers are the default ranges, scaled by the ratio of this cloth's number to the default.
    changed = {}
    for name in Randomisation.PHYSICS:
        if name not in chosen and getattr(ranges, name):
            factor = getattr(physics, name) / getattr(default, name)
            changed[name] = tuple(factor * bound for bound in getattr(ranges, name))
    return physics, dataclasses.replace(ranges, **changed)


def _scene(config: DatasetConfig, name: str, seed: int) -> tuple[Task, Garment, Target]:
    """Return task, garment and target of an episode; sizes, place and script have a generator each."""
    task = config.task(name)
    garment = task.garment()
    target = task.target
    if config.vary:
        # The target first, and then a garment that does not touch the floor.
        rng = Randomisation.generator(seed, "sizes")
        target = varied_target(target, config.vary / 2, rng)
        vary = config.vary / 2 if isinstance(target, Mannequin) else config.vary
        scale = config.randomisation.scale if config.randomisation is not None else None
        longest = float(target.seat[2]) / (scale[1] if scale else 1.0)
        if garment.name not in config.meshes:
            garment = varied_garment(task.garment, garment, vary, rng, longest)

    # The same generator decides that a path leaves its script, and draws that path.
    rng = Randomisation.generator(seed, "script")
    if rng.random() < config.off_script:
        task = task.off_script(rng)
    if config.places:
        x, y, turn = Randomisation.generator(seed, "place").uniform(-1, 1, 3).tolist()
        place = (config.places * x, config.places * y, 0.0)
        target = dataclasses.replace(target, place=place, yaw=180 * turn)
    return task, garment, target


def varied_garment(
    make: Callable[..., Garment], garment: Garment, vary: float, rng: np.random.Generator, longest: float = np.inf
) -> Garment:
    """Return the garment with each size but its spacing multiplied by a factor from 1 / (1 + vary) to 1 + vary.

    Sizes are drawn again, at most 50 times, when the pattern refuses them, when there are over 1.25 times as many vertices, and
    when the garment hangs down more than `longest` metres. The spacing follows the area of the cloth.
    """
    spacing = garment.parameters["spacing"]
    extent = np.array(_extent(garment))
    own = {name: size for name, size in garment.parameters.items() if name != "spacing"}
    for sizes in _drawn_sizes(own, vary, rng):
        # The first garment tells how much cloth there is; the second has about as many vertices as the original.
        try:
            first = make(**sizes, spacing=spacing)
            other = make(**sizes, spacing=float(spacing * np.sqrt(len(first.vertices) / len(garment.vertices))))
        except ValueError:
            continue
        if other.length <= longest and (_extent(other) <= 1.25 * extent).all():
            return other
    return garment


def varied_target(target: Target, vary: float, rng: np.random.Generator) -> Target:
    """Return the target with its sizes multiplied likewise; no rod gets thinner than 2 cm: cloth tunnels through it."""
    own = {name: size for name, size in dataclasses.asdict(target).items() if name not in ("distance", "place", "yaw")}
    for sizes in _drawn_sizes(own, vary, rng):
        thick = {name: max(size, min(own[name], 0.02)) for name, size in sizes.items() if "radius" in name}
        try:
            return dataclasses.replace(target, **sizes | thick)
        except ValueError:
            continue
    return target


def _drawn_sizes(sizes: Mapping[str, float], vary: float, rng: np.random.Generator) -> Iterator[dict[str, float]]:
    """Yield sizes that are multiplied by factors drawn at random, 50 times."""
    for _ in range(50):
        factors = np.exp(np.log1p(vary) * rng.uniform(-1, 1, len(sizes))).tolist()
        yield {name: float(size * factor) for (name, size), factor in zip(sizes.items(), factors, strict=True)}


def _extent(garment: Garment) -> list[int]:
    return [len(garment.vertices), len(garment.faces), *map(len, garment.loops)]


def _cameras(config: DatasetConfig, seat: NDArray[np.float64]) -> list[Camera]:
    """Return the cameras, evenly around the seat of a target and 20 degrees above it, the first from in front of it (-y)."""
    n = config.cameras
    azimuth = 2 * np.pi * np.arange(n) / n - np.pi / 2
    level = np.cos(np.radians(20))
    rise = np.full(n, np.sin(np.radians(20)))
    eyes = seat + config.camera_distance * np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), rise])
    return [Camera(tuple(eye), tuple(seat.tolist()), noise=float(config.depth_noise)) for eye in eyes.tolist()]


def make_episode(config: DatasetConfig, seed: int, index: int, *, time_limit: float | None = 600.0) -> Episode:
    """Simulate episode `index` of the dataset of that configuration and seed: a pure function of the three.

    Parameters
    ----------
    config : DatasetConfig
    seed, index : int
        Seed of the dataset, and number of the episode, from 0.
    time_limit : float, optional
        Limit of `topokit.sim.simulate`. None simulates in this process, which must then be a fresh one for the same bytes.
    """
    name, episode_seed = config.draw(seed, index)
    task, garment, target = _scene(config, name, episode_seed)
    physics, ranges = _physics(config, garment)
    return simulate(
        garment,
        target,
        task=task,
        seed=episode_seed,
        config=physics,
        randomisation=ranges,
        cameras=_cameras(config, target.seat),
        n_observed=config.n_observed if config.cameras else min(config.n_observed, len(garment.vertices)),
        time_limit=time_limit,
    )
