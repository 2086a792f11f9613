"""Figures that the chapters alone show: the data-flow picture, clouds and films under the reader's hand, and lunes."""

from .films import leak, planning, repaint, treatments, turning
from .garments import plans, wardrobe
from .hold import hold
from .lune_plots import plot_lens, plot_lune
from .pages import (
    belief,
    chains,
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
    thinned,
    verdicts,
)

__all__ = [
    "belief",
    "chains",
    "cloud",
    "coverage",
    "critical",
    "data_flow",
    "elimination",
    "gates",
    "growth",
    "hiding",
    "hold",
    "leak",
    "linked",
    "lunes",
    "mixture",
    "motion",
    "nudge",
    "planning",
    "plans",
    "plot_lens",
    "plot_lune",
    "repaint",
    "shares",
    "stray",
    "thinned",
    "treatments",
    "turning",
    "verdicts",
    "wardrobe",
]
