"""Checkpoints: tensors as safetensors, everything else as JSON in the same file's header. Loading runs no code.

One file, so that weights and description cannot come apart; replaced in one piece, so that a reader never sees half of it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import safetensors.torch
import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

import topokit
from topokit._archive import FormatError, atomic_file
from topokit._config import from_mapping

from ._base import Normalisation, PredictiveModel, Shape
from ._registry import build

SCHEMA = 1
_KIND = "topokit-checkpoint"


def describe(model: PredictiveModel, name: str, options: Mapping[str, Any], **more: Any) -> dict[str, Any]:
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


def save_tensors(path: str | Path, tensors: Mapping[str, Tensor], description: Mapping[str, Any]) -> Path:
    """Write tensors and their description (JSON) to one file, checksummed."""
    path = Path(path)
    if path.suffix != ".safetensors":
        raise ValueError(f"{path}: the name of a checkpoint ends in .safetensors")
    whole = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    document = {"kind": _KIND, "schema": SCHEMA, "sha256": _digest(whole), **description}
    content = safetensors.torch.save(whole, metadata={"topokit": json.dumps(document, sort_keys=True)})
    with atomic_file(path) as handle:
        handle.write(content)
    return path


def load_tensors(path: str | Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """Read what `save_tensors` wrote.

    Raises
    ------
    FileNotFoundError
        When there is no such file.
    FormatError
        When it is no safetensors file, a damaged one, one that topokit did not write, or of a newer schema; says which.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: {'a folder, not a file' if path.is_dir() else 'there is no such file'}")
    if path.stat().st_size == 0:
        raise FormatError(f"{path}: the file is empty (0 bytes)")
    try:
        with safe_open(str(path), framework="pt") as archive:
            metadata = archive.metadata() or {}
            tensors = {name: archive.get_tensor(name) for name in archive.keys()}  # noqa: SIM118  (it is no dict)
    except (SafetensorError, ValueError, RuntimeError) as error:
        raise FormatError(
            f"{path}: no checkpoint, or a truncated or damaged one ({error}); copy or train it again"
        ) from error
    try:
        document = json.loads(metadata["topokit"])
        kind, schema, digest = (document.pop(name) for name in ("kind", "schema", "sha256"))
    except (KeyError, ValueError, AttributeError) as error:
        raise FormatError(
            f"{path}: a safetensors file that topokit did not write: its header does not describe a model"
        ) from error
    if kind != _KIND or schema != SCHEMA:
        raise FormatError(f"{path}: a {kind} of schema {schema}; this topokit reads a {_KIND} of schema {SCHEMA}")
    if _digest(tensors) != digest:
        raise FormatError(
            f"{path}: the checksum does not match: the weights were changed or damaged; copy or train it again"
        )
    return document, tensors


def load_model(path: str | Path) -> tuple[PredictiveModel, dict[str, Any]]:
    """Build the model of a checkpoint, ready to predict, and return its description with it.

    Raises
    ------
    FileNotFoundError, FormatError
        As `load_tensors`, and when the description or the weights do not fit a model of this topokit; says which and where.
    """
    description, tensors = load_tensors(path)
    weights = {name.removeprefix("model."): t.float() for name, t in tensors.items() if name.startswith("model.")}
    try:
        shape = from_mapping(Shape, description["shape"], "shape")
        normalisation = from_mapping(Normalisation, description["normalisation"], "normalisation")
        model = build(description["model"], shape, normalisation, description["options"])
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(f"{path}: describes no model that this topokit can build: {error}") from error
    expected, found = (
        {name: tuple(part.shape) for name, part in parts.items()} for parts in (model.state_dict(), weights)
    )
    for name in sorted(expected.keys() | found.keys()):
        if expected.get(name) != found.get(name):
            raise FormatError(
                f"{path}: weights of another shape: {description['model']!r} as described has {name} "
                f"{expected.get(name, 'not at all')}, the file {found.get(name, 'not at all')}"
            )
    model.load_state_dict(weights)
    return model.eval(), description


def _digest(tensors: Mapping[str, Tensor]) -> str:
    """SHA-256 over names, types, shapes and values."""
    digest = hashlib.sha256()
    for name in sorted(tensors):
        tensor = tensors[name]
        digest.update(f"{name}|{tensor.dtype}|{tuple(tensor.shape)}|".encode())
        digest.update(tensor.reshape(-1).view(torch.uint8).numpy().data if tensor.numel() else b"")
    return digest.hexdigest()
