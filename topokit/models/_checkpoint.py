"""Models by their names, and their checkpoints: a safetensors file whose metadata describes the model as JSON.

Weights and description are one file, which is replaced in one piece. Loading runs no code.
"""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import safetensors.torch
import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

import topokit
from topokit._archive import FormatError, atomic_file, existing
from topokit._config import from_mapping

from ._baselines import Carry, Hold, Model, Normalisation, Ridge, Shape
from ._motion import Motion
from ._networks import MLP, PointNet

MODELS: Mapping[str, type[Model]] = {
    kind.__name__.lower(): kind for kind in (Hold, Carry, Ridge, MLP, PointNet, Motion)
}


def build(
    name: str,
    shape: Shape | None = None,
    normalisation: Normalisation | None = None,
    options: Mapping[str, Any] | None = None,
) -> Model:
    """Make a model with freshly drawn weights.

    "hold", "carry" and "ridge" are baselines without a network, "mlp" and "pointnet" are the paper's networks, and
    "motion" is ours. A ValueError says that there is no such model.

    Parameters
    ----------
    name : {"hold", "carry", "ridge", "mlp", "pointnet", "motion"}
    shape : Shape, optional
    normalisation : Normalisation, optional
        Means and scales of the training's windows, such as those of another model, `model.normalisation`.
    options : mapping, optional
        For "ridge" the `penalty` on squared coefficients; for "mlp" and "pointnet" `skip`, and the
        `hidden` units of each layer, such as (512, 256); for "mlp" also how many `points` of a cloud it reads, for "pointnet" the
        `units` of each layer that all points share; for "motion" the `width` of codes.
    """
    if name not in MODELS:
        raise ValueError(f"there is no model {name!r}; there are {', '.join(MODELS)}")
    options = dict(options or {})
    model = MODELS[name](shape or Shape(), normalisation or Normalisation(), **options)
    model.options = options
    return model


def describe(model: Model) -> dict[str, Any]:
    """Return what `build` needs to make the model again, and the versions that it was made with."""
    return {
        "model": type(model).__name__.lower(),
        "options": model.options,
        "shape": asdict(model.shape),
        "normalisation": asdict(model.normalisation),
        "topokit": topokit.__version__,
        "torch": torch.__version__,
    }


def save_tensors(path: str | Path, tensors: Mapping[str, Tensor], description: Mapping[str, Any]) -> None:
    """Write tensors and their description to one file."""
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    # One entry alone: safetensors writes several in an order that changes from run to run.
    content = safetensors.torch.save(tensors, {"topokit": json.dumps(description, sort_keys=True)})
    with atomic_file(Path(path)) as handle:
        handle.write(content)


def load_tensors(path: str | Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """Return the description of a checkpoint, and its tensors; FormatError for a damaged file, or one that is none."""
    path = existing(path)
    try:
        with safe_open(str(path), framework="pt") as archive:
            tensors = {name: archive.get_tensor(name) for name in archive.keys()}  # noqa: SIM118  (it is no dict)
            description = json.loads((archive.metadata() or {})["topokit"])
    except (SafetensorError, KeyError, ValueError) as error:
        raise FormatError(f"{path}: no checkpoint of topokit, or a damaged one: {error}") from error
    return description, tensors


def load_model(path: str | Path) -> tuple[Model, dict[str, Any]]:
    """Return the model of a checkpoint, ready to predict, and its description; FormatError names what does not fit."""
    description, tensors = load_tensors(path)
    try:
        shape = from_mapping(Shape, description["shape"], "shape")
        normalisation = from_mapping(Normalisation, description["normalisation"], "normalisation")
        # A model on the "meta" device draws no weights; those of the file are put in their places.
        with torch.device("meta"):
            model = build(description["model"], shape, normalisation, description["options"])
        model.load_state_dict({name: tensor.float() for name, tensor in tensors.items()}, assign=True)
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        reason = textwrap.shorten(str(error), 300)  # PyTorch lists every weight
        raise FormatError(f"{path}: describes no model that this topokit can build: {reason}") from error
    return model.eval(), description
