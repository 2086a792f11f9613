"""Measure how far ahead cloth can be foreseen: the simulator forecasts its own films; book/results/foreseeable.json.

    python book/experiments/foreseeable.py --dataset runs/motion_test

A window of a film has its present at a frame at which the grippers hold. The film is simulated again twice, up to that frame with
the same plan: once the hands make a detour of 2 mm just before (*nudged*), once the cloth has other physics, drawn anew
from the ranges of the dataset (*other physics*), which no cloud shows. How far the vertices go on in such a twin, added to where
they are, is its forecast. Loops are read off it as off any other (`topokit.models.Predictor`) and measured as in
motion.py. Beside it: the motion that came (*known*), a trained model, and carry.
"""

import argparse
import dataclasses
import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import torch
from accuracy import measure_forecasts
from forecasts import kinds_of, of_stream, of_windows, spread_windows, true_curves
from numpy.typing import NDArray
from torch.utils.data import default_collate
from tqdm import tqdm

from topokit.control._planner import Carried
from topokit.data import Dataset, WindowDataset, make_episode
from topokit.models import Predictor, StateTensors, build
from topokit.sim import Randomisation, SimulationError
from topokit.sim._episode import Run, record_afresh

ROOT = Path(__file__).parents[2]
STEPS = (1, 15, 30, 60)
NUDGE = 0.002  # metres that both hands are beside their way
FRAMES = 6  # for so many frames
TOLERANCE = 0.01  # metres, that of motion.json
Array = NDArray[Any]


class Caught(Exception):
    """Raised instead of a simulation, with what would have been simulated."""


def run_of(dataset: Dataset, number: int) -> Run:
    """Return the simulator's input when it made that film."""

    def catch(run: Run, *_: object) -> None:
        raise Caught(run)

    with patch("topokit.sim._episode.record_afresh", catch):
        try:
            make_episode(dataset.config, dataset.seed, number)
        except Caught as caught:
            run: Run = caught.args[0]
    return run


def nudged(run: Run, frame: int, rng: np.random.Generator) -> Run:
    """Return the same run with both hands going 2 mm out of their way and back just before a frame."""
    way = rng.normal(size=3)
    steps = FRAMES * run.config.steps_per_frame
    bump = NUDGE * np.sin(np.pi * np.arange(steps) / steps)[:, None, None] ** 2 * way / np.linalg.norm(way)
    goals = run.goals.copy()
    end = frame * run.config.steps_per_frame
    goals[end - steps : end] += bump
    return dataclasses.replace(run, goals=goals)


def other_physics(run: Run, _: int, rng: np.random.Generator) -> Run:
    """Return the same run in cloth of another stiffness, damping, friction and mass."""
    config, *_rest = Randomisation(scale=None).draw(int(rng.integers(2**31)), run.config, run.garment)
    return dataclasses.replace(run, config=config)


TWINS = {"nudged": nudged, "other physics": other_physics}
TOLD = ("known", *TWINS, "motion")  # of all vertices


def told(model: Any, futures: Sequence[Array]) -> Any:
    """Return a predictor that moves clouds as it is told, (60, n, 3) window after window, and reads loops off them."""
    predictor: Any = Predictor.of(model)
    given = iter(futures)

    def move(*_: object) -> tuple[Array, Array]:
        places = next(given)[None].astype(np.float32)
        return places, np.zeros(places.shape[:3], np.float32)

    predictor.move = move
    return predictor


def forecast(model: Any, points: Array, film: Any, frame: int) -> Array:
    """Return (60, n, 3) what a model forecasts of all vertices."""
    model.reset()
    for t in range(frame - 15, frame + 1):
        model.observe(points[t], film.grippers[t], bool(film.held[t]), film.centre_line)
    ahead = slice(frame + 1, frame + 61)
    return model.move(film.actions[ahead], film.held[ahead])[0]


def carry_of(points: Array, film: Any, frame: int) -> Array:
    """Return (4, n, 3) where all vertices are at the `STEPS` if the grippers carry them as long as they hold."""
    ahead = slice(frame + 1, frame + 61)
    start = film.grippers[frame]
    moves = np.diff(film.actions[ahead], axis=0, prepend=start[None]) * film.held[ahead][:, None, None]
    carrier = Carried()
    carrier.observe(points[frame], start)
    places, _ = carrier.move(start + moves.cumsum(axis=0), None, points[frame])
    return places[np.array(STEPS) - 1]


def simulated(run: Run, job: tuple[int, int, str]) -> Array | None:
    """Return the places (T, n, 3) of a twin of a film; None where what was drawn is not physical."""
    number, frame, name = job
    try:
        twin = TWINS[name](run, frame, np.random.default_rng((number, frame)))
        return record_afresh(twin, 600.0)["points"].astype(float)
    except SimulationError:
        return None


