"""HangEnv: Gymnasium's own checks, seeds, rewards, places, vectors of environments, and the disturbances of the experiments."""

from __future__ import annotations

import dataclasses
import warnings

import numpy as np
import pytest

pytest.importorskip("pybullet")
pytest.importorskip("gymnasium")

import gymnasium
from disturbances import Faults, Pushed, Release
from gymnasium.utils.env_checker import check_env
from scipy.spatial.distance import cdist

from chapter_tools.throwing import Fence
from topokit._geometry import turned
from topokit.sim import WARDROBE, Camera, HangEnv, Hook, SimulationConfig

COARSE = WARDROBE["apron"](spacing=0.05, strap_width=0.05)
QUICK = SimulationConfig(self_collision=False, settle=0.05)


def make(kind=HangEnv, **options):
    return kind("apron-hook", **{"garment": COARSE, "n_points": 120, "config": QUICK, **options})


def play(env, seed, policy=None):
    """The return and the last info of an episode, and whether it terminated."""
    env.reset(seed=seed)
    total = 0.0
    done = False
    while not done:
        _, reward, terminated, truncated, info = env.step(policy() if policy else env.scripted_action())
        total += reward
        done = terminated or truncated
    return total, info, terminated


def film(env, steps=4, seed=2):
    """What is observed while the grippers stay where they are."""
    shots = [env.reset(seed=seed)[0]]
    shots += [env.step(np.zeros(7))[0] for _ in range(steps)]
    env.close()
    return shots


def everything(kind=HangEnv, **options):
    """An environment that shows all vertices."""
    return make(kind, n_points=len(COARSE.vertices), **options)


@pytest.fixture(scope="module")
def usual():
    return film(everything(), 60)


def same(shots, others, *names):
    for shot, other in zip(shots, others, strict=False):
        for name in names or shot:
            np.testing.assert_array_equal(shot[name], other[name], err_msg=name)


def middles(shots):
    return np.array([shot["points"].mean(axis=0) for shot in shots])


@pytest.mark.parametrize(
    ("version", "options"),
    [
        ("topokit/HangApronHook-v1", {"cameras": (Camera(), Camera((1.6, 0.0, 1.2))), "reward": "topological"}),
        ("topokit/HangTote2Hanger-v1", {"garment": WARDROBE["tote2"](spacing=0.04)}),
    ],
)
def test_gymnasiums_checker_finds_nothing(version, options):
    env = gymnasium.make(version, **{"garment": COARSE, "config": QUICK, "n_points": 80, **options})
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # its advice comes as warnings
        check_env(env.unwrapped)
    env.close()


@pytest.mark.parametrize("reward", ["sparse", "topological"])
def test_the_scripted_path_succeeds_and_rewards_are_differences_of_a_potential(reward):
    env = make(reward=reward, n_points=160, config=dataclasses.replace(QUICK, settle=0.4))
    start = env.reset(seed=1)[1]
    total, info, terminated = play(env, seed=1)
    assert (terminated, info["success"], info["linked"]) == (True, True, 1)
    progress = start["distance"] - info["distance"]
    assert progress > 0.2
    assert total == pytest.approx({"sparse": 1, "topological": 2 + progress}[reward])
    episode = env.episode("script")
    assert episode.success
    assert (episode.seed, episode.physics["controller"]) == (1, "script")
    np.testing.assert_array_equal(episode.points[-1], env.vertices.astype(np.float32))
    env.close()


@pytest.mark.parametrize("options", [{"cameras": (Camera(), Camera((1.6, 0.0, 1.2)))}, {"place": "anywhere"}])
def test_seeds_repeat_bit_by_bit(options):
    env = make(**options)
    runs = []
    for seed in (3, 3, 4):
        observation, _ = env.reset(seed=seed)
        env.action_space.seed(0)
        runs.append([observation, *(env.step([*env.action_space.sample()[:6], 0])[0] for _ in range(5))])
    same(runs[0], runs[1])
    assert not np.array_equal(runs[0][0]["grippers"], runs[2][0]["grippers"])
    env.close()


def test_what_is_dropped_ends_the_episode_without_reward():
    env = make(reward="topological")
    total, info, terminated = play(env, 0, policy=lambda: [0, 0, 0, 0, 0, 0, 1])
    assert (terminated, info["dropped"], info["success"], info["torn"]) == (True, True, False, False)
    assert total < 0  # it fell away from the hook
    assert env.step(np.zeros(7))[0]["held"] == 0  # the action that lets go need not be repeated
    env.close()


