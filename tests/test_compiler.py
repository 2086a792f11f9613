"""With and without a compiler: the first answer, where compiled code is kept, and numba missing."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from topokit import rips_persistence

from clouds import compiled

ROOT = Path(__file__).parent.parent
LARGE = """
import numpy as np
from topokit import rips_persistence

diagram = rips_persistence(np.random.default_rng(0).random((4000, 2)), max_radius=0.02)
print(len(diagram), diagram.birth.sum())
"""


def run(code: str, home: Path, here: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run code in a fresh process with a home, and so with a cache, of its own."""
    own = ("NUMBA_CACHE_DIR", "NUMBA_CACHE_LOCATOR_CLASSES", "XDG_CACHE_HOME")
    environment = {name: value for name, value in os.environ.items() if name not in own}
    environment |= dict.fromkeys(("HOME", "LOCALAPPDATA", "USERPROFILE"), str(home)) | variables
    return subprocess.run([sys.executable, "-c", code], cwd=here, env=environment, capture_output=True, text=True)


def test_the_first_answers_wait_for_no_compiler(tmp_path):
    """README's snippet in a fresh process does not import numba."""
    snippet = re.search(r"```python\n(import numpy.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)[1]
    done = run(snippet + "import sys; assert 'numba' not in sys.modules", tmp_path, tmp_path)
    assert (done.returncode, done.stderr) == (0, "")


@compiled
def test_another_process_compiles_into_the_cache_of_the_user_while_clouds_go_on_in_plain_python(tmp_path):
    """The first process of a new user computes at once, and says once why it is slow; the second says nothing.

    `.numba_config.yaml` in the working directory could name a folder of pickles, or a class that finds one; it is not read.
    """
    home, here = tmp_path / "home", tmp_path / "here"
    here.mkdir()
    (here / ".numba_config.yaml").write_text(f"cache_dir: {here / 'cache'}\ncache_locator_classes: evil.Locator\n")
    (here / "evil.py").write_text("open('evil ran', 'w')\nclass Locator: pass\n")
    film = """
import sys, time
import numpy as np
from topokit import rips_persistence
from topokit.rips._engine import engine_is_ready

cloud = np.random.default_rng(0).random((300, 3))
before = set()
while not engine_is_ready():
    before.add(rips_persistence(cloud).death.tobytes())
print(len(before), before == {rips_persistence(cloud).death.tobytes()})
"""
    done = run(film, home, here)
    assert (done.stdout, done.stderr.count("\n")) == ("1 True\n", 1)
    known = rips_persistence(np.random.default_rng(0).random((4000, 2)), max_radius=0.02)
    done = run(LARGE, home, here)
    assert (done.stdout, done.stderr) == (f"{len(known)} {known.birth.sum()}\n", "")
    assert sorted(path.name for path in here.iterdir()) == [".numba_config.yaml", "evil.py"]
    assert len(list(home.rglob("*.nbc"))) == 1  # loaded, not compiled, the second time


@compiled
def test_a_process_that_ends_at_once_leaves_the_engine_for_the_next(tmp_path):
    short = "import numpy as np, topokit as tk; [tk.rips_persistence(np.random.rand(900, 3)) for _ in range(2)]"
    assert run(short, tmp_path, tmp_path).returncode == 0
    deadline = time.monotonic() + 120
    while not list(tmp_path.rglob("*.nbi")) and time.monotonic() < deadline:
        time.sleep(0.2)
    assert run(short, tmp_path, tmp_path).stderr == ""


def test_without_numba_every_cloud_is_paired_in_plain_python(tmp_path):
    answers = []
    for block in (
        "",
        "import importlib.util as u; find = u.find_spec; u.find_spec = lambda n: None if n == 'numba' else find(n)\n",
    ):
        done = run(
            block + LARGE.replace("4000", "1900") + "import sys; print('numba' in sys.modules)", tmp_path, tmp_path
        )
        answers.append(done.stdout.split("\n"))
    assert answers[0][0] == answers[1][0]
    assert answers[1][1] == "False"
