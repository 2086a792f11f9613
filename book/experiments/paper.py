"""Repeat the paper's experiment in the paper's own setting: book/results/paper.csv.

    python book/experiments/paper.py
    python book/experiments/paper.py --protocol book/experiments/paper_usual.json --work runs/paper_usual
    python book/experiments/paper.py --protocol book/experiments/paper_openings.json --work runs/paper_openings

Questions, claims, measures, films, networks and their trainings are in the protocol. Nothing is chosen on the films to test on.
Each of the six stages leaves alone what is in the folder already, so the same command goes on after it was stopped:

films      garments, to train and to validate with; on coarse meshes where the protocol has no other
labels     their loops, tracked on all vertices, or also on the points that a network sees
trainings  rates of all networks, then lengths, then all seeds
tests      films of other seeds and their loops, on the usual mesh and on the coarse one of the training films
forecasts  of all windows by all forecasters, on validation films and on test films
table      shares with intervals, the logs of the trainings, and what became of the claims

Test films are forecast only when every network has been trained with every seed. On one core: 1.5 hours of films, half an hour of
labels; an MLP sees 1,000 windows a second, PointNet 450. The records of paper.json, paper_anywhere.json and paper_curve.json were
made by the script of commit b5e40830, with its measures, its remedies and its learning curves.

Source: Antonova et al. 2021, section 6 and figure 4. Taught in chapter 15.
"""

import argparse
import hashlib
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Self

import numpy as np
import pandas as pd
import torch
from _paper_networks import AnyConfig, blind
from _paper_tables import MEASURES, table_of
from forecasts import HORIZONS, Forecaster, measure, of_predictor, of_windows, spread_windows
from numpy.typing import NDArray
from tables import write_results

import topokit
from topokit.data import Dataset, DatasetConfig, WindowDataset, generate_dataset, label_dataset
from topokit.models import Predictor, Scenes, StateTensors, TrainConfig, build, train
from topokit.models._baselines import Shape

ROOT = Path(__file__).parents[2]
STAGES = ("films", "labels", "trainings", "tests", "forecasts", "table")
MLP_POINTS = 32  # the first of a cloud's points
SUMMARY = "summary.json"
CHECKPOINTS = ROOT / "data_small" / "checkpoints"
OF_POINTS = ("motion", "graph")  # models that see scenes and move points; the others see windows

LOGGED = ("epoch", "step", "seconds", "train_loss", "train_distance", "validation_loss", "validation_distance")
KEYS = ["setting", "mesh", "garments", "measure", "forecaster", "training_films", "seed", "horizon"]


@dataclass(frozen=True)
class Trained:
    """A training that has ended."""

    network: str
    films: int
    seed: int
    rate: float
    epochs: int
    loss: float  #: the smallest on validation films
    folder: Path

    @classmethod
    def of(cls, folder: Path) -> Self:
        """Return what the summary in a folder says."""
        network, films, seed, rate, epochs = folder.name.rsplit("-", 4)
        reached = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
        return cls(network, int(films), int(seed), float(rate), int(epochs), reached["validation_loss"], folder)


@dataclass(frozen=True)
class Asked:
    """A forecaster to be asked about windows, and where its samples are kept."""

    name: str
    films: int = 0  #: to train on; 0 where there are none of the experiment
    seed: int = 0
    checkpoint: Path | None = None  #: of a network or of Motion

    @property
    def file(self) -> str:
        """Return the name of the file of its samples."""
        if self.films and self.checkpoint is not None:
            return f"{self.checkpoint.parent.name}.csv"
        return f"{self.name}-{self.films}-{self.seed}.csv"


