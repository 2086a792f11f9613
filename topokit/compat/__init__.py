"""Doors to the neighbours: topokit from code that was written for other libraries.

Each takes a library's own types and gives them back. What a door needs is imported with it alone.
"""

from typing import TYPE_CHECKING

from topokit._lazy import attach

if TYPE_CHECKING:
    from ._ripser import ripser
    from ._sklearn import LoopFeatures
    from ._torch import births_and_deaths

__getattr__, __dir__, __all__ = attach(__name__, __file__, "learn,sensors")
