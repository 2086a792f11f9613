"""Garments: triangle meshes that know their true loops and where to be held.

A garment is cut from flat patterns and sewn together. Triangles are near-equilateral, so that a mass-spring cloth behaves
alike in every direction, and the border of an opening keeps its order: it is the true loop.
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._validate import as_points, positive

from . import _wardrobe
from ._mesh import load_cloth
from ._surface import as_ids, check_loop, check_mesh, half_edges

__all__ = ["WARDROBE", "Garment"]

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
_log = logging.getLogger(__name__)


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

    @classmethod
    def apron(
        cls,
        *,
        loops: int = 1,
        spacing: float = 0.03,
        body_width: float = 0.56,
        body_height: float = 0.46,
        bib_width: float = 0.28,
        bib_height: float = 0.30,
        strap_length: float = 0.62,
        strap_width: float = 0.052,
        waist_strap_length: float = 0.90,
        waist_strap_width: float = 0.06,
    ) -> Garment:
        """Return an apron with one loop, its neck strap, or with two; all sizes in metres.

        The apron hangs in the plane y = 0 with the top of its bib at z = 0. The strap is three vertices wide at the
        default spacing and runs from one top corner of the bib to the other; the true loop is the border of the neck
        opening. With `loops=2` a second strap closes behind the waist (towards +y), and the second true loop runs along
        its upper border and across the apron. The grips are on the neck strap, at a third of its length from either end.

        Raises
        ------
        ValueError
            When a size is not positive, the bib is wider than the body, or a strap is too short or too wide to leave an
            opening; with any garment also when the spacing is too coarse for its sizes.
        """
        _one_or_two(loops, "loops")
        sizes = _sizes(locals(), without=("waist_strap_length", "waist_strap_width") if loops == 1 else ())
        return cls(_named("apron", loops), *_wardrobe.apron(sizes, loops), sizes)

    @classmethod
    def tote(
        cls,
        *,
        handles: int = 1,
        spacing: float = 0.03,
        width: float = 0.36,
        height: float = 0.38,
        depth: float = 0.10,
        handle_length: float | None = None,
        handle_width: float = 0.052,
        handle_span: float = 0.20,
    ) -> Garment:
        """Return a bag open at its top, whose panels bulge to `depth`, with one handle or two; sizes in metres.

        The open top is no loop in degree 1, since the bag closes it: a tote has as many classes as handles. One handle
        runs over the top from side to side; of two, each stands on its own panel, `handle_span` between the middles of
        its ends. A handle is `handle_length` long: 0.72 m when it is the only one and 0.50 m otherwise. A true loop is the
        border of the opening under a handle. The grips are on the one handle, at a third of its length from either end, or
        one on each of the two, near the top.

        Raises
        ------
        ValueError
            When a size is not positive, or the handle is too short, or too wide for its span or the bag.
        """
        _one_or_two(handles, "handles")
        handle_length = (0.72 if handles == 1 else 0.50) if handle_length is None else handle_length
        sizes = _sizes(locals(), without=("handle_span",) if handles == 1 else ())
        return cls(_named("tote", handles), *_wardrobe.bag(sizes, handles), sizes)

    @classmethod
    def backpack(
        cls,
        *,
        spacing: float = 0.03,
        width: float = 0.24,
        height: float = 0.60,
        depth: float = 0.12,
        box_height: float = 0.30,
        strap_length: float = 0.66,
        strap_width: float = 0.05,
        strap_angle: float = 40.0,
    ) -> Garment:
        """Return a backpack open at its top: a back, a box below its lower half, two straps; sizes in metres.

        The straps join the sides of the back at its top and just above the box, and are folded by `strap_angle` degrees
        from the plane of the back towards +y. There are two classes; each true loop is the border of the opening between
        a strap and the back, the left one (x < 0) first. There is one grip on each strap.

        Raises
        ------
        ValueError
            When a size is not positive, or the straps are too short, or too wide to leave an opening.
        """
        sizes = _sizes(locals())
        return cls("backpack", *_wardrobe.backpack(sizes), sizes)

    @classmethod
    def shirt(
        cls,
        *,
        spacing: float = 0.035,
        width: float = 0.52,
        length: float = 0.60,
        depth: float = 0.16,
        neck_width: float = 0.24,
        neck_depth: float = 0.09,
        sleeve_length: float = 0.16,
        sleeve_width: float = 0.17,
        sleeve_angle: float = 25.0,
    ) -> Garment:
        """Return a shirt with short sleeves, front towards -y, blown up to `depth`; sizes in metres.

        The loops are its four openings: neck, right sleeve (x > 0), left sleeve, hem. They make three classes: any three
        are independent, the fourth is their sum. The sleeves fall by `sleeve_angle` degrees. The grips are on the
        shoulders of the front.

        Raises
        ------
        ValueError
            When a size is not positive, the neck is wider than the shirt, or the sleeves do not fit it.
        """
        sizes = _sizes(locals())
        return cls("shirt", *_wardrobe.shirt(sizes), sizes)

    @classmethod
    def vest(
        cls,
        *,
        spacing: float = 0.035,
        width: float = 0.52,
        length: float = 0.58,
        depth: float = 0.16,
        neck_width: float = 0.24,
        neck_depth: float = 0.12,
        shoulder_width: float = 0.08,
        armhole_depth: float = 0.24,
    ) -> Garment:
        """Return a vest without sleeves, front towards -y, blown up to `depth`; sizes in metres.

        The loops are its four openings: neck, right armhole (x > 0), left armhole, hem. They make three classes: any
        three are independent, the fourth is their sum. The grips are on the shoulders of the front.

        Raises
        ------
        ValueError
            When a size is not positive, or the shoulders and armholes do not fit the width and the length.
        """
        sizes = _sizes(locals())
        return cls("vest", *_wardrobe.vest(sizes), sizes)

    @classmethod
    def mask(
        cls,
        *,
        spacing: float = 0.016,
        width: float = 0.18,
        height: float = 0.20,
        depth: float = 0.04,
        bow: float = 0.02,
        strap_length: float = 0.34,
        strap_width: float = 0.03,
        strap_span: float = 0.12,
    ) -> Garment:
        """Return a face mask with two ear loops, hung by one of them, the other one below; sizes in metres.

        The cloth is cupped by `depth` towards -y and its sides bow out by `bow`; `strap_span` lies between the middles of
        a strap's ends. There are two classes; the true loops are the borders of the openings, the upper one first. The
        grips are on the upper ear loop.

        Raises
        ------
        ValueError
            When a size is not positive, or the ear loops do not fit the mask or leave no opening.
        """
        sizes = _sizes(locals())
        return cls("mask", *_wardrobe.mask(sizes), sizes)

    @classmethod
    def sheet(
        cls,
        *,
        holes: int = 1,
        spacing: float = 0.03,
        width: float = 0.60,
        height: float = 0.50,
        hole_radius: float = 0.08,
        hole_drop: float = 0.16,
        hole_distance: float = 0.26,
    ) -> Garment:
        """Return a rectangle of cloth with one round hole, or two side by side; sizes in metres.

        The middles of the holes lie `hole_drop` below the upper edge, z = 0; the true loops are their borders, the left
        one (x < 0) first. The grips are the upper corners.

        Raises
        ------
        ValueError
            When a size is not positive, or the holes do not fit the sheet or each other.
        """
        _one_or_two(holes, "holes")
        sizes = _sizes(locals(), without=("hole_distance",) if holes == 1 else ())
        return cls(_named("sheet", holes), *_wardrobe.sheet(sizes, holes), sizes)

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


def _sizes(given: Mapping[str, Any], without: Sequence[str] = ()) -> dict[str, float]:
    """The sizes among a method's arguments, each a positive number; an angle lies between 0 and 80 degrees."""
    skip = {"cls", "loops", "handles", "holes", *without}
    sizes = {
        name: positive(value, name, zero=name.endswith("_angle")) for name, value in given.items() if name not in skip
    }
    for name, value in sizes.items():
        if name.endswith("_angle") and value > 80:
            raise ValueError(f"{name} must be 0 to 80 degrees, not {value}")
    return sizes


def _one_or_two(number: int, name: str) -> None:
    if number not in (1, 2):
        raise ValueError(f"{name} must be 1 or 2, not {number!r}")


def _named(kind: str, number: int) -> str:
    return kind if number == 1 else f"{kind}{number}"
