"""Measure what a dataset costs: episodes an hour, windows a second: book/results/dataset.json.

    python book/experiments/dataset.py --dataset runs/dataset --out book/results/dataset.json

Needs a labelled dataset. Takes minutes on two cores. The parts:

scaling   the same episodes on one worker and on two, and what follows for 23,000 episodes on more cores by the law below
windows   windows a second of a labelled dataset, through a DataLoader

The law: with s seconds an episode on a core, W workers make 3600 W / (s (1 + c (W - 1))) episodes an hour, for the part c that
workers cost each other, measured from 1 and 2. A fresh process for each episode is the other limit, measured with empty jobs.
"""

import argparse
import json
import multiprocessing
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import torch
from tables import write_results

from topokit.data import DatasetConfig, WindowDataset, generate_dataset

WANTED = 23_000


def scaling(folder: Path, episodes: int) -> list[dict[str, Any]]:
    """Make the same episodes of all tasks with one worker and with two."""
    rows: list[dict[str, Any]] = []
    for workers in (1, 2):
        start = time.perf_counter()
        dataset = generate_dataset(
            DatasetConfig(), folder / f"workers{workers}", episodes, 0, n_workers=workers, progress=False
        )
        wall = time.perf_counter() - start
        row = {"workers": workers, "episodes": episodes, "wall_s": wall, "episodes_an_hour": 3600 * episodes / wall}
        rows.append(row)
        row |= {"efficiency": rows[0]["wall_s"] / (wall * workers), "checksum": dataset.checksum()}
    if len({row["checksum"] for row in rows}) != 1:
        raise SystemExit(f"the datasets differ: {rows}")
    return rows


def dispatch(jobs: int = 100) -> float:
    """Return how many fresh processes a second the standard library starts, one after the other."""
    context = multiprocessing.get_context("forkserver")
    with ProcessPoolExecutor(1, context, max_tasks_per_child=1) as pool:
        pool.submit(abs, 0).result()
        start = time.perf_counter()
        list(pool.map(abs, range(jobs)))
        return jobs / (time.perf_counter() - start)


def law(rows: list[dict[str, Any]], jobs_a_second: float) -> dict[str, Any]:
    """Return hours for 23,000 episodes on W cores, from what one worker and two took."""
    seconds = rows[0]["wall_s"] / rows[0]["episodes"]
    cost = max(0.0, 1 / rows[1]["efficiency"] - 1)
    hours = {}
    for cores in (1, 2, 16, 64):
        rate = min(cores / (seconds * (1 + cost * (cores - 1))), jobs_a_second)
        hours[cores] = WANTED / rate / 3600
    return {"seconds_an_episode": seconds, "cost": cost, "jobs_a_second": jobs_a_second, "hours": hours}


def windows(folder: Path, batch: int = 64) -> list[dict[str, Any]]:
    """Return windows a second in batches by a loader with some workers."""
    torch.set_num_threads(1)
    data = WindowDataset(folder, n_points=128).load()
    rows = []
    for processes in (0, 1, 2):
        sampler = torch.utils.data.RandomSampler(data, replacement=True, num_samples=100 * batch)
        batches = iter(torch.utils.data.DataLoader(data, batch, sampler=sampler, num_workers=processes))
        next(batches)
        start = time.perf_counter()
        count = sum(len(part["frame"]) for part in batches)
        rate = count / (time.perf_counter() - start)
        rows.append({"loader_workers": processes, "batch": batch, "windows_a_second": rate})
    return rows


def main() -> None:
    """Measure the parts and print them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dataset", type=Path, default=Path("data_small/dataset"), help="a labelled dataset")
    parser.add_argument("--episodes", type=int, default=40, help="for scaling (default 40)")
    parser.add_argument("--out", type=Path, help="where to write the answers (.json)")
    options = parser.parse_args()
    answers: dict[str, Any] = {}
    with tempfile.TemporaryDirectory(dir=options.dataset.parent) as temporary:
        answers["scaling"] = scaling(Path(temporary), options.episodes)
    answers["law"] = law(answers["scaling"], dispatch())
    answers["windows"] = windows(options.dataset)
    print(json.dumps(answers, indent=1))
    if options.out:
        write_results(options.out, answers)


if __name__ == "__main__":
    main()
