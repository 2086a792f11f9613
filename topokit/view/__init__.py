"""Pictures: diagrams, tracks, cloths, and figures that move without a kernel.

Everything here needs Matplotlib; `render_cloth` draws better with PyVista, which is imported only there.

    >>> from topokit.view import loop_colour
    >>> loop_colour(0)
    '#D55E00'
"""

from __future__ import annotations

from importlib.util import find_spec

if find_spec("matplotlib") is None:
    raise ImportError("topokit.view needs matplotlib: pip install 'topokit[view]'")

from ._animation import save_animation
from ._coverage import Coverage, coverage
from ._flow import DataFlow, data_flow
from ._growth import Growth, growth
from ._lens import plot_lens
from ._lunes import plot_lune
from ._motion import Motion, motion
from ._nudge import Nudge, nudge
from ._palette import OKABE_ITO, appearances, long_lived, loop_colour
from ._player import Player, player, telling_frame
from ._plots import plot_cloth, plot_diagram, plot_tracks, track_figure
from ._render import pyvista_works, render_cloth
from ._report import model_label, plot_accuracy, plot_by_horizon, plot_conditions, plot_treatments

__all__ = [
    "OKABE_ITO",
    "Coverage",
    "DataFlow",
    "Growth",
    "Motion",
    "Nudge",
    "Player",
    "appearances",
    "coverage",
    "data_flow",
    "growth",
    "long_lived",
    "loop_colour",
    "model_label",
    "motion",
    "nudge",
    "player",
    "plot_accuracy",
    "plot_by_horizon",
    "plot_cloth",
    "plot_conditions",
    "plot_diagram",
    "plot_lens",
    "plot_lune",
    "plot_tracks",
    "plot_treatments",
    "pyvista_works",
    "render_cloth",
    "save_animation",
    "telling_frame",
    "track_figure",
]
