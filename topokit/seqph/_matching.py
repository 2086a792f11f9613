"""Match the loops of a frame with the loops known before: minimum-cost assignments, and the gates of seqPH."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._validate import Array
from topokit.sampling import hausdorff_table


@dataclass(frozen=True, eq=False)
class Candidates:
    """The input of a match rule: the n loops found in a frame and the m loops known from before."""

    birth: Array  #: (n,) births of the found loops
    death: Array  #: (n,) deaths of the found loops
    #: (n, p, d) places of the found loops, by the tracker's `identity`: two ends of an edge, or one point
    places: Array
    known_birth: Array  #: (m,) births of the known loops
    known_death: Array  #: (m,) deaths of the known loops
    known_places: Array  #: (m, p, d) places of the known loops
    motion: Array  #: (m,) largest motion of the scene since each was last found, the sum of the steps' epsilon
    alpha: float  #: the alpha of this step
    beta: Array  #: (n, m) the beta of each pair

    def changes(self) -> tuple[Array, Array]:
        """Return the changes of birth and of death, each (n, m), between every found loop and every known one."""
        birth = np.abs(self.birth[:, None] - self.known_birth)
        death = np.abs(self.death[:, None] - self.known_death)
        return birth, death

    def subset(self, rows: list[int], columns: list[int]) -> Candidates:
        """Return the input of a rule that matches only these found and these known loops."""
        return Candidates(
            birth=self.birth[rows],
            death=self.death[rows],
            places=self.places[rows],
            known_birth=self.known_birth[columns],
            known_death=self.known_death[columns],
            known_places=self.known_places[columns],
            motion=self.motion[columns],
            alpha=self.alpha,
            beta=self.beta[np.ix_(rows, columns)],
        )


#: A function that returns the pairs (i, j) of a found loop i that is the known loop j, each once at most.
MatchRule = Callable[[Candidates], Iterable[tuple[int, int]]]


def assign(cost: ArrayLike, allowed: NDArray[np.bool_] | None = None) -> list[tuple[int, int]]:
    """Match as many rows and columns as possible, at the least total cost among such matchings.

    Parameters
    ----------
    cost : (n, m) array_like
        Costs, which must not be negative when `allowed` is given.
    allowed : (n, m) bool, optional
        Pairs that may be matched; all of them when not given.

    Notes
    -----
    A forbidden pair costs more than all allowed pairs together. So the Hungarian algorithm takes one only where it has no
    choice, and forbidden pairs are dropped. Infinite costs could make the problem infeasible.
    """
    from scipy.optimize import linear_sum_assignment  # here, because importing topokit must be quick

    cost = np.asarray(cost, dtype=np.float64)
    if allowed is None:
        allowed = np.ones(cost.shape, dtype=bool)
    forbidden = 1.0 + 2.0 * float(np.where(allowed, cost, 0.0).sum())
    rows, columns = linear_sum_assignment(np.where(allowed, cost, forbidden))
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if allowed[i, j]]


def within_gates(gates: str, loops: Candidates) -> list[tuple[int, int]]:
    """Return the matching of least total distance of places, with births, deaths and places within their gates."""
    birth_changes, death_changes = loops.changes()
    distance = hausdorff_table(loops.places, loops.known_places)
    alpha = loops.alpha
    beta = loops.beta
    epsilon = loops.motion
    cost = distance

    if gates == "paper":  # Algorithm 1 and Corollary 1
        gate = 2 * alpha + epsilon
        bound = 2 * alpha + beta + epsilon
    elif gates == "proved":  # what chapter 5b proves
        gate = alpha + epsilon
        bound = 2 * beta + epsilon
    else:  # "near": killers of cloth jump, so death may change by more, and counts in the cost
        gate = alpha + epsilon + np.maximum(loops.death[:, None], loops.known_death) / 4
        bound = beta + epsilon
        cost = distance + death_changes
    return assign(cost, (birth_changes < gate) & (death_changes < gate) & (distance < bound))


def match_leaps(loops: Candidates) -> list[tuple[int, int]]:
    """Return the least-distance matching within 2 beta of loops without a name and missed loops: a killer that leaps its gate."""
    distance = hausdorff_table(loops.places, loops.known_places)
    return assign(distance, distance < 2 * loops.beta)
