"""HangEnv: Gymnasium's own checks, seeds, rewards, options, vectors of environments."""

from __future__ import annotations

import dataclasses
import gc
import os
import signal
import subprocess
import sys
import warnings

import numpy as np
import pytest

pytest.importorskip("pybullet")
pytest.importorskip("gymnasium")

import gymnasium
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AsyncVectorEnv
from scipy.spatial.distance import cdist

from topokit._geometry import turned
from topokit.sim import TASKS, WARDROBE, Camera, HangEnv, Hanger, Hook, Placed, SimulationConfig

COARSE = WARDROBE["apron"](spacing=0.05, strap_width=0.05)
QUICK = SimulationConfig(self_collision=False, settle=0.05)
SPOILT = {"cloud_delay": 2, "noise": 0.005, "dropout": 0.2, "outliers": 0.05}
DISTURBED = {"place": "anywhere", "start": "anywhere", "target_shift": 0.15, "shove": 1.0, **SPOILT}


def make(**options):
    return HangEnv("apron-hook", **{"garment": COARSE, "n_points": 120, "config": QUICK, **options})


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


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_ctrl_c_while_a_world_begins_leaves_the_output(monkeypatch, ctrl_c, capfd):
    """What PyBullet prints meanwhile is discarded; the signal comes between giving back the one output and the other."""
    dup2 = os.dup2
    calls = []

    def interrupted(*arguments):
        dup2(*arguments)
        calls.append(arguments)
        if len(calls) == 3:
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(os, "dup2", interrupted)
    with pytest.raises(KeyboardInterrupt):
        make().reset(seed=0)
    monkeypatch.undo()
    os.write(2, b"heard")
    assert capfd.readouterr().err == "heard"


def test_an_environment_that_is_dropped_gives_its_memory_back():
    import pybullet

    env = make()
    env.reset(seed=0)
    client = env._world._client
    assert pybullet.isConnected(client)
    del env
    gc.collect()
    assert not pybullet.isConnected(client)


@pytest.mark.parametrize(
    ("version", "options"),
    [
        ("topokit/HangApronHook-v1", {}),
        ("topokit/HangApronHook-v1", {"reward": "topological-observed", "cameras": Camera.around(n=2)}),
        ("topokit/HangTote2Hanger-v1", {"garment": WARDROBE["tote"](handles=2, spacing=0.04), **DISTURBED}),
    ],
)
def test_gymnasiums_checker_finds_nothing(version, options):
    env = gymnasium.make(version, **{"garment": COARSE, "config": QUICK, "n_points": 80, **options})
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # its advice comes as warnings
        check_env(env.unwrapped)
    env.close()


@pytest.mark.parametrize("reward", ["sparse", "dense", "topological", "topological-observed"])
def test_the_scripted_path_succeeds_and_rewards_are_differences_of_a_potential(reward):
    env = make(reward=reward, n_points=160, config=dataclasses.replace(QUICK, settle=0.4))
    start = env.reset(seed=1)[1]
    total, info, terminated = play(env, seed=1)
    assert terminated
    assert info["success"]
    assert info["linked"] == 1
    progress = start["distance"] - info["distance"]
    assert progress > 0.2
    assert total == pytest.approx({"sparse": 1, "dense": 1 + progress}.get(reward, 2 + progress))
    episode = env.episode("script")
    assert episode.success
    assert (episode.seed, episode.physics["controller"]) == (1, "script")
    np.testing.assert_array_equal(episode.points[-1], env.vertices.astype(np.float32))
    env.close()


@pytest.mark.parametrize("options", [{"cameras": Camera.around(n=2)}, DISTURBED])
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
    assert terminated
    assert (info["dropped"], info["success"], info["torn"]) == (True, False, False)
    assert total < 0  # it fell away from the hook
    assert env.step(np.zeros(7))[0]["held"] == 0  # the action that lets go need not be repeated
    env.close()


