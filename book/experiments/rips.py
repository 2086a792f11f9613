"""Time degree-1 Rips persistence on one core: topokit, and its peers in the same run; book/results/rips.json.

Peers that are not installed are left out: `pip install --group bench gudhi==3.14a2` gets them (`RipsPersistence` uses Ripser
from this version of GUDHI on). Times are of the processor, medians of `--repeat` runs; what takes longer than 2 s is run once.
A peer is left out of a cloud when a quarter of its points predict more than `--patience`. The floor computes the lengths of all
pairs up to the last death. The whole takes 12 minutes; `--resume` keeps the rows that this machine has made with these versions.

    python book/experiments/rips.py --json book/results/rips.json    # every row; --rows NAME... replaces some
    python book/experiments/rips.py --page                           # puts that file into book/speed.md
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib.util import find_spec
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
CORES = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else None  # first answers compile on another core
FASTEST = ("redzed-tda",)  # the peer that large clouds, batches and other spaces are run against
LONG = 2000  # milliseconds; what takes longer is run once
Entry = dict[str, Any]
# A tracker that meets a new machine: milliseconds by the clock and of the processor, until 30 frames are below 50 ms.
LIVE = """
import itertools, json, sys, time, numpy as np, topokit as tk
frames, tracker, times = np.load(sys.argv[1]), tk.SeqPH(), []
for cloud in itertools.islice(itertools.cycle(frames), 1000):
    start = time.perf_counter(), time.process_time()
    tracker.update(cloud)
    times.append([1e3 * (time.perf_counter() - start[0]), 1e3 * (time.process_time() - start[1])])
    if max(times[-30:], key=lambda frame: frame[1])[1] < 50:
        break
