"""Optimal bottleneck matchings of persistence diagrams, two-sided and one-sided, and bars that no matching reaches.

Idea: a threshold c is enough when every bar too long to stay alone at c can be matched at a cost of at most c. By the theorem
of Mendelsohn and Dulmage it suffices that the long bars of one diagram can all be matched, and those of the other can, each
by a matching of its own: two maximum bipartite matchings (Hopcroft and Karp, from SciPy) say whether c will do. The least
such c is among the costs, and a bisection finds it. Among the matchings that reach it the one of least total cost is taken.

Source: Edelsbrunner and Harer 2010, chapter VIII (bottleneck distance); Mendelsohn and Dulmage 1958. Taught in chapters 3, 4.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import maximum_bipartite_matching

from .._validate import Array
from ..rips import Diagram
from ..seqph import assign


@dataclass(frozen=True, eq=False)
class DiagramMatching:
    """The correspondence of the bars of two diagrams."""

    partner: NDArray[np.int64]  #: (n,) for every bar of the first diagram its bar in the second, -1 when it has none
    cost: float  #: the bottleneck: the largest of the shifts of matched bars and the costs of bars left alone


def match_diagrams(
    first: Diagram, second: Diagram, *, one_sided: bool = False, tolerance: float = 0.0
) -> DiagramMatching:
    """Match two diagrams optimally; of the optimal matchings the one of least total cost. Every bar must die.

    Two-sided, the cost of a pair is the larger shift of its births and of its deaths, of a bar left alone half its lifetime;
    the optimum is the bottleneck distance. One-sided, for a diagram of S and one of a subset O of S, both
    shifts O - S must not be negative, a pair costs the larger and a bar left alone its lifetime; the optimum is the least c
    for which bars longer than c are all matched with shifts in [0, c]. Shifting S by c / 2 turns the latter into the former.

    Parameters
    ----------
    first, second : Diagram
        The diagrams of S and of O when `one_sided`.
    one_sided : bool
        Whether `second` is the diagram of a subset.
    tolerance : float
        How far below zero rounding may push a shift that is zero.
    """
    pair, alone, others_alone = _costs(first, second, one_sided, tolerance)
    limits = np.unique(np.concatenate([pair[np.isfinite(pair)], alone, others_alone, [0.0]]))

    def is_enough(c: float) -> bool:
        return _saturates((pair <= c)[alone > c]) and _saturates((pair <= c).T[others_alone > c])

    # The least cost that is enough, then the cheapest matching that reaches it.
    cost = float(limits[bisect_left(limits, True, key=is_enough)])
    return DiagramMatching(_cheapest(pair, alone, others_alone, cost), cost)


def longest_unmatched(
    first: Diagram, second: Diagram, shift: float, *, one_sided: bool = False, tolerance: float = 0.0
) -> float:
    """Return the lifetime of the longest bar of `first` that no matching reaches together with all longer ones, 0.0 for none."""
    pair, _, _ = _costs(first, second, one_sided, tolerance)
    # Bars come longest first: count those that can still be matched together.
    longest = range(1, len(first) + 1)
    matched = bisect_left(longest, True, key=lambda count: not _saturates(pair[:count] <= shift))
    return 0.0 if matched == len(first) else float(first.lifetime[matched])


def _costs(first: Diagram, second: Diagram, one_sided: bool, tolerance: float) -> tuple[Array, Array, Array]:
    """Return (n, m) costs of pairs (inf where forbidden), (n,) and (m,) costs of bars left alone."""
    for name, diagram in (("first", first), ("second", second)):
        if not np.isfinite(diagram.death).all():
            raise ValueError(f"the {name} diagram has a loop that does not die; compute it without max_radius")
    births = second.birth[None, :] - first.birth[:, None]
    deaths = second.death[None, :] - first.death[:, None]
    if not one_sided:
        return np.maximum(np.abs(births), np.abs(deaths)), first.lifetime / 2, second.lifetime / 2

    # One-sided: both values may only grow, up to rounding.
    pair = np.maximum(np.maximum(births, deaths), 0.0)
    pair[np.minimum(births, deaths) < -tolerance] = np.inf
    return pair, first.lifetime, second.lifetime


def _saturates(allowed: NDArray[np.bool_]) -> bool:
    """Return whether all rows can be matched."""
    if len(allowed) == 0:
        return True
    return bool((maximum_bipartite_matching(csr_matrix(allowed), perm_type="column") >= 0).all())


def _cheapest(pair: Array, alone: Array, others_alone: Array, c: float) -> NDArray[np.int64]:
    """Return the matching of least total cost among those that match every bar too long to stay alone at `c`.

    What a pair saves against two bars left alone is what counts, and matching a long bar saves more than all else together.
    """
    partner = np.full(len(alone), -1, dtype=np.int64)
    most = 1.0 + 2.0 * (float(alone.sum()) + float(others_alone.sum()))
    saved = (alone + most * (alone > c))[:, None] + (others_alone + most * (others_alone > c))[None, :]
    saved = np.maximum(np.where(pair <= c, saved - np.where(pair <= c, pair, 0.0), 0.0), 0.0)
    for i, j in assign(-saved):
        if saved[i, j] > 0:
            partner[i] = j
    return partner
