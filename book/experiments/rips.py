"""Time degree-1 Rips persistence on one core: topokit, its peers in the same run, and the floor; book/results/rips.json.

Peers that are not installed are left out and named: pip install 'topokit[bench]'. Times are of the processor, medians of
`--repeat` runs after one that is not counted; what takes longer than 5 s is run once. Ratios are of times from the same run, and
topokit's include birth edges, killer edges and killer triangles. A peer is left out of a cloud when a quarter of its points say
that it would take longer than `--patience`. The floor computes the lengths of all pairs up to the last death, and nothing else;
what is fixed is a call that stops before the first edge: checks, boxes, Python.

    python book/experiments/rips.py --json book/results/rips.json    # every row; --rows NAME... replaces some
    python book/experiments/rips.py --readme                         # puts that file into README's tables
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np

import topokit as tk

sys.path.append(str(Path(__file__).parent))
import _rips_clouds as clouds
import _rips_peers
import _rips_tables
import realtime

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "book" / "results" / "rips.json"
FASTEST = ("redzed-tda", "tda")  # what batches are run against
Entry = dict[str, Any]
Diagrams = Sequence[tk.rips.Diagram]


def many(batch: Sequence[np.ndarray]) -> Diagrams:
    """Return diagrams of clouds that have nothing to do with each other."""
    return tk.rips_persistence_many(batch, n_jobs=1)


def film(frames: Sequence[np.ndarray]) -> Diagrams:
    """Return diagrams of consecutive frames of the same points."""
    return tk.rips_persistence_many(frames, n_jobs=1)


def longest(points: np.ndarray, k: int) -> object:
    """Return the lifetimes of the `k` longest loops."""
    return tk.rips_persistence(points).lifetime[:k]


class Race:
    """A way to take times, and the peers."""

    def __init__(self, repeat: int, patience: float, wanted: Sequence[str]) -> None:
        self.repeat = repeat
        self.patience = patience
        self.peers = {name: bars for name, bars in _rips_peers.installed().items() if name in wanted}

    def timed(self, function: Callable[[], Any]) -> tuple[float, Any]:
        """Return the median milliseconds of the processor after a run that is not counted, and the answer."""
        times: list[float] = []
        while len(times) < self.repeat + 1 or (sum(times[1:]) < 500 and len(times) < 50):
            start = time.process_time()
            answer = function()
            times.append(1e3 * (time.process_time() - start))
            if times[0] > 5e3:
                return times[0], answer
        return statistics.median(times[1:]), answer

    def ms(self, function: Callable[[], object]) -> float:
        """Return the milliseconds alone."""
        return self.timed(function)[0]

    def against(self, data: np.ndarray, is_matrix: bool = False, only: Sequence[str] = _rips_peers.NAMES) -> Entry:
        """Time one cloud: topokit, the floor and the peers, all of which must find the same last death."""
        _rips_peers.ours(data[:9, :9] if is_matrix else data[:9], is_matrix)  # compiled, before the first run is timed
        ms, diagram = self.timed(lambda: _rips_peers.ours(data, is_matrix))
        end = float(2 * diagram.death.max(initial=0.0))
        floor = _rips_peers.floor(data, is_matrix, end)
        entry: Entry = {
            "points": len(data),
            "loops": len(diagram),
            "ms": ms,
            "fixed_ms": self.ms(lambda: _rips_peers.ours(data, is_matrix, max_radius=1e-9 * end)),
            "pairs": floor(),
            "floor_ms": self.ms(floor),
            "peers": {},
        }
        for name in [name for name in self.peers if name in only]:
            bars = self.peers[name]
            if self._expected(bars, data, is_matrix) < self.patience:
                ms, found = self.timed(lambda bars=bars: bars(data, is_matrix))
                if not np.isclose(found[np.isfinite(found[:, 1]), 1].max(initial=0.0), end, rtol=1e-4):
                    raise AssertionError(f"{name} and topokit differ in the last death")
                entry["peers"][name] = ms
        return entry

    @staticmethod
    def _expected(bars: _rips_peers.Bars, data: np.ndarray, is_matrix: bool) -> float:
        """Return the seconds that a peer would take if time grew with the cube of the points, from a quarter of them."""
        few = len(data) // 4
        start = time.process_time()
        bars(data[:few, :few].copy() if is_matrix else data[:few], is_matrix)
        return (time.process_time() - start) * (len(data) / few) ** 3

    def batch(self, batch: Sequence[np.ndarray], together: Callable[[Sequence[np.ndarray]], Diagrams]) -> Entry:
        """Time clouds together, one by one, and by the fastest peers one by one."""
        alone = [tk.rips_persistence(points) for points in batch]
        for one, other in zip(alone, together(batch), strict=True):
            if not all(
                np.array_equal(getattr(one, k), getattr(other, k)) for k in ("birth", "death", "killer_triangles")
            ):
                raise AssertionError("clouds together have other diagrams than one by one")
        return {
            "clouds": len(batch),
            "points": len(batch[0]),
            "ms": self.ms(lambda: together(batch)),
            "one_by_one_ms": self.ms(lambda: [tk.rips_persistence(points) for points in batch]),
            "peers": {
                name: self.ms(lambda bars=bars: [bars(points, False) for points in batch])
                for name, bars in self.peers.items()
                if name in FASTEST
            },
        }


def single(race: Race) -> Iterator[Entry]:
    """Single clouds of four shapes."""
    for shape in ("apron", "torus", "sphere", "cube"):
        for n in (500, 1000, 2000):
            yield {"what": shape, **race.against(clouds.cloud(shape, n))}


def film_row(race: Race) -> Iterator[Entry]:
    """Consecutive frames."""
    yield {"what": "a film of the apron", **race.batch(realtime.film(1000, 96), film)}


def small(race: Race) -> Iterator[Entry]:
    """Many small clouds."""
    yield {"what": "clouds of all shapes", **race.batch(clouds.small_clouds(1000), many)}


def plans(race: Race) -> Iterator[Entry]:
    """Clouds that differ little."""
    yield {"what": "one scene under as many plans", **race.batch(clouds.plans(1000), many)}


LARGE = (
    ("torus", 10_000),
    ("torus", 20_000),
    ("sheet", 20_000),
    ("sheet", 50_000),
    ("apron", 20_000),
    ("cube", 50_000),
)


def large(race: Race) -> Iterator[Entry]:
    """Large clouds with peak memory, each in a process of its own; the fastest peer when it can within `--patience`."""
    for shape, n in LARGE:
        entry = child(LARGE_CODE, shape, n, "ours")
        entry["peers"] = {}
        if "redzed-tda" in race.peers and n <= 10_000:
            try:
                theirs = child(LARGE_CODE, shape, n, "redzed-tda", patience=race.patience)
                entry["peers"] = {"redzed-tda": theirs["ms"]}
            except subprocess.TimeoutExpired:
                entry["gave_up"] = {"redzed-tda": race.patience}
        yield {"what": shape, **entry}


LARGE_CODE = """
shape, n, engine = sys.argv[2], int(sys.argv[3]), sys.argv[4]
points = _rips_clouds.cloud(shape, n)
bars = _rips_peers.installed()[engine] if engine != "ours" else _rips_peers.ours
bars(points[:300], False)
start = time.process_time()
found = bars(points, False)
entry = {"points": n, "loops": len(found), "ms": 1e3 * (time.process_time() - start)}
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))  # ru_maxrss is the parent's as well
entry["gb"] = int(peak.split()[1]) / 1e6
if engine == "ours":
    floor = _rips_peers.floor(points, False, float(2 * found.death.max()))
    floor()
    start = time.process_time()
    entry |= {"pairs": floor(), "floor_ms": 1e3 * (time.process_time() - start)}
