"""What motion.py and unseen.py share: conditions, forecasters, and the tables of a record of forecasts.

Idea: a condition is a choice of episodes and of what is done to their clouds. Every forecaster is asked about the same
windows of it. The record has means over windows with bootstrap intervals (tables.py).

Source: the figure is that of Antonova et al. 2021, section 6. Taught in chapter 15.
"""

import argparse
import hashlib
import json
import os
import platform
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from _paper_marking import marked_vertices
from accuracy import TrueCurves, measure_forecasts
from numpy.typing import NDArray
from spoilt import spoil
from tables import bootstrap, draw_episodes, draw_seeds, interval, quotient, write_results
from torch import Tensor
from torch.utils.data import default_collate
from tqdm import tqdm

import topokit
from topokit.data import Dataset, WindowDataset
from topokit.evaluate import true_loops
from topokit.io import save_episode
from topokit.models import Predictor, StateTensors, build
from topokit.models._baselines import Shape
from topokit.models._motion import Motion

Forecaster = Callable[[Mapping[str, Tensor]], StateTensors]

ROOT = Path(__file__).parents[2]
BATCH = 64
HORIZONS = (1, 15, 30, 60)  # the paper's steps ahead: those of the tables
STEPS = (1, *range(5, 61, 5))  # those of the curves
MODELS = ("seqph", "hold", "carry", "ridge", "mlp", "pointnet", "ours")  # the order of the tables
TOLERANCES = (0.0, 0.01, 0.02, 0.03, 0.05, 0.1)  # metres beside a hull that still count as in it
FAR = 0.05  # metres outside the hull: a forecast that is lost
MOST_FAILURES = 6

# Which columns are divided to make a measure: the sum of the first over the sum of the second.
RATIOS = {
    "hull_accuracy": ("in_hull", "hull_distance_n"),
    "in_plane": ("in_plane", "in_plane_n"),
    "in_opening": ("in_opening", "in_opening_n"),
    "distance_cm": ("distance_cm", "distance_cm_n"),
    "nll": ("nll", "nll_n"),
    "cover50": ("cover50", "cover50_n"),
    "cover90": ("cover90", "cover90_n"),
    "identity": ("same_slot", "same_slot_n"),
    "brier": ("brier", "brier_n"),
    "opens_recall": ("opens_right", "opens"),
    "opens_precision": ("opens_right", "opens_forecast"),
    "closes_recall": ("closes_right", "closes"),
    "closes_precision": ("closes_right", "closes_forecast"),
}
CURVES = {"": "hull_distance", "any curve of the class, ": "hull_distance_any_curve"}
CURVES |= {"marked curve alone, ": "hull_distance_marked_curve"}


@dataclass(frozen=True)
class Clouds:
    """The changes that a condition makes to clouds. The loops are then tracked anew on the clouds that result."""

    noise: float = 0.0  #: standard deviation of each coordinate, metres
    outliers: float = 0.0  #: share of the points that are put anywhere in the cloud's box, grown by 10 cm on each side
    keep: float = 1.0  #: share of the points that are kept, at random in every frame


@dataclass(frozen=True)
class Condition:
    """One table: which episodes, what is done to their clouds, and other checkpoints if need be."""

    name: str  #: its key in the results
    dataset: str = ""  #: when not the dataset of the evaluation
    labels: str = ""  #: when not the labels of the evaluation
    plans: str = "all"  #: "script" or "off script": whether the grippers followed a scripted path
    turned: float = 0.0  #: degrees by which scene and plan are turned about the vertical before forecasters see them
    garments: Sequence[str] | None = None  #: all when not given
    windows: int = 100  #: at most so many of each garment, spread evenly over its episodes and their frames
    clouds: Clouds | None = None  #: when not given, seqPH, hold and carry have the states of the labels
    models: dict[str, list[str]] | None = None  #: checkpoints, when not those of the evaluation


