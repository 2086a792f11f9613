"""What `topokit evaluate` does: one JSON or TOML file, checked before anything runs."""

from __future__ import annotations

from dataclasses import field
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, Field

from topokit._config import Count, NotNegative, checked, load
from topokit.models import Shape

UNTRAINED = ("seqph", "hold", "carry")
"""Need no checkpoint; the first sees the future."""


def _need_checkpoints(models: dict[str, list[str]]) -> dict[str, list[str]]:
    for name in set(models) & set(UNTRAINED):
        raise ValueError(f"{name} needs no checkpoint; leave it out")
    return models


Paths = Annotated[list[str], Field(min_length=1)]
Checkpoints = Annotated[dict[str, Paths], AfterValidator(_need_checkpoints)]


@checked
class Clouds:
    """What is done to the clouds of a condition; the loops are then tracked anew on what is left."""

    noise: NotNegative = 0.0  #: standard deviation of each coordinate, metres
    #: Share of the points that are put anywhere in the cloud's box, which is grown by 10 cm on each side.
    outliers: Annotated[float, Field(ge=0, lt=1)] = 0.0
    #: Share of the points that are kept, at random in every frame.
    keep: Annotated[float, Field(gt=0, le=1)] = 1.0


@checked
class Condition:
    """One table: which episodes, what is seen of them, and other checkpoints if need be."""

    name: Annotated[str, Field(min_length=1)]  #: its key in the results
    dataset: str = ""  #: when not that of the evaluation
    labels: str = ""  #: when not those of the evaluation
    split: dict[str, Any] = field(default_factory=dict)  #: of `Dataset.split`: by episode when empty
    part: str = "test"  #: of the split; "all" for all episodes
    garments: Annotated[list[str], Field(min_length=1)] | None = None  #: all when not given
    windows: Count = 100  #: of each garment, at most, spread evenly over its episodes and their frames
    #: Spoil the clouds, and track the loops on what is left. Without it seqPH, hold and carry have the labels' states.
    clouds: Clouds | None = None
    models: Checkpoints | None = None  #: when not those of the evaluation
    #: The word of whoever wrote this that no checkpoint was trained on these episodes, where that cannot be checked: for a
    #: dataset made with another seed or another configuration.
    shares_no_episode: bool = False


@checked
class EvaluationConfig:
    """What is evaluated; paths are relative to the configuration's file."""

    dataset: str  #: directory of the dataset
    #: Checkpoints of each model, one a training seed. A model goes by the name that it is trained under; `seqph`, `hold` and
    #: `carry` need none and are always there.
    models: Checkpoints
    conditions: Annotated[list[Condition], Field(min_length=1)]  #: the first is the paper's figure
    ours: str = "loopcast"  #: which of the models is ours; in the results it is called "ours"
    labels: str = "full"  #: labels of the dataset
    shape: Shape = field(default_factory=Shape)  #: of the windows; all checkpoints must have it
    samples: Annotated[int, Field(ge=2)] = 1000  #: draws of the bootstrap
    seed: Annotated[int, Field(ge=0)] = 0  #: of everything random
    tolerance: NotNegative = 0.02  #: how far beside a hull still counts as in it, metres
    commands: list[str] = field(default_factory=list)  #: how datasets and checkpoints were made; stands in the results

    def __post_init__(self) -> None:
        names = [one.name for one in self.conditions]
        twice = {name for name in names if names.count(name) > 1}
        if twice:
            raise ValueError(f"two conditions are called {min(twice)!r}")


def load_evaluation(path: str | Path) -> tuple[EvaluationConfig, Path]:
    """Read a configuration and the folder that its paths are relative to."""
    return load(EvaluationConfig, path), Path(path).parent
