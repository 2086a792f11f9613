"""All statements on one step, and small literal instances on which a statement fails or a constant is seen to be sharp.

Taught in chapters 3 to 5.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources

import numpy as np
from numpy.typing import ArrayLike

from .._validate import Array, Ids
from ._diagrams import feature_approximation, gates, observability, temporal_persistence
from ._killers import converse, corollary, recovering_killers, regularity_of_killers
from ._step import Check, as_step


def verify_step(
    before: ArrayLike, observed_before: ArrayLike, after: ArrayLike, observed_after: ArrayLike
) -> dict[str, Check]:
    """Check all statements on two states in succession, in the paper's order; those about one state on the first.

    Parameters
    ----------
    before, observed_before, after, observed_after
        As in `gates`.
    """
    step = as_step(before, observed_before, after, observed_after)
    on_diagrams = (feature_approximation, observability, temporal_persistence, gates)
    on_killers = (recovering_killers, regularity_of_killers, corollary, converse)
    checks = [statement(step) for statement in (*on_diagrams, *on_killers)]
    return {check.statement: check for check in checks}


@dataclass(frozen=True, eq=False)
class Counterexample:
    """An instance in the plane, small enough to check by hand, on which a statement fails or a constant is seen to be sharp."""

    statement: str  #: that it is about, by its name in `verify_step`
    story: str  #: what it shows
    before: Array  #: (n, 2) S_t
    after: Array  #: (n, 2) S_t+1; the same where nothing moves
    observed_before: Ids  #: (m,) vertices seen at t; all of them where the statement has no observation
    observed_after: Ids  #: (k,) vertices seen at t + 1
    #: Whether the paper's statement fails here, its hypotheses being so. Otherwise the instance shows that a constant is
    #: sharp, or an assumption cannot hold.
    refutes: bool

    def check(self) -> Check:
        """Check the statement on this instance."""
        return verify_step(self.before, self.observed_before, self.after, self.observed_after)[self.statement]


def _read() -> Mapping[str, Counterexample]:
    """Return the instances of the file beside this module; where it does not say so, nothing moves and all is seen."""
    text = resources.files(__package__).joinpath("counterexamples.json").read_text(encoding="utf-8")
    instances = {}
    for name, entry in json.loads(text).items():
        before = np.array(entry["before"])
        after = np.array(entry.get("after", entry["before"]))
        everything = np.arange(len(before))
        observed_before = np.delete(everything, entry.get("unseen", ()))
        observed_after = np.delete(everything, entry.get("unseen_after", ()))
        for array in (before, after, observed_before, observed_after):
            array.setflags(write=False)
        instances[name] = Counterexample(
            entry["statement"], entry["story"], before, after, observed_before, observed_after, entry["refutes"]
        )
    return instances


COUNTEREXAMPLES = _read()
