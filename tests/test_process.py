"""Jobs in fresh processes: they can crash, hang and be stopped, and leave nothing behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

pytest.importorskip("pybullet")
from topokit._processes import ProcessError, in_fresh_processes
from topokit.sim import WARDROBE, SimulationConfig, SimulationError, simulate

from conftest import hear_ctrl_c
from fresh_jobs import crash_until_third, divide, do, temporary
from small_datasets import wait_until

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals")

SIMULATE = """
from topokit.sim import WARDROBE, SimulationConfig, simulate

apron = WARDROBE["apron"](spacing=0.05, strap_width=0.05)
print(simulate(apron, config=SimulationConfig(frames=2, steps_per_frame=1, settle=0), n_observed=50).points.sum())
"""
OWNER = """
import sys
sys.path.insert(0, sys.argv[1])
from topokit._processes import in_fresh_processes
import fresh_jobs
list(in_fresh_processes(fresh_jobs.wait, [sys.argv[2]]))
"""


def is_gone(pid: str) -> bool:
    try:
        return psutil.Process(int(pid)).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


def test_each_item_has_a_process_of_its_own_and_an_error_is_an_outcome():
    outcomes = dict(in_fresh_processes(divide, [1, 2, 3, 0], n_workers=2))
    assert isinstance(outcomes.pop(0), ZeroDivisionError)
    assert {item: value for item, (value, _) in outcomes.items()} == {1: 6.0, 2: 3.0, 3: 2.0}
    assert len({pid for _, pid in outcomes.values()} | {os.getpid()}) == 4


@pytest.mark.parametrize(
    ("what", "says"),
    [("crash", "signal 11"), ("kill", "signal 9"), ("leave", "exit code 3"), ("hang", "stopped after 5 s")],
)
def test_what_fails_costs_one_item(what, says):
    outcomes = dict(in_fresh_processes(do, ["a", what, "b"], n_workers=2, time_limit=5))
    assert isinstance(outcomes[what], ProcessError)
    assert says in str(outcomes.pop(what))
    assert outcomes == {"a": "a", "b": "b"}


def test_a_crash_that_passes_is_tried_again(tmp_path):
    path = str(tmp_path / "log")
    ((_, failed),) = in_fresh_processes(crash_until_third, [path], tries=2)
    assert isinstance(failed, ProcessError)
    (tmp_path / "log").unlink()
    assert list(in_fresh_processes(crash_until_third, [path], tries=3)) == [(path, "done")]


def test_temporary_files_go():
    ((_, folder),) = in_fresh_processes(temporary, [8])
    assert "topokit-" in folder
    assert not os.path.exists(folder)


def test_a_script_is_not_run_again_nor_a_module_of_the_working_directory(tmp_path):
    script, here = tmp_path / "script.py", tmp_path / "here"
    script.write_text(SIMULATE)
    here.mkdir()
    for name in ("dataclasses", "multiprocessing", "signal", "scipy", "pybullet"):
        (here / f"{name}.py").write_text("open('was run', 'w')\nraise SystemExit('what lies around was run')\n")
    done = subprocess.run([sys.executable, str(script)], cwd=here, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert not (here / "was run").exists()
    assert len(done.stdout.splitlines()) == 1  # the script ran once, and PyBullet printed nothing


def test_a_simulation_that_hangs_is_stopped():
    apron = WARDROBE["apron"](spacing=0.05, strap_width=0.05)
    config = SimulationConfig(frames=2, steps_per_frame=3_000_000, settle=0)
    with pytest.raises(SimulationError, match="stopped after 5 s"):
        simulate(apron, config=config, n_observed=50, time_limit=5)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_nothing_is_left_of_an_owner_that_is_stopped(tmp_path, number):
    pids = tmp_path / "pids"
    command = [sys.executable, "-c", OWNER, str(Path(__file__).parent), str(pids)]
    owner = subprocess.Popen(command, preexec_fn=hear_ctrl_c, stderr=subprocess.PIPE)
    wait_until(pids.exists, owner)
    assert not any(map(is_gone, pids.read_text().split()))
    owner.send_signal(number)
    owner.communicate(timeout=20)
    wait_until(lambda: all(map(is_gone, pids.read_text().split())), seconds=10)
