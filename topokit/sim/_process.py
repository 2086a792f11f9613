"""Run a simulation in a fresh process, which can be stopped.

PyBullet can hang inside C (its loader does, on meshes that `Garment` refuses), can end the process, and repeats
self-collision bit by bit in a fresh process only. What a run needs and what it gives travel as archives without pickle.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from topokit._archive import load_archive, save_archive

from .camera import Camera, DepthNoise
from .config import SimulationConfig
from .garments import Garment
from .recording import Recording, Report, Run, SimulationError, record

__all__ = ["record_in_process"]

_RUN, _RECORDING = "topokit-run", "topokit-recording"
_CHILD = "import sys; from topokit.sim._process import work; work(*sys.argv[1:])"
_FRAME = "topokit-frame"
_ERRORS: dict[str, type[Exception]] = {"SimulationError": SimulationError, "ValueError": ValueError}


def record_in_process(run: Run, time_limit: float, report: Report | None = None) -> Recording:
    """Simulate in a fresh process; it is stopped when loading, settling or a frame takes longer than `time_limit` seconds.

    Raises
    ------
    SimulationError
        As `record`, and when the process crashes or is stopped; the message says where it was.
    ImportError
        When PyBullet is not installed.
    """
    if find_spec("pybullet") is None:
        raise ImportError("topokit.sim needs PyBullet: pip install 'topokit[sim]'")
    with tempfile.TemporaryDirectory() as folder:
        question, answer, errors = (Path(folder) / name for name in ("run.npz", "recording.npz", "errors.txt"))
        _save_run(question, run)
        with errors.open("wb") as log:
            process = subprocess.Popen(
                [sys.executable, "-c", _CHILD, str(question), str(answer)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},  # the packages we have
                start_new_session=True,  # Ctrl-C reaches us alone, and we stop it
            )
            stage = "loading the garment"
            try:
                for frame in _reports(process, time_limit):
                    stage = "settling" if frame < 0 else f"in the steps after frame {frame}"
                    if report is not None:
                        report(frame)
                code = process.wait()
            except queue.Empty:
                raise SimulationError(
                    f"stopped while {stage}: no sign of life for time_limit = {time_limit:g} s. PyBullet hangs on meshes that "
                    "it cannot use (Garment.from_mesh repairs or refuses them); or the machine is very busy"
                ) from None
            finally:
                process.kill()
                process.wait()
        if code or not answer.exists():
            said = errors.read_text(errors="replace").strip().splitlines()[-1:]
            raise SimulationError(
                f"the simulator ended while {stage}, {_why(code)}" + "".join(f": {line}" for line in said)
            )
        return _load_recording(answer)


def _reports(process: subprocess.Popen[str], time_limit: float) -> Iterator[int]:
    """Yield the frames that the process reports; raise queue.Empty when it is silent for too long."""
    lines: queue.Queue[str | None] = queue.Queue()

    def read(stream: IO[str]) -> None:
        with stream:
            for line in stream:
                lines.put(line)
        lines.put(None)

    threading.Thread(target=read, args=(process.stdout,), daemon=True).start()
    patience = None if math.isinf(time_limit) else time_limit
    while (line := lines.get(timeout=patience)) is not None:
        word, _, number = line.partition(" ")
        if word == _FRAME:  # anything else is PyBullet's chatter
            yield int(number)


def _why(code: int) -> str:
    if code >= 0:
        return f"exit code {code}"
    with contextlib.suppress(ValueError):
        return f"{signal.Signals(-code).name}: a crash inside PyBullet, or out of memory"
    return f"signal {-code}"


def work(question: str, answer: str) -> None:
    """What the fresh process does: load the run, simulate, save the recording or the error."""

    def report(frame: int) -> None:
        print(f"\n{_FRAME} {frame}", flush=True)  # a line of its own, whatever C has printed before

    try:
        recording = record(_load_run(Path(question)), report)
    except tuple(_ERRORS.values()) as error:
        save_archive(answer, _RECORDING, {"error": type(error).__name__, "message": str(error)}, {})
    else:
        save_archive(answer, _RECORDING, {}, vars(recording))


def _save_run(path: Path, run: Run) -> None:
    arrays: dict[str, NDArray[Any]] = {"goals": run.goals}
    arrays |= {name: getattr(run.garment, name) for name in ("vertices", "faces", "grips")}
    arrays["rods"] = np.array([[*start, *end, radius] for start, end, radius in run.rods]).reshape(-1, 7)
    text = {name: getattr(run, name) for name in ("release", "n_observed", "noise")}
    text["config"] = dataclasses.asdict(run.config)
    text["cameras"] = [dataclasses.asdict(camera) for camera in run.cameras]
    save_archive(path, _RUN, text, arrays)


def _load_run(path: Path) -> Run:
    text, arrays = load_archive(path, _RUN)
    garment = Garment("", arrays["vertices"], arrays["faces"], (), arrays["grips"])
    cameras = []
    for camera in text.pop("cameras"):
        noise = camera.pop("noise")
        cameras.append(Camera(**camera, noise=noise and DepthNoise(**noise)))
    rods = [(rod[:3], rod[3:6], float(rod[6])) for rod in arrays["rods"]]
    return Run(garment, rods, arrays["goals"], config=SimulationConfig(**text.pop("config")), cameras=cameras, **text)


def _load_recording(path: Path) -> Recording:
    text, arrays = load_archive(path, _RECORDING)
    if "error" in text:
        raise _ERRORS[text["error"]](text["message"])
    return Recording(**arrays)
