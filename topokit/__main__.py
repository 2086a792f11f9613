"""`python -m topokit` is the `topokit` command. A signal ends it in order: one line, and no temporary file is left."""

import io
import os
import signal
import sys
import threading
from types import FrameType
from typing import Any

_SIGNALS = (signal.SIGINT, signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM))  # Windows has two of them
_arrived: list[int] = []


def run() -> int:
    """Run the command; return its exit code, which is 128 and the number of the signal that stopped it."""
    for number in _SIGNALS:
        # What is ignored stays so: SIGHUP under nohup, SIGINT in a shell's background job.
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, _stop)
    sys.unraisablehook = _repeat
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a name may hold what the terminal cannot show
    try:
        from .cli import main

        code = main()
    except KeyboardInterrupt:
        print("topokit: stopped", file=sys.stderr)
        code = 130
    for number in _SIGNALS:
        if signal.getsignal(number) is _stop:
            signal.signal(number, _let_it_end)
    if hasattr(signal, "SIGCHLD"):
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # PyTorch's raises when one of its processes ends
    return 128 + _arrived[0] if _arrived and code else code


def _stop(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, but leave at once while a module is imported: imports may turn it into another error."""
    _arrived.append(number)
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            archive = sys.modules.get("topokit._archive")
            if archive is not None and hasattr(archive, "remove_unfinished"):  # it may be half imported itself
                archive.remove_unfinished()
            os.write(2, b"topokit: stopped\n")
            os._exit(128 + number)
        frame = frame.f_back
    raise KeyboardInterrupt


def _repeat(lost: Any) -> None:
    """Send a signal again that was raised where no error can be, as in a `__del__`; any other error there is shown.

    But what ends because of a signal may complain of what else was ended.
    """
    if not _arrived:
        sys.__unraisablehook__(lost)
    elif issubclass(lost.exc_type, KeyboardInterrupt):
        threading.Timer(0.01, os.kill, [os.getpid(), _arrived[-1]]).start()


def _let_it_end(number: int, frame: FrameType | None) -> None:
    """Let a command end that has done its work; a second signal kills it."""
    signal.signal(number, signal.SIG_DFL)


if __name__ == "__main__":
    sys.exit(run())
