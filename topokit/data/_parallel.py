"""Jobs on Dask workers: a bounded number at a time, workers replaced when they die, whatever way they die.

Nothing is lost when a job is done twice, as every job writes the same bytes; so whatever goes wrong, it is given again.
"""

from __future__ import annotations

import contextlib
import logging
import sys
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from topokit._cores import n_cores

Job = Callable[[int], dict[str, Any]]
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


class _ShortOfWorkersError(Exception):
    """Workers of ours are gone and were not replaced: a nanny gives up when its worker dies while it starts."""


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
    with dask.config.set(settings):
        try:
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
