"""What is trained on: a configuration (JSON), the windows of two splits that it names, and more made of them.

Scenes are alike left and right of the plane x = 0: the mirror image of an episode could have happened.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import torch
from pydantic import Field
from torch import Tensor
from torch.utils.data import default_collate

from topokit._config import Count, NotNegative, Positive, checked, load

from ._baselines import Normalisation, Shape
from ._checkpoint import MODELS
from ._states import LossWeights, Window, target_states

_PLACES = {"clouds", "triangles", "past_triangles", "grippers", "actions"}
_PLACES |= {"cloud", "points", "flow", "target", "future"}  # of scenes
Natural = Annotated[int, Field(ge=0)]


@checked
class TrainConfig:
    """What `topokit train` does. An entry that is unknown or refused is a ValueError that names it."""

    model: str  #: a name of `topokit.models.MODELS`
    dataset: str = "."  #: directory of a dataset, relative to the configuration's file
    out: str = "run"  #: directory for checkpoints and logs, relative to the configuration's file
    start: str = ""  #: checkpoint that is gone on from, relative to the configuration's file: then few films do
    rehearse: str = ""  #: configuration whose windows are half of those trained on, as of what `start` knows
    options: dict[str, Any] = field(default_factory=dict)  #: keyword arguments of the model
    windows: dict[str, Any] = field(default_factory=dict)  #: of `topokit.data.WindowDataset`: labels, stride
    shape: Shape = field(default_factory=Shape)  #: sizes of a window
    loss: LossWeights = field(default_factory=LossWeights)  #: what is minimised
    split: dict[str, Any] = field(default_factory=dict)  #: of `Dataset.split`; its "train" and "validation" are read
    seed: Natural = 0  #: of weights and of the order of windows
    batch: Count = 64  #: windows a step
    epochs: Count = 20  #: at most
    windows_per_epoch: Count | None = None  #: so many, drawn anew for each epoch; all of them when not given
    validation_windows: Count = 2000  #: at most so many are looked at, the same ones every time
    learning_rate: Positive = 1e-3  #: of AdamW; rises over the first 2 % of steps, falls along a cosine to a hundredth
    weight_decay: NotNegative = 1e-4  #: of AdamW
    clip: Positive = 1.0  #: largest norm of a gradient
    patience: Count = 5  #: stop after so many epochs without a smaller validation loss
    minutes_between_checkpoints: Positive = 5.0  #: within an epoch; one more at its end
    threads: Count = 2  #: that share the sums; with another number weights differ in their last bits
    workers: Natural = 0  #: processes that read windows beside the one that trains
    accelerator: str = "cpu"  #: of Lightning Fabric: "cpu", "cuda", "auto"
    precision: str = "32-true"  #: of Lightning Fabric: "32-true", "bf16-mixed", "16-mixed"

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise ValueError(f"model must be one of {', '.join(MODELS)}, not {self.model!r}")


def load_config(path: str | Path) -> TrainConfig:
    """Read a configuration; paths in it are then relative to the working directory."""
    config, home = load(TrainConfig, path), Path(path).parent
    paths = {name: getattr(config, name) for name in ("dataset", "out", "start", "rehearse")}
    found: dict[str, Any] = {name: str(home / path) for name, path in paths.items() if path}
    return replace(config, **found)


@dataclass(frozen=True, eq=False)
class Windows:
    """What is trained on: two splits without a common episode, each a torch data set that has a length."""

    train: Any  #: windows, as of `topokit.data.WindowDataset`
    validation: Any  #: windows that are held back
    checksum: str = ""  #: of the dataset that they are from


def open_windows(config: TrainConfig) -> Windows:
    """The windows of a dataset that `topokit generate` made, split by episode or as `config.split` says.

    Raises
    ------
    ValueError
        When the model, the shape or the windows of what is rehearsed are not those of `config`.
    """
    if config.rehearse:
        earlier, kind = load_config(config.rehearse), ("model", "shape", "windows")
        if other := [name for name in kind if getattr(earlier, name) != getattr(config, name)]:
            raise ValueError(f"{config.rehearse}: cannot be rehearsed, its {other[0]} is not that of the configuration")
        new, old = open_windows(replace(config, rehearse="")), open_windows(earlier)
        few: Any = torch.utils.data.Subset(old.train, spread(len(old.train), len(new.train)))
        return Windows(torch.utils.data.ConcatDataset([new.train, few]), new.validation, new.checksum + old.checksum)
    from topokit.data import Dataset, WindowDataset  # which need what the extra `learn` has not

    from ._scenes import Scenes

    episodes, sizes = Dataset(config.dataset), asdict(config.shape)
    parts, size = episodes.split(**config.split), {"n_points": sizes.pop("points")}
    made, options = (Scenes, size) if config.model == "motion" else (WindowDataset, size | sizes)
    train, validation = (made(episodes, parts[part], **options, **config.windows) for part in ("train", "validation"))
    return Windows(train, validation, episodes.checksum())


def normalisation_of(data: Any) -> Normalisation:
    """Where the coordinates and filtration values of some windows lie."""
    window = default_collate([data[i] for i in spread(len(data), 200)])
    clouds, target = window["clouds"], target_states(window)
    origin = clouds.mean(dim=(0, 1, 2))
    deaths = target.death[target.presence > 0]
    value = float(deaths.mean()) if len(deaths) else Normalisation().value
    return Normalisation(tuple(origin.tolist()), float((clouds - origin).std()), value)


def epoch_order(n: int, count: int | None, seed: int, epoch: int) -> list[int]:
    """`count` of n windows, or all, in an order that seed and epoch decide."""
    generator = torch.Generator().manual_seed(seed * 1_000_003 + epoch)
    return torch.randperm(n, generator=generator)[:count].tolist()


def spread(n: int, most: int) -> list[int]:
    """At most so many of n numbers, evenly spaced."""
    return [i * n // min(n, most) for i in range(min(n, most))]


def mirrored(window: Window, which: Tensor) -> dict[str, Tensor]:
    """A batch of windows, those where `which` (B,) is true seen in the mirror x -> -x, where the grippers change names."""
    flipped = dict(window)
    for name in _PLACES & set(window):
        image = window[name][which] * window[name].new_tensor([-1.0, 1.0, 1.0])
        flipped[name] = window[name].clone()
        flipped[name][which] = image.flip(-2) if name in ("grippers", "actions") else image
    return flipped
