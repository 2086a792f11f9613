"""Questions of the chapters: the reader guesses before running a cell, and learns whether the guess is right.

The questions lie in the folder `questions`, a file for each chapter: `07.json`, or `C.json` for an appendix.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from functools import cache
from numbers import Real
from pathlib import Path
from typing import Any


def label(name: str) -> str | None:
    """Return the number of a chapter, or the letter of an appendix, from the name of its file; None for other names."""
    found = re.match(r"0?(\d+b?)_|appendix_([a-z])_", name)
    if found is None:
        return None
    return found[1] or found[2].upper()


@dataclass(frozen=True)
class Question:
    """A question, its answer, and the replies to wrong guesses. Texts are Markdown."""

    chapter: str  #: the chapter that asks it: its number, or the letter of an appendix
    level: int  #: 1: one idea of the page; 2: two ideas together; 3: a surprise
    question: str  #: the question itself
    answer: float | str  #: a number, the letter of a choice, or a few words
    by: str  #: the expression that computes the answer
    cells: list[str]  #: the cells of the chapter that must have run before
    why: str  #: the reply to a right guess
    choices: dict[str, str] | None = None  #: the choices by their letters
    tolerance: float = 0  #: the largest error of a number that counts as right
    wrong: tuple[dict[str, Any], ...] = ()  #: typical wrong guesses, each with a `remark`; `by` computes the guess
    smaller: str = "It is more."  #: the reply to a number that is too small
    larger: str = "It is less."  #: the reply to a number that is too large

    def same(self, guess: Any, value: Any) -> bool:
        """Return whether two answers agree: words without case and brackets, numbers within the tolerance."""
        if isinstance(self.answer, str):
            return _letters(guess) == _letters(value)
        return abs(float(guess) - value) <= self.tolerance

    def remark(self, guess: Any) -> str:
        """Return the reply to a wrong guess; it does not contain the answer."""
        for typical in self.wrong:
            if self.same(guess, typical["guess"]):
                return str(typical["remark"])
        if isinstance(self.answer, str):
            return "Have another look."
        return self.smaller if guess < self.answer else self.larger


def _letters(words: Any) -> str:
    return "".join(filter(str.isalnum, str(words).casefold()))


@dataclass(frozen=True, repr=False)
class Reply:
    """The reply of `ask`; a notebook shows it as text."""

    right: bool | None  #: None when nothing was guessed
    text: str  #: the question and the reply to the guess, as Markdown

    def __repr__(self) -> str:
        return self.text

    _repr_markdown_ = __repr__


@cache
def questions() -> dict[str, Question]:
    """Return all questions of the book by their names, in the order of the chapters."""
    by_name = {}
    for file in sorted((Path(__file__).parent / "questions").glob("*.json")):
        entries = json.loads(file.read_text(encoding="utf-8"))
        for name, entry in entries.items():
            by_name[name] = Question(chapter=file.stem.removeprefix("0"), **entry)
    return by_name


def ask(name: str, guess: Any) -> Reply:
    """Ask a question, or check a guess and explain a wrong one without giving the answer away.

    Parameters
    ----------
    name : str
        The question's name.
    guess : number or str or Ellipsis
        A number in the units of the question, the letter of a choice, or a few words. The dots ``...`` ask the question.

    Raises
    ------
    ValueError
        If no question has this name, or the question asks for a number and `guess` is not one.

    Examples
    --------
    >>> ask("half-1", 2.83)
    The corners of a square are (0, 0), (2, 0), (2, 2) and (0, 2). At which filtration value does its loop die?
    <BLANKLINE>
    **Not yet.** That is the length of the edge. A filtration value is half of it.
    """
    if name not in questions():
        raise ValueError(f"there is no question {name!r}; there are {', '.join(questions())}")
    question = questions()[name]
    text = question.question
    for letter, choice in (question.choices or {}).items():
        text += f"\n- **{letter}** {choice}"
    if guess is ...:
        return Reply(None, f"{text}\n\nWrite your guess in place of `...` and run the cell again.")
    if not isinstance(question.answer, str) and not isinstance(guess, Real):
        raise ValueError(f"{name!r} asks for a number, and {guess!r} is none")
    right = question.same(guess, question.answer)
    verdict = f"**Right.** {question.why}" if right else f"**Not yet.** {question.remark(guess)}"
    return Reply(right, f"{text}\n\n{verdict}")
