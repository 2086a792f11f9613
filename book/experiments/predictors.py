"""Time predictors against running seqPH, and training: book/results/predictors.json. One core, one run.

    python book/experiments/predictors.py --help

Forecasts: 60 steps from the recorded apron, by freshly drawn weights (which cost what trained ones do) or by checkpoints.
*observe* takes in the next frame; *one plan* is everything after that until the 60 states are there; *plans* the same for many
plans at once; *exact* one plan with the loops sought anew in the moved cloud, 1, 15, 30 and 60 frames ahead. The persistence of
that frame, by seqPH (all that its update does), ripser.py and GUDHI, stands below. Times are of the processor (one core, one
thread), medians of `--repeat` after one that is not counted; the clock's are beside them.

Training: steps on windows in memory, or with --dataset on real ones, read as `topokit train` reads them. The operations of the
linear layers, counted, against what one large matrix product reaches on the same core in the same run, say what binds: data,
when most of the time goes into reading windows; compute, when the products run near that speed; else memory, the passes over
arrays between them.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
import torch
from torch.utils.data import DataLoader
from torch.utils.flop_counter import FlopCounterMode

import topokit as tk
from topokit.data import Dataset, WindowDataset
from topokit.io import load_episode
from topokit.models import (
    Motion,
    MotionPredictor,
    Normalisation,
    Predictor,
    Scenes,
    Shape,
    TrainConfig,
    build,
    forecast_loss,
)

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "tests"))
from windows import RingScenes, RingWindows

EPISODE = ROOT / "data_small" / "apron_hook_0.npz"
NETWORKS = ("mlp", "pointnet", "motion")
MODELS = ("hold", "carry", "ridge", *NETWORKS)
Times = dict[str, float]


def configured(name: str) -> TrainConfig:
    """Return the options and the loss of the trained checkpoint, or the defaults where there is none."""
    path = ROOT / "data_small" / "checkpoints" / f"{name}.json"
    return TrainConfig.load(path) if path.exists() else TrainConfig(name)


def fresh(name: str) -> torch.nn.Module:
    """Return a model with freshly drawn weights."""
    how = configured(name)
    return build(name, how.shape, Normalisation(), how.options)


def predictor_of(name: str) -> Predictor:
    """Return the predictor of a model."""
    model = fresh(name)
    return MotionPredictor(model) if isinstance(model, Motion) else Predictor(model)


def timed(function: Callable[[], object], repeat: int) -> Times:
    """Return the median milliseconds of the processor and of the clock."""
    spent = []
    for _ in range(repeat + 1):
        clock = time.perf_counter()
        start = time.process_time()
        function()
        spent.append((1e3 * (time.process_time() - start), 1e3 * (time.perf_counter() - clock)))
    ms, clock_ms = (statistics.median(column) for column in zip(*spent[1:], strict=True))
    return {"ms": round(ms, 3), "clock_ms": round(clock_ms, 3)}


def forecasts(predictor: Predictor, plans: int, repeat: int) -> dict[str, Times]:
    """Return the times of observing, of one plan, and of many."""
    episode = load_episode(EPISODE)
    for t in range(25, 41):
        predictor.observe(episode.observed[t], episode.grippers[t], target=episode.centre_line)
    actions = np.asarray(episode.actions[np.minimum(np.arange(41, 101), len(episode) - 1)])
    rng = np.random.default_rng(0)
    many = actions + rng.normal(0, 0.02, (plans, 60, 2, 3)).astype(np.float32)

    def first() -> None:
        forget(predictor)
        predictor.predict(actions)

    def exact() -> None:
        forget(predictor)
        predictor.predict(actions, exact=(1, 15, 30, 60))

    found = {
        "observe": timed(lambda: predictor.observe(episode.observed[40], episode.grippers[40]), repeat),
        "one plan": timed(first, repeat),
        f"{plans} plans": timed(lambda: predictor.predict(many), max(5, repeat // 4)),
    }
    if isinstance(predictor, MotionPredictor):
        found["exact at four"] = timed(exact, repeat)
    return found


def forget(predictor: Predictor) -> None:
    """Forget what was computed for this frame, as after a new one."""
    if isinstance(predictor, MotionPredictor):
        predictor._codes = {}
    else:
        predictor._context = None


def topology(repeat: int) -> dict[str, Times]:
    """Time the same frame by seqPH and by the libraries that are installed."""
    points = load_episode(EPISODE).observed[39:41].astype(float)
    tracker = tk.SeqPH()
    tracker.update(points[0])
    found: dict[str, Callable[[], object]] = {"seqPH": lambda: tracker.update(points[1])}
    if find_spec("ripser"):
        import ripser

        found["ripser.py"] = lambda: ripser.ripser(points[1], maxdim=1)
    if find_spec("gudhi"):
        import gudhi

        def edge_collapse() -> None:
            tree = gudhi.RipsComplex(points=points[1]).create_simplex_tree(max_dimension=1)
            tree.collapse_edges()
            tree.expansion(2)
            tree.persistence(homology_coeff_field=2)

        found["GUDHI"] = edge_collapse
    return {name: timed(function, max(5, repeat // 4)) for name, function in found.items()}


def batches(name: str, dataset: Path | None, batch: int, steps: int) -> Iterator[dict[str, torch.Tensor]]:
    """Yield batches of windows as training of that model reads them."""
    points = Shape().points
    if name == "motion":
        data: Any = RingScenes(2 * batch) if dataset is None else Scenes(Dataset(dataset), Dataset(dataset).episodes)
    elif dataset is None:
        data = RingWindows(2 * batch)
        for item in data.items:
            item["clouds"] = item["clouds"].repeat(1, -(-points // item["clouds"].shape[1]), 1)[:, :points]
    else:
        data = WindowDataset(dataset, n_points=points).load()
    taken = 0
    while taken < steps:
        for window in DataLoader(data, batch, shuffle=True, drop_last=True):
            if taken == steps:
                return
            taken += 1
            yield window


def training(name: str, dataset: Path | None, batch: int, steps: int, peak: float) -> dict[str, Any]:
    """Return windows a second, the parts of a step, and what limits the speed."""
    model = fresh(name)
    weights = configured(name).loss

    def loss_of(window: dict[str, torch.Tensor]) -> torch.Tensor:
        if isinstance(model, Motion):
            return model.loss(window, torch.Generator().manual_seed(0))[0]
        return forecast_loss(model(window), window, weights)[0]

    optimizer = torch.optim.AdamW(model.parameters())
    reader = batches(name, dataset, batch, steps + 1)
    first = next(reader)
    with FlopCounterMode(display=False) as counter:
        loss_of(first).backward()
    spent = dict.fromkeys(("data", "forward and loss", "backward", "optimiser"), 0.0)
    start = before = time.perf_counter()
    for window in reader:
        marks = [time.perf_counter()]
        loss = loss_of(window)
        marks.append(time.perf_counter())
        optimizer.zero_grad()
        loss.backward()
        marks.append(time.perf_counter())
        optimizer.step()
        marks.append(time.perf_counter())
        for part, begin, end in zip(spent, [before, *marks], marks, strict=False):
            spent[part] += end - begin
        before = marks[-1]
    seconds = before - start
    speed = counter.get_total_flops() * steps / (seconds - spent["data"]) / 1e9
    binds = "memory"
    if spent["data"] > seconds / 2:
        binds = "data"
    elif speed > peak / 2:
        binds = "compute"
    return {
        "windows_per_second": round(batch * steps / seconds, 1),
        "shares": {part: round(value / seconds, 3) for part, value in spent.items()},
        "gflops": round(speed, 1),
        "bound_by": binds,
        "parameters": sum(part.numel() for part in model.parameters()),
    }


def peak_gflops() -> float:
    """Return what a large matrix product reaches."""
    a = torch.randn(1024, 1024)
    return 2 * 1024**3 / timed(lambda: a @ a, 10)["clock_ms"] / 1e6


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", nargs="+", choices=list(MODELS), default=list(NETWORKS))
    parser.add_argument("--checkpoints", type=Path, nargs="*", default=[], metavar="FILE", help="these as well")
    parser.add_argument("--plans", type=int, default=1000)
    parser.add_argument("--repeat", type=int, default=40)
    parser.add_argument("--dataset", type=Path, metavar="DIR", help="train on its windows (labels `full`)")
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--steps", type=int, default=10, help="of training; 0 leaves it out")
    parser.add_argument("--json", type=Path, help="also write the numbers there")
    options = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    torch.set_num_threads(1)
    predictors = {name: predictor_of(name) for name in options.models}
    predictors |= {path.stem: Predictor.load(path) for path in options.checkpoints}
    answer: dict[str, Any] = {"machine": platform.machine(), "torch": torch.__version__, "cores": 1}
    answer["forecast"] = {
        name: forecasts(predictor, options.plans, options.repeat) for name, predictor in predictors.items()
    }
    answer["topology"] = topology(options.repeat)
    if options.steps:
        peak = peak_gflops()
        answer["peak_gflops"] = round(peak, 1)
        learning = [name for name in options.models if fresh(name).learns]
        answer["training"] = {
            name: training(name, options.dataset, options.batch, options.steps, peak) for name in learning
        }
    print(json.dumps(answer, indent=1))
    if options.json:
        options.json.write_text(json.dumps(answer, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
