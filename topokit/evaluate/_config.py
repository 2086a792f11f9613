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
    """What is done to the clouds of a condition; the loops are then tracked anew on what is left.

    Attributes
    ----------
    noise : float
        Standard deviation of each coordinate, metres.
    outliers : float
        Share of the points that are put anywhere in the cloud's box, which is grown by 10 cm on each side.
    keep : float
        Share of the points that are kept, at random in every frame.
    """

    noise: NotNegative = 0.0
    outliers: Annotated[float, Field(ge=0, lt=1)] = 0.0
    keep: Annotated[float, Field(gt=0, le=1)] = 1.0


@checked
class Condition:
    """One table: which episodes, what is seen of them, and other checkpoints if need be.

    Attributes
    ----------
    name : str
    dataset, labels : str, optional
        When not those of the evaluation.
    split : dict
        Of `Dataset.split`: by episode when empty.
    part : str
        Of the split; "all" for all episodes.
    garments : list of str, optional
        All when not given.
    windows : int
        Of each garment, at most, spread evenly over its episodes and their frames.
    clouds : Clouds, optional
        Spoil the clouds, and track the loops on what is left. Without it seqPH, hold and carry have the labels' states.
    models : dict of str to list of str, optional
        When not those of the evaluation.
    shares_no_episode : bool
        The word of whoever wrote this that no checkpoint was trained on these episodes, where that cannot be checked: for a
        dataset made with another seed or another configuration.
    """

    name: Annotated[str, Field(min_length=1)]
    dataset: str = ""
    labels: str = ""
    split: dict[str, Any] = field(default_factory=dict)
    part: str = "test"
    garments: Annotated[list[str], Field(min_length=1)] | None = None
    windows: Count = 100
    clouds: Clouds | None = None
    models: Checkpoints | None = None
    shares_no_episode: bool = False


@checked
class EvaluationConfig:
    """What is evaluated.

    Attributes
    ----------
    dataset : str
        Directory of the dataset, relative to the configuration's file.
    models : dict of str to list of str
        Checkpoints of each model, one a training seed, relative to the configuration's file. A model goes by the name that it
        is trained under. `seqph`, `hold` and `carry` are always there.
    conditions : list of Condition
        The first is the paper's figure.
    ours : str
        Which of the models is ours; in the results it is called "ours".
    labels : str
    shape : Shape
        Of the windows; all checkpoints must have it.
    samples : int
        Draws of the bootstrap.
    seed : int
        Of everything random.
    tolerance : float
        How far beside a hull still counts as in it, metres.
    commands : list of str
        How datasets and checkpoints were made; goes into the results as it is.

    Raises
    ------
    ValueError
        When a field is unknown, of another type or out of its range; the message names it.
    """

    dataset: str
    models: Checkpoints
    conditions: Annotated[list[Condition], Field(min_length=1)]
    ours: str = "loopcast"
    labels: str = "full"
    shape: Shape = field(default_factory=Shape)
    samples: Annotated[int, Field(ge=2)] = 1000
    seed: Annotated[int, Field(ge=0)] = 0
    tolerance: NotNegative = 0.02
    commands: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        names = [one.name for one in self.conditions]
        twice = {name for name in names if names.count(name) > 1}
        if twice:
            raise ValueError(f"two conditions are called {min(twice)!r}")


def load_evaluation(path: str | Path) -> tuple[EvaluationConfig, Path]:
    """Read a configuration and the folder that its paths are relative to.

    Raises
    ------
    FileNotFoundError
        When there is no such file.
    ValueError
        When it is neither JSON nor TOML, or `EvaluationConfig` refuses it.
    """
    return load(EvaluationConfig, path), Path(path).parent
