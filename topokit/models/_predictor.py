"""A trained model on a stream of clouds: observe, then predict under one plan or many. Forecasts are NumPy arrays."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from topokit._validate import as_points, as_reals
from topokit.mixture import LoopMixture, loop_mixture
from topokit.sampling import farthest_point_sample
from topokit.seqph import SeqPH, TopologicalState

from ._baselines import past_window
from ._checkpoint import Model, describe, load_model, save_tensors
from ._motion import Motion
from ._states import NOISE, TRIANGLES, StateTensors

# Plans in a batch: enough to read the weights seldom, few enough for activations to stay in the cache.
_PLANS_AT_ONCE = 250

Array = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class PredictedLoop:
    """A predicted loop: a `topokit.Loop` whose triangles have no vertices in a cloud."""

    slot: int  #: identity of the loop, the same over the whole forecast
    presence: float  #: probability that the loop is present
    birth: float  #: filtration value, metres
    death: float  #: filtration value, metres
    killer_shift: float  #: Hausdorff distance between the killer edges at this step and at the step before, metres
    killer_triangles: Array  #: (2, 3, 3) metres, the thick triangle first
    neighbours: Array  #: (m, 3, 3) metres, m <= 4
    killer_values: Array  #: (2,)
    neighbour_values: Array  #: (m,)
    noise: float = NOISE  #: noise of the mixture, square metres; larger where the place is less certain

    @property
    def lifetime(self) -> float:
        """Return death - birth, metres."""
        return self.death - self.birth

    @property
    def centre(self) -> Array:
        """Return the mean (3,) of the killer triangles' barycentres, which is not that of the mixture."""
        return np.asarray(self.killer_triangles.mean(axis=(0, 1)))

    def mixture(self, noise: float | None = None) -> LoopMixture:
        """Return the mixture of the loop's place (`topokit.loop_mixture`), with the forecast's noise when none is given."""
        return loop_mixture(self, self.noise if noise is None else noise)

    def as_dict(self) -> dict[str, Any]:
        """Return plain numbers and lists, for JSON."""
        return {
            "slot": self.slot,
            "birth": self.birth,
            "death": self.death,
            "lifetime": self.lifetime,
            "mean": self.mixture().mean.tolist(),
            "killer_triangles": self.killer_triangles.tolist(),
            "presence": round(self.presence, 4),
        }


@dataclass(frozen=True, eq=False)
class Forecast:
    """The predicted states of K steps and S slots under a plan; under C plans every array has a leading axis of C.

    As a sequence it has K items. Each is a tuple of the loops that are present, longest lifetime first (`PredictedLoop`).
    """

    #: (K, S, 8, 3) metres: both ends of the killer edge, the apexes of both killer triangles (the thick one first), and those of
    #: the four neighbours
    corners: Array
    neighbour_values: Array  #: (K, S, 4) filtration values of the neighbours, 0 where a neighbour is missing
    birth: Array  #: (K, S) metres
    death: Array  #: (K, S) metres
    killer_shift: Array  #: (K, S) metres
    presence: Array  #: (K, S) probability
    noise: Array  #: (K, S) noise of the mixtures, square metres

    @classmethod
    def from_states(cls, states: StateTensors) -> Forecast:
        """Return a model's output (C, K, S) as a forecast."""
        states = states.replace(presence=states.presence.sigmoid())
        return cls(*(tensor.numpy() for tensor in vars(states).values()))

    def plan(self, index: int) -> Forecast:
        """Return the forecast under one of many plans.

        Raises
        ------
        IndexError
            When there is only one plan.
        """
        if self.birth.ndim < 3:
            raise IndexError("this is the forecast of a single plan, and has no plan to choose")
        return Forecast(*(array[index] for array in vars(self).values()))

    @property
    def lifetime(self) -> Array:
        """Return death - birth (K, S), metres."""
        return self.death - self.birth

    @property
    def triangles(self) -> Array:
        """Return the killer triangles and the neighbours, (K, S, 6, 3, 3)."""
        return self._states.triangles.numpy()

    @property
    def values(self) -> Array:
        """Return the filtration values (K, S, 6) of the triangles."""
        return self._states.values.numpy()

    @property
    def mean(self) -> Array:
        """Return the means (K, S, 3) of the mixtures."""
        return self._states.mean.numpy()

    @property
    def _states(self) -> StateTensors:
        return StateTensors(*map(torch.from_numpy, vars(self).values()))

    def __len__(self) -> int:
        return self.birth.shape[-2]

    def __getitem__(self, step: int) -> tuple[PredictedLoop, ...]:
        """Return the loops of a step that are more likely present than not, longest lifetime first; step 0 is the next frame."""
        if self.birth.ndim > 2:
            raise TypeError("this is a forecast of many plans: choose one first, forecast.plan(i)[step]")
        if isinstance(step, slice):
            raise TypeError("a forecast has no slices: give one step, forecast[step]")
        longest = np.argsort(-self.lifetime[step], kind="stable")
        return tuple(self._loop(step, int(slot)) for slot in longest if self.presence[step, slot] > 0.5)

    def _loop(self, step: int, slot: int) -> PredictedLoop:
        triangles = self.corners[step, slot][np.array(TRIANGLES)]  # (6, 3, 3)
        values = self.neighbour_values[step, slot]
        present = values > 0
        return PredictedLoop(
            slot=slot,
            presence=float(self.presence[step, slot]),
            birth=float(self.birth[step, slot]),
            death=float(self.death[step, slot]),
            killer_shift=float(self.killer_shift[step, slot]),
            killer_triangles=triangles[:2],
            neighbours=triangles[2:][present],
            killer_values=np.repeat(self.death[step, slot], 2),
            neighbour_values=values[present],
            noise=float(self.noise[step, slot]),
        )


