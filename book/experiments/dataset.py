"""What a dataset costs: episodes an hour, the store, opening it, and windows a second. python book/experiments/dataset.py --help

Parts, each alone with --only:
  scaling   the same episodes on one worker and on two: seconds of simulation in each, efficiency, and what follows for
            23,000 episodes on this machine and on 16 and 64 cores (of the same speed) by the law below
  store     bytes an episode of a dataset, by array, and seconds to read one
  opening   a dataset of 23,000 records (made up: only records are read) with and without its index
  windows   windows a second of a labelled dataset: alone, through a DataLoader, with episodes decoded before and on the way

The law: with s seconds an episode on a core, W workers make 3600 W / (s (1 + c (W - 1))) episodes an hour, for the part c that
workers cost each other, measured from 1 and 2; and never more than the one scheduler hands out, measured with empty jobs.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import dataclasses
import json
import shutil
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from topokit.data._records import Record, index_bytes

from topokit.data import Dataset, DatasetConfig, generate_dataset
from topokit.data._generate import Cluster, run_jobs

WANTED = 23_000


def scaling(folder: Path, config: DatasetConfig, episodes: int, counts: list[int]) -> list[dict[str, Any]]:
    """Make the same episodes with different numbers of workers; the first ones of each worker warm up and are left out."""
    rows: list[dict[str, Any]] = []
    for workers in counts:
        out = folder / f"workers{workers}"
        generate_dataset(config, out, episodes, 0, n_workers=workers, progress=False)
        log = [json.loads(line) for line in (out / "timing.jsonl").read_text().splitlines()]
        start = log[0]["at"] - log[0]["seconds"]  # of the first episode: starting Dask is not counted
        wall = log[-1]["at"] - start
        busy = sum(entry["seconds"] for entry in log) / workers
        rows.append(
            {
                "workers": workers,
                "episodes": episodes,
                "wall_s": wall,
                "episodes_an_hour": 3600 * episodes / wall,
                "simulation_s_an_episode": statistics.mean(entry["seconds"] for entry in log),
                "busy": busy / wall,
                "efficiency": rows[0]["wall_s"] / (workers * wall) * counts[0] if rows else 1.0,
                "checksum": Dataset(out).checksum(),
            }
        )
    if len({row["checksum"] for row in rows}) != 1:
        raise SystemExit(f"the datasets differ: {rows}")
    return rows


def empty(item: int) -> dict[str, Any]:
    """A job that does nothing."""
    return {"status": "ok"}


def dispatch(jobs: int = 2000) -> float:
    """Jobs a second that the scheduler hands out to one worker and takes back."""
    done = 0
    for _ in run_jobs(empty, range(jobs), Cluster(n_workers=1)):
        if done == 0:
            start = time.perf_counter()
        done += 1
    return (done - 1) / (time.perf_counter() - start)


def law(rows: list[dict[str, Any]], jobs_a_second: float) -> dict[str, Any]:
    """Hours for 23,000 episodes on W cores."""
    one = rows[0]["wall_s"] / rows[0]["episodes"] * rows[0]["workers"]
    cost = 0.0
    if len(rows) > 1:
        cost = max(0.0, (1 / rows[1]["efficiency"] - 1) / (rows[1]["workers"] - 1))
    hours = {}
    for cores in (1, 2, 16, 64):
        rate = min(cores / (one * (1 + cost * (cores - 1))), jobs_a_second)
        hours[cores] = WANTED / rate / 3600
    # The cost that two workers have for each other is that of one memory bus; nodes of a cluster share none.
    nodes = {cores: WANTED * one * (1 + cost) / cores / 3600 for cores in (16, 64)}
    return {
        "seconds_an_episode": one,
        "cost": cost,
        "jobs_a_second": jobs_a_second,
        "hours": hours,
        "hours_on_nodes_of_2": nodes,
    }


def store(url: str) -> dict[str, Any]:
    """Bytes an episode, and seconds to read one."""
    dataset = Dataset(url)
    sizes = {}
    for path in sorted(Path(url).iterdir()):
        if path.is_dir() and path.name not in (".part", "labels"):
            sizes[path.name] = sum(file.stat().st_size for file in path.iterdir()) / max(1, len(dataset))
    for name in dataset.group.names("labels"):
        files = [file for file in (Path(url) / "labels" / name).rglob("*") if file.is_file()]
        sizes[f"labels/{name}"] = sum(file.stat().st_size for file in files) / max(1, len(dataset))
    some = dataset.episodes[:: max(1, len(dataset) // 50)]
    start = time.perf_counter()
    frames = [len(dataset[int(i)]) for i in some]
    seconds = (time.perf_counter() - start) / len(some)
    points = statistics.mean(record.vertices for record in dataset.records if record.status == "ok")
    whole = sum(size for name, size in sizes.items() if not name.startswith("labels"))
    return {
        "episodes": len(dataset),
        "bytes_an_episode": whole,
        "by_array": sizes,
        "mean_frames": statistics.mean(record.frames for record in dataset.records if record.status == "ok"),
        "mean_vertices": points,
        "gigabytes_of_23000": whole * WANTED / 1e9,
        "read_s": seconds,
        "frames_read": sum(frames),
    }


def opening(folder: Path, n: int = WANTED) -> dict[str, Any]:
    """Seconds to open a dataset of `n` records. The records are made up, as long as real ones."""
    config = DatasetConfig()
    small = folder / "small"
    from topokit.data import _generate

    jobs, _generate.run_jobs = _generate.run_jobs, lambda *_: (pair for pair in ())
    try:
        generate_dataset(config, small, n, 0, progress=False)
    finally:
        _generate.run_jobs = jobs
    rows = []
    for i in range(n):
        drawn = config.draw(0, i)
        rows.append(
            Record(i, "ok", "", drawn.task, *drawn.task.split("-"), drawn.seed, True, 96, 500, 500, f"{i:064x}")
        )
    (small / "index.json").write_bytes(index_bytes(rows))
    times = []
    for _ in range(5):
        start = time.perf_counter()
        assert len(Dataset(small)) == n
        times.append(time.perf_counter() - start)
    (small / "index.json").write_bytes(index_bytes(rows[: n - 500]))  # as after a kill: 500 are read one by one
    for row in rows[n - 500 :]:
        document = {**dataclasses.asdict(row), "objects": {}, "physics": "x" * 3000}
        (small / "records" / f"{row.episode:08d}.json").write_text(json.dumps(document))
    start = time.perf_counter()
    assert len(Dataset(small)) == n
    return {
        "records": n,
        "seconds": times,
        "seconds_with_500_loose": time.perf_counter() - start,
        "index_bytes": len(index_bytes(rows)),
    }


def windows(url: str, labels: str, n_points: int, batch: int, workers: list[int]) -> list[dict[str, Any]]:
    """Windows a second."""
    import torch

    from topokit.data import WindowDataset

    torch.set_num_threads(1)
    rows = []
    start = time.perf_counter()
    data = WindowDataset(url, labels=labels, n_points=n_points)
    made = time.perf_counter() - start
    start = time.perf_counter()
    data.load()
    loaded = time.perf_counter() - start
    rng = np.random.default_rng(0)
    start = time.perf_counter()
    for i in rng.integers(len(data), size=5000):
        data[int(i)]
    rate = 5000 / (time.perf_counter() - start)
    rows.append(
        {
            "windows": len(data),
            "index_s": made,
            "decode_s_an_episode": loaded / len(data.episodes),
            "windows_a_second": rate,
        }
    )
    for processes in workers:
        sampler = torch.utils.data.RandomSampler(data, replacement=True, num_samples=100 * batch)
        loader = torch.utils.data.DataLoader(data, batch, sampler=sampler, num_workers=processes)
        batches = iter(loader)
        next(batches)
        start = time.perf_counter()
        n = sum(len(part["frame"]) for part in batches)
        rows.append(
            {"loader_workers": processes, "batch": batch, "windows_a_second": n / (time.perf_counter() - start)}
        )
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=("scaling", "store", "opening", "windows"), action="append")
    parser.add_argument("--dataset", help="a labelled dataset, for store and windows")
    parser.add_argument("--labels", default="full")
    parser.add_argument("--config", type=Path, help="for scaling: a DatasetConfig (default: all tasks)")
    parser.add_argument("--episodes", type=int, default=40, help="for scaling (default 40)")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--points", type=int, default=128)
    parser.add_argument("--out", type=Path, help="where to write the answers (.json)")
    options = parser.parse_args()
    parts = options.only or ["scaling", "store", "opening", "windows"]
    if options.dataset is None and {"store", "windows"} & set(parts):
        parser.error("store and windows need --dataset")
    answers: dict[str, Any] = {}
    folder = Path(tempfile.mkdtemp())
    try:
        if "scaling" in parts:
            config = DatasetConfig.from_json(json.loads(options.config.read_text()) if options.config else {})
            answers["scaling"] = scaling(folder, config, options.episodes, options.workers)
            answers["law"] = law(answers["scaling"], dispatch())
        if "store" in parts:
            answers["store"] = store(options.dataset)
        if "opening" in parts:
            answers["opening"] = opening(folder)
        if "windows" in parts:
            answers["windows"] = windows(options.dataset, options.labels, options.points, 64, [0, 1, 2])
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    text = json.dumps(answers, indent=1)
    print(text)
    if options.out:
        options.out.write_text(text + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
