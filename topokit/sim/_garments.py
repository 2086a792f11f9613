"""Garments: triangle meshes that know their true loops and where to be held.

A garment is cut from flat patterns and sewn together. Triangles are near-equilateral, so that a mass-spring cloth behaves
alike in every direction, and the border of an opening keeps its order: it is the true loop.
"""

from __future__ import annotations

import functools
import inspect
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, ParamSpec

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._validate import as_points, positive

from . import _bags, _wardrobe
from ._mesh import load_cloth
from ._surface import as_ids, check_loop, check_mesh, half_edges

__all__ = ["WARDROBE", "Garment"]

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
Sizes = ParamSpec("Sizes")
_log = logging.getLogger(__name__)


def _sewn(pattern: Callable[Sizes, _wardrobe.Fields]) -> Callable[Sizes, Garment]:
    """The function that makes the garment of a pattern."""

    @functools.wraps(pattern)
    def garment(*arguments: Sizes.args, **sizes: Sizes.kwargs) -> Garment:
        return Garment(*pattern(*arguments, **sizes))

    signature = inspect.signature(pattern).replace(return_annotation="Garment")
    garment.__signature__ = signature  # type: ignore[attr-defined]
    return garment


@dataclass(frozen=True, eq=False)
class Garment:
    """A triangle mesh with its true loops and the two vertices by which grippers hold it.

    Everything that makes a physics engine fail or hang is refused here: vertices in no face, several components, edges
    without length, faces that name a vertex twice. An edge may be in three faces, as where a strap is sewn on.

    Attributes
    ----------
    name : str
    vertices : (N, 3) float64
        Rest positions in metres, z up; rest lengths of the springs are taken from them.
    faces : (F, 3) int64
        Vertex ids, counted from 0.
    loops : tuple of (L,) int64
        The true loops: each a closed cycle of vertex ids along edges of the mesh (the last joins the first).
    grips : (2,) int64
        The two vertices that the grippers hold.
    parameters : mapping of str to float
        The sizes it was made from, kept with every episode.
    repairs : tuple of str
        What `from_mesh` did to the mesh of a file, in words.

    Raises
    ------
    ValueError
        When the mesh, a loop or a grip is not as described; the message names the vertex, edge or face.

    Examples
    --------
    >>> apron = Garment.apron()
    >>> len(apron.loops), len(apron.vertices) >= 520
    (1, True)
    """

    name: str
    vertices: Array
    faces: Ids
    loops: tuple[Ids, ...]
    grips: Ids
    parameters: Mapping[str, float] = field(default_factory=dict)
    repairs: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        vertices = as_points(self.vertices, "vertices")
        if vertices.shape[1] != 3:
            raise ValueError(f"vertices must be an (N, 3) array, not of shape {vertices.shape}")
        faces = as_ids(self.faces, "faces", len(vertices))
        if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
            raise ValueError(
                f"faces must be an (F, 3) array of vertex ids with at least one row, not of shape {faces.shape}"
            )
        grips = as_ids(self.grips, "grips", len(vertices))
        if grips.shape != (2,) or grips[0] == grips[1]:
            raise ValueError(f"grips must be two different vertex ids, not {grips.tolist()}")
        loops = tuple(as_ids(loop, f"loops[{i}]", len(vertices)) for i, loop in enumerate(self.loops))
        values = {
            "vertices": vertices.copy(),
            "faces": faces,
            "grips": grips,
            "loops": loops,
            "parameters": dict(self.parameters),
        }
        for key, value in values.items():
            object.__setattr__(self, key, value)
        for array in (self.vertices, self.faces, self.grips, *self.loops):
            array.setflags(write=False)
        check_mesh(vertices, faces)
        for i, loop in enumerate(loops):
            check_loop(loop, self.edges, f"loops[{i}]")

    @property
    def edges(self) -> Ids:
        """(E, 2) every edge once, smaller id first, in lexicographic order."""
        return np.unique(half_edges(self.faces), axis=0)

    @property
    def edge_lengths(self) -> Array:
        """(E,) rest lengths in metres, in the order of `edges`."""
        ends = self.vertices[self.edges]
        return np.asarray(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1))

    apron = staticmethod(_sewn(_wardrobe.apron))
    tote = staticmethod(_sewn(_bags.tote))
    backpack = staticmethod(_sewn(_bags.backpack))
    shirt = staticmethod(_sewn(_wardrobe.shirt))
    vest = staticmethod(_sewn(_wardrobe.vest))
    mask = staticmethod(_sewn(_wardrobe.mask))
    sheet = staticmethod(_sewn(_wardrobe.sheet))

    @classmethod
    def from_mesh(
        cls,
        path: str | Path,
        *,
        loops: Sequence[ArrayLike] | Literal["borders"] = (),
        grips: ArrayLike | None = None,
        size: float | None = None,
        scale: float | None = None,
        up: Literal["y", "z"] | None = None,
        weld: float | None = None,
        name: str | None = None,
        max_vertices: int = 3000,
    ) -> Garment:
        """Return the garment of an OBJ, PLY or STL file as it comes; what had to be repaired is in `repairs` and logged.

        Welded are vertices at one place (UV seams, STL corners). Dropped are vertices in no face, faces without three
        different vertices, faces that lie on another one, and small separate components (what touches at a vertex only is
        separate). Polygons are cut into triangles and faces turned to agree with their neighbours. Edges in more than two
        faces are kept: cloth may be sewn so.

        Parameters
        ----------
        path : str or Path
            Of all objects and groups of an OBJ file the garment is made.
        loops : sequence of sequences of int, or "borders"
            Vertex ids of the true loops as the file numbers them, counted from 0 (in an STL file, corner k of triangle i is
            3 i + k). In order they need not name every vertex: gaps of up to four edges are closed along the mesh. Given
            in no order, the cycle they lie around is found by persistence. With "borders", every border of the mesh,
            the longest first; of m borders of a garment without handles m - 1 are independent.
        grips : (2,) int, optional
            Vertex ids as the file numbers them; two near the top when not given, to the left and to the right.
        size : float, optional
            Largest extent that the garment shall have, metres.
        scale : float, optional
            Metres in one unit of the file. When neither is given: metres if the garment's largest extent is then 0.15 to
            2.5, else millimetres or centimetres if they make it so, else it is made 1 m.
        up : {"y", "z"}, optional
            The axis that points up; y is turned to z. When not given, y if the grips lie higher above the middle that way,
            without grips if the garment is much longer along y; else z.
        weld : float, optional
            Distance within which vertices are one, in the file's units; 1e-5 of the diagonal or 0.01 of the usual edge, if
            that is less, when not given.
        name : str, optional
            The file's name when not given.
        max_vertices : int
            More of them are refused.

        Raises
        ------
        FileNotFoundError
            When there is no such file.
        ValueError, TypeError
            When the file is empty, damaged or of another kind, the mesh has no faces, a vertex of a face is not finite,
            there are separate components of similar size, a loop or a grip names a vertex that is not part of the garment,
            or a loop cannot be closed; the message says which, where, and what to do.

        Examples
        --------
        >>> from pathlib import Path
        >>> from tempfile import TemporaryDirectory
        >>> with TemporaryDirectory() as folder:
        ...     path = Path(folder) / "flag.obj"
        ...     _ = path.write_text("v 0 0 0\\nv 90 0 0\\nv 90 0 60\\nv 0 0 60\\nf 1 2 3 4\\n")
        ...     flag = Garment.from_mesh(path, grips=[2, 3])
        >>> flag.repairs
        ('1 faces of four corners or more were cut into triangles', 'its largest extent, 90, was taken for centimetres: ...')
        """
        if up not in (None, "y", "z"):
            raise ValueError(f"up must be 'y' or 'z', not {up!r}")
        if isinstance(loops, str) and loops != "borders":
            raise ValueError(f"loops must be lists of vertex ids, or 'borders', not {loops!r}")
        if size is not None and scale is not None:
            raise ValueError("give size or scale, not both")
        numbers = {"size": size, "scale": scale, "weld": weld, "max_vertices": max_vertices}
        checked = {key: None if value is None else positive(value, key, zero=False) for key, value in numbers.items()}
        cloth = load_cloth(path, loops, grips, up=up, **checked)  # type: ignore[arg-type]
        name = Path(path).stem if name is None else name
        for repair in cloth.repairs:
            _log.warning("%s: %s", path, repair)
        parts = (cloth.vertices, cloth.faces, cloth.loops, cloth.grips)
        return cls(name, *parts, {"scale": cloth.scale}, cloth.repairs)


WARDROBE: Mapping[str, Callable[[], Garment]] = {
    "apron": Garment.apron,
    "apron2": functools.partial(Garment.apron, loops=2),
    "tote": Garment.tote,
    "tote2": functools.partial(Garment.tote, handles=2),
    "backpack": Garment.backpack,
    "shirt": Garment.shirt,
    "vest": Garment.vest,
    "mask": Garment.mask,
    "sheet": Garment.sheet,
    "sheet2": functools.partial(Garment.sheet, holes=2),
}
"""Every garment by the name that episodes record, as a function that makes it at its default sizes."""
