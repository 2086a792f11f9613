"""A trained model on a stream of clouds: observe, then predict under one plan or many; and what it says, all of it in NumPy."""

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

_PLANS_AT_ONCE = 250  # so that weights are read seldom, and what lies between layers stays in the cache

Array = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class PredictedLoop:
    """A loop that is forecast. As `topokit.Loop`, but its triangles have no vertices in a cloud."""

    slot: int  #: its identity: the same over the whole forecast
    presence: float  #: probability that it is there
    birth: float  #: filtration value, metres
    death: float  #: filtration value, metres
    killer_shift: float  #: Hausdorff distance between its killer edge and that of the step before, metres
    killer_triangles: Array  #: (2, 3, 3) metres, the thick one first
    neighbours: Array  #: (m, 3, 3) metres, m <= 4
    killer_values: Array  #: (2,)
    neighbour_values: Array  #: (m,)
    noise: float = NOISE  #: of its mixture, square metres: more, the less sure the forecast is of the place

    @property
    def lifetime(self) -> float:
        """death - birth."""
        return self.death - self.birth

    @property
    def centre(self) -> Array:
        """(3,) mean of the killer triangles' barycentres, as of a `topokit.Loop`; `mixture().mean` is another place."""
        return np.asarray(self.killer_triangles.mean(axis=(0, 1)))

    def mixture(self, noise: float | None = None) -> LoopMixture:
        """Where the loop is, as `topokit.loop_mixture` says, with the forecast's own noise when none is given."""
        return loop_mixture(self, self.noise if noise is None else noise)

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and lists, for JSON."""
        numbers = {name: getattr(self, name) for name in ("slot", "birth", "death", "lifetime")}
        places = {"mean": self.mixture().mean.tolist(), "killer_triangles": self.killer_triangles.tolist()}
        return numbers | places | {"presence": round(self.presence, 4)}


@dataclass(frozen=True, eq=False)
class Forecast:
    """The states of K steps, of S slots, under one plan, or under C plans: then every array has a leading axis of C.

    As a sequence it has K items, each a tuple of `PredictedLoop`: those that are there, longest lifetime first.
    """

    #: (K, S, 8, 3) metres: the killer edge's ends, the apexes of the thick and the other killer triangle, of the neighbours
    corners: Array
    neighbour_values: Array  #: (K, S, 4) filtration values of the neighbours, 0 where there is none
    birth: Array  #: (K, S) metres
    death: Array  #: (K, S) metres
    killer_shift: Array  #: (K, S) metres
    presence: Array  #: (K, S) probability
    noise: Array  #: (K, S) of the mixtures, square metres

    @classmethod
    def from_states(cls, states: StateTensors) -> Forecast:
        """Of a model's output (C, K, S), on the CPU."""
        return cls(*(part.numpy() for part in vars(states.replace(presence=states.presence.sigmoid())).values()))

    def plan(self, index: int) -> Forecast:
        """The forecast under one of many plans.

        Raises
        ------
        IndexError
            When there is but one.
        """
        if self.birth.ndim < 3:
            raise IndexError("this is the forecast of a single plan")
        return Forecast(*(part[index] for part in vars(self).values()))

    @property
    def lifetime(self) -> Array:
        """(K, S)."""
        return self.death - self.birth

    @property
    def triangles(self) -> Array:
        """(K, S, 6, 3, 3) the killer triangles and the neighbours."""
        return self._states.triangles.numpy()

    @property
    def values(self) -> Array:
        """(K, S, 6) filtration values of the triangles."""
        return self._states.values.numpy()

    @property
    def mean(self) -> Array:
        """(K, S, 3) means of the mixtures."""
        return self._states.mean.numpy()

    @property
    def _states(self) -> StateTensors:
        return StateTensors(*map(torch.from_numpy, vars(self).values()))

    def __len__(self) -> int:
        return self.birth.shape[-2]

    def __getitem__(self, step: int) -> tuple[PredictedLoop, ...]:
        """Return the loops of a step, 0 for the next frame: those more likely there than not, longest lifetime first."""
        if self.birth.ndim > 2:
            raise IndexError("this is a forecast of many plans: choose one first, forecast.plan(i)[step]")
        longest = np.argsort(-self.lifetime[step], kind="stable")
        return tuple(self._loop(step, int(slot)) for slot in longest if self.presence[step, slot] > 0.5)

    def _loop(self, step: int, slot: int) -> PredictedLoop:
        triangles = self.corners[step, slot][np.array(TRIANGLES)]
        near, death = self.neighbour_values[step, slot], self.death[step, slot]
        numbers = ("presence", "birth", "death", "killer_shift", "noise")
        return PredictedLoop(
            slot=slot,
            **{name: float(getattr(self, name)[step, slot]) for name in numbers},
            killer_triangles=triangles[:2],
            neighbours=triangles[2:][near > 0],
            killer_values=np.repeat(death, 2),
            neighbour_values=near[near > 0],
        )


