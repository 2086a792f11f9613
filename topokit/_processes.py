"""Work in fresh processes of this machine, each of which may crash, hang or be stopped without harm to the others.

Idea: PyBullet repeats self-collision bit by bit in a fresh process only, can end its process, and can hang inside C. So each item
has a Python of its own, which gets its work by a pipe and sends back what it did. A thread listens to each of them.
"""

from __future__ import annotations

import collections
import math
import os
import pickle
import queue
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass, field
from typing import Any

_CHILD = "from topokit._processes import perform; perform()"


class ProcessError(RuntimeError):
    """A process that crashed, or was stopped because it showed no sign of life. The message says which."""


@dataclass(eq=False)
class _Job:
    """An item, and the process in which its function runs."""

    item: Any
    failures: list[str] = field(default_factory=list)  # of the tries before
    process: Any = None
    listener: Any = None  # the thread that reads what the process sends
    deadline: float = math.inf


def in_fresh_processes(
    function: Callable[..., Any],
    items: Iterable[Any],
    *,
    n_workers: int = 1,
    time_limit: float = math.inf,
    tries: int = 1,
    report: Callable[[Any], None] | None = None,
) -> Generator[tuple[Any, Any], None, None]:
    """Yield every item with what `function(item)` returned or raised, as they are done, each from a process of its own.

    Function, items and answers must be picklable. With `report` the function gets a second argument, a function, and `report` is
    called with everything that it is called with. A process is stopped when nothing comes from it for `time_limit` seconds. An
    item whose process crashed or was stopped is tried again, `tries` times in all; then its outcome is a `ProcessError`. When the
    caller stops, all processes are stopped.
    """
    waiting = collections.deque(_Job(item) for item in items)
    running: list[_Job] = []
    news: queue.Queue[tuple[_Job, str, Any]] = queue.Queue()
    with tempfile.TemporaryDirectory(prefix="topokit-") as folder:
        try:
            while waiting or running:
                # Give every free worker an item.
                while waiting and len(running) < n_workers:
                    job = waiting.popleft()
                    job.process = _start(folder)
                    running.append(job)
                    job.deadline = time.monotonic() + time_limit
                    work = pickle.dumps((function, job.item, report is not None))
                    job.listener = threading.Thread(target=_listen, args=(job, work, news), daemon=True)
                    job.listener.start()
                # See what has come: a report, an outcome, or the end of a process that sent none.
                job, kind, value = _next(running, news, time_limit)
                if job not in running:
                    continue  # a process that was stopped
                job.deadline = time.monotonic() + time_limit
                if kind == "report" and report is not None:
                    report(value)
                    continue
                running.remove(job)
                _end(job)
                if kind == "outcome":
                    yield job.item, value
                    continue
                job.failures.append(value)
                if len(job.failures) < tries:
                    waiting.append(job)
                else:
                    yield job.item, ProcessError("; ".join(dict.fromkeys(job.failures)))
        finally:
            for job in running:
                _end(job)


def _end(job: _Job) -> None:
    """End the process of a job, and wait until it is gone."""
    job.process.kill()
    job.listener.join()


def _start(folder: str) -> subprocess.Popen[bytes]:
    """Start a Python with the caller's packages, one thread, its temporary files in a folder, and out of reach of Ctrl-C."""
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    packages = os.pathsep.join(path for path in sys.path if path)
    environment = {**os.environ, **threads, "PYTHONPATH": packages, "PYTHONSAFEPATH": "1", "TMPDIR": folder}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    return subprocess.Popen([sys.executable, "-c", _CHILD], env=environment, start_new_session=True, **pipes)


def _listen(job: _Job, work: bytes, news: queue.Queue[tuple[_Job, str, Any]]) -> None:
    """Hand a process its work, and pass on what it sends until it ends."""
    with job.process as process:
        try:
            process.stdin.write(work)
            process.stdin.flush()  # and stays open: its end tells the process that the caller has ended
            while True:
                news.put((job, *pickle.load(process.stdout)))
        except (EOFError, OSError, pickle.UnpicklingError):
            code = process.wait()
            fate = f"ended with exit code {code}"
            if code < 0:
                fate = f"ended by signal {-code}: a crash, or out of memory"
            news.put((job, "failure", fate))


def _next(running: list[_Job], news: queue.Queue[tuple[_Job, str, Any]], time_limit: float) -> tuple[_Job, str, Any]:
    """Return what comes next from a process, or the failure of the first one that is overdue."""
    overdue = min(running, key=lambda job: job.deadline)
    patience = None
    if math.isfinite(overdue.deadline):
        patience = max(0.0, overdue.deadline - time.monotonic())
    try:
        return news.get(timeout=patience)
    except queue.Empty:
        return overdue, "failure", f"stopped: no sign of life for {time_limit:g} s"


def perform() -> None:
    """Do the work that comes by standard input, and send what the function returns or raises: the child's part."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # PyBullet writes there

    def send(kind: str, value: Any) -> None:
        answers.write(pickle.dumps((kind, value)))
        answers.flush()

    function, item, reports = pickle.load(sys.stdin.buffer)
    threading.Thread(target=_end_with_caller, daemon=True).start()
    arguments = [item]
    if reports:
        arguments.append(lambda value: send("report", value))
    try:
        outcome = function(*arguments)
    except Exception as error:
        outcome = error
    send("outcome", outcome)


def _end_with_caller() -> None:
    """End this process when its caller has ended, in whatever way."""
    sys.stdin.buffer.read()
    os._exit(1)
