"""Training: the loss falls, a kill does not matter, and what does not fit is refused by name."""

from __future__ import annotations

import csv
import dataclasses
import json
from pathlib import Path

import pytest
import torch
from torch.utils.data import default_collate

from topokit._archive import FormatError
from topokit.models import Predictor, StateTensors, TrainConfig, build, train
from topokit.models._baselines import Shape
from topokit.models._training import mirrored

from windows import POINTS, SLOTS, ring_scenes, ring_windows

SHAPE = Shape(points=POINTS, slots=SLOTS)
MORE = {"centre": 1.0, "match": True}
ROOT = Path(__file__).parents[1]
OPTIONS = {"mlp": {"hidden": [32, 16]}, "pointnet": {"hidden": [64, 32]}, "motion": {"width": 16}}


@pytest.fixture(scope="module")
def windows():
    return ring_windows(96, seed=0), ring_windows(24, seed=1), "rings"


@pytest.fixture(scope="module")
def scenes():
    return ring_scenes(96, seed=0), ring_scenes(24, seed=1), "rings"


def config(model="mlp", **changes):
    entries = {"options": OPTIONS.get(model, {}), "shape": SHAPE, "batch": 16, "epochs": 3, "threads": 1}
    return TrainConfig(model, **(entries | changes))


def log(out):
    with (out / "log.csv").open(newline="") as handle:
        return list(csv.DictReader(handle))


def weights(out, name="best"):
    return Predictor.load(out / f"{name}.safetensors").model.state_dict()


def same(one, other):
    return one.keys() == other.keys() and all(torch.equal(part, other[name]) for name, part in one.items())


class Interrupted:
    """Windows; Ctrl-C comes after so many of them."""

    def __init__(self, data, reads):
        self.data = data
        self.reads = reads

    def __len__(self):
        return len(self.data)

    def __getitem__(self, i):
        self.reads -= 1
        if self.reads < 0:
            raise KeyboardInterrupt
        return self.data[i]


@pytest.mark.parametrize(
    ("model", "loss"),
    [("mlp", {}), ("pointnet", MORE), ("motion", {})],
)
def test_the_loss_falls_and_the_checkpoint_is_the_best_epoch(tmp_path, windows, scenes, model, loss):
    how = config(model, loss=loss, epochs=12, learning_rate=3e-3)
    answer = train(how, tmp_path, scenes if model == "motion" else windows)
    losses = [float(row["validation_loss"]) for row in log(tmp_path)]
    assert losses[-1] < 0.7 * losses[0]
    assert answer["validation_loss"] == min(losses)
    description = Predictor.load(answer["checkpoint"]).description
    assert description["epoch"] == answer["best_epoch"] == losses.index(min(losses))
    assert description["dataset"] == "rings"
    stored = json.loads(json.dumps(dataclasses.asdict(how)))
    assert description["config"].items() <= stored.items()
    assert {"seed", "split", "learning_rate", "threads"} < description["config"].keys()


@pytest.mark.parametrize("model", ["mlp", "motion"])
@pytest.mark.parametrize("steps", [4, 13])  # within the first epoch, and in the last
def test_interrupted_and_resumed_is_as_undisturbed(tmp_path, windows, scenes, steps, model):
    train_data, held_back, name = scenes if model == "motion" else windows
    how = config(model, loss=MORE)
    train(how, tmp_path / "whole", (train_data, held_back, name))
    reads = 16 * steps + (0 if model == "motion" else 96)  # the units are those of all windows
    with pytest.raises(KeyboardInterrupt):
        train(how, tmp_path / "parts", (Interrupted(train_data, reads), held_back, name))
    train(how, tmp_path / "parts", (train_data, held_back, name))
    assert same(weights(tmp_path / "whole"), weights(tmp_path / "parts"))
    for row, other in zip(log(tmp_path / "whole"), log(tmp_path / "parts"), strict=True):
        assert row | {"seconds": 0} == other | {"seconds": 0}


def test_early_stopping(tmp_path, windows):
    answer = train(config(epochs=50, patience=1, learning_rate=1e-9), tmp_path, windows)
    assert answer["epochs"] < 50
    assert answer["epochs"] == answer["best_epoch"] + 2


def test_what_is_no_checkpoint_of_this_training_is_not_resumed_from(tmp_path, windows):
    how = config(epochs=1)
    train(how, tmp_path, windows)
    with pytest.raises(ValueError, match=r"batch.*16.*8"):
        train(config(batch=8), tmp_path, windows)
    with pytest.raises(ValueError, match=r"dataset.*rings.*others"):
        train(how, tmp_path, (*windows[:2], "others"))
    last = tmp_path / "last.safetensors"
    whole = last.read_bytes()
    assert train(how, tmp_path, windows)["steps"] == 6  # one that has ended is left alone
    assert last.read_bytes() == whole
    with pytest.raises(ValueError, match=r"96.*128"):
        train(config(batch=128), tmp_path / "few", windows)
    last.write_bytes(whole[:-50])
    with pytest.raises(FormatError, match=r"last\.safetensors"):
        train(how, tmp_path, windows)


