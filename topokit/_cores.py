"""How many processor cores there are to run on."""

import os


def n_cores() -> int:
    """Cores that this process may run on; those of the machine where the system does not tell."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1  # macOS and Windows
