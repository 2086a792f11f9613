"""What `topokit evaluate` does: one JSON file, checked before anything runs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from topokit._validate import positive
from topokit.models.base import Shape

__all__ = ["TRAINED", "UNTRAINED", "Clouds", "Condition", "EvaluationConfig", "load_evaluation"]

UNTRAINED = ("seqph", "hold", "carry")
"""Need no checkpoint; the first sees the future."""
TRAINED = ("ridge", "mlp", "pointnet")
"""The models of the paper's figure that need checkpoints, beside ours."""


@dataclass(frozen=True)
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

    noise: float = 0.0
    outliers: float = 0.0
    keep: float = 1.0

    def __post_init__(self) -> None:
        positive(self.noise, "clouds.noise")
        if not 0 <= positive(self.outliers, "clouds.outliers") < 1:
            raise ValueError(f"clouds.outliers must be a share below 1, not {self.outliers!r}")
        if not 0 < positive(self.keep, "clouds.keep", zero=False) <= 1:
            raise ValueError(f"clouds.keep must be a share above 0 and at most 1, not {self.keep!r}")


@dataclass(frozen=True)
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

    name: str
    dataset: str = ""
    labels: str = ""
    split: dict[str, Any] = field(default_factory=dict)
    part: str = "test"
    garments: list[str] | None = None
    windows: int = 100
    clouds: Clouds | None = None
    models: dict[str, list[str]] | None = None
    shares_no_episode: bool = False

    def __post_init__(self) -> None:
        if isinstance(self.clouds, Mapping):
            object.__setattr__(self, "clouds", _make(Clouds, self.clouds, f"condition {self.name!r}: clouds"))
        if not self.name or not isinstance(self.name, str):
            raise ValueError(f"a condition needs a name, not {self.name!r}")
        if isinstance(self.windows, bool) or not isinstance(self.windows, int) or self.windows < 1:
            raise ValueError(
                f"condition {self.name!r}: windows must be a whole number above zero, not {self.windows!r}"
            )
        if self.garments is not None and not self.garments:
            raise ValueError(f"condition {self.name!r}: garments is empty; leave it out for all of them")
        if self.models is not None:
            _check_models(self.models, f"condition {self.name!r}: models")


@dataclass(frozen=True)
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
    TypeError, ValueError
        When a field is unknown, of another type or out of its range; the message names it.
    """

    dataset: str
    models: dict[str, list[str]]
    conditions: list[Condition]
    ours: str = "loopcast"
    labels: str = "full"
    shape: Shape = field(default_factory=Shape)
    samples: int = 1000
    seed: int = 0
    tolerance: float = 0.02
    commands: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        if isinstance(self.shape, Mapping):
            object.__setattr__(self, "shape", _make(Shape, self.shape, "shape"))
        if not isinstance(self.conditions, list) or not self.conditions:
            raise ValueError("conditions must be a list of one condition or more")
        made = [one if isinstance(one, Condition) else _make(Condition, one, "a condition") for one in self.conditions]
        object.__setattr__(self, "conditions", made)
        names = [one.name for one in made]
        twice = {name for name in names if names.count(name) > 1}
        if twice:
            raise ValueError(f"two conditions are called {min(twice)!r}")
        _check_models(self.models, "models")
        if not isinstance(self.samples, int) or self.samples < 2:
            raise ValueError(f"samples must be a whole number above one, not {self.samples!r}")
        positive(self.tolerance, "tolerance")

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, lists and dicts, for JSON."""
        return asdict(self)


def load_evaluation(path: str | Path) -> tuple[EvaluationConfig, Path]:
    """Read a configuration and the folder that its paths are relative to.

    Raises
    ------
    FileNotFoundError
        When there is no such file.
    TypeError, ValueError
        When it is no JSON object, or `EvaluationConfig` refuses it.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: there is no such file")
    try:
        entries = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path}: not JSON: {error}") from error
    if not isinstance(entries, dict):
        raise ValueError(f"{path}: an evaluation is an object with named entries, not a {type(entries).__name__}")
    try:
        config: EvaluationConfig = _make(EvaluationConfig, entries, "the evaluation")
    except (TypeError, ValueError) as error:
        raise type(error)(f"{path}: {error}") from error
    return config, path.parent


def _check_models(models: object, where: str) -> None:
    if not isinstance(models, Mapping):
        raise TypeError(f"{where} must be an object, model to list of checkpoints, not {models!r}")
    for name, paths in models.items():
        if name in UNTRAINED:
            raise ValueError(f"{where}: {name} needs no checkpoint; leave it out")
        if not isinstance(paths, (list, tuple)) or not paths or not all(isinstance(path, str) for path in paths):
            raise TypeError(f"{where}: {name} must have a list of checkpoints, one a training seed, not {paths!r}")


def _make(kind: type[Any], entries: Any, where: str) -> Any:
    if not isinstance(entries, Mapping):
        raise TypeError(f"{where} must be an object with named entries, not {entries!r}")
    known = [part.name for part in fields(kind)]
    unknown = sorted(set(entries) - set(known))
    if unknown:
        raise ValueError(f"{where} has no entry {unknown[0]!r}; it may have {', '.join(known)}")
    missing = [name for name in ("dataset", "models", "conditions", "name") if name in kind.__dataclass_fields__]
    missing = [name for name in missing if name not in entries and not (kind is Condition and name != "name")]
    if missing:
        raise ValueError(f"{where} has no {missing[0]!r}")
    return kind(**entries)
