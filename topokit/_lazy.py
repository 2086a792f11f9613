"""Packages that import their parts when they are used: PyTorch, Zarr, Dask and PyBullet are not needed for everything."""

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


def shown(path: str) -> dict[str, str]:
    """What a package shows, and in which of its modules it is: all that the file `path` imports from its own modules."""
    tree = ast.parse(Path(path).read_text(encoding="utf-8"))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.level == 1]
    return {alias.name: node.module or "" for node in imports for alias in node.names}


def attach(package: str, path: str, extra: str = "") -> tuple[Callable[[str], Any], list[str]]:
    """`__getattr__` and `__all__` of a package: what it imports under ``if TYPE_CHECKING:`` is imported when used.

    When something is missing that it needs, the error tells to ``pip install 'topokit[extra]'``; an extra "*" is one of the
    name of what is missing.
    """
    where, wanted = shown(path), f"topokit[{extra}]" if extra else "topokit"

    def __getattr__(name: str) -> Any:
        if name in where.values():
            return import_module(f".{name}", package)
        if name not in where:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        try:
            value = getattr(import_module(f".{where[name]}", package), name)
        except ModuleNotFoundError as error:
            if (error.name or "").startswith("topokit"):
                raise
            need = str(error.name).partition(".")[0]
            raise ImportError(f"{package}.{name} needs {need}: pip install '{wanted.replace('*', need)}'") from error
        setattr(sys.modules[package], name, value)  # the next time Python finds it without asking here
        return value

    return __getattr__, sorted(where)
