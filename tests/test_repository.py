"""The repository keeps its promises: environments in step, a light and quiet import, layers, small files, clean notebooks."""

from __future__ import annotations

import ast
import hashlib
import importlib.metadata
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import tomllib
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import topokit

ROOT = Path(__file__).parent.parent
CONDA_NAMES = {
    "torch": "pytorch",
    "matplotlib": "matplotlib-base",
    "dask": "dask-core",
    "lightning-fabric": "lightning",
}
CONDA_VERSIONS = {("pybullet", "3.2.7"): "3.25"}  # conda-forge numbers Bullet, PyPI its packaging of it


# Extras that no default environment has: their packages are large, and their doors small.
DOORS = {"pyarrow": "pyarrow", "rerun": "rerun-sdk", "rl": "stable-baselines3"}


def pinned() -> tuple[dict[str, str], dict[str, str]]:
    """The two parts of requirements.txt: what we ask for, and what that needs."""
    asked, needed = (ROOT / "requirements.txt").read_text().split("# What the packages above need")
    lines = [[line for line in part.splitlines()[1:] if line and not line.startswith("#")] for part in (asked, needed)]
    for line in lines[0] + lines[1]:
        assert re.fullmatch(r"[A-Za-z0-9._-]+==[0-9A-Za-z.]+", line), f"not pinned: {line}"
    first, second = (dict(line.lower().split("==") for line in part) for part in lines)
    return first, second


def test_conda_environment_is_in_step_with_requirements():
    asked, _ = pinned()
    entries = yaml.safe_load((ROOT / "environment.yml").read_text())["dependencies"]
    conda = dict(entry.split("=") for entry in entries if entry != "pip")
    assert conda.pop("python") == "3.11"
    expected = {CONDA_NAMES.get(name, name): CONDA_VERSIONS.get((name, v), v) for name, v in asked.items()}
    assert conda == expected


def test_requirements_cover_the_extras():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    wanted = [
        *project["dependencies"],
        *(entry for name in extras if name not in ("all", "bench", *DOORS) for entry in extras[name]),
    ]
    names = {re.split(r"[<>=\[]", entry)[0].lower() for entry in wanted}
    assert names == set(pinned()[0])
    assert pinned()[0]["torch"] == "2.13.0"
    assert "myst-parser" in pinned()[1]  # what the packages need is pinned too


def test_every_pin_but_torchs_has_a_hash():
    """Torch has builds (CPU, CUDA) of several indexes, and is installed after the others."""
    entries = (ROOT / "requirements-hashed.txt").read_text().replace("\\\n", "").splitlines()
    hashed = dict(entry.split(maxsplit=1) for entry in entries)
    pins = [f"{name}=={version}" for part in pinned() for name, version in part.items() if name != "torch"]
    assert sorted(hashed) == sorted(pins)  # where they differ: make hashes
    assert not [pin for pin, hashes in hashed.items() if not re.fullmatch(r"( *--hash=sha256:[0-9a-f]{64})+", hashes)]


def needed(entries: list[str]) -> set[str]:
    """The distributions that these requirements need on this machine, all the way down."""
    todo, found = [Requirement(entry) for entry in entries], set()
    while todo:
        entry = todo.pop()
        extras = entry.extras or {""}
        if (entry.marker and not entry.marker.evaluate()) or (entry.name, *sorted(extras)) in found:
            continue
        found.add((canonicalize_name(entry.name), *sorted(extras)))
        for below in map(Requirement, importlib.metadata.requires(entry.name) or []):
            if below.marker is None or any(below.marker.evaluate({"extra": extra}) for extra in extras):
                below.marker = None
                todo.append(below)
    return {name for name, *_ in found}


@pytest.mark.skipif(sys.platform != "linux", reason="the pins are those of Linux")
def test_all_that_the_pins_need_is_pinned():
    asked, also = pinned()
    missing = needed(list(asked)) - {canonicalize_name(name) for name in asked | also}
    assert not {
        name for name in missing if not name.startswith(("cuda", "nvidia", "triton"))
    }  # torch's own build decides


# Tools and benchmarks may carry a licence that topokit, which is MIT, may not be built on.
COPYLEFT = {"codespell", "docutils", "giotto-ph", "gudhi"}


def is_copyleft(name: str) -> bool:
    """Whether a distribution states the GPL or AGPL; the LGPL may be imported."""
    stated = importlib.metadata.metadata(name)
    classifiers = [entry for entry in stated.get_all("Classifier", []) if entry.startswith("License ::")]
    first_line = stated.get("License", "").partition("\n")[0]  # some give the whole text
    words = " ".join([stated.get("License-Expression", ""), first_line, *classifiers])
    return re.search("(?<!L)GPL|(?<!Lesser )General Public", words) is not None


def installed() -> set[str]:
    return {canonicalize_name(each.name) for each in importlib.metadata.distributions()}


def imported_distributions() -> set[str]:
    """Those that lines of topokit import, wherever these lines stand."""
    nodes = [node for path in (ROOT / "topokit").rglob("*.py") for node in ast.walk(ast.parse(path.read_text()))]
    modules = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    modules |= {node.module for node in nodes if isinstance(node, ast.ImportFrom) and not node.level}
    tops = {module.split(".")[0] for module in modules} - {"topokit", *sys.stdlib_module_names}
    names = {"PIL": "pillow", "mpl_toolkits": "matplotlib", "sklearn": "scikit-learn", **DOORS}
    return {canonicalize_name(names.get(top, top)) for top in tops}


