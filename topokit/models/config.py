"""The configuration of a training: one JSON or TOML file, checked before anything runs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from .augment import Spoiling
from .base import Shape
from .losses import LossWeights
from .registry import MODELS

__all__ = ["TrainConfig", "load_config"]


@dataclass(frozen=True)
class TrainConfig:
    """What `topokit train` does.

    Attributes
    ----------
    model : str
        A name of `topokit.models.MODELS`.
    dataset : str
        Directory of a dataset, relative to the configuration's file.
    out : str
        Directory for checkpoints and logs, relative to the configuration's file.
    options : dict
        Of the model: its keyword arguments.
    windows : dict
        Of `topokit.data.WindowDataset`: which labels, which stride.
    shape : Shape
    loss : LossWeights
    split : dict
        Of `Dataset.split`: by episode when empty. "train" and "validation" are read, "test" is not touched.
    seed : int
        Of weights and of the order of windows.
    batch, epochs : int
    windows_per_epoch : int, optional
        So many windows, drawn anew for each epoch; all of them when not given.
    validation_windows : int
        At most so many are looked at, the same ones every time.
    learning_rate, weight_decay : float
        Of AdamW; the rate rises over the first 2 % of steps and falls along a cosine to a hundredth.
    clip : float
        Largest norm of a gradient.
    mirror : bool
        Show half of the windows in the mirror (`topokit.models.augment`).
    spoil : Spoiling
        How much worse the history is seen than the labels' tracker saw it.
    patience : int
        Stop after so many epochs without a smaller validation loss.
    minutes_between_checkpoints : float
    workers : int
        Processes that read windows beside the one that trains.
    accelerator, precision : str
    devices : int
        Of Lightning Fabric: "cpu", "cuda", "auto"; "32-true", "bf16-mixed", "16-mixed"; how many.
    half : bool
        Store the best weights in 16 bits: half the size.

    Raises
    ------
    TypeError, ValueError
        When a field is unknown, of another type or out of its range; the message names it.
    """

    model: str
    dataset: str = ""
    out: str = "run"
    options: dict[str, Any] = field(default_factory=dict)
    windows: dict[str, Any] = field(default_factory=dict)
    shape: Shape = field(default_factory=Shape)
    loss: LossWeights = field(default_factory=LossWeights)
    split: dict[str, Any] = field(default_factory=dict)
    seed: int = 0
    batch: int = 64
    epochs: int = 20
    windows_per_epoch: int | None = None
    validation_windows: int = 2000
    learning_rate: float = 1e-3
    weight_decay: float = 1e-4
    clip: float = 1.0
    mirror: bool = True
    spoil: Spoiling = field(default_factory=Spoiling)
    patience: int = 5
    minutes_between_checkpoints: float = 5.0
    workers: int = 0
    accelerator: str = "cpu"
    devices: int = 1
    precision: str = "32-true"
    half: bool = True

    def __post_init__(self) -> None:
        for name, kind in (("shape", Shape), ("loss", LossWeights), ("spoil", Spoiling)):
            if isinstance(getattr(self, name), Mapping):
                object.__setattr__(self, name, _make(kind, getattr(self, name), name))
        if self.spoil.seen and not self.windows.get("seen_labels"):
            raise ValueError("spoil.seen needs windows.seen_labels: which labels hold what was seen")
        if self.model not in MODELS:
            raise ValueError(f"model must be one of {', '.join(MODELS)}, not {self.model!r}")
        for name in ("batch", "epochs", "validation_windows", "patience", "devices", "windows_per_epoch"):
            value = getattr(self, name)
            if not (isinstance(value, int) and value >= 1) and not (name == "windows_per_epoch" and value is None):
                raise ValueError(f"{name} must be a whole number above zero, not {value!r}")
        for name in ("learning_rate", "clip", "minutes_between_checkpoints"):
            if not (isinstance(getattr(self, name), (int, float)) and 0 < getattr(self, name) < float("inf")):
                raise ValueError(f"{name} must be a number above zero, not {getattr(self, name)!r}")
        for name in ("weight_decay", "workers", "seed"):
            if not (isinstance(getattr(self, name), (int, float)) and getattr(self, name) >= 0):
                raise ValueError(f"{name} must be a number of zero or more, not {getattr(self, name)!r}")

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, lists and dicts, for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, entries: Mapping[str, Any]) -> TrainConfig:
        """The opposite of `as_dict`."""
        config: TrainConfig = _make(cls, entries, "the configuration")
        return config


def load_config(path: str | Path) -> TrainConfig:
    """Read a configuration; paths in it are then relative to the working directory.

    Raises
    ------
    FileNotFoundError
        When there is no such file.
    TypeError, ValueError
        When it is neither JSON nor TOML, or `TrainConfig` refuses it.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: there is no such file")
    try:
        text = path.read_text(encoding="utf-8")
        entries = _parse_toml(text) if path.suffix == ".toml" else json.loads(text)
    except ValueError as error:
        raise ValueError(f"{path}: not {'TOML' if path.suffix == '.toml' else 'JSON'}: {error}") from error
    if not isinstance(entries, dict):
        raise ValueError(f"{path}: a configuration is an object with named entries, not a {type(entries).__name__}")
    for name in ("dataset", "out"):
        if isinstance(entries.get(name), str):
            entries[name] = str(path.parent / entries[name])
    try:
        return TrainConfig.from_dict(entries)
    except (TypeError, ValueError) as error:
        raise type(error)(f"{path}: {error}") from error


def _make(kind: type[Any], entries: Mapping[str, Any], where: str) -> Any:
    known = {part.name for part in fields(kind)}
    unknown = sorted(set(entries) - known)
    if unknown:
        raise ValueError(f"{where} has no entry {unknown[0]!r}; it may have {', '.join(sorted(known))}")
    return kind(**entries)


def _parse_toml(text: str) -> dict[str, Any]:
    try:
        import tomllib
    except ImportError as error:  # Python 3.10
        raise ValueError("TOML needs Python 3.11; write the configuration as JSON") from error
    return tomllib.loads(text)
