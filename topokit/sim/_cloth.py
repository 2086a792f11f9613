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
        # Steps of a frame go with sqrt(S) / L, about as for the garments of the wardrobe; sqrt(S) is area**0.25. With fewer than
        # 27 of them straps tunnel, and more than 81 take long.
        steps = min(max(math.ceil(area**0.25 / usual), 27), 81)
        physics = {
            "dt": 0.036 / steps,  # a frame takes 36 ms
            "steps_per_frame": steps,
            "mass": mass,
            "stiffness": self.stiffness,
            "bending": self.bending * (27 / steps) ** 2,  # the same acceleration at any clock
            "damping": self.damping * mass / len(garment.vertices),
            "friction": self.friction,
            "margin": min(0.3, 0.18 * usual / shortest),  # at most 0.3 of the shortest edge, and 0.18 of the median one
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
