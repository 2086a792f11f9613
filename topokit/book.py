"""Questions of the chapters, from ``topokit/questions``: guess before you run, and hear whether the guess is right."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from numbers import Real
from pathlib import Path
from typing import Any

__all__ = ["Question", "Reply", "check", "questions"]


@dataclass(frozen=True)
class Question:
    """A question, its answer, and what to say to those who guess something else. Texts are Markdown."""

    chapter: int  #: where it is asked
    level: int  #: 1: one idea of the page; 2: two ideas together; 3: a surprise
    question: str  #: what is asked
    answer: float | str  #: a number, the letter of a choice, or a few words
    by: str  #: the expression that computes the answer...
    cells: list[str]  #: ...when these cells of the chapter have run
    why: str  #: told when the guess is right
    choices: dict[str, str] | None = None  #: by their letters
    tolerance: float = 0  #: by how much a number may be off
    wrong: tuple[dict[str, Any], ...] = ()  #: typical guesses, each with a `remark`; `by` computes it
    smaller: str = "It is more."  #: told when a number is too small
    larger: str = "It is less."  #: told when a number is too large

    def _same(self, guess: Any, value: Any) -> bool:
        """Whether two answers are the same: words without case and brackets, numbers within the tolerance."""
        if not isinstance(self.answer, str):
            return abs(float(guess) - value) <= self.tolerance
        guess, value = ("".join(filter(str.isalnum, str(words).casefold())) for words in (guess, value))
        return bool(guess == value)

    def _remark(self, guess: Any) -> str:
        """What to say about a wrong guess; the answer is not in it."""
        known = [each["remark"] for each in self.wrong if self._same(guess, each["guess"])]
        if known or isinstance(self.answer, str):
            return str(known[0]) if known else "Have another look."
        return self.smaller if guess < self.answer else self.larger


@dataclass(frozen=True, repr=False)
class Reply:
    """What `check` says; a notebook shows it as text."""

    right: bool | None  #: None where nothing was guessed
    text: str  #: Markdown: the question, and what is to be said about the guess

    def __repr__(self) -> str:
        return self.text

    _repr_markdown_ = __repr__


@cache
def questions() -> dict[str, Question]:
    """Return all questions of the book by their names, in the order of the chapters."""
    files = sorted((Path(__file__).parent / "questions").glob("*.json"))
    found = {int(file.stem): json.loads(file.read_text(encoding="utf-8")) for file in files}
    return {name: Question(chapter=k, **entry) for k, entries in found.items() for name, entry in entries.items()}


def check(name: str, guess: Any) -> Reply:
    """Say whether a guess is right, and if not, what may have gone wrong; the answer is not given away.

    Parameters
    ----------
    name : str
        The question's name.
    guess : number or str or Ellipsis
        A number in the units of the question, the letter of a choice, a few words; the dots ``...`` put the question.

    Raises
    ------
    ValueError
        If no question has this name, or a number is asked for and `guess` is none.

    Examples
    --------
    >>> check("half-1", 2.83)
    The corners of a square are (0, 0), (2, 0), (2, 2) and (0, 2). At which filtration value does its loop die?
    <BLANKLINE>
    **Not yet.** That is the length of the edge. A filtration value is half of it.
    """
    if name not in questions():
        raise ValueError(f"there is no question {name!r}; there are {', '.join(questions())}")
    asked = questions()[name]
    text = asked.question + "".join(f"\n- **{key}** {choice}" for key, choice in (asked.choices or {}).items())
    if guess is ...:
        return Reply(None, f"{text}\n\nWrite your guess in place of `...` and run the cell again.")
    if not isinstance(asked.answer, str) and not isinstance(guess, Real):
        raise ValueError(f"{name!r} asks for a number, and {guess!r} is none")
    right = asked._same(guess, asked.answer)
    verdict = f"**Right.** {asked.why}" if right else f"**Not yet.** {asked._remark(guess)}"
    return Reply(right, f"{text}\n\n{verdict}")
