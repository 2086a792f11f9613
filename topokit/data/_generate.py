"""Generate episodes in parallel, each exactly once whatever happens.

Source: the 23,000 trajectories of Antonova et al. 2021, section 6. Taught in chapter 8.
"""

from __future__ import annotations

import contextlib
import errno
import json
import sys
import time
from collections.abc import Generator, Iterable
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from topokit._validate import positive
from topokit.sim import SimulationError
from topokit.sim._process import Forge

from ._group import Group, compact, locked, prepare, versions_of
from ._layout import encode, episode_arrays, episode_fields, room
from ._parallel import Cluster, run_jobs
from ._records import commit
from .config import DatasetConfig, draw, make_episode

__all__ = ["Interrupted", "generate", "manifest_of"]

_TRIES = 3
_WORK, _NEEDS = "topokit.data._generate:work", ("pybullet", "zarr.codecs", "zarr.storage", "scipy.spatial", "fsspec")
_NOW_AND_THEN = 500  # episodes between two updates of the index
PACKAGES = ("topokit", "numpy", "scipy", "pybullet", "zarr", "numcodecs")


class Interrupted(RuntimeError):
    """The work stopped before its end; what is done is kept, and the same command goes on."""


def manifest_of(config: DatasetConfig, episodes: int, seed: int) -> dict[str, Any]:
    """Return what the group of a dataset says it is."""
    return {
        "format": "topokit-dataset",
        "version": 1,
        "config": config.to_json(),
        "seed": seed,
        "episodes": episodes,
        "room": room(config),
        "versions": versions_of(*PACKAGES),
    }


