"""The choice between plain Python and the compiled engine.

Idea: numba takes some ten seconds to compile the engine, once for each version of it. So another process compiles it into the
user's cache, and clouds are computed in plain Python until it is there. Only clouds that would take longer than that wait.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import threading
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np


class _Engine:
    """Hold what this process knows of its engine."""

    work = 0.0  # seconds that its clouds would take in plain Python
    preparation: threading.Thread | None = None
    ready = False


def cache_folder() -> str:
    """Return the folder of the compiled code: the one that the user names, or one of the user's cache for these sources.

    Numba compares one source file with its cache, and the engine has several; so the folder is named by all of `rips`.
    """
    caches = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    sources = sorted(Path(__file__).parent.rglob("*.py"))
    digest = hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()
    return os.environ.get("NUMBA_CACHE_DIR", str(caches / "topokit" / digest[:12]))


def engine_is_ready() -> bool:
    """Return True if the engine is compiled and loaded."""
    return _Engine.ready


def ask_for_engine(sizes: list[int]) -> None:
    """Prepare the engine when clouds of these sizes make it worth while, and wait for it when that is sooner."""
    if _Engine.ready:
        return
    work = sum(n * n / 2 * (0.6e-6 + 0.4e-9 * n) for n in sizes)
    _Engine.work += work
    if _Engine.preparation is None:
        if _Engine.work < 0.3 or find_spec("numba") is None:
            return
        _Engine.preparation = threading.Thread(target=_prepare)
        _Engine.preparation.start()
    if work > (0.5 if _is_compiled() else 10):
        _Engine.preparation.join()


def _is_compiled() -> bool:
    """Return True if the cache has the engine for this Python."""
    version = f"py{sys.version_info.major}{sys.version_info.minor}"
    return any(Path(cache_folder()).rglob(f"pairing.*{version}*.nbi"))


def _prepare() -> None:
    """Load the engine; let another process compile it first when it is not in the cache."""
    if not _is_compiled():
        print("topokit: compiling its engine in the background, once (some 10 s)", file=sys.stderr)
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "PYTHONSAFEPATH": "1"}
        command = [sys.executable, "-m", "topokit.rips.engine"]
        nothing = subprocess.DEVNULL
        child = subprocess.Popen(
            command, env=environment, stdin=nothing, stdout=nothing, stderr=nothing, start_new_session=True
        )
        while child.poll() is None:
            if not threading.main_thread().is_alive():  # the child goes on, for the next process
                return
            time.sleep(0.05)

    from .engine.pairing import pair_edges  # numba is imported here

    pair_edges(np.zeros((4, 3)), 0.0, np.zeros(1, np.int64))
    _Engine.ready = True
