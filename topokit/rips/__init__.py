"""Exact degree-1 Vietoris-Rips persistence with, for every loop, the simplices that create and end it.

Source: Antonova et al. 2021, section 3 (definitions); Koyama, Memoli, Robins, Turner 2023 (the lune reduction).
Taught in chapter 0.
"""

from typing import TYPE_CHECKING

from topokit._lazy import attach

if TYPE_CHECKING:
    from ._diagram import Diagram
    from ._persistence import rips_persistence, rips_persistence_many

__getattr__, __dir__, __all__ = attach(__name__, __file__)
