"""The configuration of a training: one JSON or TOML file, checked before anything runs."""

from __future__ import annotations

from dataclasses import field, replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from topokit._config import Count, NotNegative, Positive, checked, load

from ._augment import Spoiling
from ._base import Shape
from ._losses import LossWeights
from ._registry import MODELS

Natural = Annotated[int, Field(ge=0)]


@checked
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
    spoil : Spoiling
        How much worse the history is seen than the labels' tracker saw it.
    patience : int
        Stop after so many epochs without a smaller validation loss.
    minutes_between_checkpoints : float
    workers : int
        Processes that read windows beside the one that trains.
    accelerator, precision : str
        Of Lightning Fabric: "cpu", "cuda", "auto"; "32-true", "bf16-mixed", "16-mixed".

    Raises
    ------
    ValueError
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
    seed: Natural = 0
    batch: Count = 64
    epochs: Count = 20
    windows_per_epoch: Count | None = None
    validation_windows: Count = 2000
    learning_rate: Positive = 1e-3
    weight_decay: NotNegative = 1e-4
    clip: Positive = 1.0
    spoil: Spoiling = field(default_factory=Spoiling)
    patience: Count = 5
    minutes_between_checkpoints: Positive = 5.0
    workers: Natural = 0
    accelerator: str = "cpu"
    precision: str = "32-true"

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise ValueError(f"model must be one of {', '.join(MODELS)}, not {self.model!r}")
        if self.spoil.seen and not self.windows.get("seen_labels"):
            raise ValueError("spoil.seen needs windows.seen_labels: which labels hold what was seen")


def load_config(path: str | Path) -> TrainConfig:
    """Read a configuration; paths in it are then relative to the working directory.

    Raises
    ------
    FileNotFoundError
        When there is no such file.
    ValueError
        When it is neither JSON nor TOML, or `TrainConfig` refuses it.
    """
    config, home = load(TrainConfig, path), Path(path).parent
    return replace(config, dataset=config.dataset and str(home / config.dataset), out=str(home / config.out))
