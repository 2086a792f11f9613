"""The scripts of book/experiments: their intervals against formulas, and that each runs on a little data."""

from __future__ import annotations

import dataclasses
import importlib
import json
import re
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import forecast_benchmark
import forecasts
import linkers
import numpy as np
import pandas as pd
import paper
import pytest
import torch
import tracking_benchmark
from _paper_marking import marked_vertices
from forecasts import Clouds, Condition, EvaluationConfig, evaluate_forecasts, true_curves
from tables import bootstrap, draw_episodes, interval
from torch.utils.data import default_collate

from topokit.data import Dataset, WindowDataset, label_dataset
from topokit.evaluate import true_loops
from topokit.io import load_episode
from topokit.models import Predictor, Scenes, build
from topokit.sampling import covering_radius
from topokit.sim import WARDROBE

from _tracking_clouds import CAMERA, seen, seen_radius, true_parameters
from conftest import DATA, polygon

ROOT = Path(__file__).parent.parent
EXPERIMENTS = ROOT / "book" / "experiments"


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


# -- forecasts ---------------------------------------------------------------------------------------------------------------


def masks(**options: object) -> Condition:
    return Condition("masks", garments=["mask"], windows=1, **options)


def test_an_evaluation_of_a_few_windows(tmp_path):
    models = {"motion": [str(DATA / "checkpoints" / "motion.safetensors")]}
    clean = masks()
    noisy = Condition("noisy", garments=["mask"], windows=1, clouds=Clouds(noise=0.005, keep=0.5), models={})
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


def test_a_model_is_not_tested_on_what_it_was_trained_on(monkeypatch):
    path = DATA / "checkpoints" / "mlp.safetensors"
    monkeypatch.setattr(Dataset, "checksum", lambda _: Predictor.load(path).description["dataset"])
    config = EvaluationConfig(str(DATA / "dataset"), {"mlp": [str(path)]}, [masks()], ours="mlp")
    with pytest.raises(ValueError, match="mlp"):
        evaluate_forecasts(config)


# -- the paper's experiment --------------------------------------------------------------------------------------------------


