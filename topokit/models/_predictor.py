"""A trained model on a stream of clouds: observe, then predict under one plan or many."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from topokit._validate import as_points
from topokit.sampling import farthest_point_sample
from topokit.seqph import RECOMMENDED, SeqPH
from topokit.state import TopologicalState

from ._base import PredictiveModel
from ._baselines import past_window
from ._checkpoint import load_model
from ._forecast import Forecast
from ._states import States


class Predictor:
    """Forecasts of the topological state from a stream of point clouds.

    Parameters
    ----------
    model : PredictiveModel
    description : mapping, optional
        What a checkpoint says of it.

    Examples
    --------
    Forecast a stream under the plan to stand still::

        predictor = Predictor.load("data_small/checkpoints/loopcast.safetensors")
        for cloud, grippers in stream:
            predictor.observe(cloud, grippers)
        forecast = predictor.predict(np.repeat(grippers[None], 60, axis=0))
        forecast[59][0].mixture().mean
    """

    def __init__(self, model: PredictiveModel, description: Mapping[str, Any] | None = None) -> None:
        self.model, self.description = model.eval(), dict(description or {})
        self.reset()

    @classmethod
    def load(cls, path: str | Path) -> Predictor:
        """Read a checkpoint.

        Raises
        ------
        FileNotFoundError, FormatError
            When it is missing, damaged, no checkpoint, or for other shapes; the message says which.
        """
        return cls(*load_model(path))

    def reset(self) -> None:
        """Forget everything observed."""
        self._kept: deque[dict[str, Tensor]] = deque(maxlen=self.model.shape.history)
        self._tracked: deque[tuple[TopologicalState, Tensor]] = deque(maxlen=self.model.shape.history)
        self._tracker = SeqPH(**RECOMMENDED) if self.model.tracked else None
        self._context: dict[str, Tensor] | None = None

    @torch.inference_mode()
    def observe(self, points: ArrayLike, grippers: ArrayLike | None = None, held: bool = True) -> None:
        """Take in the next frame, and encode it.

        Parameters
        ----------
        points : (n, 3) array_like
            Any number of points, metres.
        grippers : (2, 3) array_like, optional
            Where the grippers are. A model that reads clouds alone does without.
        held : bool
            Whether they hold the garment.

        Raises
        ------
        ValueError
            When an array has another shape or holds a value that is not finite, or the model needs the grippers.
        """
        cloud = as_points(points)
        if cloud.shape[1] != 3 or not len(cloud):
            raise ValueError(f"points must be an (n, 3) array of one point at least, not of shape {cloud.shape}")
        frame = {"clouds": torch.from_numpy(_spread(cloud, self.model.shape.points))[None]}
        if "grippers" in self.model.inputs:
            if grippers is None:
                raise ValueError("this model needs to know where the grippers are: observe(points, grippers)")
            place = as_points(grippers, "grippers")
            if place.shape != (2, 3):
                raise ValueError(f"grippers must be a (2, 3) array, not of shape {place.shape}")
            frame |= {"grippers": torch.from_numpy(place).float()[None], "held": torch.tensor([bool(held)])}
        if self._tracker is not None:
            self._tracked.append((self._tracker.update(cloud), frame["grippers"]))
        self._kept.append(self.model.encode_frames({name: frame[name] for name in self.model.inputs}))
        self._context = None

    @torch.inference_mode()
    def predict(self, actions: ArrayLike, held: ArrayLike | None = None) -> Forecast:
        """Forecast the states of the next frames.

        Before `history` frames were observed, the first stands in for those before it.

        Parameters
        ----------
        actions : (60, 2, 3) or (C, 60, 2, 3) array_like
            Where the two grippers are told to be at each of the next frames, metres; or C such plans.
        held : (60,) or (C, 60) array_like of bool, optional
            Whether they hold the garment then; throughout, when not given.

        Raises
        ------
        ValueError
            When nothing was observed yet, or an array has another shape or holds a value that is not finite.
        """
        plans, holds = self._plans(actions, held)
        context = self._encoded()
        chunks = zip(*(part.split(self.model.plans_at_once) for part in (plans, holds)), strict=True)
        parts = [vars(self.model.decode(context, *chunk)) for chunk in chunks]
        states = {name: torch.cat([part[name] for part in parts]) for name in parts[0]}
        forecast = Forecast.from_states(States(**states))
        return forecast if np.ndim(actions) == 4 else forecast.plan(0)

    def _encoded(self) -> dict[str, Tensor]:
        """The history as `decode` needs it; made once for all plans until the next frame."""
        if not self._kept:
            raise ValueError("nothing was observed yet: call observe(points) first")
        if self._context is None:
            back = [max(len(self._kept) - 1 - frames, 0) for frames in range(self.model.shape.history)]
            look = [back[frames] for frames in self.model.frames]
            kept = {name: torch.stack([self._kept[i][name] for i in look], dim=1) for name in self._kept[0]}
            if self._tracker is not None:
                states, grippers = zip(*self._tracked, strict=True)
                past = past_window(states, self.model.shape.slots) | {"past_grippers": torch.stack(grippers, dim=1)}
                kept |= {name: part[:, back] for name, part in past.items()}
            self._context = self.model.gather(kept)
        return self._context

    def _plans(self, actions: ArrayLike, held: ArrayLike | None) -> tuple[Tensor, Tensor]:
        steps = self.model.shape.horizon
        plans = np.asarray(actions, dtype=np.float32)
        if plans.ndim not in (3, 4) or plans.shape[-3:] != (steps, 2, 3) or not len(plans):
            raise ValueError(
                f"actions must be ({steps}, 2, 3) or (plans, {steps}, 2, 3) for this model, which forecasts {steps} steps; "
                f"not {plans.shape}"
            )
        if not np.isfinite(plans).all():
            raise ValueError("actions hold a NaN or infinite coordinate")
        holds = np.ones(plans.shape[:-2], dtype=bool) if held is None else np.asarray(held, dtype=bool)
        if holds.shape != plans.shape[:-2]:
            raise ValueError(f"held must be {plans.shape[:-2]}, as the actions, not {holds.shape}")
        return torch.from_numpy(plans).reshape(-1, steps, 2, 3), torch.from_numpy(holds).reshape(-1, steps)


def _spread(points: NDArray[np.float64], n: int) -> NDArray[np.float32]:
    """`n` farthest points, or all of them and then the first ones again."""
    if len(points) > n:
        points = points[farthest_point_sample(points, n)[0]]
    return np.resize(points, (n, 3)).astype(np.float32)
