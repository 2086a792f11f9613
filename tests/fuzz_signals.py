"""Signals at random moments, to every long command and to the library in a user's own loop.

    python tests/fuzz_signals.py --seconds 3600
    python tests/fuzz_signals.py --jobs hang stream --rounds 200

A command runs in a folder of its own and gets SIGINT, SIGTERM or SIGHUP, alone or with all its processes, as from a terminal.
Within `PATIENCE` seconds it must end by its code (128 + the number of the signal), in words. No process, no temporary file and
no half file may be left. A command that goes on where it was stopped is given again until it is done. A loop of a user catches
KeyboardInterrupt and computes again, `--rounds` times. Exits with 1 if anything went wrong.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import zipfile
from collections import Counter
from pathlib import Path

import numpy as np
import psutil
from safetensors import safe_open

from conftest import DATA, hear_ctrl_c, polygon
from small_datasets import SEED, TINY

PATIENCE = 5.0 * max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))  # seconds, more where others compute, too
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
WRONG = ("Traceback", "Exception ignored", "Fatal", "Segmentation", "SystemError", "resource_tracker")

# Commands, by what they are given; those of GO_ON are given it again in the same folder.
COMMANDS = {
    "track": "track episode.npz --plot tracks.png",
    "simulate": "simulate --task sheet-hook --out new.npz",
    "hang": "hang --task sheet-hook --model carry --out hung.npz --film hung.html",
    "generate": f"generate --config tiny.json --episodes 6 --seed {SEED} --workers 2 --out made",
    "train": "train train.json --out training",
    "predict": f"predict {DATA}/checkpoints/mlp.safetensors episode.npz --json",
}
GO_ON = ("generate", "train")

# Loops of a user: what is computed again and again, after this beginning.
LOOP = """
import faulthandler, signal, sys
import numpy as np
import topokit as tk
from topokit.io import load_episode

faulthandler.register(signal.SIGUSR1)
signal.signal(signal.SIGINT, signal.default_int_handler)
film = load_episode("episode.npz")
states = tk.track(film.points[:20])
ring = film.points[0]
exec(sys.argv[1])
while True:
    try:
        print("computing", flush=True)
        while True:
            exec(sys.argv[2])
    except KeyboardInterrupt:
        pass
