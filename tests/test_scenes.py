"""Scenes that differ: targets elsewhere, paths that turn, plans off their script, garments of other sizes."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pybullet")

from topokit._config import load
from topokit._geometry import turned
from topokit.data import DatasetConfig, make_episode
from topokit.data._recipe import _scene
from topokit.data._sizes import MOST, varied_garment, varied_target
from topokit.sim import (
    TASKS,
    WARDROBE,
    Garment,
    GripperPath,
    HangEnv,
    Hanger,
    Hook,
    Mannequin,
    Placed,
    Randomisation,
    SimulationConfig,
    Target,
    Via,
    off_script,
    simulate,
    task_for,
)
from topokit.sim._surface import EdgeGraph
from topokit.sim._targets import Moving, gap
from topokit.sim._tasks import planned

from conftest import polygon

SHORT = SimulationConfig(frames=4, steps_per_frame=10, settle=0.02)
SPREAD = np.array([[-0.1, 0, 0], [0.1, 0, 0]])
MOTION = load(DatasetConfig, Path(__file__).parent.parent / "book" / "datasets" / "motion.json")
PLACED = {"x": 0.4, "y": -0.3, "yaw": 130.0}


def coarse(name, spacing=0.05):
    return WARDROBE[name](spacing=spacing)


# Yaw.


def test_grippers_turn_with_the_yaw_of_a_path():
    vias = [Via(0, [0, 0, 1], yaw=90), Via(1, [0, 0, 1], 2.0, yaw=0), Via(2, [0, 0, 1], yaw=-90)]
    path = GripperPath(vias, SPREAD, 2.0, 2.0)
    np.testing.assert_allclose(path.at(0), [[0, -0.1, 1], [0, 0.1, 1]], atol=1e-12)  # x went towards y
    np.testing.assert_allclose(path.at(1), [[-0.2, 0, 1], [0.2, 0, 1]], atol=1e-12)
    between = path.at(0.5)
    assert (between[1, :2] > 0.03).all()
    assert np.linalg.norm(np.diff(between, axis=0)) > 0.2  # turned, not drawn together


def test_a_path_without_yaw_is_what_it_was():
    vias = [Via(0, [0, 0, 1]), Via(1, [0.3, 0.1, 1], 1.5), Via(2, [1, 0, 1])]
    path = GripperPath(vias, SPREAD, 2.0, 2.0)
    times = np.linspace(0, 2, 50)
    one, other = np.moveaxis(path.at(times), 1, 0)
    np.testing.assert_array_equal(one[:, 1:], other[:, 1:])  # to the last bit: nothing was turned
    np.testing.assert_allclose(path.moved((0, 0, 0), 90).at(times), turned(path.at(times), 90), atol=1e-12)


@pytest.mark.parametrize("vias", [[Via(0, [0, 0]), Via(1, [0, 0])], [Via(0, [0, 0, 0], yaw=np.nan), Via(1, [0, 0, 1])]])
def test_a_wrong_via_is_refused(vias):
    with pytest.raises(ValueError, match="vias must be finite numbers"):
        GripperPath(vias, SPREAD, 1.0, 1.0)


def test_the_garment_starts_turned():
    def plan(yaw):
        return lambda *_: GripperPath([Via(0, [0, -0.5, 1.2], yaw=yaw), Via(1, [0, 0, 1.2], yaw=yaw)], SPREAD, 1.0, 1.0)

    tote, task = coarse("tote"), TASKS["tote-hook"]
    first = [simulate(tote, task=dataclasses.replace(task, plan=plan(yaw)), config=SHORT).points[0] for yaw in (0, 90)]
    middle = np.array([0, -0.5, 0])
    np.testing.assert_allclose(first[1], turned(first[0] - middle, 90) + middle, atol=2e-3)
    assert np.ptp(first[1][:, 1]) > 0.3 > np.ptp(first[0][:, 1])


# Targets anywhere.


def ring(centre, normal_axis, radius=0.1):
    return np.insert(polygon(24, radius), normal_axis, 0.0, axis=1) + centre


@pytest.mark.parametrize("target", [Hook(distance=-0.2), Hanger(distance=0.0), Mannequin()])
def test_what_a_target_holds_it_holds_elsewhere(target):
    there = Placed(target, z=0.1, **PLACED)

    def moved(places):
        return turned(places, 130.0) + [0.4, -0.3, 0.1]

    np.testing.assert_allclose(there.seat, moved(target.seat), atol=1e-12)
    np.testing.assert_allclose(there.centre_line, moved(target.centre_line), atol=1e-12)
    for (a, b, radius), (c, d, thick) in zip(target.rods, there.rods, strict=True):
        np.testing.assert_allclose([c, d], moved([a, b]), atol=1e-12)
        assert radius == thick
    beside = target.seat + [0, 0.04, 0.01]
    loops = [ring(beside, 1), ring(beside, 2, 0.13), ring(beside - [0, 0.6, 0], 1)]
    held = [target.holds(loop) for loop in loops]
    assert held == [there.holds(moved(loop)) for loop in loops]
    assert any(held)
    assert not held[2]
    assert (there.lowest, there.name) == (pytest.approx(target.lowest + 0.1), target.name)
    described = there.describe()
    assert described["yaw"] == 130.0
    np.testing.assert_allclose(described["position"], moved([0, target.distance, 0]), atol=1e-12)
    back = Placed(Placed(target, yaw=50), yaw=-50.0, x=1.0)
    np.testing.assert_allclose(back.seat, target.seat + [1, 0, 0], atol=1e-12)


def test_a_task_knows_what_was_placed():
    shirt = coarse("shirt")
    assert task_for(shirt, Placed(Mannequin(), yaw=20)).loops == ("neck", "hem")
    with pytest.raises(ValueError, match="yaw"):
        Placed(Hook(), yaw=np.nan)
    with pytest.raises(ValueError, match="'distance'"):
        Placed(Hook(), distance=1.0)


class Post(Target):
    """A target of one's own; its numbers are what it likes."""

    name = "post"
    centre_line = np.array([[0, 0, 0], [0, 0, -1.0], [-1.0, 0, 1]])
    rods = ((centre_line[1], centre_line[2], 0.02),)
    seat = np.array([-0.5, 0, 0.5])


