"""What a training is configured with, and the windows of two splits that it reads."""

from __future__ import annotations

from dataclasses import asdict, field, replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import torch
from pydantic import Field
from torch.utils.data import ConcatDataset, Subset

from topokit._config import Count, NotNegative, Positive, checked, load

from ._baselines import Shape
from ._checkpoint import MODELS
from ._states import LossWeights

Natural = Annotated[int, Field(ge=0)]


class Windows(NamedTuple):
    """What is trained on: two splits without a common episode, each a torch data set that has a length."""

    train: Any  #: windows, as of `topokit.data.WindowDataset`
    validation: Any  #: windows that are held back
    checksum: str = ""  #: of the dataset that they are from


@checked
class TrainConfig:
    """What `topokit train` does. An entry that is unknown or refused is a ValueError that names it."""

    model: str  #: a name that `topokit.models.build` knows
    dataset: str = "."  #: directory of a dataset, relative to the configuration's file
    out: str = "run"  #: directory for checkpoints and logs, relative to the configuration's file
    start: str = ""  #: checkpoint whose weights the training starts from, relative to the configuration's file
    rehearse: str = ""  #: configuration whose windows are half of those trained on, so that `start` is not forgotten
    options: dict[str, Any] = field(default_factory=dict)  #: keyword arguments of the model
    windows: dict[str, Any] = field(default_factory=dict)  #: of `topokit.data.WindowDataset`: labels, stride
    shape: Shape = field(default_factory=Shape)  #: sizes of a window
    loss: LossWeights = field(default_factory=LossWeights)  #: what is minimised
    split: dict[str, Any] = field(default_factory=dict)  #: of `Dataset.split`; its "train" and "validation" are read
    seed: Natural = 0  #: of weights and of the order of windows
    batch: Count = 64  #: windows a step
    epochs: Count = 20  #: at most
    windows_per_epoch: Count | None = None  #: drawn anew for each epoch; all windows when not given
    validation_windows: Count = 2000  #: at most; the same ones in every epoch
    learning_rate: Positive = 1e-3  #: of AdamW; rises over the first 2 % of steps, falls along a cosine to a hundredth
    weight_decay: NotNegative = 1e-4  #: of AdamW
    clip: Positive = 1.0  #: largest norm of a gradient
    patience: Count = 5  #: stop after so many epochs without a smaller validation loss
    threads: Count = 2  #: of PyTorch; with another number weights differ in their last bits
    workers: Natural = 0  #: processes that read windows beside the one that trains
    accelerator: str = "cpu"  #: of Lightning Fabric: "cpu", "cuda", "auto"
    precision: str = "32-true"  #: of Lightning Fabric: "32-true", "bf16-mixed", "16-mixed"

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise ValueError(f"model must be one of {', '.join(MODELS)}, not {self.model!r}")

    @classmethod
    def load(cls, path: str | Path) -> TrainConfig:
        """Read a configuration (JSON). Its paths are made relative to the working directory."""
        config = load(cls, path)
        folder = Path(path).parent
        changes: dict[str, Any] = {}
        for name in ("dataset", "out", "start", "rehearse"):
            if getattr(config, name):
                changes[name] = str(folder / getattr(config, name))
        return replace(config, **changes)

    def open_windows(self) -> Windows:
        """Open the windows of the dataset, split by episode or as `split` says.

        Raises
        ------
        ValueError
            When the model, the shape or the windows of what is rehearsed are not those of this configuration.
        """
        if self.rehearse:
            return self._open_with_rehearsal()

        # Datasets need packages that the extra `learn` does not have.
        from topokit.data import Dataset, WindowDataset

        from ._scenes import Scenes

        dataset = Dataset(self.dataset)
        parts = dataset.split(**self.split)
        sizes: dict[str, Any] = asdict(self.shape)
        options = {"n_points": sizes.pop("points"), **self.windows}
        kind: Any = Scenes
        if self.model != "motion":
            kind = WindowDataset
            options = {**sizes, **options}
        train = kind(dataset, parts["train"], **options)
        validation = kind(dataset, parts["validation"], **options)
        return Windows(train, validation, dataset.checksum())

    def _open_with_rehearsal(self) -> Windows:
        """Open as many windows of the configuration that is rehearsed as there are new ones to train on."""
        earlier = TrainConfig.load(self.rehearse)
        for name in ("model", "shape", "windows"):
            if getattr(earlier, name) != getattr(self, name):
                raise ValueError(f"{self.rehearse}: cannot be rehearsed, its {name} is not that of the configuration")
        new = replace(self, rehearse="").open_windows()
        old = earlier.open_windows()
        repeated: Any = Subset(old.train, spread(len(old.train), len(new.train)))
        return Windows(ConcatDataset([new.train, repeated]), new.validation, new.checksum + old.checksum)


def epoch_order(n: int, count: int | None, seed: int, epoch: int) -> list[int]:
    """Return `count` of n windows, or all, in an order that depends on seed and epoch alone."""
    generator = torch.Generator().manual_seed(seed * 1_000_003 + epoch)
    return torch.randperm(n, generator=generator)[:count].tolist()


def spread(n: int, most: int) -> list[int]:
    """Return at most so many of n numbers, evenly spaced."""
    count = min(n, most)
    return [i * n // count for i in range(count)]
