"""Break the core in every way that a mutation tool knows, and count how many the tests notice.

    pip install mutmut==3.8.1
    python .github/mutation.py tracking                # seqPH, linking, mixtures, windows; goes on where it was stopped
    python .github/mutation.py rips --fresh            # persistence, from the start
    (cd runs/mutation/rips && mutmut browse)         # look at those that live

mutmut leaves decorated functions alone, and compiled code cannot be broken while it runs. So persistence is broken in its plain
form, `rips.pairing`, to which the tests compare the engine.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
WORK = ROOT / "runs" / "mutation"
PARTS = {
    "tracking": (
        (
            "seqph/_tracker.py",
            "seqph/_matching.py",
            "seqph/_evidence.py",
            "seqph/_frames.py",
            "sampling.py",
            "linking.py",
            "mixture.py",
            "data/_windows.py",
        ),
        ("seqph", "evidence", "sampling", "linking", "mixture", "data_windows"),
    ),
    "rips": (
        tuple(f"rips/{name}.py" for name in ("_cloud", "_cycles", "_diagram", "_persistence", "pairing", "reduction")),
        ("rips", "rips_properties", "reduction", "cycles"),
    ),
}
CONFIGURATION = """
[tool.mutmut]
source_paths = ["topokit"]
only_mutate = {only}
also_copy = ["tests", "data_small", "pyproject.toml"]
pytest_add_cli_args_test_selection = {tests}
pytest_add_cli_args = ["-p", "no:cacheprovider", "-o", "addopts=", "-x", "-q", "-W", "ignore::RuntimeWarning"]
do_not_mutate_patterns = ["raise ", "Error\\\\(", "f\\"", "__all__"]
"""


def main() -> None:
    """Prepare the copy, run the tool, print what it found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("names", nargs="*", help="mutants, with wildcards: topokit.seqph*")
    parser.add_argument("--fresh", action="store_true", help="forget what an earlier run found")
    parser.add_argument("--processes", type=int, default=os.cpu_count(), help="at a time")
    options = parser.parse_intermixed_args()
    work = WORK / options.part
    if options.fresh:
        shutil.rmtree(work, ignore_errors=True)
    prepare(work, *PARTS[options.part])
    command = [sys.executable, "-m", "mutmut", "run", "--max-children", str(options.processes), *options.names]
    environment = {**os.environ, "PYTHONHASHSEED": "0", "NUMBA_DISABLE_JIT": "0"}
    subprocess.run(command, cwd=work, env=environment, check=False)
    report(work / "mutants")


def prepare(work: Path, mutated: tuple[str, ...], tests: tuple[str, ...]) -> None:
    """Copy the repository and name what is mutated."""
    for name in ("topokit", "tests", "data_small"):
        shutil.copytree(ROOT / name, work / name, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__"))
    only = json.dumps([f"topokit/{name}" for name in mutated])
    files = json.dumps([f"tests/test_{name}.py" for name in tests])
    project = (ROOT / "pyproject.toml").read_text() + CONFIGURATION.format(only=only, tests=files)
    (work / "pyproject.toml").write_text(project)


def report(mutants: Path) -> None:
    """Print how many were killed, by module; a mutant that makes a test hang is noticed too."""
    total = [0, 0]
    for path in sorted(mutants.rglob("*.meta")):
        codes = [code for code in json.loads(path.read_text())["exit_code_by_key"].values() if code is not None]
        found = [sum(code not in (0, 5, 33) for code in codes), len(codes)]
        total = [a + b for a, b in zip(total, found, strict=True)]
        if codes:
            print(words(str(path.relative_to(mutants)).removesuffix(".meta"), *found))
    print(words("all", *total))


def words(name: str, killed: int, tried: int) -> str:
    """A line of the report."""
    return f"{name:40} {killed:5} of {tried:5} killed, {100 * killed / max(tried, 1):5.1f} %"


if __name__ == "__main__":
    main()
