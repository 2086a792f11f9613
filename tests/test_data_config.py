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
from topokit.data._layout import pack, unpack, vertex_ids
from topokit.data._recipe import room
from topokit.sim import TASKS, Randomisation, SimulationConfig

from small_datasets import TINY

MOTION = load(DatasetConfig, Path(__file__).parent.parent / "book" / "datasets" / "motion.json")


@pytest.mark.parametrize(
    "config",
    [
        DatasetConfig(),
        TINY,
        DatasetConfig(randomisation=None, cameras=2, depth_noise=True),
        DatasetConfig(randomisation=Randomisation(scale=None, mass=(0.1, 0.2)), simulation=SimulationConfig(frames=90)),
        MOTION,
    ],
)
def test_json_gives_the_configuration_back(config):
    assert DatasetConfig.from_json(json.loads(json.dumps(config.to_json()))) == config


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"tasks": {}}, "tasks: "),
        ({"tasks": {"apron-moon": 1}}, "no 'apron-moon'"),
        ({"tasks": {"apron-hook": 0}}, "tasks.apron-hook: Input should be greater than 0"),
        ({"sizes": {"kilt": {}}}, "no task has a garment 'kilt'"),
        ({"n_observed": 0}, "n_observed: Input should be greater than or equal to 1"),
        ({"depth_noise": True}, "cameras is 0"),
        ({"colour": 1}, "the configuration: there is no 'colour'"),
        ({"simulation": {"gravity": 1}}, "the configuration: there is no 'simulation.gravity'"),
        ({"simulation": {"dt": -1}}, "simulation.dt: Input should be greater than 0"),
        ({"randomisation": {"luck": 1}}, "there is no 'randomisation.luck'"),
        ({"randomisation": {"version": 0}}, "another version"),
        ({"version": 3}, "version: Input should be 1 or 2, not 3"),
        ({"vary": 0.3}, "vary is of version 2 of the configuration, and version is 1"),
        ({"version": 2, "off_script": 2}, "off_script: Input should be less than or equal to 1"),
    ],
)
def test_a_wrong_configuration_is_refused(values, says):
    with pytest.raises(ValueError, match=re.escape(says)):
        DatasetConfig.from_json(values)


def test_a_size_that_no_garment_has_is_refused():
    config = DatasetConfig(tasks={"sheet-hook": 1}, sizes={"sheet": {"sleeves": 2}})
    with pytest.raises(ValueError, match=r"sizes\['sheet'\].*sleeves"):
        config.garment("sheet-hook")


def test_draws_are_pure_and_do_not_depend_on_the_order_of_tasks():
    names = ["apron-hook", "tote-hook", "vest-mannequin"]
    one, other = DatasetConfig(tasks=dict.fromkeys(names, 1)), DatasetConfig(tasks=dict.fromkeys(names[::-1], 1))
    draws = [one.draw(3, i) for i in range(200)]
    assert draws == [other.draw(3, i) for i in reversed(range(200))][::-1]
    assert len({d.seed for d in draws}) == 200
    assert all(0 <= d.seed < 2**63 for d in draws)
    assert draws != [one.draw(4, i) for i in range(200)]


def test_tasks_are_drawn_at_their_weights():
    config = DatasetConfig(tasks={"apron-hook": 3, "tote-hook": 1})
    count = collections.Counter(config.draw(0, i).task for i in range(4000))
    assert abs(count["apron-hook"] / 4000 - 0.75) < 0.03  # four standard deviations


def test_every_task_of_version_one_is_drawn_by_default():
    config, later = DatasetConfig(), ("scarf", "belt", "net")
    assert {config.draw(0, i).task for i in range(400)} == {task for task in TASKS if task.split("-")[0] not in later}


def test_room_for_the_largest():
    size = room(TINY)
    garments = [TINY.garment(task) for task in TINY.tasks]
    assert size["vertices"] == max(len(garment.vertices) for garment in garments)
    assert size["frames"] == 32  # 20, in whole chunks of 16


def test_packing_costs_half_a_tenth_of_a_millimetre():
    metres = np.random.default_rng(0).uniform(-3.2, 3.2, (50, 3)).astype(np.float32)
    assert np.abs(unpack(pack("points", metres)) - metres).max() < 0.5001e-4
    assert (
        pack("points", unpack(pack("points", metres))) == pack("points", metres)
    ).all()  # packed twice is packed once
    with pytest.raises(ValueError, match=r"actions reaches 3\.40 m"):
        pack("actions", np.array([[0.0, 0.0, -3.4]]))


def test_observations_of_vertices_are_stored_as_ids():
    points = np.random.default_rng(0).normal(size=(3, 20, 3)).astype(np.float32)
    ids = np.array([[3, 1, 7], [0, 2, 4], [19, 5, 6]])
    assert (vertex_ids(points, points[np.arange(3)[:, None], ids]) == ids).all()
