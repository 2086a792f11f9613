"""Make a cloth of a mesh as it comes: welded, in one piece, in metres, with the ids of its file carried along.

What is safe is repaired and said in words; what would change the garment is refused.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from topokit._archive import FormatError

from ._read import read_mesh
from ._surface import EdgeGraph, as_ids, border_cycles, close_loop, components, half_edges, wind

__all__ = ["Cloth", "load_cloth"]

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
_WELD = 1e-5  # of the diagonal of the bounding box: what six decimals leave of one place, and less than any edge
_METRES = (0.15, 2.5)  # largest extent of a garment in metres
_UNITS = ((1.0, "metres"), (0.001, "millimetres"), (0.01, "centimetres"))


@dataclass(frozen=True)
class Cloth:
    """The parts of a `Garment` read from a file, and what was done to them, in words."""

    vertices: Array
    faces: Ids
    loops: tuple[Ids, ...]
    grips: Ids
    scale: float
    repairs: tuple[str, ...]


def load_cloth(
    path: str | Path,
    loops: Sequence[ArrayLike] | str,
    grips: ArrayLike | None,
    *,
    size: float | None,
    scale: float | None,
    up: str | None,
    weld: float | None,
    max_vertices: int,
) -> Cloth:
    """Read, repair and place a mesh; the options are those of `Garment.from_mesh`."""
    vertices, polygons = read_mesh(path)
    said: list[str] = []
    try:
        given, held = _asked(loops, grips, len(vertices))
        faces = _triangles(vertices, polygons, said)
        _check_finite(vertices, faces)
        vertex_of = _weld(vertices, _rounding(vertices, faces) if weld is None else weld, said)
        faces = _clean(vertex_of[faces], said)
        faces = _one_component(vertices, faces, said)
        names, flat = np.unique(faces, return_inverse=True)
        faces = flat.reshape(-1, 3)
        _say_unused(len(np.unique(vertex_of)) - len(names), said)
        if len(names) > max_vertices:
            raise ValueError(
                f"{len(names)} vertices after repair; more than {max_vertices:.0f} make a slow simulation. Decimate the mesh "
                "(in Blender or MeshLab), or raise max_vertices"
            )
        faces = _wound(faces, said)
        new = np.full(len(vertices), -1)
        new[names] = np.arange(len(names))
        carried = [_carry(loop, new[vertex_of], f"loops[{i}]") for i, loop in enumerate(given)]
        ends = None if held is None else _carry(held, new[vertex_of], "grips")
        if ends is not None and ends[0] == ends[1]:
            raise ValueError(f"grips {held} are one vertex after welding; give two that lie apart")
        placed, factor = _placed(vertices[names], ends, size, scale, up, said)
        _say_short(placed, faces, names, said)
        cycles = _cycles(placed, faces, names, loops if isinstance(loops, str) else carried, said)
        return Cloth(placed, faces, cycles, _grips(placed, names, said) if ends is None else ends, factor, tuple(said))
    except FormatError:
        raise
    except (TypeError, ValueError) as error:
        raise (TypeError if isinstance(error, TypeError) else ValueError)(f"{path}: {error}") from error


def _asked(loops: Sequence[ArrayLike] | str, grips: ArrayLike | None, n_vertices: int) -> tuple[list[Ids], Ids | None]:
    """The ids of loops and grips, when they are ids of the file."""
    given = [] if isinstance(loops, str) else [as_ids(loop, f"loops[{i}]", n_vertices) for i, loop in enumerate(loops)]
    if any(loop.ndim != 1 for loop in given):
        raise ValueError("loops must be a list of lists of vertex ids; one loop is a list of one list")
    held = None if grips is None else as_ids(grips, "grips", n_vertices)
    if held is not None and held.shape != (2,):
        raise ValueError(f"grips must be two vertex ids, not of shape {held.shape}")
    return given, held


def _triangles(vertices: Array, polygons: Sequence[Sequence[int]], said: list[str]) -> Ids:
    large = sum(len(polygon) > 3 for polygon in polygons)
    if large:
        said.append(f"{large} faces of four corners or more were cut into triangles")
    return np.array([triangle for polygon in polygons for triangle in _ears(vertices, list(polygon))], dtype=np.int64)


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


def _check_finite(vertices: Array, faces: Ids) -> None:
    """Refuse a face at a place that is no place; a vertex in no face may be anything, and is dropped later."""
    lost = np.asarray(~np.isfinite(vertices).all(axis=1))
    if lost[faces].any():
        vertex = faces[lost[faces]][0]
        raise ValueError(f"vertex {vertex} is at {vertices[vertex].tolist()}; every vertex of a face needs a place")


def _rounding(vertices: Array, faces: Ids) -> float:
    """What six decimals leave of one place, and much less than an edge even where one vertex lies far off."""
    length = np.linalg.norm(vertices[faces] - vertices[np.roll(faces, 1, axis=1)], axis=2)
    diagonal = float(np.linalg.norm(np.ptp(vertices[faces].reshape(-1, 3), axis=0)))
    usual = float(np.median(length[length > 0])) if length.any() else 0.0
    return min(_WELD * diagonal, 0.01 * usual)


def _weld(vertices: Array, distance: float, said: list[str]) -> Ids:
    """(n,) for each vertex the first of those at its place."""
    places, at, same = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    finite = at[np.isfinite(places).all(axis=1)]
    near = finite[cKDTree(vertices[finite]).query_pairs(distance, output_type="ndarray")]
    pairs = np.concatenate([near, np.column_stack([np.arange(len(vertices)), at[same.ravel()]])])
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(vertices),) * 2)
    _, label = connected_components(graph, directed=False)
    _, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    double = len(vertices) - len(first)
    if double:
        said.append(f"{double} vertices within {distance:.2g} of another one (in the file's units) were welded to it")
    return np.asarray(first[inverse.ravel()])


def _clean(faces: Ids, said: list[str]) -> Ids:
    """Drop faces that name a vertex twice, and all but the first of faces on the same three vertices."""
    whole = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    if len(whole) < len(faces):
        said.append(f"{len(faces) - len(whole)} faces without area, which named a vertex twice, were dropped")
    _, first = np.unique(np.sort(whole, axis=1), axis=0, return_index=True)
    if len(first) < len(whole):
        said.append(f"{len(whole) - len(first)} faces that lay on another one were dropped")
    if not len(first):
        raise ValueError("no face with three different vertices is left")
    return whole[np.sort(first)]


def _one_component(vertices: Array, faces: Ids, said: list[str]) -> Ids:
    """Keep the largest component; refuse where that would take away much of the surface."""
    corners = vertices[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    parts, which = np.unique(components(faces), return_inverse=True)
    if len(parts) == 1:
        return faces
    share = np.bincount(which.ravel(), area + 1e-300) / (area + 1e-300).sum()
    if share.max() < 0.6:
        shares = ", ".join(f"{100 * part:.0f} %" for part in np.sort(share)[:-6:-1])
        one, other = (np.unique(faces[which.ravel() == part]) for part in np.argsort(share)[:-3:-1])
        gap = cKDTree(vertices[one]).query(vertices[other])[0].min()
        raise ValueError(
            f"{len(parts)} components that no edge joins, of {shares} of the surface: none is the garment. Sew them together, "
            f"or save the one that you mean to a file of its own; a gap is closed by a larger weld (vertices of the two largest "
            f"come as near as {gap:.2g}, in the file's units)"
        )
    said.append(
        f"{len(parts) - 1} smaller components, {100 * (1 - share.max()):.1f} % of the surface, were dropped: "
        "a cloth is one piece"
    )
    return faces[which.ravel() == np.argmax(share)]


def _say_unused(unused: int, said: list[str]) -> None:
    if unused:
        said.append(f"{unused} vertices in none of the faces kept were dropped")


def _wound(faces: Ids, said: list[str]) -> Ids:
    faces, turned, two_sided = wind(faces)
    if turned:
        said.append(f"{turned} faces were turned round to agree with their neighbours")
    if not two_sided:
        said.append("the surface has one side (as a Moebius strip has): its faces cannot all agree, and were left so")
    many = int((np.unique(half_edges(faces), axis=0, return_counts=True)[1] > 2).sum())
    if many:
        said.append(f"{many} edges in more than two faces, as where a strap is sewn on, were kept")
    return faces


def _say_short(vertices: Array, faces: Ids, names: Ids, said: list[str]) -> None:
    """A very short edge is legal, but the engine's collision margin follows the shortest one."""
    edges = np.unique(half_edges(faces), axis=0)
    length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    if length.min() < 0.05 * np.median(length):
        a, b = names[edges[np.argmin(length)]]
        said.append(
            f"vertices {a} and {b} are only {length.min():.2g} m apart, and so thin is the cloth to collisions (the median edge "
            f"has {np.median(length):.2g} m); a larger weld distance joins them"
        )


