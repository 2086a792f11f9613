"""Test the questions of the chapters: stored answers are computed anew from the chapters' own cells."""

from __future__ import annotations

import json
import logging
import re
from pathlib import Path

import pytest

from chapter_tools.quiz import label, questions

ROOT = Path(__file__).parent.parent
CHAPTERS = {label(path.name): path for path in sorted((ROOT / "notebooks").glob("*.ipynb"))}
ASKED = re.compile(r'^ask\("([^"]+)", \.\.\.\)$', re.MULTILINE)


@pytest.fixture(autouse=True)
def loud_simulator():
    """Restore the level of a log that a chapter may silence."""
    logger = logging.getLogger("topokit.sim")
    level = logger.level
    yield
    logger.setLevel(level)


def code_cells(chapter: str) -> dict[str, str]:
    cells = json.loads(CHAPTERS[chapter].read_text(encoding="utf-8"))["cells"]
    return {cell["id"]: "".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"}


@pytest.mark.parametrize("name", questions())
def test_stored_answers_are_what_their_expressions_compute(name, monkeypatch):
    for package in ("gudhi", "matplotlib"):
        pytest.importorskip(package)
    monkeypatch.chdir(ROOT / "notebooks")
    question = questions()[name]
    scope = {}
    for cell in question.cells:
        exec(code_cells(question.chapter)[cell], scope)
    answer = eval(question.by, scope)
    assert question.same(answer, question.answer)
    if not isinstance(answer, str):  # the tolerance is for readers
        assert abs(answer - question.answer) < 1e-3
    for typical in question.wrong:
        if "by" in typical:
            assert question.same(eval(typical["by"], scope), typical["guess"])


def test_the_chapters_ask_each_question_once():
    asked = {k: ASKED.findall("\n".join(code_cells(k).values())) for k in CHAPTERS}
    stored = {k: [name for name, question in questions().items() if question.chapter == k] for k in asked}
    assert {k: sorted(names) for k, names in asked.items()} == {k: sorted(names) for k, names in stored.items()}
