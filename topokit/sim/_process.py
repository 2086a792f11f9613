"""Jobs in fresh processes, which can be stopped.

Idea: PyBullet repeats self-collision bit by bit in a fresh process only, can end its process, and can hang inside C. A fork
of a process that has imported NumPy, PyBullet and Zarr and done nothing else is as fresh and starts in milliseconds. That
process, the forge, has one thread, so that forking is safe; it ends, and ends its fork, when its owner goes away.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import queue
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import IO, Any

_MAIN = (  # what lies in the working directory, '' on the path, is not imported
    "import sys; sys.path[:] = filter(None, sys.path); from topokit.sim._process import serve; serve(*sys.argv[1:])"
)
_READY = "ready\n"
_STARTS = 5
_PATIENCE = 10  # times the limit of processor time
_ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
Answer = dict[str, Any]


class SimulationError(RuntimeError):
    """A run that failed: cloth that exploded or was stretched too far, a simulator that crashed or does not get on."""


class Forge:
    """Runs jobs, one after another, each in a fresh process, by "module:name" of a function from JSON to JSON.

    `needs` are modules to import beforehand; `once` is for one job only, which needs no fork.
    """

    def __init__(self, function: str, needs: Sequence[str] = (), *, once: bool = False) -> None:
        if not once and not hasattr(os, "fork"):
            raise OSError("making a dataset needs a system whose processes can fork: Linux, macOS, or WSL on Windows")
        self._arguments = [function, *needs]
        self._process: subprocess.Popen[str] | None = None

    def run(
        self,
        job: dict[str, Any],
        time_limit: float,
        *,
        silence: float | None = None,
        report: Callable[[int], None] | None = None,
    ) -> Answer:
        """Return {"answer": ...}, or {"error": name, "message": ..., "errno": ...}; a crash is an error "crash".

        A job is stopped after `time_limit` seconds of processor time, and after `silence` seconds without a sign of life
        (when not given, ten times `time_limit`, and the forge may take any time to start). The numbers that the function
        reports, by a second argument that it then gets, go to `report`.
        """
        call = {"job": job, "time_limit": time_limit, "reports": report is not None}
        try:
            process = self._started(math.inf if silence is None else silence)
            silence = _PATIENCE * time_limit if silence is None else silence
            # A child that hangs does not read, and would keep us from counting its silence.
            threading.Thread(target=_send, args=(process.stdin, json.dumps(call)), daemon=True).start()
            while line := self._line(silence):
                told: Answer = json.loads(line)
                if "report" not in told:
                    return told
                if report is not None:
                    report(told["report"])
            message = self._last_words(process)
        except queue.Empty:
            message = f"stopped: no sign of life for {silence:g} s; PyBullet hangs, or the machine is very busy"
        except BaseException:  # Ctrl-C, too
            self.close()
            raise
        self.close()
        return {"error": "crash", "message": message}

    def close(self) -> None:
        """End the forge, and what it runs."""
        if self._process is None:
            return
        if os.name == "posix":
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)  # its fork, too
        self._process.kill()
        self._process.wait()
        if self._process.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self._process.stdin.close()
        self._errors.close()
        self._folder.cleanup()
        self._process = None

    def _started(self, silence: float) -> subprocess.Popen[str]:
        """The forge; it is started once more when it was killed before it was ready, as where memory runs out."""
        if self._process is not None and self._process.poll() is None:
            return self._process
        path = [*sys.path, str(Path(__file__).parents[2])]  # the packages we have
        environment = {**os.environ, **dict.fromkeys(_THREADS, "1"), "PYTHONPATH": os.pathsep.join(filter(None, path))}
        for _ in range(_STARTS):
            self.close()
            with _signals_wait():
                self._errors = tempfile.TemporaryFile("a+", errors="replace")  # noqa: SIM115 (closed by close)
                self._folder = tempfile.TemporaryDirectory(prefix="topokit-", ignore_cleanup_errors=True)
                self._process = process = subprocess.Popen(
                    [sys.executable, "-c", _MAIN, self._folder.name, *self._arguments],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=self._errors,
                    text=True,
                    env=environment,
                    start_new_session=True,  # Ctrl-C reaches us alone, and we stop it
                )
                self._lines: queue.Queue[str] = queue.Queue()
                threading.Thread(target=_read, args=(process.stdout, self._lines), daemon=True).start()
            while line := self._line(silence):
                if line == _READY:
                    return process
            if process.wait() >= 0:  # it ended by itself, and would again
                break
        raise SimulationError(f"the process that starts simulations does not start: {self._last_words(process)}")

    def _line(self, silence: float) -> str:
        return self._lines.get(timeout=None if math.isinf(silence) else silence)

    def _last_words(self, process: subprocess.Popen[str]) -> str:
        self._errors.seek(0)
        return _fate(process.wait(), self._errors.read())


@contextlib.contextmanager
def _signals_wait() -> Iterator[None]:
    """Signals that have a handler come afterwards: what ends us while a process starts would leave it running."""
    came: list[int] = []
    ours: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        ours = {number: signal.getsignal(number) for number in _ENDING}
        ours = {number: handler for number, handler in ours.items() if callable(handler)}
    for number in ours:
        signal.signal(number, lambda number, _: came.append(number))
    try:
        yield
    finally:
        for number, handler in ours.items():
            signal.signal(number, handler)
        for number in came:
            signal.raise_signal(number)


@contextlib.contextmanager
def for_us_alone(number: signal.Signals) -> Iterator[None]:
    """A signal that comes to us afterwards and to no process begun here: Dask may wait for a worker that died of Ctrl-C."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {number})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _read(stream: IO[str], lines: queue.Queue[str]) -> None:
    with stream:
        for line in stream:
            lines.put(line)
    lines.put("")


