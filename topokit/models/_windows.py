"""What is trained on: windows of two splits, their order, and where their numbers lie."""

from __future__ import annotations

from collections.abc import Sized
from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import Dataset, default_collate

from ._base import Normalisation
from ._config import TrainConfig
from ._states import target_states


@dataclass(frozen=True, eq=False)
class Windows:
    """What is trained on: two splits without a common episode, and the checksum of the dataset that they are from.

    Attributes
    ----------
    train, validation : torch.utils.data.Dataset
        Of windows, as `topokit.data.WindowDataset`.
    checksum : str
    """

    train: Dataset[dict[str, Tensor]]
    validation: Dataset[dict[str, Tensor]]
    checksum: str = ""


def open_windows(config: TrainConfig) -> Windows:
    """The windows of a dataset that `topokit generate` made, split by episode or as `config.split` says.

    Raises
    ------
    ValueError
        When the configuration names no dataset.
    FileNotFoundError, FormatError
        When the dataset or its labels are missing or damaged.
    """
    from topokit.data import Dataset as Episodes
    from topokit.data import WindowDataset

    if not config.dataset:
        raise ValueError("the configuration names no dataset")
    episodes, sizes = Episodes(config.dataset), asdict(config.shape)
    parts, points = episodes.split(**config.split), sizes.pop("points")
    train, validation = (
        WindowDataset(episodes, parts[name], n_points=points, **sizes, **config.windows)
        for name in ("train", "validation")
    )
    return Windows(train, validation, episodes.checksum())


def normalisation_of(data: Dataset[dict[str, Tensor]], most: int = 200) -> Normalisation:
    """Where the coordinates and filtration values of some windows lie."""
    window = default_collate([data[i] for i in spread(length(data), most)])
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


def length(data: Dataset[Any]) -> int:
    """How many windows a split has."""
    assert isinstance(data, Sized)
    return len(data)
