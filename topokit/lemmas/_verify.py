"""All statements on one step of a sequence, on every step of a recorded episode, and on small literal counterexamples.

Taught in chapters 3 to 6.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import resources
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._validate import Array, Ids, as_reals, as_sequence
from ._diagrams import check_feature_approximation, check_gates, check_observability, check_temporal_persistence
from ._killers import check_converse, check_corollary, check_recovering_killers, check_regularity
from ._measures import State
from ._step import Check, Step, observed_step, vertex_ids

_CHECKS: dict[str, Callable[[Step], Check]] = {
    "feature approximation": check_feature_approximation,
    "observability": check_observability,
    "temporal persistence": check_temporal_persistence,
    "gates": check_gates,
    "recovering killers": check_recovering_killers,
    "regularity of killers": check_regularity,
    "corollary": check_corollary,
    "converse": check_converse,
}
STATEMENTS = tuple(_CHECKS)


@dataclass(frozen=True)
class StepCheck:
    """One step of an episode: the constants, and what became of every statement. A beta is nan where no loop lives so long."""

    frame: int  #: of S_t; S_t+1 is the next frame that is looked at
    alpha: float  #: the larger of both frames', in the unit of the points
    epsilon: float  #: in the unit of the points
    distortion: float  #: in the unit of the points
    lifetime: float  #: of the longest-lived loop of S_t; 0.0 when there is none
    death: float  #: of the same loop
    beta_all: float  #: the largest beta over all edges, of loops with a lifetime above the frame's alpha
    beta_critical: float  #: over (alpha, epsilon)-critical edges, of loops with a lifetime above alpha + 2 epsilon
    beta_intrinsic: float  #: the same as `beta_critical` with the distortion in place of epsilon
    checks: dict[str, Check]  #: by statement, in the order of `STATEMENTS`


def verify_step(
    before: ArrayLike, observed_before: ArrayLike, after: ArrayLike, observed_after: ArrayLike
) -> dict[str, Check]:
    """Check all statements on two states in succession, in the order of `STATEMENTS`; those about one state on the first.

    Parameters
    ----------
    before, observed_before, after, observed_after : array_like
        S_t and S_t+1, both (n, d); O_t and O_t+1: (m,) ids of their points or (m, d) coordinates.
    """
    return _checks(observed_step(before, observed_before, after, observed_after))


def _checks(step: Step) -> dict[str, Check]:
    return {name: check(step) for name, check in _CHECKS.items()}


def verify_episode(
    points: ArrayLike | Sequence[ArrayLike], observed: ArrayLike | Sequence[ArrayLike], *, stride: int = 1
) -> list[StepCheck]:
    """Check all statements on every step of a sequence: one step fewer than frames looked at.

    Parameters
    ----------
    points : (T, n, d) array_like
        The states: full vertices, in the same order in every frame.
    observed : (m,) array_like of int, (T, m) array_like of int, or (T, m, d) array_like
        What is observed: the same vertices in every frame, vertices by frame, or their coordinates. A list of T may differ in
        length.
    stride : int
        Look at every stride-th frame only; a step is then from one to the next of those.

    Raises
    ------
    TypeError, ValueError
        When the frames do not fit each other, or what is observed is not among the vertices (cameras see the surface between
        them); the message names the frame.
    """
    if not isinstance(stride, (int, np.integer)) or stride < 1:
        raise ValueError(f"stride must be a whole number of frames, 1 or more, not {stride!r}")
    frames = as_sequence(points, "points")
    shapes = {frame.shape for frame in frames}
    if len(shapes) > 1:
        raise ValueError(f"the frames of points differ in shape: {sorted(shapes)}; states are in bijection by row")
    per_frame = _per_frame(observed, len(frames))
    chosen = range(0, len(frames), stride)
    ids = [vertex_ids(frames[t], per_frame[t], f"observed[{t}]") for t in chosen]
    states = map(State, (frames[t] for t in chosen), ids)  # each is dropped after its two steps
    return [_step_check(t, Step(*pair)) for t, pair in zip(chosen, pairwise(states), strict=False)]


def _per_frame(observed: ArrayLike | Sequence[ArrayLike], n_frames: int) -> Sequence[ArrayLike]:
    """What is observed in each frame."""
    sets = list(observed)  # type: ignore[arg-type]
    if sets and np.ndim(sets[0]) == 0:
        return [as_reals(observed, "observed")] * n_frames
    if len(sets) != n_frames:
        raise ValueError(f"observed has {len(sets)} frames, points {n_frames}")
    return sets


def _step_check(frame: int, step: Step) -> StepCheck:
    checks = _checks(step)
    s, check, epsilon = step.before.diagram, checks["corollary"], step.epsilon
    return StepCheck(
        frame,
        check.alpha,
        epsilon,
        step.distortion,
        float(s.lifetime[0]) if len(s) else 0.0,
        float(s.death[0]) if len(s) else 0.0,
        _largest(checks["recovering killers"], "paper"),
        (_largest(check, "corrected") - epsilon) / 2,
        (_largest(check, "intrinsic") - epsilon) / 2,
        checks,
    )


def _largest(check: Check, version: str) -> float:
    """The largest bound of a version, nan where it speaks about no loop."""
    return max((row.bounds[version] for row in check.loops if version in row.bounds), default=float("nan"))


@dataclass(frozen=True, eq=False)
class Counterexample:
    """An instance in the plane, small enough to check by hand, on which a statement fails or a constant is seen to be sharp."""

    statement: str  #: that it is about, one of `STATEMENTS`
    story: str  #: what it shows
    before: Array  #: (n, 2) S_t
    after: Array  #: (n, 2) S_t+1; the same where nothing moves
    observed_before: Ids  #: (m,) vertices seen at t; all of them where the statement has no observation
    observed_after: Ids  #: (k,) vertices seen at t + 1
    #: Whether the paper's statement fails here, its hypotheses being so. Otherwise the instance shows that a constant is
    #: sharp, or an assumption cannot hold.
    refutes: bool

    def check(self) -> Check:
        """The statement on this instance."""
        return verify_step(self.before, self.observed_before, self.after, self.observed_after)[self.statement]


def _counterexample(entry: dict[str, Any]) -> Counterexample:
    before, after = (np.array(entry.get(when, entry["before"])) for when in ("before", "after"))
    seen, seen_after = (np.delete(np.arange(len(before)), entry.get(key, ())) for key in ("unseen", "unseen_after"))
    for array in (before, after, seen, seen_after):
        array.setflags(write=False)
    return Counterexample(entry["statement"], entry["story"], before, after, seen, seen_after, entry["refutes"])


_ENTRIES = json.loads(resources.files(__package__).joinpath("counterexamples.json").read_text(encoding="utf-8"))
COUNTEREXAMPLES = MappingProxyType({name: _counterexample(entry) for name, entry in _ENTRIES.items()})
