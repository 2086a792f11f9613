"""Training: the loss falls, a kill does not matter, and what does not fit is refused by name."""

from __future__ import annotations

import csv
import dataclasses
import json
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import asdict
from pathlib import Path

import pytest
import torch
from torch.utils.data import default_collate

from topokit._archive import FormatError
from topokit._config import from_mapping
from topokit.models import (
    LossWeights,
    Normalisation,
    Shape,
    TrainConfig,
    Windows,
    build,
    load_config,
    load_model,
    load_tensors,
    open_windows,
    StateTensors.from_labels,
    train,
)
from topokit.models._config import epoch_order, mirrored

from windows import POINTS, SLOTS, RingScenes, RingWindows

SHAPE = Shape(points=POINTS, slots=SLOTS)
MORE = LossWeights(centre=1.0, match=True)
ROOT = Path(__file__).parents[1]
HELD_OUT = ["backpack", "belt", "mask", "net", "scarf", "sheet", "sheet2", "shirt", "tote", "tote2", "vest"]


@pytest.fixture(scope="module")
def windows():
    return Windows(RingWindows(96, seed=0), RingWindows(24, seed=1), "rings")


@pytest.fixture(scope="module")
def scenes():
    return Windows(RingScenes(96, seed=0), RingScenes(24, seed=1), "rings")


def config(out, **changes):
    entries = {
        "model": "mlp",
        "options": {"hidden": [32, 16]},
        "shape": SHAPE,
        "batch": 16,
        "epochs": 3,
        "threads": 1,
        "out": str(out),
    }
    return TrainConfig(**(entries | changes))


def log(out):
    with (out / "log.csv").open(newline="") as handle:
        return list(csv.DictReader(handle))


@pytest.mark.parametrize(
    ("model", "options", "loss"),
    [
        ("mlp", {"hidden": [64, 32]}, LossWeights()),
        ("pointnet", {"hidden": [64, 32]}, LossWeights()),
        ("pointnet", {"hidden": [64, 32]}, MORE),
        ("motion", {"width": 16}, LossWeights()),
    ],
)
def test_the_loss_falls_and_the_checkpoint_is_the_best_epoch(tmp_path, windows, scenes, model, options, loss):
    how = config(tmp_path, model=model, options=options, loss=loss, epochs=12, learning_rate=3e-3)
    answer = train(how, scenes if model == "motion" else windows)
    rows = log(tmp_path)
    losses = [float(row["validation_loss"]) for row in rows]
    assert losses[-1] < 0.7 * losses[0]
    assert answer["validation_loss"] == min(losses)
    assert answer["finished"]
    _, description = load_model(tmp_path / "best.safetensors")
    assert description["dataset"] == "rings"
    free = {
        "workers",
        "minutes_between_checkpoints",
        "out",
        "dataset",
        "start",
        "rehearse",
        "accelerator",
    }  # no weights
    assert description["config"] == json.loads(json.dumps({k: v for k, v in asdict(how).items() if k not in free}))
    assert description["normalisation"]["scale"] > 0


@pytest.mark.parametrize("model", ["mlp", "motion"])
@pytest.mark.parametrize("stop", [4, 6, 13])  # within an epoch, at its end, in the last
def test_stopped_and_resumed_is_as_undisturbed(tmp_path, windows, scenes, stop, model):
    how = {"model": model, "options": {"width": 16} if model == "motion" else {"hidden": [16]}, "loss": MORE}
    windows = scenes if model == "motion" else windows
    whole, parts = config(tmp_path / "whole", **how), config(tmp_path / "parts", **how)
    train(whole, windows)
    assert not train(parts, windows, stop_after=stop)["finished"]
    assert train(parts, windows)["finished"]
    one, other = (load_tensors(tmp_path / name / "last.safetensors") for name in ("whole", "parts"))
    assert one[1].keys() == other[1].keys()
    assert all(torch.equal(part, other[1][name]) for name, part in one[1].items())
    drop = {"seconds"}
    for a, b in zip(log(tmp_path / "whole"), log(tmp_path / "parts"), strict=True):
        assert {k: v for k, v in a.items() if k not in drop} == {k: v for k, v in b.items() if k not in drop}


