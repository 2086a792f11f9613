"""What a dataset is drawn from: validated, saved, and an episode a pure function of it."""

from __future__ import annotations

import collections
import json
import re
from pathlib import Path

import numpy as np
import pytest

from topokit._config import load
from topokit.data import DatasetConfig
from topokit.data._recipe import _physics, _scene
from topokit.sim import Randomisation, SimulationConfig

from small_datasets import TINY, write_cloth

MOTION = load(DatasetConfig, Path(__file__).parent.parent / "book" / "datasets" / "motion.json")

BAG = {"tasks": {"bag-hook": 1}, "meshes": {"bag": {"file": "b.obj", "up": "z", "grips": [0, 1]}}}


@pytest.mark.parametrize(
    "config",
    [
        DatasetConfig(),
        TINY,
        DatasetConfig(randomisation=None, cameras=2, depth_noise=True),
        DatasetConfig(randomisation=Randomisation(scale=None, mass=(0.1, 0.2)), simulation=SimulationConfig(frames=90)),
        MOTION,
        DatasetConfig.from_json(BAG),
    ],
)
def test_json_gives_the_configuration_back(config):
    assert DatasetConfig.from_json(json.loads(json.dumps(config.to_json()))) == config


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"tasks": {}}, "tasks: "),
        ({"tasks": {"apron-moon": 1}}, "no 'apron-moon'"),
        ({"tasks": {"apron-hook": 0}}, "tasks.apron-hook"),
        ({"sizes": {"kilt": {}}}, "no garment 'kilt'"),
        ({"n_observed": 0}, "n_observed"),
        ({"depth_noise": True}, "cameras is 0"),
        ({"colour": 1}, "the configuration: there is no 'colour'"),
        ({"simulation": {"gravity": 1}}, "the configuration: there is no 'simulation.gravity'"),
        ({"simulation": {"dt": -1}}, "simulation.dt"),
        ({"randomisation": {"luck": 1}}, "there is no 'randomisation.luck'"),
        (BAG | {"tasks": {"sack-hook": 1}}, "no 'sack-hook'; there are apron-hook"),
        (BAG | {"tasks": {"bag-moon": 1}}, "bag-hook, bag-hanger"),
        (BAG | {"sizes": {"bag": {"spacing": 0.1}}}, "no garment 'bag' of the wardrobe"),
        ({"off_script": 2}, "off_script"),
    ],
)
def test_a_wrong_configuration_is_refused(values, says):
    with pytest.raises(ValueError, match=re.escape(says)):
        DatasetConfig.from_json(values)


def test_draws_are_pure_and_do_not_depend_on_the_order_of_tasks():
    names = ["apron-hook", "tote-hook", "vest-mannequin"]
    one, other = DatasetConfig(tasks=dict.fromkeys(names, 1)), DatasetConfig(tasks=dict.fromkeys(names[::-1], 1))
    draws = [one.draw(3, i) for i in range(200)]
    assert draws == [other.draw(3, i) for i in reversed(range(200))][::-1]
    assert len({seed for _, seed in draws}) == 200
    assert all(0 <= seed < 2**63 for _, seed in draws)
    assert draws != [one.draw(4, i) for i in range(200)]


def test_tasks_are_drawn_at_their_weights():
    config = DatasetConfig(tasks={"apron-hook": 3, "tote-hook": 1})
    count = collections.Counter(config.draw(0, i)[0] for i in range(4000))
    assert abs(count["apron-hook"] / 4000 - 0.75) < 0.03  # four standard deviations


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp("meshes") / "bag.obj"
    return {"file": str(path), **write_cloth(path)}


def own(mesh, **values):
    return DatasetConfig(tasks={"bag-hook": 1}, meshes={"bag": mesh}, **values)


def test_a_mesh_weighs_by_its_area_and_ranges_are_factors(bag):
    config = own(bag)
    garment = config.task("bag-hook").garment()
    cloth, usual = SimulationConfig.of(garment), SimulationConfig()
    physics, ranges = _physics(config, garment)
    assert physics.mass == cloth.mass != usual.mass
    assert physics.steps_per_frame == cloth.steps_per_frame
    assert physics.frame_time == pytest.approx(usual.frame_time)
    assert ranges.mass == pytest.approx([cloth.mass / usual.mass * bound for bound in Randomisation().mass])
    assert ranges.damping == pytest.approx([cloth.damping / usual.damping * bound for bound in (0.15, 0.4)])
    assert ranges.scale == Randomisation().scale
    said = SimulationConfig(mass=0.5, dt=1 / 2000, steps_per_frame=90, friction=0.4)
    physics, ranges = _physics(own(bag, simulation=said, randomisation=Randomisation(bending=None)), garment)
    assert (physics.mass, physics.friction, physics.steps_per_frame) == (0.5, 0.4, 90)
    assert physics.damping == cloth.damping
    assert (ranges.mass, ranges.bending) == (Randomisation().mass, None)
    assert _physics(own(bag, randomisation=None), garment)[1] is None
    sheet = DatasetConfig(tasks={"sheet-hook": 1})
    assert _physics(sheet, sheet.task("sheet-hook").garment()) == (sheet.simulation, sheet.randomisation)


def test_a_mesh_keeps_its_size_when_the_target_varies(bag):
    config = own(bag, vary=0.5)
    scenes = [_scene(config, "bag-hook", seed) for seed in range(3)]
    for _, garment, _target in scenes:
        np.testing.assert_array_equal(garment.vertices, config.task("bag-hook").garment().vertices)
    assert len({target.height for *_, target in scenes}) == 3
