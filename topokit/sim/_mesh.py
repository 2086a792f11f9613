"""Make a cloth of a mesh as it comes: what is safe is repaired and said in words, what would change it is refused."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from topokit._validate import as_ids, positive
from topokit.linking import side_lengths

from . import _surface
from ._names import is_flat, kind, named
from ._read import read_mesh
from ._surface import Array, EdgeGraph, Ids, border_cycles, components, edge_lengths, half_edges, joined, wind

_log = logging.getLogger("topokit.sim")
_WELD = 1e-5  # of the diagonal of the bounding box: what six decimals leave of one place, and less than any edge
_METRES = (0.15, 2.2)  # largest extent of a garment in metres
# Which axes of the file become x, y and z, and their signs, for the axis that points up.
_UP = {"x": ([2, 1, 0], (-1, 1, 1)), "y": ([0, 2, 1], (1, -1, 1)), "z": ([0, 1, 2], (1, 1, 1))}
_AXES = (*_UP, *(f"-{axis}" for axis in _UP))
_UNITS = ((1.0, "metres"), (0.001, "millimetres"), (0.01, "centimetres"))


def from_mesh(
    path: str | Path,
    *,
    loops: Mapping[str, ArrayLike] | Sequence[ArrayLike] | Literal["borders", "auto"] = (),
    grips: ArrayLike | None = None,
    size: float | None = None,
    scale: float | None = None,
    up: Literal["x", "y", "z", "-x", "-y", "-z"] | None = None,
    weld: float | None = None,
    max_vertices: int = 3000,
) -> tuple[str, Array, Ids, tuple[Ids, ...], Ids, dict[str, float], tuple[str, ...], tuple[str, ...]]:
    """Return the garment of an OBJ, PLY or STL file as it comes; what had to be repaired is in `repairs` and logged.

    Vertices at one place are welded; vertices in no face, faces without three different vertices or on another one, and
    small components are dropped; polygons are cut into triangles, and faces turned to agree with their neighbours.

    Parameters
    ----------
    path : str or Path
        Of all objects and groups of an OBJ file the garment is made.
    loops : sequence of sequences of int, mapping of str to them, "borders", or "auto"
        Vertex ids of the true loops as the file numbers them, counted from 0 (in an STL file, corner k of triangle i is
        3 i + k). Gaps of up to four edges are closed along the mesh; given in no order, the cycle they lie around is found
        by persistence. With "borders", every border of the mesh, the longest first; with "auto", without the one that goes
        around all others, and where the borders do not show all classes, those that persistence finds along the mesh. In a
        mapping each has the name that tasks ask for ("neck", "handle 1", ...); otherwise it gets one by place and size.
    grips : (2,) int, optional
        Vertex ids as the file numbers them; two near the top when not given, to the left and to the right.
    size : float, optional
        Largest extent that the garment shall have, metres.
    scale : float, optional
        Metres in one unit of the file. When neither is given: metres, millimetres or centimetres, the first that make
        the largest extent 0.15 to 2.2 m; else it is made 1 m.
    up : {"x", "y", "z", "-x", "-y", "-z"}, optional
        The axis that points up; when not given, y or z, the one along which the grips lie higher, or the garment is longer.
    weld : float, optional
        Distance within which vertices are one, in the file's units; what rounding leaves when not given.
    max_vertices : int
        More of them are refused.

    Raises
    ------
    ValueError, TypeError
        When an option, a loop or a grip cannot be meant; the message says which, where, and what to do.
    """
    for key, value in (("size", size), ("scale", scale), ("weld", weld), ("max_vertices", max_vertices)):
        if value is not None:
            positive(value, key, zero=False)
    if up not in (None, *_AXES):
        raise ValueError(f"up must be one of {', '.join(_AXES)}, not {up!r}")
    if isinstance(loops, str) and loops not in ("borders", "auto"):
        raise ValueError(f"loops must be lists of vertex ids, 'borders' or 'auto', not {loops!r}")
    if size is not None and scale is not None:
        raise ValueError("give size or scale, not both")
    vertices, polygons = read_mesh(path)
    if sum(len(polygon) ** 2 for polygon in polygons) > 3e7:  # some seconds of cutting them into triangles
        raise ValueError(f"{path}: {len(polygons)} faces are more than can be cut into triangles; decimate it")
    said: list[str] = []
    try:
        faces, vertex_of, names = _repaired(vertices, polygons, weld, said)
        if len(names) > max_vertices:
            raise ValueError(f"{len(names)} vertices after repair; more than {max_vertices}; decimate the mesh")
        new = np.full(len(vertices), -1)
        new[names] = np.arange(len(names))
        known = loops if isinstance(loops, Mapping) else dict(enumerate(() if isinstance(loops, str) else loops))
        carried = [_carry(loop, new[vertex_of], f"loops[{i!r}]") for i, loop in known.items()]
        ends = None if grips is None else _carry(grips, new[vertex_of], "grips")
        turned = _upright(vertices[names], ends, up, said)
        placed, factor = _scaled(turned, size, scale, said)
        _say_lying(placed, ends, up, said)
        _say_short(placed, faces, names, said)
        _say_open(placed, faces, loops, said)
        found = _found(placed, faces, loops if isinstance(loops, str) else "", said)
        cycles = (*found, *_closed(placed, faces, names, dict(zip(known, carried, strict=True)), said))
        called = tuple(loops) if isinstance(loops, Mapping) else named(placed, faces, cycles)
        if loops == "auto":
            kept = [i for i, name in enumerate(called) if kind(name) != "edge"]
            cycles, called = tuple(cycles[i] for i in kept), tuple(called[i] for i in kept)
        if found:
            said.append(f"by place and size they were called {', '.join(called)}")
        ends = _grips(placed, names, dict(zip(called, cycles, strict=True)), said) if ends is None else ends
    except ValueError as error:
        raise type(error)(f"{path}: {error}") from error
    for repair in said:
        _log.warning("%s: %s", path, repair)
    return Path(path).stem, placed, faces, cycles, ends, {"scale": factor}, tuple(said), called


def _note(said: list[str], count: int, what: str) -> None:
    if count:
        said.append(f"{count} {what}")


def _repaired(
    vertices: Array, polygons: Sequence[Sequence[int]], weld: float | None, said: list[str]
) -> tuple[Ids, Ids, Ids]:
    """Faces of the one component that is the cloth; for each vertex of the file the one it is now; those that are left."""
    _note(said, sum(len(corners) > 3 for corners in polygons), "faces of four corners or more were cut into triangles")
    named = np.unique(list(itertools.chain(*polygons)))  # a vertex in no face may be anywhere, and is dropped later
    lost = named[~(np.abs(vertices[named]) < 1e100).all(axis=1)]
    if len(lost):
        raise ValueError(f"vertex {lost[0]} is at {vertices[lost[0]].tolist()}; every vertex of a face needs a place")
    faces = np.array([triangle for polygon in polygons for triangle in _ears(vertices, list(polygon))], dtype=np.int64)
    vertex_of = _weld(vertices, _rounding(vertices, faces) if weld is None else weld, said)
    faces = _one_component(vertices, _clean(vertex_of[faces], said), said)
    names, flat = np.unique(faces, return_inverse=True)
    _note(said, len(np.unique(vertex_of)) - len(names), "vertices in none of the faces kept were dropped")
    faces, turned, two_sided = wind(flat.reshape(-1, 3))
    _note(said, turned, "faces were turned round to agree with their neighbours")
    if not two_sided:
        said.append("the surface has one side (as a Moebius strip has): its faces cannot all agree, and were left so")
    many = int((np.unique(half_edges(faces), axis=0, return_counts=True)[1] > 2).sum())
    _note(said, many, "edges in more than two faces, as where a strap is sewn on, were kept")
    return faces, vertex_of, names


def _ears(vertices: Array, polygon: list[int]) -> Iterable[list[int]]:
    """Cut a polygon into triangles, each time at the shortest diagonal that leaves a corner on its outer side."""
    while len(polygon) > 3:
        here = vertices[polygon]
        before, after = np.roll(here, 1, axis=0), np.roll(here, -1, axis=0)
        turn = np.cross(here - before, after - here)
        inward = turn @ np.cross(here, after).sum(axis=0) < 0  # against the polygon's own normal (Newell)
        corner = int(np.argmin(np.linalg.norm(after - before, axis=1) + np.where(inward, np.inf, 0.0)))
        yield [polygon[corner - 1], polygon[corner], polygon[(corner + 1) % len(polygon)]]
        del polygon[corner]
    yield polygon


def _rounding(vertices: Array, faces: Ids) -> float:
    """What six decimals leave of one place, and much less than an edge even where one vertex lies far off."""
    length = np.linalg.norm(vertices[faces] - vertices[np.roll(faces, 1, axis=1)], axis=2)
    diagonal = float(np.linalg.norm(np.ptp(vertices[faces].reshape(-1, 3), axis=0)))
    usual = float(np.median(length[length > 0])) if length.any() else 0.0
    return min(_WELD * diagonal, 0.01 * usual)


def _weld(vertices: Array, distance: float, said: list[str]) -> Ids:
    """(n,) for each vertex the first of those at its place."""
    places, at, same = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    finite = at[(np.abs(places) < 1e100).all(axis=1)]
    tree = cKDTree(vertices[finite])
    if tree.count_neighbors(tree, distance) > 100 * len(vertices):  # all pairs would fill the memory
        raise ValueError(f"most vertices lie within {distance:.2g} of a hundred others; weld less, or mend the mesh")
    near = finite[tree.query_pairs(distance, output_type="ndarray")]
    pairs = np.concatenate([near, np.column_stack([np.arange(len(vertices)), at[same.ravel()]])])
    _, first, inverse = np.unique(joined(pairs, len(vertices)), return_index=True, return_inverse=True)
    what = f"vertices within {distance:.2g} of another one (in the file's units) were welded to it"
    _note(said, len(vertices) - len(first), what)
    return np.asarray(first[inverse.ravel()])


def _clean(faces: Ids, said: list[str]) -> Ids:
    whole = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    _note(said, len(faces) - len(whole), "faces without area, which named a vertex twice, were dropped")
    _, first = np.unique(np.sort(whole, axis=1), axis=0, return_index=True)
    _note(said, len(whole) - len(first), "faces that lay on another one were dropped")
    if not len(first):
        raise ValueError("no face with three different vertices is left")
    return whole[np.sort(first)]


def _one_component(vertices: Array, faces: Ids, said: list[str]) -> Ids:
    area, which = _surface.face_areas(vertices, faces), components(faces)
    parts = which.max() + 1
    if parts == 1:
        return faces
    share = np.bincount(which, area + 1e-300) / (area + 1e-300).sum()
    largest = np.argsort(share)[::-1]
    if share[largest[0]] < 0.6:
        shares = ", ".join(f"{100 * part:.0f} %" for part in share[largest[:5]])
        one, other = (np.unique(faces[which == part]) for part in largest[:2])
        gap = cKDTree(vertices[one]).query(vertices[other])[0].min()
        what = f"{parts} components that no edge joins, of {shares} of the surface"
        raise ValueError(f"{what}: keep one, or weld more than {gap:.2g}")
    lost = f"{100 * (1 - share.max()):.1f} % of the surface"
    said.append(f"{parts - 1} smaller components, {lost}, were dropped: a cloth is one piece")
    return faces[which == np.argmax(share)]


def _say_short(vertices: Array, faces: Ids, names: Ids, said: list[str]) -> None:
    """A very short edge is legal, but the engine's collision margin follows the shortest one."""
    edges = np.unique(half_edges(faces), axis=0)
    length = edge_lengths(vertices, edges)
    a, b = names[edges[np.argmin(length)]]
    if length.min() == 0:
        raise ValueError(f"vertices {a} and {b} are at one place; weld them")
    if length.min() < 0.05 * np.median(length):
        said.append(f"vertices {a} and {b} are only {length.min():.2g} m apart; weld them, or collisions are as thin")


