"""Controllers: what they measure and choose, when they let go; whole runs in the simulator."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

pytest.importorskip("pybullet")
pytest.importorskip("gymnasium")

from chapter_tools.dressing import PullOver
from chapter_tools.throwing import Fence, Thrower
from topokit._geometry import angle, turned
from topokit.control import Planner, Servo, hang
from topokit.io import load_episode, save_episode
from topokit.sim import WARDROBE, HangEnv, Hook, Mannequin

from conftest import polygon

CHECKPOINTS = Path(__file__).parents[1] / "data_small" / "checkpoints"
HANDS = np.array([[-0.1, -0.6, 1.42], [0.1, -0.6, 1.42]])
COARSE = WARDROBE["apron"](spacing=0.05, strap_width=0.05)


def ring(n=40, radius=0.15, centre=(0.0, 0.0, 0.0)):
    """A ring that stands upright and looks along y."""
    x, z = radius * polygon(n).T
    return np.column_stack([x, 0 * x, z]) + centre


def seen(points, grippers, target=None, held=1):
    target = target or Hook()
    return {"points": points, "grippers": np.asarray(grippers), "target": target.centre_line, "held": held}


def plan(servo, observation, frames=8):
    """The actions of a few frames in which nothing moves."""
    servo.reset(observation)
    return [servo.act(observation) for _ in range(frames)]


def way_of_a_rigid_ring(servo, frames):
    """The places of the hands until they let go of a ring that is rigid in them; they are where they are sent."""
    hands = HANDS
    loop = ring(60, centre=(0, 0, -0.17))
    servo.reset(seen(loop + hands.mean(axis=0), hands))
    way = []
    for _ in range(frames):
        way.append(hands.mean(axis=0))
        if servo.act(seen(loop + way[-1], hands))[6] > 0:
            assert Hook().holds(loop + way[-1])
            return np.array(way)
        hands = servo.goals
    raise AssertionError(servo.reason or "it was not let go")


def test_slow_hands_go_the_same_way_as_fast_ones_and_let_go_of_a_linked_ring():
    """A stop that is not reached in time is left; hands at a quarter of the speed once went down in front of the hook."""
    usual = way_of_a_rigid_ring(Servo(), 300)
    slow = way_of_a_rigid_ring(Servo(max_step=0.0108), 1200)
    assert len(slow) > 2 * len(usual)
    assert cKDTree(usual).query(slow)[0].max() < 0.02


def test_it_hangs_the_loop_that_bears():
    servo = Servo()
    rings = np.concatenate([ring(60, 0.1, (0, 0, 1.3)), ring(60, 0.15, (0, 0, 0.8))])
    plan(servo, seen(rings, [[-0.1, 0, 1.42], [0.1, 0, 1.42]]))
    assert [loop.cycle[:, 2].mean() for loop in servo._chosen] == pytest.approx([1.3 - 1.42], abs=0.03)


def test_two_handles_that_hang_askew_are_turned_until_their_grippers_are_behind_each_other():
    askew = [turned(turned(ring(60, 0.1), 90), 30) + [x, 0, 1.27] for x in (-0.15, 0.15)]
    servo = Servo(2)
    plan(servo, seen(np.concatenate(askew), [[-0.15, 0, 1.37], [0.15, 0, 1.37]], Hook(yaw=-60.0)), 8)
    across = [abs(loop.opening.normal[0]) for loop in servo._chosen]
    assert across == pytest.approx([np.cos(np.radians(30))] * 2, abs=0.05)
    assert angle(np.eye(3)[0], servo.goals[1] - servo.goals[0]) > 1  # to 30 degrees, where the arm is


def test_a_garment_that_shows_no_loop_is_turned_until_it_does():
    """From before its edge an opening looks like a line."""
    servo = Servo()
    loop = ring(60, centre=(0, 0, -0.17))
    servo.reset(seen(loop[:30] + HANDS.mean(axis=0), HANDS))
    for _ in range(70):
        yaw = angle(np.eye(3)[0], servo.goals[1] - servo.goals[0])
        shown = loop if yaw < -40 or yaw > 40 else loop[:30]
        servo.act(seen(turned(shown, yaw) + servo.goals.mean(axis=0), servo.goals))
    assert servo._chosen
    assert not servo.reason


TUBE = ring(80, 0.2)[:, [0, 2, 1]] @ [[1, 0, 0], [0, 0.8, 0.6], [0, -0.6, 0.8]] + [0, 0, 1.2]
POLE = {"target": np.array([[0, 0.5, 0], [0, 0.5, 1.0], [0, 0.5, 1.5]])}


@pytest.mark.parametrize(
    ("points", "hands", "other", "frames", "reason"),
    [
        (ring(), [[-0.1, 0, 0.2], [0.1, 0, 0.2]], POLE, 8, "no arm"),
        (ring(20, 0.03), [[-0.1, 0, 0.05], [0.1, 0, 0.05]], {}, 70, "0 of these are as large"),
        (TUBE, [[-0.2, 0, 1.4], [0.2, 0, 1.4]], {}, 170, "1 loops are seen, 0 of"),
    ],
    ids=["a pole", "a small loop", "a tube open downwards"],
)
def test_what_cannot_hang_is_refused(points, hands, other, frames, reason):
    """A tube, as the body of a T-shirt, is turned to be seen from all sides, and goes nowhere."""
    servo = Servo()
    moves = np.array(plan(servo, {**seen(points, hands), **other}, frames))[:, :6].reshape(-1, 2, 3)
    assert reason in servo.reason
    assert np.any(moves) == (points is TUBE)
    assert np.abs(moves.sum(axis=1)).max() < 0.01


def test_planned_paths_are_no_faster_and_no_harder_than_said():
    actions = np.array(plan(Planner(), seen(ring(60, centre=(0, -0.6, 1.25)), HANDS), 16))[:, :6]
    assert 0.2 < abs(actions).max() <= 0.6
    assert abs(np.diff(actions, axis=0)).max() <= 0.06 + 1e-6


@pytest.fixture(scope="module")
def outcome():
    return hang("apron-hook", garment=COARSE, seed=1)


def test_it_hangs_and_the_episode_is_like_any_other(outcome, tmp_path):
    assert (outcome.success, outcome.linked, outcome.reason) == (True, ("neck",), "it hangs")
    episode = load_episode(save_episode(tmp_path / "e.npz", outcome.episode))
    assert (len(episode), episode.success) == (outcome.steps + 1, True)
    assert episode.held[[0, -1]].tolist() == [True, False]
    assert episode.physics["controller"] == "Servo"


def test_too_few_frames_and_models_are_told_of():
    late = hang("apron-hook", garment=COARSE, seed=1, max_steps=2)
    assert (late.success, late.reason, late.steps) == (False, "it was not let go in time", 2)
    with pytest.raises(AttributeError, match="move"):
        hang("apron-hook", garment=COARSE, seed=1, model=CHECKPOINTS / "mlp.safetensors")


def test_a_plan_hangs_it_sooner(outcome):
    planned = hang("apron-hook", garment=COARSE, seed=1, model="carry")
    assert (planned.success, planned.linked) == (True, ("neck",))
    assert planned.steps < outcome.steps
    assert planned.episode.physics["controller"] == "Planner"


# The throws and the dressing of chapter 16.


def test_what_cannot_be_reached_is_thrown(outcome):
    thrown = hang(Fence(HangEnv("apron-hook", garment=COARSE), 0.15), seed=1, controller=Thrower(fence=0.15, seed=1))
    assert (thrown.success, thrown.linked) == (True, ("neck",))
    ahead = thrown.episode.centre_line[-1] - thrown.episode.grippers  # the arm points along -y
    assert ahead[..., 1].min() > 0.12
    far = Fence(HangEnv("apron-hook", garment=COARSE), 0.15)
    assert not hang(far, seed=1, max_steps=outcome.steps + 20).success


def test_what_is_let_go_flies_as_a_thrown_body():
    held = np.zeros((1, 60, 1, 3))
    held[0, :, 0, 1] = 0.03 * np.arange(60)
    held[0, :, 0, 2] = 0.01 * np.arange(60)
    way = Thrower(fence=0.2).flight(held, np.array([50]))[0, :, 0] - held[0, 49, 0]
    time = 0.036 * np.array([4, 6, 8, 10])
    np.testing.assert_allclose(way[:, 1], 0.03 / 0.036 * time)
    np.testing.assert_allclose(way[:, 2], 0.01 / 0.036 * time - 9.8 / 2 * time**2)


DUMMY = Mannequin(place=(0.3, -0.2, 0.05), yaw=70.0)


def tube():
    """Rings above each other; the highest is the narrowest."""
    widths = [0.1, *[0.13] * 12]
    return np.concatenate([ring(30, width)[:, [0, 2, 1]] - [0, 0, 0.04 * k] for k, width in enumerate(widths)])


def carried(controller, cloth, place, yaw, gap, frames=400):
    """Cloth (n, 3), seen from between its grippers, each half of which goes with its own; clouds and the last action."""
    half = np.array([[-gap / 2, 0, 0], [gap / 2, 0, 0]])
    hands = turned(half, yaw) + place
    side = (cloth[:, 0] > 0).astype(int)
    own = cloth - half[side]
    rods = np.array([[*start, *end, radius] for start, end, radius in DUMMY.rods])
    clouds = []
    for frame in range(frames):
        points = turned(own, angle(np.eye(3)[0], hands[1] - hands[0])) + hands[side]
        clouds.append(points)
        observation = {**seen(points, hands, DUMMY), "rods": rods}
        if frame == 0:
            controller.reset(observation)
        action = controller.act(observation)
        if action[6] or controller.reason:
            break
        hands = hands + controller.max_step * action[:6].reshape(2, 3)
    return clouds, action


@pytest.mark.parametrize("yaw", [70.0, -60.0, 160.0])
def test_a_tube_is_lifted_over_the_head_and_let_go_around_the_neck(yaw):
    aside = turned(np.array([0.1, -0.5, 1.5]), 70)
    clouds, action = carried(PullOver(), tube(), np.array([*(DUMMY.seat + aside)[:2], 1.5]), yaw, 0.2)
    assert action[6] == 1
    assert DUMMY.holds(clouds[-1][:30])
    axis = DUMMY.centre_line[-1, :2]
    for cloud in clouds:  # whatever is lower than the head surrounds it, or is far from it
        low = cloud[cloud[:, 2] < DUMMY.centre_line[-1, 2]]
        inside = len(low) and np.linalg.norm(low[:, :2].mean(axis=0) - axis) < 0.05
        assert inside or not len(low) or np.linalg.norm(low[:, :2] - axis, axis=1).min() > 0.2


def test_a_vest_is_put_on_wherever_the_mannequin_stands():
    result = hang("vest-mannequin", seed=3, place="anywhere", controller=PullOver())
    assert result.success, result.reason
    assert {"neck", "hem"} <= {*result.linked}
