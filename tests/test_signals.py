"""A few signals at random moments; `fuzz_signals.py` sends more, to every command."""

import os

import pytest

pytest.importorskip("pybullet")
pytest.importorskip("safetensors")

from fuzz_signals import main


@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize("job", ["live", "simulate", "stream", "environment"])
def test_a_signal_ends_what_runs_in_order(job):
    assert main(["--jobs", job, "--rounds", "3"]) == 0
