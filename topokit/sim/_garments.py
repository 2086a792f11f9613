"""Garments: triangle meshes with their true loops and the places where they are held.

A garment is cut from flat patterns and sewn together. Triangles are near-equilateral, so that a mass-spring cloth behaves
alike in every direction, and the border of an opening keeps its order: it is the true loop.
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from topokit._geometry import turned
from topokit._strangers import printable
from topokit._validate import as_ids, as_points

from . import _mesh, _names
from ._even import evened, is_even, usual_spacing
from ._surface import Array, Ids, check_loop, check_mesh, edge_lengths, face_areas, half_edges

_log = logging.getLogger("topokit.sim")


@dataclass(frozen=True, eq=False)
class Garment:
    """A triangle mesh with its true loops and the two vertices by which grippers hold it.

    Meshes that make a physics engine fail or hang are refused: with vertices in no face, several components, edges without
    length, or faces that contain a vertex twice; the message lists them. An edge may be in three faces, for example where a
    strap is sewn on.
    """

    name: str  #: name that episodes record
    vertices: Array  #: rest positions (N, 3) float64, metres, z up; they determine the rest lengths of the springs
    faces: Ids  #: vertex ids (F, 3) int64, counted from 0
    #: True loops, each (L,) int64: closed cycles of vertex ids along edges (the last is joined to the first).
    loops: tuple[Ids, ...]
    grips: Ids  #: ids (2,) int64 of the vertices that the grippers hold
    parameters: Mapping[str, float] = field(default_factory=dict)  #: sizes that it was made from
    #: Names of the loops, all different: neck, hem, handle, strap, arm, waist, ear, hole, edge, rim, ...; several of a kind are
    #: numbered ("handle 1"). When not given, they are found from place and size of the loops on the upright mesh.
    loop_names: tuple[str, ...] = ()
    repairs: tuple[str, ...] = ()  #: repairs of the mesh by `from_mesh`, in words

    def __post_init__(self) -> None:
        # Check and copy the arrays, so that they cannot be changed from outside.
        vertices = as_points(self.vertices, "vertices", copy=True)
        if vertices.shape[1] != 3:
            raise ValueError(f"vertices must be an (N, 3) array, not of shape {vertices.shape}")
        faces = as_ids(self.faces, "faces", len(vertices))
        if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
            raise ValueError(f"faces must be vertex ids (F, 3), one row at least, not of shape {faces.shape}")
        grips = as_ids(self.grips, "grips", len(vertices))
        if grips.shape != (2,) or grips[0] == grips[1]:
            raise ValueError(f"grips must be two different vertex ids, not {grips.tolist()}")
        loops = tuple(as_ids(loop, f"loops[{i}]", len(vertices)) for i, loop in enumerate(self.loops))
        for array in (vertices, faces, grips, *loops):
            array.setflags(write=False)
        values = {"vertices": vertices, "faces": faces, "grips": grips, "loops": loops}
        for key, value in {**values, "parameters": dict(self.parameters)}.items():
            object.__setattr__(self, key, value)
        # Check that they are a cloth, and name its loops.
        check_mesh(vertices, faces)
        for i, loop in enumerate(loops):
            check_loop(loop, self.edges, f"loops[{i}]")
        names = tuple(self.loop_names) or _names.named(vertices, faces, loops)
        words = all(isinstance(name, str) and name for name in names)
        if not words or not len(set(names)) == len(names) == len(loops):
            raise ValueError(f"loop_names must be {len(loops)} different names, one a loop, not {names!r:.200}")
        object.__setattr__(self, "loop_names", names)
        self.edges.setflags(write=False)  # computed once and shared
        self.edge_lengths.setflags(write=False)

    @property
    def named_loops(self) -> dict[str, Ids]:
        """Return the true loops by their names."""
        return dict(zip(self.loop_names, self.loops, strict=True))

    @property
    def hanging_loop(self) -> Ids | None:
        """Return the true loop (L,) to hang the garment by: the neck if it has one; None without a loop."""
        names = [*_names.to_hang_by(self.loop_names), *self.loop_names]
        return self.named_loops[names[0]] if names else None

    @property
    def hangs_down(self) -> float:
        """Return the distance from the top of the hanging loop down to the lowest vertex, metres; 0 without a loop."""
        loop = self.hanging_loop
        heights = self.vertices[:, 2]
        return 0.0 if loop is None else float(heights[loop].max() - heights.min())

    @functools.cached_property
    def edges(self) -> Ids:
        """Return all edges (E, 2) once, smaller id first, in lexicographic order."""
        return np.unique(half_edges(self.faces), axis=0)

    @functools.cached_property
    def edge_lengths(self) -> Array:
        """Return the rest lengths (E,) of `edges`, metres."""
        return edge_lengths(self.vertices, self.edges)

    def turned(self, degrees: float) -> Garment:
        """Return the garment turned about the z axis, from x towards y.

        Parameters
        ----------
        degrees : float
        """
        return replace(self, vertices=turned(self.vertices, degrees)) if degrees else self

    @property
    def area(self) -> float:
        """Return the area of the cloth, square metres."""
        return float(face_areas(self.vertices, self.faces).sum())

    def evened(self) -> Garment:
        """Return the garment with edges of nearly equal length that suit its size; itself when it has them already.

        A simulation needs such a mesh: short edges tear, and long ones let a rod through. Loops and grips stay where they are.
        """
        spacing = usual_spacing(self.vertices, self.faces)
        if is_even(self.vertices, self.faces, spacing):
            return self
        even = evened(self.vertices, self.faces, spacing, self.loops)
        note = f"{len(self.vertices)} vertices were replaced by {len(even.vertices)}, about {spacing:.2g} m apart"
        _log.warning("%s", printable(f"{self.name}: {note}"))
        return replace(
            self,
            vertices=even.vertices,
            faces=even.faces,
            loops=tuple(even.cycles),
            grips=even.nearest[self.grips],
            repairs=(*self.repairs, note),
        )

    @staticmethod
    def from_mesh(path: str | Path, **options: Any) -> Garment:
        """Return the garment of an OBJ, PLY or STL file."""
        read = _mesh.from_mesh(path, **options)
        return Garment(
            Path(path).stem,
            read.vertices,
            read.faces,
            read.loops,
            read.grips,
            {"scale": read.scale},
            read.loop_names,
            read.repairs,
        )
