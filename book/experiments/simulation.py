"""Measure what simulation costs, and how often scripted paths succeed: book/results/simulation.json.

    python book/experiments/simulation.py --dataset runs/dataset > book/results/simulation.json

Takes minutes on two cores. Three tables: our per-step overhead over bare PyBullet stepping the same scene, in alternate blocks of
one run; seconds an episode by garment and resolution; success and rejection by task, of the episodes of a dataset, with Wilson's
95 % confidence intervals.
"""

import argparse
import json
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
    simulate(garment, task=f"{name}-{target}", n_observed=100)
    seconds = time.perf_counter() - start
    return {"garment": name, "target": target, "vertices": len(garment.vertices), "seconds": seconds}


def by_task(dataset: Dataset) -> Iterator[dict[str, Any]]:
    """Yield for every task how many episodes of a dataset hung, and how many were rejected."""
    for name in sorted({record.task for record in dataset.records}):
        mine = [record for record in dataset.records if record.task == name]
        hung = sum(record.success for record in mine)
        low, high = binomtest(hung, len(mine)).proportion_ci(method="wilson")
        rejected = sum(record.status != "ok" for record in mine)
        yield {"task": name, "episodes": len(mine), "hung": hung, "low": low, "high": high, "rejected": rejected}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dataset", type=Path, required=True, help="a dataset of `topokit generate`")
    options = parser.parse_args()
    answer = {
        "overhead": [overhead(name, spacing) for name in ("apron", "tote") for spacing in (0.05, 0.03, 0.022)],
        "cost": [cost(name, spacing) for name, spacings in SPACINGS.items() for spacing in spacings],
        "success": list(by_task(Dataset(options.dataset))),
    }
    print(json.dumps(answer, indent=1))


if __name__ == "__main__":
    main()
