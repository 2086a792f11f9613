"""The statements about killer edges: recovering them, following them, and distinguishing them.

Idea: the distance of two edges is the Hausdorff distance of their end points. Edges that could be taken for the killer, its
*rivals*, are assumed to lie within beta of it. In the paper's Assumption 3 the rivals are all edges of about the killer's length
(`converse` shows where that cannot hold); in Assumption 3' they are the critical edges alone (`beta_critical`).

Source: Antonova et al. 2021, section 4. Taught in chapters 5b and 6.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from .._validate import positive
from ._measures import Beta
from ._step import Check, Given, LoopCheck, Step, Verdict, as_step, compare


def recovering_killers(state: ArrayLike | Step, observed: Given = None) -> Check:
    """Check that the killer edge seen in the observation is near the true one (Lemma 4).

    The paper: the killer of a loop f in S and the killer of its counterpart in O are within beta, where beta is over all edges.
    This is true for lifetimes above alpha, a condition that the statement leaves out: shorter loops may have no counterpart.

    Corrected: the same with a beta over (alpha, 0)-critical edges for each loop. Proof: the counterpart dies in
    [d, d + alpha], and its killer's lune falls apart in O. Suppose that a path in S showed the edge not to be critical. Move
    each of its points to the nearest observed point: then the path would hold that lune together.

    Parameters
    ----------
    state, observed
        As in `feature_approximation`.
    """
    step = as_step(state, observed)
    s = step.before
    alpha = s.alpha
    everywhere = s.beta_all(alpha, alpha, alpha)
    betas = {"paper": everywhere, "corrected": s.beta_critical(alpha, alpha, 0.0)}
    rows = _loop_checks(step, ("S_t", "O_t"), [_bounds(f, betas) for f in range(len(everywhere.value))])
    separated = s.separation(alpha) > 2 * alpha + everywhere.max
    return Check("recovering killers", _verdicts(step, rows, betas, separated), alpha, loops=tuple(rows))


def regularity_of_killers(before: ArrayLike | Step, after: Given = None, alpha: float = 0.0) -> Check:
    """Check that killer edges move little in a small motion (Lemma 5).

    The paper: the killer of a loop f and the killer of its image are within beta + epsilon. This is true, but the proof applies
    Assumption 3 to edges of S_t+1, and the assumption is about S_t. It is mended by pulling the killer of the image back to
    S_t, where it is a rival of the killer of f.

    Corrected: beta over (0, epsilon)-critical edges, for loops with a lifetime above 2 epsilon. Proof: the lune of the image's
    killer falls apart in S_t+1; pulled back, the edge is critical, of half length within 2 epsilon of the death. Intrinsic:
    beta over (0, distortion)-critical edges; epsilon stays where it bounds how far the ends of the edge move.

    Parameters
    ----------
    before, after
        As in `temporal_persistence`.
    alpha : float
        The covering radius of the observations. At least 2.001 epsilon is used, since Assumption 2 needs it above 2 epsilon.
    """
    step = as_step(before, after=after)
    s = step.before
    epsilon = step.epsilon
    delta = step.distortion
    alpha = max(positive(alpha, "alpha"), step.larger_alpha)
    betas = {
        "paper": s.beta_all(alpha, alpha, alpha),
        "corrected": s.beta_critical(2 * epsilon, 0.0, epsilon),
        "intrinsic": s.beta_critical(2 * delta, 0.0, delta),
    }

    # Every version is about the loops that live long enough for it.
    n_loops = max(len(beta.value) for beta in betas.values())
    rows = _loop_checks(step, ("S_t", "S_t+1"), [_bounds(f, betas, plus=epsilon) for f in range(n_loops)])
    separated = s.separation(alpha) > 2 * alpha + betas["paper"].max + epsilon
    verdicts = _verdicts(step, rows, betas, separated)
    return Check("regularity of killers", verdicts, alpha, epsilon, delta, tuple(rows))


def corollary(
    before: ArrayLike | Step, observed_before: Given = None, after: Given = None, observed_after: Given = None
) -> Check:
    """Check how far killers may lie apart in two observations of one loop (Corollary 1).

    The paper: at most 2 alpha + beta + epsilon. This is false: its proof puts alpha for the two outer legs, where Lemma 4 gives
    beta.

    Corrected: at most 2 beta + epsilon for lifetimes above alpha + 2 epsilon, with a beta over (alpha, epsilon)-critical edges
    of S_t alone for each loop. Proof: both observed killers, pulled back to S_t, are critical and of half length in
    [d - 2 epsilon, d + alpha + 2 epsilon], hence within beta of f's. Intrinsic: the `distortion` in place of epsilon
    everywhere but in the last term. Further: over all edges 3 beta + epsilon follows from the paper's lemmas, and 2 beta +
    epsilon when its Assumption 3 takes the wider window. A loop's legs lead from O_t to S_t, to S_t+1, and to O_t+1.

    Parameters
    ----------
    before, observed_before, after, observed_after
        As in `gates`.
    """
    step = as_step(before, observed_before, after, observed_after)
    s = step.before
    alpha = step.alpha
    epsilon = step.epsilon
    delta = step.distortion
    larger = step.larger_alpha
    beta = max(state.beta_all(larger, larger, larger).max for state in (s, step.after))
    betas = {
        "corrected": s.beta_critical(alpha + 2 * epsilon, alpha, epsilon),
        "intrinsic": s.beta_critical(alpha + 2 * delta, alpha, delta),
        "2 beta + epsilon, all edges": s.beta_all(alpha + 2 * epsilon, 2 * epsilon, alpha + 2 * epsilon),
    }
    of_the_paper = {"paper": 2 * larger + beta + epsilon, "3 beta + epsilon, all edges": 3 * beta + epsilon}

    # The paper's versions are about loops that live long enough at both times.
    lifetimes = s.diagram.lifetime
    images = np.append(step.after.diagram.lifetime, 0.0)[step.matching.partner]
    bounds = [_bounds(f, betas, times=2, plus=epsilon) for f in range(int((lifetimes > alpha).sum()))]
    for f in np.flatnonzero(np.minimum(lifetimes, images) > larger):
        bounds[f] |= of_the_paper
    rows = _loop_checks(step, ("O_t", "S_t", "S_t+1", "O_t+1"), bounds)

    # Leave out a loop that is not seen at t + 1 and lives too short for any version to promise that it is.
    rows = [row for row in rows if np.isfinite(row.legs[-1]) or {"corrected", "intrinsic"} & set(row.bounds)]
    separated = s.separation(larger) > 2 * larger + beta + epsilon
    names = ("paper", "corrected", "intrinsic", "3 beta + epsilon, all edges", "2 beta + epsilon, all edges")
    return Check("corollary", _verdicts(step, rows, names, separated), alpha, epsilon, delta, tuple(rows))


def _bounds(f: int, betas: dict[str, Beta], *, times: int = 1, plus: float = 0.0) -> dict[str, float]:
    """Return times * beta + plus for every version that is about loop f."""
    return {name: times * float(beta.value[f]) + plus for name, beta in betas.items() if f < len(beta.value)}


def _loop_checks(step: Step, places: Sequence[str], bounds: Sequence[dict[str, float]]) -> list[LoopCheck]:
    """Measure the distances between the killers of a loop from place to place, for the longest-lived loops of S_t."""
    n = len(bounds)
    legs = np.array([np.diagonal(step.killer_distances(*pair, n)) for pair in pairwise(places)]).T.tolist()
    ends = np.diagonal(step.killer_distances(places[0], places[-1], n)).tolist()
    lifetimes = step.before.diagram.lifetime.tolist()
    deaths = step.before.diagram.death.tolist()
    return [LoopCheck(f, lifetimes[f], deaths[f], ends[f], tuple(legs[f]), bounds[f]) for f in range(n)]


def _verdicts(step: Step, rows: Sequence[LoopCheck], versions: Iterable[str], separated: bool) -> dict[str, Verdict]:
    """Return the verdict on every version; only the paper's version assumes that loops are separated."""
    return {version: _verdict(step, rows, version, separated or version != "paper") for version in versions}


