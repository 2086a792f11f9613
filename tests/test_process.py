"""Jobs in fresh processes: what they may not run; that they can be stopped and leave nothing behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

pytest.importorskip("pybullet")

from topokit.sim import Garment, SimulationConfig, SimulationError, _process, simulate

APRON = Garment.apron(spacing=0.05, strap_width=0.05)
SHORT = SimulationConfig(frames=2, steps_per_frame=1, settle=0)
SIMULATE = """
from topokit.sim import Garment, SimulationConfig, simulate

apron = Garment.apron(spacing=0.05, strap_width=0.05)
print(simulate(apron, config=SimulationConfig(frames=2, steps_per_frame=1, settle=0), n_observed=50).points.sum())
"""
WITHOUT_FORK = """
import os, sys

del os.fork
sys.modules["resource"] = None
from topokit.data._generate import Forge

try:
    Forge("json:dumps")
except OSError as error:
    print(error)
"""
OWNER = "import sys; from topokit.sim._process import Forge; Forge('test_process:wait').run({'pids': sys.argv[1]}, 60)"


def leave(job: dict[str, str]) -> None:
    """A job that ends its process."""
    raise SystemExit("no room on the disk")


def wait(job: dict[str, str]) -> None:
    """A job that tells who does it and whose fork that is, and does not end."""
    path = Path(job["pids"])
    path.with_suffix(".new").write_text(f"{os.getppid()} {os.getpid()}")
    path.with_suffix(".new").rename(path)
    time.sleep(60)


def until(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it takes too long"
        time.sleep(0.02)


def is_gone(pid: str) -> bool:
    return not psutil.pid_exists(int(pid)) or psutil.Process(int(pid)).status() == psutil.STATUS_ZOMBIE


def assert_nothing_is_left(pids: Path) -> None:
    until(lambda: all(map(is_gone, pids.read_text().split())), seconds=10)


def test_a_module_in_the_working_directory_is_not_run(tmp_path):
    script, here = tmp_path / "script.py", tmp_path / "here"
    script.write_text(SIMULATE)
    here.mkdir()
    (here / "dataclasses.py").write_text("raise SystemExit('what lies around was run')\n")
    done = subprocess.run([sys.executable, str(script)], cwd=here, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(sys.version_info < (3, 11), reason="Python 3.10 cannot leave it out")
def test_a_module_in_the_working_directory_is_not_run_by_a_worker(tmp_path, monkeypatch):
    """Dask starts its own with `python -c`."""
    pytest.importorskip("distributed")
    from topokit.data._generate import Cluster, run_jobs

    (tmp_path / "multiprocessing.py").write_text("raise SystemExit('what lies around was run')\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    assert list(run_jobs(abs, [-3], Cluster(None, 1, None))) == [(-3, 3)]
    assert "PYTHONSAFEPATH" not in os.environ


def test_a_system_without_forks_is_told_so():
    done = subprocess.run([sys.executable, "-c", WITHOUT_FORK], capture_output=True, text=True)
    assert "processes can fork" in done.stdout, done.stderr


def test_one_simulation_needs_no_fork(monkeypatch):
    forked = simulate(APRON, config=SHORT, n_observed=50)
    monkeypatch.setattr(_process, "_MAIN", "import os; del os.fork\n" + _process._MAIN)
    np.testing.assert_array_equal(simulate(APRON, config=SHORT, n_observed=50).points, forked.points)


@pytest.mark.parametrize(
    ("child", "says"),
    [
        ("import time; time.sleep(60)", "loading the garment: stopped: no sign of life for 1 s"),
        (
            """print('ready\\n{"report": 7}', flush=True); import time; time.sleep(60)""",
            "after frame 7: stopped: no sign of life for 1 s",
        ),
        ("""print('ready\\n{"report": -1}', flush=True); import os; os.abort()""", "settling: SIGABRT"),
        ("raise SystemExit('no room on the disk')", "does not start: exit code 1: no room on the disk"),
    ],
)
def test_a_process_that_fails_is_a_simulation_error(child, says, monkeypatch):
    monkeypatch.setattr(_process, "_MAIN", child)
    with pytest.raises(SimulationError, match=says):
        simulate(APRON, config=SHORT, n_observed=50, time_limit=1)


def test_a_fork_that_fails_says_why():
    forge = _process.Forge("test_process:leave")
    try:
        for _ in range(2):  # the forge itself goes on
            assert forge.run({}, 60) == {"error": "crash", "message": "exit code 1: no room on the disk"}
    finally:
        forge.close()


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_control_c_stops_the_processes(tmp_path):
    pids = tmp_path / "pids"

    def interrupt():
        until(pids.exists)
        os.kill(os.getpid(), signal.SIGINT)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it
    try:
        threading.Thread(target=interrupt, daemon=True).start()
        with pytest.raises(KeyboardInterrupt):
            _process.Forge("test_process:wait").run({"pids": str(pids)}, 60)
    finally:
        signal.signal(signal.SIGINT, before)
    assert_nothing_is_left(pids)


@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_a_process_starts_leaves_nothing(number, monkeypatch, tmp_path):
    """It comes when the process is there, and nobody knows it yet."""
    started, ended = [], []

    class Started(subprocess.Popen):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            started.append(self)
            signal.raise_signal(number)

    def end(number, frame):
        ended.append(number)
        raise KeyboardInterrupt

    monkeypatch.setattr(_process.subprocess, "Popen", Started)
    monkeypatch.setattr(_process.tempfile, "tempdir", str(tmp_path))
    before = signal.signal(number, end)
    try:
        with pytest.raises(KeyboardInterrupt):
            _process.Forge("json:dumps").run({}, 60)
        assert signal.getsignal(number) is end
    finally:
        signal.signal(number, before)
        left = [process for process in started if process.poll() is None]
        for process in left:
            process.kill()
    assert (ended, left, [*tmp_path.iterdir()]) == ([number], [], [])


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_nothing_is_left_of_an_owner_that_is_killed(tmp_path):
    pids = tmp_path / "pids"
    path = os.pathsep.join([str(Path(__file__).parent), *filter(None, sys.path)])
    owner = subprocess.Popen([sys.executable, "-c", OWNER, str(pids)], env={**os.environ, "PYTHONPATH": path})
    until(pids.exists)
    assert not any(map(is_gone, pids.read_text().split()))
    owner.kill()
    owner.wait()
    assert_nothing_is_left(pids)


def test_a_job_that_is_sent_before_the_last_fork_has_ended_is_done(monkeypatch):
    """The answer is there, and the fork takes its time to end: the next job must neither end it nor get its fate."""
    slow = "import os, time; end = os._exit; os._exit = lambda code: (time.sleep(0.3), end(code))\n"
    monkeypatch.setattr(_process, "_MAIN", slow + _process._MAIN)
    forge = _process.Forge("json:dumps")
    try:
        assert [forge.run({"a": i}, 5.0) for i in range(3)] == [{"answer": f'{{"a": {i}}}'} for i in range(3)]
    finally:
        forge.close()
