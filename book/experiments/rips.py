"""Time degree-1 Rips persistence on one core: topokit, and its peers in the same run; book/results/rips.json.

Peers that are not installed are left out: `pip install --group bench` gets them. Times are of the processor, medians of
`--repeat` runs; what takes longer than 2 s is run once. A peer is left out of a cloud when a quarter of its points predict
more than `--patience`. The floor computes the lengths of all pairs up to the last death.

    python book/experiments/rips.py --json book/results/rips.json    # every row; --rows NAME... replaces some
    python book/experiments/rips.py --page                           # puts that file into book/speed.md
"""

import argparse
import json
import os
import resource
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
from tables import in_page

import _rips_clouds as clouds
import _rips_peers
import _rips_tables

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "book" / "results" / "rips.json"
FASTEST = ("redzed-tda",)  # the peer that every row but the first is run against
LONG = 2000  # milliseconds; what takes longer is run once
Entry = dict[str, Any]


class Race:
    """A way to take times, and the peers."""

    def __init__(self, repeat: int, patience: float) -> None:
        self.repeat = repeat
        self.patience = patience  # seconds that a peer may take for a cloud
        self.peers = _rips_peers.installed()

    def ms(self, function: Callable[[], object]) -> float:
        """Return the median milliseconds of the processor after a run that is not counted."""
        times: list[float] = []
        while len(times) < self.repeat + 1 or (sum(times[1:]) < 500 and len(times) < 50):
            start = time.process_time()
            function()
            times.append(1e3 * (time.process_time() - start))
            if times[0] > LONG:
                return times[0]
        return statistics.median(times[1:])

    def against(self, data: np.ndarray, is_matrix: bool = False, only: Sequence[str] = FASTEST) -> Entry:
        """Time one cloud: topokit and the peers, all of which must find the same last death, and the floor."""
        end = _rips_peers.last_death(data, is_matrix)
        entry: Entry = {
            "points": len(data),
            "ms": self.ms(lambda: _rips_peers.ours(data, is_matrix)),
            "floor_ms": self.ms(_rips_peers.floor(data, is_matrix, end)),
            "peers": {},
        }
        for name in [name for name in self.peers if name in only]:
            bars = self.peers[name]
            if self._expected(bars, data, is_matrix) < self.patience:
                found = bars(data, is_matrix)
                if not np.isclose(found[np.isfinite(found[:, 1]), 1].max(initial=0.0), end, rtol=1e-4):
                    raise AssertionError(f"{name} and topokit differ in the last death")
                entry["peers"][name] = self.ms(lambda bars=bars: bars(data, is_matrix))
        return entry

    @staticmethod
    def _expected(bars: _rips_peers.Bars, data: np.ndarray, is_matrix: bool) -> float:
        """Return the seconds that a peer would take if time grew with the cube of the points, from a quarter of them."""
        few = len(data) // 4
        start = time.process_time()
        bars(data[:few, :few].copy() if is_matrix else data[:few], is_matrix)
        return (time.process_time() - start) * (len(data) / few) ** 3


def single(race: Race) -> Iterator[Entry]:
    """Time single clouds of four shapes against all peers."""
    for shape in ("apron", "torus", "sphere", "cube"):
        for n in (500, 1000, 2000):
            yield {"what": shape, **race.against(clouds.cloud(shape, n), only=_rips_peers.NAMES)}


def first(race: Race) -> Iterator[Entry]:
    """Time first answers by the clock, import included: in a fresh process with nothing compiled, then once more."""
    snippet = (ROOT / "README.md").read_text().split("```python\n")[1].split("```")[0]
    cloud = "import sys, numpy as np, topokit as tk\ntk.rips_persistence(np.load(sys.argv[1]))"
    works = [
        ("README's snippet, empty cache", snippet, "cube", 60),
        ("first cloud, a cube, empty cache", cloud, "cube", 1000),
        ("first cloud, a torus, empty cache", cloud, "torus", 1000),
        ("first cloud, a cube, without numba", "import sys\nsys.modules['numba'] = None\n" + cloud, "cube", 100),
    ]
    for what, code, shape, n in works:
        with tempfile.TemporaryDirectory() as folder:
            np.save(f"{folder}/cloud.npy", clouds.cloud(shape, n))
            empty, cached = (child(code, f"{folder}/cloud.npy", NUMBA_CACHE_DIR=folder) for _ in range(2))
        yield {"what": what, "points": n, **empty, "cached_ms": cached["ms"]}


