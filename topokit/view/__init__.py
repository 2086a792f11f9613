"""Pictures: diagrams, tracks, cloths, and figures that move without a kernel.

Everything here needs Matplotlib; `render_cloth` draws better with PyVista, and `rerun` writes for Rerun: each is imported only
there.
"""

from importlib.util import find_spec

if find_spec("matplotlib") is None:
    raise ImportError("topokit.view needs matplotlib: pip install 'topokit[view]'")

from topokit._lazy import shown

from ._lunes import lunes, plot_lens, plot_lune
from ._pages import coverage, data_flow, elimination, growth, linked, mixture, motion, nudge, stray
from ._player import plans, player, wardrobe
from ._plots import Scene, appearances, loop_colour, plot_cloth, plot_diagram, plot_tracks, track_figure
from ._render import pyvista_works, render_cloth, save_animation
from ._report import model_label, plot_accuracy, plot_by_horizon, plot_conditions, plot_treatments, shares
from ._rerun import rerun

__all__ = sorted(shown(__file__))
