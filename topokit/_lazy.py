"""Packages that import their parts when they are used: PyTorch, Zarr, Dask and PyBullet are not needed for everything."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def attach(package: str, modules: Mapping[str, str], extra: str) -> Callable[[str], Any]:
    """Return a `__getattr__` for a package.

    Parameters
    ----------
    package : str
        Its `__name__`.
    modules : mapping of str to str
        Its modules, and the names in each that it shows, with spaces between them.
    extra : str
        What to install when one of them needs a package that is missing: ``pip install 'topokit[extra]'``.
    """
    where = {name: module for module, names in modules.items() for name in names.split()}

    def __getattr__(name: str) -> Any:
        if name not in where:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        try:
            return getattr(import_module(f".{where[name]}", package), name)
        except ModuleNotFoundError as error:
            if (error.name or "").startswith("topokit"):
                raise
            raise ImportError(f"{package}.{name} needs {error.name}: pip install 'topokit[{extra}]'") from error

    return __getattr__
