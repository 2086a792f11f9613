"""Which loop of a frame is which of the loops known before: minimum-cost assignments, and the gates of seqPH."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from topokit.rips import Diagram
from topokit.sampling import hausdorff_table

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Candidates:
    """What a matching sees: the n loops found in a frame and the m known from before."""

    birth: Array  #: (n,)
    death: Array  #: (n,)
    places: Array  #: (n, p, d) where they are, by the tracker's `identity`: two ends of an edge, or one point
    known_birth: Array  #: (m,)
    known_death: Array  #: (m,)
    known_places: Array  #: (m, p, d)
    motion: Array  #: (m,) how far the scene may have moved since each was seen, the sum of the steps' epsilon
    alpha: float  #: of this step
    beta: float | Array  #: of this step, or (n, m) of each pair

    def changes(self) -> tuple[Array, Array]:
        """(n, m) changes of birth and of death between every found loop and every known one."""
        birth = np.abs(self.birth[:, None] - self.known_birth)
        return birth, np.abs(self.death[:, None] - self.known_death)

    def part(self, found: list[int], known: list[int]) -> Candidates:
        """Return what a matching of these found loops and these known ones sees.

        Parameters
        ----------
        found, known : lists of int
        """
        beta = self.beta if np.ndim(self.beta) == 0 else np.asarray(self.beta)[np.ix_(found, known)]
        here = (self.birth[found], self.death[found], self.places[found])
        there = (self.known_birth[known], self.known_death[known], self.known_places[known], self.motion[known])
        return Candidates(*here, *there, self.alpha, beta)


@dataclass(frozen=True, eq=False)
class Known:
    """What may be found again: where it was, how far the scene has moved since, for how many frames; a loop once believed in."""

    birth: float
    death: float
    place: Array  #: (p, d) for the tracker's identity
    killer_edge: Array  #: (2, d)
    belief: float
    id: int | None  #: None as long as it is not believed to be a loop
    motion: float = 0.0
    missed: int = 0


def candidates_of(
    diagram: Diagram, found: list[int], places: list[Array], known: list[Known], sizes: tuple[float, Array | float]
) -> Candidates:
    """What a matching sees of loops of a diagram and of known ones; `sizes` are alpha and beta."""
    parts = ("birth", "death", "place", "motion")
    births, deaths, there, motion = (np.array([getattr(one, part) for one in known]) for part in parts)
    here = (diagram.birth[found], diagram.death[found], np.array(places))
    return Candidates(*here, births, deaths, there, motion, *sizes)


MatchRule = Callable[[Candidates], Iterable[tuple[int, int]]]


def assign(cost: Array, allowed: NDArray[np.bool_] | None = None) -> list[tuple[int, int]]:
    """Match as many rows and columns as possible, at the least total cost among such matchings.

    Parameters
    ----------
    cost : (n, m) float64
        Not negative where `allowed` is given.
    allowed : (n, m) bool, optional
        Pairs that may be matched; all of them when not given.

    Notes
    -----
    A forbidden pair costs more than all allowed ones together, so the Hungarian algorithm takes one only where it has no
    choice, and those are dropped: unlike infinite entries this cannot make the problem infeasible.
    """
    from scipy.optimize import linear_sum_assignment  # here, because importing topokit must be quick

    if allowed is None:
        allowed = np.ones(cost.shape, dtype=bool)
    forbidden = 1.0 + 2.0 * float(np.where(allowed, cost, 0.0).sum())
    rows, columns = linear_sum_assignment(np.where(allowed, cost, forbidden))
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if allowed[i, j]]


def within_gates(gates: str, loops: Candidates) -> list[tuple[int, int]]:
    """Least total distance of places, births, deaths and places within their gates; the paper's distance is Hausdorff's."""
    births, deaths = loops.changes()
    alpha, beta, epsilon = loops.alpha, loops.beta, loops.motion
    gate, bound = {
        "paper": (2 * alpha + epsilon, 2 * alpha + beta + epsilon),
        "proved": (alpha + epsilon, 2 * beta + epsilon),
        "near": (alpha + epsilon + np.maximum(loops.death[:, None], loops.known_death) / 4, beta + epsilon),
    }[gates]
    distance = hausdorff_table(loops.places, loops.known_places)
    cost = distance + deaths if gates == "near" else distance
    return assign(cost, (births < gate) & (deaths < gate) & (distance < bound))


def check_pairs(pairs: object, found: int, known: int) -> list[tuple[int, int]]:
    """What a matching gave, or a ValueError when it is no matching."""
    try:
        checked = [(operator.index(i), operator.index(j)) for i, j in pairs]  # type: ignore[attr-defined]
        once = all(len(set(side)) == len(side) for side in zip(*checked, strict=True))
    except TypeError:
        once = False
    if not (once and all(0 <= i < found and 0 <= j < known for i, j in checked)):
        wanted = f"pairs of one of {found} found and one of {known} known loops, each once"
        raise ValueError(f"match must give {wanted}, not {pairs!r}")
    return checked
