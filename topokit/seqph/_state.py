"""The topological state of a scene: what the paper calls X_t.

A state is a list of loops; a loop is what `topokit.rips` found (birth, death, killer edge, killer triangles, neighbours)
together with the coordinates of those simplices and the identity that `topokit.seqph` gave it.

Source: Antonova et al. 2021, section 4 (the zeta_l of Algorithm 1). Taught in chapter 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topokit._validate import own_arrays

OKABE_ITO = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # of identities
ClosedCurve = tuple[NDArray[np.int64], NDArray[np.float64]]  # vertex ids of a closed walk, and their places


@dataclass(frozen=True, eq=False)
class Loop:
    """One loop of one frame. Lengths are in the unit of the points (metres in topokit's own data)."""

    id: int  #: identity through time: the same loop keeps it from frame to frame; never reused
    birth: float  #: filtration value (half the length) of the edge that creates the loop
    death: float  #: filtration value of the edge that ends it
    birth_edge: NDArray[np.int64]  #: (2,) vertex ids in the frame's cloud
    killer_edge: NDArray[np.int64]  #: (2,) vertex ids
    killer_triangle_ids: NDArray[np.int64]  #: (2, 3) vertex ids; the thick triangle comes first
    neighbour_ids: NDArray[np.int64]  #: (m, 3) vertex ids, m <= 4
    killer_edge_points: NDArray[np.float64]  #: (2, d) places of `killer_edge`
    killer_triangles: NDArray[np.float64]  #: (2, 3, d) places of `killer_triangle_ids`
    neighbours: NDArray[np.float64]  #: (m, 3, d) places of `neighbour_ids`
    killer_values: NDArray[np.float64]  #: (2,) filtration values of the killer triangles: both enter at `death`
    neighbour_values: NDArray[np.float64]  #: (m,) filtration values of the neighbours
    #: Hausdorff distance between this loop's killer edge and that of its previous appearance; nan when the loop is new
    killer_shift: float = float("nan")
    _curve: Callable[[], ClosedCurve] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        own_arrays(self)

    @property
    def lifetime(self) -> float:
        """How long the loop lasts in the filtration: death - birth."""
        return self.death - self.birth

    @property
    def centre(self) -> NDArray[np.float64]:
        """(d,) where the loop is, midway between the barycentres of its two killer triangles."""
        return np.asarray(self.killer_triangles.mean(axis=(0, 1)))

    @property
    def cycle(self) -> NDArray[np.int64]:
        """(length,) vertex ids of a closed walk, tight around the loop at its birth: `Diagram.cycle`, found when asked for.

        A LookupError when it was read from a file of states of 0.1.0, or put together by hand: it knows no cloud.
        """
        return self._closed_curve[0]

    @property
    def cycle_points(self) -> NDArray[np.float64]:
        """(length, d) the places of `cycle`: the curve to draw, or to link with a target."""
        return self._closed_curve[1]

    @cached_property
    def _closed_curve(self) -> ClosedCurve:
        if self._curve is None:
            raise LookupError(f"loop {self.id} knows no cloud to find its cycle in: track the cloud (topokit.track)")
        return self._curve()

    @property
    def quadrilateral(self) -> NDArray[np.float64]:
        """(4, d) the closed curve x, z1, y, z2 around the two killer triangles: the killer edge's ends and the apexes.

        Just before the loop dies this curve is in its class among the points, which know nothing of a hook: edges as long as
        the killer may pass through a thin one. Around a target that fills the opening it links as the loop does; around a
        hook link `cycle_points`, which is tight.
        """
        apex = ~np.isin(self.killer_triangle_ids, self.killer_edge)
        (x, y), (z1, z2) = self.killer_edge_points, self.killer_triangles[apex]
        return np.array([x, z1, y, z2])


def loop_colour(loop_id: int) -> str:
    """Return the colour of an identity as `#RRGGBB`; identities six apart share one."""
    return OKABE_ITO[int(loop_id) % len(OKABE_ITO)]


def loop_of(cloud: NDArray[np.float64], cycle: Callable[[], NDArray[np.int64]], **fields: Any) -> Loop:
    """Return a loop of a cloud.

    Parameters
    ----------
    cloud : (n, d) float64
    cycle : callable
        Returns the vertex ids of the loop's closed walk; called when the walk is asked for.
    **fields
        The fields of `Loop` that hold numbers and vertex ids.
    """
    return Loop(
        **fields,
        killer_edge_points=cloud[fields["killer_edge"]],
        killer_triangles=cloud[fields["killer_triangle_ids"]],
        neighbours=cloud[fields["neighbour_ids"]],
        killer_values=np.full(2, fields["death"]),  # their longest edge is the killer edge
        _curve=partial(_curve_of, cloud, cycle),
    )


def _curve_of(cloud: NDArray[np.float64], cycle: Callable[[], NDArray[np.int64]]) -> ClosedCurve:
    ids = cycle()
    return ids, cloud[ids]


@dataclass(frozen=True, eq=False)
class TopologicalState:
    """All loops of one frame, longest lifetime first, and the parameters they were tracked with."""

    frame: int  #: number of the frame in its sequence, from 0
    time: float  #: seconds, when the sequence has a clock; else the frame number
    loops: tuple[Loop, ...] = ()  #: longest lifetime first
    #: the `alpha`, `beta` and `epsilon` used at this frame, given or estimated
    parameters: dict[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.loops)

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and lists, for JSON: frame, time, parameters, and of every loop its id, place and values."""
        numbers, arrays = ("id", "birth", "death", "lifetime"), ("centre", "killer_edge", "killer_triangles")
        loops = [
            {name: getattr(loop, name) for name in numbers} | {name: getattr(loop, name).tolist() for name in arrays}
            for loop in self.loops
        ]
        return {"frame": self.frame, "time": self.time, "parameters": dict(self.parameters), "loops": loops}

    def __getitem__(self, loop_id: int) -> Loop:
        """Return the loop of that identity; KeyError when this frame has none."""
        for loop in self.loops:
            if loop.id == loop_id:
                return loop
        raise KeyError(f"frame {self.frame} has no loop {loop_id}; it has {[loop.id for loop in self.loops]}")


def as_table(states: Iterable[TopologicalState]) -> Any:
    """Return tracked states as a `pandas.DataFrame`, a row for every loop of every frame.

    Columns are frame, time, id, birth, death, lifetime, killer_shift, the centre (x, y, z, or x0 to x[d-1] when d is not 3)
    and the killer edge's vertex ids (killer_a, killer_b).
    """
    import pandas as pd

    numbers, axes, rows = ("id", "birth", "death", "lifetime", "killer_shift"), ["x", "y", "z"], []
    for state in states:
        for loop in state.loops:
            axes = axes if len(loop.centre) == 3 else [f"x{i}" for i in range(len(loop.centre))]
            values = [getattr(loop, name) for name in numbers]
            rows.append([state.frame, state.time, *values, *loop.centre.tolist(), *loop.killer_edge.tolist()])
    return pd.DataFrame(rows, columns=["frame", "time", *numbers, *axes, "killer_a", "killer_b"])
