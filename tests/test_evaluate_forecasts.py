"""A whole evaluation, from `data_small`: what it says, what it refuses, that it goes on; its windows; its report."""

from __future__ import annotations

import dataclasses
import json
import shutil
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import topokit
from topokit import cli, track
from topokit._archive import FormatError
from topokit._config import from_mapping
from topokit.data import Dataset, WindowDataset
from topokit.evaluate import (
    Clouds,
    Condition,
    EvaluationConfig,
    _forecasts,
    distance_to_hull,
    evaluate_forecasts,
    library_digest,
    load_evaluation,
    read_results,
    true_loops,
    write_report,
)
from topokit.evaluate._conditions import prepare_condition, spoilt_observer, spread_windows, true_curves
from topokit.evaluate._summary import steps_of
from topokit.io import load_episode
from topokit.models import Predictor, Shape, TrainConfig, build, train

from conftest import DATA
from small_datasets import part_of

SMALL = DATA / "data" if not (DATA / "dataset").is_dir() else DATA / "dataset"
SHARES = {"train": 0.4, "validation": 0.2, "test": 0.4}
SPLIT = {"seed": 1, "shares": SHARES}
MODELS = ("ridge", "mlp", "pointnet", "motion")


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    return Dataset(SMALL)


def trained(out: Path, model: str = "mlp", seed: int = 0, split: dict[str, Any] = SPLIT, **windows: Any) -> TrainConfig:
    """Train a model for a few steps; its best weights are in `out`."""
    config = TrainConfig(
        model=model,
        dataset=str(SMALL),
        out=str(out),
        split=split,
        windows=windows,
        seed=seed,
        batch=8,
        epochs=1,
        windows_per_epoch=16,
        validation_windows=8,
    )
    train(config)
    return config


@pytest.fixture(scope="module")
def checkpoints(tmp_path_factory) -> dict[str, list[str]]:
    """Every model after a few steps; the MLP under two seeds."""
    out, paths = tmp_path_factory.mktemp("runs"), {}
    for model in MODELS:
        for seed in range(2 if model == "mlp" else 1):
            where = out / f"{model}_{seed}"
            trained(where, model, seed)
            paths.setdefault(model, []).append(str(where / "best.safetensors"))
    return paths


def evaluation(conditions: list[dict[str, Any]], **more: Any) -> EvaluationConfig:
    entries = {"dataset": str(SMALL), "models": {}, "conditions": conditions, "samples": 100, "ours": "carry"}
    return from_mapping(EvaluationConfig, entries | more, "the evaluation")


@pytest.fixture(scope="module")
def results(checkpoints, tmp_path_factory) -> tuple[dict[str, Any], Path]:
    """Two conditions, all models."""
    path = tmp_path_factory.mktemp("results") / "evaluation.json"
    config = evaluation(
        [
            {"name": "held out", "split": SPLIT, "windows": 4},
            {"name": "noisy", "split": SPLIT, "windows": 2, "clouds": {"noise": 0.005}},
        ],
        models=checkpoints,
        ours="motion",
    )
    return evaluate_forecasts(config, out=path, clips=path.parent / "clips"), path


# -- what it says -----------------------------------------------------------------------------------------------------------


def test_the_file_has_the_form_that_was_agreed(results):
    made, path = results
    assert read_results(path) == json.loads(path.read_text()) == made
    assert made["complete"]
    assert made["ours"] == "motion"
    assert list(made["hull_accuracy"]) == ["seqph", "hold", "carry", "ridge", "mlp", "pointnet", "ours"]
    for condition in made["conditions"].values():
        for cells in condition["hull_accuracy"].values():
            assert list(cells) == ["1", "15", "30", "60", "mean"]
            for cell in cells.values():
                assert 0 <= cell["low"] <= cell["mean"] <= cell["high"] <= 1
                assert 0 < cell["n"] <= condition["windows"]  # no more than have a true loop there
    first = made["conditions"]["held out"]
    assert made["hull_accuracy"] == first["hull_accuracy"]
    assert first["dataset"]["sha256"] == Dataset(SMALL).checksum()
    assert [one["seed"] for one in first["checkpoints"]["mlp"]] == [0, 1]
    assert len(first["by_seed"]["mlp"]["60"]) == 2
    assert str(path.parent) not in path.read_text()