@dataclass(frozen=True)
class EvaluationConfig:
    """One evaluation. Paths are relative to the configuration's file."""

    dataset: str
    models: dict[str, list[str]]  #: checkpoints of each model, one for each training seed
    conditions: list[Condition]  #: the first is the paper's figure
    ours: str = "motion"  #: which of the models is ours; in the results it is called "ours"
    labels: str = "full"
    shape: Shape = field(default_factory=Shape)  #: of the windows; all checkpoints must have it
    samples: int = 1000  #: draws of the bootstrap
    seed: int = 0  #: of everything random
    tolerance: float = 0.02  #: metres beside a hull that still count as in it
    commands: list[str] = field(default_factory=list)  #: how datasets and checkpoints were made


def load_evaluation(path: Path) -> EvaluationConfig:
    """Read a configuration."""
    document = json.loads(path.read_text(encoding="utf-8"))
    conditions = []
    for entry in document["conditions"]:
        if "clouds" in entry:
            entry["clouds"] = Clouds(**entry["clouds"])
        conditions.append(Condition(**entry))
    document["conditions"] = conditions
    document["shape"] = Shape(**document.get("shape", {}))
    return EvaluationConfig(**document)


def evaluate_forecasts(
    config: EvaluationConfig,
    folder: Path = Path(),
    out: Path | None = None,
    *,
    only: Sequence[str] = (),
    clips: Path | None = None,
) -> dict[str, Any]:
    """Measure all models under all conditions; return the record, and write it to `out` after each condition.

    Paths of `config` are relative to a folder. Where `only` names conditions, the others are taken from the record that is there.
    Frames of the failures that the record lists go to the folder `clips`, of the condition with most failures.
    """
    known = {}
    if only and out is not None:
        known = json.loads(out.read_text(encoding="utf-8"))["conditions"]
    results = header(config)
    for condition in config.conditions:
        if only and condition.name not in only:
            results["conditions"][condition.name] = known[condition.name]
            continue
        table = measure_condition(config, condition, folder, first=condition is config.conditions[0])
        results["conditions"][condition.name] = table
        results["complete"] = len(results["conditions"]) == len(config.conditions)
        if out is not None:
            write_results(out, results)
    if clips is not None:
        tables = results["conditions"]
        chosen = max(config.conditions, key=lambda condition: len(tables[condition.name]["failures"]))
        save_clips(tables[chosen.name]["failures"], Dataset(folder / (chosen.dataset or config.dataset)), clips)
    return results


def header(config: EvaluationConfig) -> dict[str, Any]:
    """Return a record without conditions."""
    hardware = f"{platform.machine()}, {os.cpu_count()} CPU cores, {torch.get_num_threads()} used"
    return {
        "kind": "topokit-evaluation",
        "version": 1,
        "complete": False,
        "ours": config.ours,
        "measure": (
            "hull_accuracy: share of windows in which the mean of the longest-lived forecast mixture is in the convex hull of "
            "the true loop's vertices and of the edge that ends its class in the full cloud, or within "
            f"{100 * config.tolerance:g} cm of it; where two loops or more are there, the first two in two hulls. Intervals: "
            "95 %, bootstrap over the episodes of each garment, and over seeds. n: windows (of each seed) with a true loop there"
        ),
        "commands": list(config.commands),
        "seed": config.seed,
        "bootstrap_samples": config.samples,
        "tolerance": config.tolerance,
        "horizons": [*map(str, HORIZONS), "mean"],
        "made_with": {
            "topokit": topokit.__version__,
            "torch": torch.__version__,
            "numpy": np.__version__,
            "python": platform.python_version(),
            "hardware": hardware,
        },
        "conditions": {},
    }


# ---------------------------------------------------------------------------------------------------- windows and forecasters


def tested_episodes(condition: Condition, dataset: Dataset, labels: str) -> NDArray[np.int64]:
    """Return the labelled episodes of a condition, of its garments and plans."""
    chosen = []
    for number in dataset.episodes.tolist():
        if condition.garments is not None and dataset.record(number).garment not in condition.garments:
            continue
        if condition.plans != "all":
            off_script = "path" in dataset.record(number).physics
            if off_script != (condition.plans == "off script"):
                continue
        chosen.append(number)
    known = np.intersect1d(chosen, dataset.labelled(labels))
    if not len(known):
        raise ValueError(f"condition {condition.name!r}: no episode of it has labels {labels!r}")
    if len(known) < len(chosen):
        warnings.warn(f"condition {condition.name!r}: {len(chosen) - len(known)} episodes have no labels", stacklevel=2)
    return known


