"""All statements on one step of a sequence, and on every step of a recorded episode.

Taught in chapter 5.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .._validate import as_sequence
from ._converse import check_converse
from ._diagrams import (
    check_feature_approximation,
    check_gates,
    check_observability,
    check_temporal_persistence,
    vertex_views,
)
from ._killers import check_corollary, check_recovering_killers, check_regularity
from ._verdict import Check
from ._view import Motion, State, View, as_motion, vertex_ids

__all__ = ["STATEMENTS", "StepCheck", "check_episode", "check_step"]

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


def check_step(
    before: ArrayLike, observed_before: ArrayLike, after: ArrayLike, observed_after: ArrayLike
) -> dict[str, Check]:
    """Check all statements on two states in succession; those about one state on the first.

    Parameters
    ----------
    before, after : (n, d) array_like
        S_t and S_t+1: row i of both is the same point.
    observed_before, observed_after : (m,) array_like of int, or (m, d) array_like
        O_t and O_t+1: vertex ids, or coordinates of vertices.

    Returns
    -------
    dict of str to Check
        By statement, in the order of `STATEMENTS`.

    Raises
    ------
    TypeError, ValueError
        When they are no point clouds, differ in shape, or what is observed is not in the state.

    Examples
    --------
    >>> square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    >>> checks = check_step(square, [0, 1, 2, 3], square + [0.01, 0], [0, 1, 2, 3])
    >>> [name for name, check in checks.items() if not check.corrected.holds]
    []
    """
    motion = as_motion(before, after)
    return _check(motion, *vertex_views(motion, observed_before, observed_after))


def _check(motion: Motion, seen: View, seen_after: View) -> dict[str, Check]:
    checks = (
        check_feature_approximation(seen),
        check_observability(seen),
        check_temporal_persistence(motion),
        check_gates(motion, seen, seen_after),
        check_recovering_killers(seen),
        check_regularity(motion, max(seen.alpha, seen_after.alpha)),
        check_corollary(motion, seen, seen_after),
        check_converse(motion, seen, seen_after),
    )
    return {check.statement: check for check in checks}


def check_episode(
    points: ArrayLike | Sequence[ArrayLike],
    observed: ArrayLike | Sequence[ArrayLike],
    *,
    stride: int = 1,
    progress: bool = False,
) -> list[StepCheck]:
    """Check all statements on every step of a sequence.

    Parameters
    ----------
    points : (T, n, d) array_like
        The states: full vertices, in the same order in every frame.
    observed : (m,) array_like of int, (T, m) array_like of int, or (T, m, d) array_like
        What is observed: the same vertices in every frame, vertices by frame, or their coordinates. A list of T may differ in
        length.
    stride : int
        Look at every stride-th frame only; a step is then from one to the next of those.
    progress : bool
        Count the steps done on stderr.

    Returns
    -------
    list of StepCheck
        One a step: one fewer than frames looked at.

    Raises
    ------
    TypeError, ValueError
        When the frames do not fit each other, or what is observed is not among the vertices (cameras see the surface between
        them); the message names the frame.

    Examples
    --------
    >>> angle = 2 * np.pi * np.arange(24) / 24
    >>> circle = np.column_stack([np.cos(angle), np.sin(angle)])
    >>> steps = check_episode([circle, 1.01 * circle, 1.02 * circle], np.arange(0, 24, 2))
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
    looked_at = range(0, len(frames), stride)
    ids = [vertex_ids(frames[t], per_frame[t], f"observed[{t}]") for t in looked_at]
    views = [View(State(frames[t]), seen) for t, seen in zip(looked_at, ids, strict=True)]
    steps = []
    for done, (t, seen, seen_after) in enumerate(zip(looked_at, views[:-1], views[1:], strict=False), 1):
        steps.append(_step(t, seen, seen_after))
        vars(seen.state).pop("distances", None)  # (n, n) a frame: not needed again
        if progress:
            print(f"\rlemmas: {done} of {len(views) - 1} steps", end="", file=sys.stderr, flush=True)
    if progress and steps:
        print(file=sys.stderr)
    return steps


def _step(frame: int, seen: View, seen_after: View) -> StepCheck:
    motion = Motion(seen.state, seen_after.state)
    checks = _check(motion, seen, seen_after)
    s, check, epsilon = motion.before.diagram, checks["corollary"], motion.epsilon
    return StepCheck(
        frame,
        check.alpha,
        epsilon,
        motion.distortion,
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


def _per_frame(observed: ArrayLike | Sequence[ArrayLike], n_frames: int) -> Sequence[ArrayLike]:
    """What is observed in each frame."""
    sets = list(observed)  # type: ignore[arg-type]
    if sets and np.ndim(sets[0]) == 0:
        return [np.asarray(observed)] * n_frames
    if len(sets) != n_frames:
        raise ValueError(f"observed has {len(sets)} frames, points {n_frames}")
    return sets
