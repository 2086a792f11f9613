"""The commands `topokit evaluate` and `report`. What they need is imported when they run."""

import argparse
import json
from pathlib import Path
from typing import Any


def add(commands: Any) -> None:
    evaluate = commands.add_parser("evaluate", help="measure predictors on held-out episodes; goes on where it stopped")
    option = evaluate.add_argument
    option("evaluation", type=Path, metavar="EVALUATION", help="datasets, checkpoints and conditions (.json)")
    option("--out", type=Path, required=True, metavar="RESULTS", help="results, written after each condition (.json)")
    option("--clips", type=Path, metavar="DIR", help="also save the frames of a few failures, to be looked at (.npz)")
    option("--threads", type=int, default=2, help="processor cores to use at most (default 2)")
    option("--quiet", action="store_true", help="no progress")
    evaluate.set_defaults(run=_evaluate)

    report = commands.add_parser("report", help="make tables and figures of the results of an evaluation")
    report.add_argument("results", type=Path, metavar="RESULTS", help="what topokit evaluate wrote (.json)")
    report.add_argument("--out", type=Path, required=True, metavar="DIR", help="for tables (.md) and figures (.svg)")
    report.set_defaults(run=_report)


def _evaluate(options: argparse.Namespace) -> int:
    if options.threads < 1:
        raise ValueError(f"--threads {options.threads}: one at least")
    import torch

    from . import evaluate_forecasts, load_evaluation
    from ._results import table_of

    config, folder = load_evaluation(options.evaluation)
    torch.set_num_threads(min(options.threads, torch.get_num_threads()))
    command = f"topokit evaluate {options.evaluation} --out {options.out}"
    command += f" --clips {options.clips}" if options.clips else ""
    loud = not (options.quiet or options.json)
    try:
        given = {"progress": loud, "command": command, "clips": options.clips}
        results = evaluate_forecasts(config, folder, options.out, **given)
    except (KeyboardInterrupt, SystemError) as error:
        if not _interrupted(error):
            raise
        words = f"stopped; {options.out} has what was done, the same command goes on"
        raise KeyboardInterrupt(words) from None
    if options.json:
        print(json.dumps({"results": str(options.out), "hull_accuracy": results["hull_accuracy"]}))
        return 0
    for name, condition in results["conditions"].items():
        print(f"\n{name}\n\n{table_of(condition['hull_accuracy'], results['horizons'])}")
    print(f"results: {options.out}")
    return 0


def _interrupted(error: BaseException | None) -> bool:
    """Whether Ctrl-C is behind it: compiled code turns an interrupt into a SystemError with the interrupt as its cause."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _report(options: argparse.Namespace) -> int:
    from . import write_report

    files = write_report(options.results, options.out)
    print(json.dumps([str(path) for path in files]) if options.json else "\n".join(map(str, files)))
    return 0
