"""Small point sets on which statements of the paper fail, or on which a constant is seen to be sharp.

Each is given by literal coordinates in the plane, small enough to check by hand; `tests/test_lemmas.py` checks all that their
stories claim. Taught in chapters 3 to 5.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from ._verdict import Check
from ._verify import verify_step

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Counterexample:
    """An instance of a statement.

    Attributes
    ----------
    statement : str
        That it is about, one of `STATEMENTS`.
    story : str
        What it shows.
    before, after : (n, 2) float64
        S_t and S_t+1; the same where nothing moves.
    observed_before, observed_after : (m,) int64
        Vertices seen at t and at t + 1; all of them where the statement has no observation.
    refutes : bool
        Whether the paper's statement fails here, its hypotheses being so. Otherwise the instance shows that a constant is
        sharp, or an assumption cannot hold.
    """

    statement: str
    story: str
    before: Array
    after: Array
    observed_before: NDArray[np.int64]
    observed_after: NDArray[np.int64]
    refutes: bool

    def check(self) -> Check:
        """The statement on this instance."""
        return verify_step(self.before, self.observed_before, self.after, self.observed_after)[self.statement]


def _load() -> Mapping[str, Counterexample]:
    text = resources.files(__package__).joinpath("counterexamples.json").read_text(encoding="utf-8")
    return MappingProxyType({name: _counterexample(**entry) for name, entry in json.loads(text).items()})


def _counterexample(
    statement: str,
    story: str,
    refutes: bool,
    before: list[list[float]],
    after: list[list[float]] | None = None,
    unseen: tuple[int, ...] = (),
    unseen_after: tuple[int, ...] = (),
) -> Counterexample:
    points = np.array(before)
    vertices = np.arange(len(points))
    moved = points if after is None else np.array(after)
    arrays = (points, moved, np.delete(vertices, unseen), np.delete(vertices, unseen_after))
    for array in arrays:
        array.setflags(write=False)
    return Counterexample(statement, story, *arrays, refutes)


COUNTEREXAMPLES = _load()
