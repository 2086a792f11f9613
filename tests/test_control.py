"""Controllers: what they measure and choose, when they let go; whole hangings; the command."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

pytest.importorskip("pybullet")
pytest.importorskip("gymnasium")

import topokit as tk
from topokit import cli
from topokit._geometry import angle, turned
from topokit.control import Carried, Planner, PullOverController, Servo, StrapController, ThrowController, hang
from topokit.control._arm import Arm
from topokit.io import load_episode, save_episode
from topokit.sim import WARDROBE, Hanger, Hook, Mannequin, Placed

from conftest import polygon

CHECKPOINTS = Path(__file__).parents[1] / "data_small" / "checkpoints"
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


def rods_of(target):
    return np.array([[*start, *end, radius] for start, end, radius in target.rods])


@pytest.mark.parametrize("target", [Hook(), Hanger()])
def test_the_arm_is_found_wherever_the_target_stands(target):
    placed = Placed(target, 0.3, -0.2, 0.1, yaw=130.0)
    arm = Arm.of(placed.centre_line)
    np.testing.assert_allclose((arm.start + arm.end) / 2, placed.seat, atol=1e-9)
    loop = turned(ring(radius=0.12), 130)  # it looks along the arm
    for place, on in ((placed.seat, True), (arm.tip + 0.3 * arm.out, False)):
        assert arm.holds(loop + place) == placed.holds(loop + place) == on


@pytest.mark.parametrize("side", [1, -1])
def test_a_head_is_approached_from_where_the_garment_is(side):
    dummy = Placed(Mannequin(), 0.3, -0.2, 0.0, yaw=70.0)
    top, ahead = dummy.centre_line[-1], turned(np.array([0.0, -1.0, 0.0]), 70) * side
    arm = Arm.of_head(dummy.centre_line, rods_of(dummy), top + 0.5 * ahead)
    np.testing.assert_allclose(arm.out, ahead, atol=1e-9)
    assert (arm.seat - top) @ ahead < -Mannequin().head_radius  # it is let go behind the neck
    flat = ring(radius=0.12)[:, [0, 2, 1]] + top
    for z in (-0.05, -0.25, -0.3):  # on the crown like a wreath, and lower
        assert arm.holds(flat + [0, 0, z]) == dummy.holds(flat + [0, 0, z]) == (z < -0.2)


def test_a_pole_has_neither_arm_nor_head():
    line = np.array([[0, 0.5, 0], [0, 0.5, 1.0], [0, 0.5, 1.5]])
    rods = np.array([[*line[0], *line[2], 0.02]])
    servo = Servo()
    plan(servo, {**seen(ring(), [[-0.1, 0, 0.2], [0.1, 0, 0.2]]), "target": line, "rods": rods})
    assert "neither" in servo.reason


def test_grippers_go_apart_for_a_head():
    loop = ring(60, 0.2, (0, 0.0, 1.2))
    hands = [[-0.08, 0, 1.38], [0.08, 0, 1.38]]
    servo = Servo(radius=0.08)
    actions = plan(servo, {**seen(loop, hands, Mannequin()), "rods": rods_of(Mannequin())}, 8)
    assert servo.reason == ""
    first, second = actions[-1][:6].reshape(2, 3)
    assert second[0] - first[0] > 0.1


def way_of_a_rigid_ring(servo, frames):
    """The places of the hands until they let go of a ring that is rigid in them; they are where they are sent."""
    hands = np.array([[-0.1, -0.6, 1.42], [0.1, -0.6, 1.42]])
    loop = ring(60, centre=(0, 0, -0.17))
    servo.reset(seen(loop + hands.mean(axis=0), hands))
    way = []
    for _ in range(frames):
        way.append(hands.mean(axis=0))
        if servo.act(seen(loop + way[-1], hands))[6] > 0:
            return np.array(way)
        hands = servo.goals
    raise AssertionError(servo.reason or "it was not let go")


def test_slow_hands_go_the_same_way_as_fast_ones():
    """A stop that is not reached in time is left; hands at a quarter of the speed once went down in front of the hook."""
    usual = way_of_a_rigid_ring(Servo(), 300)
    slow = way_of_a_rigid_ring(Servo(max_step=0.0108), 1200)
    assert len(slow) > 2 * len(usual)
    assert cKDTree(usual).query(slow)[0].max() < 0.02


def test_it_looks_before_it_moves_and_turns_towards_the_arm():
    loop = ring(60, centre=(0, -0.6, 1.25))
    actions = plan(Servo(), seen(loop, [[-0.1, -0.6, 1.42], [0.1, -0.6, 1.42]], Placed(Hook(), yaw=30.0)), 9)
    assert not np.any(actions[:5])
    first, second = actions[-1][:6].reshape(2, 3)
    assert angle(np.array([1.0, 0]), np.array([0.2 + 0.0432 * (second - first)[0], 0.0432 * (second - first)[1]])) > 1
    assert actions[-1][6] == 0


@pytest.mark.parametrize(("goal", "z"), [(None, 1.3), ((0, 0, -0.6), 0.8)])
def test_it_hangs_the_loop_that_bears_or_the_one_it_was_told(goal, z):
    servo = Servo(goal)
    rings = np.concatenate([ring(60, 0.1, (0, 0, 1.3)), ring(60, 0.15, (0, 0, 0.8))])
    plan(servo, seen(rings, [[-0.1, 0, 1.42], [0.1, 0, 1.42]]))
    assert len(servo._chosen) == 1
    assert servo._chosen[0].cycle[:, 2].mean() == pytest.approx(z - 1.42, abs=0.03)


def test_two_rings_that_die_together_are_no_opening():
    """As the handles of a tote do; the walk around both, over a bridge, once ended the episode with an error."""
    rings = [ring(40, 0.12, (0, -0.6, 1.25)), ring(32, 0.1, (0, -0.53, 1.25))]
    assert any(len({*loop.cycle.tolist()}) < len(loop.cycle) for loop in tk.track([np.concatenate(rings)])[0].loops)
    servo = Servo()
    plan(servo, seen(np.concatenate(rings), [[-0.1, -0.6, 1.42], [0.1, -0.6, 1.42]]))
    assert [len(known.cycle) for known in servo._known_loops] == [40]


def test_of_two_handles_the_one_that_is_not_seen_is_the_twin():
    servo = Servo(2)
    plan(servo, seen(ring(60, centre=(0.15, 0, 1.2)), [[-0.15, 0, 1.37], [0.15, 0, 1.37]]))
    places = sorted(float(loop.cycle[:, 0].mean()) for loop in servo._chosen)
    assert places == pytest.approx([-0.15, 0.15], abs=0.02)


def test_of_two_handles_each_held_by_a_gripper_the_second_is_behind_the_first():
    """Handles that hang askew, and look along the arm: one behind the other they are when their grippers are."""
    askew = [turned(turned(ring(60, 0.1), 90), 30) + [x, 0, 1.27] for x in (-0.15, 0.15)]
    servo = Servo(2)
    plan(servo, seen(np.concatenate(askew), [[-0.15, 0, 1.37], [0.15, 0, 1.37]], Placed(Hook(), yaw=-60.0)), 8)
    assert [abs(loop.opening.normal[0]) for loop in servo._chosen] == pytest.approx(
        [np.cos(np.radians(30))] * 2, abs=0.05
    )
    turn = angle(np.eye(3)[0], servo._goals[1] - servo._goals[0])
    assert turn > 1  # to 30 degrees, where the arm is


def test_a_tube_that_hangs_open_downwards_is_not_put_over_an_arm():
    """The body of a T-shirt is such a loop; put over a hook it is linked with nothing, and falls."""
    tube = ring(80, 0.2)[:, [0, 2, 1]] @ [[1, 0, 0], [0, 0.8, 0.6], [0, -0.6, 0.8]]
    servo = Servo()
    actions = plan(servo, seen(tube + [0, 0, 1.2], [[-0.2, 0, 1.4], [0.2, 0, 1.4]]), 170)
    assert "1 loops are seen, 0 of" in servo.reason
    assert np.any(actions)
    grippers = np.array(actions)[:, :6].reshape(-1, 2, 3)
    assert np.abs(grippers.sum(axis=1)).max() < 0.01  # it is turned, to be seen from all sides, and goes nowhere


def test_a_garment_that_shows_no_loop_is_turned_until_it_does():
    """From before its edge an opening looks like a line."""
    servo, grippers = Servo(), np.array([[-0.1, 0.0, 1.42], [0.1, 0.0, 1.42]])
    loop = ring(60, centre=(0, 0, -0.17))
    servo.reset(seen(loop[:30] + grippers.mean(axis=0), grippers))
    for _ in range(70):
        yaw = angle(np.eye(3)[0], servo._goals[1] - servo._goals[0])
        shown = loop if yaw < -40 or yaw > 40 else loop[:30]
        servo.act(seen(turned(shown, yaw) + servo._goals.mean(axis=0), servo._goals))
        if servo._chosen:
            break
    assert servo._chosen
    assert not servo.reason


def test_a_loop_that_is_too_small_is_refused_in_words():
    servo = Servo()
    actions = plan(servo, seen(ring(20, 0.03), [[-0.1, 0, 0.05], [0.1, 0, 0.05]]), 70)
    assert "0 of these are as large" in servo.reason
    assert not np.any(actions)


@pytest.mark.parametrize("goal", [0, "left", [1, 2], [0, 0, np.nan]])
def test_a_goal_that_is_none_is_refused(goal):
    with pytest.raises((TypeError, ValueError), match="goal"):
        Servo(goal)


@pytest.fixture(scope="module")
def hanging():
    return hang("apron-hook", garment=COARSE, seed=1)


def test_it_hangs_and_the_episode_is_like_any_other(hanging, tmp_path):
    assert hanging.success
    assert hanging.linked == ("neck",)
    assert hanging.reason == "it hangs"
    assert hanging.seconds_a_decision > 0
    episode = load_episode(save_episode(tmp_path / "e.npz", hanging.episode))
    assert len(episode) == hanging.steps + 1
    assert episode.success
    assert episode.held[0]
    assert not episode.held[-1]
    assert episode.physics["controller"] == "Servo"


def test_a_small_loop_on_a_large_cloth_gets_more_points():
    sheet = WARDROBE["sheet"](spacing=0.035, width=0.7, height=0.6, hole_radius=0.06)
    mine = dataclasses.replace(sheet, name="mine")
    assert hang(garment=mine, max_steps=1).episode.observed.shape[1] > 256
    assert hang(garment=mine, max_steps=1, n_points=100).episode.observed.shape[1] == 100


def test_too_few_frames_and_models_are_told_of():
    late = hang("apron-hook", garment=COARSE, seed=1, max_steps=2)
    assert (late.success, late.reason, late.steps) == (False, "it was not let go in time", 2)
    elsewhere = hang("apron-hook", garment=COARSE, seed=1, max_steps=2, place=(0.3, 0.1, 0.0, 90.0), start="anywhere")
    np.testing.assert_allclose(elsewhere.episode.centre_line, Placed(Hook(), 0.3, 0.1, yaw=90.0).centre_line, atol=1e-6)
    assert not np.allclose(elsewhere.episode.points[0], late.episode.points[0], atol=0.1)
    with pytest.raises((TypeError, ValueError), match="wind"):
        hang("apron-hook", garment=COARSE, wind=3)
    with pytest.raises(TypeError, match="model"):
        hang(model=CHECKPOINTS / "mlp.safetensors")


def test_a_plan_hangs_it_sooner(hanging):
    planned = hang("apron-hook", garment=COARSE, seed=1, model="carry")
    assert (planned.success, planned.linked) == (True, ("neck",))
    assert planned.steps < hanging.steps
    assert planned.episode.physics["controller"] == "Planner"


def test_a_motion_model_can_be_planned_with():
    result = hang("apron-hook", garment=COARSE, seed=1, model=CHECKPOINTS / "motion.safetensors", max_steps=12)
    assert result.steps == 12
    assert np.ptp(result.episode.grippers, axis=0).max() > 0.02


def test_what_cannot_be_reached_is_thrown(hanging):
    thrown = hang("apron-hook", garment=COARSE, seed=1, model="carry", fence=0.15)
    assert (thrown.success, thrown.linked) == (True, ("neck",))
    assert thrown.episode.physics["controller"] == "ThrowController"
    ahead = thrown.episode.centre_line[-1] - thrown.episode.grippers  # the arm points along -y
    assert ahead[..., 1].min() > 0.12
    assert not hang("apron-hook", garment=COARSE, seed=1, fence=0.15, max_steps=hanging.steps + 20).success


def test_a_throw_ends_at_the_fence_and_what_is_let_go_flies():
    hands = np.array([[-0.1, -0.9, 1.3], [0.1, -0.9, 1.3]])
    loop, tip = ring(60, centre=(0, -0.9, 1.13)), Hook().centre_line[-1]
    thrower, observation = ThrowController(Carried(), fence=0.2), seen(loop, hands)
    plan(thrower, observation)
    arm, asked = Arm.of(observation["target"]), np.array([0.9, 0.6, 0.02])
    goals, last = thrower._run(asked, arm, hands)
    assert (tip - goals[last - 1])[:, 1].min() == pytest.approx(0.2)
    held = thrower._moved(goals[None], loop)
    way = thrower._flight(held, np.array([last]))[0] - held[0, last - 1]
    time = 0.036 * np.array([4, 6, 8, 10])
    np.testing.assert_allclose(way[..., 1], np.repeat(time[:, None] * 0.9 * 1.2, 60, axis=1), rtol=0.05)
    up = (held[0, last - 1, 0, 2] - held[0, last - 2, 0, 2]) / 0.036
    np.testing.assert_allclose(way[..., 2], np.repeat((up * time - 4.9 * time**2)[:, None], 60, axis=1), atol=1e-9)
    thrower._goals = hands - [0, 3, 0]  # from far away, too, it ends at the fence, and not before
    goals, last = thrower._run(asked, arm, thrower._goals)
    assert (tip - goals[last - 1])[:, 1].min() == pytest.approx(0.2)


def test_what_is_carried_turns_with_the_grippers():
    forecast, hands = Carried(), np.array([[-0.2, 0.0, 1.0], [0.2, 0.0, 1.0]])
    forecast.reset()
    forecast.observe(ring(), hands)
    plan = np.tile(turned(hands, 90) + [0.5, 0, 0.1], (2, 60, 1, 1))
    places, _ = forecast.move(plan, None, ring())
    assert places.shape == (2, 60, 40, 3)
    np.testing.assert_allclose(places[1, 30], turned(ring(), 90) + [0.5, 0, 0.1], atol=1e-12)


def test_planned_paths_are_no_faster_and_no_harder_than_said():
    observation = seen(ring(60, centre=(0, -0.6, 1.25)), [[-0.1, -0.6, 1.42], [0.1, -0.6, 1.42]])
    actions = np.array(plan(Planner(Carried()), observation, 16))[:, :6]  # the leash is not yet taut
    assert 0.2 < abs(actions).max() <= 0.6
    assert abs(np.diff(actions, axis=0)).max() <= 0.06 + 1e-6


def test_on_an_arm_that_is_drawn_back_the_seat_is_near_its_post():
    """At 0.3 m/s cloth that was let go in the middle lagged behind and slipped over the tip."""
    arm = Arm.of(Hook().centre_line)
    back = arm.drawn_back(-0.01 * arm.out)
    assert np.linalg.norm(back.seat - arm.start) == pytest.approx(0.15 * arm.reach)
    for drift in (0.01 * arm.out, 0.01 * np.cross(arm.out, [0, 0, 1])):
        np.testing.assert_array_equal(arm.drawn_back(drift).seat, arm.seat)


def test_beside_a_target_that_comes_the_way_is_slower():
    """Else the garment is turned round when it is there, and swings through the target's post."""
    planner = Planner(Carried())
    planner.reset(seen(ring(), [[-0.1, 0, 0.2], [0.1, 0, 0.2]]))
    ways = np.zeros((1, 5, 4))
    ways[..., 1] = np.linspace(0.5, 2, 5)
    fast = 0.6 * 0.0432
    for speed, comes in ((0.0, 0.0), (0.01, 0.01), (-0.01, 0.0)):
        planner._drift = np.array([0, -speed, 0])
        moves = np.diff(planner._goals_of(ways, np.zeros(3), np.array([0, -1.0, 0]))[0, 30:40, 0], axis=0)
        np.testing.assert_allclose(moves[:, 1] + speed, fast - 1.6 * comes, rtol=1e-6)


