"""Targets, paths, randomisation, processes, and tasks that are hung."""

from __future__ import annotations

import dataclasses
import logging
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pybullet")

from topokit._geometry import turned
from topokit.cli import main
from topokit.io import load_episode, save_episode
from topokit.sim import (
    TASKS,
    WARDROBE,
    Camera,
    DepthNoise,
    Garment,
    GripperPath,
    Hanger,
    Hook,
    Mannequin,
    Randomisation,
    SimulationConfig,
    SimulationError,
    Via,
    World,
    simulate,
    task_for,
)
from topokit.sim._randomisation import PURPOSES
from topokit.sim._tasks import pull_over_head

from conftest import polygon

SHORT = SimulationConfig(frames=4, steps_per_frame=10, settle=0.02)
COARSE = {"apron": 0.05, "tote": 0.05, "mask": 0.018, "sheet": 0.05}


def coarse(name):
    return WARDROBE[name](spacing=COARSE[name])


def ring(centre, normal_axis, radius=0.1):
    """A circle in the plane orthogonal to an axis."""
    return np.insert(polygon(24, radius), normal_axis, 0.0, axis=1) + centre


# What hangs on a target: a loop around it, not one beside it, and not one that lies against it.


def test_hook_holds_what_is_around_it():
    hook = Hook()
    assert hook.holds(ring(hook.seat, 1))  # around the arm
    assert hook.holds(ring(hook.centre_line[-1], 2))  # around the tip: not off yet
    assert hook.holds(ring(hook.seat * [1, 0, 0.5] + [0, hook.distance, 0], 2))  # around the pole
    assert not hook.holds(ring(hook.seat + [0.3, 0, 0], 1))  # beside it
    assert not hook.holds(ring(hook.seat - [0, 0.5, 0], 1))  # before it
    assert not hook.holds(ring(hook.seat + [0.03, 0, 0.13], 0))  # above it, along the arm
    assert not hook.holds(ring(hook.seat + [0.03, 0, 0], 0, 0.3))  # leaning against it


def test_hanger_holds_what_is_around_an_arm():
    hanger = Hanger()
    near, far = hanger.seat, hanger.seat * [1, 0, 1] + [0, 2 * hanger.distance - hanger.seat[1], 0]
    assert hanger.holds(ring(near, 1))
    assert hanger.holds(ring(far, 1))
    assert hanger.holds(ring([0, hanger.distance, hanger.height + hanger.stem / 2], 2))  # around the stem
    assert not hanger.holds(ring(near + [0.15, 0, 0], 1))  # beside the arm
    assert not hanger.holds(ring([0.03, hanger.distance, hanger.height - 0.02], 0, 0.21))  # leaning against both arms
    assert not hanger.holds(ring(near - [0, 0.3, 0], 1))  # before it
    assert not hanger.holds(ring([0, hanger.distance, 0.3], 2))  # below it, around nothing


def test_mannequin_holds_what_is_around_neck_or_shoulder():
    dummy = Mannequin()
    neck = dummy.seat + [0, 0, 0.04]
    assert dummy.holds(ring(neck, 2))
    assert dummy.holds(ring(dummy.seat - [0, 0, 0.4], 2, 0.3))  # a hem
    assert dummy.holds(ring(dummy.shoulder, 0))  # a backpack's strap
    assert dummy.holds(ring(dummy.shoulder * [-1, 1, 1], 0))
    assert not dummy.holds(ring(dummy.head_centre + [0, 0, 0.11], 2))  # a wreath on the crown
    assert not dummy.holds(ring(neck - [0, 0.2, 0], 2, 0.12))  # before the neck
    assert not dummy.holds(ring(dummy.seat - [0, 0.12, 0.2], 1))  # flat on the chest
    assert not dummy.holds(ring(dummy.shoulder + [0.0, -0.2, 0], 0))  # before the shoulder


