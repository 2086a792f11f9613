"""Figures that the chapters alone show: the data-flow picture, planar clouds under the reader's hand, and lunes."""

from .lune_plots import plot_lens, plot_lune
from .pages import (
    cloud,
    coverage,
    critical,
    data_flow,
    elimination,
    growth,
    hiding,
    linked,
    lunes,
    mixture,
    motion,
    nudge,
    shares,
    stray,
)

__all__ = [
    "cloud",
    "coverage",
    "critical",
    "data_flow",
    "elimination",
    "growth",
    "hiding",
    "linked",
    "lunes",
    "mixture",
    "motion",
    "nudge",
    "plot_lens",
    "plot_lune",
    "shares",
    "stray",
]
