"""The paper's statements, checked on data: as the paper has them, and as they are true.

One function a statement; each takes the state S (all points, row i the same point at both times) and what is observed of it
(ids of its points, or their coordinates), measures the constants and the two sides of the inequality, and returns a `Check`.
Throughout, corresponding loops are those that an optimal bottleneck matching pairs.

Source: Antonova et al. 2021, section 4. Taught in chapters 3 to 6.
"""

from topokit._lazy import shown

from ._diagrams import feature_approximation, gates, observability, temporal_persistence
from ._killers import converse, corollary, recovering_killers, regularity_of_killers
from ._matching import killer_jumps, match_diagrams
from ._measures import beta_all, beta_critical, feature_separation
from ._step import Check, LoopCheck, Verdict, Witness, distortion, max_displacement, vertex_ids
from ._verify import COUNTEREXAMPLES, STATEMENTS, Counterexample, StepCheck, verify_episode, verify_step

__all__ = sorted(shown(__file__))
