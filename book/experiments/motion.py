"""Measure every model on films that none was trained on: book/results/motion.json.

    python book/experiments/motion.py

The conditions and checkpoints are in motion.json beside this file, and so are the commands that make films and checkpoints.
Takes hours on two cores. `--only CONDITION` measures one condition and keeps the others of the record.
"""

from forecasts import run

if __name__ == "__main__":
    run("motion", __doc__)
