"""Make the files of many episodes, each exactly once whatever happens, on this machine or on a cluster.

Idea: a job writes the same bytes whenever it is done. So it may be done twice, and whatever happens to a worker, its job is given
again. On a cluster Dask hands out the jobs; each worker does its job in a fresh process, as this machine would.
"""

from __future__ import annotations

import contextlib
import errno
import sys
from collections import Counter
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from topokit._cores import n_cores
from topokit._processes import ProcessError, in_fresh_processes

from ._folder import failure_path, remove_parts, write_json

_TRIES = 3
_PATIENCE = 20.0  # seconds for a scheduler to answer
Job = Callable[[int], str]  # writes the file of an episode and returns its status


@dataclass(frozen=True)
class Workers:
    """The place where jobs run, by the parameters of `generate_dataset`."""

    scheduler: str | None = None
    n_workers: int | None = None
    time_limit: float = float("inf")
    preload: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.n_workers is not None and self.n_workers < 1:
            raise ValueError(f"n_workers must be at least 1, not {self.n_workers}")


def make_files(
    folder: Path,
    numbers: Sequence[int],
    wanted: int,
    job: Job,
    describe: Callable[[int], dict[str, Any]],
    workers: Workers,
    progress: bool,
) -> None:
    """Do a job for every number; one whose process fails again and again is recorded, as what `describe` returns."""
    from tqdm import tqdm

    counts: Counter[str] = Counter()
    options = {"unit": "episode", "disable": not progress, "file": sys.stderr, "smoothing": 0.05}
    done = wanted - len(numbers)
    try:
        with (
            tqdm(total=wanted, initial=done, **options) as bar,
            contextlib.closing(_outcomes(job, numbers, workers)) as outcomes,
        ):
            for number, outcome in outcomes:
                # The outcome is a status; an exception stops the command, unless it is the episode's own.
                if isinstance(outcome, ProcessError):
                    reason = f"after {_TRIES} tries: {outcome}"
                    write_json(failure_path(folder, number), {**describe(number), "status": "failed", "reason": reason})
                    outcome = "failed"
                elif isinstance(outcome, BaseException):
                    raise outcome
                counts[outcome] += 1
                done += 1
                bar.set_postfix({status: n for status, n in counts.items() if status != "ok"}, refresh=False)
                bar.update()
    except KeyboardInterrupt:
        kept = f"{done} of {wanted} are done and kept in {folder}"
        raise KeyboardInterrupt(f"stopped: {kept}; the same command goes on") from None
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        message = f"{folder}: the disk is full; what was finished is whole: make room, and the same command goes on"
        raise OSError(error.errno, message) from error
    finally:
        if workers.scheduler is None:  # workers of a cluster may still be writing
            remove_parts(folder)


def _outcomes(job: Job, numbers: Sequence[int], workers: Workers) -> Generator[tuple[int, Any]]:
    """Yield every number with the outcome of its job, as they are done."""
    if workers.scheduler is not None:
        yield from _on_cluster(job, numbers, workers)
        return
    yield from in_fresh_processes(
        job,
        numbers,
        n_workers=workers.n_workers or n_cores(),
        time_limit=workers.time_limit,
        tries=_TRIES,
        preload=workers.preload,
    )


def _on_cluster(job: Job, numbers: Sequence[int], workers: Workers) -> Generator[tuple[int, Any]]:
    import dask
    from distributed import Client, KilledWorker, as_completed

    address = str(workers.scheduler)
    if address.startswith("tls:") and not dask.config.get("distributed.comm.tls.ca-file", None):
        raise ValueError(f"{address}: Dask's own settings, distributed.comm.tls, must name the certificates")
    try:
        client = Client(address, timeout=_PATIENCE, set_as_default=False)
    except (OSError, TimeoutError) as error:
        raise ConnectionError(f"no Dask scheduler answers at {address}: {error}") from error
    with client:
        # Dask gives the job of a worker that dies to another one, and gives up when it dies again and again.
        afresh = partial(_one_afresh, job, workers)
        number_of = {client.submit(afresh, number, pure=False): number for number in numbers}
        for future in as_completed(list(number_of), loop=client.loop):
            number = number_of.pop(future)
            if future.cancelled():
                raise ConnectionError("the Dask scheduler has gone away: start it again, and the same command goes on")
            failure = future.exception()
            if isinstance(failure, KilledWorker):
                yield number, ProcessError("its worker died, whatever worker it was")
            else:
                yield number, failure or future.result()


def _one_afresh(job: Job, workers: Workers, number: int) -> Any:
    """Do a job in a fresh process of a worker; return its outcome."""
    ((_, outcome),) = _outcomes(job, [number], replace(workers, scheduler=None))
    return outcome
