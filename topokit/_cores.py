"""The processes of this machine: how many cores they may run on, and where they may import from."""

import contextlib
import os
from collections.abc import Iterator


def n_cores() -> int:
    """Return the number of cores that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1  # macOS and Windows tell only those of the machine


@contextlib.contextmanager
def safe_path() -> Iterator[None]:
    """Keep processes that are started meanwhile from importing modules of the working directory."""
    before = os.environ.get("PYTHONSAFEPATH")  # Python 3.10 ignores it
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        del os.environ["PYTHONSAFEPATH"]
        if before is not None:
            os.environ["PYTHONSAFEPATH"] = before
