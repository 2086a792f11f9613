"""The repository keeps its promises: versions in step, a light import, layers, licences, small files, clean notebooks."""

from __future__ import annotations

import ast
import importlib
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
PACKAGE = ROOT / "topokit"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
LOCKS = [ROOT / "requirements.txt", ROOT / "requirements-torch.txt"]
EXTRAS = PROJECT["project"]["optional-dependencies"]
PYPI_NAMES = {"pytorch": "torch", "matplotlib-base": "matplotlib", "dask-core": "dask", "lightning": "lightning-fabric"}


def locked() -> dict[str, str]:
    """Return the version of every package of the locks by name."""
    return dict(re.findall(r"^([A-Za-z0-9._-]+)==(\S+)", "".join(map(Path.read_text, LOCKS)), re.MULTILINE))


def requirements() -> list[Requirement]:
    """Return all that the library, its extras and JupyterLab ask for."""
    entries = [*PROJECT["project"]["dependencies"], *PROJECT["dependency-groups"]["lab"]]
    for name, extra in EXTRAS.items():
        if name != "all":
            entries += extra
    return [Requirement(entry) for entry in entries]


def test_the_lock_has_what_is_asked_for_and_what_that_needs():
    for requirement in requirements():
        assert locked()[requirement.name] in requirement.specifier, requirement
    assert not needed(map(str, requirements())) - {canonicalize_name(name) for name in locked()}
    assert PROJECT["dependency-groups"]["torch"] == [f"torch=={locked()['torch']}"]


@pytest.mark.parametrize("lock", LOCKS, ids=str)
def test_every_entry_of_the_locks_has_hashes(lock):
    for entry in lock.read_text().replace("\\\n", "").splitlines():
        assert entry.startswith("#") or re.fullmatch(r"\S+==\S+( ;[^-]*)?( *--hash=sha256:[0-9a-f]{64})+", entry), entry


def test_actions_of_workflows_are_pinned_by_commit():
    workflows = "".join(path.read_text() for path in (ROOT / ".github" / "workflows").glob("*.yml"))
    for action in re.findall("uses: (.*)", workflows):
        assert re.fullmatch(r"actions/[a-z-]+@[0-9a-f]{40} # v[0-9.]+", action), action


def test_conda_has_the_same_versions():
    entries = yaml.safe_load((ROOT / "environment.yml").read_text())["dependencies"]
    conda = dict(entry.split("=") for entry in entries if "=" in entry)
    assert conda.pop("python") == "3.11"
    assert conda.pop("pybullet") == "3.25"  # Bullet's own number; PyPI packages the same release as 3.2.7
    versions = locked()
    names = {PYPI_NAMES.get(name, name) for name in conda} | {"pybullet"}
    assert names == {requirement.name for requirement in requirements()}
    for name, version in conda.items():
        assert version == versions[PYPI_NAMES.get(name, name)], name


def needed(entries) -> set[str]:
    """Return the distributions that these requirements need on this machine, all the way down."""
    todo = [Requirement(entry) for entry in entries]
    found = set()
    while todo:
        entry = todo.pop()
        extras = entry.extras or {""}
        key = (canonicalize_name(entry.name), *sorted(extras))
        if key in found or (entry.marker and not entry.marker.evaluate()):
            continue
        found.add(key)
        try:
            below = importlib.metadata.requires(entry.name) or []
        except importlib.metadata.PackageNotFoundError:  # JupyterLab comes with `make lab` alone
            continue
        for requirement in map(Requirement, below):
            if requirement.marker is None or any(requirement.marker.evaluate({"extra": extra}) for extra in extras):
                requirement.marker = None
                todo.append(requirement)
    return {name for name, *_ in found}


def is_copyleft(name: str) -> bool:
    """Return True when a distribution states the GPL or AGPL; the LGPL may be imported."""
    stated = importlib.metadata.metadata(name)
    classifiers = [entry for entry in stated.get_all("Classifier", []) if entry.startswith("License ::")]
    first_line = stated.get("License", "").partition("\n")[0]  # some give the whole text
    words = " ".join([stated.get("License-Expression", ""), first_line, *classifiers])
    return re.search("(?<!L)GPL|(?<!Lesser )General Public", words) is not None