@pytest.mark.parametrize("target", [Hook(), Hanger(), Mannequin()])
def test_targets_stand_on_the_floor_around_their_centre_line(target):
    line = target.centre_line
    assert line[0, 2] == 0
    assert min(min(a[2], b[2]) for a, b, _ in target.rods) >= 0
    for point in line[1:-1]:  # the centre line runs inside the shape
        gaps = [np.linalg.norm(point - np.clip(_share(point, a, b), 0, 1) * (b - a) - a) - r for a, b, r in target.rods]
        assert min(gaps) < 0
    moved = type(target)(distance=target.distance + 1)
    np.testing.assert_allclose(moved.seat, target.seat + [0, 1, 0])


def _share(point, start, end):
    return (point - start) @ (end - start) / ((end - start) @ (end - start))


@pytest.mark.parametrize(
    ("kind", "sizes", "says"),
    [
        (Hook, {"reach": 0}, "reach"),
        (Hook, {"distance": np.nan}, "distance"),
        (Hanger, {"drop": 0.3}, "steeper"),
        (Mannequin, {"head_height": 0.1}, "head_height"),
        (Mannequin, {"neck_radius": 0.1}, "neck_radius"),
        (Mannequin, {"height": 0.5}, "floor"),
        (Mannequin, {"shoulder_width": 0.3}, "shoulder_width"),
        (Mannequin, {"torso_length": 0.2}, "torso_length"),
    ],
)
def test_bad_targets(kind, sizes, says):
    with pytest.raises(ValueError, match=says):
        kind(**sizes)


# Paths.

SPREAD = np.array([[-0.1, 0, 0], [0.1, 0, 0]])


def test_path_passes_its_places_smoothly_and_rests_where_it_should():
    vias = [
        Via(0.5, [0, 0, 1]),
        Via(1, [0, 0.3, 1.2], 1.5),
        Via(2, [0.1, 0.4, 1], 1.2, rest=True),
        Via(3, [0, 0.5, 0.9]),
    ]
    path = GripperPath(vias, SPREAD, 3.0, 4.0)
    for via in vias:
        np.testing.assert_allclose(path.at(via.time), via.place + via.opening * SPREAD, atol=1e-12)
    times = np.linspace(0, 4, 40001)
    where = path.at(times)
    speed = np.linalg.norm(np.gradient(where, times, axis=0), axis=2)
    acceleration = np.linalg.norm(np.gradient(np.gradient(where, times, axis=0), times, axis=0), axis=2)
    assert speed[(times < 0.499) | (times > 3.001)].max() < 1e-9
    assert speed[np.abs(times - 2) < 1e-3].max() < 1e-4  # rests
    assert speed[np.abs(times - 1) < 1e-3].min() > 0.1  # passes
    assert np.abs(np.diff(acceleration, axis=0)).max() < 0.05  # no jump of force anywhere


def test_a_move_between_two_rests_is_the_minimum_jerk_polynomial():
    path = GripperPath([Via(1, [0, 0, 0]), Via(3, [0, 1, 0])], SPREAD, 3, 3)
    s = np.linspace(0, 1, 11)
    expected = 10 * s**3 - 15 * s**4 + 6 * s**5
    np.testing.assert_allclose(path.at(1 + 2 * s)[:, 0, 1], expected, atol=1e-12)


def test_the_spline_has_less_jerk_than_its_neighbours():
    """Minimum jerk: any other smooth path through the same places has more."""
    vias = [Via(0, [0, 0, 0]), Via(0.8, [0, 0.5, 0.3]), Via(2, [0, 1, 0])]
    times = np.linspace(0, 2, 4001)
    best = GripperPath(vias, SPREAD, 2, 2).at(times)[:, 0]

    def jerk(path):
        for _ in range(3):
            path = np.gradient(path, times, axis=0)
        return (path**2).sum()

    bump = (times * (2 - times)) ** 3 * (times - 0.8)  # keeps places and rests
    for amplitude in (-0.05, 0.05):
        assert jerk(best + amplitude * bump[:, None]) > jerk(best)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"vias": [Via(0, [0, 0, 0])]}, "two places"),
        ({"vias": [Via(1, [0, 0, 0]), Via(1, [0, 0, 1])]}, "increase"),
        ({"vias": [Via(0, [0, 0, 0]), Via(1, [0, 0, np.nan])]}, "finite"),
        ({"vias": [Via(0, [0, 0, 0]), Via(1, [0, 0, 1], 0.0)]}, "more than zero"),
        ({"release": 2.0, "end": 1.0}, "come after the release"),
        ({"spread": np.zeros(3)}, "spread"),
    ],
)
def test_bad_paths(change, says):
    parts = {"vias": [Via(0, [0, 0, 0]), Via(1, [0, 0, 1])], "spread": SPREAD, "release": 1.0, "end": 2.0}
    with pytest.raises(ValueError, match=says):
        GripperPath(**{**parts, **change})