def test_torn_cloth_ends_the_episode():
    env = make(config=dataclasses.replace(QUICK, max_stretch=1.15))
    total, info, terminated = play(env, 0, policy=lambda: [-1, 0, 0, 1, 0, 0, 0])
    assert (terminated, info["torn"], total) == (True, True, 0)
    env.close()


def test_grippers_go_where_the_actions_say_until_taut_cloth_holds_them():
    env = make(max_steps=12)
    first, _ = env.reset(seed=0)
    steps = [env.step([0.2, 0, 0, 0.2, 0, 0, 0]) for _ in range(12)]
    assert [step[2:4] for step in steps] == [(False, False)] * 11 + [(False, True)]  # truncated, not terminated
    moved = steps[-1][0]["grippers"] - first["grippers"]
    np.testing.assert_allclose(moved, np.tile([12 * 0.2 * env.max_step, 0, 0], (2, 1)), atol=0.01)
    env.reset(seed=0)
    apart = [np.ptp(env.step([1, 0, 0, -1, 0, 0, 0])[0]["grippers"][:, 0]) for _ in range(40)]
    rest = np.linalg.norm(np.diff(COARSE.vertices[COARSE.grips], axis=0))
    assert 1.0 < apart[-1] / rest < 3.0
    back = [np.ptp(env.step([-1, 0, 0, 1, 0, 0, 0])[0]["grippers"][:, 0]) for _ in range(10)]
    assert back[-1] < apart[-1] - 0.1  # they come back at once, and not after 40 steps
    env.close()


def test_anywhere_has_bounds():
    env = make(place="anywhere")
    places = []
    for seed in range(12):
        seen, _ = env.reset(seed=seed)
        places.append([*env.target.place, env.target.yaw])
        np.testing.assert_allclose(seen["target"], env.target.centre_line, atol=1e-6)
    env.close()
    assert (np.abs(places) <= [0.4, 0.4, 0.1, 180]).all()
    assert (np.ptp(places, axis=0) > [0.4, 0.4, 0.1, 180]).all()


# The disturbances of book/experiments and of chapter 16.


def test_a_bad_sensor_spoils_points_and_nothing_else(usual):
    late = film(Faults(everything(), delay=2))
    seldom = film(Faults(everything(), delay=1, interval=3))
    noisy = film(Faults(everything(), noise=0.005))
    for t in range(5):
        np.testing.assert_array_equal(late[t]["points"], usual[max(t - 2, 0)]["points"])
        np.testing.assert_array_equal(seldom[t]["points"], usual[max(t - 1, 0) // 3 * 3]["points"])
        assert np.std(noisy[t]["points"] - usual[t]["points"]) == pytest.approx(0.005, rel=0.1)
    same(noisy, usual, "grippers", "target", "rods", "wanted", "needed", "held")


def test_grippers_let_go_after_so_many_seconds():
    held = [int(shot["held"]) for shot in film(Release(everything(), 0.4), 20)]
    assert held == [1] * 13 + [0] * 8  # 0.4 s are over after the twelfth step


def test_pushes_move_the_cloth_and_one_gripper_holds_it_alone(usual):
    shoved = middles(film(everything(Pushed, shove=1.0), 60)) - middles(usual)
    aside = np.linalg.norm(shoved[:, :2], axis=1)
    assert not aside[:8].any()  # it begins after 0.3 s
    assert 0.03 < aside.max() < 0.2
    assert aside[-1] < aside.max() / 2  # it swings back
    swung = middles(film(everything(Pushed, swing=1.0), 0)) - middles(usual[:1])
    assert 0.01 < np.linalg.norm(swung[0, :2]) < 0.2
    alone = film(everything(Pushed, n_grippers=1), 60)[-1]
    here, gone = cdist(alone["grippers"], alone["points"]).min(axis=1)
    assert here < 0.005 < 0.015 < gone
    np.testing.assert_allclose(alone["grippers"], usual[60]["grippers"], atol=0.003)  # it carries all the weight now


@pytest.mark.parametrize("distance", [None, 0.2])
def test_grippers_do_not_pass_a_fence(distance):
    env = make(target=Hook(place=(0.1, 0.2, 0.0), yaw=90.0))
    if distance:
        env = Fence(env, distance)
    start = env.reset(seed=2)[0]
    tip = start["target"][-1]
    out = turned([0, -1, 0], 90.0)  # the arm points along -y, turned by 90 degrees
    assert ((start["grippers"] - tip) @ out).min() > 0.25
    for _ in range(60):
        shot = env.step(np.array([-1, 0, 0] * 2 + [0]))[0]
    after = (shot["grippers"] - tip) @ out
    assert after == pytest.approx(0.2, abs=0.03) if distance else after.max() < 0
    env.close()