def _carry(given: ArrayLike, new: Ids, name: str) -> Ids:
    """What the vertices of a loop or the grips are now, `new` of the file's."""
    ids = as_ids(given, name, len(new))
    if ids.ndim != 1:
        raise ValueError(f"{name} must be a list of vertex ids; loops is a list of lists, of one loop, too")
    lost = new[ids] < 0
    if lost.any():
        raise ValueError(f"{name} names vertex {ids[np.argmax(lost)]}, which is in no face of the garment's component")
    if name == "grips" and (len(ids) != 2 or new[ids[0]] == new[ids[1]]):
        raise ValueError(f"grips must be two vertex ids that are not one vertex after welding, not {ids.tolist()}")
    return new[ids]


def _upright(vertices: Array, grips: Ids | None, up: str | None, said: list[str]) -> Array:
    """Vertices with z up. Grips are above the middle; without them, a garment hangs and does not lie."""
    if up is None:
        half = np.ptp(vertices, axis=0) / 2
        above = half if grips is None else vertices[grips].mean(axis=0) - (vertices.min(axis=0) + half)
        up = "y" if above[1] > (1.7 if grips is None else 1.0) * abs(above[2]) else "z"
        if up == "y":
            said.append("its y axis was taken for up and turned to z; give up='z' if it is not")
    order, signs = _UP[up[-1]]
    return vertices[:, order] * signs * ([-1, 1, -1] if up[0] == "-" else [1, 1, 1])