def test_in_a_hurry_a_loop_that_leaves_no_room_is_planned_for():
    narrow = seen(ring(60, 0.06, centre=(0, -0.6, 1.34)), [[-0.1, -0.6, 1.42], [0.1, -0.6, 1.42]])
    for pace, slow in ((0.6, True), (1.0, False)):
        planner = Planner(Carried(), pace=pace)
        plan(planner, narrow)
        assert planner._uses_servo == slow


@pytest.mark.parametrize(
    ("controller", "wrong"),
    [
        (Planner, {"plans": 3}),
        (ThrowController, {"fence": -0.1}),
        (ThrowController, {"fence": 0.1, "frame_time": 0.0}),
    ],
)
def test_wrong_options_of_planners_are_named(controller, wrong):
    with pytest.raises(ValueError, match=[*wrong][-1]):
        controller(Carried(), **wrong)


# What is worn is put on a mannequin.

DUMMY = Placed(Mannequin(), 0.3, -0.2, 0.05, yaw=70.0)


def tube():
    """Rings above each other; the highest is the narrowest."""
    widths = [0.1, *[0.13] * 12]
    return np.concatenate([ring(30, width)[:, [0, 2, 1]] - [0, 0, 0.04 * k] for k, width in enumerate(widths)])


def straps():
    """Two hoops that stand on a gripper each, since nothing here gives way, and a bag behind them."""
    y, z = 0.12 * polygon(24).T
    rings = [np.column_stack([0 * y + side, y - 0.1, z + 0.02]) for side in (-0.2, 0.2)]
    bag = np.stack(np.meshgrid(np.linspace(-0.2, 0.2, 9), [-0.26], np.linspace(-0.4, -0.1, 7)), axis=-1)
    return np.concatenate([*rings, bag.reshape(-1, 3)])


