"""Controllers: hang a garment by what is seen of it, in a closed loop.

Source: Antonova et al. 2021 ends with the promise of real-time planning and control; the servo is ours. It needs
`pip install 'topokit[sim]'` for `hang`; the controller alone needs the core.
"""

from typing import TYPE_CHECKING

from topokit._lazy import attach

if TYPE_CHECKING:
    from ._hang import Controller, Hanging, hang
    from ._servo import Servo

__getattr__, __all__ = attach(__name__, __file__, "sim")