def test_torn_cloth_ends_the_episode():
    env = make(config=dataclasses.replace(QUICK, stiffness=8.0))
    total, info, terminated = play(env, 0)
    assert terminated
    assert info["torn"]
    assert total == 0
    env.close()


def test_grippers_go_where_the_actions_say_until_taut_cloth_holds_them():
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


# Options: where it happens, what disturbs, what is seen.


def film(steps=4, seed=2, **options):
    """What is observed while the grippers stay where they are, and the infos; all vertices are seen."""
    env = make(n_points=len(COARSE.vertices))
    shots = [env.reset(seed=seed, options=options)]
    shots += [(shot, info) for shot, *_, info in (env.step(np.zeros(7)) for _ in range(steps))]
    env.close()
    return [shot for shot, _ in shots], [info for _, info in shots]


@pytest.fixture(scope="module")
def usual():
    return film(60)


def same(shots, others, *names):
    for shot, other in zip(shots, others, strict=False):
        for name in names or shot:
            np.testing.assert_array_equal(shot[name], other[name], err_msg=name)


def column(shots, name):
    return np.array([shot[name] for shot in shots])


def middles(shots):
    return column(shots, "points").mean(axis=1)


ALL_BUT_POINTS = ("grippers", "target", "rods", "wanted", "needed", "held")


@pytest.mark.parametrize("name", SPOILT)
def test_what_spoils_points_spoils_nothing_else(name, usual):
    shots, infos = film(**{name: SPOILT[name]})
    assert {*shots[0]} == {*ALL_BUT_POINTS, "points"}
    same(shots, usual[0], *ALL_BUT_POINTS)
    assert infos == usual[1][:5]
    assert not np.array_equal(shots[-1]["points"], usual[0][4]["points"])