def test_targets_of_ones_own_are_placed_too():
    there = Placed(Post(distance=-3.0), x=1.0)
    np.testing.assert_allclose(there.seat, [0.5, 0, 0.5])
    assert there.name == "post"


def test_an_episode_elsewhere_is_the_same_moved():
    tote, options = coarse("tote"), {"task": "tote-hook", "seed": 3, "config": SHORT, "n_observed": 30}
    here, there = simulate(tote, **options), simulate(tote, Placed(Hook(), **PLACED), **options)
    for name in ("points", "grippers", "actions", "centre_line"):
        moved = turned(getattr(here, name), 130.0) + [0.4, -0.3, 0]
        np.testing.assert_allclose(getattr(there, name), moved, atol=1e-4)
    assert there.physics["target"]["yaw"] == 130.0
    assert there.target == "hook"
    task, end = TASKS["tote-hook"], here.points[-1] + Hook().seat - here.points[-1][tote.loops[0]].mean(axis=0)
    end = end + [0, 0, 0.05]
    elsewhere = turned(end, 130.0) + [0.4, -0.3, 0]
    assert task.hangs(end, tote.named_loops)
    assert task.hangs(elsewhere, tote.named_loops, Placed(Hook(), **PLACED))
    assert not task.hangs(end, tote.named_loops, Placed(Hook(), **PLACED))