print(json.dumps(entry))
"""
FIRST_CODE = """
tk.farthest_point_sample(np.eye(3), 2)
for axes in map(int, sys.argv[2:]):
    data = _rips_clouds.projective_plane(100) if axes == 0 else _rips_clouds.in_dimension(axes, 200)
    start = time.process_time()
    _rips_peers.ours(data, axes == 0)
    entry = {"ms": 1e3 * (time.process_time() - start)}
print(json.dumps(entry))
"""


def child(code: str, *arguments: object, patience: float | None = None, **environment: str) -> Entry:
    """Return what a fresh process prints as its last line."""
    start = "import json, sys, time; sys.path.insert(0, sys.argv[1])\n"
    start += "import numpy as np, _rips_clouds, _rips_peers, topokit as tk\n"
    command = [sys.executable, "-c", start + code, str(Path(__file__).parent), *map(str, arguments)]
    done = subprocess.run(
        command, check=True, stdout=subprocess.PIPE, text=True, timeout=patience, env=os.environ | environment
    )
    return json.loads(done.stdout.splitlines()[-1])


def ugly(race: Race) -> Iterator[Entry]:
    """Repeated points, far clusters and grids, against clouds of as many points without them."""
    for what, (bad, plain) in clouds.ugly().items():
        entry = race.against(bad, only=FASTEST[:1])
        yield {"what": what, **entry, "plain_ms": race.ms(lambda plain=plain: tk.rips_persistence(plain))}


def dimensions(race: Race) -> Iterator[Entry]:
    """Points in many dimensions, once compiled."""
    for axes in (4, 9, 24):
        yield {"what": f"a torus in {axes} dimensions", **race.against(clouds.in_dimension(axes))}


def first(race: Race) -> Iterator[Entry]:
    """The first call of a fresh process: on a new machine, then from numba's cache; and in a dimension new to the cache."""
    for axes, what in (
        (3, "points in space"),
        (9, "points in 9 dimensions"),
        (24, "points in 24 dimensions"),
        (0, "a matrix"),
    ):
        with tempfile.TemporaryDirectory() as cache:
            empty, cached = (child(FIRST_CODE, axes, NUMBA_CACHE_DIR=cache)["ms"] for _ in range(2))
        yield {"what": f"first call, {what}, nothing compiled", "ms": empty, "cached_ms": cached}
    with tempfile.TemporaryDirectory() as cache:
        child(FIRST_CODE, 3, 5, NUMBA_CACHE_DIR=cache)
        for axes in (9, 24):
            entry = child(FIRST_CODE, axes, NUMBA_CACHE_DIR=cache)
            yield {"what": f"first call in {axes} dimensions after calls in 3 and 5", "ms": entry["ms"]}


