"""Predictors: streams and windows alike, plans in one batch; checkpoints that name what is wrong with them."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import safetensors.torch
import torch
from torch.utils.data import default_collate

import topokit as tk
from topokit._archive import FormatError
from topokit.cli import main
from topokit.models import Predictor, StateTensors, TrainConfig, build, forecast_loss
from topokit.models._baselines import Normalisation, Shape
from topokit.models._checkpoint import describe, save_tensors
from topokit.models._states import past_of

from windows import HISTORY, HORIZON, POINTS, SLOTS, ring_windows

CHECKPOINTS = Path(__file__).parents[1] / "data_small" / "checkpoints"
SHAPE = Shape(points=POINTS, slots=SLOTS)
UNITS = Normalisation((0.0, 0.0, 0.85), 0.1, 0.08)
SMALL = {"hidden": [32, 16]}
NETWORKS = ("mlp", "pointnet")
NAMES = ("hold", "carry", "ridge", *NETWORKS)


def make(name, seed=0):
    torch.manual_seed(seed)
    model = build(name, SHAPE, UNITS, SMALL if name in NETWORKS else None).eval()
    if name == "ridge":
        model.coefficients.data.normal_(std=0.01)
    return model


def save(path, name="mlp", **changes):
    """Write a checkpoint; its description may say something else."""
    model = make(name)
    save_tensors(path, model.state_dict(), describe(model) | changes)
    return path


@pytest.fixture(scope="module")
def window():
    data = ring_windows(4, seed=5)
    return default_collate([data[i] for i in range(4)])


@pytest.fixture(scope="module")
def stream(window):
    return [(window["clouds"][1, t].double().numpy(), window["grippers"][1, t].numpy()) for t in range(HISTORY)]


def shown(name, stream):
    predictor = Predictor(make(name))
    for cloud, grippers in stream:
        predictor.observe(cloud, grippers)
    return predictor


@pytest.mark.parametrize("name", NAMES)
def test_shapes_and_finite(window, name):
    with torch.inference_mode():
        states = make(name)(window)
    assert states.corners.shape == (4, HORIZON, SLOTS, 8, 3)
    assert states.neighbour_values.shape == (4, HORIZON, SLOTS, 4)
    for part in (states.birth, states.death, states.killer_shift, states.presence):
        assert part.shape == (4, HORIZON, SLOTS)
        assert torch.isfinite(part).all()
    assert (states.death >= states.birth).all()
    assert (states.birth >= 0).all()


@pytest.mark.parametrize("name", NETWORKS)
def test_every_weight_learns(window, name):
    model = make(name).train()
    forecast_loss(model(window), window, centre=1, match=True)[0].backward()
    assert [key for key, part in model.named_parameters() if part.grad is None or not part.grad.any()] == []


def test_the_order_of_points_does_not_count_for_a_pointnet(window):
    mixed = window | {"clouds": window["clouds"][:, :, torch.randperm(POINTS)]}
    with torch.inference_mode():
        assert torch.allclose(make("pointnet")(window).corners, make("pointnet")(mixed).corners, atol=1e-5)


@pytest.mark.parametrize("name", NETWORKS)
def test_outputs_of_a_network_with_a_skip_are_offsets_from_the_plan(name, window):
    model = build(name, SHAPE, UNITS, SMALL | {"skip": True}).eval()
    model.action_layer.weight.data.zero_()  # the plan reaches the output by the skip alone
    shift = torch.tensor([0.3, -0.2, 0.1])
    with torch.inference_mode():
        here = model(window)
        there = model(window | {"actions": window["actions"] + shift})
    assert torch.allclose(there.corners, here.corners + shift, atol=1e-5)


def test_hold_and_carry_are_what_their_names_mean(window):
    truth = StateTensors.from_labels(window)
    hold, carry = make("hold")(window), make("carry")(window)
    last = window["past_triangles"][:, -1, 0, 0, 0]
    assert torch.allclose(hold.corners[:, :, 0, 0], last[:, None].expand(-1, HORIZON, -1))
    assert torch.allclose(carry.corners[:, :, 0], truth.corners[:, :, 0], atol=1e-5)  # the ring goes with the grippers
    shift = carry.corners[:, :, 0, 0].diff(dim=1, prepend=last[:, None]).norm(dim=-1)
    assert torch.allclose(carry.killer_shift[:, :, 0], shift, atol=1e-6)
    assert (carry.presence[:, :, 0] > 0).all()
    assert (carry.presence[:, :, 2:] < 0).all()
    # A step does not depend on the plan after it.
    later = window["actions"].clone()
    later[:, 30:] += 0.1
    other = make("carry")(window | {"actions": later})
    assert torch.equal(carry.corners[:, :30], other.corners[:, :30])
    assert not torch.allclose(carry.corners[:, 30:], other.corners[:, 30:])


def test_carry_brings_a_lost_loop_to_where_it_should_be_now(window):
    lost = {name: part.clone() for name, part in window.items()}
    for name in ("triangles", "values", "present"):
        lost[f"past_{name}"][:, 10:, 0] = 0
    carry, expected = make("carry")(lost), make("carry")(window)
    assert torch.allclose(carry.corners[:, :, 0], expected.corners[:, :, 0], atol=1e-5)
    assert (carry.presence[:, :, 0] < 0).all()


def test_ridge_is_the_solution_of_scikit_learn():
    from sklearn.linear_model import Ridge

    model = make("ridge")
    data = ring_windows(40, seed=8)
    model.fit([default_collate([data[i] for i in range(start, start + 20)]) for start in (0, 20)])
    whole = default_collate([data[i] for i in range(40)])
    kept = model.encode(whole)
    x = model._inputs(kept, whole["actions"], whole["actions_held"]).flatten(0, 1).double().numpy()
    y = whole["present"].transpose(1, 2).flatten(0, 1).double().numpy()  # (windows * slots, steps)
    peer = Ridge(alpha=model.penalty).fit(x[:, 1:], y)
    with torch.inference_mode():
        presence = model(whole).presence / 12 + 0.5
    assert np.allclose(presence.transpose(1, 2).flatten(0, 1), peer.predict(x[:, 1:]), atol=1e-4)


@pytest.mark.parametrize("name", NAMES)
def test_many_plans_are_the_single_ones(window, stream, name):
    predictor = shown(name, stream)
    rng = np.random.default_rng(0)
    plans = window["actions"][1].numpy() + rng.normal(0, 0.05, (30, HORIZON, 2, 3))
    held = rng.random((30, HORIZON)) < 0.7
    many = predictor.predict(plans, held)
    assert len(many.birth) == 30
    for i in (0, 29):
        single = predictor.predict(plans[i], held[i])
        assert np.allclose(many[i].corners, single.corners, atol=1e-5)
        assert np.allclose(many[i].presence, single.presence, atol=1e-5)


@pytest.mark.parametrize("name", [*NETWORKS, "carry"])
def test_a_stream_is_the_window(window, stream, name):
    """Frames that are observed one at a time, after earlier ones that are forgotten, give what the batch gives."""
    frames = [*stream[5:10], *stream]
    forecast = shown(name, frames).predict(window["actions"][1], window["actions_held"][1])
    tracked = tk.track([cloud for cloud, _ in frames])
    with torch.inference_mode():
        states = make(name)({key: part[1:2] for key, part in window.items()} | past_of(tracked[-HISTORY:], SLOTS))
    for part in ("corners", "mean", "triangles", "values"):
        assert np.allclose(getattr(forecast, part), getattr(states, part)[0], atol=1e-5)
    assert np.allclose(forecast.presence, states.presence[0], atol=1e-5)


def test_mixtures_of_a_forecast(window, stream):
    forecast = shown("pointnet", stream).predict(window["actions"][1])
    for step in (0, 59):
        mixtures = forecast.mixtures(step)
        assert sorted(mixtures) == torch.nonzero(forecast.presence[step] > 0).ravel().tolist()
        lifetimes = forecast.lifetime[step, list(mixtures)].tolist()
        assert lifetimes == sorted(lifetimes, reverse=True)
        for slot, mixture in mixtures.items():
            assert np.allclose(mixture.mean, forecast.mean[step, slot], atol=1e-5)
            sides = forecast.triangles[step, slot].numpy() - mixture.means[:, None]
            spread = np.einsum("mvi,mvj->mij", sides, sides) / 2 + forecast.noise[step, slot].item() * np.eye(3)
            assert np.allclose(mixture.covariances, spread, atol=1e-6)


def test_what_cannot_be_observed_or_planned_is_refused(stream, window):
    predictor = Predictor(make("carry"))
    cloud, grippers = stream[0]
    plan = window["actions"][1].numpy()
    with pytest.raises(ValueError, match="observe"):
        predictor.predict(plan)
    for points, hands, named in (
        (cloud, None, "grippers"),
        (cloud, grippers[:1], "grippers"),
        (cloud[0], grippers, "points"),
    ):
        with pytest.raises(ValueError, match=named):
            predictor.observe(points, hands)
    predictor.observe(cloud, grippers)
    with pytest.raises(ValueError, match="actions"):
        predictor.predict(plan[:20])
    predictor.predict(plan)
    predictor.reset()
    with pytest.raises(ValueError, match="observe"):
        predictor.predict(plan)


# -- checkpoints ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_a_checkpoint_gives_the_model_back(tmp_path, window, name):
    path = save(tmp_path / "c.safetensors", name)
    predictor = Predictor.load(path)
    with torch.inference_mode():
        assert torch.equal(predictor.model(window).corners, make(name)(window).corners)
    assert predictor.description["model"] == name


@pytest.mark.parametrize("name", ["ridge", "mlp", "pointnet", "motion"])
def test_a_configuration_of_data_small_is_the_one_its_checkpoint_was_trained_with(name):
    described = Predictor.load(CHECKPOINTS / f"{name}.safetensors").description
    written = dataclasses.asdict(TrainConfig.load(CHECKPOINTS / f"{name}.json"))
    known = (described["config"].keys() & written.keys()) - {"loss"}
    assert len(known) > 12
    assert {key: written[key] for key in known} == {key: described["config"][key] for key in known}


def test_damaged_checkpoints_are_refused(tmp_path):
    path = save(tmp_path / "c.safetensors")
    whole = path.read_bytes()
    for missing in (tmp_path / "none.safetensors", tmp_path):
        with pytest.raises(FileNotFoundError):
            Predictor.load(missing)
    other = safetensors.torch.save({"a": torch.zeros(2)})
    for content in (b"", whole[:-100], whole[:50], b"\x80\x04." + bytes(100), other):
        path.write_bytes(content)
        with pytest.raises(FormatError, match=r"c\.safetensors"):
            Predictor.load(path)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"normalisation": {"scale": 0.0}}, "normalisation: scale"),
        ({"shape": {"points": 0}}, "shape: points"),
        ({"shape": {"history": 16, "horizon": 60, "points": POINTS, "slots": 3}}, r"rest\.\S+:.*7680.*5760"),
        ({"options": {"hidden": [100_000, 100_000]}}, "history_layer"),
        ({"options": {"layers": 9}}, "layers"),
        ({"model": "transformer"}, "'transformer'.*carry"),
    ],
)
def test_descriptions_that_do_not_fit_are_refused_before_memory_is_taken(tmp_path, changes, named):
    path = save(tmp_path / "c.safetensors", **changes)
    with pytest.raises(FormatError, match=rf"c\.safetensors.*{named}"):
        Predictor.load(path)


# -- the command ----------------------------------------------------------------------------------------------------------------


def test_predict_command(tmp_path, episode_path, capsys):
    path = save(tmp_path / "c.safetensors", "pointnet")
    assert main(["predict", str(path), str(episode_path), "--frame", "30", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert (answer["model"], answer["frame"]) == ("pointnet", 30)
    assert main(["predict", str(path), str(episode_path), "--frame", "90"]) == 0
    assert "loops: " in capsys.readouterr().out
    for bad in ([str(path), str(episode_path), "--frame", "300"], [str(episode_path), str(episode_path)]):
        assert main(["predict", *bad]) == 2
        assert bad[0] in capsys.readouterr().err or "300" in bad