def test_other_weights_in_the_place_of_a_training_are_named(tmp_path, windows):
    how = config(tmp_path, epochs=1)
    train(how, windows)
    shutil.copy(tmp_path / "best.safetensors", tmp_path / "last.safetensors")
    with pytest.raises(FormatError, match=r"last.safetensors: not the checkpoint of a training"):
        train(how, windows)


def test_killed_and_resumed_is_as_undisturbed(tmp_path, windows):
    """SIGKILL at some moment after the first checkpoint, in a process of its own."""
    code = """
import sys
sys.path.insert(0, sys.argv[2])
import torch
torch.set_num_threads(1)
from test_models_training import config, windows
from topokit.models import train, Windows
from windows import RingWindows
train(config(sys.argv[1], epochs=8, patience=99, minutes_between_checkpoints=1e-4),
      Windows(RingWindows(96, seed=0), RingWindows(24, seed=1), "rings"))
"""
    here = str(Path(__file__).parent)
    process = subprocess.Popen([sys.executable, "-c", code, str(tmp_path / "killed"), here])
    while not (tmp_path / "killed" / "last.safetensors").exists():
        assert process.poll() is None
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        for name in ("killed", "whole"):
            answer = train(config(tmp_path / name, epochs=8, patience=99, minutes_between_checkpoints=1e-4), windows)
            assert answer["steps"] == 8 * 6
    finally:
        torch.set_num_threads(threads)
    one, other = (load_tensors(tmp_path / name / "best.safetensors")[1] for name in ("killed", "whole"))
    assert all(torch.equal(part, other[name]) for name, part in one.items())


def test_the_same_training_gives_the_same_bytes_wherever_it_is_made(tmp_path, windows):
    """In another folder, begun with another number of threads, stopped on the way."""
    made = []
    for threads, place, stop in ((1, "a", None), (4, "b/c", 4)):
        before = torch.get_num_threads()
        torch.set_num_threads(threads)
        try:
            for model, options in (("ridge", {}), ("pointnet", {"hidden": [32, 16]})):
                wanted = config(tmp_path / place / model, model=model, options=options, epochs=2)
                train(wanted, windows, stop_after=stop)
                train(wanted, windows)
                made.append((tmp_path / place / model / "best.safetensors").read_bytes())
            assert torch.get_num_threads() == threads
        finally:
            torch.set_num_threads(before)
    assert made[:2] == made[2:]


def test_seeds_differ_and_repeat(tmp_path, windows):
    weights = []
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        train(config(tmp_path / name, epochs=1, seed=seed), windows)
        weights.append(load_tensors(tmp_path / name / "best.safetensors")[1]["model.rest.1.weight"])
    assert torch.equal(weights[0], weights[1])
    assert not torch.equal(weights[0], weights[2])


def test_early_stopping(tmp_path, windows):
    answer = train(config(tmp_path, epochs=50, patience=1, learning_rate=1e-9), windows)
    assert answer["finished"]
    assert answer["epochs"] < 50
    assert answer["epochs"] == answer["best_epoch"] + 2


def test_a_finished_training_is_left_alone(tmp_path, windows):
    first = train(config(tmp_path), windows)
    before = (tmp_path / "last.safetensors").read_bytes()
    assert train(config(tmp_path), windows) == first
    assert (tmp_path / "last.safetensors").read_bytes() == before


def test_another_configuration_or_dataset_is_refused(tmp_path, windows):
    train(config(tmp_path), windows, stop_after=2)
    with pytest.raises(ValueError, match=r"holds a training with batch = 16, the configuration says 8"):
        train(config(tmp_path, batch=8), windows)
    with pytest.raises(ValueError, match="another dataset"):
        train(config(tmp_path), Windows(windows.train, windows.validation, "others"))


