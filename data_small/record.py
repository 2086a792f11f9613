"""Record the three episodes of this folder again: python data_small/record.py

What lies here was made by these commands, with the version of topokit that each file names in its provenance; a later version
may move a vertex by some tenths of a millimetre. The labels are by an earlier default tracker, with a memory of 20 frames; the
present one finds other loops in about one frame of a hundred. `dataset`, `motion` and `forecast` are some of the episodes of
larger datasets, with their labels. Their folders were made by copying `dataset.json` and `labels.json`, with the list `numbers`
of the episodes added to the first, and the files of these numbers:

    topokit generate --config data_small/dataset.json --episodes 2000 --seed 0 --out runs/dataset
    topokit generate --config book/datasets/motion.json --episodes 4000 --seed 20 --out runs/motion
    python book/experiments/forecast_benchmark.py films --films runs/forecast

The labels of `forecast` are by the default tracker of version 0.4.
"""

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent


def main() -> None:
    """Record every episode."""
    for seed in range(3):
        command = ["topokit", "simulate", "--seed", str(seed), "--out", str(HERE / f"apron_hook_{seed}.npz")]
        subprocess.run([sys.executable, "-m", *command], check=True)


if __name__ == "__main__":
    main()
