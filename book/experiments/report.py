"""Make tables (.md) and figures (.svg) of a record of forecasts, without running anything.

    python book/experiments/report.py book/results/motion.json --out book/report

Takes seconds on any machine; `make book` runs it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from topokit.evaluate import write_report


def main() -> None:
    """Read a record and write its tables and figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path, help="a record of forecasts (.json)")
    parser.add_argument("--out", type=Path, required=True, help="folder for tables and figures")
    options = parser.parse_args()
    for path in write_report(options.results, options.out):
        print(path)


if __name__ == "__main__":
    main()
