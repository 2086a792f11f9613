"""Measure models that were trained without a family of garments on that family: book/results/unseen.json.

    python book/experiments/unseen.py

The conditions and checkpoints are in unseen.json beside this file, and so are the commands that make films and checkpoints.
Takes hours on two cores. `--only CONDITION` measures one condition and keeps the others of the record.
"""

from forecasts import run

if __name__ == "__main__":
    run("unseen", __doc__)
