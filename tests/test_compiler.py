"""With and without a compiler: the first answer, the choice, what is kept of compiled code and where, and numba missing."""

from __future__ import annotations

import os
import re
import resource
import stat
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from topokit import rips_persistence, rips_persistence_many
from topokit.rips import _numba, _pairs

ROOT = Path(__file__).parent.parent
needs_numba = pytest.mark.skipif(not _numba.is_usable(), reason="what is compiled needs numba")
DOUBLE = """
from topokit.rips import _numba

@_numba.njit(cache=True)
def double(x):
    return 2 * x

print(double(21), sum(double.stats.cache_hits.values()))
"""


def run(code: str, home: Path, cwd: Path | None = None, **options: object) -> subprocess.CompletedProcess[str]:
    """Run code in a fresh process with a home, and so with a cache, of its own."""
    places = ("HOME", "LOCALAPPDATA", "USERPROFILE")
    variables = {name: value for name, value in os.environ.items() if name not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    variables |= dict.fromkeys(places, str(home)) | options.pop("env", {})
    return subprocess.run(
        [sys.executable, "-c", code], cwd=cwd or home.parent, env=variables, capture_output=True, text=True, **options
    )


def ring(n: int) -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    return np.column_stack([np.cos(angle), np.sin(angle)])


# The first answer, and the choice


def test_the_first_answers_wait_for_no_compiler(tmp_path):
    """README's snippet in a fresh process with an empty cache: seconds of the processor, of which compiling takes thirty."""
    snippet = re.search(r"```python\n(import numpy.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)[1]
    check = "import sys, time; assert not sys.modules.get('numba'); print(time.process_time(), len(states))"
    done = run(snippet + check, tmp_path)
    assert done.stderr == ""
    seconds, frames = map(float, done.stdout.splitlines()[-1].split())
    assert frames == 10
    assert seconds < 5


@pytest.fixture
def loads(monkeypatch):
    """Nothing is loaded; what would be is listed."""
    loaded = []
    monkeypatch.setattr(_pairs, "_ready", set())
    monkeypatch.setattr(_pairs, "_spent", 0.0)
    monkeypatch.setattr(_pairs, "_load", lambda function: loaded.append(function) or True)
    monkeypatch.setattr(_numba, "is_usable", lambda: True)
    monkeypatch.setattr(_numba, "is_compiled", lambda _: False)
    monkeypatch.setattr(_numba, "seconds_before", lambda: 0.0)
    return loaded


def test_compiling_begins_when_plain_python_has_cost_as_much(loads, monkeypatch):
    assert not _pairs.compiled_pays([1000])
    assert _pairs.compiled_pays([10_000])
    assert _pairs.compiled_pays([200] * 3000)
    rips_persistence(ring(50))
    assert 0 < _pairs._spent < 1
    monkeypatch.setattr(_pairs, "_spent", _pairs.COMPILING)
    assert _pairs.compiled_pays([4])
    assert loads == [_pairs.CLOUDS] * 3


def test_kept_code_is_loaded_sooner(loads, monkeypatch):
    monkeypatch.setattr(_numba, "is_compiled", lambda _: True)
    assert not _pairs.compiled_pays([60])
    assert _pairs.compiled_pays([3000])
    assert loads == [_pairs.CLOUDS]


def test_many_clouds_are_counted_together(loads, monkeypatch):
    monkeypatch.setattr(_pairs, "COMPILING", 0.03)
    monkeypatch.setattr(_pairs, "LOADING", 0.03)
    monkeypatch.setattr(_pairs, "_load", lambda function: loads.append(function))
    rips_persistence_many([ring(40)] * 4)
    assert loads == []
    rips_persistence_many([ring(40)] * 100)
    assert loads[0]


@needs_numba
def test_short_processes_are_counted_together(tmp_path):
    """A command of few seconds, called again and again, is at last compiled."""
    code = """
from topokit.rips import _pairs, rips_persistence
_pairs.LOADING, _pairs.COMPILING = 0.0, 1.0
_pairs._load = lambda function: True
pays = _pairs.compiled_pays([40])
if not pays:
    rips_persistence([[0, 0], [2, 0], [2, 2], [0, 2]])
    _pairs._spent = 0.6
print(pays)
"""
    answers = [run(code, tmp_path).stdout for _ in range(3)]
    assert answers == ["False\n", "False\n", "True\n"]


@needs_numba
def test_fresh_processes_of_one_command_are_counted_together(tmp_path):
    """Each film of `topokit label` has a process of its own, which ends before its exit functions."""
    code = """
import numpy as np
from topokit._processes import in_fresh_processes
from topokit.rips import _numba, rips_persistence

before = _numba.seconds_before()
cloud = np.random.default_rng(0).normal(size=(1500, 3))
for _, found in in_fresh_processes(rips_persistence, [cloud]):
    found.death
print(before)
"""
    answers = [float(run(code, tmp_path).stdout) for _ in range(2)]
    assert answers[0] == 0 < 0.7 <= answers[1]


# Where compiled code is kept


@needs_numba
def test_compiled_code_is_kept_in_a_private_folder(tmp_path):
    assert run(DOUBLE, tmp_path).stdout == "42 0\n"
    again = run(DOUBLE, tmp_path)
    assert (again.stdout, again.stderr) == ("42 1\n", "")
    (file,) = tmp_path.rglob("double-*")
    if os.name == "posix":
        assert stat.S_IMODE(file.parent.stat().st_mode) == 0o700
        assert stat.S_IMODE(file.stat().st_mode) == 0o600


@needs_numba
def test_the_environment_names_the_folder(tmp_path):
    elsewhere = tmp_path / "elsewhere"
    run(DOUBLE, tmp_path / "home", tmp_path, env={"NUMBA_CACHE_DIR": str(elsewhere)})
    assert list(tmp_path.rglob("double-*")) == list(elsewhere.glob("topokit/double-*"))


@needs_numba
def test_a_file_in_the_working_directory_has_no_say(tmp_path):
    """`.numba_config.yaml` could name a folder of pickles, or a class that finds one."""
    home, here = tmp_path / "home", tmp_path / "here"
    here.mkdir()
    (here / ".numba_config.yaml").write_text(f"cache_dir: {here / 'cache'}\ncache_locator_classes: evil.Locator\n")
    (here / "evil.py").write_text("open('evil ran', 'w')\nclass Locator: pass\n")
    assert [run(DOUBLE, home, here).stdout for _ in range(2)] == ["42 0\n", "42 1\n"]
    assert sorted(path.name for path in here.iterdir()) == [".numba_config.yaml", "evil.py"]


def no_home(tmp_path: Path) -> Path:
    (tmp_path / "file").touch()
    return tmp_path / "file" / "home"


def open_to_all(tmp_path: Path) -> Path:
    (tmp_path / ".cache" / "topokit").mkdir(parents=True)
    (tmp_path / ".cache" / "topokit").chmod(0o777)
    return tmp_path


def of_somebody_else(tmp_path: Path) -> Path:
    (tmp_path / ".cache" / "topokit").mkdir(parents=True)
    if os.geteuid():
        pytest.skip("only root can give a folder away")
    os.chown(tmp_path / ".cache" / "topokit", 12345, 12345)
    return tmp_path


@needs_numba
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere caches are in another folder")
@pytest.mark.parametrize("home_in", [no_home, open_to_all, of_somebody_else])
def test_without_a_private_folder_code_is_compiled_in_memory(home_in, tmp_path):
    home = home_in(tmp_path)
    for _ in range(2):
        done = run(DOUBLE, home, tmp_path)
        assert done.stdout == "42 0\n"
        assert len(done.stderr.splitlines()) == 1
        assert "NUMBA_CACHE_DIR" in done.stderr
    assert not list(tmp_path.rglob("double-*"))


@needs_numba
@pytest.mark.skipif(os.name != "posix", reason="sizes of files are limited in POSIX")
def test_a_full_disk_loses_no_result(tmp_path):
    full = run(DOUBLE, tmp_path, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100)))
    assert full.stdout == "42 0\n"
    assert "not kept" in full.stderr
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


