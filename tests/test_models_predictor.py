"""Predictors: one network, streams and windows alike, plans in one batch; checkpoints that say what is wrong with them."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
import safetensors.torch
import torch
from torch.utils.data import default_collate

import topokit as tk
from topokit._archive import FormatError
from topokit.cli import main
from topokit.io import load_episode
from topokit.models import (
    Forecast,
    LossWeights,
    Normalisation,
    Predictor,
    Shape,
    StateTensors,
    build,
    forecast_loss,
)
from topokit.models._baselines import past_window
from topokit.models._checkpoint import MODELS, describe, load_model, load_tensors, save_tensors

from windows import HISTORY, HORIZON, POINTS, SLOTS, RingWindows

SHAPE = Shape(points=POINTS, slots=SLOTS)
UNITS = Normalisation((0.0, 0.0, 0.85), 0.1, 0.08)
SMALL = {
    "mlp": {"hidden": [32, 16]},
    "pointnet": {"hidden": [32, 16]},
}
NETWORKS = tuple(SMALL)
OF_WINDOWS = tuple(name for name in MODELS if name != "motion")


def make(name, seed=0):
    torch.manual_seed(seed)
    model = build(name, SHAPE, UNITS, SMALL.get(name)).eval()
    if name == "ridge":
        model.coefficients.data.normal_(std=0.01)
    return model


@pytest.fixture(scope="module")
def window():
    data = RingWindows(4, seed=5)
    return default_collate([data[i] for i in range(4)])


@pytest.fixture(scope="module")
def stream(window):
    return [(window["clouds"][1, t].double().numpy(), window["grippers"][1, t].numpy()) for t in range(HISTORY)]


def save(path, name="mlp", **changes):
    model = make(name)
    save_tensors(path, model.state_dict(), describe(model) | changes)
    return path


@pytest.mark.parametrize("name", OF_WINDOWS)
def test_shapes_and_finite(window, name):
    with torch.inference_mode():
        states = make(name)(window)
    assert states.corners.shape == (4, HORIZON, SLOTS, 8, 3)
    assert states.neighbour_values.shape == (4, HORIZON, SLOTS, 4)
    for part in ("birth", "death", "killer_shift", "presence"):
        assert getattr(states, part).shape == (4, HORIZON, SLOTS)
        assert torch.isfinite(getattr(states, part)).all()
    assert (states.death >= states.birth).all()
    assert (states.birth >= 0).all()


@pytest.mark.parametrize("name", NETWORKS)
def test_every_weight_learns(window, name):
    model = make(name).train()
    forecast_loss(model(window), window, LossWeights(centre=1, match=True))[0].backward()
    assert [key for key, part in model.named_parameters() if part.grad is None or not part.grad.any()] == []


def test_the_order_of_points_does_not_count_for_a_pointnet(window):
    mixed = window | {"clouds": window["clouds"][:, :, torch.randperm(POINTS)]}
    with torch.inference_mode():
        assert torch.allclose(make("pointnet")(window).corners, make("pointnet")(mixed).corners, atol=1e-5)


@pytest.mark.parametrize("name", ["carry", "hold"])
def test_a_step_knows_nothing_of_the_plan_after_it(window, name):
    later = window["actions"].clone()
    later[:, 30:] += 0.1
    with torch.inference_mode():
        model = make(name)
        one, other = model(window), model(window | {"actions": later})
    assert torch.equal(one.corners[:, :30], other.corners[:, :30])
    if name != "hold":
        assert not torch.allclose(one.corners[:, 30:], other.corners[:, 30:])


def test_hold_and_carry_are_what_they_say(window):
    truth = StateTensors.from_labels(window)
    hold, carry = make("hold")(window), make("carry")(window)
    last = window["past_triangles"][:, -1, 0, 0, 0]
    assert torch.allclose(hold.corners[:, :, 0, 0], last[:, None].expand(-1, HORIZON, -1))
    assert torch.allclose(carry.corners[:, :, 0], truth.corners[:, :, 0], atol=1e-5)  # the ring goes with the grippers
    assert torch.allclose(
        carry.killer_shift[:, :, 0],
        (carry.corners[:, :, 0, 0].diff(dim=1, prepend=last[:, None])).norm(dim=-1),
        atol=1e-6,
    )
    assert (carry.presence[:, :, 0] > 0).all()
    assert (carry.presence[:, :, 2:] < 0).all()


def test_carry_brings_a_lost_loop_to_where_it_should_be_now(window):
    lost = {name: part.clone() for name, part in window.items()}
    for name in ("triangles", "values", "present"):
        lost[f"past_{name}"][:, 10:, 0] = 0
    carry, expected = make("carry")(lost), make("carry")(window)
    assert torch.allclose(carry.corners[:, :, 0], expected.corners[:, :, 0], atol=1e-5)
    assert (carry.presence[:, :, 0] < 0).all()


def test_ridge_is_the_solution_of_scikit_learn(window):
    from sklearn.linear_model import Ridge

    model = make("ridge")
    data = RingWindows(40, seed=8)
    batches = [default_collate([data[i] for i in range(start, start + 20)]) for start in (0, 20)]
    model.fit(batches)
    whole = default_collate([data[i] for i in range(40)])
    kept = model.encode(whole)
    x = model._inputs(kept, whole["actions"], whole["actions_held"]).flatten(0, 1).double().numpy()
    y = whole["present"].transpose(1, 2).flatten(0, 1).double().numpy()  # (windows * slots, steps)
    peer = Ridge(alpha=model.penalty).fit(x[:, 1:], y)
    with torch.inference_mode():
        presence = model.decode(kept, whole["actions"], whole["actions_held"]).presence / 12 + 0.5
    assert np.allclose(presence.transpose(1, 2).flatten(0, 1), peer.predict(x[:, 1:]), atol=1e-4)


@pytest.mark.parametrize("name", OF_WINDOWS)
def test_many_plans_are_the_single_ones(window, stream, name):
    predictor = Predictor(make(name))
    for cloud, grippers in stream:
        predictor.observe(cloud, grippers)
    rng = np.random.default_rng(0)
    plans = window["actions"][1].numpy() + rng.normal(0, 0.05, (30, HORIZON, 2, 3))
    held = rng.random((30, HORIZON)) < 0.7
    many = predictor.predict(plans, held)
    assert len(many.birth) == 30
    for i in (0, 24, 29):
        single = predictor.predict(plans[i], held[i])
        assert np.allclose(many.plan(i).corners, single.corners, atol=1e-5)
        assert np.allclose(many.plan(i).presence, single.presence, atol=1e-5)
    with pytest.raises(IndexError, match="choose one first"):
        many[0]


@pytest.mark.parametrize("name", [*NETWORKS, "carry"])
def test_a_stream_is_the_window(window, stream, name):
    """Frames encoded one at a time, with earlier ones that have been forgotten, give what the batch gives."""
    predictor, frames = Predictor(make(name)), [*stream[5:10], *stream]
    for cloud, grippers in frames:
        predictor.observe(cloud, grippers)
    forecast = predictor.predict(window["actions"][1], window["actions_held"][1])
    tracked = tk.track([cloud for cloud, _ in frames])
    with torch.inference_mode():
        single = {key: part[1:2] for key, part in window.items()} | past_window(tracked[-HISTORY:], SLOTS)
        states = make(name)(single)
    assert np.allclose(forecast.corners, states.corners[0], atol=1e-5)
    assert np.allclose(forecast.mean, states.mean[0], atol=1e-5)
    assert np.allclose(forecast.triangles, states.triangles[0], atol=1e-5)
    assert np.allclose(forecast.values, states.values[0], atol=1e-6)
    assert np.allclose(forecast.presence, states.presence[0].sigmoid(), atol=1e-5)


def test_a_predictor_tracks_with_the_recommended_options(monkeypatch):
    made = []
    monkeypatch.setattr(
        "topokit.models._predictor.SeqPH", lambda **options: made.append(options) or tk.SeqPH(**options)
    )
    Predictor(make("carry"))
    assert made == [{}]


def test_frames_are_encoded_once(window, stream, monkeypatch):
    predictor = Predictor(make("pointnet"))
    calls = []
    encode = predictor.model.encode_frames
    monkeypatch.setattr(predictor.model, "encode_frames", lambda frames: calls.append(1) or encode(frames))
    for cloud, grippers in stream:
        predictor.observe(cloud, grippers)
    predictor.predict(window["actions"][1])
    predictor.predict(window["actions"].numpy())
    assert len(calls) == len(stream)


def test_carry_follows_the_tracked_loop_of_a_stream(episode_path):
    episode = load_episode(episode_path)
    predictor = Predictor(build("carry", Shape(), UNITS))
    for t in range(4, 20):
        predictor.observe(episode.points[t], episode.grippers[t])
    loop = predictor.predict(np.repeat(episode.grippers[19][None], 60, axis=0))[0][0]
    truth = episode.points[19][episode.loops[0]]
    assert np.linalg.norm(loop.mixture().mean - truth.mean(axis=0)) < 0.06
    assert loop.slot == 0


def test_loops_of_a_forecast(window, stream):
    predictor = Predictor(make("pointnet"))
    for cloud, grippers in stream:
        predictor.observe(cloud, grippers)
    forecast = predictor.predict(window["actions"][1])
    assert isinstance(forecast, Forecast)
    assert len(forecast) == HORIZON == len(list(forecast))
    for step in (0, 59):
        loops = forecast[step]
        assert len(loops) == (forecast.presence[step] > 0.5).sum()
        assert [loop.lifetime for loop in loops] == sorted((loop.lifetime for loop in loops), reverse=True)
        for loop in loops:
            assert np.allclose(loop.mixture().mean, forecast.mean[step, loop.slot], atol=1e-5)
            assert np.allclose(loop.centre, tk.Loop.centre.fget(loop))
            assert np.allclose(tk.loop_mixture(loop, noise=1e-3).covariances, loop.mixture(1e-3).covariances)
        assert [json.loads(json.dumps(loop.as_dict()))["slot"] for loop in loops] == [loop.slot for loop in loops]


def test_what_cannot_be_observed_or_planned_is_refused(stream, window):
    predictor = Predictor(make("carry"))
    cloud, grippers = stream[0]
    plan = window["actions"][1].numpy()
    with pytest.raises(ValueError, match="nothing was observed yet"):
        predictor.predict(plan)
    with pytest.raises(ValueError, match="needs to know where the grippers are"):
        predictor.observe(cloud)
    with pytest.raises(ValueError, match=r"grippers must be a \(2, 3\) array"):
        predictor.observe(cloud, grippers[:1])
    with pytest.raises(ValueError, match=r"points must be an \(n, 3\) array"):
        predictor.observe(cloud[:, :2], grippers)
    predictor.observe(cloud, grippers)
    with pytest.raises(ValueError, match=r"actions must be \(60, 2, 3\) or \(plans, 60, 2, 3\)"):
        predictor.predict(plan[:20])
    with pytest.raises(ValueError, match=r"held must be \(60,\)"):
        predictor.predict(plan, np.ones(59, bool))
    with pytest.raises(ValueError, match="NaN"):
        predictor.predict(np.full_like(plan, np.nan))
    with pytest.raises(ValueError, match="NaN or infinite"):
        predictor.predict(np.full(plan.shape, 1e300))
    with pytest.raises(ValueError, match="actions has 1 masked entries"):
        predictor.predict(np.ma.MaskedArray(plan, np.arange(plan.size).reshape(plan.shape) == 3))
    with pytest.raises(ValueError, match="held has 60 masked entries"):
        predictor.predict(plan, np.ma.masked_all(60, bool))
    with pytest.raises(ValueError, match="actions must hold real numbers"):
        predictor.predict(plan.astype(str))
    predictor.predict(plan)
    predictor.reset()
    with pytest.raises(ValueError, match="nothing was observed yet"):
        predictor.predict(plan)


def test_networks_of_clouds_alone_need_no_grippers(stream, window):
    predictor = Predictor(make("pointnet"))
    predictor.observe(stream[0][0][:5])  # fewer points than it wants, and one frame only
    assert np.isfinite(predictor.predict(window["actions"][1]).corners).all()


# -- checkpoints ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", OF_WINDOWS)
def test_a_checkpoint_gives_the_model_back(tmp_path, window, name):
    loaded, description = load_model(save(tmp_path / "c.safetensors", name))
    with torch.inference_mode():
        assert torch.equal(loaded(window).corners, make(name)(window).corners)
    assert description["model"] == name


def test_same_content_same_bytes(tmp_path):
    save(tmp_path / "a.safetensors")
    save(tmp_path / "b.safetensors")
    assert (tmp_path / "a.safetensors").read_bytes() == (tmp_path / "b.safetensors").read_bytes()


def test_wrong_and_damaged_checkpoints_are_told_apart(tmp_path):
    path = save(tmp_path / "c.safetensors")
    whole = path.read_bytes()
    with pytest.raises(FileNotFoundError, match="there is no such file"):
        Predictor.load(tmp_path / "none.safetensors")
    with pytest.raises(FileNotFoundError, match="a folder"):
        Predictor.load(tmp_path)
    for content, says in (
        (b"", "truncated or damaged"),
        (whole[:-100], "truncated or damaged"),
        (whole[:50], "truncated or damaged"),
        (b"\x80\x04." + bytes(100), "no checkpoint, or a truncated or damaged one"),
        (whole[:-8] + bytes([whole[-8] ^ 1]) + whole[-7:], "checksum does not match"),
        (safetensors.torch.save({"a": torch.zeros(2)}), "topokit did not write"),
    ):
        path.write_bytes(content)
        with pytest.raises(FormatError, match=says):
            Predictor.load(path)


def test_checkpoints_for_other_shapes_or_models(tmp_path):
    path = tmp_path / "c.safetensors"
    save(path, shape={"history": 16, "horizon": 60, "points": POINTS, "slots": 3})
    with pytest.raises(
        FormatError, match=r"weights of another shape: .*MLP: size mismatch for rest\.\S+:.*\[7680.*model is .*\[5760"
    ):
        Predictor.load(path)
    save(path, model="motion", options={})
    with pytest.raises(FormatError, match=r"weights of another shape: .*Motion: Missing key.*point"):
        Predictor.load(path)
    save(path, model="transformer")
    with pytest.raises(FormatError, match="no model 'transformer'; there are hold, carry"):
        Predictor.load(path)
    save(path, options={"layers": 9})
    with pytest.raises(FormatError, match="layers"):
        Predictor.load(path)


def test_the_name_of_a_checkpoint(tmp_path):
    with pytest.raises(ValueError, match=r"ends in \.safetensors"):
        save(tmp_path / "c.pt")


def test_half_precision_is_half_the_size(tmp_path):
    whole = save(tmp_path / "a.safetensors")
    entries = {name: part.half() for name, part in load_tensors(whole)[1].items()}
    half = tmp_path / "b.safetensors"
    save_tensors(half, entries, describe(make("mlp")))
    assert half.stat().st_size < 0.6 * whole.stat().st_size
    assert all(part.dtype == torch.float32 for part in load_model(half)[0].state_dict().values())


# -- the command ----------------------------------------------------------------------------------------------------------------


def test_predict_command(tmp_path, episode_path, capsys):
    path = save(tmp_path / "c.safetensors", "pointnet")
    assert main(["predict", str(path), str(episode_path), "--frame", "30", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["model"] == "pointnet"
    assert answer["frame"] == 30
    assert len(answer["steps"]) == HORIZON
    assert main(["predict", str(path), str(episode_path), "--frame", "90"]) == 0
    assert "mean of the mixture" in capsys.readouterr().out
    assert main(["predict", str(path), str(episode_path), "--frame", "300"]) == 2
    assert "frames 0 to 95" in capsys.readouterr().err
    assert main(["predict", str(episode_path), str(episode_path)]) == 2
    assert "no checkpoint" in capsys.readouterr().err


def test_help_and_import_do_without_torch():
    code = """
