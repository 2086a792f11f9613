"""Predictive models: from the last clouds and the planned actions to the topological states of the next frames.

    from topokit.models import Predictor

Needs `pip install topokit[learn]`; nothing here imports torch before it is used.

Source: Antonova et al. 2021, section 5. Taught in chapter 10.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .config import TrainConfig, load_config
    from .forecast import Forecast, PredictedLoop
    from .predictor import Predictor
    from .training import train

_WHERE = {
    "Forecast": "forecast",
    "PredictedLoop": "forecast",
    "Predictor": "predictor",
    "TrainConfig": "config",
    "load_config": "config",
    "train": "training",
}

__all__ = ["Forecast", "PredictedLoop", "Predictor", "TrainConfig", "load_config", "train"]


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        return getattr(import_module(f".{_WHERE[name]}", __name__), name)
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] in ("torch", "safetensors", "lightning_fabric", "lightning", "tqdm"):
            raise ImportError(f"topokit.models needs {error.name}: pip install 'topokit[learn]'") from error
        raise
