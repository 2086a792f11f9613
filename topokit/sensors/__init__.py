"""Clouds of sensors, made ready for the tracker: from files, streams, depth images and ROS bags, through a declared pipeline.

Taught in chapter 8.
"""

from typing import TYPE_CHECKING

from topokit._lazy import attach

if TYPE_CHECKING:
    from ._files import read_clouds, read_stream
    from ._memory import CloudMemory
    from ._pipeline import Cleaner, Pipeline

__getattr__, __dir__, __all__ = attach(__name__, __file__, "sensors")
