"""Progress of long work: on a terminal one line that is written over, elsewhere a line now and then."""

from __future__ import annotations

import sys
import time

_PAUSE = 20.0  # seconds between two lines where they cannot be written over


class Progress:
    """Write to stderr how many of the frames are done.

    Parameters
    ----------
    what : str
        The work, such as "simulating".
    most : str
        The number of frames, in words: "of 96".
    """

    def __init__(self, what: str, most: str) -> None:
        self._what = what
        self._most = most
        self._last = time.monotonic()

    def __call__(self, frame: int, ends: bool = False) -> None:
        """Write the number of frames that are done; 0 or less while the work begins."""
        done = "it begins" if frame < 1 else f"frame {frame} {self._most}"
        line = f"{self._what}: {done}"
        if sys.stderr.isatty():
            print(f"\r{line}", end="\n" * ends, file=sys.stderr, flush=True)
        elif time.monotonic() - self._last > _PAUSE:
            self._last = time.monotonic()
            print(line, file=sys.stderr, flush=True)
