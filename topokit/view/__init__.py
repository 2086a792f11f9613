"""Pictures: diagrams, tracks, cloths, and interactive figures that need no kernel.

Everything here needs Matplotlib (`pip install topokit[view]`). `render_cloth` draws better with PyVista, which is imported only
there.
"""

from typing import TYPE_CHECKING

from topokit._lazy import attach

if TYPE_CHECKING:
    from ._figure import HtmlFigure
    from ._looks import loop_colour
    from ._player import plans, player, wardrobe
    from ._plots import Scene, appearances, plot_cloth, plot_diagram, plot_tracks, track_figure
    from ._render import pyvista_works, render_cloth, save_animation

__getattr__, __dir__, __all__ = attach(__name__, __file__, "view")
