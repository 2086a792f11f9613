"""Make a dataset under faults and compare it with one that was left in peace: nothing lost, nothing twice, the same bytes.

    python tests/soak_dataset.py --episodes 1000 --out soak.json

Faults, at random moments: a Dask worker, a simulation, or the process that starts simulations is killed (SIGKILL); the disk is
full; the command, and with it the scheduler, is killed or stopped by Ctrl-C, and given again. Then the same for its labels. The
full disk is the system call that makes written data durable, failing as it does on one. Exits with 1 when anything differs.
Ctrl-C prints what there is so far.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import psutil

from topokit.data import Dataset, check_dataset
from topokit.data._generate import PACKAGES
from topokit.data._group import versions_of

from small_datasets import TINY, command

SEED = 11
FULL = """
import errno, os, pathlib
_fsync, _full = os.fsync, pathlib.Path({full!r})
def fsync(handle):
    if _full.exists():
        raise OSError(errno.ENOSPC, "No space left on device")
    _fsync(handle)
os.fsync = fsync
"""
RESTARTS = ("command killed", "Ctrl-C", "disk full")  # after these the command is given again
FAULTS = {"worker killed": 4, "simulation killed": 4, "forge killed": 2, **dict.fromkeys(RESTARTS, 1)}


def processes(root: psutil.Process, kind: str) -> list[psutil.Process]:
    """Processes of a command by what they do."""
    found = []
    for process in root.children(recursive=True):
        with contextlib.suppress(psutil.Error):
            text, parent = " ".join(process.cmdline()), " ".join(process.parent().cmdline())
            is_forge = "_process import serve" in text
            kinds = {
                "worker killed": "spawn_main" in text and not is_forge,
                "forge killed": is_forge and "_process import serve" not in parent,
                "simulation killed": is_forge and "_process import serve" in parent,
            }
            if kinds[kind]:
                found.append(process)
    return found


def disturb(
    arguments: Sequence[str], site: Path, rng: random.Random, every: float, counts: collections.Counter[str]
) -> None:
    """Give a command until it ends well, with faults on the way."""
    full, faults = site / "full", list(FAULTS)
    while True:
        full.unlink(missing_ok=True)
        process = command(*arguments, site=site)
        counts["started"] += 1
        wait = time.monotonic() + rng.expovariate(1 / every) + 4  # it takes some seconds to start
        fault = ""
        while process.poll() is None and fault not in RESTARTS:
            time.sleep(0.05)
            if time.monotonic() < wait:
                continue
            wait = time.monotonic() + rng.expovariate(1 / every)
            fault = rng.choices(faults, list(FAULTS.values()))[0]
            if inflict(fault, process, full, rng):
                counts[fault] += 1
        family = psutil.Process(process.pid).children(recursive=True) if process.poll() is None else []
        _, said = process.communicate(timeout=120)
        _, alive = psutil.wait_procs(family, timeout=60)
        if alive:
            raise SystemExit(f"after {fault}: {len(alive)} processes go on by themselves")
        expected = {"": 0, "command killed": -signal.SIGKILL, "Ctrl-C": 130, "disk full": 2}.get(fault, 0)
        if process.returncode == 0:
            return
        if process.returncode != expected:
            raise SystemExit(f"after {fault or 'nothing'}: exit code {process.returncode}, not {expected}: {said}")


def inflict(fault: str, process: subprocess.Popen[str], full: Path, rng: random.Random) -> bool:
    """Do it; False when there was nobody to do it to."""
    if fault == "disk full":
        full.touch()
        return True
    if fault == "Ctrl-C":
        os.killpg(process.pid, signal.SIGINT)
        return True
    if fault == "command killed":
        process.kill()
        return True
    victims = processes(psutil.Process(process.pid), fault)
    with contextlib.suppress(psutil.Error):
        if victims:
            rng.choice(victims).kill()
    return bool(victims)


def contents(folder: Path) -> Iterator[tuple[str, str]]:
    """Every file whose bytes count, with its checksum."""
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name not in (".lock", "timing.jsonl"):
            yield str(path.relative_to(folder)), hashlib.sha256(path.read_bytes()).hexdigest()


def soak(folder: Path, episodes: int, workers: int, every: float, seed: int) -> dict[str, object]:
    """Make both datasets and compare them."""
    (folder / "site").mkdir(parents=True, exist_ok=True)
    (folder / "site" / "sitecustomize.py").write_text(FULL.format(full=str(folder / "site" / "full")))
    config = folder / "config.json"
    config.write_text(json.dumps(TINY.to_json()))
    common = ["--workers", str(workers), "--quiet"]

    def commands(out: Path) -> list[list[str]]:
        made = [
            "generate",
            "--config",
            str(config),
            "--out",
            str(out),
            "--episodes",
            str(episodes),
            "--seed",
            str(SEED),
        ]
        return [[*made, *common], ["label", str(out), *common]]

    counts: collections.Counter[str] = collections.Counter()
    peace, war = folder / "peace", folder / "war"
    report: dict[str, object] = {"episodes": episodes, "workers": workers, "faults": counts}
    start = time.monotonic()
    try:
        for arguments in commands(peace):
            process = command(*arguments)
            _, said = process.communicate()
            if process.returncode:
                raise SystemExit(f"undisturbed: exit code {process.returncode}: {said}")
        report["minutes undisturbed"] = round((time.monotonic() - start) / 60, 2)
        start, rng = time.monotonic(), random.Random(seed)
        for arguments in commands(war):
            disturb(arguments, folder / "site", rng, every, counts)
        report["minutes disturbed"] = round((time.monotonic() - start) / 60, 2)
    except KeyboardInterrupt:
        return {**report, "stopped": True}
    one, other = dict(contents(peace)), dict(contents(war))
    records = [record.episode for record in Dataset(war).records]
    attempts = [json.loads(line)["attempts"] for line in (war / "timing.jsonl").read_text().splitlines()]
    return {
        **report,
        "retried in place": sum(attempt > 1 for attempt in attempts),
        "lost": len(set(range(episodes)) - set(records)),
        "twice": len(records) - len(set(records)),
        "failed": len(Dataset(war).failures) - len(Dataset(peace).failures),
        "files": len(one),
        "files that differ": sum(one.get(name) != other.get(name) for name in {*one, *other}),
        "problems": [str(problem) for problem in check_dataset(war)],
        "checksum": Dataset(war).checksum(),
        "checksum undisturbed": Dataset(peace).checksum(),
        "versions": versions_of(*PACKAGES),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--every", type=float, default=3.0, help="seconds between two faults, on average (default 3)")
    parser.add_argument("--seed", type=int, default=0, help="of the faults")
    parser.add_argument("--folder", type=Path, help="where to work (default: a temporary one)")
    parser.add_argument("--out", type=Path, help="where to write the report (.json)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary) / "soak"
        report = soak(folder, options.episodes, options.workers, options.every, options.seed)
    text = json.dumps(report, indent=1)
    print(text)
    if options.out:
        options.out.write_text(text + "\n")
    if "stopped" in report:
        return 130
    wrong = [report[name] for name in ("lost", "twice", "failed", "files that differ", "problems")]
    return int(any(wrong) or report["checksum"] != report["checksum undisturbed"])


if __name__ == "__main__":
    sys.exit(main())
