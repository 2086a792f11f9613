"""Check the statements of topokit.lemmas on recorded episodes: book/results/lemmas_on_cloth.json and lemmas_on_test.json.

    python book/experiments/lemmas_on_cloth.py data_small [more folders or episodes] --out book/results/lemmas_on_cloth.json
    python book/experiments/lemmas_on_cloth.py --dataset runs/dataset --each 1 --out book/results/lemmas_on_test.json

With --dataset: the first episodes of each garment in the test part of the split by episode, those of chapter 6.

The state is all vertices of the garment, the observation what the episode recorded when that is a subsample of them; for
episodes seen by cameras, and with --observed, a farthest-point sample of the first frame's vertices, the same in all frames.
Lengths are metres. A minute or two an episode of 96 frames and 550 vertices.
"""

import argparse
import json
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from topokit import farthest_point_sample, lemmas, rips_persistence
from topokit.data import Dataset
from topokit.io import Episode, load_episode

MEASURES = ("alpha", "epsilon", "distortion", "lifetime", "death", "beta_all", "beta_critical", "beta_intrinsic")


@dataclass(frozen=True)
class StepCheck:
    """One step of an episode: the constants, and what became of every statement. A beta is nan where no loop lives so long."""

    frame: int  #: of S_t; S_t+1 is the next frame that is looked at
    alpha: float  #: the larger of both frames', in the unit of the points
    epsilon: float  #: in the unit of the points
    distortion: float  #: in the unit of the points
    lifetime: float  #: of the longest-lived loop of S_t; 0.0 when there is none
    death: float  #: of the same loop
    beta_all: float  #: the largest beta over all edges, of loops with a lifetime above the frame's alpha
    beta_critical: float  #: over (alpha, epsilon)-critical edges, of loops with a lifetime above alpha + 2 epsilon
    beta_intrinsic: float  #: the same as `beta_critical` with the distortion in place of epsilon
    checks: dict[str, Any]  #: by statement, in the paper's order


def verify_episode(points: np.ndarray, observed: np.ndarray, stride: int = 1) -> list[StepCheck]:
    """Check all statements on every step of a sequence, one fewer than the frames looked at: every stride-th.

    `points` (T, n, d) are the states; `observed` the ids of what is observed, (m,) in every frame or (T, m), or (T, m, d)
    coordinates of vertices.
    """
    steps = []
    for frame, later in pairwise(range(0, len(points), stride)):
        ids, ids_later = (observed_ids(points[t], observed, t) for t in (frame, later))
        checks = lemmas.verify_step(points[frame], ids, points[later], ids_later)
        steps.append(step_check(frame, points[frame], checks))
    return steps


def step_check(frame: int, points: np.ndarray, checks: dict[str, Any]) -> StepCheck:
    """Gather the constants of one step."""
    diagram = rips_persistence(points)
    check = checks["corollary"]
    return StepCheck(
        frame=frame,
        alpha=check.alpha,
        epsilon=check.epsilon,
        distortion=check.distortion,
        lifetime=float(diagram.lifetime.max(initial=0.0)),
        death=float(diagram.death[:1].max(initial=0.0)),
        beta_all=largest_bound(checks["recovering killers"], "paper"),
        # The corollary's bound is 2 beta + epsilon.
        beta_critical=(largest_bound(check, "corrected") - check.epsilon) / 2,
        beta_intrinsic=(largest_bound(check, "intrinsic") - check.epsilon) / 2,
        checks=checks,
    )


def largest_bound(check: Any, version: str) -> float:
    """Return the largest bound of a version, nan where it speaks about no loop."""
    return max((row.bounds[version] for row in check.loops if version in row.bounds), default=float("nan"))


def recorded(places: list[Path]) -> Iterator[tuple[str, Episode]]:
    """Yield the episodes among files and folders, by their names."""
    for place in places:
        paths = sorted(place.glob("*.npz")) or [place]
        for path in paths:
            if not path.name.endswith(".tracks.npz"):
                yield path.name, load_episode(path)


def of_dataset(folder: Path, each: int) -> Iterator[tuple[str, Episode]]:
    """Yield the first `each` tested episodes of every garment, by the names of their tasks and their numbers."""
    dataset = Dataset(folder)
    tested = [dataset.record(i) for i in dataset.split()["test"]]
    for garment in dataset.garments:
        for record in [record for record in tested if record.garment == garment][:each]:
            yield f"{record.task} {record.episode}", dataset[record.episode]