def spaces(race: Race) -> Iterator[Entry]:
    """Rotations, and the projective plane as a matrix."""
    yield {"what": "random rotations, in 9 dimensions", **race.against(clouds.rotations())}
    yield {"what": "the projective plane, as a matrix", **race.against(clouds.projective_plane(), is_matrix=True)}


def update(race: Race) -> Iterator[Entry]:
    """A frame of the tracker, end to end, and what of it is persistence."""
    frames = realtime.film(1000, 90)
    realtime.milliseconds(frames, {})
    times = [ms for _ in range(race.repeat) for ms, _ in realtime.milliseconds(frames, {})]
    alone = race.ms(lambda: [tk.rips_persistence(points) for points in frames]) / len(frames)
    yield {
        "what": "SeqPH.update",
        "points": 1000,
        "ms": statistics.median(times),
        "persistence_ms": alone,
    }


def bounded(race: Race) -> Iterator[Entry]:
    """The longest loop alone, and loops of at least half its lifetime, against all loops."""
    for shape in ("apron", "torus", "cube"):
        points = clouds.cloud(shape, 2000)
        bound = float(tk.rips_persistence(points).lifetime[0]) / 2
        everything = race.ms(lambda points=points: tk.rips_persistence(points))
        for what, function in (
            ("the longest loop", lambda points=points: longest(points, 1)),
            (
                "loops half as long as it",
                lambda points=points, bound=bound: tk.rips_persistence(points, min_lifetime=bound),
            ),
        ):
            yield {"what": f"{shape}: {what}", "points": 2000, "ms": race.ms(function), "all_ms": everything}


ROWS: dict[str, Callable[[Race], Iterable[Entry]]] = {
    "single": single,
    "film": film_row,
    "small": small,
    "plans": plans,
    "large": large,
    "ugly": ugly,
    "dimensions": dimensions,
    "first": first,
    "spaces": spaces,
    "update": update,
    "bounded": bounded,
}


def main() -> int:
    """Run the rows and print them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", nargs="+", choices=ROWS, default=list(ROWS))
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--patience", type=float, default=30, help="seconds that a peer may take for a cloud")
    parser.add_argument("--peers", nargs="*", choices=_rips_peers.NAMES, default=list(_rips_peers.NAMES))
    parser.add_argument("--json", type=Path, help="also write the figures there, row by row")
    parser.add_argument(
        "--readme", action="store_true", help="put the recorded run into README's tables, and run nothing"
    )
    options = parser.parse_args()
    if options.readme:
        page = ROOT / "README.md"
        page.write_text(_rips_tables.in_page(page.read_text(), json.loads(RESULTS.read_text())))
        return 0
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    race = Race(options.repeat, options.patience, options.peers)
    if missing := set(options.peers) - set(race.peers):
        print(f"not installed: {', '.join(sorted(missing))}", file=sys.stderr)
    command = " ".join(["python", "book/experiments/rips.py", *sys.argv[1:]])
    for name in options.rows:
        print(f"{name}: {ROWS[name].__doc__}")
        entries = []
        for entry in ROWS[name](race):
            entries.append(_rips_tables.rounded(entry))
            print(_rips_tables.line(entries[-1]), flush=True)
        if name == "single":
            print(
                *(f"  {shape}, {library}: n^{power:.2f}" for shape, library, power in _rips_tables.growth(entries)),
                sep="\n",
            )
        if options.json:
            _rips_tables.store(options.json, name, entries, command)
    return 0


if __name__ == "__main__":
    sys.exit(main())