def _carry(ids: Ids, new: Ids, name: str) -> Ids:
    lost = new[ids] < 0
    if lost.any():
        raise ValueError(
            f"{name} names vertex {ids[np.argmax(lost)]}, which is in no face of the garment's component; it cannot be kept"
        )
    return new[ids]


def _placed(
    vertices: Array, grips: Ids | None, size: float | None, scale: float | None, up: str | None, said: list[str]
) -> tuple[Array, float]:
    """Vertices in metres, z up."""
    extent = np.ptp(vertices, axis=0)
    if up is None:  # grips are above the middle; without them, a garment hangs and does not lie
        above = extent / 2 if grips is None else vertices[grips].mean(axis=0) - (vertices.min(axis=0) + extent / 2)
        up = "y" if above[1] > (1.7 if grips is None else 1.0) * abs(above[2]) else "z"
        if up == "y":
            said.append("its y axis was taken for up and turned to z; give up='z' if it is not")
    if up == "y":
        vertices = vertices[:, [0, 2, 1]] * [1, -1, 1]
    largest = float(extent.max())
    if size is not None:
        scale = size / largest
    elif scale is None:
        low, high = _METRES
        scale, unit = next(((f, unit) for f, unit in _UNITS if low <= f * largest <= high), (1 / largest, ""))
        if not unit:
            said.append(
                f"its largest extent, {largest:.4g}, is a garment's in no unit: it was made 1 m; give size or scale"
            )
        elif unit != "metres":
            said.append(
                f"its largest extent, {largest:.4g}, was taken for {unit}: {scale * largest:.3g} m; give size or scale"
            )
    vertices = scale * vertices
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    if np.linalg.norm(middle) > 10 * scale * largest:  # single precision in the engine would blur it
        said.append(f"it lay {np.linalg.norm(middle):.3g} m from the origin, and was moved there")
        vertices = vertices - middle
    return vertices, float(scale)