@pytest.mark.parametrize("name", TASKS)
def test_every_path_is_smooth_slow_and_random(name):
    task = TASKS[name]
    garment = task.garment()
    paths = [task.plan(garment, task.target, np.random.default_rng(seed)) for seed in (0, 0, 1)]
    times = np.arange(0, paths[0].end, 0.001)
    first, again, other = (path.at(times) for path in paths)
    assert (first == again).all()
    assert np.abs(first - other).max() > 0.01
    assert np.linalg.norm(np.diff(first, axis=0), axis=2).max() < 0.002  # 2 m/s
    assert paths[0].release == paths[2].release  # all episodes of a task are of one length
    assert paths[0].release >= 1.4
    start = garment.vertices + first[0].mean(axis=0) - garment.vertices[garment.grips].mean(axis=0)
    assert start[:, 2].min() > 0.05  # above the floor
    for a, b, radius in task.target.rods:
        share = np.clip((start - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        assert np.linalg.norm(start - a - share[:, None] * (b - a), axis=1).min() > radius + 0.01  # clear of the target


def test_paths_know_their_target():
    with pytest.raises(TypeError, match="Mannequin"):
        pull_over_head(coarse("apron"), Hook(), np.random.default_rng(0))


# Randomisation.


def test_purposes_do_not_move_each_other():
    draws = {purpose: Randomisation.generator(3, purpose).random() for purpose in PURPOSES}
    assert len(set(draws.values())) == len(PURPOSES)
    cameras = Camera.around(n=2)
    config, garment, moved, drawn = Randomisation().draw(3, SimulationConfig(), coarse("apron"), cameras)
    fixed = Randomisation(mass=None, scale=None, camera_turn=None).draw(3, SimulationConfig(), coarse("apron"), cameras)
    assert fixed[0].mass == 0.3
    assert fixed[0].stiffness == config.stiffness == drawn["stiffness"]
    assert garment.parameters["scale"] == drawn["scale"]
    np.testing.assert_allclose(garment.vertices, drawn["scale"] * coarse("apron").vertices)
    assert fixed[1].parameters == coarse("apron").parameters
    away = [np.linalg.norm(np.subtract(camera.eye, camera.target)) for camera in (*moved, *fixed[2])]
    np.testing.assert_allclose(away[:2], away[2:])


def test_draws_stay_in_their_ranges_and_fill_them():
    ranges = Randomisation(stiffness=(0.5, 0.5))
    drawn = [ranges.draw(seed, SimulationConfig(), coarse("mask"))[3] for seed in range(60)]
    for name, (low, high) in ranges.describe()["ranges"].items():
        if not name.startswith("camera"):
            values = np.array([draw[name] for draw in drawn])
            assert low <= values.min() <= values.max() <= high
            assert np.ptp(values) >= 0.8 * (high - low)


@pytest.mark.parametrize(
    "option", [{"mass": (0.4, 0.2)}, {"mass": 0.3}, {"scale": (0, 1)}, {"camera_turn": (0.0, np.inf)}]
)
def test_bad_ranges(option):
    with pytest.raises(ValueError, match=next(iter(option))):
        Randomisation(**option)


# Episodes.


def test_an_episode_records_how_it_was_made(tmp_path):
    cameras = (Camera(eye=(0, -1.5, 1.3), target=(0, 0, 1.1), noise=DepthNoise()),)
    options = {"seed": 5, "config": SHORT, "randomisation": Randomisation(), "cameras": cameras, "n_observed": 300}
    one, two = (simulate(coarse("apron"), Hanger(height=1.25), **options) for _ in range(2))
    paths = [save_episode(tmp_path / name, episode) for name, episode in (("1.npz", one), ("2.npz", two))]
    assert paths[0].read_bytes() == paths[1].read_bytes()  # in one process, since each run has its own
    episode = load_episode(paths[0])
    assert episode.observed.shape == (4, 300, 3)
    assert (episode.task, episode.target, episode.seed) == ("apron-hanger", "hanger", 5)
    assert episode.physics["target"]["height"] == 1.25
    drawn = episode.physics["randomisation"]["drawn"]
    assert episode.physics["config"]["mass"] == drawn["mass"] != 0.3
    assert episode.observation["cameras"][0]["eye"] == drawn["camera_eyes"][0]
    assert episode.observation["cameras"][0]["noise"] == {**DepthNoise().__dict__}
    other = simulate(coarse("apron"), Hanger(height=1.25), **{**options, "seed": 6})
    assert np.abs(other.actions - one.actions).max() > 0.01


def test_both_ways_to_run_agree_in_a_fresh_process(tmp_path):
    code = (
        "from topokit.sim import *; import sys; import numpy as np\n"
        "config = SimulationConfig(frames=4, steps_per_frame=10, settle=0.02)\n"
        "tote = Garment.tote(spacing=0.05)\n"
        "episode = simulate(tote, config=config, n_observed=50, time_limit=None)\n"
        "again = simulate(tote, config=config, n_observed=50)\n"
        "assert (episode.points == again.points).all() and episode.task == 'tote-hook'\n"
    )
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize("name", ["tote-hook", "apron-hanger", "mask-hook"])
def test_scripted_paths_succeed(name):
    garment, task = coarse(name.split("-")[0]), TASKS[name]
    episode = simulate(garment, task=task, seed=2, n_observed=50)
    assert episode.success
    assert len(episode) >= 76
    assert not task.hangs(episode.points[0], episode.named_loops)
    still = np.linalg.norm(episode.points[-1] - episode.points[-4], axis=1)
    assert still.max() < 0.05
    assert episode.physics["stretch"]["p99"] < 1.3
    assert np.abs(episode.grippers - episode.actions)[episode.held].max() < 0.02


def test_a_strap_is_hung_around_the_neck():
    episode = simulate(coarse("apron"), task="apron-mannequin", seed=0, n_observed=50)
    assert episode.success
    dummy = Mannequin()
    loop = episode.points[-1][episode.loops[0]]
    assert dummy.shoulder_height - 0.2 < loop[:, 2].mean() < dummy.head_centre[2]


def test_what_falls_lies_on_the_floor_and_does_not_hang():
    garment = coarse("sheet")
    with World(garment, np.array([0, -1.0, 0.7]), SimulationConfig()) as world:
        world.add_rods(Hook().rods)
        world.step(garment.vertices[garment.grips] + [0, -1.0, 0.7])
        world.release()
        for _ in range(900):
            world.step(None)
        points = world.vertices()
    assert -0.01 < points[:, 2].min() < 0.03
    assert not TASKS["sheet-hook"].hangs(points, garment.named_loops)


def test_tasks_of_ones_own():
    apron = coarse("apron")
    assert task_for(apron, Hook(height=1.5)).target.height == 1.5
    square = Garment("patch", np.eye(3)[[0, 1, 2]] * 0.1, np.array([[0, 1, 2]]), (), np.array([0, 1]))
    task = task_for(square, Mannequin())
    assert not task.hangs(square.vertices, square.named_loops)
    assert simulate(square, task=task, config=SHORT, n_observed=3).garment == "patch"
    with pytest.raises(ValueError, match="no task 'apron-moon'; there are apron-hook"):
        simulate(task="apron-moon")


def named(garment, *names):
    return dataclasses.replace(garment, name="mine", loop_names=names)


@pytest.mark.parametrize(
    ("target", "names", "asks"),
    [
        (Hook(), ("neck", "hem"), ("neck",)),
        (Hook(), ("edge", "handle"), ("handle",)),
        (Mannequin(), ("hem", "neck"), ("neck", "hem")),
        (Mannequin(), ("strap 1", "strap 2"), ("strap",)),
        (Mannequin(), ("waist", "neck"), ("neck",)),
        (Mannequin(), ("waist", "hole"), ("hole",)),
        (Hanger(), ("waist", "edge"), ()),
    ],
)
def test_what_a_garment_can_be_hung_on_follows_from_the_names_of_its_loops(target, names, asks):
    garment = named(WARDROBE["sheet2"](spacing=0.05), *names)
    task = task_for(garment, target)
    assert task.loops == asks
    task.plan(garment, target, Randomisation.generator(0, "path"))
    elsewhere = dataclasses.replace(garment, name="shirt")  # what it is called does not matter
    assert task_for(elsewhere, target).loops == asks


@pytest.mark.parametrize("name", [name for name in TASKS if name.endswith("-hook")])
def test_the_loop_that_hangs_is_found_by_name_whatever_its_place_in_the_list(name):
    task = TASKS[name]
    garment = task.garment()
    turned = dataclasses.replace(garment, loops=garment.loops[::-1], loop_names=garment.loop_names[::-1])
    if "neck" in garment.loop_names:  # of two handles the first in the list is carried
        paths = [task.plan(one, task.target, Randomisation.generator(0, "path")) for one in (garment, turned)]
        assert (paths[0].at(np.arange(3.0)) == paths[1].at(np.arange(3.0))).all()
    expected = [garment.named_loops[name] for name in garment.loop_names if {name, name[:-2]} & {*task.loops}]
    assert {len(loop) for loop in expected} == {len(loop) for loop in task.wanted(turned.named_loops).values()}


def test_a_garment_without_the_loops_of_a_task_is_refused_before_anything_is_simulated():
    tote = coarse("tote")
    with pytest.raises(ValueError, match=r"^shirt-mannequin asks for the loops neck, hem; the tote has handle: "):
        simulate(tote, task="shirt-mannequin", config=SHORT)
    with pytest.raises(ValueError, match=r"^apron-hook asks for the loops neck; the mine has none"):
        simulate(dataclasses.replace(tote, name="mine", loops=(), loop_names=()), task="apron-hook", config=SHORT)
    with pytest.raises(TypeError, match=r"not str: Garment.from_mesh\('bag.obj'\) makes one of a mesh"):
        simulate("bag.obj", task="tote-hook")
    with pytest.raises(TypeError, match="garment must be a Garment, not int"):
        simulate(3)


def test_names_of_a_strangers_loops_are_stored_with_the_episode(tmp_path):
    mine = named(coarse("apron"), "strap")
    mine = dataclasses.replace(mine, parameters={"scale": 1.0})
    episode = load_episode(save_episode(tmp_path / "e.npz", simulate(mine, Hook(), config=SHORT, n_observed=50)))
    assert list(episode.named_loops) == ["strap"]
    own = simulate(coarse("apron"), config=SHORT, n_observed=50)
    assert list(own.named_loops) == ["neck"]
    assert "loops" not in own.physics  # what the wardrobe's are called is known
    assert list(dataclasses.replace(own, physics={}).named_loops) == ["loop 1"]
    for names, says in ((["neck", "hem"], "1 different names"), (["a", "a"], "1 different"), ([[]], "a list of names")):
        with pytest.raises(ValueError, match=says):
            save_episode(tmp_path / "bad.npz", dataclasses.replace(own, physics={"loops": names}))


def test_a_garment_longer_than_its_target_is_high_is_told_of(caplog):
    apron = coarse("apron")
    with caplog.at_level(logging.WARNING, logger="topokit.sim"):
        simulate(apron, Hook(), config=SHORT, n_observed=50)
        assert not caplog.records
        simulate(apron, Hook(height=0.9), config=SHORT, n_observed=50)
    assert "hangs 0.99 m down from a hook 0.90 m high" in caplog.text


@pytest.mark.parametrize("limit", ["max_stretch", "max_edge_stretch"])
def test_over_stretched_cloth_is_refused(limit):
    """With limits that a garment's own weight exceeds."""
    config = SimulationConfig(frames=4, steps_per_frame=50, **{limit: 1.001})
    with pytest.raises(SimulationError, match=rf"settling: .*{limit} is 1.001.*\[\d+, \d+\], 1\.\d+ times"):
        simulate(coarse("apron"), config=config, n_observed=50)


def test_errors_of_the_process_are_ours():
    blind = (Camera(eye=(0, 5, 1), target=(0, 9, 1)),)
    with pytest.raises(ValueError, match="no cloth is in view"):
        simulate(coarse("apron"), config=SHORT, cameras=blind)
    with pytest.raises(ValueError, match="time_limit"):
        simulate(coarse("apron"), n_observed=50, time_limit=0)


# The command.


def test_simulate_help_lists_every_task(capsys):
    assert main(["simulate", "--help"]) == 0
    listed = capsys.readouterr().out.split("There are")[1].split("With --mesh")[0]
    others, mannequin = listed.split("-mannequin:")
    tasks = {f"{name}-mannequin" for name in mannequin.split()}
    tasks |= {f"{name}-{target}" for name in others.split(":")[1].split() for target in ("hook", "hanger")}
    assert tasks == set(TASKS)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--task", "apron-moon"], "there is no such task; there are apron-hook, "),
        (["--noise"], "one at least with --noise"),
        (["--cameras", "-1"], "--cameras -1"),
        (["--observed", "100000"], "n_observed must be 1 to"),
        (["--time-limit", "-1"], "time_limit"),
        (["--task", "hook"], "there is no such task"),  # of what?
        (["--loops", "auto"], "--loops is of a mesh: give --mesh FILE"),
        (["--mesh", "nowhere.obj"], "nowhere.obj: there is no such file"),
    ],
)
def test_bad_calls_of_simulate(arguments, says, tmp_path, capsys):
    out = tmp_path / "episode.npz"
    assert main(["simulate", *arguments, "--out", str(out)]) == 2
    assert says in capsys.readouterr().err
    assert not out.exists()