def test_the_papers_experiment_goes_from_films_to_a_table_and_goes_on(tmp_path, monkeypatch):
    protocol = json.loads((EXPERIMENTS / "paper.json").read_text())
    protocol["films"] |= {"validation": 3, "mesh": "usual"}
    training = {"learning_rate": 2e-3, "epochs": 1}  # nothing is searched for
    protocol["networks"]["mlp_skip"]["training"] = training
    small = {
        "training_films": 3,
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
    arguments += ["--networks", "mlp", "mlp_skip", "--stages", "trainings", "forecasts", "table"]
    paper.main(arguments)
    table = pd.read_csv(tmp_path / "paper_validation.csv")
    assert {"seqph", "hold", "carry", "blind", "ridge", "mlp", "mlp_skip", "motion"} == set(table["forecaster"])
    assert ((table["low"] <= table["share"] + 1e-4) & (table["share"] <= table["high"] + 1e-4)).mean() > 0.95
    mean = table[(table["seed"] == "all") & (table["measure"] == "opening") & (table["horizon"] == "mean")]
    shares = mean.groupby("forecaster")["share"].max()
    assert shares["seqph"] > shares["hold"]
    assert set(table["mesh"]) == {"usual"}

    assert (tmp_path / "trainings" / "mlp_skip-3-1-0.002-1").exists()

    # What is there is not made again.
    monkeypatch.setattr(paper, "train", None)
    monkeypatch.setattr(paper, "measure", None)
    paper.main(arguments)


def test_the_networks_of_the_openings_are_trained_tuned_and_asked(tmp_path):
    """The rates beside the best are tried, until none is better; a graph's forecast is read off the cloud that it moves."""
    protocol = json.loads((EXPERIMENTS / "paper_openings.json").read_text())
    protocol["films"]["validation"] = 3
    small = {"training_films": 3, "seeds": [0], "batch": 16, "epoch": 16, "validation_windows": 4, "lengths": [1]}
    rates = {"films": 3, "seed": 0, "epochs": 1, "first": 1e-3}
    small |= {
        "rates_of": rates,
        "lengths_of": {"films": 3, "seed": 0},
        "windows": {"validation": 4},
        "garments": {"all": []},
    }
    (tmp_path / "little.json").write_text(json.dumps(protocol | small))
    shutil.copytree(DATA / "dataset", tmp_path / "films")
    label_dataset(tmp_path / "films", "observed", n_points=128, n_workers=1, progress=False)
    arguments = ["--protocol", str(tmp_path / "little.json"), "--work", str(tmp_path)]
    arguments += ["--out", str(tmp_path / "paper.csv"), "--stages", "trainings", "forecasts", "table"]
    paper.main(arguments)
    table = pd.read_csv(tmp_path / "paper_validation.csv")
    assert protocol["networks"].keys() <= set(table["forecaster"])
    ended = [paper.Trained.of(path.parent) for path in (tmp_path / "trainings").glob(f"*/{paper.SUMMARY}")]
    for network in protocol["networks"]:
        losses = {training.rate: training.loss for training in ended if training.network == network}
        if network == "mlp_128_observed":  # at the rate of mlp_128
            assert len(losses) == 1
            continue
        best = min(losses, key=losses.get)
        row = protocol["rates"].index(best)
        assert {1e-3, *protocol["rates"][max(row - 1, 0) : row + 2]} <= losses.keys()


def test_a_network_that_is_given_loops_starts_from_carry():
    windows = WindowDataset(DATA / "dataset", n_points=32)
    window = default_collate([windows[0], windows[len(windows) - 1]])
    shape = forecasts.Shape(points=32)
    carried = build("carry", shape)(window)
    states = build("givenloops", shape)(window)
    torch.testing.assert_close(states.corners, carried.corners, atol=0.02, rtol=0)
    present = carried.presence > 0
    assert present.any()
    assert ((states.presence > 0) == present).all()
    torch.testing.assert_close(states.death[present], carried.death[present], atol=0.006, rtol=0)


def test_a_graph_does_not_depend_on_the_place_nor_on_the_order_of_points():
    scenes = Scenes(Dataset(DATA / "motion"), [2])
    scene = default_collate([scenes[0], scenes[20]])
    graph = build("graph", forecasts.Shape(points=160))
    torch.nn.init.normal_(graph.out[-1].weight)
    places, _ = graph(scene)
    shift = torch.tensor([3.0, -2.0, 0.5])
    moved = {name: scene[name] + shift for name in ("cloud", "points", "grippers", "target", "actions")}
    there, _ = graph({**scene, **moved, "floor": scene["floor"] + shift[2]})
    torch.testing.assert_close(there, places + shift, atol=1e-3, rtol=0)
    order = torch.cat([torch.arange(24), 24 + torch.randperm(136), torch.arange(160, 176)])
    mixed, _ = graph({**scene, "cloud": scene["cloud"][:, order[:160]], "flow": scene["flow"][:, order]})
    torch.testing.assert_close(mixed, places, atol=1e-3, rtol=0)


def test_marked_vertices_are_a_band_around_the_opening():
    """Of the apron with two loops: each strap, and cloth beside its ends as wide as the strap; of a sheet the border alone."""
    films = Dataset(DATA / "dataset")
    number = {record.garment: record.episode for record in films.records}
    film = films[number["apron2"]]
    sizes = {name: size for name, size in film.physics["garment"].items() if name != "scale"}
    x, y, z = WARDROBE["apron2"](**sizes).vertices.T
    neck, waist = marked_vertices(film)
    assert set(np.flatnonzero(z > 0.001)) <= set(neck.tolist())
    assert set(np.flatnonzero(y > 0.001)) <= set(waist.tolist())
    front = waist[y[waist] < 0.001]
    top = -sizes["bib_height"]
    assert z[front].max() < top + 0.01
    assert z[front].min() > top - sizes["waist_strap_width"] - 0.01
    assert np.diff(np.sort(x[front])).max() < 2 * sizes["spacing"]
    assert np.ptp(x[front]) == pytest.approx(sizes["body_width"])

    windows = WindowDataset(films, [number["apron2"]])
    (truth,) = true_curves(windows, [0], [1])
    frame = windows.index[0, 1] + 1
    for vertices, ids in zip(truth.marked, (neck, waist), strict=True):
        assert vertices[0].tolist() == film.points[frame, ids].tolist()
    sheet = films[number["sheet"]]
    assert marked_vertices(sheet)[0].tolist() == sheet.loops[0].tolist()


def test_tracks_of_a_film_are_scored(tmp_path, monkeypatch):
    condition = [("every 8th frame", list(load_episode(DATA / "apron_hook_0.npz").points[::8]), 8)]
    monkeypatch.setattr(tracking_benchmark, "conditions", lambda _: condition)
    monkeypatch.setattr(tracking_benchmark, "simulated", lambda *_: [DATA / "apron_hook_0.npz"])
    films, tracks, out = tmp_path / "films", tmp_path / "tracks", tmp_path / "scores.csv"
    tracking_benchmark.main(["make", "--episodes", str(tmp_path), "--films", str(films)])
    score = ["score", "--films", str(films), "--tracks", str(tracks), "--out", str(out)]

    # The true centres have full marks; without tracks there are none.
    film = load_episode(films / "every-8th-frame" / "apron_hook_0.npz")
    rows = [(t, 0, *true.centres[0]) for t, true in enumerate(true_loops(film.points, film.loops)) if true.present[0]]
    mine = tracks / "every-8th-frame" / "apron_hook_0.csv"
    mine.parent.mkdir(parents=True)
    found = []
    for kept in ([], rows):
        pd.DataFrame(kept, columns=tracking_benchmark.COLUMNS).to_csv(mine, index=False)
        tracking_benchmark.main(score)
        found.append(pd.read_csv(out).loc[0, ["idf1", "hota"]].tolist())
    assert found == [[0, 0], [1, 1]]
    pd.DataFrame([*rows, rows[3]], columns=tracking_benchmark.COLUMNS).to_csv(mine, index=False)
    with pytest.raises(ValueError, match=f"row {len(rows) + 1}"):
        tracking_benchmark.main(score)


# -- linkers -----------------------------------------------------------------------------------------------------------------


def test_answers_in_a_file_are_scored_as_their_forecaster_is(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    films = str(DATA / "forecast")
    windows = forecast_benchmark.windows_of(films)
    assert (
        forecast_benchmark.checksums(windows.dataset).items()
        <= json.loads(forecast_benchmark.RESULTS.read_text())["films"].items()
    )
    forecast_benchmark.main(["answers", "carry", "--films", films])
    mine = forecast_benchmark.forecaster_of(forecast_benchmark.read_answers("carry.csv", windows), windows)
    asked = {"mine": mine, "carry": forecast_benchmark.forecaster("carry", windows)}
    found = forecast_benchmark.shares(asked, windows, "mine").groupby("forecaster")[["mean", "low", "high"]]
    shares = {name: part.to_numpy() for name, part in found}
    assert shares["mine"].tolist() == shares["carry"].tolist()
    assert 0 < shares["carry"].mean() < 100
    assert not shares["mine - carry"].any()

    # A wrong file is refused; the line is named.
    whole = pd.read_csv("carry.csv")
    wrong = {
        "no column presence": whole.drop(columns="presence"),
        "line 3.*not finite": whole.assign(x=whole["x"].where(whole.index != 1)),
        "line 2.*no such film": whole.assign(film=whole["film"].replace(0, 99)),
        "line 2.*frame is not asked": whole.assign(frame=whole["frame"].replace(15, 16)),
        "line 6.*horizon has to be": whole.assign(horizon=whole["horizon"].replace(15, 14)),
        "line 5.*slot has to be": whole.assign(slot=whole["slot"].replace(3, 4)),
        "line 2.*presence has to be": whole.assign(presence=2.0),
        "line 242.*an earlier line": pd.concat([whole, whole[:1]]),
        "no line for film 0, frame 15, horizon 1 .1 are missing": whole[4:],
    }
    for what, table in wrong.items():
        table.to_csv("wrong.csv", index=False)
        with pytest.raises(SystemExit):
            forecast_benchmark.main(["score", "wrong.csv", "--films", films])
        assert re.search(f"wrong.csv.*{what}", capsys.readouterr().err)


def test_the_alpha_that_the_paper_is_given():
    """It covers the surface in every frame, counts clean points only, and for a camera only what it sees."""
    film = load_episode(DATA / "apron_hook_0.npz")
    film = dataclasses.replace(film, points=film.points[:40:8].astype(float))
    whole = list(film.points)
    given = true_parameters(film, "all vertices", whole, 1)
    sides = film.points[:, film.faces] - film.points[:, np.roll(film.faces, 1, axis=1)]
    longest = np.linalg.norm(sides, axis=-1).max()
    assert 0.95 * longest / 2 < given["alpha"] <= longest / 2  # the middle of an edge may be nearer to a third vertex
    assert given["epsilon"] == np.linalg.norm(np.diff(film.points, axis=0), axis=-1).max()
    noisy = [frame + 0.01 for frame in whole]
    assert true_parameters(film, "noise of 10 mm", noisy, 1) == given
    half = true_parameters(film, "a hand", [frame[::2] for frame in whole], 1)
    assert half["alpha"] >= max(covering_radius(frame, frame[::2]) for frame in whole)

    flawed = true_parameters(film, "a depth camera's flaws", whole, 1)
    assert flawed["alpha"] == seen_radius(film, (CAMERA,))
    hidden = max(covering_radius(frame, seen(frame, film.faces, (CAMERA,))) for frame in whole)
    assert 0.01 < flawed["alpha"] <= hidden


def two_rings(large: float, small: float) -> np.ndarray:
    """Return a ring of 1 m and one of 70 cm, each around a place on the x axis."""
    rings = [radius * np.insert(polygon(24), 2, 0.0, axis=1) for radius in (1.0, 0.7)]
    return np.vstack([rings[0] + [large, 0, 0], rings[1] + [small, 0, 0]])


def test_linkers_are_scored_on_rings_that_change_their_places(tmp_path, monkeypatch):
    """Two rings change their places after three of six frames; in the second condition the small one is late.

    Identities by shape are right; those by place change hands. All numbers are counted by hand.
    """
    places = [(0.0, 4.0)] * 3 + [(4.0, 0.0)] * 3
    sizes = {"radii": np.array([1.0, 0.7]), "present": np.array([True, True])}
    truth = [SimpleNamespace(centres=np.array([[x, 0, 0] for x in pair]), **sizes) for pair in places]
    clouds = [two_rings(*pair) for pair in places]
    conditions = [("250 points", clouds, 1), ("500 points", [clouds[0][:24], *clouds[2::2]], 2)]
    weights = {"by place": [1.0], "by shape": [0.0], "tuned": [1.0, 0.0]}
    choices = {name: (linkers.lifted_link, linkers.choices(weight=some)) for name, some in weights.items()}
    monkeypatch.setattr(linkers, "true_loops", lambda *_: truth)
    monkeypatch.setattr(linkers, "conditions", lambda _: conditions)
    monkeypatch.setattr(linkers, "LINKERS", choices)
    monkeypatch.setattr(linkers, "WITH", {"alpha": ("tuned",), "seqPH": tuple(weights)})
    monkeypatch.setattr(linkers, "TUNED_IN", ("250 points",))
    for folder in ("tuning", "films"):
        (tmp_path / folder).mkdir()
        for seed in (0, 1):
            shutil.copy(DATA / "apron_hook_0.npz", tmp_path / folder / f"film_{seed}.npz")
    out = tmp_path / "linkers.json"
    arguments = ["--tuning", str(tmp_path / "tuning"), "--episodes", str(tmp_path / "films"), "--out", str(out)]
    linkers.main([*arguments, "--made"])
    made = json.loads(out.read_text())

    # Of the options of a linker the better ones are taken.
    assert made["options"]["tuned, bars by seqPH"] == made["options"]["tuned, bars by alpha"] == {"weight": 0.0}
    assert (
        made["merit_on_tuning_films"]["by place, bars by seqPH"] < made["merit_on_tuning_films"]["tuned, bars by seqPH"]
    )
    # Of a film: objects, detections, switches, and the detections that have the identity of their object.
    counted = {
        ("250 points", "by shape"): (12, 12, 0, 12),
        ("250 points", "by place"): (12, 12, 2, 6),
        ("500 points", "by shape"): (6, 5, 0, 5),
        ("500 points", "by place"): (6, 5, 2, 3),
        ("all together", "by shape"): (18, 17, 0, 17),
        ("all together", "by place"): (18, 17, 4, 9),
    }
    for (condition, linker), (objects, detections, switches, right) in counted.items():
        line = made["table"][condition][f"{linker}, bars by seqPH"]
        found = [line[name] for name in ("objects", "detections", "switches", "false_positives")]
        assert found == [2 * objects, 2 * detections, 2 * switches, 0]
        assert line["idf1"] == pytest.approx(2 * right / (objects + detections), abs=1e-4)
        assert line["mota"] == pytest.approx(1 - (objects - detections + switches) / objects, abs=1e-4)
        assert line["idf1_interval"] == [line["idf1"]] * 2  # both films are the same
    idf1 = made["against_strangers"]["500 points"]["idf1"]
    assert (idf1["stranger"], idf1["best"]) == ("tuned, bars by alpha", pytest.approx(10 / 11, abs=1e-4))

    # What is there is not computed again.
    monkeypatch.setattr(linkers, "conditions", None)
    linkers.main([*arguments, "--made"])
    assert json.loads(out.read_text()) == made


# -- scripts -----------------------------------------------------------------------------------------------------------------


RUNS = {
    "report": ["book/results/motion.json", "--out", "{folder}"],
    "lemmas_on_cloth": ["data_small/apron_hook_0.npz", "--stride", "60", "--out", "{folder}/r.json"],
    "lemma_search": ["--random", "2", "--optimised", "0"],
}


@pytest.mark.parametrize("name", RUNS)
def test_scripts_run_on_a_little(name, tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    arguments = [argument.format(folder=tmp_path) for argument in RUNS[name]]
    monkeypatch.setattr(sys, "argv", [f"book/experiments/{name}.py", *arguments])
    assert not importlib.import_module(name).main()
