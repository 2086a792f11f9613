"""How well tracked loops agree with the true ones."""

from .localisation import TrackSummary, distance_to_hull, summarise_tracks
from .tracking import TrackingScore, compare, score, true_loops

__all__ = [
    "TrackSummary",
    "TrackingScore",
    "compare",
    "distance_to_hull",
    "score",
    "summarise_tracks",
    "true_loops",
]