def test_clouds_are_late_and_stay_until_the_next_one(usual):
    late = film(cloud_delay=2)[0]
    seldom = film(cloud_interval=3, cloud_delay=1)[0]
    for t in range(5):
        np.testing.assert_array_equal(late[t]["points"], usual[0][max(t - 2, 0)]["points"])
        np.testing.assert_array_equal(seldom[t]["points"], usual[0][max(t - 1, 0) // 3 * 3]["points"])


def test_noise_losses_and_outliers_are_as_many_as_asked_for(usual):
    clean = usual[0][0]["points"]
    noisy = film(0, noise=0.005)[0][0]["points"]
    assert np.std(noisy - clean) == pytest.approx(0.005, rel=0.1)
    left = {*map(tuple, film(0, dropout=0.2)[0][0]["points"].tolist())}
    assert len(left) == round(0.8 * len(clean))
    assert left < {*map(tuple, clean.tolist())}
    stray = film(0, outliers=0.05)[0][0]["points"]
    assert (stray != clean).any(axis=1).sum() == round(0.05 * len(clean))


def test_a_swing_precedes_the_first_observation(usual):
    shots, _ = film(30, swing=1.0)
    aside = np.linalg.norm((middles(shots) - middles(usual[0][:31]))[:, :2], axis=1)
    assert 0.01 < aside[0] < 0.2
    assert aside[-1] < aside.max()
    np.testing.assert_allclose(shots[0]["grippers"], usual[0][0]["grippers"], atol=0.02)


def test_a_shove_moves_the_cloth_and_nothing_else(usual):
    shots, _ = film(60, shove=1.0)
    same(shots[:8], usual[0])  # it begins after 0.3 s
    same(shots, usual[0], "target", "rods", "wanted", "needed", "held")
    np.testing.assert_allclose(column(shots, "grippers"), column(usual[0], "grippers"), atol=0.02)
    by = middles(shots) - middles(usual[0])
    twice = middles(film(60, shove=2.0)[0]) - middles(usual[0])
    aside = np.linalg.norm(by[:, :2], axis=1)
    assert 0.03 < aside.max() < 0.2
    assert aside[-1] < aside.max() / 2  # it swings back
    peak = aside.argmax()
    assert twice[peak, :2] @ by[peak, :2] / aside[peak] ** 2 == pytest.approx(2, abs=0.4)  # the same push, harder


def test_one_gripper_holds_the_garment_alone(usual):
    """At the height of its goal: it carries all the weight now, and the other one does not rise."""
    shots, _ = film(60, n_grippers=1)
    both, alone = usual[0][60], shots[-1]
    here, gone = cdist(alone["grippers"], alone["points"]).min(axis=1)
    assert here < 0.005 < 0.015 < gone
    np.testing.assert_allclose(alone["grippers"], both["grippers"], atol=0.003)
    aside = np.linalg.norm((middles([both, alone]) - alone["grippers"][0])[:, :2], axis=1)
    assert aside[1] < 0.02 < 0.04 < aside[0]
    assert alone["held"]


def test_grippers_let_go_after_so_many_seconds():
    held = [int(shot["held"]) for shot in film(20, release_after=0.4)[0]]
    assert held == [1] * 13 + [0] * 8  # 0.4 s are over after the twelfth step


@pytest.mark.parametrize("fence", [0.0, 0.2])
def test_grippers_do_not_pass_a_fence(fence):
    env = make(fence=fence)
    start = env.reset(seed=2, options={"place": (0.1, 0.2, 0.0, 90.0)})[0]
    tip = start["target"][-1]
    out = np.array([1, 0, 0])  # the arm points along -y, turned by 90 degrees
    assert ((start["grippers"] - tip) @ out).min() > 0.25
    for _ in range(60):
        shot = env.step(np.array([-1, 0, 0] * 2 + [0]))[0]
    after = (shot["grippers"] - tip) @ out
    assert after == pytest.approx(0.2, abs=0.03) if fence else after.max() < 0
    for _ in range(3):
        shot = env.step(np.array([1, 0, 0] * 2 + [0]))[0]  # back again
    assert ((shot["grippers"] - tip) @ out > after + 0.03).all()
    env.close()


def test_grippers_behind_a_fence_are_not_pushed_and_may_go_back_alone():
    env = make(fence=2.0)
    start = env.reset(seed=2)[0]
    out = np.array([0, -1, 0])  # of the arm
    goal = env.goal
    for _ in range(5):
        env.step([0, 1, 0] * 2 + [0])
    np.testing.assert_allclose(env.goal, goal, atol=1e-9)
    for _ in range(5):
        shot = env.step([0, -1, 0] * 2 + [0])[0]
    assert ((shot["grippers"] - start["grippers"]) @ out > 0.05).all()
    env.close()


def test_a_fence_stands_before_an_arm():
    env = HangEnv("vest-mannequin", config=QUICK, fence=0.1)
    with pytest.raises(ValueError, match="fence"):
        env.reset(seed=0)
    env.close()


def test_a_target_travels_steadily(usual):
    shots, _ = film(30, target_speed=0.3)
    same(shots[:1], usual[0])
    gone = column(shots, "target") - column(usual[0][:31], "target")
    steps = np.diff(gone[:, 0], axis=0)
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1), 0.3 * 0.036, rtol=1e-3)
    np.testing.assert_allclose(steps, np.repeat(steps[:1], 30, axis=0), atol=1e-6)
    rods = column(shots, "rods") - column(usual[0][:31], "rods")
    np.testing.assert_allclose(rods[:, :, :3], np.repeat(gone[:, :1], rods.shape[1], axis=1), atol=1e-6)


def test_a_target_moves_to_its_place(usual):
    shots, _ = film(60, target_shift=0.15)
    for name in ("points", "grippers", "wanted"):  # as if nothing were: the script is that of the place where it ends
        np.testing.assert_allclose(column(shots, name), column(usual[0], name), atol=1e-4)
    gone = column(shots, "target") - column(usual[0], "target")
    np.testing.assert_allclose(gone, np.repeat(gone[:, :1], 4, axis=1), atol=1e-6)
    far = np.linalg.norm(gone[:, 0], axis=1)
    assert 0.02 < far[0] <= 0.15
    assert (np.diff(far) < 1e-6).all()
    assert far[8] == pytest.approx(far[0])  # it sets off after 0.3 s
    assert far[-1] < 1e-6
    rods = column(shots, "rods") - column(usual[0], "rods")
    np.testing.assert_allclose(rods[:, :, :6], np.repeat(np.tile(gone[:, :1], 2), 3, axis=1), atol=1e-6)
    assert not rods[:, :, 6].any()


