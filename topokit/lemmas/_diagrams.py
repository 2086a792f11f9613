"""The statements about persistence diagrams: approximation, observability, temporal persistence, gates.

Source: Antonova et al. 2021, section 4. Taught in chapters 3 and 4.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._validate import Array
from ..rips import Diagram
from ._matching import DiagramMatching, longest_unmatched, match_diagrams
from ._step import Check, Given, Step, Verdict, as_step, compare


def feature_approximation(state: ArrayLike | Step, observed: Given = None) -> Check:
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
    state : (n, d) array_like, or Step
        S_t; or a step that holds all, as in the other statements.
    observed : array_like, optional
        O_t: (m,) ids of points of S_t; all of them when not given.
    """
    step = as_step(state, observed)
    alpha = step.before.alpha
    versions = {"paper": _some_loop_of_o(step, alpha), "corrected": rank_inequality(step, alpha)}
    return Check("feature approximation", versions, alpha)


def _some_loop_of_o(step: Step, alpha: float) -> Verdict:
    """Check that O has a loop at r + alpha where S has one at r, at the values of r where that may begin to be false."""
    s = step.diagram("S_t")
    o = step.diagram("O_t")
    tolerance = step.tolerance
    if len(s) == 0:
        return Verdict(0.0, 0.0, True)
    # S has a loop at r from a birth on; O loses one at r + alpha with a death.
    radii = np.concatenate([s.birth, o.death - alpha])
    alive = (s.birth[:, None] <= radii) & (s.death[:, None] > radii + tolerance)
    shifted = radii + alpha + tolerance
    in_o = ((o.birth[:, None] <= shifted) & (o.death[:, None] > shifted)).sum(axis=0)
    loops_of_o = np.where(alive.any(axis=0), in_o, len(s) + len(o))
    return compare(1.0, float(loops_of_o.min()), 0.0, len(s))


def rank_inequality(step: Step, alpha: float) -> Verdict:
    """Compare with alpha the least c such that at most as many bars of S contain [r, r + c] as bars of O are alive at r + c.

    At the value v = r + c, where O has m loops, c must be at least the age of the (m + 1)-th oldest loop of S. Between two
    values where something is born or dies only the ages change: they are largest at the end.
    """
    s = step.diagram("S_t")
    o = step.diagram("O_t")
    tolerance = step.tolerance

    # The intervals between events, how many loops O has in each, and when the loops of S that are alive were born.
    events = np.unique(np.concatenate([s.birth, s.death, o.birth, o.death]))
    long = np.diff(events) > tolerance  # equal up to rounding is equal
    start = events[:-1][long]
    end = events[1:][long]
    in_o = _alive(o, start, end).sum(axis=0)
    born = np.sort(np.where(_alive(s, start, end), s.birth[:, None], np.inf), axis=0)
    born = np.vstack([born, np.full(len(start), np.inf)])

    # The age that the (m + 1)-th oldest loop of S reaches; the oldest of these decides.
    age = end - born[np.minimum(in_o, len(s)), np.arange(len(start))]
    return compare(float(age.max(initial=0.0)), alpha, tolerance, len(s))


def _alive(diagram: Diagram, start: Array, end: Array) -> NDArray[np.bool_]:
    """Return (n, k) which bars contain which of k intervals."""
    return np.asarray((diagram.birth[:, None] <= start) & (diagram.death[:, None] >= end))


def observability(state: ArrayLike | Step, observed: Given = None) -> Check:
    """Check that loops of the state with a lifetime above alpha are seen, and when (Lemma 2).

    The paper: every such loop has a counterpart in O with 0 <= birth_O - birth_S <= alpha, and the same for deaths. True, and
    the threshold is sharp. The statistic is the lifetime of the longest loop of S that must go without such a counterpart.

    Corrected, or rather completed: one matching does this for all loops at once, and leaves no loop of O with a lifetime
    above alpha alone either. The statistic is the least c for which a matching with all shifts in [0, c] leaves only bars of
    lifetime at most c alone. Proof: with S shifted by alpha / 2 the two persistence modules are alpha / 2-interleaved, by the
    inclusion and the nearest-point map; apply the isometry theorem.

    Parameters
    ----------
    state, observed
        As in `feature_approximation`.
    """
    step = as_step(state, observed)
    alpha = step.before.alpha
    versions = {
        "paper": _unmatched(step, "O_t", alpha),
        "corrected": _bottleneck(step, "S_t", "O_t", step.before.matching, alpha, alpha + step.tolerance),
    }
    return Check("observability", versions, alpha)


def temporal_persistence(before: ArrayLike | Step, after: Given = None) -> Check:
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
        S_t and S_t+1: row i of both is the same point. Or a Step in the place of `before`.
    """
    step = as_step(before, after=after)
    epsilon = step.epsilon
    delta = step.distortion
    versions = {"paper": _unmatched(step, "S_t+1", epsilon)}
    for version, bound in (("corrected", epsilon), ("intrinsic", delta)):
        versions[version] = _bottleneck(step, "S_t", "S_t+1", step.matching, bound, 2 * bound)
    return Check("temporal persistence", versions, epsilon=epsilon, distortion=delta)


def gates(
    before: ArrayLike | Step, observed_before: Given = None, after: Given = None, observed_after: Given = None
) -> Check:
    """Check how far births and deaths move between observations: the gates of Algorithm 1.

    The paper lets loops correspond when both values change by less than 2 alpha + epsilon: valid, and loose. Corrected:
    the bottleneck distance of the diagrams of O_t and O_t+1 is at most alpha + epsilon, so that a counterpart is guaranteed to
    observed loops with a lifetime above 2 (alpha + epsilon). Proof: the inclusion of O_t, the motion and the nearest-point map
    at t + 1 send VR_r(O_t) into VR_(r + epsilon + alpha)(O_t+1), and back the same way: an (alpha + epsilon)-interleaving.
    Intrinsic: the `distortion` in place of epsilon.

    Parameters
    ----------
    before, observed_before, after, observed_after : array_like
        S_t and S_t+1, both (n, d); O_t and O_t+1: (m,) ids of their points. Or a Step in the place of `before`.
    """
    step = as_step(before, observed_before, after, observed_after)
    alpha = step.alpha
    epsilon = step.epsilon
    delta = step.distortion
    match = match_diagrams(step.diagram("O_t"), step.diagram("O_t+1"))
    bounds = {"paper": 2 * alpha + epsilon, "corrected": alpha + epsilon, "intrinsic": alpha + delta}
    versions = {name: _bottleneck(step, "O_t", "O_t+1", match, bound, 2 * bound) for name, bound in bounds.items()}
    return Check("gates", versions, alpha, epsilon, delta)


def _unmatched(step: Step, place: str, bound: float) -> Verdict:
    """Compare with a bound the longest loop of S_t without a counterpart in a place whose values differ by at most that bound."""
    s = step.diagram("S_t")
    tolerance = step.tolerance
    one_sided = place == "O_t"
    alone = longest_unmatched(s, step.diagram(place), bound + tolerance, one_sided=one_sided, tolerance=tolerance)
    return compare(alone, bound, tolerance, int((s.lifetime > bound + tolerance).sum()))


def _bottleneck(step: Step, first: str, second: str, match: DiagramMatching, bound: float, shortest: float) -> Verdict:
    """Compare the cost of an optimal matching of two places with a bound, for bars longer than `shortest`."""
    long = sum(int((step.diagram(place).lifetime > shortest).sum()) for place in (first, second))
    return compare(match.cost, bound, step.tolerance, long)