@pytest.mark.parametrize("model", ["mlp", "motion"])
def test_a_training_starts_from_a_checkpoint_with_other_films(tmp_path, windows, scenes, model):
    data = scenes if model == "motion" else windows
    first = train(config(model, epochs=6, learning_rate=3e-3), tmp_path / "first", data)
    # With a learning rate of next to nothing the weights are those of the start.
    still = config(model, start=first["checkpoint"], epochs=1, learning_rate=1e-12)
    more = train(still, tmp_path / "more", data)
    assert more["validation_loss"] == pytest.approx(first["validation_loss"], rel=0.01)
    afresh = config(model, epochs=1, learning_rate=3e-3)
    assert train(afresh, tmp_path / "afresh", data)["validation_loss"] > first["validation_loss"]
    assert Predictor.load(tmp_path / "more" / "best.safetensors").description["start"] == "best.safetensors"


def test_a_configuration_opens_the_windows_of_two_splits():
    shares = {"train": 0.6, "validation": 0.2, "test": 0.2}
    how = config("motion", dataset=str(ROOT / "data_small" / "motion"), split={"shares": shares}, windows={"stride": 4})
    windows = how.open_windows()
    assert min(len(windows.train), len(windows.validation)) > 0
    assert not set(windows.train.episodes) & set(windows.validation.episodes)
    assert len(windows.train[0]["cloud"]) == SHAPE.points


def test_paths_of_a_configuration_are_relative_to_it(tmp_path):
    entries = {"model": "mlp", "dataset": "data", "shape": {"slots": 2}, "loss": {"centre": 0.1}}
    (tmp_path / "a.json").write_text(json.dumps(entries))
    a = TrainConfig.load(tmp_path / "a.json")
    assert a.shape == Shape(slots=2)
    assert a.loss == {"centre": 0.1}
    assert a.dataset == str(tmp_path / "data")
    assert a.start == ""


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ('{"model": "gpt"}', "pointnet.*'gpt'"),
        ('{"model": "mlp", "epoch": 3}', "'epoch'.*epochs"),
        ('{"model": "mlp", "learning_rate": "fast"}', "learning_rate.*'fast'"),
        ('{"model": "mlp", "shape": {"slots": 0}}', r"shape\.slots"),
        ('{"model": "mlp", "threads": 1000000}', "threads"),
        ('{"model": "mlp", "threads": 0}', "threads"),
        ('{"model": "mlp", "workers": -1}', "workers"),
        ("{}", "'model'"),
    ],
)
def test_bad_configurations_are_named(tmp_path, text, named):
    path = tmp_path / "c.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=rf"c\.json.*{named}"):
        TrainConfig.load(path)


def test_a_mirrored_window_is_the_window_of_the_mirrored_scene():
    data = ring_windows(4, seed=2)
    image = torch.tensor([-1.0, 1.0, 1.0])
    window = default_collate([data[i] for i in range(4)])
    # One gripper is higher and farther ahead than the other.
    for name in ("grippers", "actions"):
        window[name] = window[name] + torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.02, 0.03]])
    mirror = mirrored(window, torch.tensor([True, False, True, False]))
    assert torch.equal(mirror["clouds"][1], window["clouds"][1])
    assert torch.equal(mirror["clouds"][0], window["clouds"][0] * image)
    for name in ("grippers", "actions"):  # which exchange their places
        assert torch.equal(mirror[name][0], window[name][0].flip(1) * image)
        assert torch.equal(mirror[name][1], window[name][1])
    again = mirrored(mirror, torch.tensor([True, False, True, False]))
    assert all(torch.equal(part, again[name]) for name, part in window.items())
    assert torch.allclose(StateTensors.from_labels(window).mean[0] * image, StateTensors.from_labels(mirror).mean[0])
    forecast, mirrored_forecast = (build("carry", SHAPE)(one).mean for one in (window, mirror))
    assert torch.allclose(forecast[2] * image, mirrored_forecast[2], atol=1e-6)


def test_it_learns_to_swing_and_how_sure_it_is(tmp_path):
    data = (ring_scenes(96, seed=0), ring_scenes(16, seed=1))
    how = config("motion", options={"width": 32}, shape=Shape(points=160), batch=8, epochs=16, learning_rate=0.01)
    train(how, tmp_path, data)
    model = Predictor.load(tmp_path / "best.safetensors").model
    test = default_collate(ring_scenes(32, seed=2).items)
    torch.manual_seed(0)
    carry = build("motion", Shape(points=160))
    torch.nn.init.zeros_(carry.out[2].weight)  # it predicts that the cloth is carried
    with torch.inference_mode():
        places, scales = model(test)
        carried, _ = carry(test)
    known = test["known"][..., None].expand(scales.shape)
    error = (places - test["future"]).norm(dim=-1)[known]
    assert error.mean() < 0.8 * (carried - test["future"]).norm(dim=-1)[known].mean()
    assert 1 < float((error / scales[known]).mean()) < 8  # of a Laplace distribution in three dimensions it is 3
