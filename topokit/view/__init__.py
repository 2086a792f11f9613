"""Pictures: diagrams, tracks, cloths, and interactive figures that need no kernel.

Everything here needs Matplotlib. `render_cloth` draws better with PyVista, which is imported only there.
"""

from importlib.util import find_spec

if find_spec("matplotlib") is None:
    raise ImportError("topokit.view needs matplotlib: pip install 'topokit[view]'")

from topokit._lazy import shown

from ._figure import HtmlFigure
from ._player import plans, player, wardrobe
from ._plots import Scene, appearances, loop_colour, plot_cloth, plot_diagram, plot_tracks, track_figure
from ._render import pyvista_works, render_cloth, save_animation

__all__ = sorted(shown(__file__))