class Predictor:
    """Forecasts of the topological state from a stream of point clouds.

    Parameters
    ----------
    model : PredictiveModel
        For a `Motion` use `MotionPredictor`, or `Predictor.load`, which chooses.
    description : mapping, optional
        The description in the model's checkpoint.
    """

    def __init__(self, model: Model, description: Mapping[str, Any] | None = None) -> None:
        if isinstance(model, Motion) and type(self) is Predictor:
            raise TypeError("a Motion needs a MotionPredictor; Predictor.load chooses")
        self.model: Any = model.eval()
        self.description = dict(description or {})
        self.reset()

    @classmethod
    def load(cls, path: str | Path) -> Predictor:
        """Read a checkpoint; a model of motion gives a `MotionPredictor`."""
        from ._motion_predictor import MotionPredictor

        model, description = load_model(path)
        if isinstance(model, Motion):
            return MotionPredictor(model, description)
        return cls(model, description)

    def save(self, path: str | Path) -> None:
        """Write the model and its description to a checkpoint (.safetensors)."""
        save_tensors(path, self.model.state_dict(), self.description | describe(self.model))

    def reset(self) -> None:
        """Forget everything observed."""
        self._kept: deque[dict[str, Tensor]] = deque(maxlen=self.model.shape.history)
        self._states: deque[TopologicalState] = deque(maxlen=self.model.shape.history)
        self._tracker = SeqPH() if self.model.tracked else None
        self._context: dict[str, Tensor] | None = None

    @torch.inference_mode()
    def observe(
        self, points: ArrayLike, grippers: ArrayLike | None = None, held: bool = True, target: ArrayLike | None = None
    ) -> None:
        """Take in the next frame, and encode it.

        Parameters
        ----------
        points : (n, 3) array_like
            Metres.
        grippers : (2, 3) array_like, optional
            Places of the grippers, metres. A model whose input is clouds alone does not need them.
        held : bool
            Whether the grippers hold the garment.
        target : (L, 3) array_like, optional
            Centre line of the target, from the floor to its tip, for a `MotionPredictor`; the last one when not given.

        Raises
        ------
        ValueError
            When an array has another shape or holds a value that is not finite, or the model needs the grippers. The frame is
            then not taken in.
        """
        self._take(as_cloud(points), grippers, bool(held), target)

    def _take(self, cloud: NDArray[np.float64], grippers: Any, held: bool, target: Any) -> None:
        """Encode a frame and keep it."""
        # Choose as many points as the model reads; repeat points when there are fewer.
        n = self.model.shape.points
        points = cloud
        if len(cloud) > n:
            points = cloud[farthest_point_sample(cloud, n, None)[0]]
        points = np.resize(points, (1, n, 3)).astype(np.float32)
        frame = {"clouds": torch.from_numpy(points)}
        if "grippers" in self.model.inputs:
            place = as_grippers(grippers)
            frame |= {"grippers": torch.from_numpy(place).float()[None], "held": torch.tensor([held])}
        if self._tracker is not None:
            self._states.append(self._tracker.update(cloud))
        self._kept.append(self.model.encode_frames({name: frame[name] for name in self.model.inputs}))
        self._context = None

    @torch.inference_mode()
    def predict(self, actions: ArrayLike, held: ArrayLike | None = None) -> Forecast:
        """Forecast the states of the next frames; the first observed frame also stands for the frames before it.

        Parameters
        ----------
        actions : (60, 2, 3) or (C, 60, 2, 3) array_like
            Planned places of the two grippers at each of the next frames, metres; or C such plans.
        held : (60,) or (C, 60) array_like of bool, optional
            Whether the grippers hold the garment at each of these frames; when not given, at all of them.
        """
        chunks = self._plans(actions, held)
        context = self._encoded()
        parts = [vars(self.model.decode(context, *chunk)).values() for chunk in chunks]
        states = StateTensors(*(torch.cat(part) for part in zip(*parts, strict=True)))
        forecast = Forecast.from_states(states)
        if np.ndim(actions) == 4:
            return forecast
        return forecast.plan(0)

    def _encoded(self) -> dict[str, Tensor]:
        """Return the encoded history for `decode`; it is computed once, for all plans until the next frame."""
        if not self._kept:
            raise ValueError("no frame has been observed yet: call observe first")
        if self._context is None:
            # Take the newest frame first; the oldest one also stands for the frames before it.
            back = [max(len(self._kept) - 1 - frames, 0) for frames in range(self.model.shape.history)]
            kept = {name: torch.stack([self._kept[i][name] for i in back], dim=1) for name in self._kept[0]}
            if self._tracker is not None:
                past = past_window(self._states, self.model.shape.slots)
                kept |= {name: tensor[:, back] for name, tensor in past.items()}
            self._context = self.model.gather(kept)
        return self._context

    def _plans(self, actions: ArrayLike, held: ArrayLike | None) -> list[tuple[Tensor, Tensor]]:
        """Return plans (C, 60, 2, 3) and holds (C, 60) in batches."""
        steps = self.model.shape.horizon
        with np.errstate(over="ignore"):  # what is infinite in 32 bits is refused below
            plans = as_reals(actions, "actions").astype(np.float32)
        if plans.ndim not in (3, 4) or plans.shape[-3:] != (steps, 2, 3) or not len(plans):
            raise ValueError(f"actions must be ({steps}, 2, 3) or (plans, {steps}, 2, 3), not {plans.shape}")
        if not np.isfinite(plans).all():
            raise ValueError("actions must be finite, but hold NaN or infinite coordinates")
        holds = np.ones(plans.shape[:-2], dtype=bool)
        if held is not None:
            holds = as_reals(held, "held").astype(bool)
        if holds.shape != plans.shape[:-2]:
            raise ValueError(f"held must have the shape {plans.shape[:-2]}, as the actions do, not {holds.shape}")
        some_plans = torch.from_numpy(plans).reshape(-1, steps, 2, 3).split(_PLANS_AT_ONCE)
        some_holds = torch.from_numpy(holds).reshape(-1, steps).split(_PLANS_AT_ONCE)
        return list(zip(some_plans, some_holds, strict=True))


def as_cloud(points: ArrayLike) -> NDArray[np.float64]:
    """Return a cloud (n, 3), checked and copied."""
    cloud = as_points(points, copy=True)
    if cloud.shape[1] != 3 or not len(cloud):
        raise ValueError(f"points must be an (n, 3) array of at least one point, not of shape {cloud.shape}")
    return cloud


def as_grippers(grippers: ArrayLike | None) -> NDArray[np.float64]:
    """Return the places (2, 3) of the grippers, checked and copied."""
    if grippers is None:
        raise ValueError("this model needs the places of the grippers: observe(points, grippers)")
    if np.shape(grippers) != (2, 3):
        raise ValueError(f"grippers must be a (2, 3) array, not of shape {np.shape(grippers)}: give those of one frame")
    return as_points(grippers, "grippers", copy=True)
