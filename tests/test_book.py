"""Test the book's extension of Sphinx: numbers of chapters, links, cards, drawings, results, questions, the page for paper."""

from __future__ import annotations

import importlib
import json
import re
from pathlib import Path

import pytest

from chapter_tools.quiz import label

pytest.importorskip("sphinx", reason="the book's extension needs Sphinx: pip install 'topokit[book]'")
ROOT = Path(__file__).resolve().parent.parent
CHAPTERS = sorted((ROOT / "notebooks").glob("*.ipynb"))
NUMBER = re.compile(r"\b[Cc]hapters?\s+(\d+)")
LINK = re.compile(r"\[([^][]*)\]\([^()]*?(\d+)_\w+\.ipynb[^()]*\)")


@pytest.fixture(scope="module")
def book():
    """Import a script of the folder book by its name."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "book")
        yield importlib.import_module


def prose() -> dict[str, str]:
    """Return the text of README, the first page and the chapters without code."""
    pages = {name: (ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "book/index.md")}
    for path in CHAPTERS:
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        pages[path.name] = "\n\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "markdown")
    return {name: re.sub(r"`[^`]*`", "", text) for name, text in pages.items()}


# ---- chapters and their numbers


def test_links_to_chapters_name_the_number_of_their_file():
    for page, text in prose().items():
        for words, number in LINK.findall(text):
            named = NUMBER.search(words)
            assert not named or int(named[1]) == int(number), f"{page}: {words}"


@pytest.mark.parametrize("page", ["README.md", "book/index.md"])
def test_every_chapter_called_by_its_number_is_a_link(page):
    assert not NUMBER.findall(LINK.sub("", prose()[page]))


def test_chapters_are_numbered_without_a_gap_and_listed_in_order(book):
    names = [path.stem for path in CHAPTERS]
    labels = [label(name) for name in names]
    numbers = [int(name) for name in labels if name.isdigit()]
    letters = ["A", *(name for name in labels if not name.isdigit())]  # appendix A is a page of prose
    assert numbers == list(range(len(numbers)))
    assert letters == list("ABCDEFGH"[: len(letters)])
    assert (
        re.findall(r"^/notebooks/(\w+)$", (ROOT / "book/index.md").read_text(encoding="utf-8"), re.MULTILINE) == names
    )
    topics = dict(book("cards").TOPICS.findall((ROOT / "book" / "chapters.md").read_text(encoding="utf-8")))
    assert sorted(topics) == [f"notebooks/{name}" for name in names]


# ---- results, questions, paper


def test_a_result_is_found_by_its_path_and_a_star_is_a_sum(book):
    results = {"rows": [{"hung": 3}, {"hung": 4}]}
    assert book("shell")._at(results, ["rows", "1", "hung"]) == 4
    assert book("shell")._at(results, ["rows", "*", "hung"]) == 7
    with pytest.raises(KeyError):
        book("shell")._at(results, ["row"])
