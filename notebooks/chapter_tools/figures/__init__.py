"""Figures that the chapters alone show: the data-flow picture, clouds and films under the reader's hand, and lunes."""

from .films import planning, repaint, treatments, turning
from .lune_plots import plot_lens, plot_lune
from .pages import (
    belief,
    cloud,
    coverage,
    critical,
    data_flow,
    elimination,
    gates,
    growth,
    hiding,
    linked,
    lunes,
    mixture,
    motion,
    nudge,
    shares,
    stray,
    verdicts,
)

__all__ = [
    "belief",
    "cloud",
    "coverage",
    "critical",
    "data_flow",
    "elimination",
    "gates",
    "growth",
    "hiding",
    "linked",
    "lunes",
    "mixture",
    "motion",
    "nudge",
    "planning",
    "plot_lens",
    "plot_lune",
    "repaint",
    "shares",
    "stray",
    "treatments",
    "turning",
    "verdicts",
]
