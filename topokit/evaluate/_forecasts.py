"""Evaluate predictors on held-out windows: every number of chapter 11, from a dataset and checkpoints.

One file of results, written again after each condition; a run that was stopped goes on with the conditions that are missing.

Source: the figure is that of Antonova et al. 2021, section 6. Taught in chapter 11.
"""

from __future__ import annotations

import ast
import hashlib
import inspect
import json
import os
import platform
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import default_collate
from tqdm import tqdm

import topokit
from topokit._archive import FormatError, atomic_file
from topokit.data import Dataset, WindowDataset
from topokit.data._records import total
from topokit.models.base import Normalisation, PredictiveModel
from topokit.models.checkpoint import load_model
from topokit.models.registry import MODELS, build
from topokit.models.states import States, past_states, target_states

from . import _accuracy as measures
from . import _bootstrap as intervals
from . import _conditions as seen
from . import _failures as failures
from . import _summary as summary
from ._accuracy import COLUMNS, measure
from ._conditions import SpoiltWindows, choose, true_curves
from ._config import UNTRAINED, Condition, EvaluationConfig
from ._summary import Samples, horizons_of, steps_of, summarise

__all__ = ["evaluate_forecasts", "open_condition", "read_results", "windows_of"]

BATCH = 64


@dataclass(frozen=True, eq=False)
class Forecaster:
    """A model under one training seed; of seqPH there is no model, it looks at the future."""

    name: str
    model: PredictiveModel | None
    about: Mapping[str, Any]

    def __call__(self, window: Mapping[str, Tensor]) -> States:
        """The states that it forecasts, all steps."""
        if self.model is None:
            return target_states(window)
        states, _ = self.model(window)
        return states.float()


def evaluate_forecasts(
    config: EvaluationConfig,
    folder: str | Path = ".",
    out: str | Path | None = None,
    *,
    progress: bool = False,
    tell: Callable[[str], None] = lambda _: None,
    command: str = "",
    clips: str | Path | None = None,
) -> dict[str, Any]:
    """Evaluate all models under all conditions.

    Parameters
    ----------
    config : EvaluationConfig
    folder : path
        What the paths of `config` are relative to.
    out : path, optional
        File for the results. Conditions that are in it already, made from the same files by the same code, are not made again;
        the file is replaced in one piece after each condition.
    progress : bool
        Show a bar on stderr.
    tell : callable
        Is given a line of text now and then.
    command : str
        What made the file, for its readers.
    clips : path, optional
        Folder for the frames of the failures that the results list, of the condition with most garments.

    Returns
    -------
    dict
        What is in the file.

    Raises
    ------
    FileNotFoundError, FormatError
        When a dataset, its labels, or a checkpoint is missing or damaged.
    ValueError
        When a checkpoint was trained on windows of another shape, or on episodes that it would be tested on; or a condition
        has no window.
    """
    folder, results = Path(folder), _empty(config, command)
    done = read_results(out)["conditions"] if out is not None and Path(out).is_file() else {}
    for condition in config.conditions:
        opened = open_condition(config, condition, folder)
        known = done.get(condition.name)
        if known is not None and known["made_from"] == opened.made_from:
            tell(f"{condition.name}: in the file already")
            results["conditions"][condition.name] = known
        else:
            tell(f"{condition.name}: {len(opened.rows)} windows, {len(opened.forecasters)} forecasters")
            samples = _run(config, condition, opened, progress)
            answer = summarise(samples, config, condition is config.conditions[0])
            results["conditions"][condition.name] = opened.about() | answer | _failures(config, opened, samples)
        if condition is config.conditions[0]:
            results["hull_accuracy"] = results["conditions"][condition.name]["hull_accuracy"]
        results["complete"] = condition is config.conditions[-1]
        if out is not None:
            with atomic_file(out) as handle:
                handle.write(_as_json(results).encode())
    if clips is not None:
        _clip(config, results, folder, Path(clips))
    return results


