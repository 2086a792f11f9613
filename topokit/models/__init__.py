"""Predictive models: from the last clouds and the planned actions to the topological states of the next frames.

Needs `pip install topokit[learn]`; nothing here imports torch before it is used.
Source: Antonova et al. 2021, section 5. Taught in chapters 13 and 14.
"""

from typing import TYPE_CHECKING

from topokit._lazy import attach

if TYPE_CHECKING:
    from ._checkpoint import build
    from ._config import TrainConfig
    from ._predictor import Predictor
    from ._scenes import Scenes
    from ._states import StateTensors, forecast_loss, loop_mixtures
    from ._training import train

__getattr__, __dir__, __all__ = attach(__name__, __file__, "learn")
