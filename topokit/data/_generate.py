"""Generate episodes in parallel, each exactly once whatever happens.

Idea: every job writes the same bytes whenever it is done, so whatever goes wrong with a Dask worker, its job is given again.

Source: the 23,000 trajectories of Antonova et al. 2021, section 6. Taught in chapter 9.
"""

from __future__ import annotations

import contextlib
import errno
import json
import logging
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from topokit._cores import n_cores, safe_path
from topokit._validate import positive
from topokit.sim import SimulationError
from topokit.sim._process import Forge, for_us_alone

from ._group import Group, commit, compact, local_folder, refuse_another, versions_of, writing
from ._layout import encode, episode_arrays, episode_fields
from ._recipe import DatasetConfig, checked_file, make_episode, pinned, room
from ._records import MOST_EPISODES, record_path

_TRIES = 3
_SIMULATE = "topokit.data._generate:simulate_and_commit"
_NEEDS = ("pybullet", "zarr.codecs", "zarr.storage", "scipy.spatial", "fsspec")
Job = Callable[[int], dict[str, Any]]
PACKAGES = ("numpy", "scipy", "pybullet", "zarr", "numcodecs")
_PATIENCE = 20.0  # seconds for a scheduler to answer
_SHORT = 30.0  # seconds for which a worker of ours may be gone; its nanny needs about two to replace it
_LOST_WORKERS = 10  # a job whose worker vanished so often is at fault; its own crashes it reports itself
_STARTS = 5  # of a cluster in which nothing gets done


@dataclass(frozen=True)
class Cluster:
    """Where jobs run; `generate_dataset` says what these are."""

    scheduler: str | None = None
    n_workers: int | None = None
    dashboard: str | None = None

    def __post_init__(self) -> None:
        if self.n_workers is not None and self.n_workers < 1:
            raise ValueError(f"n_workers must be at least 1, not {self.n_workers}")


def generate_dataset(
    config: DatasetConfig,
    out: str | Path,
    episodes: int,
    seed: int,
    *,
    scheduler: str | None = None,
    n_workers: int | None = None,
    dashboard: str | None = None,
    time_limit: float = 600.0,
    retry_failed: bool = False,
    progress: bool = True,
) -> Group:
    """Make the dataset of a configuration and a seed in a folder, or go on with it.

    Every episode is `make_episode` of the configuration, the seed and its number, simulated in a fresh process: the bytes
    do not depend on how many workers there are, in which order they work or how often they were stopped.

    Parameters
    ----------
    config : DatasetConfig
    out : path
        A folder of a local disk, or of one that all workers share. What is finished there stays.
    episodes : int
        How many there are to be; more than the last time adds to them.
    seed : int
    scheduler : str, optional
        Address of a Dask scheduler whose workers see the same folder; processes of this machine when not given.
    n_workers : int, optional
        How many of those; as many as cores when not given.
    dashboard : str, optional
        Address at which Dask shows what its workers do, for example "localhost:8787"; nowhere when not given.
    time_limit : float
        Seconds of processor time after which the simulation of an episode is stopped and tried again.
    retry_failed : bool
        Try those again that were recorded as failed.
    progress : bool
        Show a bar with the time left on stderr.

    Raises
    ------
    ValueError
        When the folder was begun with another configuration, seed or version, or a mesh in it is not the one that it was;
        the message names what differs.
    FileNotFoundError
        When the file of a mesh is not there.
    ImportError
        When PyBullet is not there.
    """
    folder, cluster = local_folder(out), Cluster(scheduler, n_workers, dashboard)
    if find_spec("pybullet") is None:
        raise ImportError("making episodes needs PyBullet: pip install 'topokit[sim,data]'")
    for name, number, least, most in (("episodes", episodes, 1, MOST_EPISODES), ("seed", seed, 0, 2**128)):
        if isinstance(number, bool) or not isinstance(number, int) or not least <= number <= most:
            raise ValueError(f"{name} must be a whole number from {least} to {most:,}")
    positive(time_limit, "time_limit", zero=False)
    manifest = _manifest(pinned(config), episodes, seed)
    with writing(folder, manifest, episode_fields(manifest["room"])):
        if retry_failed:
            _forget_failed(folder)
        job = partial(_make_episode, str(folder), time_limit)
        return make_missing(folder, range(episodes), job, partial(_identity, manifest), cluster, progress)


def _manifest(config: DatasetConfig, episodes: int, seed: int) -> dict[str, Any]:
    """What the group of a dataset says it is."""
    return {
        "format": "topokit-dataset",
        "version": 1,
        "config": config.to_json(),
        "seed": seed,
        "episodes": episodes,
        "room": room(config),
        "versions": versions_of(*PACKAGES),
    }


