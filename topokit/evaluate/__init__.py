"""How good tracked and forecast loops are, against the true ones.

Scores of trackers need the core alone. Forecasts need `pip install topokit[learn,data]`, and a report `topokit[view]`;
nothing here imports them before they are used.
"""

from typing import TYPE_CHECKING

from topokit._lazy import attach

from ._scores import Event, Overlap, TrackingScore, events, score
from ._tracking import (
    TrackSummary,
    TrueLoops,
    by_diagram,
    by_killer,
    by_midpoint,
    by_place,
    compare,
    distance_to_hull,
    summarise_tracks,
    track_vines,
    true_loops,
)

if TYPE_CHECKING:
    from ._conditions import Clouds, Condition, EvaluationConfig, load_evaluation
    from ._forecasts import evaluate_forecasts
    from ._results import library_digest, read_results, write_report
    from ._summary import Bootstrap, Estimate

__getattr__, __all__ = attach(__name__, __file__, "learn,data")