def observe(episode: Episode, n_observed: int | None) -> tuple[np.ndarray, str]:
    """Return what is observed of every frame, and how it was chosen."""
    if n_observed is None and episode.observation.get("kind", "vertices") == "vertices":
        return episode.observed, "as recorded"
    n = min(n_observed or episode.observed.shape[1], episode.points.shape[1])
    return np.sort(farthest_point_sample(episode.points[0], n)[0]), f"farthest-point sample of {n} vertices"


def observed_ids(points: np.ndarray, seen: np.ndarray, t: int) -> np.ndarray:
    """Return the ids of the vertices that are observed at frame t."""
    now = seen
    if seen.ndim > 1:
        now = seen[t]
    # Where coordinates are observed, the nearest vertices are meant.
    if now.ndim > 1:
        now = np.unique(cKDTree(points).query(now)[1])
    return now


def row(garment: str, step: StepCheck) -> dict[str, Any]:
    """Return the row of a step: the constants, and for the corollary the distance of killers with its bounds."""
    numbers = {name: getattr(step, name) for name in MEASURES}
    check = step.checks["corollary"]
    for loop in check.loops[:1]:
        bounds = {f"{name.split(',')[0].replace(' ', '')}_bound": bound for name, bound in loop.bounds.items()}
        numbers |= {"killer_distance": loop.statistic, **bounds}
    shifts = {
        "bottleneck_states": step.checks["temporal persistence"].corrected.statistic,
        "bottleneck_observations": step.checks["gates"].corrected.statistic,
        "observability": step.checks["observability"].corrected.statistic,
    }
    return {"garment": garment, "frame": step.frame, **numbers, **shifts}


def short(x: Any) -> Any:
    """Round a float to four digits; None for what is not a number."""
    if not isinstance(x, float):
        return x
    if not math.isfinite(x):
        return None
    return float(f"{x:.4g}")


def shares(steps: list[StepCheck]) -> list[dict[str, Any]]:
    """Return for every version of every statement in how many steps it applies, its hypotheses hold, and its conclusion does."""
    rows = []
    for statement in steps[0].checks:
        for version in steps[0].checks[statement].versions:
            verdicts = [step.checks[statement].versions[version] for step in steps]
            speaks = [v for v in verdicts if v.loops]
            rows.append(
                {
                    "statement": statement,
                    "version": version,
                    "steps": len(verdicts),
                    "has_a_loop_to_speak_about": len(speaks),
                    "and_its_hypotheses_hold": sum(v.applies for v in speaks),
                    "and_the_conclusion_holds": sum(v.applies and v.holds for v in speaks),
                    "conclusion_holds_whatever_the_hypotheses": sum(v.holds for v in speaks),
                    "violated": sum(v.violated for v in verdicts),
                }
            )
    return rows


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("places", type=Path, nargs="*", default=[Path("data_small")], metavar="FOLDER")
    parser.add_argument("--dataset", type=Path, metavar="DIR", help="episodes of a dataset's test part instead")
    parser.add_argument("--each", type=int, default=1, help="of a dataset: episodes of each garment (default 1)")
    parser.add_argument("--out", type=Path, default=Path("book/results/lemmas_on_cloth.json"))
    parser.add_argument("--stride", type=int, default=1, help="look at every stride-th frame (default 1)")
    parser.add_argument("--observed", type=int, metavar="N", help="observe N vertices instead of what was recorded")
    options = parser.parse_args()
    films = recorded(options.places)
    places = " ".join(place.name for place in options.places)
    if options.dataset:
        films = of_dataset(options.dataset, options.each)
        places = f"--dataset runs/{options.dataset.name} --each {options.each}"
    command = f"python book/experiments/lemmas_on_cloth.py {places} --stride {options.stride}"
    if options.observed:
        command += f" --observed {options.observed}"

    # Check every step of every film.
    everything: list[StepCheck] = []
    rows = []
    listed = []
    for name, episode in films:
        seen, how = observe(episode, options.observed)
        print(f"{name}: {episode.garment}, {len(episode)} frames, {how}", file=sys.stderr)
        steps = verify_episode(episode.points, seen, options.stride)
        everything += steps
        rows += [{key: short(x) for key, x in row(episode.garment, step).items()} for step in steps]
        listed.append({"file": name, "garment": episode.garment, "steps": len(steps), "observed": how})

    answer = {
        "command": command,
        "unit": "m",
        "episodes": listed,
        "statements": shares(everything),
        "steps": {name: [r.get(name) for r in rows] for name in dict.fromkeys(key for r in rows for key in r)},
    }
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(answer) + "\n")
    return int(any(r["violated"] and r["version"] != "paper" for r in answer["statements"]))


if __name__ == "__main__":
    sys.exit(main())
