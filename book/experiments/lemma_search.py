"""Search for violations of the statements in topokit.lemmas: random instances, and instances driven towards a violation.

    python book/experiments/lemma_search.py --random 10000 --optimised 500 --seed 0 > book/results/lemma_search.json

Every random instance is a state, a motion and two observations, and goes through all statements. Every optimised one is a small
cloud for one version of one statement; it is changed for as long as that brings statistic / bound up. A tenth more does the same
for statements of the paper that are false, as a control. Where a factor stands before beta in the bound, instances with a beta of
at least a tenth of the killer's length are counted once more, with the largest factor that was needed. The script prints the
counts as JSON, and exits with 1 when a version that should be true is violated.
"""

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from topokit import farthest_point_sample, lemmas, rips_persistence

sys.path.append(str(Path(__file__).parents[2] / "tests"))
from clouds import random_cloud

Array = np.ndarray


# What stands before beta in the bounds that have it: beta, beta + epsilon, and so many beta + epsilon.
FACTORS = {("recovering killers", version): 1 for version in ("paper", "corrected")}
FACTORS |= {("regularity of killers", version): 1 for version in ("paper", "corrected", "intrinsic")}
FACTORS |= {("corollary", version): 2 for version in ("corrected", "intrinsic", "2 beta + epsilon, all edges")}
FACTORS |= {("corollary", "3 beta + epsilon, all edges"): 3}
LARGE_BETA = 0.1  # of the killer's length


@dataclass(frozen=True)
class Instance:
    """A state, the same points a moment later, and which vertices are observed."""

    before: Array  # (n, d)
    after: Array
    seen: Array  # (m,) vertex ids
    seen_after: Array


CHECKS: dict[str, Callable[[Instance], Any]] = {
    "feature approximation": lambda i: lemmas.feature_approximation(i.before, i.seen),
    "observability": lambda i: lemmas.observability(i.before, i.seen),
    "temporal persistence": lambda i: lemmas.temporal_persistence(i.before, i.after),
    "gates": lambda i: lemmas.gates(i.before, i.seen, i.after, i.seen_after),
    "recovering killers": lambda i: lemmas.recovering_killers(i.before, i.seen),
    "regularity of killers": lambda i: lemmas.regularity_of_killers(i.before, i.after),
    "corollary": lambda i: lemmas.corollary(i.before, i.seen, i.after, i.seen_after),
    "converse": lambda i: lemmas.converse(i.before, i.seen, i.after, i.seen_after),
}
# Statements about one cloud have no intrinsic version.
OF_ONE_CLOUD = ("feature approximation", "observability", "recovering killers")
TRUE_VERSIONS = [
    (name, version)
    for name in CHECKS
    for version in ("corrected", "intrinsic")
    if version == "corrected" or name not in OF_ONE_CLOUD
]
# The paper's lemmas that are true as they stand, and what follows from them: a violation would be news as well.
CONTROLS = [("temporal persistence", "paper"), ("corollary", "paper")]  # false: a search worth its name refutes them
PAPER_IS_TRUE = [
    ("observability", "paper"),
    ("gates", "paper"),
    ("recovering killers", "paper"),
    ("regularity of killers", "paper"),
    ("corollary", "3 beta + epsilon, all edges"),
    ("corollary", "2 beta + epsilon, all edges"),
]


def curve(rng: np.random.Generator, n: int, d: int) -> Array:
    """Return n points, evenly or at random, on a closed curve with a few bumps."""
    angle = 2 * np.pi * (np.arange(n) / n if rng.random() < 0.5 else rng.random(n))
    radius = 1 + rng.uniform(0, 0.4) * np.cos(rng.integers(2, 5) * angle + rng.uniform(0, 6))
    points = np.column_stack([radius * np.cos(angle), rng.uniform(0.4, 1) * radius * np.sin(angle)])
    return points if d == 2 else np.column_stack([points, rng.uniform(0, 0.5) * np.sin(2 * angle)])


