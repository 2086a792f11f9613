"""Simulated garments: made by code, carried by two grippers, hung on hooks, hangers and mannequins, in PyBullet.

Source: Antonova et al. 2021, section 6. Taught in chapters 0 and 10.
"""

from typing import TYPE_CHECKING

from topokit._lazy import attach

if TYPE_CHECKING:
    from ._camera import Camera
    from ._env import HangEnv
    from ._episode import simulate
    from ._garments import Garment
    from ._randomisation import Randomisation
    from ._targets import Hanger, Hook, Mannequin
    from ._tasks import TASKS, Task
    from ._wardrobe import WARDROBE
    from ._world import SimulationConfig, SimulationError, World

__getattr__, __dir__, __all__ = attach(__name__, __file__, "sim")