print(json.dumps(times))
"""


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
        """Time one cloud: topokit and the peers, all of which must find the same last death."""
        end = _rips_peers.last_death(data, is_matrix)
        entry: Entry = {"points": len(data), "ms": self.ms(lambda: _rips_peers.ours(data, is_matrix)), "peers": {}}
        for name in [name for name in self.peers if name in only]:
            bars = self.peers[name]
            if self._expected(bars, data, is_matrix) < self.patience:
                found = []
                entry["peers"][name] = self.ms(lambda bars=bars, found=found: found.append(bars(data, is_matrix)))
                if not np.isclose(found[0][np.isfinite(found[0][:, 1]), 1].max(initial=0.0), end, rtol=1e-4):
                    raise AssertionError(f"{name} and topokit differ in the last death")
        return entry

    @staticmethod
    def _expected(bars: _rips_peers.Bars, data: np.ndarray, is_matrix: bool) -> float:
        """Return the seconds that a peer would take if time grew with the cube of the points, from a quarter of them."""
        few = len(data) // 4
        if few < 50:
            return 0.0
        start = time.process_time()
        bars(data[:few, :few].copy() if is_matrix else data[:few], is_matrix)
        return (time.process_time() - start) * (len(data) / few) ** 3


def single(race: Race) -> Iterator[Entry]:
    """Time single clouds of four shapes against all peers, and the floor."""
    for shape in ("apron", "torus", "sphere", "cube"):
        for n in (500, 1000, 2000):
            points = clouds.cloud(shape, n)
            floor_ms = race.ms(_rips_peers.floor(points, _rips_peers.last_death(points)))
            yield {"what": shape, "floor_ms": floor_ms, **race.against(points, only=_rips_peers.NAMES)}


def small(race: Race) -> Iterator[Entry]:
    """Time small clouds, points in 50 dimensions and random matrices, where peers are ahead, against all peers."""
    rng = np.random.default_rng(0)
    works = [(shape, clouds.cloud(shape, n)) for shape in ("torus", "cube") for n in (10, 20, 32, 64, 128)]
    works += [("Gaussian in 50 dimensions", rng.normal(size=(n, 50))) for n in (500, 1000)]
    works += [("random matrix", np.triu(rng.random((n, n)), 1)) for n in (50, 100, 200)]
    for what, data in works:
        is_matrix = what == "random matrix"
        data = data + data.T if is_matrix else data
        yield {"what": what, **race.against(data, is_matrix, only=_rips_peers.NAMES)}


def large(race: Race) -> Iterator[Entry]:
    """Time large clouds, and fit the power of the points with which the time grows."""
    race = Race(race.repeat, 3 * race.patience)
    for n in (5000, 10000, 20000):
        yield {"what": "torus", **race.against(clouds.cloud("torus", n))}
    for shape in ("apron", "torus"):
        sizes = (500, 1000, 2000, 4000, 8000, 15000)
        of_shape = [clouds.cloud(shape, n) for n in sizes]
        times = [race.ms(lambda points=points: _rips_peers.ours(points, False)) for points in of_shape]
        power = float(np.polyfit(np.log(sizes), np.log(times), 1)[0])
        yield {"what": shape, "points": sizes[-1], "ms": times[-1], "power": power, "sizes": sizes, "times_ms": times}


def first(race: Race) -> Iterator[Entry]:
    """Time first answers by the clock, import included: in a fresh process with nothing compiled, then once more."""
    snippet = (ROOT / "README.md").read_text().split("```python\n")[1].split("```")[0]
    begin = "import sys, numpy as np, topokit as tk\n"
    one = begin + "tk.rips_persistence(np.load(sys.argv[1]))"
    many = begin + "tk.rips_persistence_many(list(np.load(sys.argv[1])), n_jobs=1)"
    torus = clouds.cloud("torus", 1000)
    works = [
        ("README's snippet, empty cache", snippet, torus[:60]),
        ("first cloud, a torus, empty cache", one, torus),
        ("first cloud, a torus, without numba", "import sys\nsys.modules['numba'] = None\n" + one, torus[:100]),
        ("clouds of all shapes, empty cache", many, np.array(clouds.small_clouds(1000))),
    ]
    for what, code, array in works:
        with tempfile.TemporaryDirectory() as folder:
            empty, cached = (child(code, array, folder)[0] for _ in range(2))
            found = {"points": array.shape[-2], "ms": empty, "cached_ms": cached}
            if array.ndim == 3:
                compiled = [sys.executable, "-m", "topokit.rips.engine"]
                subprocess.run(compiled, check=True, env=os.environ | {"NUMBA_CACHE_DIR": folder})
                found |= {"clouds": len(array), "compiled_ms": child(code, array, folder)[0]}
        yield {"what": what, **found}
    with tempfile.TemporaryDirectory() as folder:
        times = np.array(json.loads(child(LIVE, np.array(clouds.film(1000, 96)), folder)[1]))
    slow = times[times[:, 1] > 50]
    found = {"slow_frames": len(slow), "slow_seconds": slow[:, 0].sum() / 1e3, "longest_ms": times[:, 0].max()}
    yield {"what": "tracking live, empty cache", "points": 1000, "ms": float(np.median(times[-30:, 1])), **found}


def child(code: str, array: np.ndarray, folder: str) -> tuple[float, str]:
    """Run code on an array in a fresh process with its cache in a folder; return the milliseconds, and what it printed."""
    np.save(f"{folder}/array.npy", array)
    command = [sys.executable, "-c", code, f"{folder}/array.npy"]
    every_core = (lambda: os.sched_setaffinity(0, CORES)) if CORES else None
    start = time.perf_counter()
    environment = os.environ | {"NUMBA_CACHE_DIR": folder}
    done = subprocess.run(command, capture_output=True, check=True, env=environment, preexec_fn=every_core)
    return 1e3 * (time.perf_counter() - start), done.stdout.decode()


def batches(race: Race) -> Iterator[Entry]:
    """Time many clouds in one call, and one by one; by the fastest peer one by one."""
    batch = clouds.small_clouds(1000)
    alone = list(map(tk.rips_persistence, batch))
    for one, other in zip(alone, tk.rips_persistence_many(batch, n_jobs=1), strict=True):
        if not all(np.array_equal(getattr(one, k), getattr(other, k)) for k in ("birth", "death", "killer_triangles")):
            raise AssertionError("clouds together have other diagrams than one by one")
    times = {
        "ms": race.ms(lambda: tk.rips_persistence_many(batch, n_jobs=1)),
        "one_by_one_ms": race.ms(lambda: list(map(tk.rips_persistence, batch))),
    }
    peers = {name: race.peers[name] for name in FASTEST if name in race.peers}
    times["peers"] = {
        name: race.ms(lambda bars=bars: [bars(points, False) for points in batch]) for name, bars in peers.items()
    }
    yield {"what": "clouds of all shapes", "clouds": len(batch), "points": len(batch[0]), **times}


def spaces(race: Race) -> Iterator[Entry]:
    """Time rotations, and the projective plane as a matrix."""
    yield {"what": "random rotations, in 9 dimensions", **race.against(clouds.rotations())}
    yield {"what": "the projective plane, as a matrix", **race.against(clouds.projective_plane(), is_matrix=True)}


def update(race: Race) -> Iterator[Entry]:
    """Time a frame of the tracker, end to end, and what of it is persistence; and many plans under one forecast."""
    frames = clouds.film(1000, 90)
    tracked = race.ms(lambda: tk.track(frames)) / len(frames)
    alone = race.ms(lambda: [tk.rips_persistence(points) for points in frames]) / len(frames)
    yield {"what": "SeqPH.update", "points": 1000, "ms": tracked, "persistence_ms": alone}
    if find_spec("torch"):
        import torch

        from topokit.io import load_episode
        from topokit.models import Predictor

        torch.set_num_threads(1)
        predictor = Predictor.load(ROOT / "data_small" / "checkpoints" / "motion.safetensors")
        episode = load_episode(ROOT / "data_small" / "apron_hook_0.npz")
        for t in range(16):
            predictor.observe(episode.observed[t], episode.grippers[t], target=episode.centre_line)
        aside = np.random.default_rng(0).normal(0, 0.02, (1000, 60, 2, 3))
        plans = episode.actions[16:76] + aside.astype(np.float32)
        ms = race.ms(lambda: predictor.predict(plans))
        with torch.profiler.profile() as profile:
            predictor.predict(plans)
        spent = {event.key: event.self_cpu_time_total for event in profile.key_averages()}
        share = sum(spent.get(f"aten::{name}", 0) for name in ("addmm", "mm", "bmm")) / sum(spent.values())
        yield {"what": "states of 60 frames by Motion", "plans": len(plans), "ms": ms, "products_ms": share * ms}


ROWS: dict[str, Callable[[Race], Iterable[Entry]]] = {
    "single": single,
    "small": small,
    "large": large,
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
    parser.add_argument("--patience", type=float, default=5, help="seconds that a peer may take for a cloud")
    parser.add_argument("--json", type=Path, help="also write the figures there, row by row")
    parser.add_argument("--resume", action="store_true", help="leave out rows that are in this file already")
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
    tk.rips_persistence(np.random.default_rng(0).random((6000, 2)))  # it waits for the compiled engine
    command = " ".join(["python", "book/experiments/rips.py", *(word for word in sys.argv[1:] if word != "--resume")])
    known = _rips_tables.known_rows(options.json) if options.resume else {}
    for name in [name for name in options.rows if name not in known]:
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
