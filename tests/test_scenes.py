"""The scenes of a dataset: garments and targets of other sizes, elsewhere, with plans off their script."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pybullet")

from topokit._config import load
from topokit.data import DatasetConfig, make_episode
from topokit.data._recipe import _scene, varied_garment
from topokit.sim import TASKS, WARDROBE, Hook, Randomisation, SimulationConfig

MOTION = load(DatasetConfig, Path(__file__).parent.parent / "book" / "datasets" / "motion.json")
MASKS = {"tasks": {"mask-hook": 1.0}, "sizes": {"mask": {"spacing": 0.03}}}


@pytest.mark.parametrize("name", ["tote2", "mask", "sheet"])
def test_sizes_vary_within_bounds_and_repeat(name):
    own = WARDROBE[name]()
    drawn = [varied_garment(WARDROBE[name], own, 0.35, np.random.default_rng(seed)) for seed in (0, 0, 1, 2)]
    assert drawn[0].parameters == drawn[1].parameters != drawn[2].parameters
    assert (drawn[0].vertices == drawn[1].vertices).all()
    for garment in drawn:
        for size, value in garment.parameters.items():
            assert 1 / 1.36 < value / own.parameters[size] < 1.36
        assert 0.8 * len(own.vertices) < len(garment.vertices) <= 1.25 * len(own.vertices)
        assert garment.loop_names == own.loop_names


def test_scenes_repeat_and_each_draw_leaves_the_others():
    config = dataclasses.replace(MOTION, **MASKS)
    fixed = dataclasses.replace(config, vary=0.0)
    places = []
    off = 0
    for i in range(60):
        name, seed = fixed.draw(0, i)
        task, garment, target = _scene(fixed, name, seed)
        off += bool(task.path(garment, target, Randomisation.generator(seed, "path")).drawn)
        places.append([*target.place[:2], target.yaw / 360])
        assert dataclasses.replace(target, place=(0.0, 0.0, 0.0), yaw=0.0) == Hook()
    for i in range(3):
        name, seed = config.draw(0, i)
        scenes = [_scene(config, name, seed) for _ in range(2)]
        paths = [task.path(garment, target, Randomisation.generator(seed, "path")) for task, garment, target in scenes]
        assert scenes[0][2] == scenes[1][2]
        assert scenes[0][1].parameters == scenes[1][1].parameters
        assert (paths[0].at(1.0) == paths[1].at(1.0)).all()
        target = scenes[0][2]
        assert [*target.place[:2], target.yaw / 360] == places[i]  # sizes do not move places
    spread = np.ptp(places, axis=0)
    assert ((spread > 0.85) & (spread <= 1.0)).all()
    assert abs(off / 60 - 0.6) < 0.2


def test_an_episode_records_what_was_drawn():
    short = SimulationConfig(frames=4, steps_per_frame=10, settle=0.02)
    config = dataclasses.replace(MOTION, **MASKS, simulation=short, n_observed=20, off_script=1.0)
    episode = make_episode(config, 0, 0)
    assert episode.physics["garment"]["width"] != 0.18
    assert episode.physics["target"]["height"] != 1.2
    assert episode.physics["target"]["yaw"] != 0
    assert episode.physics["path"]["pace"] > 0
    assert (episode.garment, episode.task) == ("mask", "mask-hook")


def test_the_default_draws_what_it_always_drew():
    later = ("scarf", "belt", "net")
    config = DatasetConfig(tasks={task: 1.0 for task in TASKS if task.partition("-")[0] not in later})
    assert [config.draw(3, i) for i in (0, 9)] == [
        ("sheet-hanger", 3492691328359077705),
        ("apron2-mannequin", 7155809240061363837),
    ]
    task, garment, target = _scene(config, *config.draw(3, 0))
    assert task.plan is TASKS["sheet-hanger"].plan
    assert target is task.target
    assert garment.parameters == task.garment().parameters