import sys
for name in ("torch", "safetensors", "lightning_fabric", "tqdm"):
    sys.modules[name] = None
import topokit.models
from topokit.cli import main
assert main(["predict", "--help"]) == 0
assert main(["predict", "c.safetensors", "e.npz"]) == 2
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "Usage: topokit predict" in done.stdout
    assert "pip install 'topokit[learn]'" in done.stderr


@pytest.mark.parametrize("name", ["ridge", *NETWORKS])
def test_a_checkpoint_in_16_bits_takes_less_than_5_mb(name):
    assert sum(part.numel() for part in build(name, Shape(), UNITS).parameters()) < 2_450_000


# -- what a stranger's checkpoint may say ----------------------------------------------------------------------------------------


def rewritten(path, change):
    """Change the description of a checkpoint in its file, and nothing else."""
    raw = path.read_bytes()
    size = int.from_bytes(raw[:8], "little")
    header = json.loads(raw[8 : 8 + size])
    header["__metadata__"]["topokit"] = change(header["__metadata__"]["topokit"])
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    path.write_bytes(len(text).to_bytes(8, "little") + text + raw[8 + size :])
    return path


def test_one_bit_of_the_description_is_noticed(tmp_path):
    path = save(tmp_path / "c.safetensors")
    with pytest.raises(FormatError, match="checksum does not match"):
        Predictor.load(rewritten(path, lambda text: text.replace('"scale": 0.1', '"scale": 0.3')))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"normalisation": {"scale": 0.0}}, r"normalisation: scale: .* greater than or equal to 0.000001, not 0.0"),
        ({"normalisation": {"scale": float("nan")}}, "normalisation: scale: "),
        ({"normalisation": {"scale": "0.1"}}, "normalisation: scale: "),
        ({"normalisation": {"value": -1.0}}, "normalisation: value: "),
        ({"normalisation": {"origin": [0.0, float("nan"), 1.0]}}, "normalisation: origin.1: "),
        ({"normalisation": {"origin": [0.0, 1e300, 1.0]}}, "normalisation: origin.1: "),
        ({"normalisation": []}, "normalisation must be an object"),
        ({"shape": {"points": 10**9}}, "shape: points: .* less than or equal to 100000"),
        ({"shape": {"history": 10**9}}, "shape: history: "),
        ({"shape": {"horizon": 0}}, "shape: horizon: "),
        ({"options": {"hidden": [10**9, 10**9]}}, "hidden must be numbers of units"),
        ({"options": {"hidden": [100_000, 100_000]}}, "weights of another shape"),
        ({"options": {"hidden": []}}, "hidden must be numbers of units"),
        ({"options": {"hidden": "1"}}, "hidden must be numbers of units"),
        ({"options": {"points": 0}}, "points must be a whole number"),
        ({"options": {"points": 10**9}}, "points must be a whole number"),
        ({"options": 3}, "describes no model"),
        ({"model": ["mlp"]}, "describes no model"),
        ({"model": "ridge", "options": {"penalty": float("nan")}}, "penalty must be more than zero"),
        ({"model": "motion", "options": {"width": -1}}, "width must be a whole number from 1 to 4096, not -1"),
    ],
)
def test_descriptions_that_make_no_sense_are_refused_before_memory_is_taken(tmp_path, changes, says):
    """Their checksums are right: whoever wrote them meant it."""
    path = save(tmp_path / "c.safetensors", **changes)
    with pytest.raises(FormatError, match=says) as caught:
        Predictor.load(path)
    assert str(path) in str(caught.value)


