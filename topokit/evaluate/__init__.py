"""Measures of tracked loops against the true ones. They need the core alone. Taught in chapter 8."""

from typing import TYPE_CHECKING

from topokit._lazy import attach

if TYPE_CHECKING:
    from ._scores import Overlap, events, score
    from ._tracking import compare, distance_to_hull, summarise_tracks, true_loops

__getattr__, __dir__, __all__ = attach(__name__, __file__)