def test_nothing_that_topokit_imports_is_copyleft():
    runtime = [entry for name in ("sim", "learn", "data", "sensors", "view") for entry in EXTRAS[name]]
    below = needed([*PROJECT["project"]["dependencies"], *runtime])
    assert {"numpy", "torch", "pillow"} <= below
    assert not {name for name in below if is_copyleft(name)}
    assert is_copyleft("codespell")  # a tool; the check sees it


def test_versions_agree():
    version = PROJECT["project"]["version"]
    assert version == topokit.__version__
    assert version == yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"]
    assert f"## {version}" in (ROOT / "CHANGELOG.md").read_text()


def test_import_is_light_and_quiet():
    """Count modules, not seconds: a test that times fails on a busy machine."""
    heavy = ["numba", "torch", "pybullet", "trimesh", "matplotlib", "scipy", "pandas", "dask"]
    heavy += ["gudhi", "ripser", "sklearn", "gymnasium", "rosbags", "networkx"]
    code = f"import sys, topokit; print([name for name in {heavy} if name in sys.modules], file=sys.stderr)"
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == ""
    assert done.stderr.strip() == "[]"


# Data flows downwards in this list; nothing imports from a line below its own. Underscored modules at the top of the
# library are private to it, and all of it may use them.
LAYERS = [
    {
        "_strangers",
        "_validate",
        "_archive",
        "_ply",
        "_cores",
        "_lazy",
        "_geometry",
        "_processes",
        "_config",
    },
    {"sampling", "linking", "rips", "_opening"},
    {"mixture"},
    {"seqph"},
    {"sensors"},
    {"io"},
    {"lemmas"},
    {"sim"},
    {"data"},
    {"models"},
    {"control", "evaluate"},
    {"view"},
    {"cli", "__main__"},
]


def imports() -> list[tuple[str, tuple[str, ...], tuple[str, ...]]]:
    """Return every import of a topokit module: file, path of the importing module, path of what is imported."""
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        for node in ast.walk(ast.parse(path.read_text())):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                base = ".".join(("topokit", *parts[: len(parts) - node.level])) if node.level else ""
                module = ".".join(part for part in (base, node.module) if part)
                names = [f"{module}.{alias.name}" for alias in node.names]
            ours = [name.split(".")[1:] for name in names if name.startswith("topokit.")]
            found += [(str(path), parts, tuple(target)) for target in ours]
    return found


def test_modules_import_only_from_their_layer_or_an_earlier_one():
    layer = {name: i for i, names in enumerate(LAYERS) for name in names}
    for path, parts, target in imports():
        if parts != ("__init__",) and target[0] != "__version__":
            assert layer[target[0]] <= layer[parts[0]], f"{path} imports topokit.{target[0]}, of a later layer"


def test_no_package_imports_another_packages_private_module():
    for path, parts, target in imports():
        own = target[0] == parts[0] or len(target) == 1 or target[0].startswith("_")
        assert own or not any(part.startswith("_") for part in target[1:]), f"{path} imports topokit.{'.'.join(target)}"


def test_packages_show_few_names():
    """Count the names that the packages show: what a reader of the library has to know. 130 is the aim."""
    names = set()
    for path in [*PACKAGE.glob("*.py"), *PACKAGE.glob("*/__init__.py")]:
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        if not path.stem.startswith("_") or path.stem == "__init__":
            names |= set(getattr(importlib.import_module(name), "__all__", []))
    assert len(names) <= 144


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


def test_chapters_are_stored_without_outputs():
    for path in (ROOT / "notebooks").glob("*.ipynb"):
        cells = json.loads(path.read_text())["cells"]
        code = [cell for cell in cells if cell["cell_type"] == "code"]
        assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code), path.name
        assert all(cell.get("id") for cell in cells), path.name