def test_the_environment_is_elsewhere_too():
    gymnasium = pytest.importorskip("gymnasium")
    config = SimulationConfig(self_collision=False, steps_per_frame=10, settle=0.02)
    seen = []
    for target in (Hook(), Placed(Hook(), **PLACED)):
        options = {"garment": coarse("tote"), "target": target, "config": config, "n_points": 30}
        env = gymnasium.make("topokit/HangToteHook-v1", place=None, **options).unwrapped
        seen.append(env.reset(seed=1)[0])
        env.step(env.scripted_action())
        env.close()
    for name in ("points", "grippers", "target"):
        np.testing.assert_allclose(seen[1][name], turned(seen[0][name], 130.0) + [0.4, -0.3, 0], atol=1e-3)


# Plans off their script.


def scripts(count):
    names = [name for name in TASKS if name.startswith(("tote-", "sheet2-", "backpack-"))]
    garments = {name: TASKS[name].garment() for name in names[:count]}
    for i in range(count):
        task, garment = TASKS[names[i % len(names)]], garments[names[i % len(names)]]
        script = task.plan(garment, task.target, Randomisation.generator(i, "path"))
        yield task, garment, script, off_script(script, garment, task.target, Randomisation.generator(i, "script"))


def test_off_script_plans_stay_in_their_bounds():
    seen = set()
    for task, garment, script, path in scripts(80):
        times = np.arange(0, path.end, 0.01)
        where = path.at(times)
        assert path.release <= path.end <= max(GripperPath.LONGEST, script.end)
        assert np.abs(where - task.target.seat).max() < 2.2
        assert np.linalg.norm(np.diff(where, axis=0), axis=2).max() < 0.045  # 4.5 m/s
        assert path.drawn["pace"] <= 1.4
        way = EdgeGraph(garment.vertices, garment.edges).distances(garment.grips)[0, 1]
        widest = np.linalg.norm(script.at(times)[:, 0] - script.at(times)[:, 1], axis=1).max()
        assert np.linalg.norm(where[:, 0] - where[:, 1], axis=1).max() < max(1.025 * way, widest + 1e-3)
        start = turned(garment.vertices, path.vias[0].yaw)
        start = start + where[0].mean(axis=0) - start[garment.grips].mean(axis=0)
        assert start[:, 2].min() > 0.05
        if path.drawn.get("elsewhere"):
            assert gap(start, task.target) > 0.3
        seen |= {*path.drawn, *(["never"] if path.release == path.end else [])}
        seen |= (
            {"early"}
            if path.release < path.vias[-1].time
            else {"late"}
            if path.release > path.vias[-1].time + 0.1
            else set()
        )
        assert np.abs(where - script.at(times)).max() > 0.005
    changes = {"wander", "push", "miss", "turn", "openings", "detour", "stop", "elsewhere", "pace", "release"}
    assert seen >= {*changes, "never", "early", "late"}


def test_off_script_plans_repeat_and_differ():
    (*_, one), *_, (*_, other) = scripts(4)
    (*_, again), *_ = scripts(1)
    times = np.linspace(0, 3, 40)
    assert (one.at(times) == again.at(times)).all()
    assert one.drawn == again.drawn
    assert one.drawn != other.drawn


def test_the_way_between_the_grips_binds_the_openings():
    """A sheet is held by its corners: no opening can be more than 1.02, where a draw of 1.4 would tear it."""
    task = TASKS["sheet-hook"]
    garment = task.garment()
    drawn = []
    for i in range(40):
        script = task.plan(garment, task.target, Randomisation.generator(i, "path"))
        path = off_script(script, garment, task.target, Randomisation.generator(i, "script"))
        where = path.at(np.arange(0, path.end, 0.01))
        drawn.append(np.linalg.norm(where[:, 0] - where[:, 1], axis=1).max() / 0.6)
    assert 1.0 < max(drawn) < 1.03


# Sizes, and the configuration that draws all this.