def test_nothing_that_topokit_imports_is_copyleft():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    listed = [entry for name in ("sim", "learn", "data", "sensors", "view") for entry in extras[name]]
    absent = {name for name in {*DOORS.values(), "rclpy"} if name not in installed()}  # rclpy comes with ROS
    below = needed([*project["dependencies"], *listed, *imported_distributions() - absent])
    assert {"numpy", "zarr", "pillow"} <= below
    assert not {name for name in below if name in COPYLEFT or is_copyleft(name)}


def test_the_table_of_licences_is_whole():
    copyleft = {name for name in installed() if is_copyleft(name)}
    assert {"codespell"} <= copyleft <= COPYLEFT
    told = re.findall("[a-z0-9-]+", (ROOT / "CONTRIBUTING.md").read_text().split("## What topokit stands on")[1])
    assert COPYLEFT | imported_distributions() <= set(told)


def test_versions_agree():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert project["version"] == topokit.__version__ == citation["version"]
    assert f"## {topokit.__version__}" in (ROOT / "CHANGELOG.md").read_text()


def test_import_is_light_and_quiet():
    """Modules, not seconds: a test that times is a test that lies on a busy machine."""
    heavy = ["numba", "torch", "pybullet", "trimesh", "matplotlib", "pyvista", "scipy", "pandas", "zarr", "dask"]
    heavy += ["gudhi", "ripser", "sklearn", "gymnasium", "stable_baselines3", "rerun", "rosbags", "networkx"]
    code = f"import sys, topokit; print([name for name in {heavy} if name in sys.modules], file=sys.stderr)"
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == ""
    assert done.stderr.strip() == "[]"


def test_tracking_needs_only_the_core():
    code = """
import sys
for name in "torch pybullet trimesh matplotlib pyvista pandas gudhi".split():
    sys.modules[name] = None
import numpy as np, topokit
angle = np.linspace(0, 6, 30)
states = topokit.track([np.column_stack([np.cos(angle), np.sin(angle)])] * 2, alpha=0.1)
assert [state.loops[0].id for state in states] == [0, 0]
"""
    subprocess.run([sys.executable, "-c", code], check=True)


# Data flows downwards in this list; nothing imports from a line below its own.
LAYERS = [
    {"book"},
    {"_validate", "_archive", "_cores", "_lazy", "_traversal"},
    {"sampling", "linking", "rips"},
    {"state", "mixture", "_evidence", "_matching"},
    {"_frames"},
    {"seqph"},
    {"_follow"},
    {"_config"},
    {"sensors"},
    {"io"},
    {"compat"},
    {"lemmas"},
    {"sim"},
    {"data"},
    {"models"},
    {"control"},
    {"view"},
    {"evaluate"},
    {"_simulate", "cli", "__main__"},
]


def test_modules_import_only_from_earlier_stages():
    level = {name: i for i, names in enumerate(LAYERS) for name in names}
    package = ROOT / "topokit"
    for path in package.rglob("*.py"):
        parts = path.relative_to(package).with_suffix("").parts
        if parts == ("__init__",):
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            for target in imported(node, parts):
                assert level[target] <= level[parts[0]], f"{path.name} imports topokit.{target}, a later stage"


def imported(node: ast.AST, parts: tuple[str, ...]) -> list[str]:
    """First components of the topokit modules that an import statement names."""
    if isinstance(node, ast.Import):
        return [alias.name.split(".")[1] for alias in node.names if alias.name.startswith("topokit.")]
    if not isinstance(node, ast.ImportFrom):
        return []
    if node.level:
        base = (*parts[: len(parts) - node.level], *((node.module or "").split(".") if node.module else ()))
    elif (node.module or "").split(".")[0] == "topokit":
        base = tuple(node.module.split(".")[1:])
    else:
        return []
    return [base[0]] if base else [alias.name for alias in node.names if alias.name != "__version__"]


def tracked_files() -> list[Path]:
    done = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        pytest.skip("not a git checkout")
    return [ROOT / name for name in done.stdout.split("\0") if name and (ROOT / name).is_file()]


def test_files_are_small():
    sizes = {path: path.stat().st_size for path in tracked_files()}
    limit = {".safetensors": 5_000_000}  # a trained checkpoint
    assert not [path for path, size in sizes.items() if size > limit.get(path.suffix, 3_000_000)]
    assert sum(size for path, size in sizes.items() if path.is_relative_to(ROOT / "data_small")) < 25_000_000


def test_manifest_matches_the_data():
    manifest = json.loads((ROOT / "data_small" / "manifest.json").read_text())
    listed = {entry["file"]: entry for entry in manifest["files"]}
    assert set(listed) == {path.name for path in (ROOT / "data_small").glob("*.npz")}
    for name, entry in listed.items():
        assert hashlib.sha256((ROOT / "data_small" / name).read_bytes()).hexdigest() == entry["sha256"], name
        assert {"shape", "units", "seed", "command"} <= set(entry)


def test_chapters_are_stored_clean():
    for path in (ROOT / "notebooks").glob("*.ipynb"):
        cells = json.loads(path.read_text())["cells"]
        code = [cell for cell in cells if cell["cell_type"] == "code"]
        assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code), path.name
        assert all(cell.get("id") for cell in cells), path.name