def kinds_of(windows: WindowDataset, name: str) -> NDArray[np.str_]:
    """Return (n,) the `garment` or the `target` of each window."""
    return np.array([getattr(windows.dataset.record(number), name) for number in windows.index[:, 0].tolist()])


def spread_windows(windows: WindowDataset, most: int) -> NDArray[np.int64]:
    """Return rows of at most so many windows of each garment, spread evenly over its episodes and their frames."""
    garments = kinds_of(windows, "garment")
    chosen = []
    for name in np.unique(garments):
        rows = np.flatnonzero(garments == name)
        places = np.linspace(0, len(rows) - 1, min(most, len(rows))).round().astype(int)
        chosen.append(rows[np.unique(places)])
    return np.sort(np.concatenate(chosen))


def spoilt_observer(clouds: Clouds, seed: int) -> Callable[[int, NDArray[np.float64]], NDArray[np.float64]]:
    """Return what `WindowDataset` observes: spoilt clouds, on which the tracker works, too."""

    def observe(number: int, film: NDArray[np.float64]) -> NDArray[np.float64]:
        rng = np.random.default_rng((seed, number))
        kept = max(1, round(clouds.keep * film.shape[1]))  # the points after these repeat them
        return spoil(film, rng, **asdict(clouds))[:, :kept]

    return observe


def true_curves(windows: WindowDataset, rows: Sequence[int], steps: Sequence[int]) -> list[TrueCurves]:
    """Return the true loops of some windows at some steps ahead."""
    curves = []
    for number, frame in windows.index[np.asarray(rows)].tolist():
        whole = _true_curves(windows.dataset.folder, number)
        frames = frame + np.array(steps)
        curves.append(
            TrueCurves(
                curves=tuple(curve[frames] for curve in whole.curves),
                closing=tuple(ends[frames] for ends in whole.closing),
                present=tuple(present[frames] for present in whole.present),
                tight=tuple([loop[frame] for frame in frames] for loop in whole.tight),
                marked=tuple(vertices[frames] for vertices in whole.marked),
            )
        )
    return curves


@cache  # conditions share their episodes; a few hundred, half a second and a megabyte each
def _true_curves(folder: Path, number: int) -> TrueCurves:
    episode = Dataset(folder)[number]
    points = episode.points.astype(np.float64)
    frames = true_loops(points, episode.loops)
    killers = np.array([frame.killers for frame in frames])  # (T, loops, 2)
    every = np.arange(len(points))[:, None]
    loops = range(len(episode.loops))
    return TrueCurves(
        curves=tuple(points[:, loop] for loop in episode.loops),
        closing=tuple(points[every, killers[:, i]] for i in loops),
        present=tuple(np.array([frame.present for frame in frames]).T),
        tight=tuple([cloud[frame.tight[i]] for cloud, frame in zip(points, frames, strict=True)] for i in loops),
        marked=tuple(points[:, ids] for ids in marked_vertices(episode)),
    )


def of_windows(model: Any) -> Forecaster:
    """Return a forecaster that looks at the windows themselves."""
    return lambda window: model(window).map(Tensor.float)


def of_stream(predictor: Any, windows: WindowDataset, steps: Sequence[int]) -> Forecaster:
    """Return a forecaster that is shown the frames of each window one by one, as whole clouds.

    Its loops are sought anew in the moved cloud, at the steps that are measured.
    """
    seen = lru_cache(8)(windows.seen)

    def forecast(window: Mapping[str, Tensor]) -> StateTensors:
        turn = np.asarray(window.get("turn", np.eye(3)), np.float64)
        forecasts = []
        for i, (number, frame) in enumerate(zip(window["episode"].tolist(), window["frame"].tolist(), strict=True)):
            clouds, target = seen(number)
            predictor.reset()
            for k in range(windows.history):
                cloud = clouds[frame - windows.history + 1 + k] @ turn.T
                predictor.observe(cloud, window["grippers"][i, k], bool(window["held"][i, k]), target @ turn.T)
            forecasts.append(predictor.predict(window["actions"][i], window["actions_held"][i], exact=steps))
        return stack_forecasts(forecasts, windows.slots)

    return forecast


