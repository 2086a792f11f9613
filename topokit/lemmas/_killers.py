"""The statements about killer edges: recovering them, following them, telling them apart.

Source: Antonova et al. 2021, section 4. Taught in chapter 5.

All of them compare edges by Hausdorff distance, each edge taken as its two end points, and all of them rest on an assumption
on rivals: edges that could be taken for the killer lie within beta of it. The paper's Assumption 3 asks this of all edges of
about the killer's length. Two loops that die within alpha of each other are then rivals, within beta, and the same assumption
wants them more than 2 alpha + beta + epsilon apart: it cannot hold. (`Verdict.hypotheses` of the paper's versions says whether
it does.) Assumption 3' asks it of critical edges only, see `beta_critical`. The killers of other loops are critical too, so
where several loops die at about the same time only the distance to the nearest of their killers can be small: `converse`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import cdist

from .._validate import positive
from ._diagrams import vertex_views
from ._measures import Beta
from ._verdict import Check, LoopCheck, Verdict, Witness
from ._view import Motion, State, View, as_motion, as_view

__all__ = ["corollary", "recovering_killers", "regularity_of_killers"]

MORE_THAN_TWICE = 2.001  # alpha must exceed 2 epsilon in Assumption 2; a larger alpha than measured is still one


def recovering_killers(state: ArrayLike, observed: ArrayLike) -> Check:
    """Check that the killer edge seen in the observation is near the true one (Lemma 4).

    The paper: the killer of f in S and that of its counterpart in O are within beta. True for lifetimes above alpha, which the
    statement leaves out: shorter loops may have no counterpart. Its beta is over all edges.

    Corrected: the same with beta over (alpha, 0)-critical edges, for each loop its own. Proof: the counterpart dies in
    [d, d + alpha], and its killer's lune falls apart in O. A path in S that showed the edge not to be critical would, each point
    moved to the nearest observed one, hold that lune together.

    Parameters
    ----------
    state : (n, d) array_like
        S_t.
    observed : (m,) array_like of int, or (m, d) array_like
        O_t: vertex ids, or coordinates of vertices.

    Returns
    -------
    Check

    Raises
    ------
    TypeError, ValueError
        When `state` is no point cloud or `observed` is not among its points.

    Examples
    --------
    >>> angle = 2 * np.pi * np.arange(40) / 40
    >>> check = recovering_killers(np.column_stack([np.cos(angle), np.sin(angle)]), np.arange(0, 40, 2))
    >>> check.corrected.holds
    True
    """
    return check_recovering_killers(as_view(state, observed))


def check_recovering_killers(view: View) -> Check:
    s, alpha = view.state, view.alpha
    everywhere, critical = s.beta_all(alpha, alpha, alpha), s.beta_critical(alpha, alpha, 0.0)
    rows = []
    for f in range(len(everywhere.value)):
        partner = int(view.matching.partner[f])
        seen = s.points[view.killer(partner)] if partner >= 0 else None
        legs = (away(s.points[s.diagram.killer_edge[f]], seen),)
        bounds = {"paper": float(everywhere.value[f]), "corrected": float(critical.value[f])}
        rows.append(LoopCheck(f, float(s.diagram.lifetime[f]), sum(legs), legs, bounds))
    verdict = _verdicts(rows, s, s.tolerance)
    separated = _is_separated(s, alpha, 2 * alpha + everywhere.max)
    return Check(
        "recovering killers", verdict("paper", separated), verdict("corrected"), alpha=alpha, loops=tuple(rows)
    )


def regularity_of_killers(before: ArrayLike, after: ArrayLike, alpha: float = 0.0) -> Check:
    """Check that killer edges move little in a small motion (Lemma 5).

    The paper: the killer of f and that of its image are within beta + epsilon. True; the proof uses Assumption 3 on edges of
    S_t+1, where it says nothing about them: pull the image's killer back to S_t, where it is a rival of f's.

    Corrected: beta over (0, epsilon)-critical edges, for loops with a lifetime above 2 epsilon. Proof: the lune of the image's
    killer falls apart in S_t+1; pulled back, the edge is critical, of half length within 2 epsilon of the death. Intrinsic:
    beta over (0, distortion)-critical edges; epsilon stays where it says how far the edge's ends move.

    Parameters
    ----------
    before, after : (n, d) array_like
        S_t and S_t+1: row i of both is the same point.
    alpha : float
        Of the observations, for the paper's Assumption 3; 2.001 epsilon when smaller, since Assumption 2 wants it above
        2 epsilon.

    Returns
    -------
    Check

    Raises
    ------
    TypeError, ValueError
        When they are no point clouds, differ in shape, or `alpha` is negative.

    Examples
    --------
    >>> square = np.array([[0, 0], [1, 0], [1, 1], [0, 1.001]])
    >>> check = regularity_of_killers(square, square + [0.01, 0])
    >>> check.corrected.holds, round(check.corrected.statistic, 4)
    (True, 0.01)
    """
    return check_regularity(as_motion(before, after), positive(alpha, "alpha"))


def check_regularity(motion: Motion, alpha: float) -> Check:
    s, after, epsilon = motion.before, motion.after, motion.epsilon
    alpha = max(alpha, MORE_THAN_TWICE * epsilon)
    everywhere = s.beta_all(alpha, alpha, alpha)
    critical = s.beta_critical(2 * epsilon, 0.0, epsilon)
    intrinsic = s.beta_critical(2 * motion.distortion, 0.0, motion.distortion)
    rows = []
    for f in range(max(len(beta.value) for beta in (everywhere, critical, intrinsic))):
        partner = int(motion.matching.partner[f])
        later = after.points[after.diagram.killer_edge[partner]] if partner >= 0 else None
        legs = (away(s.points[s.diagram.killer_edge[f]], later),)
        bounds = _bounds(f, {"paper": everywhere, "corrected": critical, "intrinsic": intrinsic}, 1, epsilon)
        rows.append(LoopCheck(f, float(s.diagram.lifetime[f]), sum(legs), legs, bounds))
    verdict = _verdicts(rows, s, motion.tolerance)
    return Check(
        "regularity of killers",
        verdict("paper", _is_separated(s, alpha, 2 * alpha + everywhere.max + epsilon)),
        verdict("corrected"),
        verdict("intrinsic"),
        alpha,
        epsilon,
        motion.distortion,
        tuple(rows),
    )


def corollary(before: ArrayLike, observed_before: ArrayLike, after: ArrayLike, observed_after: ArrayLike) -> Check:
    """Check how far killers may lie apart in two observations of one loop (Corollary 1).

    The paper: at most 2 alpha + beta + epsilon. False: its proof puts alpha for the two outer legs, where Lemma 4 gives beta.

    Corrected: 2 beta + epsilon, with beta over (alpha, epsilon)-critical edges of S_t alone, for each loop its own, and
    lifetimes above alpha + 2 epsilon. Proof: both observed killers, pulled back to S_t, are critical and of half length in
    [d - 2 epsilon, d + alpha + 2 epsilon], hence within beta of f's. Intrinsic: the `distortion` in place of epsilon
    everywhere but in the last term. Further: over all edges 3 beta + epsilon follows from the paper's lemmas, and 2 beta +
    epsilon when its Assumption 3 takes the wider window.

    Parameters
    ----------
    before, after : (n, d) array_like
        S_t and S_t+1: row i of both is the same point.
    observed_before, observed_after : (m,) array_like of int, or (m, d) array_like
        O_t and O_t+1: vertex ids, or coordinates of vertices. They need not be the same vertices.

    Returns
    -------
    Check
        A loop's three legs are from O_t to S_t, from there to S_t+1, and on to O_t+1.

    Raises
    ------
    TypeError, ValueError
        When they are no point clouds, differ in shape, or what is observed is not in the state.

    Examples
    --------
    >>> angle = 2 * np.pi * np.arange(40) / 40
    >>> circle = np.column_stack([np.cos(angle), np.sin(angle)])
    >>> check = corollary(circle, np.arange(0, 40, 2), circle + [0.001, 0], np.arange(1, 40, 2))
    >>> check.corrected.holds
    True
    """
    motion = as_motion(before, after)
    return check_corollary(motion, *vertex_views(motion, observed_before, observed_after))


def check_corollary(motion: Motion, seen: View, seen_after: View) -> Check:
    s, epsilon, delta = motion.before, motion.epsilon, motion.distortion
    alpha = max(seen.alpha, seen_after.alpha)
    larger = max(alpha, MORE_THAN_TWICE * epsilon)
    everywhere = s.beta_all(larger, larger, larger)
    beta = max(everywhere.max, motion.after.beta_all(larger, larger, larger).max)
    wide = s.beta_all(alpha + 2 * epsilon, 2 * epsilon, alpha + 2 * epsilon)
    critical = s.beta_critical(alpha + 2 * epsilon, alpha, epsilon)
    intrinsic = s.beta_critical(alpha + 2 * delta, alpha, delta)
    rows = []
    for f in range(int((s.diagram.lifetime > alpha).sum())):
        bounds = _bounds(
            f, {"corrected": critical, "intrinsic": intrinsic, "2 beta + epsilon, all edges": wide}, 2, epsilon
        )
        image = int(motion.matching.partner[f])
        if f < len(everywhere.value) and image >= 0 and motion.after.diagram.lifetime[image] > larger:
            bounds["paper"] = 2 * larger + beta + epsilon
            bounds["3 beta + epsilon, all edges"] = 3 * beta + epsilon
        legs = _chain(motion, seen, seen_after, f)
        if np.isinf(legs[-1]) and "corrected" not in bounds and "intrinsic" not in bounds:
            continue  # it is not seen at t + 1, and is too short-lived to have to be
        rows.append(LoopCheck(f, float(s.diagram.lifetime[f]), _total(motion, seen, seen_after, f), legs, bounds))
    verdict = _verdicts(rows, s, motion.tolerance)
    separated = _is_separated(s, larger, 2 * larger + beta + epsilon)
    return Check(
        "corollary",
        verdict("paper", separated),
        verdict("corrected"),
        verdict("intrinsic"),
        alpha,
        epsilon,
        delta,
        tuple(rows),
        {name: verdict(name) for name in ("3 beta + epsilon, all edges", "2 beta + epsilon, all edges")},
    )


def observed_ids(
    motion: Motion, seen: View, seen_after: View, f: int
) -> tuple[NDArray[np.int64] | None, NDArray[np.int64] | None]:
    """Vertex ids of the killer of loop f of S_t as it is seen at t, and at t + 1; None where it is not seen."""
    now, image = int(seen.matching.partner[f]), int(motion.matching.partner[f])
    later = int(seen_after.matching.partner[image]) if image >= 0 else -1
    return seen.killer(now) if now >= 0 else None, seen_after.killer(later) if later >= 0 else None


def observed_killers(
    motion: Motion, seen: View, seen_after: View, f: int
) -> tuple[NDArray[np.float64] | None, NDArray[np.float64] | None]:
    """The same by coordinates."""
    now, later = observed_ids(motion, seen, seen_after, f)
    before, after = motion.before.points, motion.after.points
    return None if now is None else before[now], None if later is None else after[later]


def _chain(motion: Motion, seen: View, seen_after: View, f: int) -> tuple[float, float, float]:
    """How far killers lie apart from O_t to S_t, on to S_t+1, and on to O_t+1."""
    now, later = observed_killers(motion, seen, seen_after, f)
    image = int(motion.matching.partner[f])
    mine = motion.before.points[motion.before.diagram.killer_edge[f]]
    moved = motion.after.points[motion.after.diagram.killer_edge[image]] if image >= 0 else None
    return away(now, mine), away(mine, moved), away(moved, later)


def _total(motion: Motion, seen: View, seen_after: View, f: int) -> float:
    return away(*observed_killers(motion, seen, seen_after, f))


def away(a: NDArray[np.float64] | None, b: NDArray[np.float64] | None) -> float:
    """Hausdorff distance of two edges, inf when there is none."""
    if a is None or b is None:
        return float("inf")
    d = cdist(a, b)
    return float(max(d.min(axis=0).max(), d.min(axis=1).max()))


def _bounds(f: int, betas: dict[str, Beta], times: int, epsilon: float) -> dict[str, float]:
    """times * beta + epsilon of every version that speaks about loop f."""
    return {name: times * float(b.value[f]) + epsilon for name, b in betas.items() if f < len(b.value)}


def _is_separated(state: State, min_lifetime: float, distance: float) -> bool:
    return state.separation(min_lifetime) > distance


def _verdicts(rows: list[LoopCheck], state: State, tolerance: float) -> Callable[..., Verdict]:
    """A function that gives the verdict of a version: at the loop where it is tightest."""

    def verdict(name: str, hypotheses: bool = True) -> Verdict:
        mine = [row for row in rows if name in row.bounds]
        if not mine:
            return Verdict(0.0, 0.0, True, hypotheses)
        worst = max(mine, key=lambda row: row.statistic - row.bounds[name])
        bound = worst.bounds[name]
        holds = worst.statistic <= bound + tolerance
        return Verdict(
            worst.statistic, bound, holds, hypotheses, len(mine), witness(state, worst.loop, "killers this far apart")
        )

    return verdict


def witness(state: State, loop: int, what: str) -> Witness:
    a, b = state.diagram.killer_edge[loop].tolist()
    return Witness("S_t", loop, float(state.diagram.birth[loop]), float(state.diagram.death[loop]), (a, b), what)
