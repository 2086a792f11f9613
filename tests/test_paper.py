"""The map of the paper in the book has an entry for each item, and names things that exist."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
MAP = (ROOT / "book" / "paper.md").read_text()
ITEMS = {"Definition": 3, "Assumption": 3, "Lemma": 5, "Corollary": 1, "Algorithm": 1, "Equation": 1, "Figure": 4}


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


def test_every_item_of_the_paper_has_an_entry():
    for item, count in ITEMS.items():
        assert [int(k) for k in re.findall(rf"^{item} (\d)", MAP, re.M)] == list(range(1, count + 1)), item


@pytest.mark.parametrize("name", sorted(set(re.findall(r"`(topokit[\w.]+)`", MAP))))
def test_every_function_of_the_map_exists(name):
    assert resolve(name) is not None
