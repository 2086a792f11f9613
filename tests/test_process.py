"""Jobs in fresh processes: what they may not run, what a system without forks is told."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytest.importorskip("pybullet")

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


def test_a_module_in_the_working_directory_is_not_run(tmp_path):
    script, here = tmp_path / "script.py", tmp_path / "here"
    script.write_text(SIMULATE)
    here.mkdir()
    (here / "dataclasses.py").write_text("raise SystemExit('what lies around was run')\n")
    done = subprocess.run([sys.executable, str(script)], cwd=here, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_a_system_without_forks_is_told_so():
    done = subprocess.run([sys.executable, "-c", WITHOUT_FORK], capture_output=True, text=True)
    assert "processes can fork" in done.stdout, done.stderr
