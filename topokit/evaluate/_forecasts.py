"""Evaluate predictors on held-out windows: every number of chapter 13, from a dataset and checkpoints.

One file of results, written again after each condition; a run that was stopped goes on with the conditions that are missing.
The forecasts that went farthest astray are kept to be looked at: a table says how often, a picture why.

Source: the figure is that of Antonova et al. 2021, section 6. Taught in chapter 13.
"""

from __future__ import annotations

import dataclasses
import os
import platform
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import default_collate
from tqdm import tqdm

import topokit
from topokit.data import Dataset
from topokit.io import save_episode
from topokit.models import StateTensors

from ._accuracy import COLUMNS, measure_forecasts
from ._conditions import Condition, EvaluationConfig, PreparedCondition, kinds_of, prepare_condition, true_curves
from ._forecasters import horizons_of, steps_of
from ._results import KIND, read_results, write_results
from ._summary import Samples, summarise

BATCH = 64
MOST_FAILURES = 6


def evaluate_forecasts(
    config: EvaluationConfig,
    folder: str | Path = ".",
    out: str | Path | None = None,
    *,
    progress: bool = False,
    command: str = "",
    clips: str | Path | None = None,
) -> dict[str, Any]:
    """Evaluate all models under all conditions; return what is in the file.

    Parameters
    ----------
    config : EvaluationConfig
    folder : path
        What the paths of `config` are relative to.
    out : path, optional
        File for the results. Conditions that are in it already, made from the same files by the same code, are not made again.
    progress : bool
        Say on stderr what is done, with a bar on a terminal.
    command : str
        What made the file, for its readers.
    clips : path, optional
        Folder for the frames of the failures that the results list, of the condition with most garments.
    """
    folder, results = Path(folder), _empty(config, command)
    done = read_results(out)["conditions"] if out is not None and Path(out).is_file() else {}
    tables = results["conditions"]
    for condition in config.conditions:
        prepared = prepare_condition(config, condition, folder)
        known = done.get(condition.name)
        if known is None or known["made_from"] != prepared.entries["made_from"]:
            samples = _measured(config, condition, prepared, progress)
            known = _table(config, prepared, samples, condition is config.conditions[0])
        tables[condition.name] = known
        results["hull_accuracy"] = tables[config.conditions[0].name]["hull_accuracy"]
        results["complete"] = len(tables) == len(config.conditions)
        if out is not None:
            write_results(out, results)
    if clips is not None:
        chosen = max(config.conditions, key=lambda condition: len(tables[condition.name]["failures"]))
        dataset = Dataset(folder / (chosen.dataset or config.dataset))
        _save_clips(tables[chosen.name]["failures"], dataset, Path(clips))
    return results


def _table(config: EvaluationConfig, prepared: PreparedCondition, samples: Samples, thorough: bool) -> dict[str, Any]:
    spoilt = prepared.observed is not prepared.clean  # no dataset holds spoilt clouds
    failures = [] if spoilt or "ours" not in samples.columns else _failures(prepared, samples, config)
    return {**prepared.entries, **summarise(samples, config, thorough), "failures": failures}


def _measured(config: EvaluationConfig, condition: Condition, prepared: PreparedCondition, progress: bool) -> Samples:
    steps, fine = steps_of(config.shape.horizon), horizons_of(config.shape.horizon)
    clean, observed = prepared.clean, prepared.observed
    parts: dict[str, list[Any]] = {name: [[] for _ in found] for name, found in prepared.forecasters.items()}
    total = len(clean) * sum(map(len, parts.values()))
    if progress:
        print(f"{condition.name}: {len(clean)} windows, {total} forecasts", file=sys.stderr)
    bar = tqdm(total=total, unit="forecast", desc=condition.name, disable=None if progress else True, leave=False)
    with bar, torch.inference_mode():
        for number, start in enumerate(range(0, len(clean), BATCH)):
            rows = range(start, min(start + BATCH, len(clean)))
            labelled, window = (default_collate([windows[i] for i in rows]) for windows in (clean, observed))
            truth = true_curves(clean, rows, steps)
            target, past = StateTensors.from_labels(labelled), StateTensors.from_past(labelled)[:, -1:]
            for name, found in prepared.forecasters.items():
                for forecaster, part in zip(found, parts[name], strict=True):
                    rng = np.random.default_rng((config.seed, number))  # the same points of the openings for all
                    part.append(measure_forecasts(forecaster(window), target, past, truth, steps, fine, rng))
                    bar.update(len(rows))
    columns = {
        name: {key: np.array([np.concatenate([some[key] for some in part]) for part in seeds]) for key in COLUMNS}
        for name, seeds in parts.items()
    }
    return Samples(columns, clean.index[:, 0], kinds_of(clean, "garment"), kinds_of(clean, "target"))