def test_a_description_too_deep_to_read_is_refused(tmp_path):
    path = rewritten(save(tmp_path / "c.safetensors"), lambda _: "[" * 100_000)
    with pytest.raises(FormatError, match="topokit did not write"):
        Predictor.load(path)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_weights_that_are_no_numbers_are_refused(tmp_path, bad):
    weights = load_tensors(save(tmp_path / "c.safetensors"))[1]
    weights["rest.1.bias"][3] = bad
    path = tmp_path / "bad.safetensors"
    save_tensors(path, weights, describe(make("mlp")))
    with pytest.raises(FormatError, match=r"rest\.1\.bias hold a NaN or an infinite number"):
        Predictor.load(path)


def test_a_changed_byte_never_gives_another_model(tmp_path, window):
    path = save(tmp_path / "c.safetensors")
    raw, whole = path.read_bytes(), load_model(path)
    header = 8 + int.from_bytes(raw[:8], "little")
    rng = np.random.default_rng(0)
    places = [*range(8), *rng.integers(8, header, 250).tolist(), *rng.integers(header, len(raw), 30).tolist()]
    refused = 0
    for at in places:
        path.write_bytes(raw[:at] + bytes([raw[at] ^ 1 << rng.integers(8)]) + raw[at + 1 :])
        try:
            model, description = load_model(path)
        except FormatError:
            refused += 1
        else:  # a blank of the header, or a place where JSON says the same in other words
            assert description == whole[1]
            assert all(torch.equal(part, model.state_dict()[name]) for name, part in whole[0].state_dict().items())
    assert refused > 0.9 * len(places)