def _say_lying(vertices: Array, grips: Ids | None, up: str | None, said: list[str]) -> None:
    """Refuse grips at the floor; say so where the garment seems to lie."""
    z, (wide, deep, high) = vertices[:, 2], np.ptp(vertices, axis=0)
    if grips is not None and z[grips].mean() < z.min() + high / 3:
        raise ValueError("its grips would be in the lowest third, near the floor: say which axis is up (up='-z')")
    if up is None and high < min(wide, deep):
        said.append("it seems to lie: its thinnest axis is upright; say which axis is up if it is not z")


def _say_open(vertices: Array, faces: Ids, loops: Any, said: list[str]) -> None:
    """Where loops are to be found: say so when a border of a garment that is not flat runs from its top to its bottom."""
    low, high = vertices[:, 2].min(), np.ptp(vertices[:, 2])
    for border in border_cycles(faces) if isinstance(loops, str) and not is_flat(vertices, faces) else []:
        z = (vertices[border, 2] - low) / high
        if z.min() < 0.1 and z.max() > 0.8:
            one = f"neck, slit and hem are one border of {len(border)} vertices: an open front"
            said.append(f"{one}; close it, or give loops by vertex ids")


def _scaled(vertices: Array, size: float | None, scale: float | None, said: list[str]) -> tuple[Array, float]:
    largest = float(np.ptp(vertices, axis=0).max())
    if largest < 1e-100:
        raise ValueError(f"its largest extent is {largest:.3g}, which is too small to measure its edges; scale it up")
    if size is not None:
        scale = size / largest
    elif scale is None:
        low, high = _METRES
        scale, unit = next(((f, unit) for f, unit in _UNITS if low <= f * largest <= high), (1 / largest, "no unit"))
        if unit != "metres":
            metres = f"{unit}: {scale * largest:.3g} m; give size or scale"
            said.append(f"its largest extent, {largest:.4g}, was taken for {metres}")
    vertices = scale * vertices
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    if np.linalg.norm(middle) > 10 * scale * largest:  # single precision in the engine would blur it
        said.append(f"it lay {np.linalg.norm(middle):.3g} m from the origin, and was moved there")
        vertices = vertices - middle
    return vertices, float(scale)


