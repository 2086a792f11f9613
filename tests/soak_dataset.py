"""Make a dataset under faults and compare it with one that was left in peace: nothing lost, nothing twice, the same bytes.

    python tests/soak_dataset.py --episodes 1000 --out soak.json
    python tests/soak_dataset.py --episodes 40 --every 10 --cluster    on a scheduler and two workers, processes of their own
    python tests/soak_dataset.py --episodes 40 --remote s3://bucket/x  and at the end written there, and read from there

Faults, at random moments: a Dask worker, a simulation, or the process that starts simulations is killed (SIGKILL); the disk is
full; the clock is set back by a year, or right again; the command, and with it the scheduler, is killed or stopped by Ctrl-C or
SIGTERM, and given again. With --cluster its scheduler or a worker of it is killed, and another started. Then the same for its
labels. The full disk is the system call that makes written data durable, failing as it does on one. Exits with 1 when anything
differs. Ctrl-C prints what there is so far.
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
from topokit.data._group import versions_of

from topokit.data import Dataset, check_dataset
from topokit.data._generate import PACKAGES

from small_datasets import TINY, command

SEED = 11
FULL = """
import errno, os, pathlib, time
_time, _back = time.time, {back!r}
time.time = lambda: _time() - 31536000 * os.path.exists(_back)
_fsync, _full = os.fsync, pathlib.Path({full!r})
def fsync(handle):
    if _full.exists():
        raise OSError(errno.ENOSPC, "No space left on device")
    _fsync(handle)
os.fsync = fsync
"""
RESTARTS = (
    "command killed",
    "Ctrl-C",
    "SIGTERM",
    "disk full",
    "scheduler lost",
)  # after these the command is given again
COMMAND = dict.fromkeys(("command killed", "Ctrl-C", "SIGTERM", "clock set"), 1)
FAULTS = {"worker killed": 4, "simulation killed": 4, "forge killed": 2, "disk full": 1, **COMMAND}
CLUSTER_FAULTS = {"cluster worker lost": 3, "scheduler lost": 2, **COMMAND}


class Cluster:
    """A Dask scheduler and two workers, each a process of its own."""

    def __init__(self, port: int) -> None:
        self.address = f"tcp://127.0.0.1:{port}"
        worker = ["dask_worker", self.address, "--nthreads", "1", "--no-dashboard", "--death-timeout", "20"]
        scheduler = ["dask_scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
        self.roles = {"scheduler": scheduler, "worker 1": worker, "worker 2": worker}
        self.running: dict[str, subprocess.Popen[bytes]] = {}

    def keep(self) -> None:
        """Start what is not there, or no longer."""
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
        for role, (module, *arguments) in self.roles.items():
            if role not in self.running or self.running[role].poll() is not None:
                call = [sys.executable, "-m", f"distributed.cli.{module}", *arguments]
                quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
                self.running[role] = subprocess.Popen(call, env=environment, **quiet)  # type: ignore[call-overload]

    def lose(self, role: str) -> None:
        """Kill one, and what it started."""
        process = self.running.pop(role)
        family = [process, *psutil.Process(process.pid).children(recursive=True)]
        for one in family:
            with contextlib.suppress(psutil.Error):
                one.kill()
        process.wait()

    def close(self) -> None:
        for role in list(self.running):
            with contextlib.suppress(psutil.Error):
                self.lose(role)


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
    arguments: Sequence[str],
    site: Path,
    rng: random.Random,
    every: float,
    counts: collections.Counter[str],
    cluster: Cluster | None,
) -> None:
    """Give a command until it ends well, with faults on the way."""
    full, chances = site / "full", CLUSTER_FAULTS if cluster else FAULTS
    while True:
        full.unlink(missing_ok=True)
        if cluster:
            cluster.keep()
        process = command(*arguments, site=site)
        counts["started"] += 1
        wait = time.monotonic() + rng.expovariate(1 / every) + 4  # it takes some seconds to start
        fault = ""
        while process.poll() is None and fault not in RESTARTS:
            time.sleep(0.05)
            if time.monotonic() < wait:
                continue
            wait = time.monotonic() + rng.expovariate(1 / every)
            fault = rng.choices(list(chances), list(chances.values()))[0]
            if inflict(fault, process, full, rng, cluster):
                counts[fault] += 1
        family = psutil.Process(process.pid).children(recursive=True) if process.poll() is None else []
        _, said = process.communicate(timeout=120)
        _, alive = psutil.wait_procs(family, timeout=60)
        if alive:
            raise SystemExit(f"after {fault}: {len(alive)} processes go on by themselves")
        codes = {"command killed": -signal.SIGKILL, "Ctrl-C": 130, "SIGTERM": 130, "disk full": 2, "scheduler lost": 2}
        expected = codes.get(fault, 0)
        if process.returncode == 0:
            return
        if process.returncode != expected:
            raise SystemExit(f"after {fault or 'nothing'}: exit code {process.returncode}, not {expected}: {said}")


def inflict(
    fault: str, process: subprocess.Popen[str], full: Path, rng: random.Random, cluster: Cluster | None
) -> bool:
    """Do it; False when there was nobody to do it to."""
    if cluster and "lost" in fault:
        cluster.lose("scheduler" if fault == "scheduler lost" else rng.choice(("worker 1", "worker 2")))
        if fault != "scheduler lost":
            cluster.keep()
        return True
    if fault == "clock set":
        back = full.with_name("back")
        back.unlink() if back.exists() else back.touch()
        return True
    if fault == "SIGTERM":
        process.send_signal(signal.SIGTERM)
        return True
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


def soak(
    folder: Path, episodes: int, workers: int, every: float, seed: int, cluster: Cluster | None
) -> dict[str, object]:
    """Make both datasets and compare them."""
    (folder / "site").mkdir(parents=True, exist_ok=True)
    site = folder / "site"
    (folder / "site" / "sitecustomize.py").write_text(FULL.format(full=str(site / "full"), back=str(site / "back")))
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
            scheduler = ["--scheduler", cluster.address] if cluster else []
            disturb([*arguments, *scheduler], folder / "site", rng, every, counts, cluster)
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
    parser.add_argument(
        "--cluster", type=int, nargs="?", const=8799, metavar="PORT", help="with a scheduler at that port"
    )
    parser.add_argument("--remote", metavar="URL", help="an empty place that fsspec writes to")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary) / "soak"
        cluster = Cluster(options.cluster) if options.cluster else None
        try:
            report = soak(folder, options.episodes, options.workers, options.every, options.seed, cluster)
        finally:
            if cluster:
                cluster.close()
        if options.remote and "stopped" not in report:
            war = Dataset(folder / "war")
            far = war.cut(war.episodes, options.remote)
            report["remote problems"] = [str(problem) for problem in check_dataset(options.remote)]
            back = far.cut(far.episodes, folder / "back")
            report["differs remotely"] = back.checksum() != far.checksum() or len(back) != len(war)
    text = json.dumps(report, indent=1)
    print(text)
    if options.out:
        options.out.write_text(text + "\n")
    if "stopped" in report:
        return 130
    wrong = [report.get("remote problems"), report.get("differs remotely")]
    wrong += [report[name] for name in ("lost", "twice", "failed", "files that differ", "problems")]
    return int(any(wrong) or report["checksum"] != report["checksum undisturbed"])


if __name__ == "__main__":
    sys.exit(main())
