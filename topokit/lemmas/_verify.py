"""All statements on one step of a sequence, and on every step of a recorded episode.

Taught in chapter 5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from .._validate import as_sequence
from ._diagrams import check_feature_approximation, check_gates, check_observability, check_temporal_persistence
from ._killers import check_converse, check_corollary, check_recovering_killers, check_regularity
from ._measures import State
from ._step import Step, observed_step, vertex_ids
from ._verdict import Check

STATEMENTS = (
    "feature approximation",
    "observability",
    "temporal persistence",
    "gates",
    "recovering killers",
    "regularity of killers",
    "corollary",
    "converse",
)


@dataclass(frozen=True)
class StepCheck:
    """One step of an episode: the constants, and what became of every statement.

    Attributes
    ----------
    frame : int
        Of S_t; S_t+1 is the next frame that is looked at.
    alpha, epsilon, distortion : float
        In the unit of the points; alpha is the larger of both frames'.
    lifetime, death : float
        Of the longest-lived loop of S_t; 0.0 when there is none.
    beta_all, beta_critical, beta_intrinsic : float
        The largest beta over all edges, of loops with a lifetime above the frame's alpha; over (alpha, epsilon)-critical ones,
        of loops with a lifetime above alpha + 2 epsilon; over (alpha, distortion)-critical ones, of loops above
        alpha + 2 distortion. nan where there is no such loop.
    checks : dict of str to Check
        By statement, in the order of `STATEMENTS`.
    """

    frame: int
    alpha: float
    epsilon: float
    distortion: float
    lifetime: float
    death: float
    beta_all: float
    beta_critical: float
    beta_intrinsic: float
    checks: dict[str, Check]


def verify_step(
    before: ArrayLike, observed_before: ArrayLike, after: ArrayLike, observed_after: ArrayLike
) -> dict[str, Check]:
    """Check all statements on two states in succession, in the order of `STATEMENTS`; those about one state on the first.

    Parameters
    ----------
    before, observed_before, after, observed_after : array_like
        S_t and S_t+1, both (n, d); O_t and O_t+1: (m,) ids of their points or (m, d) coordinates. They need not be the same
        vertices.

    Examples
    --------
    >>> square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    >>> checks = verify_step(square, [0, 1, 2, 3], square + [0.01, 0], [0, 1, 2, 3])
    >>> [name for name, check in checks.items() if not check.corrected.holds]
    []
    """
    return _checks(observed_step(before, observed_before, after, observed_after))


def _checks(step: Step) -> dict[str, Check]:
    still = Step(step.before, step.before)
    checks = (
        check_feature_approximation(still),
        check_observability(still),
        check_temporal_persistence(step),
        check_gates(step),
        check_recovering_killers(still),
        check_regularity(step, step.alpha),
        check_corollary(step),
        check_converse(step),
    )
    return {check.statement: check for check in checks}


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

    Examples
    --------
    >>> angle = 2 * np.pi * np.arange(24) / 24
    >>> circle = np.column_stack([np.cos(angle), np.sin(angle)])
    >>> steps = verify_episode([circle, 1.01 * circle, 1.02 * circle], np.arange(0, 24, 2))
    >>> [step.checks["corollary"].corrected.holds for step in steps]
    [True, True]
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
        return [np.asarray(observed)] * n_frames
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