def _closed(vertices: Array, faces: Ids, names: Ids, loops: Mapping[Any, Ids], said: list[str]) -> tuple[Ids, ...]:
    graph = EdgeGraph(vertices, np.unique(half_edges(faces), axis=0))
    cycles = []
    for i, loop in loops.items():
        try:
            cycle, how = graph.close(loop.tolist(), names)
        except ValueError as error:
            raise ValueError(f"loops[{i!r}] cannot be followed along the mesh: {error}") from error
        if how:
            said.append(f"loops[{i!r}]: {how}")
        cycles.append(cycle)
    return tuple(cycles)


def _found(vertices: Array, faces: Ids, how: str, said: list[str]) -> tuple[Ids, ...]:
    """Loops that nobody marked, the longest first: the borders, or by persistence where there are more classes than they show."""
    edges, cycles = np.unique(half_edges(faces), axis=0), border_cycles(faces)
    classes = 1 - len(vertices) + len(edges) - len(faces) + (not cycles)
    if not cycles and (how == "borders" or not classes):
        what = "every edge is in two faces or more, as of a closed solid, and a cloth has borders"
        raise ValueError(f"{what}: open it, leave out its inner side, or give loops by vertex ids")
    what = "borders were found"
    if how == "auto" and classes >= max(len(cycles), 1):
        cycles, what = EdgeGraph(vertices, edges).loops(classes), "loops were found by persistence along the mesh"
    if how:
        said.append(f"{len(cycles)} {what}, the longest first")
    return tuple(sorted(cycles, key=lambda cycle: -side_lengths(vertices[cycle]).sum())) if how else ()