def child(code: str, *arguments: str, **environment: str) -> Entry:
    """Run code in a fresh process; return the time that it took."""
    command = [sys.executable, "-c", code, *arguments]
    start = time.perf_counter()
    start_of_processor = processor_time()
    subprocess.run(command, capture_output=True, check=True, env=os.environ | environment)
    return {
        "ms": 1e3 * (time.perf_counter() - start),
        "processor_ms": 1e3 * (processor_time() - start_of_processor),
    }


def processor_time() -> float:
    """Return the seconds of the processor that child processes have taken so far."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def batches(race: Race) -> Iterator[Entry]:
    """Time many clouds in one call, and one by one."""
    for what, batch in (
        ("clouds of all shapes", clouds.small_clouds(1000)),
        ("one scene under as many plans", clouds.plans(1000)),
        ("a film of the apron", clouds.film(1000, 96)),
    ):
        yield {"what": what, **together(race, batch)}


def together(race: Race, batch: Sequence[np.ndarray]) -> Entry:
    """Time clouds in one call, one by one, and by the fastest peer one by one."""
    alone = [tk.rips_persistence(points) for points in batch]
    for one, other in zip(alone, tk.rips_persistence_many(batch, n_jobs=1), strict=True):
        if not all(np.array_equal(getattr(one, k), getattr(other, k)) for k in ("birth", "death", "killer_triangles")):
            raise AssertionError("clouds together have other diagrams than one by one")
    return {
        "clouds": len(batch),
        "points": len(batch[0]),
        "ms": race.ms(lambda: tk.rips_persistence_many(batch, n_jobs=1)),
        "one_by_one_ms": race.ms(lambda: [tk.rips_persistence(points) for points in batch]),
        "peers": {
            name: race.ms(lambda name=name: [race.peers[name](points, False) for points in batch])
            for name in FASTEST
            if name in race.peers
        },
    }


def spaces(race: Race) -> Iterator[Entry]:
    """Time points in many dimensions, rotations, and the projective plane as a matrix."""
    yield {"what": "a torus in 4 dimensions", **race.against(clouds.in_dimension(4))}
    yield {"what": "a torus in 24 dimensions", **race.against(clouds.in_dimension(24))}
    yield {"what": "random rotations, in 9 dimensions", **race.against(clouds.rotations())}
    yield {"what": "the projective plane, as a matrix", **race.against(clouds.projective_plane(), is_matrix=True)}


def update(race: Race) -> Iterator[Entry]:
    """Time a frame of the tracker, end to end, and what of it is persistence."""
    frames = clouds.film(1000, 90)
    tracked = race.ms(lambda: tk.track(frames)) / len(frames)
    alone = race.ms(lambda: [tk.rips_persistence(points) for points in frames]) / len(frames)
    yield {"what": "SeqPH.update", "points": 1000, "ms": tracked, "persistence_ms": alone}


ROWS: dict[str, Callable[[Race], Iterable[Entry]]] = {
    "single": single,
    "first": first,
    "batches": batches,
    "spaces": spaces,
    "update": update,
}


def main() -> int:
    """Run the rows and print them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", nargs="+", choices=ROWS, default=list(ROWS))
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--patience", type=float, default=10, help="seconds that a peer may take for a cloud")
    parser.add_argument("--json", type=Path, help="also write the figures there, row by row")
    parser.add_argument("--page", action="store_true", help="put the recorded run into book/speed.md, and run nothing")
    options = parser.parse_args()
    if options.page:
        page = ROOT / "book" / "speed.md"
        found = _rips_tables.tables(json.loads(RESULTS.read_text()))
        page.write_text(in_page(page.read_text(), "rips.py", found))
        return 0
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    race = Race(options.repeat, options.patience)
    if missing := set(_rips_peers.NAMES) - set(race.peers):
        print(f"not installed: {', '.join(sorted(missing))}", file=sys.stderr)
    # Compile topokit's kernel for points and for matrices.
    _rips_peers.ours(np.random.default_rng(0).random((2000, 2)), is_matrix=False)
    _rips_peers.ours(clouds.projective_plane(1000), is_matrix=True)
    command = " ".join(["python", "book/experiments/rips.py", *sys.argv[1:]])
    for name in options.rows:
        print(f"{name}: {ROWS[name].__doc__}")
        entries = []
        for entry in ROWS[name](race):
            entries.append(_rips_tables.rounded(entry))
            print(_rips_tables.line(entries[-1]), flush=True)
        if options.json:
            _rips_tables.store(options.json, name, entries, command)
    return 0


if __name__ == "__main__":
    sys.exit(main())
