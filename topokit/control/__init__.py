"""Controllers: hang a garment by what is seen of it, in a closed loop. Needs `pip install 'topokit[sim]'`."""

from typing import TYPE_CHECKING

from topokit._lazy import attach

if TYPE_CHECKING:
    from ._hang import hang
    from ._planner import Planner
    from ._servo import Servo

__getattr__, __dir__, __all__ = attach(__name__, __file__, "sim")
