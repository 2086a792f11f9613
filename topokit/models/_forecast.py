"""What a predictor says: the loops of all steps, for one plan or for many, and their mixtures. All of it is NumPy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from topokit.mixture import LoopMixture, loop_mixture

from ._states import TRIANGLES, States

Array = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class PredictedLoop:
    """A loop that is forecast. As `topokit.Loop`, but its triangles have no vertices in a cloud.

    Attributes
    ----------
    slot : int
        Its identity: the same over the whole forecast.
    presence : float
        Probability that it is there.
    birth, death : float
        Filtration values, metres.
    step : float
        Hausdorff distance between its killer edge and that of the step before, metres.
    killer_triangles, neighbours : (2, 3, 3) and (m, 3, 3)
        Metres; the thick one first. m <= 4.
    killer_values, neighbour_values : (2,) and (m,)
    """

    slot: int
    presence: float
    birth: float
    death: float
    step: float
    killer_triangles: Array
    neighbours: Array
    killer_values: Array
    neighbour_values: Array

    @property
    def lifetime(self) -> float:
        """death - birth."""
        return self.death - self.birth

    @property
    def centre(self) -> Array:
        """(3,) mean of the barycentres of the two killer triangles, as of a `topokit.Loop`; `mixture().mean` is another place."""
        return np.asarray(self.killer_triangles.mean(axis=(0, 1)))

    def mixture(self, noise: float = 1e-4) -> LoopMixture:
        """Where the loop is, as `topokit.loop_mixture` says."""
        return loop_mixture(self, noise)


@dataclass(frozen=True, eq=False)
class Forecast:
    """The states of K steps, of S slots, under one plan, or under C plans: then every array has a leading axis of C.

    As a sequence it has K items, each a tuple of `PredictedLoop`: those that are there, longest lifetime first.

    Attributes
    ----------
    corners : (K, S, 8, 3)
        Metres: the killer edge's ends, the apexes of the thick and the other killer triangle, those of the neighbours.
    neighbour_values : (K, S, 4)
        Their filtration values.
    birth, death, step, presence : (K, S)
        `presence` is a probability.
    """

    corners: Array
    neighbour_values: Array
    birth: Array
    death: Array
    step: Array
    presence: Array

    @classmethod
    def from_states(cls, states: States) -> Forecast:
        """Of a model's output (C, K, S)."""
        states = states.replace(presence=states.presence.sigmoid())
        return cls(*(part.cpu().numpy() for part in vars(states).values()))

    @property
    def plans(self) -> int | None:
        """C, or None of a single plan."""
        return len(self.birth) if self.birth.ndim == 3 else None

    def plan(self, index: int) -> Forecast:
        """The forecast under one of the plans.

        Raises
        ------
        IndexError
            When there is but one.
        """
        if self.plans is None:
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
    def _states(self) -> States:
        return States(*map(torch.from_numpy, vars(self).values()))

    def __len__(self) -> int:
        return self.birth.shape[-2]

    def __getitem__(self, step: int) -> tuple[PredictedLoop, ...]:
        """Return the loops of a step, 0 for the next frame: those more likely there than not, longest lifetime first."""
        if self.plans is not None:
            raise IndexError("this is a forecast of many plans: choose one first, forecast.plan(i)[step]")
        longest = np.argsort(-self.lifetime[step], kind="stable")
        return tuple(self.loop(step, int(slot)) for slot in longest if self.presence[step, slot] > 0.5)

    def loop(self, step: int, slot: int) -> PredictedLoop:
        """Return one loop of a single plan, there or not.

        Parameters
        ----------
        step, slot : int
        """
        triangles = self.corners[step, slot][np.array(TRIANGLES)]
        near, death = self.neighbour_values[step, slot], self.death[step, slot]
        return PredictedLoop(
            slot=slot,
            presence=float(self.presence[step, slot]),
            birth=float(self.birth[step, slot]),
            death=float(death),
            step=float(self.step[step, slot]),
            killer_triangles=triangles[:2],
            neighbours=triangles[2:][near > 0],
            killer_values=np.repeat(death, 2),
            neighbour_values=near[near > 0],
        )

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and lists, for JSON: of every step the loops that are there."""
        return {"steps": [[_as_dict(loop) for loop in self[step]] for step in range(len(self))]}


def _as_dict(loop: PredictedLoop) -> dict[str, Any]:
    return {
        "slot": loop.slot,
        "presence": round(loop.presence, 4),
        "birth": loop.birth,
        "death": loop.death,
        "lifetime": loop.lifetime,
        "mean": loop.mixture().mean.tolist(),
        "killer_triangles": loop.killer_triangles.tolist(),
    }
