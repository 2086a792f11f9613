"""Predictive models: from the last clouds and the planned actions to the topological states of the next frames.

Needs `pip install topokit[learn]`; nothing here imports torch before it is used.
Source: Antonova et al. 2021, section 5. Taught in chapter 13.
"""

from typing import TYPE_CHECKING

from topokit._lazy import attach

if TYPE_CHECKING:
    from ._baselines import Normalisation, Shape
    from ._checkpoint import build
    from ._config import TrainConfig
    from ._motion import Motion
    from ._motion_predictor import MotionPredictor
    from ._predictor import Forecast, Predictor
    from ._scenes import Scenes
    from ._states import LossWeights, StateTensors, forecast_loss, loop_mixtures
    from ._training import train

__getattr__, __dir__, __all__ = attach(__name__, __file__, "learn")
