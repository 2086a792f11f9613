"""Jobs for fresh processes. This module imports nothing that takes long: each process imports it anew."""

from __future__ import annotations

import os
import signal
import tempfile
import time
from pathlib import Path


def divide(number: int) -> tuple[float, int]:
    return 6 / number, os.getpid()


def crash_until_third(path: str) -> str:
    """Crash twice, as PyBullet can."""
    with open(path, "a") as log:
        log.write("x")
    if os.path.getsize(path) < 3:
        os.kill(os.getpid(), signal.SIGSEGV)
    return "done"


def do(what: str) -> str:
    if what == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    if what == "leave":
        os._exit(3)
    if what == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    while what == "hang":
        pass
    return what


def temporary(_: int) -> str:
    return tempfile.gettempdir()


def wait(path: str) -> None:
    """Tell which process this is, and do not end."""
    Path(path).with_suffix(".new").write_text(f"{os.getppid()} {os.getpid()}")
    Path(path).with_suffix(".new").rename(path)
    time.sleep(60)