def of_predictor(predictor: Any, windows: WindowDataset, steps: Sequence[int] = HORIZONS) -> Forecaster:
    """Return the forecaster of a checkpoint; one that moves points is shown whole clouds, and others the windows."""
    if isinstance(predictor.model, Motion):
        return of_stream(predictor, windows, steps)
    return of_windows(predictor.model)


def states_at(place: Tensor, presence: Tensor, lifetime: Tensor) -> StateTensors:
    """Return states whose loops are points (B, K, S, 3), with logits of presence (B, K, S) and lifetimes (B, K, S), metres."""
    ones = torch.ones_like(presence)
    return StateTensors(
        corners=place[..., None, :].expand(*place.shape[:3], 8, 3),
        neighbour_values=0.025 * ones[..., None].expand(*place.shape[:3], 4),
        birth=0.025 * ones,
        death=0.025 + lifetime,
        killer_shift=0.025 * ones,
        presence=presence,
        noise=1e-4 * ones,
    )


def stack_forecasts(forecasts: Sequence[StateTensors], slots: int) -> StateTensors:
    """Return B forecasts as one, with as many slots as the windows have. A slot that a forecast lacks is empty."""
    padded = [forecast[:, :slots].padded(slots) for forecast in forecasts]
    return StateTensors(
        *(torch.stack(part) for part in zip(*(vars(states).values() for states in padded), strict=True))
    )