def test_a_measure_can_be_told_from_the_next(results):
    """Orders that hold whatever the small models have learned."""
    table = results[0]["conditions"]["held out"]

    def of(measure: str, model: str, horizon: str = "60") -> float:
        return table[measure][model][horizon]["mean"]

    assert of("hull_accuracy", "seqph", "1") > 0.4
    assert of("hull_accuracy", "hold") < of(
        "hull_accuracy", "carry"
    )  # all garments are carried away from where they were
    assert of("distance_cm", "hold") > of("distance_cm", "carry") > of("distance_cm", "seqph") - 3
    for place in ("in_plane", "in_opening"):
        assert of(place, "hold") < of(place, "carry")
        assert of(place, "seqph") > 0.5
    assert of("nll_median", "hold") > of("nll_median", "seqph")
    assert of("cover90", "hold") < of("cover90", "seqph")
    assert of("cover50", "seqph") < of("cover90", "seqph")
    assert of("presence", "seqph") == 1  # the labels against themselves
    assert of("brier", "seqph") < 0.001 < of("brier", "hold")
    for event in ("opens", "closes"):
        assert table[f"{event}_precision"]["hold"]["60"]["mean"] is None  # who holds, or carries, forecasts no event
        assert table[f"{event}_precision"]["carry"]["60"]["mean"] is None
        assert table[f"{event}_recall"]["hold"]["60"]["mean"] in (None, 0)
    assert of("identity", "seqph", "1") == 1


def test_more_tolerance_is_never_worse(results):
    table = results[0]["conditions"]["held out"]
    ways = table["hull_treatments"]
    assert (ways["in the plane"], ways["in the opening"]) == (table["in_plane"], table["in_opening"])
    for model in ways["within 0 cm"]:
        values = [
            ways[f"within {tolerance} cm"][model][key]["mean"]
            for key in ("1", "60")
            for tolerance in (0, 1, 2, 3, 5, 10)
        ]
        assert values[:6] == sorted(values[:6])
        assert values[6:] == sorted(values[6:])
        assert ways["within 2 cm"][model] == results[0]["hull_accuracy"][model]


def test_outcomes_add_up(results):
    for models in (condition["outcomes"] for condition in results[0]["conditions"].values()):
        for steps in models.values():
            assert all(sum(shares.values()) == pytest.approx(1, abs=2e-3) for shares in steps.values())


def test_a_gain_is_a_difference(results):
    table = results[0]["conditions"]["held out"]
    for model, cells in table["gain_of_ours"].items():
        other = table["hull_accuracy"][model]["60"]["mean"]
        assert cells["60"]["mean"] == pytest.approx(table["hull_accuracy"]["ours"]["60"]["mean"] - other, abs=2e-4)


def test_failures_can_be_looked_at(results, dataset):
    made, path = results
    listed = made["conditions"]["held out"]["failures"]
    assert 0 < len(listed) <= 6  # after a few steps nothing is learned yet
    assert listed == sorted(listed, key=lambda one: -one["outside_cm"]["ours"])
    for number, failure in enumerate(listed):
        clip = load_episode(path.parent / "clips" / f"forecast_{number}.npz")
        whole = dataset[failure["episode"]]
        frame = failure["frame"] + failure["step"]
        assert np.allclose(clip.points[1], whole.points[frame], atol=1e-4)  # 16 bits
        assert clip.garment == failure["garment"]
        hulls = [whole.points[frame][loop] for loop in whole.loops]
        if len(hulls) == 1:
            outside = distance_to_hull(failure["forecasts"]["ours"][0]["mean"], hulls[0])
            assert 100 * outside == pytest.approx(failure["outside_cm"]["ours"], abs=0.1)
    assert made["conditions"]["noisy"]["failures"] == []


def test_noise_spoils_the_tracker_too(results):
    clean, noisy = results[0]["conditions"].values()
    assert noisy["states_of_seqph_hold_carry_ridge"] == "tracked on the spoilt clouds"
    assert noisy["presence"]["seqph"]["mean"]["mean"] < clean["presence"]["seqph"]["mean"]["mean"]


def forecasts_of(prepared) -> dict[str, torch.Tensor]:
    """(K, S, 3) what each forecaster says of the first window."""
    window = torch.utils.data.default_collate([prepared.observed[0]])
    with torch.inference_mode():
        return {name: found[0](window).mean[0] for name, found in prepared.forecasters.items()}


