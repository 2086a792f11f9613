"""What is put on a mannequin in a closed loop: in a world where cloth goes with its grippers, and once in PyBullet."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("pybullet")
pytest.importorskip("gymnasium")

from topokit._geometry import turned
from topokit.control import PullOverController, StrapController, hang
from topokit.control._arm import angle
from topokit.sim import Hook, Mannequin, Placed

from conftest import polygon

DUMMY = Placed(Mannequin(), 0.3, -0.2, 0.05, yaw=70.0)


def tube(radius=0.13, top=0.0, bottom=-0.5, n=30):
    """Rings above each other; the highest is the narrowest."""
    heights = np.arange(top, bottom, -0.04)
    rings = [
        np.column_stack([r * polygon(n), np.full(n, z)]) for z, r in zip(heights, [0.1, *[radius] * 99], strict=False)
    ]
    return np.concatenate(rings)


def straps():
    """Two hoops that stand on a gripper each, since nothing here gives way, and a bag behind them."""
    y, z = 0.12 * polygon(24).T
    rings = [np.column_stack([0 * y + side, y - 0.1, z + 0.02]) for side in (-0.2, 0.2)]
    bag = np.stack(np.meshgrid(np.linspace(-0.2, 0.2, 9), [-0.26], np.linspace(-0.4, -0.1, 7)), axis=-1)
    return np.concatenate([*rings, bag.reshape(-1, 3)])


def rods_of(target):
    return np.array([[*start, *end, radius] for start, end, radius in target.rods])


def carried(controller, cloth, place, yaw, gap, frames=400):
    """Cloth (n, 3), seen from between its grippers, each half of which goes with its own; clouds and the last action."""
    half = np.array([[-gap / 2, 0, 0], [gap / 2, 0, 0]])
    hands, side = turned(half, yaw) + place, (cloth[:, 0] > 0).astype(int)
    own, clouds, action = cloth - half[side], [], np.zeros(7)
    for frame in range(frames):
        points = turned(own, angle(np.eye(3)[0], hands[1] - hands[0])) + hands[side]
        clouds.append(points)
        seen = {"points": points, "grippers": hands, "target": DUMMY.centre_line, "rods": rods_of(DUMMY), "held": 1}
        if frame == 0:
            controller.reset(seen)
        action = controller.act(seen)
        if action[6] or controller.reason:
            break
        hands = hands + controller.max_step * action[:6].reshape(2, 3)
    return clouds, action


@pytest.mark.parametrize("yaw", [70.0, -60.0, 160.0])
def test_a_tube_is_lifted_over_the_head_and_let_go_around_the_neck(yaw):
    aside = turned(np.array([0.1, -0.5, 1.5]), 70)
    clouds, action = carried(PullOverController(), tube(), np.array([*(DUMMY.seat + aside)[:2], 1.5]), yaw, 0.2)
    assert action[6] == 1
    assert DUMMY.holds(clouds[-1][:30])
    axis, top = DUMMY.centre_line[-1, :2], DUMMY.centre_line[-1, 2]
    for cloud in clouds:  # whatever is lower than the head surrounds it, or is far from it
        low = cloud[cloud[:, 2] < top]
        inside = len(low) and np.linalg.norm(low[:, :2].mean(axis=0) - axis) < 0.05
        assert inside or not len(low) or np.linalg.norm(low[:, :2] - axis, axis=1).min() > 0.2


def test_a_tube_that_looks_aside_is_turned_to_the_shoulders_either_way_round():
    clouds, _ = carried(PullOverController(), tube() * [1.5, 0.8, 1], DUMMY.seat + [0, 0, 1.0], 20.0, 0.3)
    ring = clouds[-1][30:60]
    longest = ring[np.linalg.norm(ring - ring.mean(axis=0), axis=1).argmax()] - ring.mean(axis=0)
    assert abs(abs(angle(longest, turned(np.array([1.0, 0, 0]), 70))) % 180) == pytest.approx(0, abs=15)


def test_what_has_no_loop_is_never_let_go():
    controller = PullOverController()
    _, action = carried(controller, tube()[::30], DUMMY.seat + [0, 0, 1.0], 70.0, 0.2, frames=2500)
    assert action[6] == 0
    assert "not seen to be worn" in controller.reason


@pytest.mark.parametrize("turn", [0.0, 40.0])
def test_straps_go_over_both_shoulders(turn):
    start = DUMMY.seat + turned(np.array([0.1, -0.8, 0.0]), 70)
    clouds, action = carried(StrapController(), straps() * [1.25, 1, 1], start, 70.0 + turn, 0.55)
    assert action[6] == 1
    assert all(DUMMY.holds(clouds[-1][part]) for part in (slice(0, 24), slice(24, 48)))


def test_straps_that_are_too_narrow_are_refused_before_anything_tears():
    controller = StrapController()
    clouds, _ = carried(controller, straps() * [0.7, 1, 1], DUMMY.seat + [0, -0.8, 0], 70.0, 0.3)
    assert len(clouds) == 1
    assert "0.30 m apart do not pass shoulders that take 0.5" in controller.reason


@pytest.mark.parametrize("kind", [PullOverController, StrapController])
def test_a_hook_wears_nothing(kind):
    hands = np.array([[-0.1, 0, 1.4], [0.1, 0, 1.4]])
    seen = {"points": tube() + [0, 0, 1.4], "grippers": hands, "target": Hook().centre_line, "held": 1}
    controller = kind()
    controller.reset(seen)
    assert not controller.act({**seen, "rods": rods_of(Hook())}).any()
    assert "no head" in controller.reason


def test_a_vest_is_put_on_wherever_the_mannequin_stands():
    result = hang("vest-mannequin", seed=3, place="anywhere")
    assert result.success, result.reason
    assert {"neck", "hem"} <= {*result.linked}
