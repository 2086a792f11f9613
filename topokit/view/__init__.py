"""Pictures: diagrams, tracks, cloths, and interactive figures that need no kernel.

Everything here needs Matplotlib (`pip install topokit[view]`).
"""

from typing import TYPE_CHECKING

from topokit._lazy import attach

if TYPE_CHECKING:
    from ._cloth import plot_cloth
    from ._diagrams import plot_diagram, plot_tracks
    from ._figure import HtmlFigure
    from ._looks import loop_colour
    from ._player import player

__getattr__, __dir__, __all__ = attach(__name__, __file__, "view")
