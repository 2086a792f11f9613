"""Work in fresh processes of this machine, each of which may crash, hang or be stopped without harm to the others.

Idea: PyBullet repeats self-collision bit by bit in a fresh process only, can end its process, and can hang inside C. So each item
has a Python of its own, which gets its work by a pipe and sends back its outcome. A thread waits for each of them.
"""

from __future__ import annotations

import math
import os
import pickle
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from typing import Any


class ProcessError(RuntimeError):
    """A process that crashed, or was stopped because it took too long. The message says which."""


def in_fresh_processes(
    function: Callable[[Any], Any],
    items: Iterable[Any],
    *,
    n_workers: int = 1,
    time_limit: float = math.inf,
    tries: int = 1,
) -> Generator[tuple[Any, Any], None, None]:
    """Yield every item with what `function(item)` returned or raised, as they are done, each from a process of its own.

    Function, items and outcomes must be picklable. A process is stopped after `time_limit` seconds. An item whose process
    crashed or was stopped is tried again, `tries` times in all; then its outcome is a `ProcessError`. When the caller stops, all
    processes are stopped.
    """
    with tempfile.TemporaryDirectory(prefix="topokit-") as folder, ThreadPoolExecutor(n_workers) as pool:
        crew = _Crew(folder, None if math.isinf(time_limit) else time_limit, tries)
        try:
            futures = {pool.submit(crew.outcome, function, item): item for item in items}
            for future in as_completed(futures):
                yield futures[future], future.result()
        finally:
            crew.stop()
            pool.shutdown(cancel_futures=True)


@dataclass
class _Crew:
    """The processes that run now, and how they are started."""

    folder: str  # of their temporary files
    time_limit: float | None
    tries: int
    stopped: bool = False
    running: set[subprocess.Popen[bytes]] = field(default_factory=set)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def outcome(self, function: Callable[[Any], Any], item: Any) -> Any:
        """Return what a function returns or raises for an item in a fresh process, or a `ProcessError` after all tries."""
        work = pickle.dumps((os.getpid(), function, item))
        failures = []
        for _ in range(self.tries):
            process = self.start()
            try:
                sent, _ = process.communicate(work, timeout=self.time_limit)
                if process.returncode == 0:
                    return pickle.loads(sent)
                failures.append(f"exit code {process.returncode}")
                if process.returncode < 0:
                    failures[-1] = f"ended by signal {-process.returncode}: a crash, or out of memory"
            except subprocess.TimeoutExpired:
                failures.append(f"stopped after {self.time_limit:g} s")
                process.kill()
                process.communicate()
            finally:
                self.running.discard(process)
        return ProcessError("; ".join(dict.fromkeys(failures)))

    def start(self) -> subprocess.Popen[bytes]:
        """Start a Python with the caller's packages, one thread, and out of reach of Ctrl-C."""
        threads = dict.fromkeys(
            ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
        )
        packages = os.pathsep.join(path for path in sys.path if path)
        environment = {**os.environ, **threads, "PYTHONPATH": packages, "PYTHONSAFEPATH": "1", "TMPDIR": self.folder}
        command = [sys.executable, "-c", "from topokit._processes import perform; perform()"]
        with self.lock:
            if self.stopped:
                raise ProcessError("the caller has stopped")
            process = subprocess.Popen(
                command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
            )
            self.running.add(process)
        return process

    def stop(self) -> None:
        """End all processes, and start none any more."""
        with self.lock:
            self.stopped = True
            for process in list(self.running):
                process.kill()


def perform() -> None:
    """Do the work that comes by standard input, and send what the function returns or raises: the child's part."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # PyBullet writes there
    caller, function, item = pickle.load(sys.stdin.buffer)
    threading.Thread(target=_end_with, args=(caller,), daemon=True).start()
    try:
        outcome = function(item)
    except Exception as error:
        outcome = error
    answers.write(pickle.dumps(outcome))
    answers.flush()


def _end_with(caller: int) -> None:
    """End this process when its caller has ended, in whatever way."""
    while os.getppid() == caller:
        time.sleep(0.5)
    os._exit(1)
