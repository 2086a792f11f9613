"""Kinds of cloth, and the physics of a garment made of one.

Idea: with springs of stiffness k = s m / (N dt^2) the mass m cancels in the strain: a strap that carries the garment stretches by
about g dt^2 S / (s L^2), where S is the garment's size and L the length of its edges. Small or fine meshes are rubber because the
clock is too slow for them, not because they are heavy. So dt goes with L / sqrt(S), and mass follows area.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from topokit._config import NotNegative, Positive, checked

from ._garments import WARDROBE, Garment
from ._surface import face_areas
from ._world import SimulationConfig

_FRAME = 0.036  # s, between two frames
_STEPS = (27, 81)  # of a frame: a slower clock lets straps tunnel, a quicker one takes long
_CLOCK = 1.0  # m^0.5, steps of a frame times L / sqrt(S): about what the wardrobe's garments have
_MARGIN = (0.3, 0.18)  # of the shortest edge, and of the usual one, at most


@checked
class Cloth:
    """A kind of cloth, by numbers that do not depend on a garment's size or resolution."""

    density: Positive = 0.25  #: kg/m^2
    stiffness: Positive = 0.8  #: of the springs, as in `SimulationConfig`
    bending: NotNegative = 0.0003  #: stiffness as a share of the elastic one at 750 steps a second
    damping: NotNegative = 350.0  #: of the springs, 1/s: per mass of a vertex
    friction: NotNegative = 1.0  #: coefficient

    def config(self, garment: Garment, **options: Any) -> SimulationConfig:
        """Return the physics of a garment of this cloth: its mass is area times density, its clock as fast as its edges ask.

        Parameters
        ----------
        garment : Garment
        **options
            Fields of `SimulationConfig`, as they shall be instead.
        """
        area, lengths = float(face_areas(garment.vertices, garment.faces).sum()), garment.edge_lengths
        usual, mass = float(np.median(lengths)), self.density * area
        steps = min(max(math.ceil(_CLOCK * area**0.25 / usual), _STEPS[0]), _STEPS[1])
        physics = {
            "dt": _FRAME / steps,
            "steps_per_frame": steps,
            "mass": mass,
            "stiffness": self.stiffness,
            "bending": self.bending * (_STEPS[0] / steps) ** 2,  # the same acceleration at any clock
            "damping": self.damping * mass / len(garment.vertices),
            "friction": self.friction,
            "margin": min(_MARGIN[0], _MARGIN[1] * usual / float(lengths.min())),
        }
        return SimulationConfig(**{**physics, **options})


# Area densities (as ISO 3801 measures them) are typical of such fabrics; how far each drapes is measured by tests/drape.py.
CLOTHS: Mapping[str, Cloth] = {
    "canvas": Cloth(density=0.34, stiffness=0.6, bending=0.4, damping=60.0),
    "cotton": Cloth(density=0.15, stiffness=0.6, bending=0.1, damping=60.0, friction=0.8),
    "jersey": Cloth(density=0.18, stiffness=0.6, bending=0.03, damping=60.0),
    "silk": Cloth(density=0.06, stiffness=0.8, bending=0.0003, damping=60.0, friction=0.5),
}
"""Kinds of cloth by their names."""


def usual_config(garment: Garment) -> SimulationConfig:
    """The physics of a garment when none is asked for: by its area and its edges when it is not in the wardrobe."""
    return SimulationConfig() if garment.name in WARDROBE else Cloth().config(garment)
