"""Episodes in PyBullet: physical, repeatable, recorded whole, and refused when they cannot be."""

from __future__ import annotations

import dataclasses
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("pybullet")

from topokit._geometry import turned
from topokit.io import load_episode, save_episode
from topokit.sim import (
    TASKS,
    WARDROBE,
    Camera,
    Garment,
    Hanger,
    Hook,
    Mannequin,
    Randomisation,
    SimulationConfig,
    SimulationError,
    World,
    simulate,
)

APRON = WARDROBE["apron"](spacing=0.05, strap_width=0.05)
SHORT = SimulationConfig(frames=4, steps_per_frame=10, settle=0.02)


# What cannot be simulated.


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"task": "apron-moon"}, "apron-moon"),
        ({"garment": WARDROBE["tote"](spacing=0.05), "task": "shirt-mannequin"}, "neck, hem; the tote has handle"),
        ({"config": SHORT, "cameras": (Camera(eye=(0, 5, 1), target=(0, 9, 1)),)}, "no cloth is in view"),
    ],
)
def test_what_cannot_be_simulated_is_refused(options, named):
    with pytest.raises(ValueError, match=named):
        simulate(**{"garment": APRON, "task": "apron-hook", **options})


@pytest.mark.parametrize("limit", ["max_stretch", "max_edge_stretch"])
def test_over_stretched_cloth_is_refused(limit):
    config = SimulationConfig(frames=4, steps_per_frame=50, **{limit: 1.001})  # its own weight exceeds that
    with pytest.raises(SimulationError, match=rf"settling: .*{limit}"):
        simulate(APRON, config=config, n_observed=50)


# Episodes.


def test_an_episode_is_the_same_in_every_fresh_process_and_in_ours(tmp_path):
    code = (
        "from topokit.sim import SimulationConfig, WARDROBE, simulate; from topokit.io import save_episode; import sys\n"
        "config = SimulationConfig(frames=8, steps_per_frame=20, settle=0.05)\n"
        "apron = WARDROBE['apron'](spacing=0.05, strap_width=0.05)\n"
        "if __name__ == '__main__':\n"
        "    options = {'seed': 4, 'config': config, 'n_observed': 100}\n"
        "    save_episode(sys.argv[1] + '/one.npz', simulate(apron, time_limit=None, **options))\n"
        "    save_episode(sys.argv[1] + '/other.npz', simulate(apron, **options))\n"
        "    assert 'gymnasium' not in sys.modules\n"
    )
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code, str(tmp_path)], capture_output=True, text=True, check=True
    )
    assert done.stdout == done.stderr == ""  # PyBullet's own chatter is kept away
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "other.npz").read_bytes()
    episode = load_episode(tmp_path / "one.npz")
    assert episode.observed.shape == (8, 100, 3)
    assert (episode.task, episode.seed, episode.observation["kind"]) == ("apron-hook", 4, "vertices")
    assert episode.dt == pytest.approx(20 * SimulationConfig().dt)
    assert episode.held.all()
    assert not episode.success  # a fifth of a second is no time to hang anything
    assert episode.physics["garment"]["spacing"] == 0.05
    assert episode.physics["target"]["position"] == [0, 0.3, 0]


def test_an_episode_records_what_was_drawn(tmp_path):
    cameras = (Camera(eye=(0, -1.5, 1.3), target=(0, 0, 1.1), noise=1.0),)
    options = {"config": SHORT, "randomisation": Randomisation(), "cameras": cameras, "n_observed": 300}
    one, two, other = (simulate(APRON, Hanger(height=1.25), seed=seed, **options) for seed in (5, 5, 6))
    paths = [save_episode(tmp_path / name, episode) for name, episode in (("1.npz", one), ("2.npz", two))]
    assert paths[0].read_bytes() == paths[1].read_bytes()
    episode = load_episode(paths[0])
    assert episode.observed.shape == (4, 300, 3)
    assert (episode.task, episode.target, episode.seed) == ("apron-hanger", "hanger", 5)
    assert episode.physics["target"]["height"] == 1.25
    drawn = episode.physics["randomisation"]["drawn"]
    assert episode.physics["config"]["mass"] == drawn["mass"] != 0.3
    assert episode.observation["cameras"][0]["eye"] == drawn["camera_eyes"][0]
    assert episode.observation["cameras"][0]["noise"] == 1.0
    assert np.abs(other.actions - one.actions).max() > 0.01


