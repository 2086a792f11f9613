"""The processes of this machine: how many cores they may run on, and that they import nothing that merely lies around."""

import contextlib
import os
from collections.abc import Iterator


def n_cores() -> int:
    """Cores that this process may run on; those of the machine where the system does not tell."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1  # macOS and Windows


@contextlib.contextmanager
def safe_path() -> Iterator[None]:
    """Processes that Dask, PyTorch and multiprocessing start meanwhile import nothing from the working directory."""
    before = os.environ.get("PYTHONSAFEPATH")  # Python 3.10 does not know it
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        del os.environ["PYTHONSAFEPATH"]
        if before is not None:
            os.environ["PYTHONSAFEPATH"] = before