@pytest.mark.parametrize("name", ["tote2", "mask", "sheet"])
def test_sizes_vary_within_room_and_repeat(name):
    own = WARDROBE[name]()
    drawn = [varied_garment(WARDROBE[name], own, 0.35, np.random.default_rng(seed)) for seed in (0, 0, 1, 2)]
    assert drawn[0].parameters == drawn[1].parameters != drawn[2].parameters
    assert (drawn[0].vertices == drawn[1].vertices).all()
    for garment in drawn:
        for size, value in garment.parameters.items():
            assert 1 / 1.36 < value / own.parameters[size] < 1.36
        assert 0.8 * len(own.vertices) < len(garment.vertices) <= MOST * len(own.vertices)
        assert garment.loop_names == own.loop_names


def test_a_garment_that_fits_in_no_size_keeps_its_own(monkeypatch):
    own, asked = WARDROBE["sheet"](spacing=0.06), []

    def refuse(**sizes):
        asked.append(sizes)
        raise ValueError("no")

    assert varied_garment(refuse, own, 0.35, np.random.default_rng(0)) is own
    assert len(asked) == 50
    make = WARDROBE["sheet"]
    short = varied_garment(make, own, 0.35, np.random.default_rng(0), own.hangs_down * 0.9)
    assert short.hangs_down < own.hangs_down * 0.9


def test_targets_vary_and_do_not_get_thin():
    drawn = [
        varied_target(target(), 0.2, Randomisation.generator(i, "sizes"))
        for i in range(30)
        for target in (Hook, Hanger, Mannequin)
    ]
    hooks = drawn[::3]
    assert all(0.02 <= hook.radius <= 0.024 + 1e-9 and 1.0 <= hook.height <= 1.44 for hook in hooks)
    assert len({hook.height for hook in hooks}) == 30
    assert all(target.distance == 0.3 for target in drawn)


def ribbon(*, length: float = 1.0, spacing: float = 0.1) -> Garment:
    """A strip whose vertices grow faster with its length than its spacing makes up for."""
    n = max(3, round(12 * length**4 / (10 * spacing)))
    x, i = np.linspace(0, length, n), np.arange(n - 1)
    vertices = np.concatenate([np.column_stack([x, 0 * x, 0 * x]), np.column_stack([x, 0 * x, 0 * x - 0.1])])
    faces = np.concatenate([np.column_stack([i, i + 1, i + n]), np.column_stack([i + 1, i + 1 + n, i + n])])
    border = np.concatenate([np.arange(n), np.arange(2 * n - 1, n - 1, -1)])
    return Garment(
        "ribbon",
        vertices,
        faces,
        (border,),
        np.array([0, n - 1]),
        {"length": length, "spacing": spacing},
        (),
        ("edge",),
    )


def test_varied_garments_have_no_more_vertices_than_allowed():
    own, crowded = ribbon(), 0
    for seed in range(200):
        garment = varied_garment(ribbon, own, 0.5, np.random.default_rng(seed))
        for name in ("vertices", "faces"):
            assert len(getattr(garment, name)) <= MOST * len(getattr(own, name))
        assert len(garment.loops[0]) <= MOST * len(own.loops[0])
        length = np.exp(np.log(1.5) * np.random.default_rng(seed).uniform(-1, 1, 1)[0])
        crowded += garment.parameters["length"] != pytest.approx(length)
    assert crowded > 20  # were too many at first, and drawn again


SMALL = {"mask": {"spacing": 0.03}}


def test_scenes_repeat_and_each_draw_leaves_the_others():
    config = dataclasses.replace(MOTION, tasks={"mask-hook": 1.0}, sizes=SMALL)
    fixed = dataclasses.replace(config, vary=0.0)
    places, off = [], 0
    for i in range(60):
        name, seed = fixed.draw(0, i)
        task, garment, target = _scene(fixed, name, seed)
        off += bool(planned(task, garment, target, Randomisation.generator(seed, "path")).drawn)
        places.append([target.x, target.y, target.yaw / 360])
        assert target.target == Hook()
    for i in range(3):
        name, seed = config.draw(0, i)
        one, again = _scene(config, name, seed), _scene(config, name, seed)
        assert one[2] == again[2]
        assert one[1].parameters == again[1].parameters
        paths = [
            planned(task, garment, target, Randomisation.generator(seed, "path"))
            for task, garment, target in (one, again)
        ]
        assert (paths[0].at(1.0) == paths[1].at(1.0)).all()
        assert [one[2].x, one[2].y, one[2].yaw / 360] == places[i]  # sizes do not move places
    spread = np.ptp(places, axis=0)
    assert ((spread > 0.85) & (spread <= 1.0)).all()
    assert abs(off / 60 - 0.6) < 0.2


