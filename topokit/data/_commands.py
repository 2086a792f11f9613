"""The commands `topokit generate`, `label` and `check`. What they need is imported when they run."""

import argparse
import json
import signal
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any


def add(commands: Any) -> None:
    """Add the sub-parsers."""
    output = argparse.ArgumentParser(add_help=False)
    output.add_argument("--quiet", action="store_true", help="no progress bar")
    workers = argparse.ArgumentParser(add_help=False)
    workers.add_argument("--workers", type=int, metavar="W", help="processes on this machine (default: one a core)")
    workers.add_argument("--scheduler", metavar="TCP", help="a Dask scheduler whose workers see the same folder")
    address, default = "localhost:8787", "serve Dask's dashboard (default localhost:8787)"
    workers.add_argument("--dashboard", nargs="?", const=address, metavar="ADDRESS", help=default)

    def command(name: str, run: Callable[[argparse.Namespace], int], what: str, *more: Any) -> Any:
        parser = commands.add_parser(name, help=what, parents=[*more, output])
        parser.set_defaults(run=run)
        return parser.add_argument

    option = command("generate", _generate, "make a dataset of many episodes; goes on where it stopped", workers)
    option("--out", type=Path, required=True, metavar="DIR", help="where to make it, or to go on with it")
    option("--episodes", type=int, required=True, metavar="N", help="how many; more than last time adds some")
    option("--seed", type=int, default=0, help="of the dataset (default 0)")
    option("--config", type=Path, metavar="FILE", help="a DatasetConfig, as JSON; the rest has its default")
    option("--time-limit", type=float, default=600.0, metavar="S", help="seconds of an episode's processor time (600)")
    option("--retry-failed", action="store_true", help="try failed episodes again")

    option = command("label", _label, "track the loops of every episode; goes on where it stopped", workers)
    option("dataset", type=Path, metavar="DIR")
    seen = "what the tracker sees: all vertices (default), what was recorded, or what its cameras saw"
    option("--observation", choices=("full", "observed", "camera"), default="full", help=seen)
    option("--points", type=int, metavar="M", help="with observed: a farthest-point sample of so many points")
    option("--name", help="of the labels (default: that of the observation)")

    option = command("check", _check, "verify a dataset: checksums, shapes, units, identities")
    option("dataset", metavar="DIR", help="a folder, or a URL that fsspec reads")


def _generate(options: argparse.Namespace) -> int:
    from topokit._config import load

    from . import DatasetConfig, generate_dataset

    config = load(DatasetConfig, options.config) if options.config else DatasetConfig()
    home = options.config.parent if options.config else Path()
    meshes = {name: replace(mesh, file=str(home / mesh.file)) for name, mesh in config.meshes.items()}
    config = replace(config, meshes=meshes)
    how = {"time_limit": options.time_limit, "retry_failed": options.retry_failed}
    return _report(options, generate_dataset, config, options.out, options.episodes, options.seed, **how)


def _label(options: argparse.Namespace) -> int:
    from . import label_dataset

    how = {"name": options.name, "n_points": options.points}
    return _report(options, label_dataset, options.dataset, options.observation, **how)


def _report(options: argparse.Namespace, make: Callable[..., Any], *what: Any, **how: Any) -> int:
    """Make what Ctrl-C may stop without loss, and say what there is then."""
    how |= {"scheduler": options.scheduler, "n_workers": options.workers, "dashboard": options.dashboard}
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)  # what was begun is put away, as at Ctrl-C
    try:
        group = make(*what, progress=not options.quiet, **how)
    finally:
        signal.signal(signal.SIGTERM, before)
    counts = Counter(record.status for record in group.records.values())
    answer = {"out": group.url, "episodes": len(group.records), **counts, "checksum": group.checksum()}
    if options.json:
        print(json.dumps(answer))
    else:
        print(f"{group.url}: " + ", ".join(f"{n} {status}" for status, n in sorted(counts.items())))
        print(f"checksum: {answer['checksum']}")
    return 0


def _check(options: argparse.Namespace) -> int:
    from . import check_dataset

    problems = check_dataset(options.dataset, progress=sys.stderr.isatty() and not options.quiet)
    if options.json:
        print(json.dumps({"dataset": options.dataset, "problems": [asdict(problem) for problem in problems]}))
    else:
        print(*problems, sep="\n", end="\n" if problems else "")
        print(f"{options.dataset}: " + (f"{len(problems)} problems" if problems else "all is well"))
    return 1 if problems else 0
