"""What the sources of topokit may not do: unpickle, run text as code, or ask a shell."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import topokit

PACKAGE = Path(topokit.__file__).parent
PICKLES = {"pickle", "cPickle", "_pickle", "cloudpickle", "dill", "joblib", "jsonpickle", "marshal", "shelve"}
RUNNERS = {"eval", "exec", "compile", "__import__"}
CALLS = {"torch.load", "torch.save", "os.system", "os.popen", "numpy.fromregex", "yaml.load", "pandas.read_pickle"}


def offences(source: str) -> list[str]:
    """Return what a module does that it may not."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            named = [alias.name for alias in node.names] if isinstance(node, ast.Import) else [node.module or ""]
            found += [name for name in named if name.split(".")[0] in PICKLES]
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            if name in RUNNERS or name in CALLS:
                found.append(name)
            for keyword in node.keywords:
                if keyword.arg in ("allow_pickle", "shell") and ast.unparse(keyword.value) != "False":
                    found.append(f"{name}({keyword.arg}={ast.unparse(keyword.value)})")
    return found


@pytest.mark.parametrize(
    "source",
    [
        "import pickle",
        "from pickle import loads",
        "import numpy as np; np.load(path, allow_pickle=True)",
        "torch.load(path)",
        "model.eval(); eval(text)",
        "exec(text)",
        "subprocess.run(text, shell=True)",
    ],
)
def test_an_offence_is_found(source):
    assert len(offences(source)) == 1


def test_no_source_unpickles_runs_text_or_asks_a_shell():
    files = sorted(PACKAGE.rglob("*.py"))
    assert len(files) > 50
    found = {path.name: found for path in files if (found := offences(path.read_text(encoding="utf-8")))}
    # A process of our own sends its outcome by a pipe.
    assert found == {"_processes.py": ["pickle"]}