def test_an_episode_of_version_two_records_what_was_drawn():
    config = dataclasses.replace(
        MOTION, tasks={"mask-hook": 1.0}, sizes=SMALL, simulation=SHORT, n_observed=20, off_script=1.0
    )
    episode = make_episode(config, 0, 0)
    assert episode.physics["garment"]["width"] != 0.18
    assert episode.physics["target"]["height"] != 1.2
    assert episode.physics["target"]["yaw"] != 0
    assert episode.physics["path"]["pace"] > 0
    assert (episode.garment, episode.task) == ("mask", "mask-hook")


def test_version_one_says_what_it_said():
    """Nothing of version 2 is in it, and its episodes are drawn and their scenes made as they were."""
    config = DatasetConfig()
    assert not {"off_script", "places", "vary"} & {*config.to_json()}
    assert [config.draw(3, i) for i in (0, 9)] == [
        ("sheet-hanger", 3492691328359077705),
        ("apron2-mannequin", 7155809240061363837),
    ]
    task, garment, target = _scene(config, *config.draw(3, 0))
    assert task is TASKS["sheet-hanger"]
    assert target is task.target
    assert garment.parameters == task.garment().parameters


def test_a_target_that_moves_takes_what_hangs_on_it_along():
    config = SimulationConfig(dt=0.002, steps_per_frame=18, frames=118, settle=0.3, self_collision=False)
    way = Moving(Hook(), x=0.12, start=2.9, seconds=1.0)
    script = TASKS["sheet-hook"]
    early = dataclasses.replace(
        script, plan=lambda *scene: script.plan(*scene).moved([-0.12, 0, 0], 0)
    )  # where it begins
    episode = simulate(coarse("sheet"), way, task=early, seed=3, config=config)
    assert episode.success
    middle, before = episode.points.mean(axis=1), int(2.9 / episode.dt)
    assert middle[-1, 0] - middle[before, 0] > 0.05
    np.testing.assert_allclose(episode.centre_line, Hook().centre_line + [0.12, 0, 0], atol=1e-6)  # where it ends up
    assert episode.physics["target"]["moves"] == {"by": [0.12, 0.0, 0.0], "start": 2.9, "seconds": 1.0}


def test_a_target_on_the_move_is_seen_where_it_is():
    way = Moving(Hook(), y=0.5, start=1.0, seconds=2.0)
    np.testing.assert_allclose(way.at(0).seat, Hook().seat)
    np.testing.assert_allclose(way.at(2).seat, Hook().seat + [0, 0.25, 0])
    np.testing.assert_allclose(way.at(9).seat, way.seat)
    turned_way = Placed(way, yaw=90)
    np.testing.assert_allclose(turned_way.at(2).seat - turned_way.at(0).seat, [-0.25, 0, 0], atol=1e-12)
    env = HangEnv(
        "sheet-hook",
        garment=coarse("sheet"),
        target=Moving(Hook(), x=0.2, start=0, seconds=0.1),
        n_points=20,
        config=SHORT,
    )
    first, _ = env.reset(seed=0)
    for _ in range(12):
        seen, *_ = env.step(np.zeros(7))
    env.close()
    np.testing.assert_allclose(seen["target"] - first["target"], [[0.2, 0, 0]] * 4, atol=1e-6)


def test_a_target_that_moves_does_not_turn():
    with pytest.raises(ValueError, match="does not turn"):
        Moving(Hook(), yaw=10)