@dataclass(frozen=True)
class Experiment:
    """The protocol, and the folder of its films, trainings and forecasts."""

    protocol: dict[str, Any]
    folder: Path
    configs: Path  #: the folder that paths of the protocol are relative to
    workers: int
    networks: tuple[str, ...]

    def generate(self, described: dict[str, Any], episodes: int, folder: str) -> Dataset:
        """Make the films that the protocol describes, or go on with them."""
        path = self.configs / described["config"]
        config = DatasetConfig.from_json(json.loads(path.read_text(encoding="utf-8")))
        return generate_dataset(config, self.folder / folder, episodes, described["seed"], n_workers=self.workers)

    @property
    def is_decided(self) -> bool:
        """Return whether all trainings that the claims are about have ended."""
        films = self.protocol["training_films"]
        seeds = set(self.protocol["seeds"])
        return all(seeds <= self.ended(network, films).keys() for network in self.protocol["networks"])

    def described(self, network: str) -> dict[str, Any]:
        """Return what the protocol says of a network; a checkpoint of data_small is a Motion.

        Its `points` are those on which the loops to learn were tracked, 0 for all vertices.
        """
        return {"options": {}, "loss": {}, "points": 0, **self.protocol["networks"].get(network, {"model": "motion"})}

    # ------------------------------------------------------------------------------------------------------- films and labels

    def make_films(self) -> None:
        """Make films until there are enough for the largest training; those that are refused are replaced."""
        described = self.protocol["films"]
        wanted = self.protocol["training_films"]
        first = described["validation"]
        episodes = first + wanted
        if (self.folder / "films").exists():
            episodes = max(episodes, len(Dataset(self.folder / "films").wanted))
        missing = 1
        while missing > 0:
            films = self.generate(described, episodes, "films")
            missing = wanted - int((films.episodes >= first).sum())
            episodes += missing

    def label_films(self) -> None:
        """Track the loops of all films."""
        label_dataset(self.folder / "films", n_workers=self.workers)
        for points in {self.described(network)["points"] for network in self.networks} - {0}:
            label_dataset(self.folder / "films", "observed", n_points=points, n_workers=self.workers)

    def make_tests(self) -> None:
        """Make the test films, and track their loops on all vertices and on the points that networks are shown."""
        for mesh, described in self.protocol["tests"].items():
            folder = self.generate(described, described["episodes"], f"test_{mesh}").folder
            label_dataset(folder, n_workers=self.workers)
            for points in self.shown_points:
                label_dataset(folder, "observed", n_points=points, n_workers=self.workers)

    @cached_property
    def shown_points(self) -> tuple[int, ...]:
        """Return how many points PointNet and the MLP are shown."""
        return self.protocol["points"], MLP_POINTS

    @cached_property
    def shape(self) -> Shape:
        """Return the shape of all windows."""
        return Shape(points=self.protocol["points"])

    # -------------------------------------------------------------------------------------------------------------- trainings

    def training_films(self, films: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the numbers of the films of a size, and of the validation films; sizes are nested."""
        known = Dataset(self.folder / "films").labelled("full")
        first = self.protocol["films"]["validation"]
        chosen = known[known >= first][:films]
        if len(chosen) < films:
            raise ValueError(f"{len(chosen)} labelled films to train on, and {films} are wanted: run films and labels")
        return chosen, known[known < first]

    def windows_of(self, episodes: NDArray[np.int64], tracked: int = 0) -> WindowDataset:
        """Return the windows of some films, with loops that were tracked on so many points, or on all vertices."""
        labels = f"observed-{tracked}" if tracked else "full"
        return _windows(self.folder / "films", tuple(episodes.tolist()), self.shape.points, labels)

    def train(self, network: str, films: int, seed: int, rate: float, epochs: int) -> Trained:
        """Train a network, or go on with it, or return what it reached."""
        out = self.folder / "trainings" / f"{network}-{films}-{seed}-{rate:g}-{epochs}"
        if not (out / SUMMARY).exists():
            chosen, validation = self.training_films(films)
            checksum = _checksum(self.folder / "films", chosen)
            config = self.training_config(network, seed, rate, epochs)
            parts = [self.seen_by(network, episodes) for episodes in (chosen, validation)]
            print(f"{out.name}: {len(parts[0])} windows of {films} films", flush=True)
            found = train(config, out, (*parts, checksum), progress=True)
            write_results(out / SUMMARY, {**found, "films": checksum})
        training = Trained.of(out)
        print(f"{out.name}: {training.loss:.4f}", flush=True)
        return training

    def seen_by(self, network: str, episodes: NDArray[np.int64]) -> Scenes | WindowDataset:
        """Return what a network sees of some films in its training."""
        described = self.described(network)
        if described["model"] in OF_POINTS:
            return Scenes(Dataset(self.folder / "films"), episodes.tolist())
        return self.windows_of(episodes, described["points"])

    def training_config(self, network: str, seed: int, rate: float, epochs: int) -> TrainConfig:
        """Return the configuration of a training. It is never stopped early: its rate has to fall to the end."""
        described = self.described(network)
        options = described["options"]
        if described["model"] == "mlp":
            options = {"points": MLP_POINTS} | options
        return AnyConfig(
            described["model"],
            options=options,
            loss=described["loss"],
            shape=Shape(points=160) if described["model"] in OF_POINTS else self.shape,
            batch=self.protocol["batch"],
            epochs=epochs,
            windows_per_epoch=self.protocol["epoch"],
            validation_windows=self.protocol["validation_windows"],
            learning_rate=rate,
            seed=seed,
            patience=epochs,
            threads=1,
        )

    def rate_of(self, network: str) -> float:
        """Return the rate of the best of some whole trainings, which differ in nothing else.

        Where the protocol has a first rate, those beside the best are tried until none beside it is better.
        """
        how = self.protocol["rates_of"]
        rates = self.protocol["rates"]
        wanted = [how["first"]] if "first" in how else rates
        losses: dict[float, float] = {}
        while wanted:
            for rate in wanted:
                losses[rate] = self.loss_at(network, rate)
            best = min(losses, key=losses.__getitem__)
            row = rates.index(best)
            wanted = [rate for rate in rates[max(row - 1, 0) : row + 2] if rate not in losses]
        return best

    def loss_at(self, network: str, rate: float) -> float:
        """Return the loss of a whole training at a rate; infinity where it was not finite any more."""
        how = self.protocol["rates_of"]
        try:
            return self.train(network, how["films"], how["seed"], rate, how["epochs"]).loss
        except ValueError as error:
            if "lower learning_rate" not in str(error):
                raise
            return math.inf

    def length_of(self, network: str) -> int:
        """Return the epochs of a training that is no worse than one of twice the length.

        The rate falls to nothing over a training, so that its loss falls to the end, however long it is. So the question whether
        it has been trained for long enough is put to whole trainings.
        """
        how = self.protocol["lengths_of"]
        rate = self.rate_of(network)
        first, *others = self.protocol["lengths"]
        best = self.train(network, how["films"], how["seed"], rate, first)
        for epochs in others:
            longer = self.train(network, how["films"], how["seed"], rate, epochs)
            if longer.loss > best.loss - self.protocol["better"] * abs(best.loss):  # that of a Motion may be below 0
                break
            best = longer
        return best.epochs

    def train_seeds(self, network: str) -> None:
        """Train a network with all seeds, at the rate and for the length that were found for it, or for the one it is like.

        Where the protocol has both, nothing is searched for.
        """
        described = self.described(network)
        if "training" in described:
            rate = described["training"]["learning_rate"]
            length = described["training"]["epochs"]
        else:
            rate = self.rate_of(described.get("like", network))
            length = self.length_of(described.get("like", network))
        for seed in self.protocol["seeds"]:
            self.train(network, self.protocol["training_films"], seed, rate, length)

    def ended(self, network: str, films: int) -> dict[int, Trained]:
        """Return for each seed the best of its trainings that have ended, by their validation loss."""
        paths = (self.folder / "trainings").glob(f"{network}-{films}-*/{SUMMARY}")
        trainings = sorted((Trained.of(path.parent) for path in paths), key=lambda training: -training.loss)
        return {training.seed: training for training in trainings}

    def ridge(self, films: int) -> Path:
        """Return the checkpoint of the ridge regression on some films."""
        out = self.folder / "trainings" / f"ridge-{films}"
        if not (out / "best.safetensors").exists():
            chosen, validation = self.training_films(films)
            options = {"batch": self.protocol["batch"], "validation_windows": self.protocol["validation_windows"]}
            config = TrainConfig("ridge", shape=self.shape, windows_per_epoch=60_000, threads=1, **options)
            parts = [self.windows_of(episodes) for episodes in (chosen, validation)]
            train(config, out, (*parts, _checksum(self.folder / "films", chosen)))
        return out / "best.safetensors"

    def height(self, films: int) -> float:
        """Return how far below the grippers' middle the first loop is in the last frame of a history, in the median, metres."""
        chosen, _ = self.training_films(films)
        windows = self.windows_of(chosen)
        heights = []
        for row in np.linspace(0, len(windows) - 1, min(len(windows), 2000)).astype(int):
            window = windows[int(row)]
            past = StateTensors.from_past({name: part[None] for name, part in window.items() if name[:5] == "past_"})
            if window["held"][-1] and past.presence[0, -1, 0] > 0:
                middle = window["grippers"][-1].mean(dim=0)
                heights.append(float(middle[2] - past.mean[0, -1, 0, 2]))
        return float(np.median(heights))

    def train_all(self) -> None:
        """Train all networks: first all at the first rate, if there is one; then rates and lengths are sought; then all seeds."""
        how = self.protocol.get("rates_of", {})
        searched = [name for name in self.networks if not {"training", "like"} & self.described(name).keys()]
        for network in searched:
            if "first" in how:
                self.train(network, how["films"], how["seed"], how["first"], how["epochs"])
        for search in (self.rate_of, self.length_of):
            for network in searched:
                search(network)
        for network in self.networks:
            self.train_seeds(network)

    # -------------------------------------------------------------------------------------------------------------- forecasts

    @property
    def asked(self) -> list[Asked]:
        """Return the forecasters to ask; of the networks those trainings that have ended."""
        films = self.protocol["training_films"]
        names = ["seqph", *(f"seqph_{points}_points" for points in self.shown_points), "hold", "carry"]
        found = [*map(Asked, names), Asked("blind", films), Asked("ridge", films)]
        for network in self.networks:
            for seed, training in sorted(self.ended(network, films).items()):
                if seed in self.protocol["seeds"]:
                    found.append(Asked(network, films, seed, training.folder / "best.safetensors"))
        for seed, checkpoint in enumerate(self.protocol["motion"]):
            found.append(Asked("motion", 0, seed, CHECKPOINTS / f"{checkpoint}.safetensors"))
        return found

    def forecaster(self, asked: Asked, windows: WindowDataset) -> Forecaster:
        """Return a forecaster; seqPH is asked about the frame itself."""
        if asked.name.startswith("seqph"):
            return StateTensors.from_labels
        if asked.name in ("hold", "carry"):
            return of_windows(build(asked.name, self.shape).eval())
        if asked.name == "blind":
            return blind(self.height(asked.films), self.shape.slots)
        if asked.name == "ridge":
            return of_windows(Predictor.load(self.ridge(asked.films)).model)
        return of_predictor(Predictor.load(asked.checkpoint), windows)

    def forecast(self) -> None:
        """Measure all forecasters on validation films; on test films only when no training of the claims is missing."""
        films = Dataset(self.folder / "films")
        self.forecast_part("validation", films, self.training_films(1)[1])
        for mesh in self.protocol["tests"]:
            test = self.folder / f"test_{mesh}"
            if self.is_decided and test.exists():
                self.forecast_part(f"test_{mesh}", Dataset(test), Dataset(test).labelled("full"))

    def forecast_part(self, part: str, dataset: Dataset, episodes: NDArray[np.int64]) -> None:
        """Measure all forecasters on some films; each has a file of samples for each choice of garments."""
        options = {"n_points": self.shape.points}
        for garments, chosen in self.protocol["garments"].items():
            names = chosen or dataset.garments
            numbers = [i for i in episodes.tolist() if dataset.record(i).garment in names]
            windows = WindowDataset(dataset, numbers, **options)
            most = self.protocol["windows"]["validation" if part == "validation" else "tests"]
            rows = spread_windows(windows, math.ceil(most / len(names)))
            for asked in self.asked:
                path = self.folder / "samples" / part / garments / asked.file
                if path.exists():
                    continue
                clean = windows.select(rows)
                seen = clean
                if asked.name.endswith("_points"):
                    points = int(asked.name.split("_")[1])
                    if f"observed-{points}" not in dataset.label_names:
                        continue  # of the validation films, which are among those to train on
                    same = WindowDataset(dataset, numbers, n_points=points, labels=f"observed-{points}")
                    seen = same.select(rows)
                found = {asked.name: [self.forecaster(asked, clean)]}
                samples = measure(found, clean, seen, HORIZONS, 0, f"{part}, {garments}, {path.stem}")
                save_samples(path, samples.assign(films=asked.films, seed=asked.seed))

    # ------------------------------------------------------------------------------------------------------------------ table

    def checksums(self) -> dict[str, Any]:
        """Return the SHA-256 of the protocol, of the films with their labels, and of those to test on."""
        folder = self.folder / "films"
        protocol = hashlib.sha256(json.dumps(self.protocol, sort_keys=True).encode()).hexdigest()
        made_with = {"topokit": topokit.__version__, "torch": torch.__version__, "numpy": np.__version__}
        found: dict[str, Any] = {"made_with": made_with, "protocol": protocol}
        found["validation"] = _checksum(folder, self.training_films(1)[1])
        films = self.protocol["training_films"]
        found[f"{films} films"] = _checksum(folder, self.training_films(films)[0])
        for mesh in self.protocol["tests"]:
            test = self.folder / f"test_{mesh}"
            if test.exists():
                found[f"test, {mesh} mesh"] = Dataset(test).checksum()
        return found

    def samples(self, part: str) -> Iterator[tuple[str, pd.DataFrame]]:
        """Yield the samples of each choice of garments, and of the garments that a choice names."""
        for garments, names in self.protocol["garments"].items():
            files = [self.folder / "samples" / part / garments / asked.file for asked in self.asked]
            paths = [path for path in files if path.exists()]
            if not paths:
                continue
            samples = pd.concat([pd.read_csv(path) for path in paths], ignore_index=True)
            yield garments, samples
            for name in names:
                if name != garments and (samples["garment"] == name).any():
                    yield name, samples[samples["garment"] == name]

    def tabulate(self, out: Path) -> None:
        """Write the shares on validation and on test films, the differences of the claims, checksums and logs.

        Rows of other settings in these files are kept.
        """
        protocol = self.protocol
        setting = protocol["setting"]
        tests = {f"test_{mesh}": mesh for mesh in protocol["tests"]}
        validation = {"validation": protocol["films"].get("mesh", "coarse")}
        for name, parts in ((f"{out.stem}_validation", validation), (out.stem, tests)):
            tables = []
            claims = {}
            for part, mesh in parts.items():
                for garments, samples in self.samples(part):
                    table, differences = table_of(samples, protocol["training_films"])
                    tables.append(table.assign(setting=setting, mesh=mesh, garments=garments))
                    claims[f"{garments}, {mesh} mesh"] = differences
            if tables:
                columns = [*KEYS, "share", "low", "high", "films", "windows"]
                write_rows(out.with_name(f"{name}.csv"), pd.concat(tables)[columns], setting)
                write_entry(out.with_name(f"{name}_claims.json"), claims, setting)
        write_entry(out.with_name(f"{out.stem}_films.json"), self.checksums(), setting)

        # The logs of all trainings.
        logs = []
        for path in sorted((self.folder / "trainings").glob("*/log.csv")):
            log = pd.read_csv(path)
            log = log[[name for name in LOGGED if name in log]]
            logs.append(log.assign(training=path.parent.name, setting=setting))
        if logs:
            write_rows(out.with_name(f"{out.stem}_trainings.csv"), pd.concat(logs), setting)


def write_rows(path: Path, rows: pd.DataFrame, setting: str) -> None:
    """Write the rows of a setting to a table, in place of those that it has of it."""
    if path.exists():
        known = pd.read_csv(path)
        rows = pd.concat([known[known["setting"] != setting], rows])
    rows.round(4).to_csv(path, index=False)


def write_entry(path: Path, entry: dict[str, Any], setting: str) -> None:
    """Write what a setting has to a JSON object of all settings."""
    known = {}
    if path.exists():
        known = json.loads(path.read_text(encoding="utf-8"))
    write_results(path, known | {setting: entry})


def save_samples(path: Path, samples: pd.DataFrame) -> None:
    """Write the distances of a forecaster's samples in one piece."""
    columns = ["window", "episode", "garment", "model", "films", "seed", "step"]
    columns += dict.fromkeys(column for column, _ in MEASURES.values())
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.with_suffix(".part")
    samples[columns].round(5).to_csv(aside, index=False)
    aside.replace(path)


@lru_cache(4)
def _windows(folder: Path, episodes: tuple[int, ...], points: int, labels: str) -> WindowDataset:
    return WindowDataset(folder, episodes, n_points=points, labels=labels).load()


def _checksum(folder: Path, episodes: NDArray[np.int64]) -> str:
    """Return one SHA-256 of some films and their labels."""
    dataset = Dataset(folder)
    digest = hashlib.sha256()
    for number in episodes.tolist():
        for path in (dataset.path_of(number), dataset.labels("full").path_of(number)):
            digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the stages of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--protocol", type=Path, default=Path(__file__).with_suffix(".json"))
    parser.add_argument("--work", type=Path, default=ROOT / "runs" / "paper", help="folder for films and trainings")
    parser.add_argument("--out", type=Path, default=ROOT / "book" / "results" / "paper.csv")
    parser.add_argument("--stages", nargs="+", choices=STAGES, default=STAGES)
    parser.add_argument("--networks", nargs="+", help="of those of the protocol")
    parser.add_argument("--workers", type=int, default=1, help="processes for films and labels (default 1)")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    protocol = json.loads(options.protocol.read_text(encoding="utf-8"))
    experiment = Experiment(
        protocol,
        options.work,
        options.protocol.parent,
        options.workers,
        tuple(options.networks or protocol["networks"]),
    )
    stages = {
        "films": experiment.make_films,
        "labels": experiment.label_films,
        "trainings": experiment.train_all,
        "tests": experiment.make_tests,
        "forecasts": experiment.forecast,
        "table": lambda: experiment.tabulate(options.out),
    }
    for stage, run in stages.items():
        if stage in options.stages:
            print(f"-- {stage}", flush=True)
            run()


if __name__ == "__main__":
    main()
