"""Small point sets on which statements of the paper fail, or on which a constant is seen to be sharp.

Each is given by literal coordinates in the plane, small enough to check by hand; `tests/test_lemmas.py` checks all that their
stories claim. Taught in chapters 3 to 5.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from ._diagrams import feature_approximation, gates, observability, temporal_persistence
from ._killers import corollary, recovering_killers, regularity_of_killers
from ._verdict import Check

__all__ = ["COUNTEREXAMPLES", "Counterexample"]

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
        s, later, o, o_later = self.before, self.after, self.observed_before, self.observed_after
        checks = {
            "feature approximation": lambda: feature_approximation(s, o),
            "observability": lambda: observability(s, o),
            "temporal persistence": lambda: temporal_persistence(s, later),
            "gates": lambda: gates(s, o, later, o_later),
            "recovering killers": lambda: recovering_killers(s, o),
            "regularity of killers": lambda: regularity_of_killers(s, later),
            "corollary": lambda: corollary(s, o, later, o_later),
        }
        return checks[self.statement]()


def _make(
    statement: str,
    story: str,
    before: list[tuple[float, float]],
    *,
    after: list[tuple[float, float]] | None = None,
    unseen: tuple[int, ...] = (),
    unseen_after: tuple[int, ...] = (),
    refutes: bool = True,
) -> Counterexample:
    points = np.array(before, dtype=np.float64)
    everything = np.arange(len(points))
    later = points if after is None else np.array(after, dtype=np.float64)
    seen, seen_after = (np.setdiff1d(everything, gone) for gone in (unseen, unseen_after))
    for array in (points, later, seen, seen_after):
        array.setflags(write=False)
    return Counterexample(statement, story, points, later, seen, seen_after, refutes)


# Vertices 1 to 5 of a hexagon with radii 0.95 and 1 by turns.
_HEXAGON = [
    (0.5, 3**0.5 / 2),
    (-0.475, 0.475 * 3**0.5),
    (-1.0, 0.0),
    (-0.475, -0.475 * 3**0.5),
    (0.5, -(3**0.5) / 2),
]
_SQUARES = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (10.0, 0.0), (11.0, 0.0), (11.0, 1.01), (10.0, 1.01)]


def _ring(apart: float) -> list[tuple[float, float]]:
    """A ring whose lower side is 0, 1, 2, 3 in a row, 0 and 1 moved to the left and 2 and 3 to the right."""
    left, right = [(-0.75, 0.0), (-0.5, 0.0)], [(0.5, 0.0), (0.75, 0.0)]
    side = [(1.6, 0.5), (1.6, 1.45), (0.8, 2.05), (0.0, 2.5), (-0.8, 2.05), (-1.6, 1.45), (-1.6, 0.5)]
    return [(x - apart, y) for x, y in left] + [(x + apart, y) for x, y in right] + side


COUNTEREXAMPLES: Mapping[str, Counterexample] = MappingProxyType(
    {
        "a loop without an image": _make(
            "feature approximation",
            "The unit square and three of its corners, alpha = 1: S has a loop from 0.5 to 0.707, O has none at any scale. "
            "Lemma 4, which leaves out that the lifetime must exceed alpha, finds no counterpart either.",
            [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)],
            unseen=(3,),
        ),
        "a loop that goes unseen": _make(
            "observability",
            "The threshold alpha is sharp: a loop of lifetime 0.9996 alpha, and without the last two vertices none at all.",
            [
                (0.625, 0.343),
                (0.071, 1.479),
                (-1.032, 1.464),
                (-1.461, 0.173),
                (-1.207, -0.461),
                (1.710, -1.663),
                (0.763, -0.112),
                (0.940, -0.636),
                (-0.912, -0.413),
                (0.470, -0.171),
            ],
            unseen=(8, 9),
            refutes=False,
        ),
        "a gate that is tight": _make(
            "gates",
            "At t all is seen, and the longest side of the ring is {1, 2}. At t + 1 vertices 1 and 2 are unseen, alpha = 0.25 "
            "from their neighbours 0 and 3, which have moved apart by epsilon = 0.05 each: the birth is alpha + epsilon later.",
            _ring(0.0),
            after=_ring(0.05),
            unseen_after=(1, 2),
            refutes=False,
        ),
        "a loop that four points lose": _make(
            "temporal persistence",
            "A loop of lifetime 0.050 is gone after a motion of at most 0.0343: ratio 1.46. Four points cannot do much better: "
            "birth edge and killer share a vertex, which has to serve both, and the ratio stays below 1.5.",
            [(0.0, 0.55), (-0.835, 0.0), (0.0, -0.55), (0.834, 0.0)],
            after=[(0.0303, 0.5338), (-0.8633, -0.0192), (0.0, -0.5157), (0.834, 0.0)],
        ),
        "a loop that five points lose": _make(
            "temporal persistence",
            "A loop from 0.5 to 0.7 is gone after a motion of 0.101: ratio 1.98, and 2 is the supremum. Birth edge {0, 1} and "
            "killer {2, 4} have no vertex in common; each changes by 2 epsilon in length.",
            [(0.0, 1.2099), (0.7640, 0.5646), (0.0, 0.0), (-0.9455, 0.0920), (-0.9350, 1.0420)],
            after=[
                (-0.077161, 1.275072),
                (0.841161, 0.499428),
                (-0.067457, 0.075177),
                (-0.9455, 0.0920),
                (-0.867543, 0.966823),
            ],
        ),
        "killers two beta apart": _make(
            "corollary",
            "Nothing moves; alpha = 0.028, beta = 0.781. S has one loop, with the killer {1, 6}. Without vertex 6 the killer is "
            "{0, 4}, without vertex 4 it is {2, 6}: 1.516 apart, where the paper allows 2 alpha + beta = 0.838.",
            [(0.96, 0.10), (0.46, 0.70), (-0.26, 1.00), (-1.18, 0.20), (-0.52, -0.60), (0.54, -1.04), (-0.50, -0.62)],
            unseen=(6,),
            unseen_after=(4,),
        ),
        "two squares": _make(
            "recovering killers",
            "Two loops that die within 0.004 of each other. With any alpha above that the killer of one is an edge that "
            "Assumption 3 wants within beta of the other's, and more than 2 alpha + beta + epsilon away from it. Here alpha is "
            "0.02, from the last vertex, which is not seen.",
            [*_SQUARES, (-0.02, 0.0)],
            unseen=(8,),
            refutes=False,
        ),
        "the diagonal of a square": _make(
            "regularity of killers",
            "A motion of 1e-9 makes the other diagonal the killer. Lemma 5 holds, because beta is that large.",
            [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)],
            after=[(1.0 + 1e-9, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)],
            refutes=False,
        ),
        "the sides of a hexagon": _make(
            "regularity of killers",
            "Radii 0.95 and 1 by turns. Moving vertex 0 by 2e-9 along the tangent makes {0, 4} the killer instead of {0, 2}: a "
            "jump by 1.645, the killer's whole length. The thick killer triangle is {0, 2, 4} before and after.",
            [(0.95, -1e-9), *_HEXAGON],
            after=[(0.95, 1e-9), *_HEXAGON],
            refutes=False,
        ),
    }
)