def _cycles(vertices: Array, faces: Ids, names: Ids, loops: str | Sequence[Ids], said: list[str]) -> tuple[Ids, ...]:
    if isinstance(loops, str):
        cycles = border_cycles(faces)
        lengths = [np.linalg.norm(vertices[c] - vertices[np.roll(c, 1)], axis=1).sum() for c in cycles]
        said.append(f"{len(cycles)} borders were taken for loops, the longest first")
        return tuple(cycles[i] for i in np.argsort(-np.array(lengths), kind="stable"))
    graph = EdgeGraph(vertices, np.unique(half_edges(faces), axis=0))
    closed = []
    for i, loop in enumerate(loops):
        try:
            cycle, how = close_loop(graph, loop.tolist(), names)
        except ValueError as error:
            raise ValueError(f"loops[{i}] cannot be followed along the mesh: {error}") from error
        if how:
            said.append(f"loops[{i}]: {how}")
        closed.append(cycle)
    return tuple(closed)


def _grips(vertices: Array, names: Ids, said: list[str]) -> Ids:
    """The leftmost and the rightmost vertex near the top, the higher of two as far out."""
    x, _, z = vertices.T
    for share in (0.1, 0.3, 1.0):
        top = np.flatnonzero(z >= z.max() - share * np.ptp(z))
        order = top[np.lexsort((-z[top], x[top]))]
        left, right = order[0], top[np.lexsort((-z[top], -x[top]))][0]
        if x[right] - x[left] > 0.1 * np.ptp(x):
            break
    if left == right:
        left, right = int(np.argmax(z)), int(np.argmin(z))
    said.append(f"vertices {names[left]} and {names[right]}, left and right near the top, were taken for grips")
    return np.array([left, right])