@needs_numba
def test_damaged_code_is_compiled_again(tmp_path):
    run(DOUBLE, tmp_path)
    (file,) = tmp_path.rglob("double-*")
    file.write_bytes(file.read_bytes()[:1000])
    damaged = run(DOUBLE, tmp_path)
    assert damaged.stdout == "42 0\n"
    assert "cannot be read" in damaged.stderr
    assert run(DOUBLE, tmp_path).stdout == "42 1\n"


# Without numba


def test_a_numba_that_fails_is_said_and_not_needed(tmp_path):
    """As one that is older than NumPy."""
    (tmp_path / "numba").mkdir()
    (tmp_path / "numba" / "__init__.py").write_text("raise ImportError('Numba needs NumPy 2.4 or less')")
    code = """
import numpy as np
from topokit.rips import _pairs, rips_persistence
_pairs.LOADING = _pairs.COMPILING = 0.0
square = [[0, 0], [2, 0], [2, 2], [0, 2]]
print([rips_persistence(square).birth for _ in range(3)])
"""
    done = run(code, tmp_path, env={"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path[1:]])})
    assert done.stdout.count("array([1.])") == 3
    assert len(done.stderr.splitlines()) == 1
    assert "Numba needs NumPy 2.4" in done.stderr


def test_a_large_cloud_without_numba_is_announced_once(monkeypatch, capsys):
    monkeypatch.setattr(_pairs, "_ready", set())
    monkeypatch.setattr(_numba, "_said", set())
    monkeypatch.setattr(_numba, "is_usable", lambda: False)
    cloud = np.random.default_rng(0).random((2500, 2))
    for _ in range(2):
        assert len(rips_persistence(cloud, max_radius=1e-5)) == 0
    rips_persistence(cloud[:100])
    assert capsys.readouterr().err.count("2500 points") == 1