class Predictor:
    """Forecasts of the topological state from a stream of point clouds.

    Parameters
    ----------
    model : PredictiveModel or Motion
    description : mapping, optional
        What a checkpoint says of it.
    """

    def __init__(self, model: Model, description: Mapping[str, Any] | None = None) -> None:
        self.model: Any = model.eval()
        self.description = dict(description or {})
        self.reset()

    @classmethod
    def load(cls, path: str | Path) -> Predictor:
        """Read a checkpoint; of a model of motion it is a `MotionPredictor`."""
        from ._motion_predictor import MotionPredictor

        model, description = load_model(path)
        return (MotionPredictor if isinstance(model, Motion) else cls)(model, description)

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
            Metres. A model that reads clouds alone does without.
        held : bool
            Whether they hold the garment.
        target : (L, 3) array_like, optional
            Centre line of the target, from the floor to its tip, which a `MotionPredictor` looks at; the last one when not given.

        Raises
        ------
        ValueError
            When an array has another shape or holds a value that is not finite, or the model needs the grippers.
        """
        self._take(as_cloud(points), grippers, bool(held), target)

    def _take(self, cloud: NDArray[np.float64], grippers: Any, held: bool, target: Any) -> None:
        n = self.model.shape.points
        chosen = cloud[farthest_point_sample(cloud, n, None)[0]] if len(cloud) > n else cloud
        repeated = np.resize(chosen, (1, n, 3)).astype(np.float32)  # where there are few
        frame = {"clouds": torch.from_numpy(repeated)}
        if "grippers" in self.model.inputs:
            place = as_grippers(grippers)
            frame |= {"grippers": torch.from_numpy(place).float()[None], "held": torch.tensor([held])}
        if self._tracker is not None:
            self._states.append(self._tracker.update(cloud))
        self._kept.append(self.model.encode_frames({name: frame[name] for name in self.model.inputs}))
        self._context = None

    @torch.inference_mode()
    def predict(self, actions: ArrayLike, held: ArrayLike | None = None) -> Forecast:
        """Forecast the states of the next frames; the first frame observed stands in for those before it.

        Parameters
        ----------
        actions : (60, 2, 3) or (C, 60, 2, 3) array_like
            Where the two grippers are told to be at each of the next frames, metres; or C such plans.
        held : (60,) or (C, 60) array_like of bool, optional
            Whether they hold the garment then; throughout, when not given.
        """
        chunks = self._plans(actions, held)
        context = self._encoded()
        parts = (vars(self.model.decode(context, *chunk)).values() for chunk in chunks)
        forecast = Forecast.from_states(StateTensors(*map(torch.cat, zip(*parts, strict=True))))
        return forecast if np.ndim(actions) == 4 else forecast.plan(0)

    def _encoded(self) -> dict[str, Tensor]:
        """The history as `decode` needs it; made once for all plans until the next frame."""
        if not self._kept:
            raise ValueError("nothing was observed yet: call observe(points) first")
        if self._context is None:
            back = [max(len(self._kept) - 1 - frames, 0) for frames in range(self.model.shape.history)]
            kept = {name: torch.stack([self._kept[i][name] for i in back], dim=1) for name in self._kept[0]}
            if self._tracker is not None:
                past = past_window(self._states, self.model.shape.slots)
                kept |= {name: part[:, back] for name, part in past.items()}
            self._context = self.model.gather(kept)
        return self._context

    def _plans(self, actions: ArrayLike, held: ArrayLike | None) -> list[tuple[Tensor, Tensor]]:
        """Plans (C, 60, 2, 3) and holds (C, 60), some at a time."""
        steps = self.model.shape.horizon
        with np.errstate(over="ignore"):  # infinite here, and said so
            plans = as_reals(actions, "actions").astype(np.float32)
        if plans.ndim not in (3, 4) or plans.shape[-3:] != (steps, 2, 3) or not len(plans):
            raise ValueError(f"actions must be ({steps}, 2, 3) or (plans, {steps}, 2, 3), not {plans.shape}")
        if not np.isfinite(plans).all():
            raise ValueError("actions hold a NaN or infinite coordinate")
        holds = np.ones(plans.shape[:-2], dtype=bool) if held is None else as_reals(held, "held").astype(bool)
        if holds.shape != plans.shape[:-2]:
            raise ValueError(f"held must be {plans.shape[:-2]}, as the actions, not {holds.shape}")
        parts = torch.from_numpy(plans).reshape(-1, steps, 2, 3), torch.from_numpy(holds).reshape(-1, steps)
        return list(zip(*(part.split(_PLANS_AT_ONCE) for part in parts), strict=True))


def as_cloud(points: ArrayLike) -> NDArray[np.float64]:
    """A cloud that can be looked at, and kept."""
    cloud = as_points(points, copy=True)
    if cloud.shape[1] != 3 or not len(cloud):
        raise ValueError(f"points must be an (n, 3) array of one point at least, not of shape {cloud.shape}")
    return cloud


def as_grippers(grippers: ArrayLike | None) -> NDArray[np.float64]:
    """Where the two grippers are, told to a model that needs to know."""
    if grippers is None:
        raise ValueError("this model needs to know where the grippers are: observe(points, grippers)")
    place = as_points(grippers, "grippers", copy=True)
    if place.shape != (2, 3):
        raise ValueError(f"grippers must be a (2, 3) array, not of shape {place.shape}")
    return place
