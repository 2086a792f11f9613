"""Check the statements of topokit.lemmas on recorded episodes: book/results/lemmas_on_cloth.json and lemmas_on_test.json.

    python book/experiments/lemmas_on_cloth.py data_small [more folders or episodes] --out book/results/lemmas_on_cloth.json
    python book/experiments/lemmas_on_cloth.py --dataset runs/dataset --each 1 --out book/results/lemmas_on_test.json

With --dataset: the first episodes of each garment in the test part of the split by episode, those of chapter 6.

The state is all vertices of the garment, the observation what the episode recorded of them; with --observed it is a
farthest-point sample of the first frame's vertices, the same in all frames.
Lengths are metres. A minute or two an episode of 96 frames and 550 vertices.
"""

import argparse
import json
import math
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from topokit import farthest_point_sample, lemmas, rips_persistence
from topokit.data import Dataset
from topokit.io import Episode, load_episode

Checks = dict[str, Any]  # of a step, by statement, in the paper's order


def verify_episode(points: np.ndarray, observed: np.ndarray, stride: int = 1) -> list[Checks]:
    """Check all statements on every step of a sequence, one fewer than the frames looked at: every stride-th.

    `points` (T, n, d) are the states; `observed` the ids (m,) of the vertices that are observed, or coordinates (T, m, d) of
    vertices.
    """
    steps = []
    for frame, later in pairwise(range(0, len(points), stride)):
        ids, ids_later = (observed_ids(points[t], observed, t) for t in (frame, later))
        steps.append(lemmas.verify_step(points[frame], ids, points[later], ids_later))
    return steps


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
    if n_observed is None:
        return episode.observed, "as recorded"
    n = min(n_observed, episode.points.shape[1])
    return np.sort(farthest_point_sample(episode.points[0], n)[0]), f"farthest-point sample of {n} vertices"


def observed_ids(points: np.ndarray, seen: np.ndarray, t: int) -> np.ndarray:
    """Return the ids of the vertices that are observed at frame t: where coordinates are, the nearest ones."""
    if seen.ndim == 1:
        return seen
    return np.unique(cKDTree(points).query(seen[t])[1])


def row(garment: str, points: np.ndarray, checks: Checks) -> dict[str, Any]:
    """Return the row of a step: the constants, the longest-lived loop, and how far its killers are apart, with the bound.

    A beta is nan where no loop lives so long.
    """
    check = checks["corollary"]
    diagram = rips_persistence(points)
    numbers = {"garment": garment, "alpha": check.alpha, "epsilon": check.epsilon, "distortion": check.distortion}
    numbers["lifetime"] = float(diagram.lifetime.max(initial=0.0))
    numbers["death"] = float(diagram.death[:1].max(initial=0.0))
    # The corollary's bound is 2 beta + epsilon.
    numbers["beta_intrinsic"] = (largest_bound(check, "intrinsic") - check.epsilon) / 2
    for loop in check.loops[:1]:
        numbers |= {"killer_distance": loop.statistic, "intrinsic_bound": loop.bounds.get("intrinsic")}
    return numbers


def short(x: Any) -> Any:
    """Round a float to four digits; None for what is not a number."""
    if not isinstance(x, float):
        return x
    if not math.isfinite(x):
        return None
    return float(f"{x:.4g}")


def shares(steps: list[Checks]) -> list[dict[str, Any]]:
    """Return for every version of every statement in how many steps it applies, its hypotheses hold, and its conclusion does."""
    rows = []
    for statement in steps[0]:
        for version in steps[0][statement].versions:
            verdicts = [step[statement].versions[version] for step in steps]
            speaks = [v for v in verdicts if v.loops]
            rows.append(
                {
                    "statement": statement,
                    "version": version,
                    "steps": len(verdicts),
                    "has_a_loop_to_speak_about": len(speaks),
                    "and_its_hypotheses_hold": sum(v.applies for v in speaks),
                    "and_the_conclusion_holds": sum(v.applies and v.holds for v in speaks),
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
    everything: list[Checks] = []
    rows = []
    listed = []
    for name, episode in films:
        seen, how = observe(episode, options.observed)
        print(f"{name}: {episode.garment}, {len(episode)} frames, {how}", file=sys.stderr)
        steps = verify_episode(episode.points, seen, options.stride)
        everything += steps
        for points, checks in zip(episode.points[:: options.stride], steps, strict=False):
            rows.append({key: short(x) for key, x in row(episode.garment, points, checks).items()})
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
