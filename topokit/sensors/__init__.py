"""Clouds of sensors, made ready for the tracker: read from files, cleaned step by step, and remembered where they are hidden.

Taught in chapter 8.
"""

from typing import TYPE_CHECKING

from topokit._lazy import attach

if TYPE_CHECKING:
    from ._clean import Cleaner
    from ._memory import CloudMemory
    from ._read import read_clouds

__getattr__, __dir__, __all__ = attach(__name__, __file__, "sensors")
