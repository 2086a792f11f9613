"""`python -m topokit` is the `topokit` command."""

import sys


def run() -> int:
    """Run the command; return its exit code."""
    from .cli import main

    return main()


if __name__ == "__main__":
    sys.exit(run())