def make_missing(
    folder: Path, numbers: Sequence[int], job: Job, identity: Job, cluster: Cluster, progress: bool
) -> Group:
    """Do a job for every episode without a record, which begins with its identity; return the group as it is then."""
    done = Group(folder).records
    todo = [i for i in numbers if i not in done]
    try:
        if todo:
            with contextlib.closing(run_jobs(job, todo, cluster)) as outcomes:  # and with them the workers
                _note(folder, (_kept(folder, identity, *one) for one in outcomes), len(todo), len(numbers), progress)
        return compact(folder)
    except KeyboardInterrupt:
        kept = f"{len(compact(folder).records)} of {len(numbers)} are done and kept in {folder}"
        raise KeyboardInterrupt(f"stopped: {kept}; the same command goes on") from None
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        message = f"{folder}: the disk is full; what was finished is whole: make room, and the same command goes on"
        raise OSError(error.errno, message) from error


def _note(folder: Path, outcomes: Iterable[dict[str, Any]], todo: int, wanted: int, progress: bool) -> None:
    """Keep the log and the bar up to date with what is done."""
    from tqdm import tqdm

    counts: Counter[str] = Counter()
    options = {"unit": "episode", "disable": not progress, "file": sys.stderr, "smoothing": 0.05}
    bar = tqdm(total=wanted, initial=wanted - todo, **options)
    with bar, (folder / "timing.jsonl").open("a") as log:
        for outcome in outcomes:
            counts[outcome["status"]] += 1
            print(json.dumps({**outcome, "at": round(time.time(), 3)}), file=log, flush=True)
            bar.set_postfix({key: n for key, n in counts.items() if key != "ok"}, refresh=False)
            bar.update()


def _kept(folder: Path, identity: Job, index: int, outcome: Any) -> dict[str, Any]:
    """What goes into the log; an episode whose workers died under it again and again is recorded first."""
    from distributed import KilledWorker

    if isinstance(outcome, KilledWorker):
        failure = {"status": "failed", "reason": "its worker died again and again, whatever worker it was"}
        commit(folder, {**identity(index), **failure, "attempts": None})
        outcome = {"status": "failed", "seconds": 0.0}
    elif isinstance(outcome, BaseException):
        raise outcome  # of the disk, or of this program: not the episode's fault
    return {"episode": index, **outcome}


def _forget_failed(folder: Path) -> None:
    records = Group(folder).records
    (folder / "index.json").unlink(missing_ok=True)  # before the records, which it would outlive
    for index, record in records.items():
        if record.status == "failed":
            (folder / record_path(index)).unlink(missing_ok=True)


def manifest_here(folder: Path, packages: Sequence[str]) -> dict[str, Any]:
    """What a group says it is, to a worker that shall write to it: with the same versions, else bytes might differ."""
    manifest = Group(folder).manifest
    refuse_another(manifest["versions"], versions_of(*packages), str(folder), "versions")
    return manifest


_forge: Forge | None = None  # of this worker


def _make_episode(folder: str, time_limit: float, index: int) -> dict[str, Any]:
    """What a Dask worker does for an episode: see to its record, and say what goes into the log."""
    global _forge
    _forge = _forge or Forge(_SIMULATE, _NEEDS)
    start, reasons, manifest = time.monotonic(), [], manifest_here(Path(folder), PACKAGES)
    mesh = DatasetConfig.from_json(manifest["config"]).meshes.get(_identity(manifest, index)["garment"])
    if mesh is not None:
        checked_file(mesh)  # that it is gone is no fault of the episode, either
    for attempt in range(1, _TRIES + 1):
        result = _forge.run({"folder": folder, "index": index, "attempt": attempt}, time_limit)
        if result.get("errno") is not None:  # the disk, not the episode: nothing is recorded
            raise OSError(result["errno"], result["message"])
        if "answer" in result:
            status = result["answer"]
            break
        reasons.append(result["message"] if result["error"] == "crash" else f"{result['error']}: {result['message']}")
    else:
        status, reason = "failed", f"after {_TRIES} tries: {'; '.join(dict.fromkeys(reasons))}"
        document = {**_identity(manifest, index), "status": status, "reason": reason, "attempts": _TRIES}
        commit(Path(folder), document)
    return {"status": status, "seconds": round(time.monotonic() - start, 3), "attempts": attempt}


