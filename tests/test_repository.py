"""The repository keeps its promises: versions in step, a light import, layers, licences, small files, clean notebooks."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import tomllib
import yaml
from packaging.requirements import Requirement

import topokit

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "topokit"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
LOCKS = [ROOT / "requirements.txt", ROOT / "requirements-torch.txt"]
PYPI_NAMES = {"pytorch": "torch", "matplotlib-base": "matplotlib"}


def locked() -> dict[str, str]:
    """Return the version of every package of the locks by name."""
    return dict(re.findall(r"^([A-Za-z0-9._-]+)==(\S+)", "".join(map(Path.read_text, LOCKS)), re.MULTILINE))


def requirements() -> list[Requirement]:
    """Return all that the library, its extras and JupyterLab ask for."""
    entries = [*PROJECT["project"]["dependencies"], *PROJECT["dependency-groups"]["lab"]]
    extras = PROJECT["project"]["optional-dependencies"]
    entries += [entry for name, extra in extras.items() if name != "all" for entry in extra]
    return [Requirement(entry) for entry in entries]


def test_the_lock_has_what_is_asked_for():
    for requirement in requirements():
        assert locked()[requirement.name] in requirement.specifier, requirement
    assert PROJECT["dependency-groups"]["torch"] == [f"torch=={locked()['torch']}"]


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


def test_versions_agree():
    version = PROJECT["project"]["version"]
    assert version == topokit.__version__
    assert version == yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"]
    assert f"## {version}" in (ROOT / "CHANGELOG.md").read_text()


# Data flows downwards in this list; nothing imports from a line below its own. Underscored modules at the top of the
# library are private to it, and all of it may use them.
LAYERS = [
    {"_validate", "_archive", "_cores", "_lazy", "_geometry", "_processes", "_config"},
    {"sampling", "linking", "rips"},
    {"seqph"},
    {"mixture"},
    {"io"},
    {"sensors"},
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
