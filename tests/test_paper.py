"""The book's map of the paper names things that exist, and links and references lead somewhere."""

from __future__ import annotations

import importlib
import json
import re
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
MAP = (ROOT / "book" / "paper.md").read_text()
ITEMS = {"Definition": 3, "Assumption": 3, "Lemma": 5, "Corollary": 1, "Algorithm": 1, "Equation": 1, "Figure": 4}


def pages() -> dict[str, str]:
    """The text of every chapter and page, by file name."""
    texts = {path.name: path.read_text() for path in (ROOT / "book").glob("*.md")}
    for path in (ROOT / "notebooks").glob("*.ipynb"):
        cells = json.loads(path.read_text())["cells"]
        texts[path.name] = "\n\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "markdown")
    return texts


PAGES = pages()
ALL = "\n".join(PAGES.values())


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


def test_every_link_to_a_chapter_leads_there():
    for page, text in PAGES.items():
        folder = ROOT / ("notebooks" if page.endswith(".ipynb") else "book")
        for link in re.findall(r"\]\(([^)#\s]+\.(?:ipynb|md))[)#]", text):
            assert (ROOT / link[1:] if link.startswith("/") else folder / link).exists(), f"{page}: {link}"


def test_every_chapter_is_in_the_table_of_contents():
    listed = re.findall(r"^/notebooks/(\w+)$", PAGES["index.md"], re.M)
    assert sorted(listed) == sorted(path.stem for path in (ROOT / "notebooks").glob("*.ipynb"))


def test_labels_are_given_once_and_references_have_one():
    given = Counter(re.findall(r"^:label: (\S+)$", ALL, re.M))
    assert max(given.values()) == 1
    assert set(re.findall(r"\{(?:prf:ref|numref)\}`(?:[^`<]*<)?([^`>]+)>?`", ALL)) <= set(given)
