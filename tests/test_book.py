"""Test the book's extension of Sphinx: its list of chapters has each file once, and results are found by their paths."""

from __future__ import annotations

import importlib
import json
import re
from pathlib import Path

import pytest

pytest.importorskip("sphinx", reason="the book's extension needs Sphinx: pip install 'topokit[book]'")
ROOT = Path(__file__).resolve().parent.parent
CHAPTERS = sorted((ROOT / "notebooks").glob("*.ipynb"))
LINK = re.compile(r"\[[^][]*?\b[Cc]hapters?\s+(\d+)[^][]*\]\([^()]*?(\d+)_\w+\.ipynb[^()]*\)")


@pytest.fixture(scope="module")
def book():
    """Import a script of the folder book by its name."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "book")
        yield importlib.import_module


def test_links_to_chapters_name_the_number_of_their_file():
    for path in [ROOT / "README.md", ROOT / "book" / "index.md", *CHAPTERS]:
        text = path.read_text(encoding="utf-8")
        if path in CHAPTERS:
            text = "\n".join("".join(cell["source"]) for cell in json.loads(text)["cells"])
        for named, number in LINK.findall(text):
            assert int(named) == int(number), path.name


def test_a_result_is_found_by_its_path_and_a_star_is_a_sum(book):
    results = {"rows": [{"hung": 3}, {"hung": 4}]}
    assert book("shell")._at(results, ["rows", "1", "hung"]) == 4
    assert book("shell")._at(results, ["rows", "*", "hung"]) == 7
    with pytest.raises(KeyError):
        book("shell")._at(results, ["row"])
