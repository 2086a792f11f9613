"""HangEnv: Gymnasium's own checks, seeds, rewards, vectors of environments."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
import warnings

import numpy as np
import pytest

pytest.importorskip("pybullet")
pytest.importorskip("gymnasium")

import gymnasium
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv

from topokit.sim import TASKS, Garment, HangEnv, SimulationConfig, cameras_around
from topokit.sim._env import REWARDS
from topokit.sim._surface import simple_cycles

COARSE = Garment.apron(spacing=0.05, strap_width=0.05)
QUICK = SimulationConfig(self_collision=False, settle=0.05)


def make(**options):
    return HangEnv("apron-hook", **{"garment": COARSE, "n_points": 120, "config": QUICK, **options})


def play(env, seed, policy=None):
    """Returns and last info of an episode."""
    env.reset(seed=seed)
    total, done = 0.0, False
    while not done:
        _, reward, terminated, truncated, info = env.step(policy() if policy else env.scripted_action())
        total, done = total + reward, terminated or truncated
    return total, info, terminated


@pytest.mark.parametrize("options", [{}, {"reward": "topological-observed", "cameras": cameras_around(n=2)}])
def test_gymnasiums_checker_finds_nothing(options):
    env = gymnasium.make("topokit/HangApronHook-v1", garment=COARSE, config=QUICK, n_points=80, **options)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # its advice comes as warnings
        check_env(env.unwrapped)
    env.close()


def test_the_scripted_path_succeeds_and_rewards_say_so():
    returns = {}
    for reward in REWARDS:
        env = make(reward=reward, n_points=160, config=dataclasses.replace(QUICK, settle=0.4))
        start = env.reset(seed=1)[1]
        returns[reward], info, terminated = play(env, seed=1)
        assert terminated
        assert info["success"]
        assert info["linked"] == 1
        progress = start["distance"] - info["distance"]
        assert progress > 0.2
        expected = {"sparse": 1, "dense": 1 + progress}.get(reward, 2 + progress)
        assert returns[reward] == pytest.approx(expected)
        env.close()


def test_seeds_repeat_bit_by_bit():
    env = make(cameras=cameras_around(n=2))
    runs = []
    for seed in (3, 3, 4):
        observation, _ = env.reset(seed=seed)
        env.action_space.seed(0)
        runs.append([observation, *(env.step([*env.action_space.sample()[:6], 0])[0] for _ in range(5))])
    for one, again in zip(runs[0], runs[1], strict=True):
        for name in one:
            np.testing.assert_array_equal(one[name], again[name])
    assert not np.array_equal(runs[0][0]["grippers"], runs[2][0]["grippers"])
    env.close()


def test_what_is_dropped_ends_the_episode_without_reward():
    env = make(reward="topological")
    total, info, terminated = play(env, 0, policy=lambda: [0, 0, 0, 0, 0, 0, 1])
    assert terminated
    assert info["dropped"]
    assert not info["success"]
    assert total < 0  # it fell away from the hook
    assert env.step(np.zeros(7))[0]["held"] == 0  # the action that lets go need not be repeated
    env.close()


def test_grippers_go_where_they_are_told_and_steps_are_limited():
    env = make(max_steps=12)
    first, _ = env.reset(seed=0)
    truncations = []
    for _ in range(12):
        observation, _, terminated, truncated, _ = env.step([0.2, 0, 0, 0.2, 0, 0, 0])
        truncations.append(truncated)
        assert not terminated
    assert truncations == [False] * 11 + [True]
    moved = observation["grippers"] - first["grippers"]
    np.testing.assert_allclose(moved, np.tile([12 * 0.2 * env.max_step, 0, 0], (2, 1)), atol=0.01)
    env.close()


def test_taut_cloth_holds_the_grippers_back():
    env = make()
    env.reset(seed=0)
    for _ in range(40):
        observation, *_ = env.step([1, 0, 0, -1, 0, 0, 0])
    apart = np.ptp(observation["grippers"][:, 0])
    rest = np.linalg.norm(np.diff(COARSE.vertices[COARSE.grips], axis=0))
    assert 1.0 < apart / rest < 3.0
    for _ in range(10):  # at once, and not after 40 steps, they come back
        observation, *_ = env.step([-1, 0, 0, 1, 0, 0, 0])
    assert np.ptp(observation["grippers"][:, 0]) < apart - 0.1
    env.close()


def test_tearing_ends_the_episode():
    env = make(config=dataclasses.replace(QUICK, stiffness=8.0))
    total, info, terminated = play(env, 0)
    assert terminated
    assert info["torn"]
    assert total == 0
    env.close()


@pytest.mark.parametrize("vector", [SyncVectorEnv, AsyncVectorEnv])
def test_vectors_of_environments(vector):
    envs = vector([make, make])
    observations, _ = envs.reset(seed=5)
    assert observations["points"].shape == (2, 120, 3)
    assert not np.array_equal(*observations["grippers"])
    observations, rewards, *_ = envs.step(np.zeros((2, 7), np.float32))
    assert rewards.shape == (2,)
    alone = make()
    expected, _ = alone.reset(seed=5)
    expected, *_ = alone.step(np.zeros(7, np.float32))
    np.testing.assert_array_equal(observations["points"][0], expected["points"])
    envs.close()
    alone.close()


def test_pictures():
    env = make(render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (360, 480, 3)
    assert picture.dtype == np.uint8
    blue = (picture[..., 2] > picture[..., 0] + 20).mean()
    grey = ((picture.max(axis=-1) < 220) & (np.ptp(picture.astype(int), axis=-1) < 3)).mean()
    assert blue > 0.02
    assert grey > 0.001
    env.close()
    assert make().render() is None


def test_misuse_is_explained():
    with pytest.raises(ValueError, match="there is no task 'tie-nail'; there are apron-hook"):
        HangEnv("tie-nail")
    with pytest.raises(ValueError, match="shirt-mannequin asks for the loops neck, hem; the apron has neck"):
        HangEnv("shirt-mannequin", garment=COARSE)
    with pytest.raises(ValueError, match="reward must be one of sparse"):
        make(reward="gold")
    with pytest.raises(ValueError, match="n_points must be 1 to"):
        make(n_points=10**6)
    with pytest.raises(ValueError, match="render_mode"):
        make(render_mode="human")
    env = make()
    with pytest.raises(gymnasium.error.ResetNeeded, match="reset the environment first"):
        env.step(np.zeros(7))
    env.reset(seed=0)
    for action in (np.zeros(6), [np.nan] * 7):
        with pytest.raises(ValueError, match="seven finite numbers"):
            env.step(action)
    env.close()
    env.close()


def test_a_task_of_ones_own():
    task = dataclasses.replace(TASKS["apron-hook"], garment=lambda: COARSE)
    env = HangEnv(task, n_points=50, config=QUICK)
    assert env.reset(seed=0)[0] in env.observation_space
    env.close()


def test_walks_are_cut_where_they_return():
    assert simple_cycles([1, 2, 3, 4]) == [[1, 2, 3, 4]]
    assert simple_cycles([1, 2, 3, 9, 5, 6, 7, 5, 9]) == [[5, 6, 7], [1, 2, 3, 9]]


def test_without_gymnasium_only_the_environment_is_missing():
    code = """
import sys
sys.modules["gymnasium"] = None
import topokit.sim
try:
    topokit.sim.HangEnv
except ImportError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "pip install 'topokit[sim]'" in done.stdout
