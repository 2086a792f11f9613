"""Work in fresh processes of this machine, each of which may crash, hang or be stopped without harm to the others.

Idea: PyBullet repeats self-collision bit by bit in a fresh process only, can end its process, and can hang inside C. The fork
server of the standard library has imported what is needed and has done nothing else. A fork of it is as fresh as a new process
and starts in some milliseconds. Where there is no fork server (Windows), each process starts anew.
"""

from __future__ import annotations

import collections
import contextlib
import math
import multiprocessing
import multiprocessing.resource_tracker
import multiprocessing.spawn
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any

from ._archive import temporary_folder

_CONTEXT: Any = multiprocessing.get_context("forkserver" if hasattr(os, "fork") else "spawn")
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_LONGEST_FOLDER = 70  # characters: the address of a fork server is a path of at most 107, with 33 of its own
_starting = threading.Lock()


class ProcessError(RuntimeError):
    """A process that crashed, or was stopped because it showed no sign of life. The message says which."""


@dataclass
class _Job:
    """An item whose function runs in a fresh process."""

    item: Any
    failures: list[str]  # of the tries before
    process: Any
    deadline: float


def in_fresh_processes(
    function: Callable[..., Any],
    items: Iterable[Any],
    *,
    n_workers: int = 1,
    time_limit: float = math.inf,
    tries: int = 1,
    report: Callable[[Any], None] | None = None,
    preload: Sequence[str] = (),
) -> Iterator[tuple[Any, Any]]:
    """Yield every item with what `function(item)` returned or raised, as they are done, each from a process of its own.

    Function, items and answers must be picklable. With `report` the function gets a second argument, a function, and `report` is
    called with everything that it is called with. A process is stopped when nothing comes from it for `time_limit` seconds. An
    item whose process crashed or was stopped is tried again, `tries` times in all; then its outcome is a `ProcessError`. The
    modules `preload` are imported once, by the first caller. When the caller stops, all processes are stopped.
    """
    waiting = collections.deque((item, list[str]()) for item in items)
    running: dict[Connection, _Job] = {}
    with temporary_folder() as folder:
        try:
            while waiting or running:
                # Give every free worker an item.
                while waiting and len(running) < n_workers:
                    item, failures = waiting.popleft()
                    ours, theirs = _CONTEXT.Pipe(duplex=False)
                    arguments = (theirs, function, item, report is not None, str(folder))
                    with deferred_signals():  # so that every process that was started is stopped
                        process = _started(_CONTEXT.Process(target=_perform, args=arguments), preload)
                        theirs.close()
                        running[ours] = _Job(item, failures, process, time.monotonic() + time_limit)
                # See what has come: a report, an outcome, or the end of a process that sent none.
                for connection, kind, value in _news(running, time_limit):
                    if kind == "report" and report is not None:
                        report(value)
                        continue
                    job = running.pop(connection)
                    _end(connection, job.process)
                    if kind == "outcome":
                        yield job.item, value
                    elif len(job.failures) + 1 < tries:
                        waiting.append((job.item, [*job.failures, value]))
                    else:
                        yield job.item, ProcessError("; ".join(dict.fromkeys([*job.failures, value])))
        finally:
            for connection, job in running.items():
                _end(connection, job.process)


def _news(running: dict[Connection, _Job], time_limit: float) -> list[tuple[Connection, str, Any]]:
    """Wait until a process sends something, ends or is overdue; return what each of these sent, or how it failed."""
    patience = min(job.deadline for job in running.values()) - time.monotonic()
    ready = wait(list(running), None if math.isinf(patience) else max(0.0, patience))
    news: list[tuple[Connection, str, Any]] = []
    for connection, job in running.items():
        if connection in ready:
            job.deadline = time.monotonic() + time_limit
            try:
                news.append((connection, *connection.recv()))
            except (EOFError, OSError):
                job.process.join()
                news.append((connection, "failure", _fate(job.process.exitcode)))
        elif time.monotonic() >= job.deadline:
            news.append((connection, "failure", f"stopped: no sign of life for {time_limit:g} s"))
    return news