@pytest.mark.parametrize("name", ["apron-hook", "tote-hook", "apron-hanger", "mask-hook", "apron-mannequin"])
def test_scripted_paths_succeed(name):
    sizes = {"apron": {"spacing": 0.05, "strap_width": 0.05}, "mask": {"spacing": 0.018}, "tote": {"spacing": 0.05}}
    task = TASKS[name]
    episode = simulate(task.garment(**sizes[name.split("-")[0]]), task=task, seed=2, n_observed=50)
    assert episode.success
    assert len(episode) >= 76
    assert not task.succeeds(episode.points[0], episode.named_loops)
    loop = episode.points[-1][episode.loops[0]]
    assert task.target.holds(loop)
    assert np.linalg.norm(episode.points[-1] - episode.points[-4], axis=1).max() < 0.1
    assert episode.physics["stretch"]["p99"] < 1.3
    lag = 0.04 if name == "apron-mannequin" else 0.02  # the grippers keep up, also where a strap is taut
    assert np.abs(episode.grippers - episode.actions)[episode.held].max() < lag
    if isinstance(task.target, Mannequin):
        assert task.target.shoulder_height - 0.2 < loop[:, 2].mean() < task.target.head_centre[2]


def test_what_falls_lies_on_the_floor_and_does_not_hang():
    garment = WARDROBE["sheet"](spacing=0.05)
    lift = np.array([0, -1.0, 0.7])
    with World(garment, lift, SimulationConfig()) as world:
        world.add_rods(Hook().rods)
        world.step(garment.vertices[garment.grips] + lift)
        world.release()
        for _ in range(900):
            world.step(None)
        points = world.vertices()
    assert -0.01 < points[:, 2].min() < 0.03
    assert not TASKS["sheet-hook"].succeeds(points, garment.named_loops)


def test_an_episode_elsewhere_is_the_same_moved():
    place = Hook(place=(0.4, -0.3, 0.0), yaw=130.0)
    tote = WARDROBE["tote"](spacing=0.05)
    options = {"task": "tote-hook", "seed": 3, "config": SHORT, "n_observed": 30}
    here, there = simulate(tote, **options), simulate(tote, place, **options)
    for name in ("points", "grippers", "actions", "centre_line"):
        moved = turned(getattr(here, name), 130.0) + [0.4, -0.3, 0]
        np.testing.assert_allclose(getattr(there, name), moved, atol=1e-4)
    assert (there.target, there.physics["target"]["yaw"]) == ("hook", 130.0)
    end = here.points[-1] + Hook().seat + [0, 0, 0.05] - here.points[-1][tote.loops[0]].mean(axis=0)
    elsewhere = turned(end, 130.0) + [0.4, -0.3, 0]
    task = TASKS["tote-hook"]
    assert task.succeeds(end, tote.named_loops)
    assert task.succeeds(elsewhere, tote.named_loops, place)
    assert not task.succeeds(end, tote.named_loops, place)


# The cloth of a configuration.


def test_mass_goes_with_the_area():
    sheet = WARDROBE["sheet"](holes=0, width=0.5, height=0.4, spacing=0.05)
    config = SimulationConfig.of(sheet)
    assert config.mass == pytest.approx(0.25 * 0.5 * 0.4)
    assert config.frame_time == pytest.approx(SimulationConfig().frame_time)
    doubled = dataclasses.replace(sheet, vertices=2 * sheet.vertices)
    assert SimulationConfig.of(doubled).mass == pytest.approx(4 * config.mass)


def stretched(garment: Garment, config: SimulationConfig) -> float:
    """The 99th percentile of edge length over rest length after 0.4 s between the grippers."""
    lift = np.array([0, 0, 1.0 - garment.vertices[:, 2].min()])
    with World(garment, lift, config) as world:
        for _ in range(round(0.4 / config.dt)):
            world.step(garment.vertices[garment.grips] + lift)
        ends = world.vertices()[garment.edges]
    return float(np.percentile(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) / garment.edge_lengths, 99))


@pytest.mark.parametrize("size", [0.2, 2.0])
def test_a_mesh_of_any_size_is_cloth(size):
    scaled = dataclasses.replace(APRON, vertices=APRON.vertices * size / np.ptp(APRON.vertices, axis=0).max())
    assert stretched(scaled, SimulationConfig.of(scaled)) < 1.12
    if size < 1:
        assert stretched(scaled, SimulationConfig()) > 1.12  # too slow a clock makes it rubber