def generate(
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
        Address of a Dask scheduler; processes of this machine when not given.
    n_workers : int, optional
        How many of those; as many as cores when not given.
    dashboard : str, optional
        Address at which Dask shows what its workers do; nowhere when not given.
    time_limit : float
        Seconds of processor time after which the simulation of an episode is stopped and tried again.
    retry_failed : bool
        Try those again that were recorded as failed.
    progress : bool
        Show a bar with the time left on stderr.

    Returns
    -------
    Group
        Open it with `Dataset` to read episodes.

    Raises
    ------
    ValueError
        When the folder was begun with another configuration, seed or version; the message names what differs.
    OSError
        When the disk is full, or another command is writing there.
    ConnectionError
        When the scheduler cannot be reached or goes away.
    Interrupted
        On Ctrl-C. In these three cases the same call goes on where it stopped.
    """
    folder = Path(out)
    if find_spec("pybullet") is None:
        raise ImportError("making episodes needs PyBullet: pip install 'topokit[sim,data]'")
    if isinstance(episodes, bool) or not isinstance(episodes, int) or episodes < 1:
        raise ValueError(f"episodes must be a whole number, at least 1, not {episodes!r}")
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise ValueError(f"seed must be a whole number, zero or more, not {seed!r}")
    positive(time_limit, "time_limit", zero=False)
    manifest = manifest_of(config, episodes, seed)
    with locked(folder):
        group = prepare(folder, manifest, episode_fields(manifest["room"]))
        if retry_failed:
            group = _forget_failed(folder, group)
        todo = [i for i in range(episodes) if i not in group.records]
        jobs = run_jobs(_make, todo, (str(folder), time_limit), Cluster(scheduler, n_workers, dashboard))
        return follow(folder, jobs, len(todo), episodes, progress)


def follow(folder: Path, jobs: Generator[tuple[int, Any]], todo: int, of: int, progress: bool) -> Group:
    """Take note of what is done, with a bar, and keep the index up to date; return the group as it is then."""
    try:
        if todo:
            with contextlib.closing(jobs):  # and with them the workers, whatever happens here
                _follow(folder, jobs, todo, of, progress)
        return compact(folder)
    except KeyboardInterrupt:
        done = len(compact(folder).records)
        raise Interrupted(f"stopped: {done} of {of} are done and kept in {folder}; the same command goes on") from None
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        said = f"{folder}: the disk is full; what was finished is whole: make room, and the same command goes on"
        raise OSError(error.errno, said) from error


def _follow(folder: Path, jobs: Iterable[tuple[int, Any]], todo: int, of: int, progress: bool) -> None:
    from tqdm import tqdm

    counts: dict[str, int] = {}
    bar = tqdm(total=of, initial=of - todo, unit="episode", disable=not progress, file=sys.stderr, smoothing=0.05)
    with bar, (folder / "timing.jsonl").open("a") as log:
        for done, (index, outcome) in enumerate(jobs, 1):
            if isinstance(outcome, BaseException):
                outcome = _lost(folder, index, outcome)
            counts[outcome["status"]] = counts.get(outcome["status"], 0) + 1
            print(json.dumps({"episode": index, **outcome, "at": round(time.time(), 3)}), file=log, flush=True)
            bar.set_postfix({key: n for key, n in counts.items() if key != "ok"}, refresh=False)
            bar.update()
            if done % _NOW_AND_THEN == 0:
                compact(folder)


def _lost(folder: Path, index: int, error: BaseException) -> dict[str, Any]:
    """Record an episode whose workers died under it again and again, or that Dask could not run."""
    from distributed import KilledWorker

    if not isinstance(error, KilledWorker):
        raise error  # of the disk, or of this program: not the episode's fault
    _record_failure(folder, index, "its worker died again and again, whatever worker it was", None)
    return {"status": "failed", "seconds": 0.0}


def _forget_failed(folder: Path, group: Group) -> Group:
    from ._records import record_path

    (folder / "index.json").unlink(missing_ok=True)  # before the records, which it would outlive
    for index, record in group.records.items():
        if record.status == "failed":
            (folder / record_path(index)).unlink(missing_ok=True)
    return compact(folder)


@lru_cache(maxsize=4)
def same_versions(folder: str, packages: tuple[str, ...]) -> None:
    """Raise RuntimeError when this worker has other versions than a group was begun with: its bytes might differ."""
    if not Path(folder, "zarr.json").exists():
        raise FileNotFoundError(
            f"{folder}: a worker does not see this folder; with a scheduler it must be on a shared disk"
        )
    here, begun = versions_of(*packages), Group(folder, records=False).manifest["versions"]
    if here != begun:
        raise RuntimeError(f"a worker has the versions {here}, {folder} was begun with {begun}: use the same ones")


_forge: Forge | None = None


def _make(folder: str, time_limit: float, index: int) -> dict[str, Any]:
    """What a Dask worker does for an episode: see to it that its record is written. Returns what goes into the log."""
    global _forge
    _forge = _forge or Forge(_WORK, _NEEDS)
    start, reasons = time.monotonic(), []
    same_versions(folder, PACKAGES)
    for attempt in range(1, _TRIES + 1):
        result = _forge.run({"folder": folder, "index": index, "attempt": attempt}, time_limit)
        if "answer" in result:
            return {"status": result["answer"], "seconds": round(time.monotonic() - start, 3), "attempts": attempt}
        if result.get("errno") is not None:  # the disk, not the episode: nothing is recorded
            raise OSError(result["errno"], result["message"])
        reasons.append(result["message"] if result["error"] == "crash" else f"{result['error']}: {result['message']}")
    _record_failure(Path(folder), index, f"after {_TRIES} tries: {'; '.join(dict.fromkeys(reasons))}", _TRIES)
    return {"status": "failed", "seconds": round(time.monotonic() - start, 3), "attempts": _TRIES}


def _record_failure(folder: Path, index: int, reason: str, attempts: int | None) -> None:
    manifest = Group(folder, records=False).manifest
    drawn = draw(DatasetConfig.from_json(manifest["config"]), manifest["seed"], index)
    commit(
        folder, {**_identity(index, drawn.task, drawn.seed), "status": "failed", "reason": reason, "attempts": attempts}
    )


def work(job: dict[str, Any]) -> str:
    """What the fresh process does: simulate, pack, write, commit. Returns the status."""
    folder, index = Path(job["folder"]), job["index"]
    manifest = Group(folder, records=False).manifest
    config, seed = DatasetConfig.from_json(manifest["config"]), manifest["seed"]
    drawn = draw(config, seed, index)
    identity = _identity(index, drawn.task, drawn.seed)
    try:
        episode = make_episode(config, seed, index, time_limit=None)
    except SimulationError as error:  # not physical, the same on every try
        return commit(folder, {**identity, "status": "rejected", "reason": str(error)}).status
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
        "shapes": {name: list(values.shape) for name, values in arrays.items()},
        "observation": episode.observation,
        "physics": episode.physics,
    }
    return commit(folder, document, encode(episode_fields(manifest["room"]), index, arrays)).status


def _identity(index: int, task: str, seed: int) -> dict[str, Any]:
    garment, _, target = task.rpartition("-")
    return {"episode": index, "task": task, "garment": garment, "target": target, "seed": seed}
