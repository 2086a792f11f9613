"""The commands `topokit generate`, `label` and `check`. What they need is imported when they run."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

__all__ = ["add"]


def add(commands: Any) -> None:
    """Add the sub-parsers."""
    generate = commands.add_parser(
        "generate", help="make a dataset of many episodes, in parallel; goes on where it stopped"
    )
    generate.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="where to make it, or to go on with it"
    )
    generate.add_argument(
        "--episodes", type=int, required=True, metavar="N", help="how many; more than last time adds some"
    )
    generate.add_argument("--seed", type=int, default=0, help="of the dataset (default 0)")
    generate.add_argument(
        "--config",
        type=Path,
        metavar="JSON",
        help="a DatasetConfig; what it leaves out has its default (default: all tasks)",
    )
    generate.add_argument(
        "--tasks", metavar="A,B=2", help="tasks, with weights if they differ (default: all, as in --config)"
    )
    generate.add_argument("--observed", type=int, metavar="M", help="points of an observation (default 512)")
    generate.add_argument(
        "--cameras", type=int, metavar="K", help="observe with K depth cameras (default 0: all sides)"
    )
    generate.add_argument(
        "--time-limit",
        type=float,
        default=600.0,
        metavar="S",
        help="stop an episode after so many seconds of processor time (default 600)",
    )
    generate.add_argument("--retry-failed", action="store_true", help="try failed episodes again")
    generate.set_defaults(run=_generate)

    label = commands.add_parser("label", help="track the loops of every episode of a dataset; goes on where it stopped")
    label.add_argument("dataset", type=Path, metavar="DIR")
    label.add_argument(
        "--observation",
        choices=("full", "observed", "camera"),
        default="full",
        help="what the tracker sees: all vertices (default), what was recorded, or what its cameras saw",
    )
    label.add_argument(
        "--points", type=int, metavar="M", help="with observed: a farthest-point sample of so many points"
    )
    label.add_argument("--name", help="of the labels (default: that of the observation)")
    label.add_argument("--slots", type=int, default=8, help="loops kept in a frame, longest lifetime first (default 8)")
    label.add_argument("--identity", choices=("killer-edge", "killer-triangles", "cycle"), default="killer-triangles")
    label.add_argument("--gates", choices=("paper", "proved"), default="proved")
    label.add_argument(
        "--memory", type=int, default=8, metavar="FRAMES", help="how long a missed loop is remembered (default 8)"
    )
    label.set_defaults(run=_label)

    for parser in (generate, label):
        parser.add_argument("--workers", type=int, metavar="W", help="processes on this machine (default: one a core)")
        parser.add_argument("--scheduler", metavar="TCP", help="a Dask scheduler whose workers see the same folder")
        parser.add_argument(
            "--dashboard",
            nargs="?",
            const="localhost:8787",
            metavar="ADDRESS",
            help="serve Dask's dashboard (default localhost:8787)",
        )
        parser.add_argument("--quiet", action="store_true", help="no progress bar")
        parser.add_argument("--json", action="store_true", help="print the answer as JSON")
        parser.set_defaults(run=functools.partial(_or_stopped, parser.get_default("run")))

    check = commands.add_parser("check", help="verify a dataset: checksums, shapes, units, identities")
    check.add_argument("dataset", metavar="DIR", help="a folder, or a URL that fsspec reads")
    check.add_argument("--quiet", action="store_true", help="no progress bar")
    check.add_argument("--json", action="store_true", help="print the answer as JSON")
    check.set_defaults(run=_check)


def _or_stopped(command: Callable[[argparse.Namespace], int], options: argparse.Namespace) -> int:
    """Run a command that Ctrl-C may stop without loss."""
    from . import Interrupted

    try:
        return command(options)
    except Interrupted as stopped:
        print(f"topokit {options.command}: {stopped}", file=sys.stderr)
        return 130


def _generate(options: argparse.Namespace) -> int:
    from . import DatasetConfig, generate

    try:
        values: dict[str, Any] = json.loads(options.config.read_text()) if options.config else {}
    except ValueError as error:
        raise ValueError(f"--config {options.config}: not JSON: {error}") from error
    if options.tasks:
        values["tasks"] = _weights(options.tasks)
    given = {"n_observed": options.observed, "cameras": options.cameras}
    values |= {name: value for name, value in given.items() if value is not None}
    group = generate(
        DatasetConfig.from_json(values),
        options.out,
        options.episodes,
        options.seed,
        time_limit=options.time_limit,
        retry_failed=options.retry_failed,
        **_cluster(options),
    )
    _report(options, group, str(options.out))
    return 0


def _label(options: argparse.Namespace) -> int:
    from . import label

    tracker = {name: getattr(options, name) for name in ("identity", "gates", "memory")}
    group = label(
        options.dataset,
        options.observation,
        name=options.name,
        n_points=options.points,
        slots=options.slots,
        options=tracker,
        **_cluster(options),
    )
    _report(options, group, group.url)
    return 0


def _check(options: argparse.Namespace) -> int:
    from . import check

    problems = check(options.dataset, progress=sys.stderr.isatty() and not options.quiet)
    if options.json:
        print(
            json.dumps({"dataset": options.dataset, "problems": [dataclasses.asdict(problem) for problem in problems]})
        )
    else:
        for problem in problems:
            print(problem)
        print(f"{options.dataset}: " + (f"{len(problems)} problems" if problems else "all is well"))
    return 1 if problems else 0


def _report(options: argparse.Namespace, group: Any, where: str) -> None:
    from ._records import total

    counts: dict[str, int] = {}
    for record in group.records.values():
        counts[record.status] = counts.get(record.status, 0) + 1
    answer = {"out": where, "episodes": len(group.records), **counts, "checksum": total(group.manifest, group.records)}
    if options.json:
        print(json.dumps(answer))
    else:
        print(f"{where}: " + ", ".join(f"{n} {status}" for status, n in sorted(counts.items())))
        print(f"checksum: {answer['checksum']}")


def _cluster(options: argparse.Namespace) -> dict[str, Any]:
    if options.workers is not None and options.workers < 1:
        raise ValueError(f"--workers {options.workers}: one at least")
    return {
        "scheduler": options.scheduler,
        "n_workers": options.workers,
        "dashboard": options.dashboard,
        "progress": not options.quiet,
    }


def _weights(text: str) -> dict[str, float]:
    weights = {}
    for part in text.split(","):
        name, _, weight = part.strip().partition("=")
        try:
            weights[name] = float(weight or 1)
        except ValueError as error:
            raise ValueError(f"--tasks {part}: a weight is a number") from error
    return weights