def _send(stream: IO[str], line: str) -> None:
    with contextlib.suppress(BrokenPipeError, ValueError):  # its reader is gone; or the forge was closed meanwhile
        print(line, file=stream, flush=True)


def _fate(code: int, errors: str) -> str:
    if code < 0:
        return f"{signal.Signals(-code).name}: a crash inside PyBullet, or out of memory"
    return f"exit code {code}" + "".join(f": {line}" for line in errors.strip().splitlines()[-1:])


def serve(folder: str, function: str, *needs: str) -> None:
    """What the forge does: read jobs from standard input, answer where standard output was; temporary files in a folder."""
    tempfile.tempdir = folder
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # PyBullet writes there
    for needed in needs:
        import_module(needed)
    module, _, name = function.partition(":")
    work = getattr(import_module(module), name)
    print(_READY, end="", file=answers, flush=True)
    try:
        for line in iter(sys.stdin.buffer.readline, b""):
            (_fork if hasattr(os, "fork") else _perform)(work, json.loads(line), answers)
    finally:  # our owner is gone, and could not
        shutil.rmtree(folder, ignore_errors=True)


def _fork(work: Callable[..., Any], call: dict[str, Any], answers: IO[str]) -> None:
    """Do a job in a fork, and end it when our owner is gone; say how it ended when it gave no answer."""
    import resource  # there is none on Windows

    alive, held = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(0)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # no file of the memory at a crash
        if math.isfinite(call["time_limit"]):
            resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(call["time_limit"]), math.ceil(call["time_limit"]) + 1))
        _perform(work, call, answers)
        os._exit(0)
    os.close(held)
    ended, _, _ = select.select([0, alive], [], [])
    jobs: Any = sys.stdin.buffer
    answered = 0 in ended and bool(jobs.peek(1))  # nobody sends another job before this one is answered
    if 0 in ended and not answered:
        os.kill(child, signal.SIGKILL)
    os.close(alive)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if answered or not code:
        return
    fate = f"stopped after {call['time_limit']:g} s of processor time"
    if code != -signal.SIGXCPU:
        fate = _fate(code, os.pread(2, os.fstat(2).st_size, 0).decode(errors="replace"))
    print(json.dumps({"error": "crash", "message": fate}), file=answers, flush=True)


def _perform(work: Callable[..., Any], call: dict[str, Any], answers: IO[str]) -> None:
    def tell(told: Answer) -> None:
        print(json.dumps(told), file=answers, flush=True)

    reports = [lambda number: tell({"report": number})] if call["reports"] else []
    try:
        tell({"answer": work(call["job"], *reports)})
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        message = f"{str(error) or type(error).__name__} ({os.path.basename(place.filename)}, line {place.lineno})"
        tell({"error": type(error).__name__, "message": message, "errno": getattr(error, "errno", None)})