def carried(controller, cloth, place, yaw, gap, frames=400):
    """Cloth (n, 3), seen from between its grippers, each half of which goes with its own; clouds and the last action."""
    half = np.array([[-gap / 2, 0, 0], [gap / 2, 0, 0]])
    hands, side = turned(half, yaw) + place, (cloth[:, 0] > 0).astype(int)
    own, clouds, action = cloth - half[side], [], np.zeros(7)
    for frame in range(frames):
        points = turned(own, angle(np.eye(3)[0], hands[1] - hands[0])) + hands[side]
        clouds.append(points)
        observation = {**seen(points, hands, DUMMY), "rods": rods_of(DUMMY)}
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
    assert "0.30 m" in controller.reason


@pytest.mark.parametrize("kind", [PullOverController, StrapController])
def test_a_hook_wears_nothing(kind):
    observation = {**seen(tube() + [0, 0, 1.4], [[-0.1, 0, 1.4], [0.1, 0, 1.4]]), "rods": rods_of(Hook())}
    controller = kind()
    controller.reset(observation)
    assert not controller.act(observation).any()
    assert "no head" in controller.reason


def test_a_vest_is_put_on_wherever_the_mannequin_stands():
    result = hang("vest-mannequin", seed=3, place="anywhere")
    assert result.success, result.reason
    assert {"neck", "hem"} <= {*result.linked}


# The command.


def test_the_command(hanging, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("topokit.control.hang", lambda *_, **__: hanging)
    out, film = tmp_path / "e.npz", tmp_path / "film.html"
    assert cli.main(["hang", "--task", "apron-hook", "--out", str(out), "--film", str(film), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["linked"] == ["neck"]
    assert load_episode(out).success
    assert "<canvas" in film.read_text()
    failed = dataclasses.replace(hanging, success=False, reason="it was let go, and does not hang")
    monkeypatch.setattr("topokit.control.hang", lambda *_, **__: failed)
    assert cli.main(["hang"]) == 1
    assert "does not hang" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--film", "a.mp4"], "a.mp4"),
        (["--out", "a.txt"], "a.txt"),
        (["--task", "cat-hook"], "cat-hook"),
        (["--loops", "auto"], "--mesh"),
    ],
)
def test_bad_calls_of_hang(options, named, capsys):
    assert cli.main(["hang", *options]) == 2
    assert named in capsys.readouterr().err
