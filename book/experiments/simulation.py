"""Measure what simulation costs, and how often scripted paths succeed: book/results/simulation.json.

    python book/experiments/simulation.py --dataset runs/dataset --json

Takes minutes on two cores with `--dataset`, and hours without.

Three tables: our per-step overhead over bare PyBullet stepping the same scene, in alternate blocks of one run; seconds an episode
by garment and resolution; success and rejection by task with Wilson's 95 % confidence intervals. Episodes are appended to a
file (--results) one by one and not simulated again, so that a long measurement can be stopped and continued.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import statistics
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from topokit.data import Dataset
from topokit.sim import TASKS, WARDROBE, Randomisation, SimulationConfig, SimulationError, World, simulate

SPACINGS = {"apron": (0.05, 0.04, 0.03, 0.022), "tote": (0.05, 0.04, 0.03, 0.02), "shirt": (0.06, 0.045, 0.035, 0.025)}


def wilson(successes: int, trials: int, z: float = 1.96) -> tuple[float, float]:
    """Return Wilson's score interval for a share."""
    if trials == 0:
        return 0.0, 1.0
    share = successes / trials
    spread = z * z / trials
    middle = (share + spread / 2) / (1 + spread)
    half = z * math.sqrt(share * (1 - share) / trials + spread / (4 * trials)) / (1 + spread)
    return max(middle - half, 0.0), min(middle + half, 1.0)


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
    """Return seconds of one episode, in a process of its own, and how much of it the process costs."""
    target = "mannequin" if name in ("shirt", "vest") else "hook"
    garment = WARDROBE[name](spacing=spacing)
    start = time.perf_counter()
    episode = simulate(garment, task=f"{name}-{target}", n_observed=100)
    seconds = time.perf_counter() - start
    steps = round((len(episode) * episode.dt + SimulationConfig().settle) / SimulationConfig().dt)
    row = {"garment": name, "target": target, "vertices": len(garment.vertices), "steps": steps, "seconds": seconds}
    start = time.perf_counter()
    short = SimulationConfig(frames=2, steps_per_frame=1, settle=0.0)
    simulate(garment, task=f"{name}-{target}", n_observed=100, config=short)
    return {**row, "process_seconds": time.perf_counter() - start}


def attempt(name: str, seed: int, randomise: bool) -> dict[str, Any]:
    """Simulate one episode of a task; return whether it hung, why it was rejected, how far its cloth was stretched."""
    row: dict[str, Any] = {"task": name, "seed": seed, "randomise": randomise}
    start = time.perf_counter()
    try:
        episode = simulate(
            task=name, seed=seed, randomisation=Randomisation() if randomise else None, n_observed=100, time_limit=300
        )
    except SimulationError as error:
        return {**row, "seconds": time.perf_counter() - start, "rejected": str(error)}
    speed = float(np.linalg.norm(episode.points[-1] - episode.points[-2], axis=1).mean()) / episode.dt
    row |= {"seconds": time.perf_counter() - start, "success": bool(episode.success), "speed": speed}
    return {**row, "vertices": episode.points.shape[1], **episode.physics["stretch"]}


def attempts(names: list[str], seeds: range, randomise: bool, results: Path) -> list[dict[str, Any]]:
    """Return the rows of these tasks and seeds; those that are not in the file yet are simulated and appended."""
    lines = results.read_text().splitlines() if results.exists() else []
    known = {(row["task"], row["seed"], row["randomise"]): row for row in map(json.loads, lines)}
    wanted = [(name, seed, randomise) for seed in seeds for name in names]
    results.parent.mkdir(parents=True, exist_ok=True)
    for done, key in enumerate(wanted):
        if key not in known:
            known[key] = attempt(*key)
            with results.open("a") as file:
                file.write(json.dumps(known[key]) + "\n")
        if sys.stderr.isatty():
            print(
                f"\repisode {done + 1} of {len(wanted)}", end="\n" if done + 1 == len(wanted) else "", file=sys.stderr
            )
    return [known[key] for key in wanted]


def recorded(folder: Path) -> list[dict[str, Any]]:
    """Return the same rows, of the episodes of a dataset that `topokit generate` made."""
    dataset = Dataset(folder)
    lines = (folder / "timing.jsonl").read_text().splitlines()
    seconds = {row["episode"]: row["seconds"] for row in map(json.loads, lines)}
    rows = []
    for record in dataset.records:
        row: dict[str, Any] = {
            "task": record.task,
            "seed": record.episode,
            "seconds": seconds.get(record.episode, math.nan),
        }
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
        low, high = wilson(hung, len(mine))
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
            "failed": [row["seed"] for row in mine if "rejected" in row or not row["success"]],
        }


def table(rows: list[dict[str, Any]], columns: dict[str, str]) -> None:
    """Print rows as a table: column name to format."""
    print("  ".join(f"{name:>{len(format(rows[0][name], form))}}" for name, form in columns.items()))
    for row in rows:
        print("  ".join(f"{format(row[name], form):>{len(name)}}" for name, form in columns.items()))
    print()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=("overhead", "cost", "success"), help="one of the three tables")
    parser.add_argument(
        "--tasks", nargs="+", choices=list(TASKS), default=list(TASKS), metavar="TASK", help="default: all"
    )
    parser.add_argument("--seeds", type=int, default=50, help="episodes a task (default 50)")
    parser.add_argument(
        "--randomise", action="store_true", help="draw physics and sizes from the default Randomisation"
    )
    parser.add_argument("--results", type=Path, default=Path("simulation.jsonl"), help="file of episodes to continue")
    parser.add_argument(
        "--dataset", type=Path, help="success of the episodes of this dataset, instead of simulating any"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON document instead of tables")
    options = parser.parse_args()
    answer: dict[str, list[dict[str, Any]]] = {}
    if options.only in (None, "overhead"):
        answer["overhead"] = [overhead(name, spacing) for name in ("apron", "tote") for spacing in (0.05, 0.03, 0.022)]
    if options.only in (None, "cost"):
        answer["cost"] = [cost(name, spacing) for name, spacings in SPACINGS.items() for spacing in spacings]
    if options.only in (None, "success"):
        rows = (
            recorded(options.dataset)
            if options.dataset
            else attempts(options.tasks, range(options.seeds), options.randomise, options.results)
        )
        answer["success"] = list(by_task(rows))
    if options.json:
        print(json.dumps({"config": dataclasses.asdict(SimulationConfig()), **answer}, indent=1))
        return
    shapes = {
        "overhead": {"garment": "8", "vertices": "8d", "ours_us": "8.0f", "bare_us": "8.0f", "overhead": "8.1%"},
        "cost": {
            "garment": "8",
            "target": "10",
            "vertices": "8d",
            "steps": "6d",
            "seconds": "8.1f",
            "process_seconds": "8.2f",
        },
        "success": {"task": "20", "vertices": "8d", "episodes": "8d", "hung": "5d", "low": "5.0%", "high": "5.0%"}
        | {"rejected": "8d", "seconds": "8.1f", "p99": "6.2f", "worst": "6.2f"},
    }
    for name, rows in answer.items():
        table(rows, shapes[name])


if __name__ == "__main__":
    main()
