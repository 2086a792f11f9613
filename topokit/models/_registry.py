"""The predictors by the names that configurations and checkpoints give them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ._base import Normalisation, PredictiveModel, Shape
from ._baselines import Carry, Hold, Ridge
from ._loopcast import LoopCast
from ._paper import MLP, PointNet

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
    """Make a model with freshly drawn weights.

    "hold", "carry" and "ridge" are baselines without a network, "mlp" and "pointnet" the paper's, "loopcast" is ours.

    Parameters
    ----------
    name : str
        A key of `MODELS`.
    shape : Shape
    normalisation : Normalisation
    options : mapping, optional
        Of "ridge" `penalty`; of "mlp" `hidden`, `cloud_points`; of "pointnet" `hidden`, `per_point`; of "loopcast" `width`,
        `step_width`, `tracked`. The classes say what they mean.

    Raises
    ------
    ValueError
        When there is no such model, or it has no such option.
    """
    if name not in MODELS:
        raise ValueError(f"there is no model {name!r}; there are {', '.join(MODELS)}")
    options = dict(options or {})
    try:
        return MODELS[name](shape, normalisation, **options)
    except TypeError as error:
        raise ValueError(f"model {name!r} with options {options}: {error}") from error