def test_all_goes_along_to_another_place(usual):
    shot = film(0, place=(0.3, -0.2, 0.05, 130.0))[0][0]
    for name in ("points", "grippers", "target", "wanted"):  # farthest points may come in another order
        gaps = cdist(shot[name], turned(usual[0][0][name], 130.0) + [0.3, -0.2, 0.05])
        assert max(gaps.min(axis=0).max(), gaps.min(axis=1).max()) < 1e-3, name


def test_anywhere_has_bounds():
    env = make(place="anywhere")
    places = []
    for seed in range(12):
        seen, _ = env.reset(seed=seed)
        places.append([*env.target.place, env.target.yaw])
        np.testing.assert_allclose(seen["target"], env.target.centre_line, atol=1e-6)
    env.reset(seed=0, options={"place": None})
    assert env.target == TASKS["apron-hook"].target
    env.close()
    assert (np.abs(places) <= [0.4, 0.4, 0.1, 180]).all()
    assert (np.ptp(places, axis=0) > [0.4, 0.4, 0.1, 180]).all()


def test_a_start_anywhere_turns_the_garment_with_the_grippers():
    yaws = []
    for seed in range(4):
        here, there = (film(0, seed=seed, **options)[0][0] for options in ({}, {"start": "anywhere"}))
        same([here], [there], "target", "rods", "needed", "held")
        away = there["grippers"].mean(axis=0) - Hook().seat
        assert 0.5 < np.hypot(*away[:2]) < 1.0
        spans = [np.diff(shot["grippers"], axis=0)[0] for shot in (here, there)]
        yaw = np.subtract(*(np.degrees(np.arctan2(span[1], span[0])) for span in spans[::-1]))
        hangs = [shot["points"].mean(axis=0) - shot["grippers"].mean(axis=0) for shot in (here, there)]
        np.testing.assert_allclose(hangs[1], turned(hangs[0], yaw), atol=1e-3)
        yaws.append(yaw % 360)
    assert np.ptp(yaws) > 60


def test_the_script_succeeds_from_elsewhere():
    env = make(place="anywhere", start="anywhere", target_shift=0.1, config=dataclasses.replace(QUICK, settle=0.4))
    assert play(env, seed=1)[1]["success"]
    env.close()


def test_cameras_that_see_nothing_show_what_was_seen(usual):
    away = make(cameras=[Camera(target=(0, -9, 1.2))])
    seen, _ = away.reset(seed=2)
    np.testing.assert_array_equal(np.unique(seen["points"], axis=0), np.unique(seen["grippers"], axis=0))
    away.close()
    x, y, z = usual[0][0]["grippers"].mean(axis=0).tolist()
    env = make(cameras=[Camera(eye=(x, y - 0.6, z), target=(x, y, z), fov=30)])
    clouds = [env.reset(seed=2)[0]["points"]]
    clouds += [env.step([0] * 6 + [1])[0]["points"] for _ in range(20)]  # it falls out of view
    env.close()
    assert not np.array_equal(clouds[0], clouds[5])
    np.testing.assert_array_equal(clouds[-1], clouds[-2])


@pytest.mark.parametrize(("name", "wanted", "needed"), [("tote2", 2, 2), ("backpack", 2, 1), ("sheet", 1, 1)])
def test_rods_and_loops_of_a_task(name, wanted, needed):
    env = HangEnv(garment=WARDROBE[name](spacing=0.04), target=Hanger(), n_points=40, config=QUICK)
    seen, _ = env.reset(seed=0)
    assert seen in env.observation_space
    rods = [[*start, *end, radius] for start, end, radius in Hanger().rods]
    np.testing.assert_allclose(seen["rods"], rods, atol=1e-6)
    assert (len(seen["wanted"]), seen["needed"]) == (wanted, needed)
    assert np.abs(seen["wanted"] - seen["grippers"].mean(axis=0)).max() < 0.6
    env.close()


