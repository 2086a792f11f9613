"""Garments: triangle meshes with their true loops and the vertices by which they are held."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from topokit._geometry import turned
from topokit._validate import as_ids, as_points, positive

from ._surface import Array, Ids, Surface, count_components, edge_lengths, half_edges, held_upright, is_cycle

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True, eq=False)
class Garment:
    """A triangle mesh with its true loops and the two vertices by which grippers hold it.

    `WARDROBE` makes garments from patterns, `from_mesh` reads those of others. Meshes that make a physics engine fail are
    refused: with vertices in no face, several components, edges without length, or faces that contain a vertex twice.
    """

    name: str  #: name that episodes record
    vertices: Array  #: rest positions (N, 3) float64, metres, z up; they determine the rest lengths of the springs
    faces: Ids  #: vertex ids (F, 3) int64, counted from 0
    #: True loops, each (L,) int64: closed cycles of vertex ids along edges. The first is the one to hang the garment by.
    loops: tuple[Ids, ...]
    grips: Ids  #: ids (2,) int64 of the vertices that the grippers hold
    parameters: Mapping[str, float] = field(default_factory=dict)  #: sizes that it was made from
    #: Names of the loops, all different; several of a kind are numbered ("handle 1"). "loop 1", ... when not given.
    loop_names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        # Check and copy the arrays, so that they cannot be changed from outside.
        vertices = as_points(self.vertices, "vertices", copy=True)
        faces = as_ids(self.faces, "faces", len(vertices))
        grips = as_ids(self.grips, "grips", len(vertices))
        loops = tuple(as_ids(loop, f"loops[{i}]", len(vertices)) for i, loop in enumerate(self.loops))
        names = tuple(self.loop_names) or tuple(f"loop {i + 1}" for i in range(len(loops)))
        for array in (vertices, faces, grips, *loops):
            array.setflags(write=False)
        values = {"vertices": vertices, "faces": faces, "grips": grips, "loops": loops, "loop_names": names}
        for key, value in {**values, "parameters": dict(self.parameters)}.items():
            object.__setattr__(self, key, value)
        # PyBullet fails at an edge without length, and never returns from loading parts that are joined by a vertex alone.
        if vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
            raise ValueError(f"vertices must be (N, 3) and faces (F, 3), not {vertices.shape} and {faces.shape}")
        if self.edge_lengths.min() <= 0:
            raise ValueError(f"edge {self.edges[np.argmin(self.edge_lengths)].tolist()} has length 0")
        count = count_components(faces) + len(vertices) - len(np.unique(faces))
        if count > 1:
            raise ValueError(f"the mesh has {count} components that no edge joins, counting vertices in no face")
        for i, loop in enumerate(loops):
            if not is_cycle(loop, self.edges):
                raise ValueError(
                    f"loops[{i}] must be a closed cycle of different vertices along edges: {loop.tolist()!r:.80}"
                )
        if grips.shape != (2,) or grips[0] == grips[1]:
            raise ValueError(f"grips must be two different vertex ids, not {grips.tolist()}")
        if not len(set(names)) == len(names) == len(loops):
            raise ValueError(f"loop_names must be {len(loops)} different names, one a loop, not {names}")

    @classmethod
    def from_mesh(
        cls,
        mesh: str | Path | trimesh.Trimesh,
        *,
        up: Literal["x", "y", "z", "-x", "-y", "-z"],
        grips: ArrayLike,
        size: float | None = None,
        unit: float | None = None,
        loops: Literal["auto"] | Mapping[str, str | ArrayLike] = "auto",
        name: str | None = None,
    ) -> Garment:
        """Return the garment of a mesh file (OBJ, PLY, STL, ...), or of a mesh of trimesh.

        Vertices at one place become one. What a mesh does not say are arguments; appendix C draws the candidates. The mesh should
        have some hundred vertices, about equally far apart.

        Parameters
        ----------
        mesh : path or trimesh.Trimesh
            One piece of cloth. Vertex ids are those of the mesh, or of `trimesh.load_mesh` for a file.
        up : {"x", "y", "z", "-x", "-y", "-z"}
            The axis of the mesh that points up.
        grips : (2,) array_like of int
            Ids of the vertices to hold; the garment is turned so that the first is on the left.
        size, unit : float
            One of the two: the largest extent that the garment shall have, metres; or the metres in a unit of the mesh.
        loops : "auto" or mapping of str to (L,) array_like of int or to str
            True loops by their names ("neck"), the one to hang the garment by first: closed cycles of vertex ids, or names of
            loops of `find_loops` ("loop 2"). "auto" takes all of these.
        name : str, optional
            The name of the file when not given.
        """
        surface = Surface(mesh)
        scale = unit if size is None else size / float(np.ptp(surface.vertices[surface.used], axis=0).max())
        if scale is None:
            raise TypeError("a mesh does not say how large it is: give its size or its unit in metres")
        held = surface.numbers(grips, "grips")
        cycles = surface.loops()
        if loops != "auto":
            cycles = {key: cycles[loop] if isinstance(loop, str) else np.asarray(loop) for key, loop in loops.items()}
        return cls(
            name or (Path(mesh).stem if isinstance(mesh, str | Path) else mesh.metadata.get("name", "mesh")),
            held_upright(positive(scale, "unit", zero=False) * surface.vertices[surface.used], up, held),
            np.searchsorted(surface.used, surface.faces),
            tuple(surface.numbers(cycle, f"loops[{key!r}]") for key, cycle in cycles.items()),
            held,
            {"scale": scale},
            tuple(cycles),
        )

    @staticmethod
    def find_loops(mesh: str | Path | trimesh.Trimesh) -> dict[str, Ids]:
        """Return the loops of a mesh by the names "loop 1", "loop 2", ..., the longest first.

        They are the borders of the mesh. Where these do not generate all classes of loops, they are representative cycles of
        the persistence of distances along the mesh. Each is a closed cycle (L,) of vertex ids, as `from_mesh` takes them.
        """
        return Surface(mesh).loops()

    @property
    def named_loops(self) -> dict[str, Ids]:
        """Return the true loops by their names."""
        return dict(zip(self.loop_names, self.loops, strict=True))

    @property
    def length(self) -> float:
        """Return the distance from the top of the first loop down to the lowest vertex, metres; 0 without a loop."""
        heights = self.vertices[:, 2]
        return float(heights[self.loops[0]].max() - heights.min()) if self.loops else 0.0

    @functools.cached_property
    def edges(self) -> Ids:
        """Return all edges (E, 2) once, smaller id first, in lexicographic order."""
        return np.unique(half_edges(self.faces), axis=0)

    @functools.cached_property
    def edge_lengths(self) -> Array:
        """Return the rest lengths (E,) of `edges`, metres."""
        return edge_lengths(self.vertices, self.edges)

    @property
    def area(self) -> float:
        """Return the area of the cloth, square metres."""
        a, b, c = np.moveaxis(self.vertices[self.faces], 1, 0)
        return float((np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2).sum())

    def turned(self, degrees: float) -> Garment:
        """Return the garment turned by degrees about the z axis, from x towards y."""
        return replace(self, vertices=turned(self.vertices, degrees)) if degrees else self
