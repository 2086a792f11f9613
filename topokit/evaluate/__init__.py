"""Measures of tracked and forecast loops against the true ones.

Scores of trackers need the core alone. `measure_forecasts` needs `pip install topokit[learn]`, and nothing here imports torch
before it is used.
"""

from typing import TYPE_CHECKING

from topokit._lazy import attach

if TYPE_CHECKING:
    from ._accuracy import TrueCurves, measure_forecasts
    from ._scores import Overlap, TrackingScore, events, score
    from ._tracking import TrueLoops, compare, distance_to_hull, summarise_tracks, true_loops

__getattr__, __dir__, __all__ = attach(__name__, __file__, "learn")