@pytest.fixture(scope="module")
def running():
    env = make()
    env.reset(seed=0)
    yield env
    env.close()


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"lat": 2}, "'lat'.* cloud_delay"),
        ({"place": "here"}, "place"),
        ({"place": (0, 0, float("nan"), 0)}, "place"),
        ({"start": (0, 0, 1)}, "start"),
        ({"target_shift": -0.1}, "target_shift"),
        ({"cloud_delay": 1.5}, "cloud_delay"),
        ({"dropout": 1.0}, "dropout"),
        ({"n_grippers": 3}, "n_grippers"),
        ({"outliers": "few"}, "outliers"),
    ],
)
def test_a_wrong_option_is_refused_by_name(options, named, running):
    with pytest.raises(ValueError, match=named):
        make(**options)
    with pytest.raises(ValueError, match=named):
        running.reset(options=options)
    running.step(np.zeros(7))  # the episode goes on


def test_every_task_has_an_id():
    ours = {spec.kwargs["task"]: name for name, spec in gymnasium.registry.items() if name.startswith("topokit/")}
    assert ours.keys() == TASKS.keys()
    assert ours["apron2-hanger"] == "topokit/HangApron2Hanger-v1"
    env = gymnasium.make(ours["apron-hook"], garment=COARSE, config=QUICK, n_points=50, cloud_delay=1).unwrapped
    env.reset(seed=0)
    assert env.task is TASKS["apron-hook"]
    assert isinstance(env.target, Placed)
    env.close()


def test_vectors_of_environments():
    envs = AsyncVectorEnv([make, make])
    observations, _ = envs.reset(seed=5)
    assert observations["points"].shape == (2, 120, 3)
    assert not np.array_equal(*observations["grippers"])
    observations, rewards, *_ = envs.step(np.zeros((2, 7), np.float32))
    assert rewards.shape == (2,)
    alone = make()
    alone.reset(seed=5)
    expected, *_ = alone.step(np.zeros(7, np.float32))
    np.testing.assert_array_equal(observations["points"][0], expected["points"])
    envs.close()
    alone.close()


def test_pictures():
    env = make(render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    env.close()
    assert (picture.shape, picture.dtype) == ((360, 480, 3), np.uint8)
    assert (picture[..., 2] > picture[..., 0] + 20).mean() > 0.02  # the blue cloth
    assert make().render() is None


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"task": "tie-nail"}, "tie-nail"),
        ({"task": "shirt-mannequin", "garment": COARSE}, "neck, hem.*apron"),
        ({"reward": "gold"}, "reward"),
        ({"n_points": 10**6}, "n_points"),
        ({"n_points": 2.5}, "n_points"),
        ({"n_points": "a"}, "n_points"),
        ({"n_points": True}, "n_points"),
        ({"max_steps": float("inf")}, "max_steps"),
        ({"render_mode": "human"}, "render_mode"),
    ],
)
def test_misuse_is_explained(options, named):
    with pytest.raises(ValueError, match=named):
        HangEnv(**options)


BAD_ACTIONS = [None, "abc", [0] * 6, [np.nan] * 7, [[1], 2, 3, 4, 5, 6, 7], [10**400] * 7, np.zeros(7, complex)]


def test_no_step_without_a_reset_nor_by_a_bad_action():
    env = make()
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(7))
    env.reset(seed=0)
    for action in BAD_ACTIONS:
        with pytest.raises(ValueError, match="action"):
            env.step(action)
    env.close()
    env.close()


def test_without_gymnasium_only_the_environment_is_missing():
    code = "import sys; sys.modules['gymnasium'] = None; import topokit.sim; print('imported'); topokit.sim.HangEnv"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout == "imported\n"
    assert "topokit[sim]" in done.stderr