def _fate(code: int) -> str:
    """Return in words how a process ended that sent no answer."""
    if code < 0:
        return f"{signal.Signals(-code).name}: a crash inside PyBullet, or out of memory"
    return f"exit code {code}"


def _end(connection: Connection, process: Any) -> None:
    connection.close()
    process.kill()
    process.join()
    process.close()


def _started(process: Any, preload: Sequence[str]) -> Any:
    """Start a process that knows nothing of its caller but the path of its packages.

    It does not run the caller's script again, as multiprocessing would have it, and imports nothing from the working directory.
    Ctrl-C, and the end of the terminal, are for the caller alone. A caller that is a daemon, as Dask's workers are, may start
    one: it ends with its caller.
    """
    packages = [path for path in sys.path if path]
    own = {"PYTHONSAFEPATH": "1", "PYTHONPATH": os.pathsep.join(packages), **dict.fromkeys(_THREADS, "1")}
    prepare = multiprocessing.spawn.get_preparation_data

    def prepare_without_script(name: str) -> dict[str, Any]:
        data = {key: value for key, value in prepare(name).items() if not key.startswith("init_main")}
        return {**data, "sys_path": packages}

    with _starting, contextlib.ExitStack() as restore:
        # The fork server inherits the environment: one thread each, and a safe path.
        restore.callback(os.environ.update, dict(os.environ))
        for name in own.keys() - os.environ.keys():
            restore.callback(os.environ.pop, name)
        os.environ.update(own)
        # A blocked signal stays blocked in the fork server and in all that it forks.
        if hasattr(signal, "pthread_sigmask"):
            mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})
            restore.callback(signal.pthread_sigmask, signal.SIG_SETMASK, mask)
            multiprocessing.resource_tracker.ensure_running()  # it would unblock Ctrl-C again
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        # The fork server listens at a path in the folder of temporary files, which may be too long for an address.
        if len(tempfile.gettempdir()) > _LONGEST_FOLDER and os.path.isdir("/tmp"):
            restore.callback(setattr, tempfile, "tempdir", tempfile.tempdir)
            tempfile.tempdir = "/tmp"
        # multiprocessing refuses children of daemons, and would run the caller's script in them.
        settings = multiprocessing.current_process()._config  # type: ignore[attr-defined]
        restore.callback(settings.update, daemon=settings.get("daemon"))
        settings["daemon"] = False
        restore.callback(setattr, multiprocessing.spawn, "get_preparation_data", prepare)
        multiprocessing.spawn.get_preparation_data = prepare_without_script
        _CONTEXT.set_forkserver_preload(list(preload))
        process.start()
    return process


@contextlib.contextmanager
def deferred_signals() -> Iterator[None]:
    """Let the signals that end this process act after the block, which must not be left half done."""
    if threading.current_thread() is not threading.main_thread():  # signals are handled in the main thread alone
        yield
        return
    arrived: list[int] = []
    handlers = {}
    try:
        for number in {signal.SIGINT, signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)}:
            if signal.getsignal(number) is not None:
                handlers[number] = signal.getsignal(number)
                signal.signal(number, lambda arrival, _: arrived.append(arrival))
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for number in arrived:
            signal.raise_signal(number)


def _perform(connection: Connection, function: Callable[..., Any], item: Any, reports: bool, folder: str) -> None:
    """Do the work, and send what the function returns or raises; temporary files lie in `folder`."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # PyBullet writes there
    tempfile.tempdir = folder
    arguments = [item]
    if reports:
        arguments.append(lambda value: connection.send(("report", value)))
    try:
        outcome = function(*arguments)
    except Exception as error:
        outcome = error
    pairs = sys.modules.get("topokit.rips._pairs")
    if pairs is not None:
        pairs.keep_seconds()  # now, since this process is killed when its outcome has arrived
    with contextlib.suppress(BrokenPipeError):  # the caller has ended
        connection.send(("outcome", outcome))


def _end_with_parent() -> None:
    """End this process when its parent has ended, in whatever way."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
