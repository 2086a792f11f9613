"""Targets, paths on and off their script, ranges that are drawn, and the tasks of garments."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

pytest.importorskip("pybullet")

from topokit._geometry import turned
from topokit.io import load_episode
from topokit.sim import (
    TASKS,
    WARDROBE,
    Garment,
    Hanger,
    Hook,
    Mannequin,
    Randomisation,
    Task,
)
from topokit.sim._path import GripperPath, Via
from topokit.sim._surface import EdgeGraph
from topokit.sim._targets import gap

from conftest import DATA, polygon

SPREAD = np.array([[-0.1, 0, 0], [0.1, 0, 0]])


def coarse(name: str, spacing: float = 0.05) -> Garment:
    return WARDROBE[name](spacing=spacing)


def ring(centre: np.ndarray, normal_axis: int, radius: float = 0.1) -> np.ndarray:
    """A circle in the plane orthogonal to an axis."""
    return np.insert(polygon(24, radius), normal_axis, 0.0, axis=1) + centre


# Targets: a loop around one hangs, a loop beside it or against it does not.

HOOK, HANGER, DUMMY = Hook(), Hanger(), Mannequin()
HOLDS = [
    (HOOK, "around the arm", ring(HOOK.seat, 1), True),
    (HOOK, "around the tip: not off yet", ring(HOOK.centre_line[-1], 2), True),
    (HOOK, "around the pole", ring(HOOK.seat * [1, 0, 0.5] + [0, HOOK.distance, 0], 2), True),
    (HOOK, "beside it", ring(HOOK.seat + [0.3, 0, 0], 1), False),
    (HOOK, "leaning against it", ring(HOOK.seat + [0.03, 0, 0], 0, 0.3), False),
    (HANGER, "around the near arm", ring(HANGER.seat, 1), True),
    (HANGER, "around the far arm", ring(HANGER.seat + [0, 2 * (HANGER.distance - HANGER.seat[1]), 0], 1), True),
    (HANGER, "around the stem", ring([0, HANGER.distance, HANGER.height + HANGER.stem / 2], 2), True),
    (HANGER, "beside the arm", ring(HANGER.seat + [0.15, 0, 0], 1), False),
    (HANGER, "leaning against both arms", ring([0.03, HANGER.distance, HANGER.height - 0.02], 0, 0.21), False),
    (DUMMY, "around the neck", ring(DUMMY.seat + [0, 0, 0.04], 2), True),
    (DUMMY, "a hem", ring(DUMMY.seat - [0, 0, 0.4], 2, 0.3), True),
    (DUMMY, "a strap of a backpack", ring(DUMMY.shoulders[0], 0), True),
    (DUMMY, "the other strap", ring(DUMMY.shoulders[1], 0), True),
    (DUMMY, "a wreath on the crown", ring(DUMMY.head_centre + [0, 0, 0.11], 2), False),
    (DUMMY, "flat on the chest", ring(DUMMY.seat - [0, 0.12, 0.2], 1), False),
    (DUMMY, "before the shoulder", ring(DUMMY.shoulders[0] + [0.0, -0.2, 0], 0), False),
]


def test_a_target_holds_what_is_around_it():
    for target, where, loop, holds in HOLDS:
        assert target.holds(loop) == holds, (target, where)


@pytest.mark.parametrize("target", [Hook(), Hanger(), Mannequin()])
def test_targets_stand_on_the_floor_around_their_centre_line(target):
    assert target.centre_line[0, 2] == 0
    assert min(min(a[2], b[2]) for a, b, _ in target.rods) >= 0
    assert all(gap(point[None], target) < 0 for point in target.centre_line[1:-1])
    moved = type(target)(distance=target.distance + 1)
    np.testing.assert_allclose(moved.seat, target.seat + [0, 1, 0])


@pytest.mark.parametrize("target", [Hook(distance=-0.2), Hanger(distance=0.0), Mannequin()])
def test_what_a_target_holds_it_holds_elsewhere(target):
    there = dataclasses.replace(target, place=(0.4, -0.3, 0.1), yaw=130.0)

    def moved(places):
        return turned(places, 130.0) + [0.4, -0.3, 0.1]

    np.testing.assert_allclose(there.seat, moved(target.seat), atol=1e-12)
    np.testing.assert_allclose(there.centre_line, moved(target.centre_line), atol=1e-12)
    for (a, b, radius), (c, d, thickness) in zip(target.rods, there.rods, strict=True):
        np.testing.assert_allclose([c, d], moved([a, b]), atol=1e-12)
        assert radius == thickness
    beside = target.seat + [0, 0.04, 0.01]
    loops = [ring(beside, 1), ring(beside, 2, 0.13), ring(beside - [0, 0.6, 0], 1)]
    assert [target.holds(loop) for loop in loops] == [there.holds(moved(loop)) for loop in loops]
    assert (there.lowest, there.name) == (pytest.approx(target.lowest + 0.1), target.name)


# Paths.


def test_a_move_between_two_rests_is_the_minimum_jerk_polynomial():
    path = GripperPath([Via(1, [0, 0, 0]), Via(3, [0, 1, 0])], SPREAD, 3, 3)
    s = np.linspace(0, 1, 11)
    expected = 10 * s**3 - 15 * s**4 + 6 * s**5
    np.testing.assert_allclose(path.at(1 + 2 * s)[:, 0, 1], expected, atol=1e-12)


@pytest.mark.parametrize("name", TASKS)
def test_every_path_is_smooth_slow_random_and_clear_of_the_target(name):
    task = TASKS[name]
    garment = task.garment()
    paths = [task.plan(garment, task.target, np.random.default_rng(seed)) for seed in (0, 0, 1)]
    times = np.arange(0, paths[0].end, 0.001)
    first, again, other = (path.at(times) for path in paths)
    assert (first == again).all()
    assert np.abs(first - other).max() > 0.01
    assert np.linalg.norm(np.diff(first, axis=0), axis=2).max() < 0.002  # 2 m/s
    assert paths[0].release == paths[2].release >= 1.4  # all episodes of a task are of one length
    start = garment.vertices + first[0].mean(axis=0) - garment.vertices[garment.grips].mean(axis=0)
    assert start[:, 2].min() > 0.05  # above the floor
    assert gap(start, task.target) > 0.01


# Off the script.


def scripts(count):
    """Tasks with a script and the same script changed."""
    names = [name for name in TASKS if name.startswith(("tote-", "sheet2-", "backpack-"))]
    for i in range(count):
        task = TASKS[names[i % len(names)]]
        garment = task.garment()
        script = task.path(garment, task.target, Randomisation.generator(i, "path"))
        left = task.off_script(Randomisation.generator(i, "script"))
        yield task, garment, script, left.path(garment, task.target, Randomisation.generator(i, "path"))


def test_off_script_plans_stay_in_their_bounds():
    seen = set()
    for seed, (task, garment, script, path) in enumerate(scripts(80)):
        times = np.arange(0, path.end, 0.01)
        where = path.at(times)
        assert path.release <= path.end <= max(4.5, script.end)
        assert np.abs(where - task.target.seat).max() < 2.2
        assert np.linalg.norm(np.diff(where, axis=0), axis=2).max() < 0.045  # 4.5 m/s
        assert path.drawn["pace"] <= 1.4
        along_cloth = EdgeGraph(garment.vertices, garment.edges).distances(garment.grips)[0, 1]
        assert path.widest < max(1.025 * along_cloth, script.widest + 1e-3)
        start = turned(garment.vertices, path.table["yaw"][0])
        start = start + where[0].mean(axis=0) - start[garment.grips].mean(axis=0)
        assert start[:, 2].min() > 0.05
        if path.drawn.get("elsewhere"):
            assert gap(start, task.target) > 0.3
        assert np.abs(where - script.at(times)).max() > 0.005
        left = task.off_script(Randomisation.generator(seed, "script"))
        again = left.path(garment, task.target, Randomisation.generator(seed, "path"))
        assert (again.at(times) == where).all()
        last = path.table["time"][-1]
        seen |= {*path.drawn}
        seen |= {"never"} if path.release == path.end else set()
        seen |= {"early"} if path.release < last else set()
        seen |= {"late"} if path.release > last + 0.1 else set()
    changes = {"wander", "push", "miss", "turn", "openings", "detour", "stop", "elsewhere", "pace", "release"}
    assert seen >= {*changes, "never", "early", "late"}


# Tasks.


def test_a_garment_of_ones_own_needs_its_loops():
    mine = dataclasses.replace(coarse("sheet2"), name="mine")
    assert Task.of(mine, Hook(), ("hole 2",)).loops == ("hole 2",)
    assert Task.of(dataclasses.replace(coarse("tote"), name="mine"), Hanger()).loops == ("handle",)
    named = Task.of(coarse("shirt"), Mannequin(yaw=20.0))
    assert (named.loops, named.all_loops, named.target.yaw) == (("neck", "hem"), True, 20.0)
    for target, loops in ((Hook(), ()), (Mannequin(), ("hole 1",))):
        with pytest.raises(ValueError, match="mine"):
            Task.of(mine, target, loops)


def test_the_loop_that_is_named_is_carried():
    sheet = dataclasses.replace(coarse("sheet2"), name="mine")
    paths = [Task.of(sheet, Hook(), (name,)).path(sheet, Hook(), np.random.default_rng(0)) for name in sheet.loop_names]
    apart = paths[0].at(2.35).mean(axis=0) - paths[1].at(2.35).mean(axis=0)
    np.testing.assert_allclose(apart, [0.26, 0, 0], atol=0.01)  # the holes are so far apart


def test_data_small_is_what_its_commands_record():
    """Here only that simulate() still plans what was recorded; `python data_small/record.py` compares the bytes."""
    episode = load_episode(DATA / "apron_hook_1.npz")
    task = TASKS["apron-hook"]
    path = task.plan(task.garment(), task.target, Randomisation.generator(1, "path"))
    np.testing.assert_allclose(path.at(episode.times), episode.actions, atol=1e-4)
    assert episode.task == "apron-hook"