def turned(forecaster: Forecaster, degrees: float) -> Forecaster:
    """Return a forecaster that is shown scene and plan turned about the vertical, and whose forecast is turned back."""
    angle = np.radians(degrees)
    axes = [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    turn = torch.tensor(axes, dtype=torch.float32)

    def forecast(window: Mapping[str, Tensor]) -> StateTensors:
        names = ("clouds", "grippers", "actions", "triangles", "past_triangles")
        states = forecaster({**window, **{name: window[name] @ turn.T for name in names}, "turn": turn})
        return states.replace(corners=states.corners @ turn)

    return forecast


def load_checkpoint(path: Path, shown: str, shape: Shape) -> tuple[Predictor, dict[str, Any]]:
    """Return a predictor, and what the record says about its checkpoint."""
    predictor = Predictor.load(path)
    trained_shape = predictor.model.shape
    description = predictor.description
    fits = description["model"] == "motion" or trained_shape == shape
    if trained_shape.horizon != shape.horizon or not fits:
        raise ValueError(f"{path}: trained on windows of shape {trained_shape}; the evaluation has {shape}")
    trained = description.get("config", {})
    about = {
        "checkpoint": shown,
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "model": description["model"],
        "seed": trained.get("seed"),
        "trained_on": description.get("dataset", ""),
    }
    for name in ("steps", "validation_loss"):
        if name in description:
            about[name] = description[name]
    return predictor, about


# ------------------------------------------------------------------------------------------------------------------- measuring


def measure_condition(config: EvaluationConfig, condition: Condition, folder: Path, first: bool) -> dict[str, Any]:
    """Return the table of a condition; the `first` also has treatments of nearly flat hulls for each garment."""
    dataset = Dataset(folder / (condition.dataset or config.dataset))
    labels = condition.labels or config.labels
    shape = config.shape

    # Windows as the labels have them, and the same windows as the forecasters see them.
    options: dict[str, Any] = {"n_points": shape.points, "labels": labels}
    windows = WindowDataset(dataset, tested_episodes(condition, dataset, labels), **options)
    rows = spread_windows(windows, condition.windows)
    clean = windows.select(rows)
    observed = clean
    if condition.clouds is not None:
        observe = spoilt_observer(condition.clouds, config.seed)
        observed = WindowDataset(dataset, windows.episodes, observe=observe, **options).select(rows)

    # Three forecasters need no checkpoint; seqPH sees the future. Then those that were trained, one for each seed.
    forecasters: dict[str, list[Forecaster]] = {"seqph": [StateTensors.from_labels]}
    for name in ("hold", "carry"):
        forecasters[name] = [of_windows(build(name, shape).eval())]
    checkpoints: dict[str, list[dict[str, Any]]] = {}
    models = config.models
    if condition.models is not None:
        models = condition.models
    for name, paths in models.items():
        shown = "ours" if name == config.ours else name
        forecasters[shown] = []
        checkpoints[shown] = []
        for path in paths:
            predictor, about = load_checkpoint(folder / path, path, shape)
            if about["trained_on"] == dataset.checksum():
                raise ValueError(f"condition {condition.name!r}: {path} was trained on the episodes to test on")
            forecasters[shown].append(of_predictor(predictor, observed, STEPS))
            checkpoints[shown].append(about)
    for name, found in forecasters.items():
        forecasters[name] = [turned(forecaster, condition.turned) for forecaster in found]

    samples = measure(forecasters, clean, observed, STEPS, config.seed, condition.name)
    settings = {key: value for key, value in asdict(condition).items() if key not in ("models", "dataset")}
    spoilt = condition.clouds is not None
    failures = []
    if "ours" in forecasters and not spoilt:  # no dataset holds spoilt clouds
        failures = list_failures(samples, forecasters, clean, config)
    return {
        "dataset": {"sha256": dataset.checksum(), "seed": dataset.seed, "episodes": len(dataset)},
        "labels": {"name": labels, "sha256": dataset.labels(labels).checksum()},
        "condition": settings,
        "states_of_seqph_hold_carry_ridge": "tracked on the spoilt clouds" if spoilt else "the labels",
        "windows": len(clean),
        "episodes": len(clean.episodes),
        "checkpoints": checkpoints,
        **summarise(samples, config, thorough=first),
        "failures": failures,
    }


def measure(
    forecasters: Mapping[str, Sequence[Forecaster]],
    clean: WindowDataset,
    observed: WindowDataset,
    steps: Sequence[int],
    seed: int,
    name: str,
) -> pd.DataFrame:
    """Return one row for each model, training seed, window and step."""
    described = pd.DataFrame({"episode": clean.index[:, 0]})
    described["garment"] = kinds_of(clean, "garment")
    described["target"] = kinds_of(clean, "target")
    horizons = [step for step in steps if step in HORIZONS]
    parts = []
    bar = tqdm(total=len(clean) * sum(map(len, forecasters.values())), desc=name, unit="forecast", disable=None)
    with bar, torch.inference_mode():
        for number, start in enumerate(range(0, len(clean), BATCH)):
            # The truth about a batch of windows; all forecasters are compared with it.
            rows = range(start, min(start + BATCH, len(clean)))
            labelled = default_collate([clean[row] for row in rows])
            window = default_collate([observed[row] for row in rows])
            truth = true_curves(clean, rows, steps)
            target = StateTensors.from_labels(labelled)
            past = StateTensors.from_past(labelled)[:, -1:]
            for model, found in forecasters.items():
                for training, forecaster in enumerate(found):
                    rng = np.random.default_rng((seed, number))  # all are compared at the same points of the openings
                    columns = measure_forecasts(forecaster(window), target, past, truth, steps, horizons, rng)
                    part = described.loc[np.repeat(rows, len(steps))].reset_index(names="window")
                    part["model"] = model
                    part["seed"] = training
                    part["step"] = np.tile(steps, len(rows))
                    parts.append(part.assign(**{name: values.ravel() for name, values in columns.items()}))
                    bar.update(len(rows))
    return pd.concat(parts, ignore_index=True)


# -------------------------------------------------------------------------------------------------------------------- tables


def summarise(samples: pd.DataFrame, config: EvaluationConfig, thorough: bool) -> dict[str, Any]:
    """Return all tables of a condition."""
    order = [*MODELS, *samples["model"].unique()]
    samples = samples.sort_values("model", key=lambda names: names.map(order.index), kind="stable")
    totals = sums_of(samples, config)
    measures = {name: quotient(totals, *columns) for name, columns in RATIOS.items()}
    present = [quotient(totals, f"{kind}_right", kind) for kind in ("present", "absent")]
    measures["presence"] = (present[0][0] + present[1][0]) / 2, np.maximum(present[0][1], present[1][1])

    # Means over the windows by model and step, then what is no mean.
    answer: dict[str, Any] = {name: table(*found) for name, found in measures.items()}
    answer["nll_median"] = medians(samples)
    answer["lost"] = lost(samples, config)
    answer["gain_of_ours"] = gains(*measures["hull_accuracy"])
    answer["outcomes"] = outcomes(samples, config.tolerance)
    answer["by_seed"] = by_seed(samples, config.tolerance)
    answer["curves"] = {
        name: table(*measures[name], STEPS, mean=False)
        for name in ("hull_accuracy", "distance_cm", "identity", "presence")
    }
    answer["hull_treatments"] = treatments(totals, TOLERANCES)

    # The same for each garment and each target, with draws of their own.
    for kind in ("garment", "target"):
        parts = dict(list(samples.groupby(kind)))
        if len(parts) < 2:
            continue
        answer[f"by_{kind}"] = {}
        for name, part in parts.items():
            sums = sums_of(part, config)
            entry = {"windows": int(part["window"].nunique()), "episodes": int(part["episode"].nunique())}
            for measure in ("hull_accuracy", "in_opening"):
                entry[measure] = table(*quotient(sums, *RATIOS[measure]))
            if thorough and kind == "garment":
                entry["hull_treatments"] = treatments(sums, (0.0, config.tolerance))
            answer[f"by_{kind}"][str(name)] = entry
    return answer


def sums_of(samples: pd.DataFrame, config: EvaluationConfig) -> pd.DataFrame:
    """Return bootstrap sums of all columns, of hits under all tolerances, and of how many samples have a value at all."""
    # Hits are 0 or 1, so that their sums over counts are shares.
    columns = samples.drop(columns=["window", "target"]).copy()
    columns["distance_cm"] = 100 * columns.pop("distance")
    columns["in_hull"] = columns["hull_distance"] <= max(config.tolerance, 1e-9)
    for column in CURVES.values():
        for tolerance in TOLERANCES:
            columns[f"{column}, {tolerance}"] = columns[column] <= max(tolerance, 1e-9)
    column = "hull_distance_presence_ignored"
    columns[f"{column}, {config.tolerance}"] = columns[column] <= max(config.tolerance, 1e-9)
    # Beside each column its count: how many samples have a value.
    keys = ("model", "seed", "step", "episode", "garment")
    values = [name for name in columns if name not in keys]
    counts = columns[values].notna().add_suffix("_n")
    distances = columns[values].replace(np.inf, np.nan)  # too few loops are forecast: no distance, but a miss
    table = pd.concat([columns[list(keys)], distances.astype(float), counts.astype(float)], axis=1)
    return bootstrap(table, [*values, *counts], config.samples, config.seed)


def table(
    values: pd.DataFrame, counts: pd.DataFrame, steps: Sequence[int] = HORIZONS, mean: bool = True
) -> dict[str, Any]:
    """Return by model and step the mean, its interval and the number of samples, and so of the mean over the steps."""
    answer = {}
    for model in values.columns.unique(0):
        chosen = values[model][list(steps)]
        number = counts[model].iloc[0][list(steps)]
        if mean:
            chosen = chosen.assign(mean=chosen.mean(axis=1, skipna=False))
            number["mean"] = number.max()
        cells = interval(chosen).round(4).replace([np.inf, -np.inf, np.nan], None)  # as JSON has it
        rows = cells.to_dict("index").items()
        answer[model] = {str(step): cell | {"n": round(number[step])} for step, cell in rows}
    return answer


def gains(hits: pd.DataFrame, counts: pd.DataFrame) -> dict[str, Any]:
    """Return how far the hull accuracy of ours is above that of the others, on the same draws of episodes."""
    others = [model for model in hits.columns.unique(0) if model != "ours"]
    if "ours" not in hits:
        return {}
    return table(pd.concat({model: hits["ours"] - hits[model] for model in others}, axis=1), counts)


def medians(samples: pd.DataFrame) -> dict[str, Any]:
    """Return the median over the windows of the negative log-likelihood, without intervals."""
    found = samples[samples["step"].isin(HORIZONS)].groupby(["model", "step"], sort=False)["nll"].median().unstack()
    found["mean"] = found.mean(axis=1, skipna=False)
    answer: dict[str, Any] = {}
    for model, row in found.round(4).iterrows():
        answer[model] = {str(step): {"mean": float(x) if np.isfinite(x) else None} for step, x in row.items()}
    return answer


def lost(samples: pd.DataFrame, config: EvaluationConfig) -> dict[str, Any]:
    """Return the chance that of two forecasts the one far outside the hull expects more error (AUROC), with intervals."""
    expected = samples.dropna(subset=["expected_variance"])
    expected = expected[expected["step"].isin(HORIZONS)]
    answer: dict[str, Any] = {}
    for model, rows in expected.groupby("model", sort=False):
        chances = {}
        counts = {}
        for step, part in rows.groupby("step"):
            far = (part["hull_distance"] > FAR).to_numpy()
            variance = part["expected_variance"].to_numpy()
            # The Mann-Whitney statistic over its largest value, in every draw.
            above = (1 + np.sign(variance[far][:, None] - variance[~far])) / 2  # (far, near), half where they are equal
            draws = draw_samples(part, config)
            pairs = draws[:, far].sum(axis=1) * draws[:, ~far].sum(axis=1)
            with np.errstate(invalid="ignore", divide="ignore"):
                chances[step] = ((draws[:, far] @ above) * draws[:, ~far]).sum(axis=1) / pairs
            counts[step] = len(part) / part["seed"].nunique()
        values = pd.concat({model: pd.DataFrame(chances)}, axis=1)
        numbers = pd.concat({model: pd.DataFrame(counts, index=[0])}, axis=1)
        answer |= table(values, numbers, [step for step in HORIZONS if step in chances])
    return answer


def draw_samples(samples: pd.DataFrame, config: EvaluationConfig) -> NDArray[np.float64]:
    """Return (1 + draws, samples) how often each draw of episodes and training seeds takes each sample of a model."""
    episodes = draw_episodes(samples.groupby("episode")["garment"].first(), config.samples, config.seed)
    seeds = draw_seeds(samples["seed"].unique(), config.samples, config.seed + 1)
    return episodes[samples["episode"]].to_numpy() * seeds[samples["seed"]].to_numpy()


def outcomes(samples: pd.DataFrame, tolerance: float) -> dict[str, Any]:
    """Return shares of windows: in the hull, beside it by 10 cm at most, farther, or too few loops forecast."""
    known = samples.dropna(subset=["hull_distance"])
    ends = [-np.inf, max(tolerance, 1e-9), 0.1, np.finfo(float).max, np.inf]
    kinds = pd.cut(known["hull_distance"], ends, labels=["hit", "near", "far", "silent"])
    groups = kinds.groupby([known["model"], known["step"]], sort=False)
    shares = groups.value_counts(normalize=True).unstack(fill_value=0.0)
    answer: dict[str, Any] = {}
    for model in samples["model"].unique():
        answer[model] = {str(step): shares.loc[model, step].round(4).to_dict() for step in HORIZONS}
    return answer


def by_seed(samples: pd.DataFrame, tolerance: float) -> dict[str, Any]:
    """Return the hull accuracy of every training seed on its own, for models that have several."""
    known = samples.dropna(subset=["hull_distance"])
    known = known[known["step"].isin(HORIZONS)]
    hits = known["hull_distance"] <= max(tolerance, 1e-9)
    hits = hits.groupby([known["model"], known["seed"], known["step"]]).mean()
    answer: dict[str, Any] = {}
    for model in samples["model"].unique():
        each = hits[model].unstack("step")
        if len(each) > 1:
            each["mean"] = each.mean(axis=1)
            answer[model] = {str(step): column.round(4).tolist() for step, column in each.items()}
    return answer


def treatments(totals: pd.DataFrame, tolerances: Sequence[float]) -> dict[str, Any]:
    """Return the hull accuracy when a nearly flat hull is treated otherwise, or presence is not asked for."""
    columns = {}
    for curve, column in CURVES.items():
        for tolerance in tolerances:
            columns[f"{curve}within {100 * tolerance:g} cm"] = f"{column}, {tolerance}", f"{column}_n"
    columns["in the plane"] = RATIOS["in_plane"]
    columns["in the opening"] = RATIOS["in_opening"]
    ignored = next(name for name in totals.columns.unique(2) if name.startswith("hull_distance_presence_ignored, "))
    columns["presence not asked for"] = ignored, "hull_distance_presence_ignored_n"
    return {name: table(*quotient(totals, *pair)) for name, pair in columns.items()}


# ------------------------------------------------------------------------------------------------------------------ failures


def list_failures(
    samples: pd.DataFrame,
    forecasters: Mapping[str, Sequence[Forecaster]],
    windows: WindowDataset,
    config: EvaluationConfig,
) -> list[dict[str, Any]]:
    """Return the worst samples, and what models forecast there for the last step: loops by lifetime times presence, metres."""
    step = HORIZONS[-1]
    last = samples[(samples["step"] == step) & (samples["seed"] == 0)]
    distances = last.pivot(index="window", columns="model", values="hull_distance_presence_ignored")
    ours = distances["ours"].replace(np.inf, np.nan)  # elsewhere nothing is forecast, and there is nothing to be seen
    garments = last.drop_duplicates("window").set_index("window")["garment"]
    ranked = ours[ours > config.tolerance].sort_values(ascending=False, kind="stable")
    # The farthest of each garment.
    chosen = ranked[~garments[ranked.index].duplicated().to_numpy()].index[:MOST_FAILURES]
    if not len(chosen):
        return []
    batch = default_collate([windows[row] for row in chosen])
    names = [name for name in ("ours", "pointnet", "carry", "seqph") if name in forecasters]
    with torch.inference_mode():
        forecasts = {name: forecasters[name][0](batch)[:, step - 1] for name in names}
    failures = []
    away = (100 * distances[names]).round(1).replace(np.inf, None)
    for place, row in enumerate(chosen):
        failure = {"episode": int(windows.index[row, 0]), "frame": int(windows.index[row, 1]), "step": step}
        failure |= {"garment": str(garments[row]), "hull_distance_cm": away.loc[row].to_dict()}
        failures.append(failure | {"forecasts": {name: loops_of(part[place]) for name, part in forecasts.items()}})
    return failures


def loops_of(states: StateTensors) -> list[dict[str, Any]]:
    """Return the loops of one state, the longest-lived and likeliest first."""
    presence = states.presence.sigmoid()
    lifetime = states.death - states.birth
    loops = []
    for slot in torch.argsort(-lifetime * presence).tolist():
        if lifetime[slot] > 0:
            mean = states.mean[slot].double().numpy().round(4).tolist()
            triangles = states.triangles[slot, :2].double().numpy().round(4).tolist()
            likely = round(float(presence[slot]), 3)
            loops.append({"slot": slot, "presence": likely, "mean": mean, "triangles": triangles})
    return loops


def save_clips(failures: Sequence[Mapping[str, Any]], dataset: Dataset, folder: Path) -> None:
    """Save the last frame that was seen and the frame that was forecast, as episodes of two frames."""
    for number, failure in enumerate(failures):
        episode = dataset[failure["episode"]]
        frames = [failure["frame"], failure["frame"] + failure["step"]]
        arrays = {
            name: getattr(episode, name)[frames] for name in ("points", "observed", "actions", "grippers", "held")
        }
        note = {key: value for key, value in failure.items() if key != "forecasts"}
        clip = replace(episode, **arrays, dt=episode.dt * failure["step"], observation=note)
        save_episode(folder / f"forecast_{number}.npz", clip)


def run(name: str, description: str) -> None:
    """Run the evaluation that a file beside this one describes, from the command line."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--config", type=Path, default=ROOT / "book" / "experiments" / f"{name}.json")
    parser.add_argument("--out", type=Path, default=ROOT / "book" / "results" / f"{name}.json")
    parser.add_argument("--only", nargs="*", default=[], metavar="CONDITION", help="measure these, and keep the others")
    parser.add_argument("--clips", type=Path, help="folder for the frames of failures, to be looked at")
    options = parser.parse_args()
    torch.set_num_threads(min(2, torch.get_num_threads()))
    config = load_evaluation(options.config)
    config = replace(config, commands=[*config.commands, " ".join(["python", *sys.argv])])
    results = evaluate_forecasts(config, options.config.parent, options.out, only=options.only, clips=options.clips)
    for name, found in results["conditions"].items():
        means = {model: cells["mean"]["mean"] for model, cells in found["hull_accuracy"].items()}
        print(name, means)