"""
LOOPS = {
    "rips_persistence": ("", "tk.rips_persistence(ring)"),
    "rips_persistence_many": ("", "tk.rips_persistence_many(film.points[:40])"),
    "stream": ("", "for state in tk.SeqPH().stream(film.points): pass"),
    "cycles": ("diagram = tk.rips_persistence(ring)", "[diagram.cycle(i) for i in range(len(diagram))]"),
    "score": (
        "from topokit.evaluate import score, summarise_tracks, true_loops",
        "summarise_tracks(states, film.points[:20], film.loops)",
    ),
    "environment": (
        "from topokit.sim import HangEnv; env = HangEnv('sheet-hook')",
        "env.reset(seed=0); [env.step(env.scripted_action()) for _ in range(20)]",
    ),
    "hang in a loop": (
        "from topokit.control import hang",
        "hang('sheet-hook', model='carry', max_steps=20)",
    ),
    "simulate in a loop": (
        "from topokit.sim import simulate",
        "simulate(task='sheet-hook')",
    ),
    "predictor": (
        f"from topokit.models import Predictor; model = Predictor.load({str(DATA / 'checkpoints' / 'mlp.safetensors')!r})",
        "model.reset(); [model.observe(film.observed[t], film.grippers[t], True, target=film.centre_line) for t in range(16)]; "
        "model.predict(film.actions[16:76], film.held[16:76])",
    ),
}


def prepared(folder: Path) -> Path:
    """Return a new folder with what the jobs read."""
    (folder / "tmp").mkdir(parents=True)
    shutil.copy(DATA / "apron_hook_0.npz", folder / "episode.npz")
    shutil.copytree(DATA / "dataset", folder / "dataset")
    (folder / "tiny.json").write_text(json.dumps(TINY.to_json()))
    training = {"model": "mlp", "dataset": str(DATA / "dataset"), "options": {"hidden": [64, 32]}, "batch": 8}
    training |= {
        "epochs": 4,
        "windows_per_epoch": 64,
        "validation_windows": 16,
        "threads": 1,
        "patience": 9,
        "workers": 1,
    }
    (folder / "train.json").write_text(json.dumps(training))
    grid = np.array([[x, 0, z] for z in range(40) for x in range(40)]) / 80
    corners = [
        (i, i + 1, i + 41, i + 40) for i in range(1560) if i % 40 != 39 and not (15 < i % 40 < 22 and 600 < i < 1000)
    ]
    rows = ["v {} {} {}".format(*place) for place in grid]
    rows += ["f {} {} {} {}".format(*(corner + 1 for corner in face)) for face in corners]
    (folder / "cloth.obj").write_text("\n".join(rows))
    return folder


def started(command: list[str], folder: Path, **options: object) -> subprocess.Popen[bytes]:
    path = os.pathsep.join(filter(None, sys.path))
    with (folder / "stderr").open("wb") as stderr:
        return subprocess.Popen(
            command,
            cwd=folder,
            env={**os.environ, "TMPDIR": str(folder / "tmp"), "PYTHONPATH": path, "MPLBACKEND": "Agg"},
            stderr=stderr,
            bufsize=0,
            start_new_session=True,
            preexec_fn=hear_ctrl_c,
            **options,
        )


def feed(process: subprocess.Popen[bytes]) -> None:
    """Send a live tracker clouds until it ends."""
    stream = io.BytesIO()
    np.save(stream, np.column_stack([polygon(300), np.zeros(300)]))
    try:
        while True:
            process.stdin.write(stream.getvalue())
    except BrokenPipeError:
        process.stdin.close()


def family_of(session: int) -> list[psutil.Process]:
    """Return the living processes of a session."""

    def belongs(process: psutil.Process) -> bool:
        try:
            return os.getsid(process.pid) == session and process.status() != psutil.STATUS_ZOMBIE
        except (ProcessLookupError, psutil.NoSuchProcess):
            return False

    return list(filter(belongs, psutil.process_iter()))


def half_files(folder: Path) -> list[str]:
    """Return what is left half-written, or in the folder of temporary files."""
    left = [
        str(path) for path in (folder / "tmp").iterdir() if not path.name.startswith("torchinductor_")
    ]  # of PyTorch
    return left + [str(path) for path in folder.rglob("*") if not is_whole(path)]


def is_whole(path: Path) -> bool:
    """Return whether the end of a file is there."""
    try:
        if path.suffix == ".npz":
            with zipfile.ZipFile(path) as archive:
                return archive.testzip() is None
        if path.suffix == ".safetensors":
            with safe_open(str(path), "np") as tensors:
                return bool(tensors.metadata())
        if path.suffix == ".json":
            json.loads(path.read_bytes())
        if path.suffix in (".html", ".svg", ".png"):
            return path.read_bytes().rstrip().endswith((b"</html>", b"</svg>", b"IEND\xaeB`\x82"))
    except Exception:
        return False
    return path.suffix != ".part"


def interrupt_command(
    name: str, folder: Path, moment: float, number: int, whole_group: bool
) -> tuple[str, float, list[str]]:
    """Run a command and signal it at a moment; return how it ended, in how many seconds, and what was wrong."""
    command = [sys.executable, "-m", "topokit", *COMMANDS[name].split()]
    process = started(command, folder, stdout=subprocess.DEVNULL, stdin=subprocess.PIPE if name == "live" else None)
    feeder = None
    if name == "live":
        feeder = threading.Thread(target=feed, args=[process], daemon=True)
        feeder.start()
    wrong: list[str] = []
    try:
        code = process.wait(moment)
        outcome = "done"
        seconds = 0.0
        if code:
            wrong.append(f"exit code {code} without a signal")
    except subprocess.TimeoutExpired:
        send = os.killpg if whole_group else os.kill
        start = time.monotonic()
        send(process.pid, number)
        try:
            code = process.wait(4 * PATIENCE)
        except subprocess.TimeoutExpired:
            wrong.append("it does not end")
            os.killpg(process.pid, signal.SIGKILL)
            code = process.wait()
        seconds = time.monotonic() - start
        # Python itself is killed before the command begins, in its own words or none, and after it has ended.
        said = (folder / "stderr").read_text(errors="replace")
        loads = ("<frozen site>" in said or "<frozen runpy>" in said) and "__main__.py" not in said
        outcome = "killed" if loads else {0: "done", -number: "killed"}.get(code, "stopped")
        if loads:
            (folder / "stderr").write_text("")
        elif code not in (0, 128 + number, -number):
            wrong.append(f"exit code {code}")
        if seconds > PATIENCE:
            wrong.append(f"it took {seconds:.1f} s")
    if feeder is not None:
        feeder.join()
    said = (folder / "stderr").read_text(errors="replace")
    wrong += [word for word in WRONG if word in said]
    if outcome == "stopped" and "stopped" not in said:
        wrong.append("not a word")
    if left := psutil.wait_procs(family_of(process.pid), PATIENCE)[1]:
        wrong.append(f"processes are left: {[' '.join(p.cmdline())[:80] for p in left]}")
        os.killpg(process.pid, signal.SIGKILL)
    wrong += half_files(folder)
    if wrong:
        wrong.append(said[-2000:])
    return outcome, seconds, wrong


def interrupt_loop(name: str, folder: Path, moments: list[float]) -> tuple[str, float, list[str]]:
    """Interrupt a user's loop at these moments; return how it ended, the longest time until it was heard, and what was wrong."""
    process = started([sys.executable, "-c", LOOP, *LOOPS[name]], folder, stdout=subprocess.PIPE)
    wrong: list[str] = []
    longest = 0.0
    answers: list[bytes] = []
    heard = threading.Semaphore(0)

    def listen() -> None:
        for line in process.stdout:
            answers.append(line)
            heard.release()

    listener = threading.Thread(target=listen, daemon=True)
    listener.start()
    if not heard.acquire(timeout=60):
        wrong.append("it does not begin")
    for moment in moments if not wrong else []:
        time.sleep(moment)
        start = time.monotonic()
        process.send_signal(signal.SIGINT)
        if not heard.acquire(timeout=PATIENCE):
            wrong.append(f"not heard after {moment:.3f} s; it ended by {process.poll()}, or is here:")
            process.send_signal(signal.SIGUSR1)
            time.sleep(1)
            break
        longest = max(longest, time.monotonic() - start)
    process.kill()
    process.wait()
    listener.join()
    process.stdout.close()
    said = (folder / "stderr").read_text(errors="replace")
    wrong += [word for word in WRONG if word in said]
    if wrong:
        wrong.append(said[-2000:])
    return "loop", longest, wrong