def test_a_turned_scene_is_the_same_to_all_but_those_who_know_places_by_heart(checkpoints, tmp_path):
    paths = {name: checkpoints[name][:1] for name in ("mlp", "motion")}
    films = {"name": "x", "dataset": str(DATA / "motion"), "part": "all", "shares_no_episode": True, "windows": 1}
    films |= {"garments": ["apron"]}
    config = evaluation([films, films | {"name": "turned", "turned": 70.0}], models=paths, ours="motion")
    one, turned = (forecasts_of(prepare_condition(config, condition, tmp_path)) for condition in config.conditions)
    for name in ("seqph", "hold", "carry"):
        assert torch.allclose(one[name], turned[name], atol=1e-4)
    steps = [step - 1 for step in steps_of(60)]
    assert torch.allclose(one["ours"][steps, 0], turned["ours"][steps, 0], atol=1e-3)
    assert (one["mlp"] - turned["mlp"]).norm(dim=-1).mean() > 0.02


def test_plans_on_and_off_the_script_are_told_apart(tmp_path):
    films, dataset = {"dataset": str(DATA / "motion"), "part": "all"}, Dataset(DATA / "motion")
    plans = ("all", "script", "off script")
    config = evaluation([films | {"name": name, "plans": name} for name in plans])
    found = [prepare_condition(config, condition, tmp_path).clean.episodes.tolist() for condition in config.conditions]
    assert sorted(found[1] + found[2]) == found[0]
    assert found[1]
    assert all(("path" in dataset.record(number).physics) for number in found[2])


# -- going on ---------------------------------------------------------------------------------------------------------------


def test_it_goes_on_where_it_was_stopped(tmp_path, monkeypatch):
    path, real = tmp_path / "r.json", _forecasts._measured
    config = evaluation(
        [
            {"name": "one", "part": "all", "garments": ["mask"], "windows": 2},
            {"name": "two", "part": "all", "garments": ["sheet"], "windows": 2},
        ]
    )

    def stopped(config, condition, *arguments):
        if condition.name == "two":
            raise KeyboardInterrupt
        return real(config, condition, *arguments)

    monkeypatch.setattr(_forecasts, "_measured", stopped)
    with pytest.raises(KeyboardInterrupt):
        evaluate_forecasts(config, out=path)
    assert list(read_results(path)["conditions"]) == ["one"]
    assert not read_results(path)["complete"]
    ran = []
    monkeypatch.setattr(_forecasts, "_measured", lambda *given: ran.append(given[1].name) or real(*given))
    whole = evaluate_forecasts(config, out=path)
    assert ran == ["two"]
    assert whole == evaluate_forecasts(config)  # the same as in one go
    other = dataclasses.replace(config, tolerance=0.05)
    ran.clear()
    evaluate_forecasts(other, out=path)
    assert ran == ["one", "two"]  # made from something else: made again


# -- what it refuses --------------------------------------------------------------------------------------------------------


def test_it_refuses_episodes_that_a_model_was_trained_on(checkpoints):
    for part in ("train", "validation", "all"):
        config = evaluation([{"name": "x", "split": SPLIT, "part": part}], models={"mlp": checkpoints["mlp"][:1]})
        with pytest.raises(ValueError, match=r"x.*was trained on this dataset.*training or validation part"):
            evaluate_forecasts(config)
    word = {"name": "x", "split": SPLIT, "part": "train", "shares_no_episode": True}
    with pytest.raises(ValueError, match="was trained on this dataset"):  # no word helps against the checksum
        evaluate_forecasts(evaluation([word], models={"mlp": checkpoints["mlp"][:1]}))


def test_no_order_of_the_shares_hides_a_leak(tmp_path):
    """A checkpoint stores its configuration with sorted names: the parts must not depend on their order."""
    other = {"seed": 1, "shares": {name: SHARES[name] for name in ("test", "train", "validation")}}
    config = trained(tmp_path, split=other)
    models = {"mlp": [str(tmp_path / "best.safetensors")]}
    windows = config.open_windows()
    learned = {*windows.train.index[:, 0].tolist(), *windows.validation.index[:, 0].tolist()}
    for split in (SPLIT, other):
        for part in ("train", "validation"):
            with pytest.raises(ValueError, match=r"was trained on this dataset.*training or validation part"):
                evaluate_forecasts(evaluation([{"name": "x", "split": split, "part": part}], models=models))
        condition = evaluation([{"name": "x", "split": split, "windows": 1}], models=models)
        prepared = prepare_condition(condition, condition.conditions[0], tmp_path)
        assert not learned & set(prepared.observed.index[:, 0].tolist())


