"""A few signals at random moments; `fuzz_signals.py` sends more, to every command."""

import os
import subprocess
import sys

import pytest

pytest.importorskip("pybullet")
pytest.importorskip("safetensors")

from fuzz_signals import main


@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize("job", ["simulate", "stream", "environment"])
def test_a_signal_ends_what_runs_in_order(job):
    assert main(["--jobs", job, "--rounds", "3"]) == 0


STOPPED_WHILE_IMPORTING = """
import signal, sys
from topokit import __main__, _archive
signal.signal(signal.SIGTERM, __main__._stop)
sys.path.append(sys.argv[1])
with _archive.atomic_file(f"{sys.argv[1]}/picture.svg") as file:
    file.write(b"half")
    import stopped
"""


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_a_signal_while_a_module_is_imported_leaves_no_half_file(tmp_path):
    (tmp_path / "stopped.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGTERM)\n")
    command = [sys.executable, "-B", "-c", STOPPED_WHILE_IMPORTING, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (143, "topokit: stopped\n")
    assert [path.name for path in tmp_path.iterdir()] == ["stopped.py"]
