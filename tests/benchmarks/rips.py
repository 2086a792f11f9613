"""Degree-1 Rips persistence: topokit against its peers, one core, one run. python tests/benchmarks/rips.py --help

Peers that are not installed are left out and named: pip install 'topokit[bench]'. Every cloud is timed `--repeat` times after a
run that is not counted; the table gives the median, and ratios of medians from the same run. For topokit the time includes birth
edges, killer edges and killer triangles.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from scipy.spatial.distance import pdist, squareform

import topokit as tk

SHAPES = ("apron", "torus", "sphere", "cube")


PEERS = ("redzed-tda", "giotto-ph", "GUDHI", "ripser.py")


def apron(n: int, rng: np.random.Generator) -> np.ndarray:
    """Farthest-point samples of a waving sheet with the outline of the recorded apron (above 4,096: random points of it)."""
    from topokit.io import load_episode

    episode = load_episode(Path(__file__).parents[2] / "data_small" / "apron_hook_0.npz")
    corners = episode.points[60][episode.faces].astype(float)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    many = 6 * n if n <= 4096 else n
    u, v = np.sort(rng.random((2, many)), axis=0)
    weights = np.column_stack([u, v - u, 1 - v])
    points = np.einsum("ik,ikd->id", weights, corners[rng.choice(len(area), many, p=area / area.sum())])
    return points[tk.farthest_point_sample(points, n)[0]] if many > n else points


def cloud(shape: str, n: int) -> np.ndarray:
    """A benchmark cloud; the same for every run."""
    rng = np.random.default_rng(0)
    if shape == "apron":
        return apron(n, rng)
    if shape == "torus":
        a, b = 2 * np.pi * rng.random((2, n))
        return np.column_stack(
            [(1 + 0.35 * np.cos(b)) * np.cos(a), (1 + 0.35 * np.cos(b)) * np.sin(a), 0.35 * np.sin(b)]
        )
    if shape == "sphere":
        points = rng.normal(size=(n, 3))
        return points / np.linalg.norm(points, axis=1, keepdims=True)
    return rng.random((n, 3))


def peers() -> dict[str, Callable[[np.ndarray], object]]:
    """What is installed of the libraries to compare with, each as a function of the points."""
    found: dict[str, Callable[[np.ndarray], object]] = {}
    if find_spec("redzed_tda"):
        import redzed_tda

        found["redzed-tda"] = lambda points: redzed_tda.rips(squareform(pdist(points)), 1)
    if find_spec("gph"):
        from gph import ripser_parallel

        found["giotto-ph"] = lambda points: ripser_parallel(points, maxdim=1, n_threads=1)
    if find_spec("gudhi"):
        import gudhi

        def edge_collapse(points: np.ndarray) -> object:
            tree = gudhi.RipsComplex(points=points).create_simplex_tree(max_dimension=1)
            tree.collapse_edges()
            tree.expansion(2)
            return tree.persistence(homology_coeff_field=2)

        found["GUDHI"] = edge_collapse
    if find_spec("ripser"):
        import ripser

        found["ripser.py"] = lambda points: ripser.ripser(points, maxdim=1)
    return found


def median_ms(function: Callable[[np.ndarray], object], points: np.ndarray, repeat: int) -> float:
    """Median of timed runs after one that is not counted, `repeat` of them at least and half a second of them; milliseconds."""
    times = []
    while len(times) < repeat + 1 or (sum(times[1:]) < 500 and len(times) < 200):
        start = time.perf_counter()
        function(points)
        times.append(1e3 * (time.perf_counter() - start))
        if times[0] > 5e3:
            return times[0]  # once is enough for what takes seconds
    return statistics.median(times[1:])


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[500, 1000, 2000])
    parser.add_argument("--shapes", nargs="+", choices=SHAPES, default=list(SHAPES))
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--peers", nargs="*", metavar="NAME", help=f"against these only, of {', '.join(PEERS)}")
    parser.add_argument(
        "--large", type=int, nargs="*", metavar="N", help="large clouds, topokit alone, with peak memory"
    )
    parser.add_argument("--json", type=Path, help="also write the numbers there")
    options = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    if options.large is not None:
        return large(options.shapes, options.large or [10_000])
    wanted = PEERS if options.peers is None else options.peers
    others = {name: function for name, function in peers().items() if name in wanted}
    missing = set(wanted) - set(others)
    if missing:
        print(f"not installed: {', '.join(sorted(missing))}", file=sys.stderr)
    rows = []
    print(f"{'cloud':>8} {'points':>6} {'topokit':>9}" + "".join(f"{name:>20}" for name in others))
    for shape in options.shapes:
        for n in options.sizes:
            points = cloud(shape, n)
            ours = median_ms(tk.rips_persistence, points, options.repeat)
            theirs = {name: median_ms(function, points, options.repeat) for name, function in others.items()}
            rows.append({"cloud": shape, "points": n, "topokit_ms": ours, **{f"{k}_ms": v for k, v in theirs.items()}})
            cells = "".join(f"{f'{ms:.1f} ms ({ms / ours:.1f}x)':>20}" for ms in theirs.values())
            print(f"{shape:>8} {n:>6} {ours:>6.1f} ms{cells}", flush=True)
    for shape in options.shapes if len(options.sizes) > 1 else ():
        ms = [row["topokit_ms"] for row in rows if row["cloud"] == shape]
        print(f"{shape}: time grows as n^{np.polyfit(np.log(options.sizes), np.log(ms), 1)[0]:.2f}")
    if options.json:
        options.json.write_text(
            json.dumps({"machine": platform.processor() or platform.machine(), "rows": rows}, indent=2) + "\n"
        )
    return 0


def large(shapes: list[str], sizes: list[int]) -> int:
    """Time and peak memory of single large clouds, each in a process of its own."""
    code = (
        "import sys, time; sys.path.insert(0, sys.argv[3]); import numpy as np, rips, resource, topokit as tk\n"
        "points = rips.cloud(sys.argv[1], int(sys.argv[2])); tk.rips_persistence(points[:300])\n"
        "start = time.perf_counter(); diagram = tk.rips_persistence(points); seconds = time.perf_counter() - start\n"
        "print(f'{sys.argv[1]}, {len(points)} points: {seconds:.2f} s, {len(diagram)} loops, peak memory',"
        " f'{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB', diagram.lifetime[:3].round(4))"
    )
    for shape in shapes:
        for n in sizes:
            subprocess.run([sys.executable, "-c", code, shape, str(n), str(Path(__file__).parent)], check=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
