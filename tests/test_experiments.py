"""The scripts of book/experiments: their intervals against formulas, and that each runs on a little data."""

from __future__ import annotations

import importlib
import json
import shutil
import sys
from pathlib import Path

import forecasts
import linkers
import numpy as np
import pandas as pd
import paper
import pytest
import torch
import tracking
import tracking_benchmark
from _paper_tables import MEASURES, lost
from _paper_windows import LabelledScenes, Remedied
from forecasts import HORIZONS, Clouds, Condition, EvaluationConfig, evaluate_forecasts, load_evaluation
from scipy.stats import mannwhitneyu
from tables import bootstrap, draw_episodes, interval
from torch.utils.data import default_collate

from topokit.data import Dataset, WindowDataset
from topokit.models import Motion, Normalisation, Shape, build

from conftest import DATA

ROOT = Path(__file__).parent.parent
EXPERIMENTS = ROOT / "book" / "experiments"
SCRIPTS = sorted(path.stem for path in EXPERIMENTS.glob("[!_]*.py"))


# -- intervals ---------------------------------------------------------------------------------------------------------------


def samples(hits: np.ndarray, episode: np.ndarray, garment: object = "one kind", model: str = "ours") -> pd.DataFrame:
    """Hits of shape (seeds, n) as a table with a row for each."""
    parts = []
    for seed, row in enumerate(hits):
        part = pd.DataFrame({"hits": row, "episode": episode, "garment": garment, "model": model, "seed": seed})
        parts.append(part.assign(n=1.0, step=1))
    return pd.concat(parts)


def share(table: pd.DataFrame) -> pd.DataFrame:
    """The share of hits of each model in all draws."""
    totals = bootstrap(table, ["hits", "n"])
    return totals.xs("hits", axis=1, level=2) / totals.xs("n", axis=1, level=2)


def width(table: pd.DataFrame) -> float:
    (cell,) = interval(share(table)).itertuples()
    return cell.high - cell.low


def test_interval_of_independent_samples_is_the_binomial_one():
    hits = (np.arange(1000) % 10 < 3).astype(float)[None]
    (cell,) = interval(share(samples(hits, np.arange(1000)))).itertuples()
    assert cell.mean == pytest.approx(0.3)
    assert cell.low < 0.3 < cell.high
    assert cell.high - cell.low == pytest.approx(2 * 1.96 * np.sqrt(0.3 * 0.7 / 1000), rel=0.1)


def test_windows_of_an_episode_are_no_independent_samples():
    hits = np.repeat(np.arange(20) % 2, 50).astype(float)[None]  # 20 episodes, each all right or all wrong
    honest = width(samples(hits, np.repeat(np.arange(20), 50)))
    assert honest > 5 * width(samples(hits, np.arange(1000)))
    assert honest == pytest.approx(2 * 1.96 * np.sqrt(0.25 / 20), rel=0.15)


def test_the_mixture_of_garments_is_not_drawn():
    episode = np.repeat(np.arange(20), 5)
    easy = (episode < 10).astype(float)[None]  # ten episodes of a garment that all pass, ten of one that none does
    assert width(samples(easy, episode)) > 0.3
    assert width(samples(easy, episode, np.where(episode < 10, "apron", "tote"))) == 0


def test_seeds_widen_an_interval():
    rng = np.random.default_rng(0)
    hits = (rng.random((3, 400)) < np.array([[0.3], [0.5], [0.7]])).astype(float)
    assert width(samples(hits, np.arange(400))) > 2 * width(samples(hits.mean(axis=0)[None], np.arange(400)))


def test_a_difference_is_on_the_same_episodes():
    rng = np.random.default_rng(0)
    episode = np.repeat(np.arange(15), 10)
    hard = np.repeat(rng.random(15), 10)[None]  # episodes differ far more than models do
    both = [samples((hard < limit).astype(float), episode, model=str(limit)) for limit in (0.5, 0.55)]
    drawn = share(pd.concat(both))
    gain = drawn["0.55"] - drawn["0.5"]
    assert np.ptp(gain.to_numpy()) < np.ptp(drawn["0.5"].to_numpy()) / 2
    assert draw_episodes(pd.Series("a", index=range(4)), 5).sum(axis=1).tolist() == [4] * 6


