"""The forecasts that went farthest astray, to be looked at: a table says how often, a picture why.

Taught in chapter 11.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import default_collate

from topokit.data import Dataset, WindowDataset
from topokit.io import save_episode
from topokit.models import States

from ._summary import Samples

MOST = 6
Model = Callable[[Mapping[str, Tensor]], States]


def far_astray(
    windows: WindowDataset, samples: Samples, models: Mapping[str, Model], tolerance: float
) -> list[dict[str, Any]]:
    """The samples that `_worst` names, with what each of the models said about the last step.

    A forecast is a list of loops by lifetime times presence, each with its `mean` and its two killer `triangles`, metres.
    """
    chosen, step = _worst(samples, tolerance), samples.steps[-1]
    if not chosen:
        return []
    window = default_collate([windows[row] for row in chosen])
    with torch.inference_mode():
        forecasts = {name: model(window)[:, step - 1] for name, model in models.items()}
    return [
        {
            "episode": int(samples.episode[row]),
            "frame": int(windows.index[row, 1]),
            "step": step,
            "garment": str(samples.garment[row]),
            "outside_cm": {name: _cm(samples.columns[name]["outside_anyway"][0, row, -1]) for name in models},
            "forecasts": {name: _loops(states[place]) for name, states in forecasts.items()},
        }
        for place, row in enumerate(chosen)
    ]


def _worst(samples: Samples, tolerance: float) -> list[int]:
    """Of each garment the sample that our first seed puts farthest outside at the last step; the farthest first.

    Loops that are said to be absent count, too: where nothing is forecast there would be nothing to be seen.
    """
    reach = samples.columns["ours"]["outside_anyway"][0, :, -1]
    reach = np.where(np.isfinite(reach), reach, -1)
    rows = [np.flatnonzero(samples.garment == garment) for garment in np.unique(samples.garment)]
    farthest = [int(some[np.argmax(reach[some])]) for some in rows]
    return sorted((row for row in farthest if reach[row] > tolerance), key=lambda row: -reach[row])[:MOST]


def save_clips(failures: Sequence[Mapping[str, Any]], dataset: Dataset, folder: Path) -> None:
    """Save the last frame that was seen and the frame that was forecast, as episodes of two frames."""
    for number, failure in enumerate(failures):
        episode, last = dataset[failure["episode"]], failure["frame"]
        frames = [last, last + failure["step"]]
        arrays = {
            name: getattr(episode, name)[frames] for name in ("points", "observed", "actions", "grippers", "held")
        }
        note = {key: value for key, value in failure.items() if key != "forecasts"}
        clip = dataclasses.replace(episode, **arrays, dt=episode.dt * failure["step"], observation=note)
        save_episode(folder / f"forecast_{number}.npz", clip)


def _loops(states: States) -> list[dict[str, Any]]:
    """All loops of one window at one step (S, ...)."""
    presence = states.presence.sigmoid()
    lifetime = states.death - states.birth
    order = [int(i) for i in torch.argsort(-lifetime * presence) if lifetime[i] > 0]
    return [
        {
            "slot": slot,
            "presence": round(float(presence[slot]), 3),
            "mean": _rounded(states.mean[slot]),
            "triangles": _rounded(states.triangles[slot, :2]),
        }
        for slot in order
    ]


def _rounded(values: Tensor) -> Any:
    return np.round(values.double().numpy(), 4).tolist()


def _cm(metres: float) -> float | None:
    return round(100 * float(metres), 1) if np.isfinite(metres) else None