def _verdict(step: Step, rows: Sequence[LoopCheck], version: str, hypotheses: bool) -> Verdict:
    """Return the verdict on a version at the loop where it is tightest."""
    concerned = [row for row in rows if version in row.bounds]
    if not concerned:
        return Verdict(0.0, 0.0, True, hypotheses)
    worst = max(concerned, key=lambda row: row.statistic - row.bounds[version])
    return compare(worst.statistic, worst.bounds[version], step.tolerance, len(concerned), hypotheses)


def converse(
    before: ArrayLike | Step, observed_before: Given = None, after: Given = None, observed_after: Given = None
) -> Check:
    """Check that observed killers which are close belong to the same loop: the converse of the corollary, which tracking needs.

    The paper concludes this when killers in S_t are more than 2 alpha + beta + epsilon apart. Its own Assumption 3 rules that out
    in a scene that is connected in steps of 4 alpha and at least four deaths wide: some rival of one loop has an end at the
    killer of the other, so both killers are within beta. The same holds where two loops die within alpha of each other. The
    killers of other loops are critical edges, too. So only the distance of a critical edge to the nearest killer can be small.

    Corrected: let every critical edge in the window of some loop with a lifetime above alpha + 2 epsilon lie within beta of the
    *nearest* killer of such a loop, and let these killers be more than 4 beta + 2 epsilon apart. Then each observed killer has
    one place: the killer in S_t within beta of it (beta + epsilon at t + 1). Two observed killers of t and t + 1 are within
    the reach 2 beta + epsilon if and only if they have the same place. The statistic is the reach; the bound is the least
    distance between killers of different places. Proof: both are critical, as in the corollary; apply the triangle inequality
    through their places. Intrinsic: the `distortion` in place of epsilon, but not where epsilon bounds how far edges move. The
    check is empty where there are not two loops that live long enough.

    Parameters
    ----------
    before, observed_before, after, observed_after
        As in `gates`.
    """
    step = as_step(before, observed_before, after, observed_after)
    alpha = step.alpha
    epsilon = step.epsilon
    delta = step.distortion
    versions = {
        "paper": _by_loop(step, step.larger_alpha),
        "corrected": _by_nearest_killer(step, alpha, epsilon),
        "intrinsic": _by_nearest_killer(step, alpha, delta),
    }
    return Check("converse", versions, alpha, epsilon, delta)


