"""A process that has everything imported and gives every job a fresh copy of itself.

Idea: PyBullet repeats self-collision bit by bit in a fresh process only, and can crash or hang. Importing NumPy, PyBullet
and Zarr takes about as long as a short simulation; a fork of a process that has imported them and done nothing else is as
fresh and starts in milliseconds. The forge has one thread, so that forking is safe; it ends, and ends its child, when the
process that owns it goes away in whatever manner.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import resource
import select
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from typing import Any

__all__ = ["Forge"]

_MAIN = "import sys; from topokit.data._forge import serve; serve(*sys.argv[1:])"
_READY = "ready"
_PATIENCE = 10
_STARTS = 5
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class Forge:
    """Runs jobs, one after another, each in a fresh process.

    Parameters
    ----------
    function : str
        "module:name" of a function that takes a job and gives an answer, both what JSON can hold.
    needs : sequence of str
        Modules to import beforehand that the function's own module does not import at once.
    """

    def __init__(self, function: str, needs: Sequence[str] = ()) -> None:
        if not hasattr(os, "fork"):
            raise OSError("making a dataset needs a system whose processes can fork: Linux, macOS, or WSL on Windows")
        self._function, self._needs = function, needs
        self._server: subprocess.Popen[str] | None = None

    def run(self, job: dict[str, Any], time_limit: float) -> dict[str, Any]:
        """Return {"answer": ...}, or {"error": name, "message": ..., "errno": ...}; a crash is an error "crash".

        `time_limit` is in seconds of processor time: on a busy machine a job may take much longer. One that waits for ever
        is stopped after ten times as long.
        """
        if self._server is None or self._server.poll() is not None:
            self._start()
        assert self._server is not None
        assert self._server.stdin is not None
        assert self._server.stdout is not None
        try:
            print(json.dumps({"time_limit": time_limit, "job": job}), file=self._server.stdin, flush=True)
            line = self._server.stdout.readline()
        except BrokenPipeError:
            line = ""
        if not line:
            self.close()
            return {"error": "crash", "message": "the process that starts simulations has ended"}
        answer: dict[str, Any] = json.loads(line)
        return answer

    def close(self) -> None:
        """End the process, and what it runs."""
        if self._server is not None:
            self._server.kill()
            self._server.wait()
            for pipe in (self._server.stdin, self._server.stdout):
                if pipe is not None:
                    with contextlib.suppress(BrokenPipeError):
                        pipe.close()
            self._server = None

    def _start(self) -> None:
        """Start the process; once more when it was killed before it was ready, as by a system that is out of memory."""
        for _ in range(_STARTS):
            self.close()
            environment = {**os.environ, **dict.fromkeys(_THREADS, "1")}
            environment["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))  # the packages we have
            self._server = subprocess.Popen(
                [sys.executable, "-c", _MAIN, self._function, *self._needs],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                env=environment,
                start_new_session=True,  # Ctrl-C reaches the command alone, and that stops us
            )
            assert self._server.stdout is not None
            if self._server.stdout.readline().strip() == _READY:
                return
            if self._server.wait() >= 0:  # it ended by itself, and would again
                break
        self.close()
        raise RuntimeError("the process that starts simulations does not start; what it said is on standard error")


def serve(function: str, *needs: str) -> None:
    """What the forge does: read jobs from standard input, answer on standard output."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # PyBullet writes there
    module, _, name = function.partition(":")
    with _hush():
        for needed in needs:
            import_module(needed)
        work = getattr(import_module(module), name)
    with contextlib.suppress(BrokenPipeError):
        print(_READY, file=answers, flush=True)
    buffer = b""
    while True:
        while b"\n" not in buffer:
            more = os.read(0, 65536)
            if not more:
                return
            buffer += more
        line, _, buffer = buffer.partition(b"\n")
        answer = _fork(work, **json.loads(line))
        if answer is None:
            return
        with contextlib.suppress(BrokenPipeError):
            print(json.dumps(answer), file=answers, flush=True)


@contextlib.contextmanager
def _hush() -> Iterator[None]:
    """Keep PyBullet from telling when it was built."""
    errors = os.dup(2)
    os.dup2(1, 2)
    try:
        yield
    finally:
        os.dup2(errors, 2)
        os.close(errors)


def _fork(work: Callable[[dict[str, Any]], Any], job: dict[str, Any], time_limit: float) -> dict[str, Any] | None:
    """Do a job in a fork; None when nobody waits for it any more."""
    out, into = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(out)
        _do(work, job, into, math.ceil(time_limit))
    os.close(into)
    try:
        return _watch(child, out, time_limit)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
        with contextlib.suppress(ChildProcessError):
            os.waitpid(child, 0)
        os.close(out)


def _watch(child: int, out: int, time_limit: float) -> dict[str, Any] | None:
    said, patience = b"", _PATIENCE * time_limit
    end = time.monotonic() + patience
    while True:
        ready, _, _ = select.select([0, out], [], [], max(0.0, end - time.monotonic()))
        if not ready:
            return {"error": "crash", "message": f"stopped: it waited for {patience:g} s"}
        if 0 in ready:  # nobody sends a second job before the first is answered: this is the end of our owner
            return None
        more = os.read(out, 65536)
        if more:
            said += more
            continue
        _, status = os.waitpid(child, 0)
        if os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU:
            return {"error": "crash", "message": f"stopped after {time_limit:g} s of processor time"}
        if os.WIFSIGNALED(status):
            return {
                "error": "crash",
                "message": f"{signal.Signals(os.WTERMSIG(status)).name}: it crashed, or memory ran out",
            }
        if not said:
            return {"error": "crash", "message": f"it ended with exit code {os.WEXITSTATUS(status)}"}
        answer: dict[str, Any] = json.loads(said)
        return answer


def _do(work: Callable[[dict[str, Any]], Any], job: dict[str, Any], into: int, seconds: int) -> None:
    """What the fork does; it ends here."""
    os.close(0)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    try:
        answer: dict[str, Any] = {"answer": work(job)}
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        message = f"{error} ({os.path.basename(place.filename)}, line {place.lineno})"
        answer = {"error": type(error).__name__, "message": message, "errno": getattr(error, "errno", None)}
    content = json.dumps(answer).encode()
    while content:
        content = content[os.write(into, content) :]
    os._exit(0)