def test_data_small_is_what_its_commands_record():
    """Here only that simulate() still plans what was recorded; `python data_small/record.py` compares the bytes."""
    episode = load_episode(Path(__file__).parent.parent / "data_small" / "apron_hook_1.npz")
    task = TASKS["apron-hook"]
    path = task.plan(task.garment(), task.target, Randomisation.generator(1, "path"))
    np.testing.assert_allclose(path.at(episode.times), episode.actions, atol=1e-4)
    assert episode.task == "apron-hook"


def test_a_small_garment_is_observed_whole_by_default():
    mask = coarse("mask")
    assert len(mask.vertices) < 500
    episode = simulate(mask, config=SHORT)
    assert episode.observed.shape == episode.points.shape


def test_a_garment_whose_strap_looks_aside_is_turned_so_that_the_arm_goes_through():
    bag = dataclasses.replace(WARDROBE["tote"](), name="found", vertices=turned(WARDROBE["tote"]().vertices, 80))
    task = task_for(bag, Hook())
    path = task.plan(bag, Hook(), np.random.default_rng(0))
    assert {round(via.yaw) for via in path.vias} == {-80}
    hands = path.at(0.0)
    assert abs(hands[0, 1] - hands[1, 1]) < 0.02 < abs(hands[0, 0] - hands[1, 0])  # along x, as of the tote itself
    straight = dataclasses.replace(WARDROBE["tote"](), name="found")
    assert not any(via.yaw for via in task_for(straight, Hook()).plan(straight, Hook(), np.random.default_rng(0)).vias)


def test_a_target_is_as_high_as_a_long_garment_needs(caplog):
    long = dataclasses.replace(WARDROBE["apron"](), vertices=2 * WARDROBE["apron"]().vertices, name="found")
    hook = Hook().raised_for(long)
    assert hook.seat[2] > long.vertices[long.loops[0], 2].max() - long.vertices[:, 2].min()
    assert "so long" in caplog.text
    assert Hook().raised_for(WARDROBE["apron"]()) == Hook()
    assert Mannequin().raised_for(long) == Mannequin()
