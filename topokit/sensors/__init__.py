"""What sensors send, made ready for the tracker: clouds from files, depth images and ROS bags, and a declared pipeline.

`topokit.io.read_clouds` is the door of the files. Taught in chapter 7.
"""

from typing import TYPE_CHECKING

from topokit._lazy import attach

if TYPE_CHECKING:
    from ._memory import CloudMemory
    from ._pipeline import Cleaner, Pipeline

__getattr__, __all__ = attach(__name__, __file__, "sensors")
