"""The process of the command: a signal ends it in order, whenever it comes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from conftest import hear_ctrl_c

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals")
COMMAND = [sys.executable, "-m", "topokit"]
INTERRUPTED = """
import os, runpy, signal, sys

class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == sys.argv[2]:
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupt())
runpy.run_module("topokit", run_name="__main__")
"""


@pytest.mark.parametrize("module", ["numpy", "numpy.linalg", "topokit.cli", "topokit.seqph", "topokit.data._commands"])
def test_ctrl_c_during_start_up_is_one_line_and_130(module):
    """It comes when that module is about to be imported: what imports it must not make another error of it."""
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, "--version", module],
        capture_output=True,
        text=True,
        preexec_fn=hear_ctrl_c,
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "topokit: stopped\n")


def test_importing_the_library_changes_no_signal():
    code = (
        "import signal, topokit.cli, topokit.__main__; print(signal.getsignal(signal.SIGTERM), topokit.track.__name__)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["0", "track"] or "SIG_DFL track" in done.stdout


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_simulation_that_is_ended_leaves_no_temporary_folder(tmp_path, number):
    pytest.importorskip("pybullet")
    room, out = tmp_path / "room", tmp_path / "out"
    room.mkdir()
    command = subprocess.Popen(
        [*COMMAND, "simulate", "--out", str(out / "e.npz")],
        env={**os.environ, "TMPDIR": str(room)},
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=hear_ctrl_c,
    )
    end = time.monotonic() + 60
    while not any(room.iterdir()):  # the folder of the process that simulates
        assert time.monotonic() < end
        time.sleep(0.01)
    command.send_signal(number)
    _, said = command.communicate(timeout=60)
    assert (command.returncode, said) == (128 + number, f"topokit: stopped by {number.name}\n")
    assert not list(room.iterdir())
    assert not out.exists()


def test_a_half_written_file_is_taken_away(tmp_path):
    code = """
import os, signal, sys
from topokit import __main__, _archive, cli

def work():
    with _archive.atomic_file(sys.argv[1]) as handle:
        handle.write(bytes(1000))
        os.kill(os.getpid(), signal.SIGTERM)

cli.main = work
sys.exit(__main__.run())
"""
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path / "a.npz")], capture_output=True, text=True)
    assert done.returncode == 128 + signal.SIGTERM, done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("package", "use"),
    [
        ("pydantic", "from topokit.sim import SimulationConfig"),
        ("gymnasium", "from topokit.sim import HangEnv"),
        ("torch", "from topokit.models import Predictor"),
        ("torch", "from topokit.evaluate import evaluate_forecasts"),
        ("matplotlib", "import topokit.view"),
        (
            "dask",
            "from topokit.__main__ import run; sys.argv[1:] = ['generate', '--out', 'x', '--episodes', '1']; run()",
        ),
    ],
)
def test_what_is_missing_is_named_with_the_extra_that_brings_it(package, use, tmp_path):
    code = f"import sys\nsys.modules[{package!r}] = None\n{use}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert "pip install 'topokit[" in done.stderr.splitlines()[-1]
    assert package in done.stderr.splitlines()[-1]
