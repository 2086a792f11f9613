"""Meshes of others: trimesh reads them, and their loops are found here."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from topokit._geometry import angle, turned
from topokit._validate import as_ids
from topokit.linking import side_lengths
from topokit.rips import rips_persistence

from ._surface import Array, EdgeGraph, Ids, border_cycles, half_edges, simple_cycles, wind

if TYPE_CHECKING:
    import trimesh


class Surface:
    """The faces of a mesh with one vertex at each place and each face once; vertices keep the ids of the mesh."""

    def __init__(self, mesh: str | Path | trimesh.Trimesh) -> None:
        import trimesh

        if not isinstance(mesh, trimesh.Trimesh):
            mesh = trimesh.load_mesh(mesh)
        self.vertices: Array = np.asarray(mesh.vertices, dtype=np.float64)
        # All vertices at one place go by the id of the first of them.
        first, place_of = trimesh.grouping.unique_rows(self.vertices)  # type: ignore[no-untyped-call]
        self._first_at: Ids = first[place_of]
        faces = self._first_at[mesh.faces]
        corners = np.sort(faces, axis=1)
        _, once = np.unique(corners, axis=0, return_index=True)
        once = once[(np.diff(corners[once], axis=1) > 0).all(axis=1)]
        self.faces = wind(faces[np.sort(once)])
        self.edges = np.unique(half_edges(self.faces), axis=0)
        self.used = np.unique(self.faces)

    def numbers(self, ids: ArrayLike, name: str) -> Ids:
        """Return the places of vertices, given by the ids of the mesh, in `used`."""
        known = self._first_at[as_ids(ids, name, len(self.vertices))]
        if not np.isin(known, self.used).all():
            raise ValueError(f"{name}: a vertex is in no face")
        return np.searchsorted(self.used, known)

    def loops(self) -> dict[str, Ids]:
        """Return the loops of `Garment.find_loops`."""
        cycles = border_cycles(self.faces)
        # By Euler's formula; a closed surface has a class in dimension 2, too.
        n_classes = 1 - len(self.used) + len(self.edges) - len(self.faces) + (not cycles)
        if n_classes >= max(len(cycles), 1):
            cycles = self._persistent_loops(n_classes)
        cycles.sort(key=lambda cycle: -float(side_lengths(self.vertices[cycle]).sum()))
        return {f"loop {i + 1}": cycle for i, cycle in enumerate(cycles)}

    def _persistent_loops(self, n: int) -> list[Ids]:
        """Return cycles along edges that represent the n longest-lived classes of the distances along the mesh."""
        graph = EdgeGraph(self.vertices, self.edges)
        diagram = rips_persistence(graph.distances(self.used), metric="precomputed")
        cycles = []
        for i in range(n):
            corners = self.used[diagram.cycle(i)].tolist()
            paths = [graph.path(a, b) for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)]
            walk = [vertex for path in paths for vertex in path[:-1]]
            cycles.append(np.array(max(simple_cycles(walk), key=len)))
        return cycles


def held_upright(vertices: Array, up: str, grips: Ids) -> Array:
    """Return vertices (N, 3) with an axis of theirs upwards, and about the middle of the grips: the first left of the second."""
    upright = np.roll(vertices, 2 - "xyz".index(up[-1]), axis=1)
    if up[0] == "-":
        upright = upright * [1, -1, -1]  # half a turn about x
    first, second = upright[grips]
    return turned(upright - (first + second) / 2, -angle(np.array([1.0, 0, 0]), second - first))
