"""How well tracked loops agree with the true ones."""

from .localisation import TrackSummary, distance_to_hull, summarise_tracks

__all__ = ["TrackSummary", "distance_to_hull", "summarise_tracks"]