def _empty(config: EvaluationConfig, command: str) -> dict[str, Any]:
    return {
        "kind": KIND,
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


def _failures(prepared: PreparedCondition, samples: Samples, config: EvaluationConfig) -> list[dict[str, Any]]:
    """The worst samples, with what models said about the last step: loops by lifetime times presence, metres."""
    chosen, step = _worst(samples, config.tolerance), steps_of(config.shape.horizon)[-1]
    if not chosen:
        return []
    window = default_collate([prepared.clean[row] for row in chosen])
    names = [name for name in ("ours", "pointnet", "carry", "seqph") if name in prepared.forecasters]
    with torch.inference_mode():
        forecasts = {name: prepared.forecasters[name][0](window)[:, step - 1] for name in names}
    return [
        {
            "episode": int(samples.episode[row]),
            "frame": int(prepared.clean.index[row, 1]),
            "step": step,
            "garment": str(samples.garment[row]),
            "outside_cm": {name: _cm(samples.columns[name]["outside_anyway"][0, row, -1]) for name in names},
            "forecasts": {name: _loops(states[place]) for name, states in forecasts.items()},
        }
        for place, row in enumerate(chosen)
    ]


def _worst(samples: Samples, tolerance: float) -> list[int]:
    """Of each garment the sample that our first seed puts farthest outside at the last step; the farthest first."""
    reach = samples.columns["ours"]["outside_anyway"][0, :, -1]  # elsewhere nothing is forecast, and nothing to be seen
    reach = np.where(np.isfinite(reach), reach, -1)
    ranked = np.argsort(-reach, kind="stable")
    _, first = np.unique(samples.garment[ranked], return_index=True)  # of each garment the farthest
    return [row for row in ranked[np.sort(first)].tolist() if reach[row] > tolerance][:MOST_FAILURES]


def _loops(states: StateTensors) -> list[dict[str, Any]]:
    presence, lifetime = states.presence.sigmoid(), states.death - states.birth
    return [
        {
            "slot": slot,
            "presence": round(float(presence[slot]), 3),
            "mean": _rounded(states.mean[slot]),
            "triangles": _rounded(states.triangles[slot, :2]),
        }
        for slot in torch.argsort(-lifetime * presence).tolist()
        if lifetime[slot] > 0
    ]


def _rounded(values: Tensor) -> Any:
    return np.round(values.double().numpy(), 4).tolist()


def _cm(metres: float) -> float | None:
    return round(100 * float(metres), 1) if np.isfinite(metres) else None


def _save_clips(failures: Sequence[Mapping[str, Any]], dataset: Dataset, folder: Path) -> None:
    """Save the last frame that was seen and the frame that was forecast, as episodes of two frames."""
    for number, failure in enumerate(failures):
        episode, last = dataset[failure["episode"]], failure["frame"]
        frames, names = [last, last + failure["step"]], ("points", "observed", "actions", "grippers", "held")
        arrays = {name: getattr(episode, name)[frames] for name in names}
        note = {key: value for key, value in failure.items() if key != "forecasts"}
        clip = dataclasses.replace(episode, **arrays, dt=episode.dt * failure["step"], observation=note)
        save_episode(folder / f"forecast_{number}.npz", clip)
