"""Progress of long work: one line on the terminal that is written over."""

import sys


def show_progress(line: str, *, ends: bool = False) -> None:
    """Write a line in place of the last one, where stderr is a terminal; the last line `ends` the work."""
    if sys.stderr.isatty():
        print(f"\r{line}", end="\n" * ends, file=sys.stderr, flush=True)