def test_a_damaged_checkpoint_is_not_resumed_from(tmp_path, windows):
    train(config(tmp_path), windows, stop_after=2)
    path = tmp_path / "last.safetensors"
    path.write_bytes(path.read_bytes()[:-50])
    with pytest.raises(ValueError, match="truncated or damaged"):
        train(config(tmp_path), windows)


def test_ridge_is_solved_in_one_pass(tmp_path, windows):
    answer = train(config(tmp_path, model="ridge", options={"penalty": 1.0}), windows)
    assert answer["finished"]
    model, _ = load_model(tmp_path / "best.safetensors")
    assert model.coefficients.abs().sum() > 0


@pytest.mark.parametrize(("model", "options"), [("mlp", {"hidden": [32, 16]}), ("motion", {"width": 16})])
def test_a_training_goes_on_from_a_checkpoint_with_other_films(tmp_path, windows, scenes, model, options):
    data = scenes if model == "motion" else windows
    how = {"model": model, "options": options, "learning_rate": 3e-3}
    first = train(config(tmp_path / "first", **how, epochs=6), data)
    more = config(tmp_path / "more", **how, start=first["checkpoint"], epochs=1)
    more = dataclasses.replace(more, learning_rate=1e-12)  # nothing is learned: the weights are those of the start
    assert train(more, data)["validation_loss"] == pytest.approx(first["validation_loss"], rel=0.01)
    assert train(config(tmp_path / "afresh", **how, epochs=1), data)["validation_loss"] > first["validation_loss"]
    assert load_model(tmp_path / "more" / "best.safetensors")[1]["start"] == "best.safetensors"
    with pytest.raises(ValueError, match="its options is"):
        train(config(tmp_path / "other", **{**how, "options": {}}, start=first["checkpoint"]), data)


def test_few_films_are_learned_beside_those_that_the_start_knows(tmp_path):
    shares = {"train": 0.6, "validation": 0.2, "test": 0.2}
    entries = {"model": "motion", "dataset": str(ROOT / "data_small" / "motion"), "split": {"shares": shares}}
    (tmp_path / "old.json").write_text(json.dumps(entries))
    entries |= {"split": {"shares": shares, "seed": 4, "held_out": HELD_OUT}, "windows": {"stride": 4}}
    (tmp_path / "new.json").write_text(json.dumps(entries | {"rehearse": "old.json"}))
    with pytest.raises(ValueError, match=r"old\.json: cannot be rehearsed, its windows is not that"):
        open_windows(TrainConfig.load(tmp_path / "new.json"))
    (tmp_path / "old.json").write_text(json.dumps({**entries, "split": {"shares": shares}}))
    both = open_windows(TrainConfig.load(tmp_path / "new.json"))
    new, old = (
        open_windows(TrainConfig(**{**entries, "split": split})) for split in (entries["split"], {"shares": shares})
    )
    n = len(new.train)
    assert len(both.train) == 2 * n > 0
    assert len(both.validation) == len(new.validation)
    assert torch.equal(both.train[n - 1]["cloud"], new.train[n - 1]["cloud"])
    assert torch.equal(both.train[2 * n - 1]["cloud"], old.train[(n - 1) * len(old.train) // n]["cloud"])
    assert both.checksum == new.checksum + old.checksum


def test_every_window_once_an_epoch_and_another_order_the_next():
    first, second = (epoch_order(10, None, 0, epoch) for epoch in (0, 1))
    assert sorted(first) == sorted(second) == list(range(10))
    assert first != second
    assert epoch_order(10, 8, 0, 0) == first[:8]


def test_too_little_data(tmp_path, windows):
    with pytest.raises(ValueError, match=r"96 windows to train on .* a batch has 128"):
        train(config(tmp_path, batch=128), windows)


def test_load_config(tmp_path):
    entries = {"model": "mlp", "dataset": "data", "shape": {"slots": 2}, "loss": {"centre": 0.1}}
    (tmp_path / "a.json").write_text(json.dumps(entries))
    a = TrainConfig.load(tmp_path / "a.json")
    assert a.shape == Shape(slots=2)
    assert a.dataset == str(tmp_path / "data")
    assert from_mapping(TrainConfig, json.loads(json.dumps(asdict(a))), "c") == a


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "not JSON"),
        ("[]", "an object with named entries"),
        ('{"model": "gpt"}', "model must be one of hold, carry, ridge, mlp, pointnet, motion, not 'gpt'"),
        ('{"model": "mlp", "epoch": 3}', "there is no 'epoch'; there are .*epochs"),
        ('{"model": "mlp", "batch": 0}', "batch: .* greater than or equal to 1, not 0"),
        ('{"model": "mlp", "learning_rate": "fast"}', "learning_rate: .* valid number, not 'fast'"),
        ('{"model": "mlp", "shape": {"slots": 0}}', r"shape\.slots: .* greater than or equal to 1"),
        ('{"model": "mlp", "loss": {"centre": -1}}', r"loss\.centre: .* greater than or equal to 0"),
        ("{}", "'model' is missing"),
    ],
)
def test_bad_configurations_are_named(tmp_path, text, says):
    path = tmp_path / "c.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=rf"c\.json.*{says}"):
        TrainConfig.load(path)


