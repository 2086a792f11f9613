"""Make the files of many episodes, each in a fresh process of this machine.

Idea: a job writes the same bytes whenever it is done, and it writes a file whole or not at all. So a run that was stopped goes on
with the files that are missing.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from topokit._cores import n_cores
from topokit._processes import ProcessError, in_fresh_processes

from ._folder import failure_path, remove_parts, write_json


def make_files(
    folder: Path,
    numbers: Sequence[int],
    job: Callable[[int], str],
    describe: Callable[[int], dict[str, Any]],
    n_workers: int | None,
    time_limit: float,
    progress: bool,
) -> None:
    """Do a job for every number; one whose process fails three times is recorded, as what `describe` returns.

    A job writes the file of an episode and returns its status. An error that it raises stops the command.
    """
    from tqdm import tqdm

    counts: Counter[str] = Counter()
    workers = n_cores() if n_workers is None else n_workers
    outcomes = in_fresh_processes(job, numbers, n_workers=workers, time_limit=time_limit, tries=3)
    bar = tqdm(outcomes, total=len(numbers), unit="episode", disable=not progress, file=sys.stderr)
    try:
        for number, outcome in bar:
            if isinstance(outcome, ProcessError):
                reason = f"after 3 tries: {outcome}"
                write_json(failure_path(folder, number), {**describe(number), "status": "failed", "reason": reason})
                outcome = "failed"
            elif isinstance(outcome, BaseException):
                raise outcome
            counts[outcome] += 1
            bar.set_postfix({status: n for status, n in counts.items() if status != "ok"}, refresh=False)
    except KeyboardInterrupt:
        done = f"{counts.total()} of {len(numbers)} are done and stored in {folder}"
        raise KeyboardInterrupt(f"stopped: {done}; the same command goes on") from None
    finally:
        outcomes.close()
        remove_parts(folder)