def _by_loop(step: Step, alpha: float) -> Verdict:
    """Check the paper's version: killers of different loops are farther apart than the corollary's bound."""
    s = step.before
    n_loops = int((s.diagram.lifetime > alpha).sum())
    if n_loops < 2:
        return Verdict(0.0, np.inf, True)
    beta = max(state.beta_all(alpha, alpha, alpha).max for state in (s, step.after))
    reach = 2 * alpha + beta + step.epsilon
    distance = step.killer_distances("O_t", "O_t+1", n_loops)
    np.fill_diagonal(distance, np.inf)
    least = float(distance.min())
    return Verdict(reach, least, least > reach - step.tolerance, s.separation(alpha) > reach, n_loops)


def _by_nearest_killer(step: Step, alpha: float, change: float) -> Verdict:
    """Check that observed killers with the same nearest killer in S_t are within reach, and those with different ones are not."""
    s = step.before
    min_lifetime = alpha + 2 * change
    n_loops = int((s.diagram.lifetime > min_lifetime).sum())
    if n_loops < 2:
        return Verdict(0.0, np.inf, True)
    reach = 2 * s.beta_critical(min_lifetime, alpha, change, nearest=True).max + step.epsilon
    edges = [step.killers(place, n_loops) for place in ("O_t", "O_t+1")]
    if np.min(edges) < 0:  # a loop has no counterpart, against the theorem
        return Verdict(reach, 0.0, False, True, n_loops)

    # Find the killer in S_t that is nearest to each observed killer, at both times.
    killers = s.diagram.killer_edge[:n_loops]
    nearest = [np.argmin([s.edge_distances(observed, killer) for killer in killers], axis=0) for observed in edges]
    of_one_place = np.equal.outer(*nearest)
    distance = step.killer_distances("O_t", "O_t+1", n_loops)
    least = float(distance[~of_one_place].min(initial=np.inf))
    most = float(distance[of_one_place].max(initial=0.0))
    holds = least > reach - step.tolerance and most <= reach + step.tolerance
    return Verdict(reach, least, holds, s.separation(min_lifetime) > 2 * reach, n_loops)