def wedge(rng: np.random.Generator, n: int, d: int) -> Array:
    """Return two or three loops that touch, or lie apart."""
    k = int(rng.integers(2, 4))
    gap = rng.choice([1.8, 2.0, 3.0, 8.0, 15.0, 30.0])
    size = rng.uniform(0.5, 1.5, k) if rng.random() < 0.5 else np.ones(k)
    return np.vstack([size[i] * curve(rng, max(n // k, 4), d) + gap * i * np.eye(d)[0] for i in range(k)])


def theta(rng: np.random.Generator, n: int, d: int) -> Array:
    """Return a circle with a chord."""
    chord = np.zeros((max(n // 4, 2), d))
    chord[:, 0] = np.linspace(-0.9, 0.9, len(chord))
    chord[:, 1] = rng.uniform(-0.3, 0.3)
    return np.vstack([curve(rng, n - len(chord), d), chord])


def sheet(rng: np.random.Generator, n: int, d: int) -> Array:
    """Return a grid with one or two holes, sometimes exact (many ties), sometimes shaken, sometimes bent in space."""
    side = int(np.ceil(np.sqrt(1.4 * n)))
    grid = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2) / (side - 1)
    for _ in range(int(rng.integers(1, 3))):
        hole = rng.uniform(0.25, 0.75, 2)
        grid = grid[np.abs(grid - hole).max(axis=1) > rng.uniform(0.1, 0.3)]
    grid = grid + rng.choice([0.0, 0.2]) / side * rng.normal(size=grid.shape)
    return grid if d == 2 else np.column_stack([grid, rng.uniform(0, 0.5) * np.sin(3 * grid[:, 0])])


def noise(rng: np.random.Generator, n: int, d: int) -> Array:
    """Return points without a shape: many short loops."""
    return rng.normal(size=(n, d))


def ring(rng: np.random.Generator, n: int, d: int) -> Array:
    """Return points almost evenly on a circle, some with a double nearby: many edges are almost the killer."""
    angle = 2 * np.pi * np.arange(max(n // 2, 5)) / max(n // 2, 5)
    circle = np.pad(np.column_stack([np.cos(angle), np.sin(angle)]), ((0, 0), (0, d - 2)))
    circle = circle + rng.choice([0.003, 0.02]) * rng.normal(size=circle.shape)
    doubled = circle[rng.random(len(circle)) < 0.7]
    return np.vstack([circle, doubled + rng.choice([0.01, 0.04]) * rng.normal(size=doubled.shape)])


def tied(rng: np.random.Generator, n: int, d: int) -> Array:
    """Return lattice points and points on circles, where distances tie."""
    while True:
        cloud = random_cloud(rng, str(rng.choice(["grid", "polygon", "cocircular", "coplanar"])), max(n, 6))
        if len(cloud) >= 4 and cloud.shape[1] in (2, 3):
            return cloud


FAMILIES = (curve, wedge, theta, sheet, noise, ring, tied)


def state(rng: np.random.Generator, n: int) -> Array:
    """Return a cloud of about n points in the plane or in space, about one unit large."""
    cloud = FAMILIES[int(rng.integers(len(FAMILIES)))](rng, n, int(rng.integers(2, 4)))
    cloud = cloud + rng.choice([0.0, 0.0, 0.01, 0.05]) * rng.normal(size=cloud.shape)
    return cloud / max(float(np.ptp(cloud, axis=0).max()), 1e-6)


def motion(rng: np.random.Generator, points: Array) -> Array:
    """Return where the points go: nowhere, together, apart, or towards a violation; about as far as some loop lives."""
    diagram = rips_persistence(points)
    scale = float(rng.choice(diagram.lifetime[:5])) if len(diagram) else 0.05
    size = scale * rng.choice([0.0, 0.05, 0.2, 0.45, 0.5, 0.7, 1.0])
    kind = rng.choice(["shake", "rigid", "stretch", "undo"])
    if kind == "rigid":
        step = 10 * size * rng.normal(size=points.shape[1]) + 0.1 * size * rng.normal(size=points.shape)
    elif kind == "stretch":
        step = size * points @ rng.normal(size=(points.shape[1],) * 2)
    elif kind == "undo" and len(diagram):
        step = np.zeros_like(points)
        for loop in range(min(len(diagram), int(rng.integers(1, 4)))):
            for (a, b), sign in ((diagram.birth_edge[loop], 1), (diagram.killer_edge[loop], -1)):
                along = (points[b] - points[a]) / max(np.linalg.norm(points[b] - points[a]), 1e-12)
                step[b] += sign * size * along
                step[a] -= sign * size * along
        step = step * size / max(np.linalg.norm(step, axis=1).max(), 1e-12)
    else:
        step = rng.normal(size=points.shape)
        step *= size / max(np.linalg.norm(step, axis=1).max(), 1e-12)
    return points + step


def observation(rng: np.random.Generator, points: Array) -> Array:
    """Return which vertices are seen: all, a farthest-point or a random sample, or all but those of a loop."""
    n = len(points)
    kind = rng.choice(["all", "farthest", "random", "blind"])
    if kind == "all":
        return np.arange(n)
    if kind == "blind" and len(diagram := rips_persistence(points)):
        loop = int(rng.integers(min(len(diagram), 3)))
        edges = np.concatenate([diagram.birth_edge[loop], diagram.killer_edge[loop]])
        gone = rng.choice(edges, size=int(rng.integers(1, 4)), replace=False)
        return np.setdiff1d(np.arange(n), gone)
    m = max(1, int(n * rng.uniform(0.4, 1)))
    if kind == "random":
        return np.sort(rng.choice(n, m, replace=False))
    return np.sort(farthest_point_sample(points, m, start=int(rng.integers(n)))[0])


def random_instance(rng: np.random.Generator, n: int) -> Instance:
    """Return any of the above, or one of those below."""
    if rng.random() < 0.1:
        return (rivals, two_rivals)[int(rng.integers(2))](rng, max(5, n // 3))
    before = state(rng, n)
    after = motion(rng, before)
    seen = observation(rng, before)
    return Instance(before, after, seen, seen if rng.random() < 0.3 else observation(rng, after))


def rivals(rng: np.random.Generator, n: int) -> Instance:
    """Return an uneven ring with one vertex doubled, of which now the one and then the other is seen: near ties."""
    angle = 2 * np.pi * np.arange(n) / n
    circle = np.column_stack([np.cos(angle), np.sin(angle)]) * (1 + 0.15 * rng.normal(size=(n, 1)))
    before = np.vstack([circle, circle[0] + rng.choice([0.01, 0.03, 0.06]) * rng.normal(size=2)])
    after = before + rng.choice([0.0, 1e-4, 1e-2]) * rng.normal(size=before.shape)
    return Instance(before, after, np.arange(n), np.arange(1, n + 1))


def two_rivals(rng: np.random.Generator, n: int) -> Instance:
    """Return two of these rings, far apart for their size."""
    a = rivals(rng, n)
    b = rivals(rng, n)
    apart = rng.uniform(8, 30) * np.eye(2)[0]
    moved = (np.vstack([getattr(a, x), getattr(b, x) + apart]) for x in ("before", "after"))
    ids = (np.concatenate([getattr(a, x), getattr(b, x) + n + 1]) for x in ("seen", "seen_after"))
    return Instance(*moved, *ids)


def seven_points() -> Instance:
    """Return the library's counterexample to the paper's corollary."""
    case = lemmas.COUNTEREXAMPLES["killers two beta apart"]
    return Instance(case.before, case.after, case.observed_before, case.observed_after)


def ratio(verdict: Any) -> float:
    """Return statistic / bound: above 1 is a violation."""
    if verdict.statistic <= 0:
        return 0.0
    if verdict.bound <= 0:
        return float("inf")
    return verdict.statistic / verdict.bound


def needed_factor(check: Any, version: str) -> tuple[float, float] | None:
    """Return the factor before beta that is needed, and beta in killer lengths; None where beta is small or not in the bound."""
    verdict = check.versions[version]
    times = FACTORS.get((check.statement, version))
    if times is None or not verdict.loops:
        return None
    rows = [row for row in check.loops if version in row.bounds]
    tightest = max(rows, key=lambda row: row.statistic - row.bounds[version])
    beta = (verdict.bound - check.epsilon) / times
    share = beta / (2 * tightest.death)
    if share < LARGE_BETA:
        return None
    return (verdict.statistic - check.epsilon) / beta, share


def tightness(check: Any, version: str) -> float:
    """Return how near to a violation, 1 being on the bound: by the factor before beta where beta is large."""
    verdict = check.versions[version]
    if verdict.violated or (check.statement, version) not in FACTORS:
        return ratio(verdict)
    needed = needed_factor(check, version)
    if needed is None:
        return 0.1 * ratio(verdict)
    return needed[0] / FACTORS[check.statement, version]


def mutate(rng: np.random.Generator, instance: Instance, size: float) -> Instance:
    """Return another instance nearby."""
    before = instance.before.copy()
    step = instance.after - instance.before
    which = rng.random(len(before)) < rng.choice([0.15, 0.5])
    size *= 10 ** rng.uniform(-2, 0)
    if rng.random() < 0.6:
        before[which] += size * rng.normal(size=before[which].shape)
    if rng.random() < 0.6:
        step = step + which[:, None] * size * rng.normal(size=step.shape)
    if rng.random() < 0.2:
        step = step * rng.uniform(0.5, 1.5)
    seen, seen_after = (flip(rng, ids, len(before)) for ids in (instance.seen, instance.seen_after))
    return Instance(before, before + step, seen, seen_after)


def flip(rng: np.random.Generator, ids: Array, n: int) -> Array:
    """Return the seen vertices, now and then with one more or one fewer."""
    if rng.random() > 0.1:
        return ids
    changed = np.setxor1d(ids, [rng.integers(n)])
    return changed if len(changed) else ids


def score(check: Any, version: str) -> float:
    """Return what to climb: the ratio, and for a chain of killers also the length of its legs."""
    verdict = check.versions[version]
    if not (verdict.applies or verdict.violated):
        return -0.5
    reached = tightness(check, version)
    if check.statement == "corollary":
        legs = [sum(row.legs) / max(row.bounds[version], 1e-12) for row in check.loops if version in row.bounds]
        reached += 0.5 * min(max(legs, default=0.0), 3.0)
    return reached


def optimised_instance(rng: np.random.Generator, statement: str, version: str, steps: int) -> tuple[Instance, Any]:
    """Keep mutations that bring the score up, with a step size that adapts (1 + 1 evolution strategy)."""
    kinds = {"recovering killers": rivals, "regularity of killers": rivals, "corollary": rivals, "converse": two_rivals}
    make = kinds.get(statement, random_instance)
    starts = [make(rng, int(rng.integers(5, 9))) for _ in range(30)]
    if statement == "corollary" and (statement, version) in FACTORS and rng.random() < 0.5:
        starts = [mutate(rng, seven_points(), 0.01) for _ in range(30)]
    instance, check = max(((i, CHECKS[statement](i)) for i in starts), key=lambda pair: score(pair[1], version))
    worst = instance, check  # the tightest
    best = score(check, version)
    size = 0.1
    for _ in range(steps):
        other = mutate(rng, instance, size)
        found = CHECKS[statement](other)
        reached = score(found, version)
        if reached >= best:
            if reached > best:
                size = min(1.5 * size, 0.3)
            instance = other
            check = found
            best = reached
            if tightness(check, version) > tightness(worst[1], version):
                worst = instance, check
        else:
            size = max(0.95 * size, 1e-4)
    return worst


@dataclass
class Count:
    """Counts of one version of one statement."""

    tried: int = 0
    applies: int = 0
    violated: int = 0
    largest_ratio: float = 0.0
    large_beta: int = 0  #: instances whose beta is large for their scale
    largest_factor: float | None = None  #: before beta, needed by one of these
    beta_there: float | None = None  #: in killer lengths

    def add(self, check: Any, version: str) -> None:
        """Count a check."""
        verdict = check.versions[version]
        self.tried += 1
        self.applies += verdict.applies
        self.violated += verdict.violated
        if not verdict.applies:
            return
        self.largest_ratio = max(self.largest_ratio, ratio(verdict))
        if needed := needed_factor(check, version):
            self.large_beta += 1
            if self.largest_factor is None or needed[0] > self.largest_factor:
                self.largest_factor, self.beta_there = needed


class Search:
    """Counts, and the first instance that violates what should be true."""

    def __init__(self, seed: int, steps: int) -> None:
        self.seed = seed
        self.steps = steps
        self.random: dict[tuple[str, str], Count] = {}
        self.optimised: dict[tuple[str, str], Count] = {}
        self.news: list[dict[str, Any]] = []

    def run(self, n_random: int, n_optimised: int, progress: bool) -> None:
        """Check random instances, optimised ones, and a tenth as many controls."""
        for index in tqdm(range(n_random), "random", disable=not progress):
            self._random(index)
        for index in tqdm(range(n_optimised), "optimised", disable=not progress):
            self._optimised(index, TRUE_VERSIONS)
        for index in tqdm(range(n_optimised, n_optimised + n_optimised // 10), "controls", disable=not progress):
            self._optimised(index, CONTROLS)

    def _random(self, index: int) -> None:
        """Check all statements on a random instance, small or large."""
        rng = np.random.default_rng([self.seed, 0, index])
        low, high = (4, 13) if rng.random() < 0.5 else (13, 61)
        instance = random_instance(rng, int(rng.integers(low, high)))
        points = instance.before, instance.seen, instance.after, instance.seen_after
        for check in lemmas.verify_step(*points).values():
            self._add(self.random, check, list(check.versions), instance, f"random {index}")

    def _optimised(self, index: int, targets: list[tuple[str, str]]) -> None:
        """Check one version of one statement on an instance that is driven towards a violation."""
        rng = np.random.default_rng([self.seed, 1, index])
        name, version = targets[index % len(targets)]
        instance, check = optimised_instance(rng, name, version, self.steps)
        self._add(self.optimised, check, [version], instance, f"optimised {index}")

    def _add(
        self, counts: dict[tuple[str, str], Count], check: Any, versions: list[str], instance: Instance, label: str
    ) -> None:
        """Count a check, and keep the instance where it violates what should be true."""
        for version in versions:
            pair = (check.statement, version)
            counts.setdefault(pair, Count()).add(check, version)
            if check.versions[version].violated and pair in TRUE_VERSIONS + PAPER_IS_TRUE:
                where = {key: getattr(instance, key).tolist() for key in ("before", "after", "seen", "seen_after")}
                entry = {"instance": label, "statement": check.statement, "version": version, "says": str(check)}
                self.news.append(entry | where)

    def table(self) -> list[dict[str, Any]]:
        """Return a row for every version of every statement, random and optimised apart."""
        rows = []
        for kind, counts in (("random", self.random), ("optimised", self.optimised)):
            # In the order of the statements.
            for pair, count in sorted(counts.items(), key=lambda item: list(CHECKS).index(item[0][0])):
                row = {"instances": kind, "statement": pair[0], "version": pair[1]}
                row |= {"should_be_true": pair in TRUE_VERSIONS + PAPER_IS_TRUE, "factor": FACTORS.get(pair)}
                row |= vars(count)
                if np.isinf(count.largest_ratio):
                    row["largest_ratio"] = None  # JSON has no infinity
                rows.append(row)
        return rows


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--random", type=int, default=1000, metavar="N")
    parser.add_argument("--optimised", type=int, default=50, metavar="N")
    parser.add_argument("--steps", type=int, default=300, help="mutations of an optimised instance (default 300)")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    search = Search(options.seed, options.steps)
    search.run(options.random, options.optimised, progress=True)
    command = f"python book/experiments/lemma_search.py --random {options.random} --optimised {options.optimised}"
    found = {
        "command": f"{command} --steps {options.steps} --seed {options.seed}",
        "random": options.random,
        "optimised": options.optimised,
        "controls": options.optimised // 10,
        "complete": True,
        "table": search.table(),
        "violations": search.news,
    }
    print(json.dumps(found, indent=1))
    return bool(search.news)


if __name__ == "__main__":
    sys.exit(main())