def _grips(vertices: Array, names: Ids, loops: Mapping[str, Ids], said: list[str]) -> Ids:
    """The tops of two handles or straps, the sides of a tube's neck; else the leftmost and rightmost near the top."""
    x = vertices[:, 0]
    pair = [loop for name, loop in loops.items() if kind(name) in ("handle", "strap")]
    if "hem" in loops and "neck" in loops:
        neck = loops["neck"]
        held = [int(neck[np.argmin(x[neck])]), int(neck[np.argmax(x[neck])])]
    elif len(pair) == 2:
        held = [_top(vertices[loop], loop) for loop in sorted(pair, key=lambda loop: float(x[loop].mean()))]
    else:
        held = _outermost(vertices)
    said.append(f"vertices {names[held[0]]} and {names[held[1]]}, left and right near the top, were taken for grips")
    return np.array(held)


def _top(curve: Array, loop: Ids) -> int:
    """The vertex of a loop near its top that is nearest to above its middle, from which both sides hang alike."""
    high = curve[:, 2] >= curve[:, 2].max() - 0.15 * np.ptp(curve[:, 2])
    beside = np.linalg.norm(curve[:, :2] - curve[:, :2].mean(axis=0), axis=1)
    return int(loop[np.argmin(np.where(high, beside, np.inf))])


def _outermost(vertices: Array) -> list[int]:
    """The leftmost and the rightmost vertex near the top, the higher of two as far out."""
    x, _, z = vertices.T
    for share in (0.1, 0.3, 1.0):
        top = np.flatnonzero(z >= z.max() - share * np.ptp(z))
        left, right = (top[np.lexsort((-z[top], side * x[top]))][0] for side in (1, -1))
        if x[right] - x[left] > 0.1 * np.ptp(x):
            break
    if left == right:
        left, right = int(np.argmax(z)), int(np.argmin(z))
    return [int(left), int(right)]