def test_it_is_wary_of_another_dataset(checkpoints, dataset, tmp_path):
    parts = dataset.split(**SPLIT)
    cut = part_of(dataset, [*parts["train"][:2], *parts["test"][:2]], tmp_path / "cut")
    models = {"mlp": checkpoints["mlp"][:1]}
    bare = {"name": "x", "dataset": str(tmp_path / "cut"), "windows": 1}
    with pytest.raises(ValueError, match=r"checksum.*shares_no_episode"):
        evaluate_forecasts(evaluation([bare | {"part": "all"}], models=models))
    with pytest.warns(UserWarning, match="another checksum"):
        made = evaluate_forecasts(evaluation([bare | {"split": SPLIT}], models=models))
    assert made["conditions"]["x"]["episodes"] == 2
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        evaluate_forecasts(evaluation([bare | {"part": "all", "shares_no_episode": True}], models=models))
    assert len(cut) == 4


def test_it_says_when_a_model_has_learned_the_order_of_the_mesh(checkpoints, tmp_path):
    def prepare(path: str) -> None:
        config = evaluation([{"name": "x", "split": SPLIT, "windows": 1}], models={"mlp": [path]})
        prepare_condition(config, config.conditions[0], tmp_path)

    trained(tmp_path, resampled=False)
    with pytest.warns(UserWarning, match=r"best\.safetensors was trained with resampled=False"):
        prepare(str(tmp_path / "best.safetensors"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        prepare(checkpoints["mlp"][0])


def test_it_refuses_checkpoints_that_do_not_fit(checkpoints, tmp_path):
    def refused(models: dict[str, list[str]], error: type[Exception], match: str, **more: Any) -> None:
        condition = {"name": "x", "split": SPLIT, "windows": 1}
        with pytest.raises(error, match=match):
            evaluate_forecasts(evaluation([condition], models=models, **more), tmp_path)

    mlp = checkpoints["mlp"][0]
    refused({"mlp": ["gone.safetensors"]}, FileNotFoundError, r"gone\.safetensors: there is no such file")
    refused({"pointnet": [mlp]}, ValueError, "a checkpoint of 'mlp', listed under 'pointnet'")
    refused({"mlp": [mlp, mlp]}, ValueError, "the same weights twice")
    shutil.copy(mlp, tmp_path / "damaged.safetensors")
    with (tmp_path / "damaged.safetensors").open("r+b") as handle:
        handle.truncate(1000)
    refused({"mlp": ["damaged.safetensors"]}, FormatError, "damaged")
    shape = Shape(history=8, horizon=30, points=64)
    Predictor(build("mlp", shape)).save(tmp_path / "short.safetensors")
    refused({"mlp": ["short.safetensors"]}, ValueError, "windows of another shape: history 8, horizon 30, points 64")


def test_it_refuses_conditions_without_windows(tmp_path, dataset):
    def refused(error: type[Exception], match: str, **entries: Any) -> None:
        with pytest.raises(error, match=match):
            evaluate_forecasts(evaluation([{"name": "x", "windows": 1, **entries}]), tmp_path)

    refused(FileNotFoundError, "labels 'camera'; it has", labels="camera")
    refused(ValueError, "no garment 'glove'.*it has apron", garments=["glove"])
    refused(ValueError, "no part 'exam'; it has train, validation, test, all", part="exam")
    refused(FileNotFoundError, "nowhere", dataset="nowhere")
    refused(ValueError, "condition 'x': split .*'seeds'", split={"seeds": 1})
    refused(ValueError, "condition 'x': split .*by must be", split={"by": "hand"})
    numbers = dataset.episodes[:2]
    cut = part_of(dataset, numbers, tmp_path / "cut")
    shutil.rmtree(tmp_path / "cut" / "labels")
    assert len(cut) == 2
    refused(FileNotFoundError, "topokit label makes them", dataset="cut", part="all")


@pytest.mark.parametrize(
    ("entries", "match"),
    [
        ({"conditions": [{"name": "x", "tolerant": 1}]}, "there is no 'conditions.0.tolerant'"),
        ({"conditions": []}, "conditions: .* at least 1 item"),
        ({"conditions": [{"name": "x"}, {"name": "x"}]}, "two conditions are called 'x'"),
        ({"conditions": [{"garments": ["apron"]}]}, "'conditions.0.name' is missing"),
        ({"conditions": [{"name": ""}]}, "conditions.0.name: .* at least 1 character"),
        ({"conditions": [{"name": "x", "garments": []}]}, "conditions.0.garments: .* at least 1 item"),
        ({"conditions": [{"name": "x", "windows": 0}]}, "conditions.0.windows: .* greater than or equal to 1, not 0"),
        ({"conditions": [{"name": "x", "windows": True}]}, "conditions.0.windows: .* not True"),
        ({"conditions": [{"name": "x", "clouds": {"keep": 2}}]}, "conditions.0.clouds.keep: .* equal to 1, not 2"),
        ({"conditions": [{"name": "x", "clouds": {"keep": 0}}]}, "conditions.0.clouds.keep: .* than 0, not 0"),
        ({"conditions": [{"name": "x", "clouds": {"outliers": 1}}]}, "conditions.0.clouds.outliers: .* less than 1"),
        ({"conditions": [{"name": "x", "clouds": {"fog": 1}}]}, "there is no 'conditions.0.clouds.fog'"),
        ({"conditions": [{"name": "x", "models": {"carry": ["a"]}}]}, "conditions.0.models: carry needs no checkpoint"),
        ({"models": {"hold": ["a"]}}, "models: hold needs no checkpoint"),
        ({"models": {"mlp": "a"}}, "models.mlp: .* array, not 'a'"),
        ({"models": {"mlp": []}}, "models.mlp: .* at least 1 item"),
        ({"samples": 1}, "samples: .* 2, not 1"),
        ({"tolerance": -1}, "tolerance: .* not -1"),
        ({"shape": {"history": 0}}, "shape.*history.* not 0"),
    ],
)
def test_a_wrong_configuration_says_what_is_wrong(entries, match, tmp_path):
    path = tmp_path / "evaluation.json"
    whole = {"dataset": "d", "models": {}, "conditions": [{"name": "x"}], **entries}
    path.write_text(json.dumps(whole))
    with pytest.raises(ValueError, match=match) as caught:
        load_evaluation(path)
    assert str(path) in str(caught.value)


def test_the_committed_evaluation_is_a_good_one():
    config, folder = load_evaluation(DATA.parent / "book" / "motion.json")
    assert config.ours in config.models
    assert all((folder / path).is_file() for path in config.models[config.ours])  # its rivals are made by the commands
    names = [condition.name for condition in config.conditions]
    chapter = {"aprons", "script", "off script", "turned by 70 degrees", "500 observed points"}  # asked for by name
    assert names[0] == "all garments"  # whose hulls are treated in several ways
    assert chapter <= set(names)


def test_learning_rates_of_the_rivals_are_those_that_validation_chose():
    folder = DATA.parent / "book" / "same_films"
    for model, losses in json.loads((folder / "rates.json").read_text()).items():
        config = json.loads((folder / f"{model}.json").read_text())
        assert config["learning_rate"] == float(min(losses, key=losses.get))
        assert len(losses) == 3


def test_the_readme_says_what_the_results_say():
    """Its table, line by line: means over the horizons, in per cent."""
    results = read_results(DATA.parent / "book" / "results" / "motion.json")
    lines = (DATA.parent / "README.md").read_text().split("<!-- book/results/motion.json -->")[1].strip().splitlines()
    shown = [cell.strip() for cell in lines[0].strip("|").split("|")]
    models = [{"Motion": "ours"}.get(name, name.lower()) for name in shown[1:]]
    said = {row[0].strip(): [int(cell) for cell in row[1:]] for row in (x.strip("|").split("|") for x in lines[2:])}
    conditions = results["conditions"]
    whole = conditions["all garments"]["hull_treatments"]
    found = {name: table["hull_accuracy"] for name, table in conditions.items()}
    found["all garments, strict"] = whole["marked curve alone, within 0 cm"]
    found["all garments, any curve of the class"] = whole["any curve of the class, within 1 cm"]
    assert said == {
        name: [round(100 * rows[model]["mean"]["mean"]) for model in models] for name, rows in found.items()
    }


# -- windows ----------------------------------------------------------------------------------------------------------------


def test_windows_are_spread_over_episodes(dataset):
    windows = WindowDataset(dataset)
    rows = spread_windows(windows, 12)
    record = dataset.record
    for garment in {record(i).garment for i in windows.index[:, 0]}:
        own = [i for i in rows if record(windows.index[i, 0]).garment == garment]
        episodes = {int(windows.index[i, 0]) for i in own}
        there = {int(i) for i in windows.episodes if record(i).garment == garment}
        assert len(own) == len(set(own)) == 12
        assert episodes == there or len(there) > 12
    assert len(spread_windows(windows, 10**6)) == len(windows)


def test_true_loops_are_those_of_the_window(dataset):
    windows, steps = WindowDataset(dataset), (1, 30, 60)
    rows = np.array([0, len(windows) // 2, len(windows) - 1])
    for row, curves in zip(rows, true_curves(windows, rows, steps), strict=True):
        truth = windows.true_loops(int(row))
        assert len(curves.curves) == len(truth)
        for mine, true in zip(curves.curves, truth, strict=True):
            assert np.array_equal(mine, true[np.array(steps) - 1])
        number, frame = windows.index[row].tolist()
        film = dataset[number]
        for k, step in enumerate(steps):  # which loops are there, and what ends them
            (expected,) = true_loops(film.points[[frame + step]], film.loops)
            assert [present[k] for present in curves.present] == expected.present.tolist()
            ends = film.points[frame + step][expected.killers]
            assert np.allclose([edge[k] for edge in curves.closing], ends)
    assert steps_of(60)[:3] == (1, 5, 10)


def test_baselines_are_tracked_on_what_the_networks_see(dataset):
    number = next(r.episode for r in dataset.records if r.garment == "mask")  # 128 points show its loops
    windows, again = (WindowDataset(dataset, [number], observe=spoilt_observer(Clouds(keep=0.5), 3)) for _ in range(2))
    window = windows[5]
    assert all(torch.equal(window[name], again[5][name]) for name in window)
    assert torch.equal(window["clouds"][:, :64], window["clouds"][:, 64:])  # half the points, twice
    noisy = WindowDataset(dataset, [number], observe=spoilt_observer(Clouds(keep=0.5, noise=0.005), 3))[5]
    assert noisy["clouds"][:, 64:].equal(noisy["clouds"][:, :64])  # a point that is kept is seen once
    assert not noisy["clouds"].equal(window["clouds"])
    other = WindowDataset(dataset, [number], observe=spoilt_observer(Clouds(keep=0.5), 4))[5]
    assert not other["clouds"].equal(window["clouds"])
    as_it_is = WindowDataset(dataset, [number], observe=spoilt_observer(Clouds(), 3))
    window = as_it_is[0]  # of the episode's first frames
    assert window["clouds"].equal(WindowDataset(dataset, [number])[0]["clouds"])
    states = track(window["clouds"].double().numpy(), n_jobs=1)
    assert any(states)
    for state, death, present in zip(states, window["past_death"], window["past_present"], strict=True):
        expected = sorted((loop.death for loop in state.loops), reverse=True)
        found = sorted(death[present].tolist(), reverse=True)
        assert len(found) == min(len(expected), 4)
        assert set(np.round(found, 5)) <= set(np.round(expected, 5))


# -- the code ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("module", "old", "new"),
    [
        ("evaluate/_tracking.py", "if scale == 0.0:", "if scale <= 0.0:"),  # in distance_to_hull
        ("seqph/_tracker.py", "options: ", None),
        ("seqph/_tracker.py", "next_id + 1, None", "next_id + 2, None"),
        ("seqph/_matching.py", "2 * alpha + epsilon", "3 * alpha + epsilon"),
        ("models/_states.py", "clamp_min(1e-9)", "clamp_min(1e-6)"),
        ("sim/_camera.py", "_MARGIN = 0.1", "_MARGIN = 0.2"),
    ],
)
def test_results_of_other_code_are_stale_and_words_do_not_count(module, old, new, tmp_path):
    """Any line of the library that numbers can depend on changes its digest; docstrings and comments do not."""
    package = tmp_path / "topokit"
    shutil.copytree(Path(topokit.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    path = package / module
    text = path.read_text()
    assert old in text
    if new is None:
        path.write_text(
            '"""Other words."""  # and a comment\n' + text.split('"""', 2)[2].replace("Parameters\n", "Given\n")
        )
        (package / "view" / "_plots.py").write_text("nothing = 0\n")
        assert library_digest(package) == library_digest()
    else:
        path.write_text(text.replace(old, new))
        assert library_digest(package) != library_digest()


# -- the commands -----------------------------------------------------------------------------------------------------------


def test_report_is_made_of_the_file_alone(results, tmp_path):
    files = write_report(results[1], tmp_path / "a")
    assert [path.name for path in files] == [
        "tables.md",
        "hull_accuracy.svg",
        "distance.svg",
        "conditions.svg",
        "treatments.svg",
    ]
    text = files[0].read_text()
    assert all(f"]({path.name})" in text for path in files[1:])
    cell = results[0]["hull_accuracy"]["carry"]["60"]
    line = next(line for line in text.splitlines() if line.startswith("| carry"))
    assert f"{100 * cell['mean']:.1f} [{100 * cell['low']:.1f}, {100 * cell['high']:.1f}]" in line
    assert "topokit evaluate" not in text  # the command was not known
    again = write_report(results[1], tmp_path / "b")
    assert [path.read_bytes() for path in files] == [path.read_bytes() for path in again]
    old = json.loads(results[1].read_text())
    del old["conditions"]["held out"]["in_plane"]
    (tmp_path / "old.json").write_text(json.dumps(old))
    assert (
        "in the outline" not in write_report(tmp_path / "old.json", tmp_path / "c")[0].read_text().split("## Noisy")[0]
    )
    with pytest.raises(FormatError, match="no results of topokit evaluate"):
        write_report(DATA / "manifest.json", tmp_path / "c")


def test_commands(tmp_path, capsys):
    condition = {"name": "masks", "part": "all", "garments": ["mask"], "windows": 2}
    given = tmp_path / "evaluation.json"
    given.write_text(json.dumps({"dataset": str(SMALL), "models": {}, "conditions": [condition], "samples": 50}))
    out = tmp_path / "results.json"
    assert cli.main(["evaluate", str(given), "--out", str(out), "--json", "--threads", "1"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["hull_accuracy"]["seqph"]["1"]["n"] == 2
    assert read_results(out)["commands"] == [f"topokit evaluate {given} --out {out}"]
    assert cli.main(["report", str(out), "--out", str(tmp_path / "report")]) == 0
    assert "tables.md" in capsys.readouterr().out
    assert cli.main(["evaluate", str(given), "--out", str(given)]) == 2
    assert cli.main(["evaluate", str(tmp_path / "none.json"), "--out", str(out)]) == 2
    assert "there is no such file" in capsys.readouterr().err
    assert Condition("x").part == "test"


def test_an_interrupt_in_compiled_code_is_one(tmp_path, monkeypatch, capsys):
    given = tmp_path / "evaluation.json"
    given.write_text(json.dumps({"dataset": str(SMALL), "models": {}, "conditions": [{"name": "x", "part": "all"}]}))

    def stopped(*_: object) -> None:
        raise SystemError("returned a result with an exception set") from KeyboardInterrupt()

    def broken(*_: object) -> None:
        raise SystemError("broken")

    monkeypatch.setattr(_forecasts, "_measured", stopped)
    assert cli.main(["evaluate", str(given), "--out", str(tmp_path / "r.json")]) == 130
    assert "the same command goes on" in capsys.readouterr().err
    monkeypatch.setattr(_forecasts, "_measured", broken)
    with pytest.raises(SystemError, match="broken"):
        cli.main(["evaluate", str(given), "--out", str(tmp_path / "r.json")])


@pytest.mark.parametrize(
    "content",
    [
        {},
        {"conditions": {}},
        {"conditions": []},
        {"conditions": {"one": {}}, "horizons": ["15"]},
        {"conditions": {"one": {"hull_accuracy": {"ours": 3}}}, "horizons": 15},
    ],
)
def test_results_with_a_part_missing_say_so(tmp_path, content):
    (tmp_path / "r.json").write_text(json.dumps({"kind": "topokit-evaluation", **content}))
    with pytest.raises(FormatError, match=r"r\.json: a part is missing or of another kind"):
        write_report(tmp_path / "r.json", tmp_path / "out")


def test_results_too_deep_to_read_are_refused(tmp_path):
    (tmp_path / "r.json").write_text("[" * 100_000)
    with pytest.raises(FormatError, match="holds no results"):
        read_results(tmp_path / "r.json")
