"""`python -m topokit` is the `topokit` command. A signal ends it in order: one line, and no temporary file is left."""

import os
import signal
import sys
from types import FrameType


def run() -> int:
    """Run the command; return its exit code."""
    for number in (signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)):  # Windows has one of them
        if signal.getsignal(number) is signal.SIG_DFL:  # nohup ignores the other
            signal.signal(number, _end)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # a shell's background job ignores it
        signal.signal(signal.SIGINT, _interrupt)
    try:
        from .cli import main

        return main()
    except KeyboardInterrupt:
        print("topokit: stopped", file=sys.stderr)
        return 130


def _end(number: int, frame: FrameType | None) -> None:
    print(f"topokit: stopped by {signal.Signals(number).name}", file=sys.stderr)
    raise SystemExit(128 + number)  # on its way out everything is closed


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, but leave at once while a module is imported: imports may turn it into another error."""
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            os.write(2, b"topokit: stopped\n")
            os._exit(128 + number)
        frame = frame.f_back
    raise KeyboardInterrupt


if __name__ == "__main__":
    sys.exit(run())
