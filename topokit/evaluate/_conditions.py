"""What `topokit evaluate` does, one JSON file, and each of its conditions made ready.

That is: which windows, what is seen of them, where their true loops are, and who forecasts; checked before anything runs.
"""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from topokit._config import Count, NotNegative, checked, load
from topokit.data import Dataset, WindowDataset
from topokit.models import MotionPredictor, Predictor, Shape, StateTensors, build
from topokit.sampling import spoil

from ._accuracy import TrueCurves
from ._forecasters import Forecaster, of_stream, of_windows, turned
from ._results import digest, library_digest
from ._tracking import true_loops

_BASELINES = ("hold", "carry")
_MODELS = (*_BASELINES, "ridge", "mlp", "pointnet", "motion")
UNTRAINED = ("seqph", *_BASELINES)  # need no checkpoint; the first sees the future


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
    plans: Literal["all", "script", "off script"] = "all"  #: which episodes, by what their grippers were told
    turned: float = 0.0  #: degrees by which scene and plan are turned about the vertical before forecasters see them
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
    ours: str = "motion"  #: which of the models is ours; in the results it is called "ours"
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


@dataclass(frozen=True, eq=False)
class PreparedCondition:
    """A condition whose files were found good."""

    clean: WindowDataset  #: the windows; their labels are the truth about presence
    observed: WindowDataset  #: the same as the forecasters see them; `clean` itself when nothing is spoilt
    forecasters: Mapping[str, Sequence[Forecaster]]  #: by what the results call them, one a training seed
    entries: Mapping[str, Any]  #: what the results say about the condition


def kinds_of(windows: WindowDataset, name: Literal["garment", "target"]) -> NDArray[np.str_]:
    """(n,) the garment or the target of each window."""
    return np.array([getattr(windows.dataset.record(number), name) for number in windows.index[:, 0].tolist()])


def prepare_condition(config: EvaluationConfig, condition: Condition, folder: Path) -> PreparedCondition:
    """Open dataset and checkpoints of a condition, check that they fit each other, choose the windows."""
    dataset = Dataset(folder / (condition.dataset or config.dataset))
    shape, labels = config.shape, condition.labels or config.labels
    options: dict[str, Any] = {"history": shape.history, "horizon": shape.horizon, "labels": labels}
    options |= {"n_points": shape.points, "slots": shape.slots}
    windows = WindowDataset(dataset, _tested(condition, dataset, labels), **options)
    rows = spread_windows(windows, condition.windows)
    clean = observed = windows.select(rows)
    if condition.clouds is not None:
        observe = spoilt_observer(condition.clouds, config.seed)
        observed = WindowDataset(dataset, windows.episodes, observe=observe, **options).select(rows)
    shown = {config.ours: "ours"}
    untrained: dict[str, Forecaster] = {"seqph": StateTensors.from_labels}
    untrained |= {name: of_windows(build(name, config.shape).eval()) for name in _BASELINES}
    turn = partial(turned, degrees=condition.turned)
    forecasters = {shown.get(name, name): [turn(one)] for name, one in untrained.items()}
    checkpoints = {}
    for name, paths in (config.models if condition.models is None else condition.models).items():
        found = [_load(config, name, folder / path, path) for path in paths]
        about = checkpoints[shown.get(name, name)] = [told for _, told in found]
        if len({one["sha256"] for one in about}) < len(about):
            raise ValueError(f"condition {condition.name!r}: {name} lists the same weights twice")
        for one in about:
            _check_unseen(one, clean, condition)
        made = [of_stream(p, observed) if isinstance(p, MotionPredictor) else of_windows(p.model) for p, _ in found]
        forecasters[shown.get(name, name)] = [turn(one) for one in made]
    return PreparedCondition(clean, observed, forecasters, _entries(config, condition, clean, checkpoints))


def _entries(
    config: EvaluationConfig, condition: Condition, windows: WindowDataset, checkpoints: Mapping[str, Any]
) -> dict[str, Any]:
    """What the results say about a condition, and from what it is made: when that is the same, so are the results."""
    dataset, labels = windows.dataset, windows.dataset.labels(windows.labels)
    counts = zip(*np.unique(kinds_of(windows, "garment"), return_counts=True), strict=True)
    entries = {
        "dataset": {"sha256": dataset.checksum(), "seed": dataset.seed, "episodes": len(dataset)},
        "labels": {"name": windows.labels, "observation": labels.settings.observation, "sha256": labels.checksum()},
        "condition": {key: value for key, value in asdict(condition).items() if key not in ("models", "dataset")},
        "states_of_seqph_hold_carry_ridge": "tracked on the spoilt clouds" if condition.clouds else "the labels",
        "windows": len(windows),
        "episodes": len(windows.episodes),
        "windows_by_garment": {str(garment): int(count) for garment, count in counts},
        "checkpoints": checkpoints,
    }
    settings = {name: asdict(config)[name] for name in ("ours", "shape", "samples", "seed", "tolerance")}
    return {"made_from": digest([entries, settings, library_digest()]), **entries}


