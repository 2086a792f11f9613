"""Packages that import their parts when they are used: PyTorch and PyBullet are not needed for everything.

Idea: the face of a package writes its imports under ``if TYPE_CHECKING:``, where type checkers and readers see them. The same
lines are read here at run time, and each name is imported at its first use.
"""

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


def attach(package: str, path: str, extra: str = "") -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return the `__getattr__`, the `__dir__` and the `__all__` of a face; errors name `extra`, which brings what is missing."""
    tree = ast.parse(Path(path).read_text(encoding="utf-8"))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.level == 1]
    module_of = {alias.name: node.module or "" for node in imports for alias in node.names}
    requirement = f"topokit[{extra}]" if extra else "topokit"

    def __getattr__(name: str) -> Any:
        # A name may be that of a module of the package.
        if name in module_of.values():
            return import_module(f".{name}", package)
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")

        try:
            value = getattr(import_module(f".{module_of[name]}", package), name)
        except ModuleNotFoundError as error:
            if (error.name or "").startswith("topokit"):
                raise
            missing = str(error.name).partition(".")[0]
            command = f"pip install '{requirement}'"
            raise ImportError(f"{package}.{name} needs {missing}: {command}") from error

        setattr(sys.modules[package], name, value)  # the next time Python finds it without asking here
        return value

    names = sorted(module_of)
    return __getattr__, lambda: names, names
