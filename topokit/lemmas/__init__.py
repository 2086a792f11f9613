"""The paper's statements, checked on data: as the paper has them, and as they are true.

    >>> from topokit import lemmas
    >>> print(lemmas.feature_approximation([[0, 0], [1, 0], [1, 1], [0, 1]], [0, 1, 2]))
    feature approximation: alpha 1, epsilon 0, distortion 0
      paper: 1 <= 0 FAILS, 1 loops
        at r = 0.5 S has a loop, O at r + alpha has 0: loop 0 of S_t, edge (0, 2)
      corrected: 0.2071 <= 1 holds, 1 loops

One function a statement; each takes the state S (all points, row i the same point at both times) and what is observed of it
(ids of its points, or their coordinates), measures the constants and the two sides of the inequality, and returns a `Check`.
Throughout, corresponding loops are those that an optimal bottleneck matching pairs.

Source: Antonova et al. 2021, section 4. Taught in chapters 3 to 5.
"""

from __future__ import annotations

from ..sampling import covering_radius
from ._converse import converse
from ._counterexamples import COUNTEREXAMPLES, Counterexample
from ._diagrams import feature_approximation, gates, observability, temporal_persistence
from ._episode import STATEMENTS, StepCheck, check_episode, check_step
from ._killers import corollary, recovering_killers, regularity_of_killers
from ._matching import Matching, match_diagrams
from ._measures import Beta, beta_all, beta_critical, distortion, feature_separation, max_displacement
from ._stability import Jump, killer_jumps
from ._verdict import Check, LoopCheck, Verdict, Witness
from ._view import vertex_ids

__all__ = [
    "COUNTEREXAMPLES",
    "STATEMENTS",
    "Beta",
    "Check",
    "Counterexample",
    "Jump",
    "LoopCheck",
    "Matching",
    "StepCheck",
    "Verdict",
    "Witness",
    "beta_all",
    "beta_critical",
    "check_episode",
    "check_step",
    "converse",
    "corollary",
    "covering_radius",
    "distortion",
    "feature_approximation",
    "feature_separation",
    "gates",
    "killer_jumps",
    "match_diagrams",
    "max_displacement",
    "observability",
    "recovering_killers",
    "regularity_of_killers",
    "temporal_persistence",
    "vertex_ids",
]
