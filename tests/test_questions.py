"""Questions of the chapters: answers are computed anew from the chapters' own cells, replies help and give nothing away."""

from __future__ import annotations

import json
import logging
import re
from pathlib import Path

import numpy as np
import pytest

from topokit.book import Question, check, questions

ROOT = Path(__file__).parent.parent
ASKED = re.compile(r'^check\("([^"]+)", \.\.\.\)$', re.MULTILINE)


@pytest.fixture(autouse=True)
def warnings_as_they_were():
    """A chapter may silence the simulator; tests that come later want to hear it."""
    logger = logging.getLogger("topokit.sim")
    level = logger.level
    yield
    logger.setLevel(level)


def cells(chapter: int) -> dict[str, str]:
    (path,) = (ROOT / "notebooks").glob(f"{chapter:02}_*.ipynb")
    found = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return {cell["id"]: "".join(cell["source"]) for cell in found if cell["cell_type"] == "code"}


@pytest.mark.parametrize("name", questions())
def test_stored_answers_are_what_their_expressions_compute(name, monkeypatch):
    for needed in ("gudhi", "matplotlib"):
        pytest.importorskip(needed)
    monkeypatch.chdir(ROOT / "notebooks")
    question, scope = questions()[name], {}
    for cell in question.cells:
        exec(cells(question.chapter)[cell], scope)
    answer = eval(question.by, scope)
    assert question._same(answer, question.answer)
    if not isinstance(answer, str):  # the tolerance is the reader's, not ours
        assert abs(answer - question.answer) < 1e-3
    for each in question.wrong:
        assert "by" not in each or question._same(eval(each["by"], scope), each["guess"]), each


@pytest.mark.parametrize("name", questions())
def test_every_question_is_put_once_and_left_open_in_its_chapter(name):
    source = "\n".join(cells(questions()[name].chapter).values())
    assert ASKED.findall(source).count(name) == 1


def test_every_question_that_is_put_is_stored():
    files = sorted((ROOT / "notebooks").glob("*.ipynb"))
    asked = [name for k in range(len(files)) for name in ASKED.findall("\n".join(cells(k).values()))]
    assert sorted(asked) == sorted(questions())
    names = [name for path in (ROOT / "topokit/questions").glob("*.json") for name in json.loads(path.read_text())]
    assert sorted(names) == sorted(questions())  # no name twice


@pytest.mark.parametrize("name", questions())
def test_replies_tell_right_from_wrong_and_do_not_say_the_answer(name):
    question = questions()[name]
    right = check(name, question.answer)
    assert right.right
    assert question.why in right.text
    guesses = [each["guess"] for each in question.wrong]
    guesses += ["what?"] if isinstance(question.answer, str) and not question.choices else list(question.choices or ())
    if not isinstance(question.answer, str):
        guesses += [question.answer + (question.tolerance + 1) * sign for sign in (-1, 1)]
    said = {guess: check(name, guess) for guess in guesses if guess != question.answer}
    assert not any(reply.right for reply in said.values())
    remarks = [reply.text.partition("**Not yet.** ")[2] for reply in said.values()]
    assert len(set(remarks)) == len(remarks) >= 2
    told = re.findall(r"[\w.]+", " ".join(remarks)) if not question.choices else []
    assert str(question.answer) not in told
    assert 1 <= question.level <= 3


def test_a_question_that_nobody_has_answered_is_put():
    reply = check("rooms-1", ...)
    assert reply.right is None
    assert reply.text.startswith(questions()["rooms-1"].question)
    assert "- **b** " in reply.text
    assert "place of `...`" in reply.text
    assert reply._repr_markdown_() == repr(reply) == reply.text


def test_words_are_compared_without_case_and_brackets_and_numbers_with_their_tolerance():
    words = Question(2, 1, "Which edge?", "(1, 3)", "", [], "")
    assert words._same((1, 3), words.answer)
    assert not words._same((1, 4), words.answer)
    assert check("rooms-1", "C").right
    assert check("half-1", np.float64(1.41)).right
    assert not check("half-1", 1.4).right
    assert check("lune-1", 3).text.endswith(questions()["lune-1"].smaller)


def test_what_cannot_be_asked_or_answered_says_so():
    with pytest.raises(ValueError, match="no question 'lune'; there are rectangle-1, ring-1"):
        check("lune", 3)
    with pytest.raises(ValueError, match="'lune-1' asks for a number, and 'four' is none"):
        check("lune-1", "four")
