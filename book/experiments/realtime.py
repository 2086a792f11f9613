"""Measure frames a second of the tracker, end to end, on one core.

    python book/experiments/realtime.py

Takes a minute on one core.

A film of the recorded apron with as many points as asked for: the same places on its triangles in every frame. Every setting is
run `--repeat` times after a run that is not counted; the table gives the median frame, and what its parts take in the first
setting. Times are of the processor (one core, one thread), which other programs stretch less; the clock's are beside them.
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
from contextlib import contextmanager
from pathlib import Path
from typing import Any

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np

import topokit as tk
from topokit.io import load_episode
from topokit.seqph import PAPER, _tracker

PARTS: dict[tuple[Any, str], str] = {
    (_tracker, "as_tree"): "tree of neighbours",
    (tk.SeqPH, "_frame"): "which points count, alpha",
    (_tracker, "rips_persistence"): "persistence",
    (tk.SeqPH, "_motion"): "epsilon",
    (_tracker, "place"): "places",
    (_tracker, "loop_at"): "triangles, neighbours",
}
SETTINGS: dict[str, dict[str, Any]] = {
    "everything estimated": {},
    "alpha, beta, epsilon given": {"alpha": 0.012, "beta": 0.2, "epsilon": 0.03},
    "the paper's": dict(PAPER),
    "cycle": {"identity": "cycle"},
}


def film(n: int, frames: int) -> list[np.ndarray]:
    """Return clouds of `n` points: a farthest-point sample of places on the first frame's triangles, carried along."""
    episode = load_episode(Path(__file__).parents[2] / "data_small" / "apron_hook_0.npz")
    corners = episode.points[:frames, episode.faces].astype(float)  # (T, F, 3, 3)
    rng = np.random.default_rng(0)
    area = np.linalg.norm(np.cross(corners[0, :, 1] - corners[0, :, 0], corners[0, :, 2] - corners[0, :, 0]), axis=1)
    u, v = np.sort(rng.random((2, 6 * n)), axis=0)
    weights = np.column_stack([u, v - u, 1 - v])
    triangle = rng.choice(len(area), 6 * n, p=area / area.sum())
    points = np.einsum("ik,tikd->tid", weights, corners[:, triangle])
    kept = tk.farthest_point_sample(points[0], n)[0]
    return list(np.ascontiguousarray(points[:, kept]))


@contextmanager
def timed(spent: dict[str, float]) -> Iterator[None]:
    """Add up the seconds in the parts of the tracker."""
    originals = {part: getattr(*part) for part in PARTS}

    def around(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **options: Any) -> Any:
            start = time.process_time()
            try:
                return function(*args, **options)
            finally:
                spent[name] = spent.get(name, 0.0) + time.process_time() - start

        return call

    try:
        for (owner, part), function in originals.items():
            setattr(owner, part, around(PARTS[owner, part], function))
        yield
    finally:
        for (owner, part), function in originals.items():
            setattr(owner, part, function)


def milliseconds(clouds: list[np.ndarray], options: dict[str, Any]) -> list[tuple[float, float]]:
    """Return the milliseconds of every frame: of the processor, and of the clock."""
    tracker = tk.SeqPH(**options)
    spent = []
    for cloud in clouds:
        clock = time.perf_counter()
        start = time.process_time()
        tracker.update(cloud)
        spent.append((1000 * (time.process_time() - start), 1000 * (time.perf_counter() - clock)))
    return spent


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=1000)
    parser.add_argument("--frames", type=int, default=90)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--json", action="store_true", help="print one JSON document instead of a table")
    options = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # one core
    clouds = film(options.points, options.frames)
    answer: dict[str, Any] = {"points": options.points, "frames": options.frames, "machine": platform.machine()}
    for name, setting in SETTINGS.items():
        milliseconds(clouds, setting)
        frames = [ms for _ in range(options.repeat) for ms in milliseconds(clouds, setting)]
        frame, clock = (statistics.median(column) for column in zip(*frames, strict=True))
        answer[name] = {"ms": round(frame, 3), "frames_per_second": round(1000 / frame, 1), "clock_ms": round(clock, 3)}
    spent: dict[str, float] = {}
    start = time.process_time()
    with timed(spent):
        milliseconds(clouds, SETTINGS["everything estimated"])
    spent["the rest (checks, matching)"] = time.process_time() - start - sum(spent.values())
    answer["parts_ms"] = {name: round(1000 * seconds / len(clouds), 3) for name, seconds in spent.items()}
    if options.json:
        json.dump(answer, sys.stdout, indent=1)
        return
    for name in SETTINGS:
        ms, rate, clock = (answer[name][key] for key in ("ms", "frames_per_second", "clock_ms"))
        print(f"{name:30}{ms:8.2f} ms {rate:8.1f} frames/s{clock:10.2f} ms by the clock")
    print("parts of the first (ms a frame):")
    for name, value in answer["parts_ms"].items():
        print(f"  {name:28}{value:8.2f}")


if __name__ == "__main__":
    main()