def test_expected_variance_ranks_the_lost_as_the_rank_test_does():
    rng = np.random.default_rng(0)
    table = samples(np.zeros((2, 120)), np.arange(120) // 4).assign(step=60)
    table["hull_distance"] = rng.choice([0.0, 0.1], len(table))  # metres
    table["expected_variance"] = 0.1 + table["hull_distance"] / 4 + rng.normal(0, 0.02, len(table))
    config = EvaluationConfig(dataset="", models={}, conditions=[], samples=200)
    cell = forecasts.lost(table, config, [60])["ours"]["60"]
    far = table["hull_distance"] > 0
    variance = table["expected_variance"]
    expected = mannwhitneyu(variance[far], variance[~far]).statistic / (far.sum() * (~far).sum())
    assert cell["mean"] == pytest.approx(expected, abs=1e-4)
    assert cell["low"] < cell["mean"] < cell["high"]
    assert cell["n"] == 120


# -- forecasts ---------------------------------------------------------------------------------------------------------------


def masks(**options: object) -> Condition:
    return Condition("masks", part="all", garments=["mask"], windows=1, **options)


def test_an_evaluation_of_a_few_windows(tmp_path):
    models = {"motion": [str(DATA / "checkpoints" / "motion.safetensors")]}
    clean = masks(shares_no_episode=True)
    noisy = Condition(
        "noisy", part="all", garments=["mask"], windows=1, clouds=Clouds(noise=0.005, keep=0.5), models={}
    )
    config = EvaluationConfig(
        dataset=str(DATA / "motion"),
        models=models,
        conditions=[clean, noisy],
        samples=50,
        shape=forecasts.Shape(points=160),
    )
    made = evaluate_forecasts(config, out=tmp_path / "r.json", clips=tmp_path)
    assert json.loads((tmp_path / "r.json").read_text()) == made
    assert made["complete"]
    table = made["conditions"]["masks"]
    assert list(table["hull_accuracy"]) == ["seqph", "hold", "carry", "ours"]
    for model, cells in table["hull_accuracy"].items():
        assert list(cells) == ["1", "15", "30", "60", "mean"]
        assert table["hull_treatments"]["within 2 cm"][model] == cells
        assert all(0 <= cell["low"] <= cell["mean"] <= cell["high"] <= 1 for cell in cells.values())
    gain = table["gain_of_ours"]["carry"]["60"]["mean"]
    shares = table["hull_accuracy"]
    assert gain == pytest.approx(shares["ours"]["60"]["mean"] - shares["carry"]["60"]["mean"], abs=2e-4)
    assert table["presence"]["seqph"]["mean"]["mean"] == 1  # the labels against themselves
    noise = made["conditions"]["noisy"]["presence"]["seqph"]["mean"]["mean"]
    assert noise < 1


def test_a_model_is_not_tested_on_what_it_was_trained_on():
    """The checkpoints of data_small were trained on its films and on many more; no statement to the contrary is made."""
    models = {"mlp": [str(DATA / "checkpoints" / "mlp.safetensors")]}
    config = EvaluationConfig(dataset=str(DATA / "dataset"), models=models, conditions=[masks()], ours="mlp")
    with pytest.raises(ValueError, match="mlp"):
        evaluate_forecasts(config)


# -- the paper's experiment --------------------------------------------------------------------------------------------------


def test_the_papers_experiment_goes_from_films_to_a_table_and_goes_on(tmp_path, monkeypatch):
    protocol = json.loads((EXPERIMENTS / "paper.json").read_text())
    protocol["films"] |= {"validation": 3, "mesh": "usual"}
    training = {"learning_rate": 2e-3, "epochs": 1}  # nothing is searched for
    without = {"model": "mlp", "held_out": ["sheet"], "seeds": [0], "training": training}
    protocol["networks"]["mlp_without_sheet"] = without
    small = {
        "training_films": 3,
        "curve": {"films": [2], "networks": ["mlp"], "seed": 0},
        "seeds": [0, 1],
        "batch": 32,
        "epoch": 32,
        "lengths": [1, 2],
        "rates": [1e-3, 3e-3],
        "windows": {"validation": 20},
    }
    rates = {"films": 3, "seed": 0, "epochs": 1}
    small |= {
        "rates_of": rates,
        "lengths_of": {"films": 3, "seed": 0},
        "validation_windows": 32,
        "motion": ["motion"],
        "garments": {"all": []},
    }
    (tmp_path / "little.json").write_text(json.dumps(protocol | small))
    shutil.copytree(DATA / "dataset", tmp_path / "films")
    out = tmp_path / "paper.csv"
    arguments = ["--protocol", str(tmp_path / "little.json"), "--work", str(tmp_path), "--out", str(out)]
    arguments += ["--networks", "mlp", "mlp_without_sheet", "--stages", "trainings", "forecasts", "table"]
    paper.main(arguments)
    table = pd.read_csv(tmp_path / "paper_validation.csv")
    assert {"seqph", "hold", "carry", "blind", "ridge", "mlp", "mlp_unknown", "motion"} == set(table["forecaster"])
    assert ((table["low"] <= table["share"] + 1e-4) & (table["share"] <= table["high"] + 1e-4)).mean() > 0.95
    mean = table[(table["seed"] == "all") & (table["measure"] == "marked1") & (table["horizon"] == "mean")]
    shares = mean.groupby("forecaster")["share"].max()
    assert shares["seqph"] > shares["hold"]
    assert set(table["mesh"]) == {"usual"}

    # A network that is trained without a garment sees none of its films, and is asked about them alone.
    dataset = Dataset(tmp_path / "films")
    (unknown,) = (tmp_path / "samples" / "validation" / "all").glob("mlp_without_sheet-*.csv")
    assert set(pd.read_csv(unknown)["garment"]) == {"sheet"}
    assert unknown.stem == "mlp_without_sheet-3-0-0.002-1"
    experiment = paper.Experiment(protocol | small, tmp_path, EXPERIMENTS, 1, "cpu", (3,), ("mlp",))
    for films in experiment.training_films(3, ["sheet"]):
        assert len(films)
        assert "sheet" not in {dataset.record(number).garment for number in films.tolist()}

    # What is there is not made again.
    monkeypatch.setattr(paper, "train", None)
    monkeypatch.setattr(paper, "measure", None)
    paper.main(arguments)


def test_a_loss_from_some_films_to_others_has_the_interval_of_both():
    rng = np.random.default_rng(0)
    parts = []
    for share in (0.9, 0.5):
        for name in ("motion", "carry"):
            hits = (rng.random(400) < share) if name == "motion" else np.zeros(400, bool)
            for step in HORIZONS:
                part = pd.DataFrame({"episode": np.arange(400), "garment": "one kind", "model": name, "step": step})
                part = part.assign(films=0, seed=0)
                for column, _ in MEASURES.values():
                    part[column] = np.where(hits, 0.0, 1.0)
                parts.append(part)
    usual, other = pd.concat(parts[: len(parts) // 2]), pd.concat(parts[len(parts) // 2 :])
    loss = lost(usual, other)["wide"]
    mean, low, high = loss["motion"]["later"]
    assert mean == pytest.approx(40, abs=5)
    # Two binomial shares of 400 films.
    assert high - low == pytest.approx(2 * 196 * np.sqrt((0.9 * 0.1 + 0.5 * 0.5) / 400), rel=0.2)
    assert loss["carry"]["mean"] == [0, 0, 0]


def test_windows_in_the_frame_of_the_grippers_are_the_same_scene():
    windows = WindowDataset(DATA / "dataset", [0, 1], n_points=8)
    window = default_collate([windows[i] for i in (0, 9, len(windows) - 1)])
    remedied = Remedied(windows, "grippers", ("grippers", "target", "floor"))
    seen = remedied.remedied(window)
    assert torch.allclose(seen["grippers"][:, -1].mean(dim=1), torch.zeros(3), atol=1e-6)
    assert torch.allclose(seen["grippers"][:, -1, :, 1], torch.zeros(2), atol=1e-6)
    assert torch.equal(seen["clouds"][:, :, :2], seen["grippers"])  # a network is given them before the points
    assert seen["clouds"].shape[2] == 8 + 2 + 4 + 1
    lowest = windows.dataset[0].centre_line.min(axis=0)[2]
    gripper = window["grippers"][0, -1].mean(dim=0)
    assert seen["clouds"][0, 0, 6, 2] == pytest.approx(
        float(lowest - gripper[2]), abs=1e-5
    )  # the floor is where it was
    # Carry forecasts the same in any frame.
    carry = build("carry", Shape(points=8)).eval()
    assert torch.allclose(remedied.forecaster(carry)(window).corners, carry(window).corners, atol=1e-5)


def test_scenes_of_labels_tell_how_loops_moved_and_nothing_of_other_points():
    dataset = Dataset(DATA / "dataset")
    scenes = LabelledScenes(dataset, [0, 1])
    number, frame = scenes.index[20].tolist()
    scene = scenes[20]
    states = dataset.states(number, "full")
    (loop, *_) = states[frame].loops
    assert np.allclose(scene["points"][:6], loop.killer_triangles.reshape(6, 3), atol=1e-4)
    (then,) = [later for later in states[frame + 15].loops if later.id == loop.id]
    moved = scene["future"][4, 24:30] - scene["points"][:6]  # the fifth knot is 15 frames ahead
    assert np.allclose(moved, then.centre - loop.centre, atol=1e-4)
    assert scene["known"][4, 24:30].all()
    assert not scene["known"][:, :24].any()

    # What is said of points whose future is unknown does not change the loss.
    batch = default_collate([scene])
    other = {**batch, "future": batch["future"] + 0.2 * ~batch["known"][..., None]}
    model = Motion(Shape(points=160), Normalisation())
    losses = [model.loss(one, torch.Generator().manual_seed(0))[0] for one in (batch, other)]
    assert torch.isclose(*losses, rtol=1e-3)


LINKED = {
    "trackpy": ("trackpy", {"reach": 0.2, "memory": 0}),
    "LapTrack": ("laptrack", {"reach": 0.2, "memory": 0}),
    "Stone Soup, nearest": ("stonesoup", {"motion": 0.1, "noise": 0.03, "missed": 3, "memory": 5}),
    "Stone Soup, JPDA": ("stonesoup", {"motion": 0.1, "noise": 0.03, "missed": 0.95, "memory": 5}),
    "bottleneck": ("persim", {"distance": "bottleneck"}),
    "Wasserstein": ("persim", {"distance": "wasserstein"}),
    "lifted Wasserstein": ("scipy", {"weight": 1.0}),
}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("linker", LINKED)
def test_linkers_follow_two_bars_that_change_their_order(linker):
    package, options = LINKED[linker]
    pytest.importorskip(package)
    places = np.array([[0.0, 0, 0], [1.0, 0, 0]])
    diagram = np.array([[0.01, 0.3], [0.02, 0.2]])
    frames = []
    for t in range(8):
        order = [0, 1] if t % 3 else [1, 0]
        centre = places[order] + 0.01 * t
        frames.append(linkers.Bars(centre, centre + 0.1, diagram[order]))
    ids = linkers.LINKERS[linker][0](frames, **options)
    # The identity that each of the two places has in each frame; a filter begins with the second frame.
    by_place = [names[np.argsort(bars.centre[:, 0])].tolist() for bars, names in zip(frames, ids, strict=True)]
    assert by_place[1:] == [by_place[1]] * 7
    assert len(set(by_place[1])) == 2


def test_linkers_are_tuned_scored_and_shown_once(tmp_path, monkeypatch):
    name = "every 8th frame"
    monkeypatch.setattr(linkers, "conditions", lambda episode: [(name, list(episode.points[::8].astype(float)), 8)])
    monkeypatch.setattr(linkers, "TUNED_IN", (name,))
    monkeypatch.setattr(linkers, "TIMED", name)
    monkeypatch.setattr(linkers, "WITH", {"alpha": ("lifted Wasserstein",)})
    monkeypatch.setattr(linkers, "PAGE", tmp_path / "page.md")
    monkeypatch.setattr(linkers, "RESULTS", tmp_path / "linkers.json")
    (tmp_path / "page.md").write_text("before {} {} after".format(*linkers.MARKS))
    for folder in ("tuning", "episodes"):
        (tmp_path / folder).mkdir()
        shutil.copy(DATA / "apron_hook_0.npz", tmp_path / folder / "apron-hook_0.npz")
    command = ["--made", "--tuning", str(tmp_path / "tuning"), "--episodes", str(tmp_path / "episodes")]
    linkers.main([*command, "--out", str(linkers.RESULTS)])
    results = json.loads(linkers.RESULTS.read_text())
    stranger = "lifted Wasserstein, bars by alpha"
    assert results["films"] == results["tuned_on"] == ["apron-hook_0"]
    assert set(results["table"][name]) == {*linkers.OURS, stranger}
    assert results["table"][name]["seqPH"]["idf1"] == 1  # one neck, seen in each frame
    assert results["against_strangers"][name]["hota"]["stranger"] == stranger

    # Rows are kept: a second run reads no film.
    monkeypatch.setattr(linkers, "row_of", None)
    linkers.main([*command, "--out", str(linkers.RESULTS)])
    linkers.main(["--page"])
    page = (tmp_path / "page.md").read_text()
    assert page.startswith("before ")
    assert page.endswith(" after")
    assert f"| {stranger} | " in page
    assert linkers.in_page(page, results) == page


def test_the_films_of_the_benchmark_stay_those_of_the_record():
    record = json.loads((ROOT / "book" / "results" / "tracking.json").read_text())
    assert record["episodes"] == [f"{task}_{seed}" for seed in range(3) for task in tracking.FILMED]


def trackeval_scores(folder: Path, condition: str) -> list[float]:
    """Return IDF1, HOTA and switches of exported tracks by TrackEval."""
    trackeval = pytest.importorskip("trackeval")
    dataset = tracking_benchmark.trackeval_dataset()(
        {
            "GT_FOLDER": str(folder / "gt"),
            "TRACKERS_FOLDER": str(folder / "trackers"),
            "BENCHMARK": condition,
            "SPLIT_TO_EVAL": "all",
            "PRINT_CONFIG": False,
        }
    )
    quiet = {"PRINT_RESULTS": False, "PRINT_CONFIG": False, "TIME_PROGRESS": False, "PLOT_CURVES": False}
    quiet |= {"OUTPUT_SUMMARY": False, "OUTPUT_DETAILED": False, "OUTPUT_EMPTY_CLASSES": False}
    metrics = [trackeval.metrics.HOTA(), trackeval.metrics.Identity(), trackeval.metrics.CLEAR()]
    answer, _ = trackeval.Evaluator(trackeval.Evaluator.get_default_eval_config() | quiet).evaluate([dataset], metrics)
    found = answer["Loops"]["mine"]["COMBINED_SEQ"]["pedestrian"]
    return [found["Identity"]["IDF1"], found["HOTA"]["HOTA"].mean(), found["CLEAR"]["IDSW"]]


def test_tracks_of_a_film_are_scored_from_either_format(tmp_path, monkeypatch, capsys):
    conditions = [("every 8th frame", lambda points: list(points[::8]), 8)]
    monkeypatch.setattr(
        tracking_benchmark,
        "conditions",
        lambda episode: [(name, clouds(episode.points), stride) for name, clouds, stride in conditions],
    )
    monkeypatch.setattr(tracking_benchmark, "simulated", lambda *_: [DATA / "apron_hook_0.npz"])
    films, tracks, out = tmp_path / "films", tmp_path / "tracks", tmp_path / "scores.csv"
    tracking_benchmark.main(["make", "--episodes", str(tmp_path), "--films", str(films)])
    score = ["score", "--films", str(films), "--tracks", str(tracks), "--out", str(out)]

    # A folder without tracks of these films is refused. An empty file is a film without tracks.
    assert tracking_benchmark.main(score) == 1
    assert str(tracks) in capsys.readouterr().err

    # The truth, as MOTChallenge has it and as CSV, has full marks; without tracks there are none.
    truth = films / "every-8th-frame" / "apron_hook_0.gt.txt"
    mine = tracks / "every-8th-frame" / "apron_hook_0.txt"
    mine.parent.mkdir(parents=True)
    table = pd.read_csv(truth, header=None)[[0, 1, 7, 8, 9]]
    table.columns = ["frame", "id", "x", "y", "z"]
    table["frame"] -= 1
    found = []
    for write in (mine.touch, lambda: shutil.copy(truth, mine), lambda: table.to_csv(mine.with_suffix(".csv"))):
        write()
        assert tracking_benchmark.main(score) == 0
        found.append(pd.read_csv(out).loc[0, ["idf1", "hota"]].tolist())
    assert found == [[0, 0], [1, 1], [1, 1]]

    # TrackEval scores other tracks of the film as the command does.
    table.assign(id=table["id"] + table["frame"] // 4, x=table["x"] + 0.005 * table["frame"]).to_csv(
        mine.with_suffix(".csv")
    )
    tracking_benchmark.main(score)
    tracking_benchmark.main(["export", *score[1:-1], str(tmp_path / "trackeval")])
    expected = pd.read_csv(out).loc[0, ["idf1", "hota", "switches"]].tolist()

    # What was exported for TrackEval is read and has the same scores.
    exported = tmp_path / "trackeval" / "trackers" / "every-8th-frame-all" / "mine" / "data"
    (tmp_path / "back").mkdir()
    shutil.copytree(exported, tmp_path / "back" / "every-8th-frame")
    again = tmp_path / "again.csv"
    assert tracking_benchmark.main([*score[:4], str(tmp_path / "back"), "--out", str(again)]) == 0
    assert again.read_text() == out.read_text()
    assert trackeval_scores(tmp_path / "trackeval", "every-8th-frame") == pytest.approx(expected, abs=1e-4)

    # An identity that a frame has twice is refused with its row.
    pd.concat([table, table.iloc[3:4]]).to_csv(mine.with_suffix(".csv"))
    assert tracking_benchmark.main(score) == 1
    assert f"row {len(table) + 1}" in capsys.readouterr().err


# -- scripts -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SCRIPTS)
def test_every_script_tells_its_command(name, monkeypatch, capsys):
    try:
        script = importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name.startswith("topokit"):
            raise
        pytest.skip(f"{error.name} is not installed")
    assert f"book/experiments/{name}.py" in script.__doc__ or not hasattr(script, "main")


@pytest.mark.parametrize("name", ["motion", "unseen"])
def test_configurations_are_good(name):
    config = load_evaluation(EXPERIMENTS / f"{name}.json")
    record = json.loads((ROOT / "book" / "results" / f"{name}.json").read_text())
    assert [condition.name for condition in config.conditions] == list(record["conditions"])
    shipped = [path for path in config.models.get("motion", []) if "data_small" in path]
    assert all((EXPERIMENTS / path).is_file() for path in shipped)


def test_learning_rates_of_the_rivals_are_those_that_validation_chose():
    folder = EXPERIMENTS / "same_films"
    for model, losses in json.loads((folder / "rates.json").read_text()).items():
        config = json.loads((folder / f"{model}.json").read_text())
        assert config["learning_rate"] == float(min(losses, key=losses.get))


RUNS = {
    "dataset": ["--only", "store", "opening", "--records", "30"],
    "report": ["book/results/motion.json", "--out", "{folder}"],
    "lemmas_on_cloth": ["data_small/apron_hook_0.npz", "--stride", "60", "--out", "{folder}/r.json"],
    "lemma_search": ["--random", "2", "--optimised", "0", "--json"],
}


@pytest.mark.parametrize("name", RUNS)
def test_scripts_run_on_a_little(name, tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    arguments = [argument.format(folder=tmp_path) for argument in RUNS[name]]
    monkeypatch.setattr(sys, "argv", [f"book/experiments/{name}.py", *arguments])
    assert not importlib.import_module(name).main()