def main(arguments: list[str] | None = None) -> int:
    """Send signals until the time is up; return 1 if anything went wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument(
        "--rounds", type=int, default=20, help="signals to each loop, and commands of each kind at a time"
    )
    parser.add_argument("--jobs", nargs="+", choices=[*COMMANDS, *LOOPS], default=[*COMMANDS, *LOOPS])
    parser.add_argument("--seed", type=int, default=None)
    options = parser.parse_args(arguments)
    draw = random.Random(options.seed)
    end = time.monotonic() + options.seconds
    counts: Counter[str] = Counter()
    longest: dict[str, float] = {}
    lengths: dict[str, float] = {}
    failures = 0
    with tempfile.TemporaryDirectory(prefix="signals-") as home:
        trial = 0
        while time.monotonic() < end:
            for job in options.jobs:
                folder = prepared(Path(home) / str(trial))
                trial += 1
                if job in LOOPS:
                    moments = [draw.random() ** 3 for _ in range(options.rounds)]
                    results = [("SIGINT", *interrupt_loop(job, folder, moments))]
                    counts[f"{job}: signals"] += len(moments)
                else:
                    results = []
                    # How long it takes when it is left alone is measured once.
                    if job not in lengths:
                        start = time.monotonic()
                        limit = 5.0 if job == "live" else 300.0
                        results.append(("none", *interrupt_command(job, folder, limit, signal.SIGINT, False)))
                        lengths[job] = min(time.monotonic() - start, limit)
                        folder = prepared(Path(home) / f"{trial}-again")
                    for _ in range(options.rounds):
                        number = draw.choice(SIGNALS)
                        moment = draw.random() * lengths[job]
                        outcome = interrupt_command(job, folder, moment, number, draw.random() < 0.5)
                        results.append((f"{signal.Signals(number).name} after {moment:.2f} s", *outcome))
                        if job not in GO_ON or outcome[0] == "done" or outcome[2]:
                            shutil.rmtree(folder)
                            prepared(folder)
                for how, outcome, seconds, wrong in results:
                    counts[f"{job}: {outcome}"] += 1
                    longest[job] = max(longest.get(job, 0.0), seconds)
                    if wrong:
                        failures += 1
                        print(f"{job}: {how}:", *wrong, sep="\n  ", flush=True)
                shutil.rmtree(folder, ignore_errors=True)
            print(json.dumps({**counts, "failures": failures}), flush=True)
            print({job: f"{seconds:.2f} s" for job, seconds in longest.items()}, flush=True)
            if options.seconds == float("inf"):
                break
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
