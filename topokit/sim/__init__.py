"""Simulated garments: made by code, carried by two grippers, hung on hooks, hangers and mannequins, in PyBullet.

Source: Antonova et al. 2021, section 6. Taught in chapters 0 and 7.
"""

from __future__ import annotations

import importlib.util
from typing import TYPE_CHECKING, Any

from .camera import Camera, DepthNoise, cameras_around, observe
from .config import SimulationConfig
from .episode import simulate
from .garments import WARDROBE, Garment
from .paths import GripperPath, Via
from .randomise import Randomisation
from .recording import SimulationError
from .targets import Hanger, Hook, Mannequin, Target
from .tasks import TASKS, Task
from .world import World

if TYPE_CHECKING:
    from .env import HangEnv

__all__ = [
    "TASKS",
    "WARDROBE",
    "Camera",
    "DepthNoise",
    "Garment",
    "GripperPath",
    "HangEnv",
    "Hanger",
    "Hook",
    "Mannequin",
    "Randomisation",
    "SimulationConfig",
    "SimulationError",
    "Target",
    "Task",
    "Via",
    "World",
    "cameras_around",
    "observe",
    "simulate",
]

if importlib.util.find_spec("gymnasium"):  # so that gymnasium.make knows the environment once this package is imported
    from gymnasium import register

    register("topokit/Hang-v0", "topokit.sim.env:HangEnv")


def __getattr__(name: str) -> Any:
    """Import `HangEnv` when it is used: only then is Gymnasium needed."""
    if name == "HangEnv":
        from .env import HangEnv

        return HangEnv
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
