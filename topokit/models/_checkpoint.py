"""Models by their names, and checkpoints: tensors as safetensors, all else as JSON in the same file's header.

One file, so that weights and description cannot come apart; replaced in one piece, so that a reader never sees half of it.
Loading runs no code.
"""

from __future__ import annotations

import hashlib
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

from ._baselines import Carry, Hold, Normalisation, PredictiveModel, Ridge, Shape
from ._motion import Motion
from ._networks import MLP, PointNet

SCHEMA = 2
_KIND = "topokit-checkpoint"

Model = PredictiveModel | Motion
_KINDS: tuple[type[Model], ...] = (Hold, Carry, Ridge, MLP, PointNet, Motion)
MODELS: Mapping[str, type[Model]] = {kind.__name__.lower(): kind for kind in _KINDS}


def build(name: str, shape: Shape, normalisation: Normalisation, options: Mapping[str, Any] | None = None) -> Model:
    """Make a model with freshly drawn weights.

    "hold", "carry" and "ridge" are baselines without a network, "mlp" and "pointnet" the paper's, "motion" is ours.

    Parameters
    ----------
    name : str
        A key of `MODELS`.
    shape : Shape
    normalisation : Normalisation
    options : mapping, optional
        Of "ridge" `penalty`, on squared coefficients; of "mlp" and "pointnet" `hidden` units, of "mlp" the `points`
        of a cloud that it reads; of "motion" `width` of codes.

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
    except (TypeError, OverflowError) as error:
        raise ValueError(f"model {name!r} with options {options}: {error}") from error


def describe(model: Model, name: str, options: Mapping[str, Any], **more: Any) -> dict[str, Any]:
    """Return what must be known to build the model again, and whatever `more` there is to say about it."""
    return {
        "model": name,
        "options": dict(options),
        "shape": asdict(model.shape),
        "normalisation": asdict(model.normalisation),
        "topokit": topokit.__version__,
        "torch": torch.__version__,
        **more,
    }


def save_tensors(path: Path, tensors: Mapping[str, Tensor], description: Mapping[str, Any]) -> Path:
    """Write tensors and their description (JSON) to one file, checksummed."""
    if path.suffix != ".safetensors":
        raise ValueError(f"{path}: the name of a checkpoint ends in .safetensors")
    whole = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    document = {"kind": _KIND, "schema": SCHEMA, **description}
    document["sha256"] = _digest(whole, document)
    content = safetensors.torch.save(whole, metadata={"topokit": json.dumps(document, sort_keys=True)})
    with atomic_file(path) as handle:
        handle.write(content)
    return path


def load_tensors(path: str | Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """Read the description of a checkpoint, and its tensors.

    Raises
    ------
    FormatError
        When it is damaged, was not written by topokit, or is of another schema; says which.
    """
    path = existing(path)
    try:
        with safe_open(str(path), framework="pt") as archive:
            metadata = archive.metadata() or {}
            tensors = {name: archive.get_tensor(name) for name in archive.keys()}  # noqa: SIM118  (it is no dict)
    except (SafetensorError, ValueError, RuntimeError) as error:
        raise FormatError(f"{path}: no checkpoint, or a truncated or damaged one ({error}); copy it again") from error
    try:
        document = json.loads(metadata["topokit"])
        digest, whole = document.pop("sha256"), _digest(tensors, document)
        kind = document.pop("kind"), document.pop("schema")
    except (KeyError, ValueError, AttributeError, TypeError, RecursionError) as error:
        raise FormatError(f"{path}: topokit did not write this safetensors file: its header names no model") from error
    if kind != (_KIND, SCHEMA):
        raise FormatError(f"{path}: a {kind[0]} of schema {kind[1]}; this topokit reads a {_KIND} of schema {SCHEMA}")
    if whole != digest:
        raise FormatError(f"{path}: the checksum does not match: changed or damaged; copy it again")
    return document, tensors


def load_model(path: str | Path) -> tuple[Model, dict[str, Any]]:
    """Build the model of a checkpoint, ready to predict, and return its description with it.

    Raises
    ------
    FormatError
        When the description or the weights do not fit a model of this topokit; says which and where.
    """
    description, tensors = load_tensors(path)
    weights = {name: part.float() for name, part in part_of(tensors, "model.").items()}
    try:
        shape = from_mapping(Shape, description["shape"], "shape")
        normalisation = from_mapping(Normalisation, description["normalisation"], "normalisation")
        with torch.device("meta"):  # no memory is taken for what the description claims
            model = build(description["model"], shape, normalisation, description["options"])
        model.load_state_dict(weights, assign=True)
        if isinstance(model, PredictiveModel):
            model.origin = torch.tensor(normalisation.origin)
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(f"{path}: describes no model that this topokit can build: {error}") from error
    except RuntimeError as error:  # of torch: it lists every weight
        raise FormatError(f"{path}: weights of another shape: {textwrap.shorten(str(error), 300)}") from error
    for name, part in weights.items():
        if not part.isfinite().all():
            raise FormatError(f"{path}: the weights {name} hold a NaN or an infinite number; train it again")
    return model.eval(), description


def part_of(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """Those whose names begin so, under the rest of their names."""
    return {name.removeprefix(prefix): part for name, part in tensors.items() if name.startswith(prefix)}


def _digest(tensors: Mapping[str, Tensor], document: dict[str, Any]) -> str:
    """SHA-256 over names, types, shapes and values, and over the document."""
    digest = hashlib.sha256()
    for name in sorted(tensors):
        tensor = tensors[name]
        digest.update(f"{name}|{tensor.dtype}|{tuple(tensor.shape)}|".encode())
        digest.update(tensor.reshape(-1).view(torch.uint8).numpy().data if tensor.numel() else b"")
    digest.update(json.dumps(document, sort_keys=True).encode())
    return digest.hexdigest()
