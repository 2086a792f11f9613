"""The configuration of a training, and the windows of the two splits that it reads."""

from __future__ import annotations

from dataclasses import asdict, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field

from topokit._config import Count, Positive, checked, load

from ._baselines import Shape


class Windows(NamedTuple):
    """Two splits to train on and to validate on, without a common episode; each is a torch data set that has a length."""

    train: Any  #: windows to train on, see `topokit.data.WindowDataset`
    validation: Any  #: windows for validation
    checksum: str = ""  #: checksum of their dataset


@checked
class TrainConfig:
    """The configuration of `topokit train`; a ValueError names an entry that is unknown or refused."""

    #: Name of the model, see `topokit.models.build`.
    model: Literal["hold", "carry", "ridge", "mlp", "pointnet", "motion"]
    dataset: str = "."  #: directory of a dataset, relative to the configuration's file
    start: str = ""  #: checkpoint whose weights the training starts from, relative to the configuration's file
    options: dict[str, Any] = field(default_factory=dict)  #: keyword arguments of the model
    #: Keyword arguments of `topokit.data.WindowDataset`: labels, stride; of a motion model stride alone.
    windows: dict[str, Any] = field(default_factory=dict)
    shape: Shape = field(default_factory=Shape)  #: sizes of a window
    loss: dict[str, Any] = field(default_factory=dict)  #: keyword arguments of `topokit.models.forecast_loss`
    #: Keyword arguments of `topokit.data.Dataset.split`, whose "train" and "validation" are read.
    split: dict[str, Any] = field(default_factory=dict)
    seed: int = 0  #: seed of the weights and of the order of windows
    batch: Count = 64  #: number of windows in a step
    epochs: Count = 20  #: largest number of epochs
    #: Number of windows in an epoch, drawn anew for each; all windows when not given.
    windows_per_epoch: Count | None = None
    validation_windows: Count = 2000  #: largest number of windows for validation, the same in every epoch
    #: Learning rate of AdamW. It rises over the first 2 % of steps, and falls along a cosine to a hundredth.
    learning_rate: Positive = 1e-3
    patience: Count = 5  #: number of epochs without a smaller validation loss after which training stops
    #: Number of threads of PyTorch; with another number the weights differ in their last bits.
    threads: Annotated[int, Field(ge=1, le=1024)] = 2
    #: Number of processes that read windows, besides the training process.
    workers: Annotated[int, Field(ge=0, le=1024)] = 0

    @classmethod
    def load(cls, path: str | Path) -> TrainConfig:
        """Read a configuration (JSON). Its paths are made relative to the working directory."""
        config = load(cls, path)
        folder = Path(path).expanduser().parent
        start = str(folder / config.start) if config.start else ""
        return replace(config, dataset=str(folder / config.dataset), start=start)

    def open_windows(self) -> Windows:
        """Open the windows of the dataset, split by episode or by the options in `split`."""
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


def spread(n: int, most: int) -> list[int]:
    """Return at most `most` of the numbers below n, evenly spaced."""
    count = min(n, most)
    return [i * n // count for i in range(count)]
