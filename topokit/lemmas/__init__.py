"""The paper's statements, checked on data: as the paper has them, and as they are true.

One function a statement; each takes the state S (all points, row i the same point at both times) and what is observed of it
(ids of its points), measures the constants and the two sides of the inequality, and returns a `Check`.
Throughout, corresponding loops are those that an optimal bottleneck matching pairs.

Source: Antonova et al. 2021, section 4. Taught in chapters 3 to 6.
"""

from typing import TYPE_CHECKING

from topokit._lazy import attach

if TYPE_CHECKING:
    from ._counterexamples import COUNTEREXAMPLES, verify_step
    from ._diagrams import feature_approximation, gates, observability, temporal_persistence
    from ._killers import converse, corollary, recovering_killers, regularity_of_killers
    from ._matching import match_diagrams
    from ._measures import beta_all, beta_critical

__getattr__, __dir__, __all__ = attach(__name__, __file__)
