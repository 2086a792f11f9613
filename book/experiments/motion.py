"""Measure every model on films that none has seen: book/results/motion.json.

    python book/experiments/motion.py

The conditions and checkpoints are in motion.json beside this file, and so are the commands that make films and checkpoints.
Takes some hours on two cores.
"""

from topokit.evaluate import evaluate_forecasts, load_evaluation

NAME = "motion"

if __name__ == "__main__":
    config, folder = load_evaluation(f"book/experiments/{NAME}.json")
    out = f"book/results/{NAME}.json"
    evaluate_forecasts(config, folder, out, progress=True, command=f"python book/experiments/{NAME}.py")
