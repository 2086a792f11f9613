"""The converse of the corollary: telling loops apart by their killer edges.

Source: Antonova et al. 2021, Assumption 3 and Corollary 1. Taught in chapter 5.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._diagrams import vertex_views
from ._killers import MORE_THAN_TWICE, away, observed_ids, observed_killers, witness
from ._measures import edge_distances
from ._verdict import Check, Verdict
from ._view import Motion, State, View, as_motion

__all__ = ["converse"]


def converse(before: ArrayLike, observed_before: ArrayLike, after: ArrayLike, observed_after: ArrayLike) -> Check:
    """Check that observed killers which are close belong to the same loop: what tracking needs, the corollary's converse.

    The paper concludes it from killers in S_t that are more than 2 alpha + beta + epsilon apart, which its Assumption 3 rules
    out where loops die within alpha of each other. Even where they do not, each observed killer may be beta off.

    Corrected: let every critical edge in the window of some loop with a lifetime above alpha + 2 epsilon lie within beta of the
    *nearest* killer of such a loop, and let these killers be more than 4 beta + 2 epsilon apart. Then each observed killer has
    its place, the killer in S_t within beta of it (beta + epsilon at t + 1), and two observed killers of t and t + 1 are within
    2 beta + epsilon if and only if they have the same place. The statistic is that reach, the bound the least distance
    between killers of different places. Proof: both are critical, as in the corollary; apply the triangle inequality through
    their places. Intrinsic: the `distortion` in place of epsilon, but not where it says how far edges move.

    Parameters
    ----------
    before, after, observed_before, observed_after
        As in `corollary`.

    Returns
    -------
    Check
        Empty where there are not two loops that live long enough.

    Raises
    ------
    TypeError, ValueError
        As `corollary`.

    Examples
    --------
    >>> angle = 2 * np.pi * np.arange(20) / 20
    >>> circle = np.column_stack([np.cos(angle), np.sin(angle)])
    >>> both = np.vstack([circle, circle + [20, 0]])
    >>> check = converse(both, np.arange(40), both, np.arange(40))
    >>> check.paper.applies, check.corrected.applies, check.corrected.holds
    (False, True, True)
    """
    motion = as_motion(before, after)
    return check_converse(motion, *vertex_views(motion, observed_before, observed_after))


def check_converse(motion: Motion, seen: View, seen_after: View) -> Check:
    epsilon, delta = motion.epsilon, motion.distortion
    alpha = max(seen.alpha, seen_after.alpha)
    larger = max(alpha, MORE_THAN_TWICE * epsilon)
    views = (motion, seen, seen_after)
    corrected, intrinsic = (_by_place(*views, alpha, change) for change in (epsilon, delta))
    return Check("converse", _by_loop(*views, larger), corrected, intrinsic, alpha, epsilon, delta)


def _by_loop(motion: Motion, seen: View, seen_after: View, alpha: float) -> Verdict:
    """The paper's: killers of different loops are farther apart than the corollary's bound."""
    s = motion.before
    loops = np.flatnonzero(s.diagram.lifetime > alpha)
    if len(loops) < 2:
        return Verdict(0.0, np.inf, True)
    beta = max(state.beta_all(alpha, alpha, alpha).max for state in (s, motion.after))
    reach = 2 * alpha + beta + motion.epsilon
    killers = [observed_killers(motion, seen, seen_after, int(f)) for f in loops]
    distance = np.array([[away(now[0], later[1]) for later in killers] for now in killers])
    np.fill_diagonal(distance, np.inf)
    least, loop = float(distance.min()), int(loops[distance.min(axis=1).argmin()])
    holds = least > reach - motion.tolerance
    separated = s.separation(alpha) > reach
    return Verdict(
        reach, least, holds, separated, len(loops), witness(s, loop, "the killer of another loop is as near")
    )


def _by_place(motion: Motion, seen: View, seen_after: View, alpha: float, change: float) -> Verdict:
    """Killers of one place are within reach, those of different places are not."""
    s, min_lifetime = motion.before, alpha + 2 * change
    loops = np.flatnonzero(s.diagram.lifetime > min_lifetime)
    if len(loops) < 2:
        return Verdict(0.0, np.inf, True)
    beta = s.beta_critical(min_lifetime, alpha, change, nearest=True).max
    reach = 2 * beta + motion.epsilon
    pairs = [observed_ids(motion, seen, seen_after, int(f)) for f in loops]
    if any(edge is None for pair in pairs for edge in pair):  # against the theorem
        return Verdict(reach, 0.0, False, True, len(loops), witness(s, int(loops[0]), "a loop is not seen"))
    now, later = np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs])
    places = [_places(s, ids, loops) for ids in (now, later)]
    after = motion.after.points
    distance = np.array([[away(s.points[a], after[b]) for b in later] for a in now])
    same = places[0][:, None] == places[1][None, :]
    least, most = float(distance[~same].min(initial=np.inf)), float(distance[same].max(initial=0.0))
    holds = least > reach - motion.tolerance and most <= reach + motion.tolerance
    loop = int(loops[np.where(same, np.inf, distance).min(axis=1).argmin()])
    found = witness(s, loop, f"killers of one place up to {most:.6g} apart, of different ones down to {least:.6g}")
    return Verdict(reach, least, holds, s.separation(min_lifetime) > 2 * reach, len(loops), found)


def _places(s: State, edges: NDArray[np.int64], loops: NDArray[np.int64]) -> NDArray[np.int64]:
    """For each edge of S_t the loop whose killer is nearest."""
    distance = np.array([edge_distances(s.distances, edges, s.diagram.killer_edge[g]) for g in loops])
    return np.asarray(loops[distance.argmin(axis=0)])
