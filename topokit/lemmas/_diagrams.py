"""The statements about persistence diagrams: approximation, observability, temporal persistence, gates.

Source: Antonova et al. 2021, section 4. Taught in chapters 3 and 4.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..rips import Diagram
from ._matching import Matching, longest_unmatched, match_diagrams
from ._verdict import Check, Verdict, Witness
from ._view import Motion, View, as_motion, as_view, vertex_ids

__all__ = ["feature_approximation", "gates", "observability", "temporal_persistence"]

_Named = tuple[str, Diagram, NDArray[np.int64] | None]  # where, its diagram, its vertices in the state (None: all)


def feature_approximation(state: ArrayLike, observed: ArrayLike) -> Check:
    """Check that every loop of the state has an image in what is observed (Lemma 1).

    The paper: for every feature f of S at filtration value r there is a feature of O at r + alpha that is homologous to f in
    S at r + alpha. As a feature is a class that is not trivial, this fails when f dies by r + alpha: then the trivial class
    will do, and O may have no other. Checked here in its weakest form: where S has a loop at r, O has one at r + alpha
    (statistic 1, bound the number of loops of O).

    Corrected: the rank form. At most as many bars of S contain [r, r + alpha] as bars of O are alive at r + alpha.
    The statistic is the least shift that makes this true for all r, and its bound is alpha. Proof: moving every vertex to its
    nearest observed point sends VR_r(S) into VR_(r + alpha)(O), and followed by the inclusion into VR_(r + alpha)(S) is
    contiguous to it; so the map of S from r to r + alpha factors through O at r + alpha, and its rank is at most the dimension
    there.

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
    The unit square and three of its corners: S has a loop at 0.5, O never has one.

    >>> check = feature_approximation([[0, 0], [1, 0], [1, 1], [0, 1]], [0, 1, 2])
    >>> check.paper.holds, check.corrected.holds
    (False, True)
    """
    return check_feature_approximation(as_view(state, observed))


def check_feature_approximation(view: View) -> Check:
    s, o, alpha, tolerance = view.state.diagram, view.diagram, view.alpha, view.state.tolerance
    return Check(
        "feature approximation",
        paper=_some_loop_of_o(s, o, alpha, tolerance),
        corrected=_rank_inequality(s, o, alpha, tolerance),
        alpha=alpha,
    )


def _some_loop_of_o(s: Diagram, o: Diagram, alpha: float, tolerance: float) -> Verdict:
    """Where S has a loop at r, O has one at r + alpha: checked at the values of r where that may begin to be false."""
    if len(s) == 0:
        return Verdict(0.0, 0.0, True)
    at = np.concatenate([s.birth, o.death - alpha])
    alive = (s.birth[:, None] <= at) & (s.death[:, None] > at + tolerance)
    in_o = ((o.birth[:, None] <= at + alpha + tolerance) & (o.death[:, None] > at + alpha + tolerance)).sum(axis=0)
    at_least = np.where(alive.any(axis=0), in_o, len(s) + len(o))
    worst = int(np.argmin(at_least))
    loop = int(np.argmax(alive[:, worst]))
    what = f"at r = {at[worst]:.6g} S has a loop, O at r + alpha has {at_least[worst]}"
    return Verdict(1.0, float(at_least[worst]), bool(at_least[worst] >= 1), True, len(s), _bar(s, "S_t", loop, what))


def _rank_inequality(s: Diagram, o: Diagram, alpha: float, tolerance: float) -> Verdict:
    """The least c with: at most as many bars of S contain [r, r + c] as bars of O are alive at r + c, for all r.

    At the value v = r + c, where O has m loops, c must be at least the age of the (m + 1)-th oldest loop of S. Between two
    values where something is born or dies only the ages change: they are largest at the end.
    """
    if len(s) == 0:
        return Verdict(0.0, alpha, True)
    events = np.unique(np.concatenate([s.birth, s.death, o.birth, o.death]))
    start, end = events[:-1], events[1:]
    long = end - start > tolerance  # equal up to rounding is equal
    start, end = start[long], end[long]
    born = np.sort(np.where((s.birth[:, None] <= start) & (s.death[:, None] >= end), s.birth[:, None], np.inf), axis=0)
    in_o = ((o.birth[:, None] <= start) & (o.death[:, None] >= end)).sum(axis=0)
    padded = np.vstack([born, np.full(len(start), np.inf)])
    age = end - padded[np.minimum(in_o, len(s)), np.arange(len(start))]
    if not len(age) or age.max() <= 0:
        return Verdict(0.0, alpha, True, True, len(s))
    worst = int(np.argmax(age))
    statistic = float(age[worst])
    loop = int(np.argmin(np.abs(s.birth - (end[worst] - statistic)) + 1e9 * (s.death < end[worst])))
    what = f"just before {end[worst]:.6g} O has {in_o[worst]} loops, S has more that are older than alpha"
    holds = statistic <= alpha + tolerance
    return Verdict(statistic, alpha, holds, True, len(s), _bar(s, "S_t", loop, what))


def observability(state: ArrayLike, observed: ArrayLike) -> Check:
    """Check that loops of the state with a lifetime above alpha are seen, and when (Lemma 2).

    The paper: every such loop has a counterpart in O with 0 <= birth_O - birth_S <= alpha, and the same for deaths. True, and
    the threshold is sharp. The statistic is the lifetime of the longest loop of S that must go without such a counterpart.

    Corrected, or rather completed: one matching does this for all loops at once, and leaves no loop of O with a lifetime
    above alpha alone either. The statistic is the least c for which a matching with all shifts in [0, c] leaves only bars of
    lifetime at most c alone. Proof: with S shifted by alpha / 2 the two persistence modules are alpha / 2-interleaved, by the
    inclusion and the nearest-point map; apply the isometry theorem.

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
    >>> check = observability(np.column_stack([np.cos(angle), np.sin(angle)]), np.arange(0, 40, 2))
    >>> check.corrected.holds, round(check.corrected.statistic / check.alpha, 2)
    (True, 0.5)
    """
    return check_observability(as_view(state, observed))


def check_observability(view: View) -> Check:
    s, o, alpha, tolerance = view.state.diagram, view.diagram, view.alpha, view.state.tolerance
    alone, loop = longest_unmatched(s, o, alpha + tolerance, one_sided=True, tolerance=tolerance)
    witness = _bar(s, "S_t", loop, "no counterpart within [0, alpha]") if loop >= 0 else None
    long = int((s.lifetime > alpha + tolerance).sum())
    match = view.matching
    where, bar, i = ("S_t", s, match.worst[0]) if match.worst[0] >= 0 else ("O_t", o, match.worst[1])
    ids = None if where == "S_t" else view.ids
    worst = _bar(bar, where, i, f"costs {match.cost:.6g}", ids) if i >= 0 else None
    return Check(
        "observability",
        paper=Verdict(alone, alpha, alone <= alpha + tolerance, True, long, witness),
        corrected=Verdict(
            match.cost,
            alpha,
            match.cost <= alpha + tolerance,
            True,
            long + int((o.lifetime > alpha + tolerance).sum()),
            worst,
        ),
        alpha=alpha,
    )


def temporal_persistence(before: ArrayLike, after: ArrayLike) -> Check:
    """Check that loops outlive a small motion (Lemma 3).

    The paper: every loop of S_t with a lifetime above epsilon has a counterpart in S_t+1 with birth and death changed by at
    most epsilon. False: a motion can undo a loop with a lifetime of almost 2 epsilon, since its birth edge and its killer
    may each change by 2 epsilon in length. The statistic is the lifetime of the longest loop that must go without one.

    Corrected: true for lifetimes above 2 epsilon; the bottleneck distance of the two diagrams is at most epsilon. Proof: no
    edge changes its half length by more than epsilon, so the modules are epsilon-interleaved. Intrinsic: the same holds with
    the `distortion` in place of epsilon, which a rigid motion does not feel.

    Parameters
    ----------
    before, after : (n, d) array_like
        S_t and S_t+1: row i of both is the same point.

    Returns
    -------
    Check

    Raises
    ------
    TypeError, ValueError
        When they are no point clouds or differ in shape.

    Examples
    --------
    >>> square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    >>> check = temporal_persistence(square, square + [3, 0])
    >>> check.epsilon, check.distortion, check.corrected.statistic
    (3.0, 0.0, 0.0)
    """
    return check_temporal_persistence(as_motion(before, after))


def check_temporal_persistence(motion: Motion) -> Check:
    s, epsilon, tolerance = motion.before.diagram, motion.epsilon, motion.tolerance
    alone, loop = longest_unmatched(s, motion.after.diagram, epsilon + tolerance)
    witness = _bar(s, "S_t", loop, "no counterpart within epsilon") if loop >= 0 else None
    diagrams = (("S_t", s, None), ("S_t+1", motion.after.diagram, None))
    return Check(
        "temporal persistence",
        paper=Verdict(alone, epsilon, alone <= epsilon + tolerance, True, _longer(s, epsilon + tolerance), witness),
        corrected=_bottleneck(motion.matching, diagrams, epsilon, tolerance),
        intrinsic=_bottleneck(motion.matching, diagrams, motion.distortion, tolerance),
        epsilon=epsilon,
        distortion=motion.distortion,
    )


def gates(before: ArrayLike, observed_before: ArrayLike, after: ArrayLike, observed_after: ArrayLike) -> Check:
    """Check how far births and deaths move between observations: the gates of Algorithm 1.

    The paper lets loops correspond when both values change by less than 2 alpha + epsilon: valid, and loose. Corrected:
    the bottleneck distance of the diagrams of O_t and O_t+1 is at most alpha + epsilon, so that a counterpart is guaranteed to
    observed loops with a lifetime above 2 (alpha + epsilon). Proof: the inclusion of O_t, the motion and the nearest-point map
    at t + 1 send VR_r(O_t) into VR_(r + epsilon + alpha)(O_t+1), and back the same way: an (alpha + epsilon)-interleaving.
    Intrinsic: the `distortion` in place of epsilon.

    Parameters
    ----------
    before, after : (n, d) array_like
        S_t and S_t+1: row i of both is the same point.
    observed_before, observed_after : (m,) array_like of int, or (m, d) array_like
        O_t and O_t+1: vertex ids, or coordinates of vertices. They need not be the same vertices.

    Returns
    -------
    Check

    Raises
    ------
    TypeError, ValueError
        When they are no point clouds, differ in shape, or what is observed is not in the state.

    Examples
    --------
    >>> angle = 2 * np.pi * np.arange(40) / 40
    >>> circle = np.column_stack([np.cos(angle), np.sin(angle)])
    >>> check = gates(circle, np.arange(0, 40, 2), 1.01 * circle, np.arange(0, 40, 4))
    >>> check.paper.holds, check.corrected.holds
    (True, True)
    """
    motion = as_motion(before, after)
    seen = vertex_views(motion, observed_before, observed_after)
    return check_gates(motion, *seen)


def vertex_views(motion: Motion, observed_before: ArrayLike, observed_after: ArrayLike) -> tuple[View, View]:
    """What is observed of both states of a motion."""
    return (
        View(motion.before, vertex_ids(motion.before.points, observed_before, "observed_before")),
        View(motion.after, vertex_ids(motion.after.points, observed_after, "observed_after")),
    )


def check_gates(motion: Motion, seen: View, seen_after: View) -> Check:
    match = match_diagrams(seen.diagram, seen_after.diagram)
    alpha, tolerance = max(seen.alpha, seen_after.alpha), motion.tolerance
    diagrams = (("O_t", seen.diagram, seen.ids), ("O_t+1", seen_after.diagram, seen_after.ids))
    return Check(
        "gates",
        paper=_bottleneck(match, diagrams, 2 * alpha + motion.epsilon, tolerance),
        corrected=_bottleneck(match, diagrams, alpha + motion.epsilon, tolerance),
        intrinsic=_bottleneck(match, diagrams, alpha + motion.distortion, tolerance),
        alpha=alpha,
        epsilon=motion.epsilon,
        distortion=motion.distortion,
    )


def _bottleneck(match: Matching, diagrams: tuple[_Named, _Named], bound: float, tolerance: float) -> Verdict:
    """The bottleneck distance against a bound, which speaks about bars longer than twice the bound."""
    side = 0 if match.worst[0] >= 0 else 1
    where, diagram, ids = diagrams[side]
    witness = None
    if match.worst[side] >= 0:
        witness = _bar(diagram, where, match.worst[side], f"costs {match.cost:.6g}", ids)
    long = sum(_longer(d, 2 * bound) for _, d, _ in diagrams)
    return Verdict(match.cost, bound, match.cost <= bound + tolerance, True, long, witness)


def _longer(diagram: Diagram, lifetime: float) -> int:
    return int((diagram.lifetime > lifetime).sum())


def _bar(diagram: Diagram, of: str, loop: int, what: str, ids: NDArray[np.int64] | None = None) -> Witness:
    """A loop as a witness; `ids` are the vertices of the state that the diagram's are."""
    a, b = diagram.killer_edge[loop].tolist() if ids is None else ids[diagram.killer_edge[loop]].tolist()
    return Witness(of, loop, float(diagram.birth[loop]), float(diagram.death[loop]), (a, b), what)
