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
    heard = signal.getsignal(signal.SIGINT)  # a shell's background job ignores it
    if heard is signal.default_int_handler:
        signal.signal(signal.SIGINT, _leave)
    from .cli import main, parser

    parser()
    signal.signal(signal.SIGINT, heard)
    try:
        return main()
    except KeyboardInterrupt:
        print("topokit: stopped", file=sys.stderr)
        return 130


def _end(number: int, frame: FrameType | None) -> None:
    print(f"topokit: stopped by {signal.Signals(number).name}", file=sys.stderr)
    raise SystemExit(128 + number)  # on its way out everything is closed


def _leave(number: int, frame: FrameType | None) -> None:
    """At once: modules that are being imported make something else of an exception."""
    os.write(2, b"topokit: stopped\n")
    os._exit(128 + number)


if __name__ == "__main__":
    sys.exit(run())
