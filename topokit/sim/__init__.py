"""Simulated garments: made by code, carried by two grippers, hung on a hook, in PyBullet.

Source: Antonova et al. 2021, section 6. Taught in chapter 0.
"""

from .config import SimulationConfig
from .episode import SimulationError, simulate
from .garments import Garment
from .targets import Hook

__all__ = ["Garment", "Hook", "SimulationConfig", "SimulationError", "simulate"]
