"""Starts in a row for learners: Gymnasium's checks, Stable-Baselines3, and the starts of the hanging benchmark."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

from topokit.control import Controller, hang
from topokit.sim import Garment, HangingStarts, SimulationConfig


def starts(**options: object) -> HangingStarts:
    garment = Garment.apron(spacing=0.05, strap_width=0.05)
    quick = SimulationConfig(self_collision=False, settle=0.02)
    env = gymnasium.make("topokit/HangApronHook-v1", garment=garment, config=quick, n_points=60, max_steps=4)
    return HangingStarts(env, **options)


def test_starts_come_in_a_row_and_again():
    env = starts(seeds=[7, 8, 9])
    observations, infos = zip(*(env.reset() for _ in range(4)), strict=True)
    assert [info["seed"] for info in infos] == [7, 8, 9, 7]
    np.testing.assert_array_equal(observations[0]["points"], observations[3]["points"])
    assert not np.array_equal(observations[0]["target"], observations[1]["target"])
    assert [env.reset(seed=4)[1]["seed"], env.reset()[1]["seed"]] == [8, 9]
    env.close()


def test_starts_are_those_of_the_hanging_benchmark():
    class GivesUp(Controller):
        def reset(self, observation):
            self.reason = ""
            self.seen = observation

        def act(self, observation):
            self.reason = "it looked"

    env = starts()
    looks = GivesUp()
    mine = env.reset()[0]
    scene = {"garment": env.unwrapped.garment, "config": env.unwrapped.config, "n_points": 60}
    hang("apron-hook", seed=1000, place="anywhere", controller=looks, **scene)
    for name, value in looks.seen.items():
        np.testing.assert_array_equal(mine[name], value)
    env.close()


@pytest.mark.parametrize("seeds", [[], [0.5], [-1]], ids=str)
def test_seeds_are_whole_numbers(seeds):
    with pytest.raises(ValueError, match="seed"):
        starts(seeds=seeds)


@pytest.mark.filterwarnings("ignore")
def test_stable_baselines3_checks_and_trains():
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    from stable_baselines3 import PPO

    env = starts(seeds=range(3))
    checker.check_env(env)
    model = PPO("MultiInputPolicy", env, n_steps=8, batch_size=8, n_epochs=1, seed=0)
    before = [weights.detach().clone() for weights in model.policy.parameters()]
    model.learn(16)
    after = list(model.policy.parameters())
    assert any((old != new).any() for old, new in zip(before, after, strict=True))
    model.env.close()