def read_results(path: str | Path) -> dict[str, Any]:
    """Read a file that `evaluate_forecasts` wrote.

    Raises
    ------
    FileNotFoundError, FormatError
        When there is none, or it is something else.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: there is no such file; topokit evaluate makes it")
    try:
        results: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if results["kind"] != _KIND:
            raise KeyError("kind")
    except (ValueError, KeyError, TypeError) as error:
        raise FormatError(f"{path}: holds no results of topokit evaluate; take another name for --out") from error
    return results


# -- a condition ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Opened:
    """A condition whose files were found good."""

    windows: WindowDataset  # clean: its labels are the truth about presence
    seen: WindowDataset  # what the forecasters see
    rows: NDArray[np.int64]
    forecasters: tuple[Forecaster, ...]
    entries: Mapping[str, Any]
    made_from: str

    def about(self) -> dict[str, Any]:
        """What the results say about it."""
        return {"made_from": self.made_from, **self.entries}


def open_condition(config: EvaluationConfig, condition: Condition, folder: Path) -> Opened:
    """Open dataset and checkpoints of a condition, check that they fit each other, choose the windows."""
    where = f"condition {condition.name!r}"
    dataset = Dataset(folder / (condition.dataset or config.dataset))
    windows = windows_of(config, condition, dataset)
    rows = choose(windows, condition.windows)
    tested = np.unique(windows.index[rows, 0])
    listed = config.models if condition.models is None else condition.models
    forecasters = [
        Forecaster(
            name, None if name == "seqph" else build(name, config.shape, Normalisation()).eval(), {"model": name}
        )
        for name in UNTRAINED
    ]
    for name, paths in listed.items():
        found = [_load(config, name, folder / path, path) for path in paths]
        digests = [one.about["sha256"] for one in found]
        if len(set(digests)) < len(digests):
            raise ValueError(f"{where}: {name} lists the same weights twice; each checkpoint is to be of another seed")
        for one, path in zip(found, paths, strict=True):
            _check_unseen(one.about, path, dataset, tested, condition)
        forecasters += found
    spoilt = (
        windows
        if condition.clouds is None
        else SpoiltWindows(dataset, tested, how=condition.clouds, seed=config.seed, **_options(config, windows.labels))
    )
    if spoilt is not windows:
        places = {tuple(row): i for i, row in enumerate(spoilt.index.tolist())}
        own = np.array([places[tuple(row)] for row in windows.index[rows].tolist()])
        windows, rows = _take(windows, rows), own
    labels = dataset.labels(windows.labels)
    count = {g: int(n) for g, n in zip(*np.unique(_garments(spoilt, rows), return_counts=True), strict=True)}
    checkpoints: dict[str, list[dict[str, Any]]] = {}
    for one in forecasters:
        if one.name not in UNTRAINED:
            checkpoints.setdefault(_key(config, one.name), []).append(dict(one.about))
    entries = {
        "dataset": {"sha256": dataset.checksum(), "seed": dataset.seed, "episodes": len(dataset)},
        "labels": {
            "name": windows.labels,
            "observation": labels.manifest["observation"],
            "sha256": total(labels.manifest, labels.records),
        },
        "condition": {key: value for key, value in asdict(condition).items() if key not in ("models", "dataset")},
        "states_of_seqph_hold_carry_ridge": "the labels" if spoilt is windows else "tracked on the spoilt clouds",
        "windows": len(rows),
        "episodes": len(tested),
        "windows_by_garment": count,
        "checkpoints": checkpoints,
    }
    settings = {k: v for k, v in config.as_dict().items() if k in ("ours", "shape", "samples", "seed", "tolerance")}
    return Opened(windows, spoilt, rows, tuple(forecasters), entries, _digest([entries, settings, _code()]))


def windows_of(config: EvaluationConfig, condition: Condition, dataset: Dataset) -> WindowDataset:
    """All windows of a condition, of its part of the split and its garments.

    Raises
    ------
    ValueError
        When there is none; the message says what there is.
    """
    where, labels = f"condition {condition.name!r}", condition.labels or config.labels
    labelled = dataset.labelled(labels)
    parts = dataset.split(**condition.split) | {"all": dataset.episodes}
    if condition.part not in parts:
        raise ValueError(f"{where}: the split has no part {condition.part!r}; it has {', '.join(parts)}")
    unknown = sorted(set(condition.garments or ()) - set(dataset.garments))
    if unknown:
        raise ValueError(f"{where}: no garment {unknown[0]!r} in the dataset; it has {', '.join(dataset.garments)}")
    garments = condition.garments or dataset.garments
    chosen = [i for i in parts[condition.part].tolist() if dataset.group.records[i].garment in garments]
    known = np.intersect1d(chosen, labelled)
    if not len(known):
        raise ValueError(
            f"{where}: no episode to test on: the part {condition.part!r} has {len(parts[condition.part])} episodes, "
            f"{len(chosen)} of them of these garments, and none of those has labels {labels!r}"
        )
    if len(known) < len(chosen):
        warnings.warn(
            f"{where}: {len(chosen) - len(known)} of {len(chosen)} episodes have no labels {labels!r} and are left out",
            stacklevel=2,
        )
    return WindowDataset(dataset, known, **_options(config, labels))


def _options(config: EvaluationConfig, labels: str) -> dict[str, Any]:
    shape = config.shape
    sizes = {"history": shape.history, "horizon": shape.horizon, "n_points": shape.points, "slots": shape.slots}
    return {"labels": labels, **sizes}


def _take(windows: WindowDataset, rows: NDArray[np.int64]) -> WindowDataset:
    """Leave the chosen windows only, in their order."""
    windows.index = windows.index[rows]
    return windows


def _garments(windows: WindowDataset, rows: NDArray[np.int64]) -> NDArray[np.str_]:
    return np.array([windows.dataset.group.records[int(i)].garment for i in windows.index[rows, 0]])


def _load(config: EvaluationConfig, name: str, path: Path, shown: str) -> Forecaster:
    """Read a checkpoint and hold it against the evaluation."""
    model, description = load_model(path)
    if name in MODELS and description["model"] != name:
        raise ValueError(f"{path}: a checkpoint of {description['model']!r}, listed under {name!r}")
    if model.shape != config.shape:
        raise ValueError(
            f"{path}: trained on windows of another shape: {_words(model.shape)}; the evaluation has {_words(config.shape)}"
        )
    trained = description.get("config", {})
    about: dict[str, Any] = {
        "checkpoint": shown,
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "model": description["model"],
        "seed": trained.get("seed"),
        "split": _in_order(trained.get("split", {})),
        "trained_on": description.get("dataset", ""),
        **{key: description[key] for key in ("steps", "validation_loss") if key in description},
    }
    return Forecaster(name, model, about)


def _in_order(split: Mapping[str, Any]) -> dict[str, Any]:
    """The shares of a split in the order of training: checkpoints keep names sorted, and a split depends on their order."""
    order = {"train": 0, "validation": 1}
    shares = sorted(split.get("shares", {}).items(), key=lambda part: order.get(part[0], 2))
    return dict(split) | ({"shares": dict(shares)} if shares else {})


def _words(shape: object) -> str:
    return ", ".join(f"{name} {value}" for name, value in vars(shape).items())


def _check_unseen(
    about: Mapping[str, Any], path: str, dataset: Dataset, tested: NDArray[np.int64], condition: Condition
) -> None:
    """Refuse a checkpoint that was trained, or stopped, on episodes that it is to be tested on."""
    where = f"condition {condition.name!r}: {path}"
    same = about["trained_on"] == dataset.checksum()
    if condition.shares_no_episode and not same:
        return
    try:
        parts = dataset.split(**about["split"])
    except ValueError as error:
        raise ValueError(
            f"{where} was trained on another dataset, whose split {about['split']} cannot be made here ({error}); if it "
            'shares no episode with this one, say so: "shares_no_episode": true'
        ) from error
    both = np.intersect1d(tested, np.concatenate([parts["train"], parts["validation"]]))
    if len(both):
        whose = "this dataset" if same else f"a dataset with checksum {about['trained_on'][:12] or 'unknown'}"
        raise ValueError(
            f"{where} was trained on {whose} with the split {about['split']}, and {len(both)} of the {len(tested)} episodes "
            f"to test on were in its training or validation part, the first is {both[0]}: test on the part it did not see"
            + ("" if same else ', or say that no episode is shared, if so: "shares_no_episode": true')
        )
    if not same:
        warnings.warn(
            f"{where} was trained on a dataset with another checksum. None of the tested episodes was in its training part "
            "if the two number their episodes alike, as a dataset and its cut do; that was not checked",
            stacklevel=2,
        )


def _run(config: EvaluationConfig, condition: Condition, opened: Opened, progress: bool) -> Samples:
    """Forecast all windows with all models, and measure."""
    steps = steps_of(config.shape.horizon)
    fine = horizons_of(config.shape.horizon)
    rows = opened.rows
    clean_rows = rows if opened.seen is opened.windows else np.arange(len(rows))
    kept: list[list[dict[str, NDArray[np.float64]]]] = [[] for _ in opened.forecasters]
    bar = tqdm(
        total=len(rows) * len(opened.forecasters),
        unit="forecast",
        desc=condition.name,
        disable=not progress,
        leave=False,
    )
    with bar, torch.inference_mode():
        for number, part in enumerate(_chunks(len(rows))):
            clean = default_collate([opened.windows[int(i)] for i in clean_rows[part]])
            window = clean
            if opened.seen is not opened.windows:
                window = default_collate([opened.seen[int(i)] for i in rows[part]])
            truth = true_curves(opened.windows, clean_rows[part], steps)  # type: ignore[arg-type]
            target, past = target_states(clean), past_states(clean)[:, -1:]
            for place, forecaster in enumerate(opened.forecasters):
                rng = np.random.default_rng((config.seed, number))  # the same points of the openings for all
                kept[place].append(measure(forecaster(window), target, past, truth, steps, fine, rng))
                bar.update(len(truth))
    columns: dict[str, list[dict[str, NDArray[np.float64]]]] = {}
    for forecaster, parts in zip(opened.forecasters, kept, strict=True):
        whole = {name: np.concatenate([part[name] for part in parts]) for name in COLUMNS}
        columns.setdefault(_key(config, forecaster.name), []).append(whole)
    stacked = {
        name: {column: np.stack([seed[column] for seed in seeds]) for column in COLUMNS}
        for name, seeds in columns.items()
    }
    return Samples(stacked, opened.seen.index[rows, 0], _garments(opened.seen, rows), steps, fine)


def _failures(config: EvaluationConfig, opened: Opened, samples: Samples) -> dict[str, Any]:
    """What is to be looked at; nothing where the clouds are spoilt, which no dataset holds."""
    first: dict[str, Forecaster] = {}
    for one in opened.forecasters:
        first.setdefault(_key(config, one.name), one)
    if "ours" not in first or opened.seen is not opened.windows:
        return {"failures": []}
    models: dict[str, failures.Model] = {
        name: first[name] for name in ("ours", "pointnet", "carry", "seqph") if name in first
    }
    return {"failures": failures.shown(opened.windows, opened.rows, samples, models, config.tolerance)}


def _clip(config: EvaluationConfig, results: Mapping[str, Any], folder: Path, clips: Path) -> None:
    """Save the frames of the failures of the condition that shows most garments."""
    known = results["conditions"]
    chosen = max(config.conditions, key=lambda condition: len(known[condition.name]["failures"]))
    dataset = Dataset(folder / (chosen.dataset or config.dataset))
    failures.save_clips(known[chosen.name]["failures"], dataset, clips)


def _chunks(n: int) -> Iterator[slice]:
    return (slice(start, min(start + BATCH, n)) for start in range(0, n, BATCH))


def _key(config: EvaluationConfig, name: str) -> str:
    """What the results call a model."""
    return "ours" if name == config.ours else name


# -- the file ---------------------------------------------------------------------------------------------------------------

_KIND = "topokit-evaluation"


def _empty(config: EvaluationConfig, command: str) -> dict[str, Any]:
    return {
        "kind": _KIND,
        "version": 1,
        "complete": False,
        "ours": config.ours,
        "measure": (
            "hull_accuracy: share of windows in which the mean of the longest-lived forecast mixture is in the convex hull of "
            "the true loop's vertices and of the edge that ends its class in the full cloud, or within "
            f"{100 * config.tolerance:g} cm of it; where two loops or more are there, the first two in two hulls. Intervals: "
            "95 %, bootstrap over the episodes of each garment, and over seeds. n: windows (of each seed) with a true loop there"
        ),
        "commands": [*config.commands, *([command] if command else [])],
        "seed": config.seed,
        "bootstrap_samples": config.samples,
        "tolerance": config.tolerance,
        "horizons": [*map(str, horizons_of(config.shape.horizon)), "mean"],
        "made_with": {
            "topokit": topokit.__version__,
            "torch": torch.__version__,
            "numpy": np.__version__,
            "python": platform.python_version(),
            "hardware": f"{platform.machine()}, {os.cpu_count()} CPU cores, {torch.get_num_threads()} used",
        },
        "hull_accuracy": {},
        "conditions": {},
    }


def _as_json(results: Mapping[str, Any]) -> str:
    """JSON with a line for every innermost object or list."""
    text = json.dumps(results, indent=1, allow_nan=False)
    text = re.sub(r"\{[^][{}]*\}", lambda match: re.sub(r"\s+", " ", match[0]), text)
    return re.sub(r"\[[^][{}]*\]", lambda match: re.sub(r"\s+", " ", match[0]), text) + "\n"


def _code() -> str:
    """A name for the code that makes the numbers; words about it do not count."""
    trees = [ast.parse(inspect.getsource(module)) for module in (measures, seen, intervals, summary, failures)]
    for node in (node for tree in trees for node in ast.walk(tree)):
        body = getattr(node, "body", None)
        if isinstance(body, list) and isinstance(body[0], ast.Expr) and isinstance(body[0].value, ast.Constant):
            body.pop(0)
    return _digest([ast.dump(tree) for tree in trees])


def _digest(parts: Sequence[Any]) -> str:
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:16]
