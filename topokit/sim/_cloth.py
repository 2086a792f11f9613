"""Kinds of cloth, and the physics of a garment made of a kind of cloth.

Idea: with springs of stiffness k = s m / (N dt^2) the mass m cancels in the strain: a strap that carries the garment stretches by
about g dt^2 S / (s L^2), where S is the garment's size and L the length of its edges. Small or fine meshes are rubber because the
clock is too slow for them, not because they are heavy. So dt goes with L / sqrt(S), and mass follows area.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from topokit._config import NotNegative, Positive, checked

from ._garments import Garment
from ._wardrobe import WARDROBE
from ._world import SimulationConfig

_FRAME = 0.036  # time between two frames, seconds
_FEWEST_STEPS = 27  # least steps of a frame: with a slower clock straps tunnel
_MOST_STEPS = 81  # most steps of a frame: a quicker clock takes long
_CLOCK = 1.0  # m^0.5, steps of a frame times L / sqrt(S): about the value of the wardrobe's garments
_MARGIN = 0.3  # largest margin as a share of the shortest edge
_MARGIN_OF_USUAL = 0.18  # largest margin as a share of the median edge


@checked
class Cloth:
    """A kind of cloth, by numbers that do not depend on a garment's size or resolution."""

    density: Positive = 0.25  #: mass per area, kg/m^2
    stiffness: Positive = 0.8  #: stiffness of the springs, see `SimulationConfig`
    bending: NotNegative = 0.0003  #: bending stiffness as a share of the elastic one, at 750 steps a second
    damping: NotNegative = 350.0  #: damping of the springs per mass of a vertex, 1/s
    friction: NotNegative = 1.0  #: coefficient of friction

    KINDS: ClassVar[Mapping[str, Cloth]] = {}  #: canvas, cotton, jersey and silk by their names

    def config(self, garment: Garment, **options: Any) -> SimulationConfig:
        """Return the physics of a garment of this cloth: the mass is area times density, the clock is as fast as the edges need.

        Parameters
        ----------
        garment : Garment
        **options
            Fields of `SimulationConfig` that replace the computed ones.
        """
        area = garment.area
        mass = self.density * area
        shortest = float(garment.edge_lengths.min())
        usual = float(np.median(garment.edge_lengths))
        # sqrt(S) is area**0.25, as S goes with the square root of the area.
        steps = min(max(math.ceil(_CLOCK * area**0.25 / usual), _FEWEST_STEPS), _MOST_STEPS)
        physics = {
            "dt": _FRAME / steps,
            "steps_per_frame": steps,
            "mass": mass,
            "stiffness": self.stiffness,
            "bending": self.bending * (_FEWEST_STEPS / steps) ** 2,  # the same acceleration at any clock
            "damping": self.damping * mass / len(garment.vertices),
            "friction": self.friction,
            "margin": min(_MARGIN, _MARGIN_OF_USUAL * usual / shortest),
        }
        return SimulationConfig(**{**physics, **options})


# Area densities (as ISO 3801 measures them) are typical of such fabrics; book/experiments/drape.py measures how far each drapes.
Cloth.KINDS = {
    "canvas": Cloth(density=0.34, stiffness=0.6, bending=0.4, damping=60.0),
    "cotton": Cloth(density=0.15, stiffness=0.6, bending=0.1, damping=60.0, friction=0.8),
    "jersey": Cloth(density=0.18, stiffness=0.6, bending=0.03, damping=60.0),
    "silk": Cloth(density=0.06, stiffness=0.8, bending=0.0003, damping=60.0, friction=0.5),
}


def usual_config(garment: Garment, **options: Any) -> SimulationConfig:
    """Return the default physics of a garment: the standard one for the wardrobe, else one for its area and edges."""
    if garment.name in WARDROBE:
        return SimulationConfig(**options)
    return Cloth().config(garment, **options)