def futures_of(film: Any, frame: int, twins: Mapping[str, Array], model: Any) -> dict[str, Array]:
    """Return by name the next 60 places (60, n, 3) of all vertices: known, of each twin, and of a model."""
    points = film.points.astype(float)
    ahead = slice(frame + 1, frame + 61)
    moved = {"known": points[ahead]}
    for name, twin in twins.items():
        moved[name] = points[frame] + twin[ahead] - twin[frame]
    return moved | {"motion": forecast(model, points, film, frame)}


def hits_of(windows: WindowDataset, futures: Mapping[str, list[Array]], model: Any) -> dict[str, Array]:
    """Return by name whether each window's forecast is in the hull at the `STEPS`: 1, 0, or nan without a true loop."""
    batch = default_collate([windows[i] for i in range(len(windows))])
    truth = true_curves(windows, range(len(windows)), STEPS)
    target = StateTensors.from_labels(batch)
    past = StateTensors.from_past(batch)[:, -1:]

    # Given motions are read as a model's own motions are. Carry moves the loops alone.
    forecasters = {"carry": of_windows(build("carry"))}
    for name, places in futures.items():
        forecasters[name] = of_stream(told(model.model, places), windows, STEPS)
    hits = {}
    for name, forecaster in forecasters.items():
        with torch.inference_mode():
            columns = measure_forecasts(forecaster(batch), target, past, truth, STEPS, (), np.random.default_rng(0))
        away = columns["hull_distance"]
        hits[name] = np.where(np.isnan(away), np.nan, away <= TOLERANCE)
    return hits


def main() -> None:
    """Simulate the twins of some windows, measure all forecasts, and write them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dataset", type=Path, default=ROOT / "runs" / "motion_test")
    parser.add_argument("--model", type=Path, default=ROOT / "data_small" / "checkpoints" / "motion.safetensors")
    parser.add_argument("--windows", type=int, default=6, help="of each garment, at most")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", type=Path, default=ROOT / "book" / "results" / "foreseeable.json")
    options = parser.parse_args()

    # Windows at whose present the grippers hold.
    windows = WindowDataset(options.dataset, labels="full")
    dataset = windows.dataset
    rows = spread_windows(windows, options.windows)
    films = {int(number): dataset[int(number)] for number in np.unique(windows.index[rows, 0])}
    runs = {number: run_of(dataset, number) for number in films}
    windows = windows.select([row for row in rows if films[windows.index[row, 0]].held[windows.index[row, 1]]])

    # Simulate all twins, and leave out the windows of which one was refused.
    again = record_afresh(next(iter(runs.values())), 600.0)["points"]
    assert np.abs(again - next(iter(films.values())).points).max() < 1e-3, "here the same simulation gives another film"
    jobs = [(number, frame, name) for number, frame in windows.index.tolist() for name in TWINS]
    with ThreadPoolExecutor(options.workers) as pool:
        found = pool.map(lambda job: simulated(runs[job[0]], job), jobs)
        twins = dict(zip(jobs, tqdm(found, total=len(jobs), unit="twin"), strict=True))
    refused = {job[:2] for job, twin in twins.items() if twin is None}
    windows = windows.select([i for i, pair in enumerate(windows.index.tolist()) if tuple(pair) not in refused])

    # Forecasts of all vertices, and how far they are from where the vertices came.
    model: Any = Predictor.load(options.model)
    futures: dict[str, list[Array]] = {name: [] for name in TOLD}
    gaps: dict[str, list[list[float]]] = {name: [] for name in (*TOLD, "carry")}
    later = np.array(STEPS) - 1
    for number, frame in windows.index.tolist():
        film = films[number]
        points = film.points.astype(float)
        moved = futures_of(film, frame, {name: twins[number, frame, name] for name in TWINS}, model)
        there = {name: places[later] for name, places in moved.items()} | {"carry": carry_of(points, film, frame)}
        for name, places in there.items():
            off = np.linalg.norm(places - points[frame + 1 + later], axis=2).mean(axis=1)
            gaps[name].append((100 * off).round(2).tolist())
        for name, places in moved.items():
            futures[name].append(places)

    hits = hits_of(windows, futures, model)
    garments = kinds_of(windows, "garment").tolist()
    said = []
    for i, (number, frame) in enumerate(windows.index.tolist()):
        hit = {name: [None if np.isnan(x) else bool(x) for x in cells[i]] for name, cells in hits.items()}
        error = {name: cells[i] for name, cells in gaps.items()}
        said.append({"episode": number, "frame": frame, "garment": garments[i], "hit": hit, "error_cm": error})
    document = {"steps": STEPS, "nudge_m": NUDGE, "dataset": dataset.checksum(), "windows": said}
    options.json.write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
