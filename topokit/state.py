"""The topological state of a scene: what the paper calls X_t.

A state is a list of loops; a loop is what `topokit.rips` found (birth, death, killer edge, killer triangles, neighbours)
together with the coordinates of those simplices and the identity that `topokit.seqph` gave it.

Source: Antonova et al. 2021, section 4 (the zeta_l of Algorithm 1). Taught in chapter 0.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Loop", "TopologicalState"]


@dataclass(frozen=True, eq=False)
class Loop:
    """One loop of one frame. Lengths are in the unit of the points (metres in topokit's own data).

    Attributes
    ----------
    id : int
        Identity through time: the same loop keeps it from frame to frame; never reused.
    birth, death : float
        Filtration values (half the length) of the edge that creates the loop and of the edge that ends it.
    birth_edge, killer_edge : (2,) int
        Vertex ids in the frame's cloud.
    killer_triangle_ids, neighbour_ids : (2, 3) and (m, 3) int, m <= 4
        Vertex ids; the thick killer triangle comes first.
    killer_edge_points : (2, d) float
    killer_triangles, neighbours : (2, 3, d) and (m, 3, d) float
        Their coordinates.
    killer_values, neighbour_values : (2,) and (m,) float
        Filtration values of the triangles; both killer triangles enter at `death`.
    step : float
        Hausdorff distance between this loop's killer edge and that of its previous appearance; nan when the loop is new.
    """

    id: int
    birth: float
    death: float
    birth_edge: NDArray[np.int64]
    killer_edge: NDArray[np.int64]
    killer_triangle_ids: NDArray[np.int64]
    neighbour_ids: NDArray[np.int64]
    killer_edge_points: NDArray[np.float64]
    killer_triangles: NDArray[np.float64]
    neighbours: NDArray[np.float64]
    killer_values: NDArray[np.float64]
    neighbour_values: NDArray[np.float64]
    step: float = float("nan")

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    @property
    def lifetime(self) -> float:
        """How long the loop lasts in the filtration: death - birth."""
        return self.death - self.birth

    @property
    def centre(self) -> NDArray[np.float64]:
        """(d,) mean of the barycentres of the two killer triangles: where the loop is."""
        return np.asarray(self.killer_triangles.mean(axis=(0, 1)))


@dataclass(frozen=True, eq=False)
class TopologicalState:
    """All loops of one frame, longest lifetime first, and the parameters they were tracked with.

    Attributes
    ----------
    frame : int
        Number of the frame in its sequence, from 0.
    time : float
        Seconds, when the sequence has a clock; else the frame number.
    loops : tuple of Loop
    parameters : dict of str to float
        The `alpha`, `beta` and `epsilon` used at this frame, given or estimated.
    """

    frame: int
    time: float
    loops: tuple[Loop, ...] = ()
    parameters: dict[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.loops)

    def __getitem__(self, loop_id: int) -> Loop:
        """Return the loop of that identity; KeyError when this frame has none."""
        for loop in self.loops:
            if loop.id == loop_id:
                return loop
        raise KeyError(f"frame {self.frame} has no loop {loop_id}; it has {[loop.id for loop in self.loops]}")
