"""Measure what simulation costs, and how often scripted paths succeed: book/results/simulation.json.

    python book/experiments/simulation.py --dataset runs/dataset > book/results/simulation.json

Takes minutes on two cores. Three tables: our per-step overhead over bare PyBullet stepping the same scene, in alternate blocks of
one run; seconds an episode by garment and resolution; success and rejection by task, of the episodes of a dataset, with Wilson's
95 % confidence intervals.
"""

import argparse
import dataclasses
import json
import math
import statistics
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from topokit.data import Dataset
from topokit.sim import TASKS, WARDROBE, SimulationConfig, World, simulate

SPACINGS = {"apron": (0.05, 0.04, 0.03, 0.022), "tote": (0.05, 0.04, 0.03, 0.02), "shirt": (0.06, 0.045, 0.035, 0.025)}


def overhead(name: str, spacing: float, blocks: int = 60, steps: int = 20) -> dict[str, Any]:
    """Return microseconds a step of `World.step` and of bare `stepSimulation` in the same scene, in alternate blocks.

    In a bare block nothing draws the grippers: they fall 2 mm, and are drawn back in the next one.
    """
    task = TASKS[f"{name}-hook"]
    garment = WARDROBE[name](spacing=spacing)
    path = task.plan(garment, task.target, np.random.default_rng(0))
    config = SimulationConfig()
    goal = path.at(0.0)
    offset = goal.mean(axis=0) - garment.vertices[garment.grips].mean(axis=0)
    ours = []
    bare = []
    with World(garment, offset, config) as world:
        world.add_rods(task.target.rods)
        for _ in range(400):
            world.step(goal)
        step = world._p.stepSimulation
        client = world._client
        for _ in range(blocks):
            for times, advance in ((ours, lambda: world.step(goal)), (bare, lambda: step(client))):
                start = time.perf_counter()
                for _ in range(steps):
                    advance()
                times.append((time.perf_counter() - start) / steps)
    ratio = statistics.median(a / b for a, b in zip(ours, bare, strict=True)) - 1
    us = 1e6 * np.array([statistics.median(ours), statistics.median(bare)])
    return {"garment": name, "vertices": len(garment.vertices), "ours_us": us[0], "bare_us": us[1], "overhead": ratio}


def cost(name: str, spacing: float) -> dict[str, Any]:
    """Return seconds of one episode, in a process of its own."""
    target = "mannequin" if name in ("shirt", "vest") else "hook"
    garment = WARDROBE[name](spacing=spacing)
    start = time.perf_counter()
    episode = simulate(garment, task=f"{name}-{target}", n_observed=100)
    seconds = time.perf_counter() - start
    steps = round((len(episode) * episode.dt + SimulationConfig().settle) / SimulationConfig().dt)
    return {"garment": name, "target": target, "vertices": len(garment.vertices), "steps": steps, "seconds": seconds}


def recorded(folder: Path) -> list[dict[str, Any]]:
    """Return a row for each episode of a dataset: whether it hung, why it was rejected, how far its cloth was stretched."""
    dataset = Dataset(folder)
    lines = (folder / "timing.jsonl").read_text().splitlines()
    seconds = {row["episode"]: row["seconds"] for row in map(json.loads, lines)}
    rows = []
    for record in dataset.records:
        row = {"task": record.task, "seconds": seconds.get(record.episode, math.nan)}
        if record.status == "ok":
            row |= {"success": record.success, "vertices": dataset[record.episode].points.shape[1]}
            row |= record.physics["stretch"]
        else:
            row["rejected"] = record.reason
        rows.append(row)
    return sorted(rows, key=lambda row: row["task"])


def by_task(rows: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield success, rejection, cost and stretch of every task."""
    for name in dict.fromkeys(row["task"] for row in rows):
        mine = [row for row in rows if row["task"] == name]
        good = [row for row in mine if "rejected" not in row]
        hung = sum(row["success"] for row in good)
        low, high = binomtest(hung, len(mine)).proportion_ci(method="wilson")
        yield {
            "task": name,
            "episodes": len(mine),
            "hung": hung,
            "low": low,
            "high": high,
            "rejected": len(mine) - len(good),
            "vertices": max((row["vertices"] for row in good), default=0),
            "seconds": statistics.median(row["seconds"] for row in mine),
            "p99": max((row["p99"] for row in good), default=math.nan),
            "worst": max((row["worst"] for row in good), default=math.nan),
        }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=("overhead", "cost", "success"), help="one of the three tables")
    parser.add_argument("--dataset", type=Path, required=True, help="a dataset of `topokit generate`")
    options = parser.parse_args()
    answer: dict[str, Any] = {"config": dataclasses.asdict(SimulationConfig())}
    if options.only in (None, "overhead"):
        answer["overhead"] = [overhead(name, spacing) for name in ("apron", "tote") for spacing in (0.05, 0.03, 0.022)]
    if options.only in (None, "cost"):
        answer["cost"] = [cost(name, spacing) for name, spacings in SPACINGS.items() for spacing in spacings]
    if options.only in (None, "success"):
        answer["success"] = list(by_task(recorded(options.dataset)))
    print(json.dumps(answer, indent=1))


if __name__ == "__main__":
    main()
