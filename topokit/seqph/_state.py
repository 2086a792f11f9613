"""The topological state of a scene: X_t in the paper.

A state is a list of loops. A loop is what `topokit.rips` finds (birth, death, killer edge, killer triangles, neighbours)
together with the coordinates of those simplices and the identity that the tracker gives it.

Source: Antonova et al. 2021, section 4 (the zeta_l of Algorithm 1). Taught in chapter 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import numpy as np

from topokit._validate import Array, Ids, own_arrays
from topokit.rips import Diagram
from topokit.sampling import hausdorff_table

ClosedCurve = tuple[Ids, Array]  # vertex ids of a closed walk, and their places


@dataclass(frozen=True, eq=False)
class Loop:
    """One loop of one frame. Lengths are in the unit of the points (metres in topokit's own data)."""

    id: int  #: identity through time: the same loop keeps it from frame to frame; never reused
    birth: float  #: filtration value (half the length) of the edge that creates the loop
    death: float  #: filtration value of the edge that ends it
    birth_edge: Ids  #: (2,) vertex ids in the frame's cloud
    killer_edge: Ids  #: (2,) vertex ids
    killer_triangle_ids: Ids  #: (2, 3) vertex ids; the thick triangle comes first
    neighbour_ids: Ids  #: (m, 3) vertex ids, m <= 4
    killer_edge_points: Array  #: (2, d) places of `killer_edge`
    killer_triangles: Array  #: (2, 3, d) places of `killer_triangle_ids`
    neighbours: Array  #: (m, 3, d) places of `neighbour_ids`
    killer_values: Array  #: (2,) filtration values of the killer triangles: both enter at `death`
    neighbour_values: Array  #: (m,) filtration values of the neighbours
    #: Hausdorff distance between this loop's killer edge and that of its previous appearance; nan when the loop is new
    killer_shift: float = float("nan")
    _curve: Callable[[], ClosedCurve] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        own_arrays(self)

    def __repr__(self) -> str:
        centre = np.array2string(self.centre, precision=3, separator=", ")
        return f"Loop(id={self.id}, birth={self.birth:.4g}, death={self.death:.4g}, centre={centre})"

    @property
    def lifetime(self) -> float:
        """Return how long the loop lasts in the filtration: death - birth."""
        return self.death - self.birth

    @property
    def centre(self) -> Array:
        """Return the centre (d,) of the loop, midway between the barycentres of its two killer triangles."""
        return np.asarray(self.killer_triangles.mean(axis=(0, 1)))

    @property
    def cycle(self) -> Ids:
        """Return the vertex ids (length,) of a closed walk, tight around the loop at its birth; computed on first use.

        It is the cycle of `Diagram.cycle`. A loop that was made by hand has no cloud for it, and raises LookupError.
        """
        return self._closed_curve[0]

    @property
    def cycle_points(self) -> Array:
        """Return the places (length, d) of `cycle`: the curve to draw, or to link with a target."""
        return self._closed_curve[1]

    @cached_property
    def _closed_curve(self) -> ClosedCurve:
        """Return the ids and the places of the cycle."""
        if self._curve is None:
            raise LookupError(f"loop {self.id} has no cloud to find its cycle in: track the cloud (topokit.track)")
        return self._curve()

    @property
    def quadrilateral(self) -> Array:
        """Return the closed curve x, z1, y, z2 (4, d) around the killer triangles: the killer edge's ends and the apexes.

        Just before the loop dies this curve is in its class among the points. The class takes no account of a hook: edges as
        long as the killer may pass through a thin one. Around a target that fills the opening the curve has the linking
        number of the loop; around a hook use `cycle_points`, which is tight.
        """
        is_apex = ~np.isin(self.killer_triangle_ids, self.killer_edge)
        x, y = self.killer_edge_points
        z1, z2 = self.killer_triangles[is_apex]
        return np.array([x, z1, y, z2])

    @classmethod
    def from_cloud(cls, cloud: Array, cycle: Callable[[], Ids], **fields: Any) -> Loop:
        """Return a loop of a cloud.

        Parameters
        ----------
        cloud : (n, d) float64
        cycle : callable
            Function that returns the vertex ids of the loop's closed walk, called on first use.
        **fields
            The fields that hold numbers and vertex ids.
        """
        return cls(
            **fields,
            killer_edge_points=cloud[fields["killer_edge"]],
            killer_triangles=cloud[fields["killer_triangle_ids"]],
            neighbours=cloud[fields["neighbour_ids"]],
            killer_values=np.full(2, fields["death"]),  # their longest edge is the killer edge
            _curve=partial(_closed_curve, cloud, cycle),
        )


def loop_at(diagram: Diagram, bar: int, cloud: Array, ids: Ids, identity: int, edge_before: Array | None) -> Loop:
    """Return the loop of a bar of the diagram of the points `ids`; `edge_before` (2, d) is where its last killer edge was."""
    killer_edge = ids[diagram.killer_edge[bar]]
    neighbours = ids[diagram.neighbours(bar)]
    sides = np.linalg.norm(cloud[neighbours] - cloud[neighbours[:, [2, 0, 1]]], axis=2)
    killer_shift = float("nan")
    if edge_before is not None:
        killer_shift = float(hausdorff_table(cloud[killer_edge][None], edge_before[None])[0, 0])
    return Loop.from_cloud(
        cloud,
        partial(_cycle_in_cloud, diagram, bar, ids),
        id=identity,
        birth=float(diagram.birth[bar]),
        death=float(diagram.death[bar]),
        birth_edge=ids[diagram.birth_edge[bar]],
        killer_edge=killer_edge,
        killer_triangle_ids=ids[diagram.killer_triangles[bar]],
        neighbour_ids=neighbours,
        neighbour_values=sides.max(axis=1, initial=0.0) / 2,
        killer_shift=killer_shift,
    )


# These two are functions of the module, not closures, so that loops can be pickled.
def _closed_curve(cloud: Array, cycle: Callable[[], Ids]) -> ClosedCurve:
    ids = cycle()
    return ids, cloud[ids]


def _cycle_in_cloud(diagram: Diagram, bar: int, ids: Ids) -> Ids:
    return ids[diagram.cycle(bar)]


@dataclass(frozen=True, eq=False)
class TopologicalState:
    """All loops of one frame, longest lifetime first, and the parameters they were tracked with."""

    frame: int  #: number of the frame in its sequence, from 0
    time: float  #: seconds, when the sequence has a clock; else the frame number
    loops: tuple[Loop, ...] = ()  #: longest lifetime first
    #: the `alpha`, `beta` and `epsilon` used at this frame, given or estimated
    parameters: dict[str, Any] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        return len(self.loops)

    def __iter__(self) -> Iterator[Loop]:
        return iter(self.loops)

    def __getitem__(self, loop_id: int) -> Loop:
        """Return the loop with that identity; raise KeyError when this frame has none."""
        for loop in self.loops:
            if loop.id == loop_id:
                return loop
        raise KeyError(f"frame {self.frame} has no loop {loop_id}; it has {[loop.id for loop in self.loops]}")

    def as_dict(self) -> dict[str, Any]:
        """Return plain numbers and lists, for JSON: frame, time, parameters, and for every loop its id, place and values."""
        loops = []
        for loop in self.loops:
            row: dict[str, Any] = {name: getattr(loop, name) for name in ("id", "birth", "death", "lifetime")}
            for name in ("centre", "killer_edge", "killer_triangles"):
                row[name] = getattr(loop, name).tolist()
            loops.append(row)
        return {"frame": self.frame, "time": self.time, "parameters": dict(self.parameters), "loops": loops}
