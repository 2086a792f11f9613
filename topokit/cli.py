"""The `topokit` command. Exit code 0 when all is well, 1 when the work failed, 2 when the input or the call is wrong."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from . import __version__

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command with `arguments` (those of the process when None) and return its exit code."""
    options = _parser().parse_args(arguments)
    try:
        code: int = options.run(options)
        return code
    except (ValueError, OSError, ImportError) as error:  # any other is a mistake of ours, and shows where
        print(f"topokit {options.command}: error: {error}", file=sys.stderr)
        return 2
    except RuntimeError as error:  # the input was right, the work failed: a simulation that exploded
        print(f"topokit {options.command}: failed: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"topokit {options.command}: stopped; nothing was written", file=sys.stderr)
        return 130


def _parser() -> argparse.ArgumentParser:
    from . import _commands
    from .data import _commands as data
    from .evaluate import _commands as evaluate
    from .models import _commands as models

    parser = argparse.ArgumentParser(prog="topokit", description="Sequential topology for deformable objects.")
    parser.add_argument("--version", action="version", version=f"topokit {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for part in (_commands, data, models, evaluate):
        part.add(commands)
    return parser


if __name__ == "__main__":
    sys.exit(main())
