"""Time predictors against running seqPH: book/results/predictors.json. One core, one run.

    python book/experiments/predictors.py --json book/results/predictors.json

Forecasts: 60 steps from the recorded apron, by freshly drawn weights, which cost what trained ones do.
*observe* takes in the next frame; *one plan* is everything after that until the 60 states are there; *plans* is the same for
many plans at once. Beside it: the loops of that frame by seqPH and by GUDHI. Times are of the processor (one core, one thread),
medians of `--repeat`.
"""

import argparse
import json
import os
import platform
import statistics
import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
import torch

import topokit as tk
from topokit.io import load_episode
from topokit.models import Predictor, TrainConfig, build

from _rips_peers import gudhi_collapsed

ROOT = Path(__file__).parents[2]
EPISODE = ROOT / "data_small" / "apron_hook_0.npz"
NETWORKS = ("mlp", "pointnet")  # those of the paper; rips.py times plans by Motion
Times = dict[str, float]


def predictor_of(name: str) -> Predictor:
    """Return a network with the options of its trained checkpoint and freshly drawn weights."""
    config = TrainConfig.load(ROOT / "data_small" / "checkpoints" / f"{name}.json")
    return Predictor.of(build(name, config.shape, options=config.options))


def timed(function: Callable[[], object], repeat: int, before: Callable[[], object] = int) -> Times:
    """Return the median milliseconds of the processor; what is done `before` each call is not counted."""
    spent = []
    for _ in range(repeat + 1):
        before()
        start = time.process_time()
        function()
        spent.append(1e3 * (time.process_time() - start))
    return {"ms": round(statistics.median(spent[1:]), 3)}


def watch(predictor: Predictor, plans: int) -> tuple[Any, Any]:
    """Let a predictor observe the recorded apron; return the plan (60, 2, 3) from there, and many (plans, 60, 2, 3) about it."""
    episode = load_episode(EPISODE)
    for t in range(25, 41):
        predictor.observe(episode.observed[t], episode.grippers[t], target=episode.centre_line)
    actions = np.asarray(episode.actions[np.minimum(np.arange(41, 101), len(episode) - 1)])
    rng = np.random.default_rng(0)
    return actions, actions + rng.normal(0, 0.02, (plans, 60, 2, 3)).astype(np.float32)


def forecasts(predictor: Predictor, plans: int, repeat: int) -> dict[str, Times]:
    """Return the times of observing, of one plan, and of many."""
    episode = load_episode(EPISODE)
    actions, many = watch(predictor, plans)

    def observe() -> None:
        predictor.observe(episode.observed[40], episode.grippers[40])

    # What is encoded once a frame is a part of one plan's time, so a new frame is taken in before each.
    return {
        "observe": timed(observe, repeat),
        "one plan": timed(lambda: predictor.predict(actions), repeat, before=observe),
        f"{plans} plans": timed(lambda: predictor.predict(many), max(5, repeat // 4)),
    }


def topology(repeat: int) -> dict[str, Times]:
    """Time the same frame by seqPH, and by GUDHI where it is installed."""
    tk.rips_persistence(np.random.default_rng(0).random((6000, 2)))  # it waits for the compiled engine
    points = load_episode(EPISODE).observed[39:41].astype(float)
    tracker = tk.SeqPH()
    tracker.update(points[0])
    found: dict[str, Callable[[], object]] = {"seqPH": lambda: tracker.update(points[1])}
    if find_spec("gudhi"):
        found["GUDHI"] = lambda: gudhi_collapsed(points[1], False)
    return {name: timed(function, max(5, repeat // 4)) for name, function in found.items()}


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plans", type=int, default=1000)
    parser.add_argument("--repeat", type=int, default=40)
    parser.add_argument("--json", type=Path, help="also write the numbers there")
    options = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    torch.set_num_threads(1)
    answer: dict[str, Any] = {"machine": platform.machine(), "torch": torch.__version__, "cores": 1}
    answer["forecast"] = {name: forecasts(predictor_of(name), options.plans, options.repeat) for name in NETWORKS}
    answer["topology"] = topology(options.repeat)
    print(json.dumps(answer, indent=1))
    if options.json:
        options.json.write_text(json.dumps(answer, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