def test_a_mirrored_window_is_the_window_of_the_mirrored_scene():
    data = RingWindows(4, seed=2)
    window = default_collate([data[i] for i in range(4)])
    which = torch.tensor([True, False, True, False])
    mirror = mirrored(window, which)
    assert torch.equal(mirror["clouds"][1], window["clouds"][1])
    assert torch.equal(mirror["clouds"][0, ..., 0], -window["clouds"][0, ..., 0])
    assert torch.equal(mirror["actions"][2, :, 0, 1:], window["actions"][2, :, 1, 1:])
    again = mirrored(mirror, which)
    assert all(torch.equal(part, again[name]) for name, part in window.items())
    one, other = StateTensors.from_labels(window), StateTensors.from_labels(mirror)
    assert torch.allclose(one.mean[0] * torch.tensor([-1.0, 1, 1]), other.mean[0])
    carried = (build("carry", SHAPE, Normalisation())(w).mean for w in (window, mirror))
    assert torch.allclose(next(carried)[2] * torch.tensor([-1.0, 1, 1]), next(carried)[2], atol=1e-6)


def test_the_mirror_exchanges_the_grippers_and_their_targets():
    data, image = RingWindows(2, seed=2), torch.tensor([-1.0, 1, 1])
    window = default_collate([data[i] for i in range(2)])
    for name in ("grippers", "actions"):  # one is higher and farther ahead than the other
        window[name] = window[name] + torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.02, 0.03]])
    mirror = mirrored(window, torch.tensor([True, False]))
    for name in ("grippers", "actions"):
        assert torch.equal(mirror[name][0, :, 0], window[name][0, :, 1] * image)
        assert torch.equal(mirror[name][0, :, 1], window[name][0, :, 0] * image)
        assert torch.equal(mirror[name][1], window[name][1])


def test_mixed_precision_learns_from_exact_coordinates(tmp_path, windows):
    """Targets are not rounded: the loss is about that of 32 bits."""
    losses = []
    for precision in ("32-true", "bf16-mixed"):
        how = {"model": "pointnet", "options": {"hidden": [16]}, "loss": MORE, "epochs": 1}
        losses.append(train(config(tmp_path / precision, precision=precision, **how), windows)["validation_loss"])
    assert losses[0] != losses[1]
    assert abs(losses[0] - losses[1]) < 0.05 * losses[0]
