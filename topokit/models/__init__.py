"""Predictive models: from the last clouds and the planned actions to the topological states of the next frames.

Needs `pip install topokit[learn]`; nothing here imports torch before it is used.
Source: Antonova et al. 2021, section 5. Taught in chapter 11.
"""

from typing import TYPE_CHECKING

from topokit._lazy import attach

if TYPE_CHECKING:
    from ._baselines import Normalisation, PredictiveModel, Shape
    from ._checkpoint import MODELS, build, load_model, load_tensors
    from ._config import TrainConfig, Windows, load_config, open_windows
    from ._motion import Motion
    from ._motion_predictor import MotionPredictor
    from ._predictor import Forecast, PredictedLoop, Predictor
    from ._scenes import Scenes
    from ._states import LossWeights, States, forecast_loss, loop_mixtures, match_slots, past_states, target_states
    from ._training import train

__getattr__, __all__ = attach(__name__, __file__, "learn")