def _tested(condition: Condition, dataset: Dataset, labels: str) -> NDArray[np.int64]:
    """The labelled episodes of a condition: of its part of the split, and its garments."""
    where, labelled = f"condition {condition.name!r}", dataset.labelled(labels)
    try:
        parts = dataset.split(**condition.split) | {"all": dataset.episodes}
    except (TypeError, ValueError) as error:
        raise ValueError(f"{where}: split {condition.split}: {error}") from error
    if condition.part not in parts:
        raise ValueError(f"{where}: the split has no part {condition.part!r}; it has {', '.join(parts)}")
    garments = condition.garments or dataset.garments
    unknown = sorted(set(garments) - set(dataset.garments))
    if unknown:
        raise ValueError(f"{where}: no garment {unknown[0]!r} in the dataset; it has {', '.join(dataset.garments)}")
    chosen = [number for number in parts[condition.part].tolist() if dataset.record(number).garment in garments]
    if condition.plans != "all":
        off = condition.plans == "off script"
        chosen = [number for number in chosen if ("path" in dataset.record(number).physics) == off]
    known = np.intersect1d(chosen, labelled)
    if not len(known):
        raise ValueError(f"{where}: no episode of {condition.part!r} is of these garments and has labels {labels!r}")
    if len(known) < len(chosen):
        missing = f"{len(chosen) - len(known)} of {len(chosen)} episodes have no labels {labels!r}"
        warnings.warn(f"{where}: {missing} and are left out", stacklevel=2)
    return known


def spread_windows(windows: WindowDataset, most: int) -> NDArray[np.int64]:
    """At most so many windows of each garment, spread evenly over its episodes and their frames; rows of `index`."""
    garments, chosen = kinds_of(windows, "garment"), []
    for name in np.unique(garments):
        rows = np.flatnonzero(garments == name)
        chosen.append(rows[np.unique(np.linspace(0, len(rows) - 1, min(most, len(rows))).round().astype(int))])
    return np.sort(np.concatenate(chosen))


def spoilt_observer(how: Clouds, seed: int) -> Callable[[int, NDArray[np.float64]], NDArray[np.float64]]:
    """What `WindowDataset` observes: spoilt clouds, so that baselines that start from tracked states see what networks see."""

    def observe(number: int, clouds: NDArray[np.float64]) -> NDArray[np.float64]:
        rng = np.random.default_rng((seed, number))
        kept = max(1, round(how.keep * clouds.shape[1]))  # the others repeat these
        return spoil(clouds, rng, **asdict(how))[:, :kept]

    return observe


def true_curves(windows: WindowDataset, rows: Sequence[int], steps: Sequence[int]) -> list[TrueCurves]:
    """The true loops of windows at some steps: which are there, and where."""
    found = []
    for number, frame in windows.index[np.asarray(rows)].tolist():
        whole, at = _true_curves(windows.dataset.folder, number), frame + np.array(steps)
        curves, closing, present = (tuple(p[at] for p in part) for part in (whole.curves, whole.closing, whole.present))
        tight = tuple([loop[step] for step in at] for loop in whole.tight)
        found.append(TrueCurves(curves, closing, present, tight))
    return found


@cache  # conditions share their episodes; a few hundred, half a second and a megabyte each
def _true_curves(folder: Path, number: int) -> TrueCurves:
    episode = Dataset(folder)[number]
    points, loops = episode.points.astype(np.float64), episode.loops
    frames, row = true_loops(points, loops), np.arange(len(points))[:, None]
    killers = np.array([frame.killers for frame in frames])  # (T, loops, 2)
    return TrueCurves(
        tuple(points[:, loop] for loop in loops),
        tuple(points[row, killers[:, loop]] for loop in range(len(loops))),
        tuple(np.array([frame.present for frame in frames]).T),
        tuple([cloud[frame.tight[i]] for cloud, frame in zip(points, frames, strict=True)] for i in range(len(loops))),
    )


def _load(config: EvaluationConfig, name: str, path: Path, shown: str) -> tuple[Predictor, dict[str, Any]]:
    predictor = Predictor.load(path)
    model, description = predictor.model, predictor.description
    if name in _MODELS and description["model"] != name:
        raise ValueError(f"{path}: a checkpoint of {description['model']!r}, listed under {name!r}")
    if model.shape.horizon != config.shape.horizon or not (isinstance(predictor, MotionPredictor) or model.shape == config.shape):
        has = ", ".join(f"{size} {value}" for size, value in asdict(model.shape).items())
        raise ValueError(f"{path}: trained on windows of another shape: {has}; the evaluation has {config.shape}")
    trained = description.get("config", {})
    if trained.get("windows", {}).get("resampled") is False:
        told = "its clouds began at the first vertex of the mesh, and those of an evaluation do not: it may do worse for that"
        warnings.warn(f"{path} was trained with resampled=False: {told}", stacklevel=2)
    return predictor, {
        "checkpoint": shown,
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "model": description["model"],
        "seed": trained.get("seed"),
        "split": trained.get("split", {}),
        "trained_on": description.get("dataset", ""),
        **{key: description[key] for key in ("steps", "validation_loss") if key in description},
    }


def _check_unseen(about: Mapping[str, Any], windows: WindowDataset, condition: Condition) -> None:
    """Refuse a checkpoint that was trained, or stopped, on episodes that it is to be tested on."""
    where, dataset = f"condition {condition.name!r}: {about['checkpoint']}", windows.dataset
    same, word = about["trained_on"] == dataset.checksum(), 'if no episode is shared, say so: "shares_no_episode": true'
    if condition.shares_no_episode and not same:
        return
    try:
        parts = dataset.split(**about["split"])
    except (TypeError, ValueError) as error:
        raise ValueError(f"{where} was trained with a split that cannot be made here ({error}); {word}") from error
    both = np.intersect1d(windows.episodes, np.concatenate([parts["train"], parts["validation"]]))
    if len(both):
        whose = "this dataset" if same else f"a dataset with checksum {about['trained_on'][:12] or 'unknown'}"
        what = f"{where} was trained on {whose}, and {len(both)} episodes to test on, the first is {both[0]}"
        cure = f"test on the part it did not see{'' if same else f', or {word}'}"
        raise ValueError(f"{what}, were in its training or validation part; {cure}")
    if not same:
        alike = "they share no episode if both number theirs alike, as a dataset and its cut do; that was not checked"
        warnings.warn(f"{where} was trained on a dataset with another checksum: {alike}", stacklevel=2)
