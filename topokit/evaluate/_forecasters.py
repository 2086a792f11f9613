"""Who forecasts in an evaluation, all asked alike: from a batch of windows to the states of all steps. Taught in chapter 13."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from topokit.data import WindowDataset
from topokit.models import NOISE, Forecast, MotionPredictor, StateTensors

Forecaster = Callable[[Mapping[str, Tensor]], StateTensors]
_TURNS = ("clouds", "grippers", "actions", "triangles", "past_triangles")


def horizons_of(horizon: int) -> tuple[int, ...]:
    """The steps of the tables: the paper's 1, 15, 30, 60, as far as the forecast goes."""
    return tuple(step for step in (1, 15, 30, 60) if step <= horizon)


def steps_of(horizon: int) -> tuple[int, ...]:
    """The steps of the curves: every fifth, and the first."""
    return tuple(sorted({1, *range(5, horizon + 1, 5), *horizons_of(horizon)}))


def of_windows(model: torch.nn.Module) -> Forecaster:
    """A model that looks at the windows themselves."""
    return lambda window: model(window).map(Tensor.float)


def of_stream(predictor: MotionPredictor, windows: WindowDataset) -> Forecaster:
    """A predictor that is shown the frames of each window one by one, as whole as the tracker of its labels sees them.

    It is asked through `turned`, which says how the scene stands. Its loops are sought anew in the moved cloud, at the steps
    that are measured.
    """
    seen = lru_cache(8)(windows.seen)
    steps = steps_of(windows.horizon)

    def forecast(window: Mapping[str, Tensor]) -> StateTensors:
        found = []
        for i, (number, frame) in enumerate(zip(window["episode"].tolist(), window["frame"].tolist(), strict=True)):
            clouds, target = seen(number)
            turn = window["turn"].double().numpy()
            predictor.reset()
            for k in range(windows.history):
                cloud, hands = clouds[frame - windows.history + 1 + k] @ turn.T, window["grippers"][i, k]
                predictor.observe(cloud, hands, bool(window["held"][i, k]), target @ turn.T)
            found.append(predictor.predict(window["actions"][i], window["actions_held"][i], exact=steps))
        return _stacked(found, windows.slots)

    return forecast


def turned(forecaster: Forecaster, degrees: float) -> Forecaster:
    """One that is shown scene and plan turned about the vertical, and whose answer is turned back."""
    angle = np.radians(degrees)
    axes = [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    turn = torch.tensor(axes, dtype=torch.float32)

    def forecast(window: Mapping[str, Tensor]) -> StateTensors:
        states = forecaster({**window, **{name: window[name] @ turn.T for name in _TURNS}, "turn": turn})
        return states.replace(corners=states.corners @ turn)

    return forecast


def _stacked(forecasts: list[Forecast], slots: int) -> StateTensors:
    """Of B forecasts, with as many slots as the windows have: a slot that a forecast lacks is empty."""

    def stack(name: str, empty: float) -> Tensor:
        parts: list[NDArray[np.float32]] = [getattr(one, name)[:, :slots] for one in forecasts]
        more = [[(0, 0), (0, slots - part.shape[1]), *[(0, 0)] * (part.ndim - 2)] for part in parts]
        padded = [np.pad(part, width, constant_values=empty) for part, width in zip(parts, more, strict=True)]
        return torch.from_numpy(np.stack(padded)).float()

    parts = {part.name: stack(part.name, NOISE if part.name == "noise" else 0.0) for part in fields(StateTensors)}
    return StateTensors(**parts | {"presence": parts["presence"].double().logit(1e-6).float()})