def simulate_and_commit(job: dict[str, Any]) -> str:
    """What the fresh process does: simulate, pack, write, commit. Returns the status."""
    folder, index = Path(job["folder"]), job["index"]
    manifest = Group(folder).manifest
    identity = _identity(manifest, index)
    try:
        episode = make_episode(DatasetConfig.from_json(manifest["config"]), manifest["seed"], index, time_limit=None)
    except SimulationError as error:  # not physical, the same on every try
        commit(folder, {**identity, "status": "rejected", "reason": str(error)})
        return "rejected"
    arrays = episode_arrays(episode)
    document = {
        **identity,
        "status": "ok",
        "success": episode.success,
        "frames": len(episode),
        "vertices": episode.points.shape[1],
        "observed": episode.observed.shape[1],
        "dt": episode.dt,
        "loops": [len(loop) for loop in episode.loops],
        "observation": episode.observation,
        "physics": episode.physics,
        "shapes": {name: list(part.shape) for name, part in arrays.items()},
    }
    commit(folder, document, encode(episode_fields(manifest["room"]), index, arrays))
    return "ok"


def _identity(manifest: dict[str, Any], index: int) -> dict[str, Any]:
    task, seed = DatasetConfig.from_json(manifest["config"]).draw(manifest["seed"], index)
    garment, _, target = task.rpartition("-")
    return {"episode": index, "task": task, "garment": garment, "target": target, "seed": seed}


class _ShortOfWorkersError(Exception):
    """Workers of ours are gone for good: a nanny gives up when its worker dies while it starts."""


def run_jobs(job: Job, items: Sequence[int], cluster: Cluster) -> Generator[tuple[int, Any]]:
    """Yield (item, what `job` of it returned, or the exception that it raised) as they are done."""
    left, starts = dict.fromkeys(items), 0
    while left and starts < _STARTS:
        starts += 1
        with contextlib.suppress(_ShortOfWorkersError), _client(cluster, len(left)) as (client, workers):
            for item, outcome in _run(client, workers, job, list(left)):
                del left[item]
                starts = 0
                yield item, outcome
    if left:
        raise ConnectionError("Dask's workers do not start, or end again at once; the same command goes on")


def _run(client: Any, workers: int, job: Job, items: list[int]) -> Iterator[tuple[int, Any]]:
    """Yield what is done, with two jobs in flight for every thread: small ones, so that nobody waits for the next."""
    from distributed import CancelledError, wait
    from distributed import TimeoutError as WaitTimeoutError

    number: dict[Any, int] = {}
    todo, last_full = iter(items), time.monotonic()
    while True:
        threads = client.nthreads()
        last_full = time.monotonic() if len(threads) >= workers else last_full
        if time.monotonic() - last_full > _SHORT:
            raise _ShortOfWorkersError
        wanted = 2 * max(1, sum(threads.values())) - len(number)
        for _, item in zip(range(wanted), todo, strict=False):
            number[client.submit(job, item, pure=False)] = item
        if not number:
            return
        with client.as_current(), contextlib.suppress(WaitTimeoutError, CancelledError):
            wait(list(number), timeout=5, return_when="FIRST_COMPLETED")
        for future in [future for future in number if future.done()]:
            if future.cancelled():
                raise ConnectionError("the Dask scheduler has gone away: start it again, and the same command goes on")
            yield number.pop(future), future.exception() or future.result()


@contextlib.contextmanager
def _client(cluster: Cluster, jobs: int) -> Iterator[tuple[Any, int]]:
    """A client, and how many workers its cluster must have."""
    from distributed import Client

    if cluster.scheduler is None:
        count = min(cluster.n_workers or n_cores(), jobs)
        with _local_cluster(count, cluster.dashboard) as local, Client(local, set_as_default=False) as client:
            yield client, count
        return
    try:
        client = Client(cluster.scheduler, timeout=_PATIENCE, set_as_default=False)
    except (OSError, TimeoutError) as error:
        raise ConnectionError(f"no Dask scheduler answers at {cluster.scheduler}: {error}") from error
    with client:
        yield client, 0  # workers of others may come and go


@contextlib.contextmanager
def _local_cluster(count: int, dashboard: str | None) -> Iterator[Any]:
    import dask
    from distributed import LocalCluster

    settings = {
        "distributed.scheduler.allowed-failures": _LOST_WORKERS,
        "distributed.comm.timeouts.connect": "60s",
        "distributed.worker.profile.enabled": bool(dashboard),  # it would take 3 % of a core
        "distributed.admin.low-level-log-length": 100,
    }
    with dask.config.set(settings), safe_path():
        try:
            with for_us_alone(signal.SIGINT):
                local = LocalCluster(
                    n_workers=count,
                    threads_per_worker=1,
                    processes=True,
                    memory_limit=0,
                    dashboard_address=dashboard or "127.0.0.1:0",  # its health alone, to this machine
                    scheduler_kwargs={"dashboard": bool(dashboard)},
                    silence_logs=logging.CRITICAL,
                )
        except RuntimeError as error:
            raise _ShortOfWorkersError from error
        with local:
            if dashboard:
                print(f"dashboard: {local.dashboard_link}", file=sys.stderr)
            yield local
