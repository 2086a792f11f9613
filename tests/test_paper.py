"""The map of the paper in the book has an entry for each item, and names things that exist."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
MAP = (ROOT / "book" / "paper.md").read_text()


def resolve(name: str) -> object:
    """The thing of a dotted name: the longest module, then attributes."""
    parts = name.split(".")
    for k in range(len(parts), 0, -1):
        try:
            thing = importlib.import_module(".".join(parts[:k]))
        except ModuleNotFoundError:
            continue
        for part in parts[k:]:
            # A field of a dataclass without a default is annotated, and no attribute of the class.
            thing = (
                thing.__annotations__[part] if part in vars(thing).get("__annotations__", {}) else getattr(thing, part)
            )
        return thing
    raise ModuleNotFoundError(name)


@pytest.mark.parametrize("name", sorted(set(re.findall(r"`(topokit[\w.]+)`", MAP))))
def test_every_function_of_the_map_exists(name):
    assert resolve(name) is not None
