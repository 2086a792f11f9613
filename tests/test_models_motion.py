"""Motion: what must not matter does not, what it learns is motion, and loops are read off the moved cloud."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch.utils.data import default_collate

import topokit as tk
from topokit.data import Dataset
from topokit.models import Predictor, Scenes, build
from topokit.models._baselines import Shape
from topokit.models._motion import CARRIERS, KNOTS, UNIT, carried
from topokit.seqph import SeqPH, follow

from conftest import DATA
from windows import ring_scenes

SHAPE = Shape(points=160)
FILMS = DATA / "motion"


def make(width: int = 16, seed: int = 0, strong: float = 0.3, **options):
    torch.manual_seed(seed)
    model = build("motion", SHAPE, None, {"width": width, **options}).eval()
    torch.nn.init.normal_(model.out[2].weight, std=strong)  # an untrained one carries, and little can be seen
    return model


@pytest.fixture(scope="module")
def batch():
    scenes = ring_scenes(4, seed=3)
    return default_collate([scenes[i] for i in range(4)])


@pytest.fixture(scope="module")
def episode():
    dataset = Dataset(FILMS)
    return dataset[next(int(i) for i in dataset.episodes if dataset.record(i).garment == "apron")]


def observed(predictor, episode, last=20, points=None):
    predictor.reset()
    for t in range(last - 15, last + 1):
        cloud = episode.points[t] if points is None else points[t]
        predictor.observe(cloud, episode.grippers[t], bool(episode.held[t]), episode.centre_line)
    return episode.actions[last + 1 : last + 61], episode.held[last + 1 : last + 61]


def moved(batch, turn, shift):
    """The same scenes elsewhere."""
    places = {
        name: batch[name] @ turn.T + shift for name in ("cloud", "points", "grippers", "target", "actions", "future")
    }
    return {**batch, **places, "flow": batch["flow"] @ turn.T, "floor": batch["floor"] + shift[2]}


def about_the_vertical(angle):
    c, s = np.cos(angle), np.sin(angle)
    return torch.tensor([[c, -s, 0], [s, c, 0], [0, 0, 1]], dtype=torch.float32)


# -- the network ------------------------------------------------------------------------------------------------------------


def test_shapes_and_every_weight_learns(batch):
    model = make().train()
    places, scales = model(batch)
    assert places.shape == (4, len(KNOTS), CARRIERS + 16, 3)
    assert scales.shape == places.shape[:3]
    assert (scales > 0).all()
    model.loss(batch, torch.Generator().manual_seed(0))[0].backward()
    assert [name for name, part in model.named_parameters() if part.grad is None or not part.grad.any()] == []


@pytest.mark.parametrize("angle", [0.4, -2.9])
def test_a_scene_turned_and_moved_is_the_same_scene(batch, angle):
    model = make()
    turn = about_the_vertical(angle)
    shift = torch.tensor([2.0, -1.0, 0.3])
    elsewhere = moved(batch, turn, shift)
    with torch.inference_mode():
        (places, scales), (others, other_scales) = model(batch), model(elsewhere)
    assert torch.allclose(places @ turn.T + shift, others, atol=1e-4)
    assert torch.allclose(scales, other_scales, rtol=1e-4)
    losses = [model.loss(one, torch.Generator().manual_seed(1))[0].item() for one in (batch, elsewhere)]
    assert losses[0] == pytest.approx(losses[1], abs=1e-4)


def test_tilt_and_floor_matter(batch):
    """Gravity counts, and so does a floor that is near; one that is far below does not."""
    model = make()
    tilt = torch.tensor([[1, 0, 0], [0, 0, -1], [0, 1, 0]], dtype=torch.float32)
    with torch.inference_mode():
        usual, high, higher = (model({**batch, "floor": batch["floor"] - down})[0] for down in (0, 100, 1000))
        tilted = model(moved(batch, tilt, torch.zeros(3)))[0]
    assert not torch.allclose(usual, high, atol=1e-4)
    assert torch.equal(high, higher)
    assert not torch.allclose(usual @ tilt.T, tilted, atol=1e-2)


def test_untrained_it_carries(batch):
    torch.manual_seed(0)
    model = build("motion", SHAPE)
    with torch.inference_mode():
        places, _ = model(batch)
    start = torch.cat([batch["cloud"][:, :CARRIERS], batch["points"]], dim=1)
    ahead = carried(start, batch["grippers"][:, 0], batch["actions"][:, -1])
    assert (places[:, -1] - ahead).norm(dim=-1).max() < UNIT / 2
    assert (start - ahead).norm(dim=-1).min() > 0.01


def test_an_ablation_leaves_out_the_parts_that_it_names(batch):
    shift = torch.tensor([2.0, -1.0, 0.3])
    beside = {**batch, "target": batch["target"] + 0.1, "floor": batch["floor"] + 0.1}
    told, anywhere = {}, {}
    for part in ("target", "frame", "carry"):
        model = make(without=[part])
        with torch.inference_mode():
            places, others, elsewhere = (
                model(scene)[0] for scene in (batch, beside, moved(batch, torch.eye(3), shift))
            )
        told[part] = not torch.allclose(places, others, atol=1e-4)
        anywhere[part] = torch.allclose(places + shift, elsewhere, atol=1e-4)
    assert told == {"target": False, "frame": True, "carry": True}
    assert not anywhere["frame"]
    assert anywhere["carry"]
    still, _ = make(strong=0.0, without=["carry"])(batch)
    start = torch.cat([batch["cloud"][:, :CARRIERS], batch["points"]], dim=1)
    assert torch.allclose(still[:, -1], start, atol=1e-4)


def test_points_are_forecast_alike_alone_and_in_company(batch):
    model = make()
    with torch.inference_mode():
        whole, _ = model(batch)
        few = {**batch, "points": batch["points"][:, 5:7]}
        few["flow"] = torch.cat([batch["flow"][:, :160], batch["flow"][:, 165:167]], dim=1)
        some, _ = model(few)
    assert torch.allclose(whole[:, :, CARRIERS + 5 : CARRIERS + 7], some[:, :, CARRIERS:], atol=1e-5)
    assert torch.allclose(whole[:, :, :CARRIERS], some[:, :, :CARRIERS], atol=1e-5)


def test_a_step_knows_nothing_of_the_plan_after_it(batch):
    later = batch["actions"].clone()
    later[:, 30:] += 0.1
    model = make()
    with torch.inference_mode():
        one, other = model(batch)[0], model({**batch, "actions": later})[0]
    early = KNOTS.index(30) + 1
    assert torch.equal(one[:, :early], other[:, :early])
    assert not torch.allclose(one[:, early:], other[:, early:], atol=1e-3)


def test_after_the_release_the_grippers_do_not_matter(batch):
    free = torch.zeros_like(batch["actions_held"])
    away = batch["actions"] + 0.5
    model = make()
    with torch.inference_mode():
        one, other = (model({**batch, "actions_held": free, "actions": plan})[0] for plan in (batch["actions"], away))
    assert torch.equal(one, other)


# -- what it is shown -------------------------------------------------------------------------------------------------------


def test_scenes_are_windows_of_vertices(episode):
    dataset = Dataset(FILMS)
    scenes = Scenes(dataset, dataset.episodes[:2], stride=10)
    assert len(scenes) > 8
    one, again = scenes[3], scenes[3]
    assert all(torch.equal(part, again[name]) for name, part in one.items())
    number, frame = scenes.index[3].tolist()
    film = dataset[number]
    vertices = torch.from_numpy(film.points[frame].astype(np.float32))
    assert torch.cdist(one["cloud"].double(), vertices.double()).amin(dim=1).max() < 1e-6
    knot = KNOTS.index(15)
    start = torch.cat([one["cloud"][:CARRIERS], one["points"]])
    same = torch.cdist(start.double(), vertices.double()).argmin(dim=1)
    assert np.allclose(one["future"][knot], film.points[frame + 15][same], atol=1e-5)
    last = scenes.index[:, 1] > 0
    assert scenes[int(np.flatnonzero(last)[-1])]["known"].tolist() == [
        int(scenes.index[-1, 1]) + k < len(dataset[int(scenes.index[-1, 0])]) for k in KNOTS
    ]


# -- the predictor ----------------------------------------------------------------------------------------------------------


def test_many_plans_are_the_single_ones(episode):
    predictor = Predictor.of(make())
    actions, held = observed(predictor, episode)
    rng = np.random.default_rng(0)
    plans = actions + rng.normal(0, 0.05, (3, 60, 2, 3))
    many = predictor.predict(plans, np.stack([held] * 3))
    for i in range(3):
        one = predictor.predict(plans[i], held)
        assert np.allclose(many[i].corners, one.corners, atol=1e-5)
        assert np.allclose(many[i].presence, one.presence, atol=1e-5)


def test_the_two_tiers_move_the_same_points(episode):
    """Corners are points of the cloud: the fast tier moves them as the exact one does."""
    predictor = Predictor.of(make(strong=0.05))
    plan = observed(predictor, episode)
    clouds, scales = predictor.move(*plan)
    assert clouds.shape == (60, *episode.points[20].shape)
    assert scales.shape == clouds.shape[:2]
    fast = predictor.predict(*plan)
    killer = predictor.loops[0].killer_edge
    assert np.allclose(fast.corners[29, 0, :2], clouds[29][killer], atol=1e-5)
    exact = predictor.predict(*plan, exact=(30,))
    (loop,) = [one for one in tk.follow(predictor.loops, clouds[29]) if one.id == predictor.loops[0].id]
    assert exact.death[29, 0].item() == pytest.approx(loop.death)
    assert np.allclose(exact.corners[28], fast.corners[28])  # nothing else changed


def test_a_forecast_is_as_wide_as_it_is_unsure(episode):
    predictor = Predictor.of(make())
    plan = observed(predictor, episode)
    forecast = predictor.predict(*plan)
    loop = predictor.loops[0]
    places, scales = predictor.move(*plan, points=loop.killer_edge_points)
    assert np.allclose(forecast.corners[:, 0, :2], places, atol=1e-5)
    surplus = (forecast.noise[:, 0] - 1e-4 - forecast.death[:, 0] ** 2).numpy()
    assert np.all(surplus > 0.5 * (scales**2).mean(axis=1))  # of two of the eight corners
    timid = make()
    torch.nn.init.constant_(timid.out[2].bias[3:], 2.0)
    unsure = Predictor.of(timid)
    assert (unsure.predict(*observed(unsure, episode)).noise > forecast.noise).all()


def with_stray(predictor, episode, cloud, stray):
    """The film of a cloud that goes with the grippers, and a point in mid-air with it; the plan after it."""
    clouds = [
        np.concatenate([cloud, [stray]]) + middle - episode.grippers[20].mean(axis=0)
        for middle in episode.grippers[:21].mean(axis=1)
    ]
    return observed(predictor, episode, points=clouds)


def test_a_stray_in_an_opening_does_not_end_it(episode):
    """The tracker leaves it out, and so does who seeks its loops in the moved cloud."""
    turn = 2 * np.pi * np.arange(150) / 150
    ring = episode.grippers[20].mean(axis=0) + np.column_stack([0.3 * np.cos(turn), 0 * turn, 0.3 * np.sin(turn) - 0.3])
    predictor = Predictor.of(make(strong=1e-3))
    plan = with_stray(predictor, episode, ring, ring.mean(axis=0))
    exact, fast = predictor.predict(*plan, exact=[1]), predictor.predict(*plan)
    assert len(predictor.loops) == 1
    assert exact.death[0, 0].item() == pytest.approx(fast.death[0, 0].item(), rel=0.05)
    assert fast.death[0, 0] > 0.25


def test_a_cloud_without_a_loop_has_a_forecast_without_one():
    predictor, rng = Predictor.of(make()), np.random.default_rng(0)
    hands = np.array([[-0.1, 0, 1.0], [0.1, 0, 1.0]])
    for _ in range(3):
        predictor.observe(rng.normal(0, 0.01, (6, 3)) + [0, 0, 0.9], hands)
    plan = np.repeat(hands[None], 60, axis=0)
    forecast = predictor.predict(plan, exact=(1, 60))
    assert forecast.mixtures(0) == {}
    assert predictor.move(plan)[0].shape == (60, 6, 3)


def test_loops_are_born_in_the_moved_cloud(episode):
    """A film that opens, backwards: what the present does not show is read off the moved cloud, and followed from there on."""
    angle = 2 * np.pi * np.arange(60) / 60
    ring = np.column_stack([0.2 * np.cos(angle), 0.2 * np.sin(angle), 0 * angle])
    opened = np.concatenate([ring, ring + [1, 0, 0]])
    shut = np.concatenate([ring, ring * [1, 0.01, 1] + [1, 0, 0]])
    (loop,) = tk.track([shut] * 3)[-1].loops
    tracker = SeqPH()
    tracker.update(opened)
    (born,) = (one for one in follow([loop], opened, tracker) if one.id != loop.id)
    predictor = Predictor.of(make())
    plan, held = observed(predictor, episode)
    predictor.predict(plan, held)  # all that was observed is tracked
    predictor.move = lambda *_: (
        np.stack([shut] * 20 + [opened] * 40)[None].astype(np.float32),
        np.full((1, 60, 120), 0.01),
    )
    predictor.loops, predictor.tracker = (loop,), tracker
    forecast = predictor.predict(plan, held, exact=(60, 10, 30))
    assert forecast.birth.shape == (60, 2)
    assert [len(forecast.mixtures(step - 1)) for step in (10, 30, 60)] == [1, 2, 2]
    assert forecast.corners[29, 1, :, 0].min() > 0.5
    assert (forecast.presence[[9, 20, 40], 1] < -10).all()  # only where it was looked for
    assert forecast.noise[59, 1] == pytest.approx(1e-4 + born.death**2 + 4e-4, rel=0.01)
