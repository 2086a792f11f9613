"""The predictors by the names that configurations and checkpoints give them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .base import Normalisation, PredictiveModel, Shape
from .baselines import Carry, Hold, Ridge
from .loopcast import LoopCast
from .mlp import MLP
from .pointnet import PointNet

__all__ = ["MODELS", "build"]

MODELS: Mapping[str, type[PredictiveModel]] = {
    "hold": Hold,
    "carry": Carry,
    "ridge": Ridge,
    "mlp": MLP,
    "pointnet": PointNet,
    "loopcast": LoopCast,
}


def build(
    name: str, shape: Shape, normalisation: Normalisation, options: Mapping[str, Any] | None = None
) -> PredictiveModel:
    """Make the model of that name with freshly drawn weights.

    Raises
    ------
    ValueError
        When there is no such model, or it has no such option.
    """
    if name not in MODELS:
        raise ValueError(f"there is no model {name!r}; there are {', '.join(MODELS)}")
    try:
        return MODELS[name](shape, normalisation, **dict(options or {}))
    except TypeError as error:
        raise ValueError(f"model {name!r} with options {dict(options or {})}: {error}") from error
