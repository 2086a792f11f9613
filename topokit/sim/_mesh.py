"""Make a cloth of the mesh of a file: safe repairs are made and reported in words, all others are refused."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from topokit._strangers import printable
from topokit._validate import as_ids, positive
from topokit.linking import side_lengths

from ._even import simplified
from ._names import is_flat, is_open_front, kind, named
from ._read import read_mesh
from ._surface import (
    Array,
    EdgeGraph,
    Ids,
    border_cycles,
    component_of,
    components,
    edge_lengths,
    face_areas,
    half_edges,
    is_inside,
    of_three_vertices,
    once_each,
    vector_area,
    weighted,
    wind,
)

_log = logging.getLogger("topokit.sim")
_WELD = 1e-5  # of the diagonal of the bounding box: what six decimals leave of one place, and less than any edge
_COPIES = 30  # vertices of a file, at most, for each that the cloth may have: copies of it, and other components
_FEW = 4  # edges of a hole that is only a missing face or two
_STAR = 7  # edges of a hole, at most, that is left where the faces around a vertex are missing
_NEAR_LOOP = 0.2  # of its length: what is nearer to a loop may be the strap itself
_STRAP = 0.3  # of its length: how far the middle of a strap is from the body, at least
_APART = 0.2  # of the width: how far apart the middles of two straps are at least
_SQUARE = 1.05  # depth over width below which a garment is as deep as it is wide
_LONGER = 1.7  # height over depth from which on the height is surely up
# How much less a garment is like its mirror image upside down: of its size, and as a ratio.
_LIKE_MIRRORED = (0.04, 3.0)
_ROUND_A_ROD = 0.1  # metres: a shorter loop fits closely around a rod of 3 cm
_METRES = (0.15, 2.2)  # largest extent of a garment in metres
# Which axes of the file become x, y and z, and their signs, for the axis that points up.
_UP = {"x": ([2, 1, 0], (-1, 1, 1)), "y": ([0, 2, 1], (1, -1, 1)), "z": ([0, 1, 2], (1, 1, 1))}
_AXES = (*_UP, *(f"-{axis}" for axis in _UP))
_logged: set[str] = set()  # what this process has logged
_TURNED = "its y axis was taken for up and turned to z; give up='z' (--up z) if it is not"
_UNCLEAR = "whether its y or its z axis points up is unclear, and z was taken; give up='y' (--up y) if it is y"
_UNITS = ((1.0, "metres"), (0.001, "millimetres"), (0.01, "centimetres"))


class Read(NamedTuple):
    """What is made of a mesh file."""

    vertices: Array
    faces: Ids
    loops: tuple[Ids, ...]
    grips: Ids
    loop_names: tuple[str, ...]
    scale: float
    repairs: tuple[str, ...]


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
) -> Read:
    """Return the garment of an OBJ, PLY or STL file; what had to be repaired is in `repairs` and logged.

    Vertices at one place are welded; vertices in no face, faces without three different vertices or on another one, and
    small components are dropped; polygons are cut into triangles, and faces turned to agree with their neighbours.

    Parameters
    ----------
    path : str or Path
        All objects and groups of an OBJ file together are the garment.
    loops : sequence of sequences of int, mapping of str to them, "borders", or "auto"
        Vertex ids of the true loops as the file numbers them, counted from 0 (in an STL file, corner k of triangle i is
        3 i + k). Gaps of up to four edges are closed along the mesh. For vertices in no order, persistence finds the cycle
        that they lie around. "borders" takes every border of the mesh, the longest first. "auto" leaves out the border that
        goes around all others; where the borders do not show all classes, it takes the loops that persistence finds along
        the mesh. In a mapping each loop has the name that tasks ask for ("neck", "handle 1", ...); otherwise it gets a name
        by place and size.
    grips : (2,) int, optional
        Vertex ids as the file numbers them. When not given: the sides of a shirt's neck, the middles of two straps, handles or
        ear loops, two places on one strap, or else two vertices near the top, to the left and to the right.
    size : float, optional
        Largest extent that the garment shall have, metres.
    scale : float, optional
        Metres in one unit of the file. When neither size nor scale is given: the first of metres, millimetres and
        centimetres that makes the largest extent 0.15 to 2.2 m; if none does, the largest extent becomes 1 m.
    up : {"x", "y", "z", "-x", "-y", "-z"}, optional
        The axis that points up. When not given, y or z: the one along which the grips lie higher, or along which the widest
        border faces, or the garment is longer. Without grips it is then turned about that axis to be wider than deep.
    weld : float, optional
        Distance within which vertices are one, in the file's units. When not given, the size of rounding errors.
    max_vertices : int
        A mesh with more of them is simplified to at most as many, with loops and grips at the nearest vertices that are left.
        A file with 30 times as many is refused before it is read.

    Raises
    ------
    ValueError, TypeError
        When an option, a loop or a grip cannot be right; the message says which, where, and what to do.
    """
    for option, value in (("size", size), ("scale", scale), ("weld", weld), ("max_vertices", max_vertices)):
        if value is not None:
            positive(value, option, zero=False)
    if up not in (None, *_AXES):
        raise ValueError(f"up must be one of {', '.join(_AXES)}, not {up!r}")
    if isinstance(loops, str) and loops not in ("borders", "auto"):
        raise ValueError(f"loops must be lists of vertex ids, 'borders' or 'auto', not {loops!r}")
    if size is not None and scale is not None:
        raise ValueError("give size or scale, not both")
    vertices, polygons = read_mesh(path, _COPIES * max_vertices)
    if sum(len(polygon) ** 2 for polygon in polygons) > 3e7:  # some seconds of cutting them into triangles
        raise ValueError(f"{path}: {len(polygons)} faces are more than can be cut into triangles; decimate it")
    repairs: list[str] = []
    try:
        # What is left of the surface, and which of its vertices each vertex of the file is now (-1 for none).
        faces, vertex_of, kept = _repaired(vertices, polygons, weld, repairs)
        new_id = np.full(len(vertices), -1)
        new_id[kept] = np.arange(len(kept))
        corners = vertices[kept]
        if len(kept) > max_vertices:
            simple = simplified(corners, faces, max_vertices)
            count = len(simple.vertices)
            repairs.append(f"its {len(kept)} vertices were simplified to {count}; max_vertices is {max_vertices}")
            new_id[kept] = simple.nearest
            kept = kept[cKDTree(corners).query(simple.vertices)[1]]  # messages name the nearest vertices of the file
            corners = simple.vertices
            faces = simple.faces
        new_id = new_id[vertex_of]
        # How it stands, and how large it is.
        held = None if grips is None else _carry(grips, new_id, "grips")
        if up is None and held is None:
            up = _up_of_borders(corners, faces, repairs)
        upright = _upright(corners, held, up, repairs)
        placed, factor = _scaled(upright, size, scale, repairs)
        if held is None:
            placed = _facing(placed, repairs)
        _report_lying(placed, held, up, repairs)
        _report_short_edges(placed, faces, kept, repairs)
        # Its loops: found when a rule for them is named, else those that are given.
        if isinstance(loops, str):
            _report_borders(placed, faces, repairs)
            cycles = _found(placed, faces, loops, repairs)
            names = named(placed, faces, cycles)
            if loops == "auto":
                inner = [i for i, name in enumerate(names) if kind(name) != "edge"]
                cycles = tuple(cycles[i] for i in inner)
                names = tuple(names[i] for i in inner)
            if names:
                repairs.append(f"by place and size they were called {', '.join(names)}")
        else:
            _count_classes(placed, faces, border_cycles(faces))  # refuses a closed solid
            known = loops if isinstance(loops, Mapping) else dict(enumerate(loops))
            carried = {key: _carry(loop, new_id, f"loops[{key!r}]") for key, loop in known.items()}
            cycles = _closed(placed, faces, kept, carried, repairs)
            names = tuple(loops) if isinstance(loops, Mapping) else named(placed, faces, cycles)
        if held is None:
            held = _grips(placed, faces, kept, dict(zip(names, cycles, strict=True)), repairs)
    except ValueError as error:
        done = f" (done before: {'; '.join(repairs)})" if repairs else ""
        raise type(error)(f"{path}: {error}{done}") from error
    # A dataset reads its mesh for each film; its repairs are logged once.
    for repair in repairs:
        message = printable(f"{path}: {repair}")
        if message not in _logged:
            _logged.add(message)
            _log.warning("%s", message)
    return Read(placed, faces, cycles, held, names, factor, tuple(repairs))


def _note(repairs: list[str], count: int, what: str) -> None:
    """Report a repair that was made `count` times, if any."""
    if count:
        repairs.append(f"{count} {what}")


def _repaired(
    vertices: Array, polygons: Sequence[Sequence[int]], weld: float | None, repairs: list[str]
) -> tuple[Ids, Ids, Ids]:
    """Return the faces of the one component that is the cloth, as ids of the vertices that are left.

    Also returned are, for each vertex of the file, the vertex (of the file) that it was welded to; and those that are left.
    """
    large = sum(len(corners) > 3 for corners in polygons)
    _note(repairs, large, "faces of four corners or more were cut into triangles")
    # A vertex in no face may be anywhere, and is dropped later.
    used = np.unique(list(itertools.chain(*polygons)))
    lost = used[~(np.abs(vertices[used]) < 1e100).all(axis=1)]
    if len(lost):
        raise ValueError(f"vertex {lost[0]} is at {vertices[lost[0]].tolist()}; every vertex of a face needs a place")
    faces = np.array([triangle for polygon in polygons for triangle in _ears(vertices, list(polygon))], dtype=np.int64)
    distance = _rounding(vertices, faces) if weld is None else weld
    vertex_of = _weld(vertices, distance, repairs)
    faces = _clean(vertex_of[faces], repairs)
    faces = _one_component(vertices, faces, repairs)
    kept, flat = np.unique(faces, return_inverse=True)
    _note(repairs, len(np.unique(vertex_of)) - len(kept), "vertices in none of the faces kept were dropped")
    faces = wind(flat.reshape(-1, 3))
    _, counts = np.unique(half_edges(faces), axis=0, return_counts=True)
    _note(repairs, int((counts > 2).sum()), "edges in more than two faces, as where a strap is sewn on, were kept")
    return faces, vertex_of, kept


def _ears(vertices: Array, polygon: list[int]) -> Iterable[list[int]]:
    """Cut a polygon into triangles, each time at the shortest diagonal that leaves a corner on its outer side."""
    while len(polygon) > 3:
        corners = vertices[polygon]
        before = np.roll(corners, 1, axis=0)
        after = np.roll(corners, -1, axis=0)
        # A corner that turns against the polygon's own normal (Newell's) points inwards: no ear there.
        turn = np.cross(corners - before, after - corners)
        normal = np.cross(corners, after).sum(axis=0)
        diagonal = np.linalg.norm(after - before, axis=1)
        ear = int(np.argmin(np.where(turn @ normal < 0, np.inf, diagonal)))
        yield [polygon[ear - 1], polygon[ear], polygon[(ear + 1) % len(polygon)]]
        del polygon[ear]
    yield polygon


def _rounding(vertices: Array, faces: Ids) -> float:
    """Return the distance that rounding to six decimals leaves between copies of a vertex; far below the usual edge."""
    length = np.linalg.norm(vertices[faces] - vertices[np.roll(faces, 1, axis=1)], axis=2)
    diagonal = float(np.linalg.norm(np.ptp(vertices[faces].reshape(-1, 3), axis=0)))
    usual = float(np.median(length[length > 0])) if length.any() else 0.0
    return min(_WELD * diagonal, 0.01 * usual)


def _weld(vertices: Array, distance: float, repairs: list[str]) -> Ids:
    """Return (n,) for each vertex the first of those that lie at its place.

    trimesh's `merge_vertices` rounds to a grid and misses pairs on either side of a grid line (2 of 72 of a public backpack);
    here distances decide.
    """
    places, first_at, place_of = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    finite = first_at[(np.abs(places) < 1e100).all(axis=1)]
    tree = cKDTree(vertices[finite])
    if tree.count_neighbors(tree, distance) > 100 * len(vertices):  # all pairs would fill the memory
        raise ValueError(f"most vertices lie within {distance:.2g} of a hundred others; weld less, or mend the mesh")
    near = finite[tree.query_pairs(distance, output_type="ndarray")]
    equal = np.column_stack([np.arange(len(vertices)), first_at[place_of.ravel()]])
    group = component_of(np.concatenate([near, equal]), len(vertices))
    _, first, group_of = np.unique(group, return_index=True, return_inverse=True)
    what = f"vertices within {distance:.2g} of another one (in the file's units) were welded to it"
    _note(repairs, len(vertices) - len(first), what)
    return np.asarray(first[group_of.ravel()])


def _clean(faces: Ids, repairs: list[str]) -> Ids:
    """Return the faces of three different vertices, each once."""
    whole = of_three_vertices(faces)
    _note(repairs, len(faces) - len(whole), "faces without area, which named a vertex twice, were dropped")
    single = once_each(whole)
    _note(repairs, len(whole) - len(single), "faces that lay on another one were dropped")
    if not len(single):
        raise ValueError("no face with three different vertices is left")
    return single


def _one_component(vertices: Array, faces: Ids, repairs: list[str]) -> Ids:
    """Return the faces of the largest component, if it is clearly the largest."""
    component = components(faces)
    count = component.max() + 1
    if count == 1:
        return faces
    area = face_areas(vertices, faces) + 1e-300
    share = np.bincount(component, area) / area.sum()
    largest = np.argsort(share)[::-1]
    if share[largest[0]] < 0.6:
        shares = ", ".join(f"{100 * part:.0f} %" for part in share[largest[:5]])
        first = np.unique(faces[component == largest[0]])
        second = np.unique(faces[component == largest[1]])
        what = f"{count} components that no edge joins, of {shares} of the surface: keep one"

        # Welding helps where the two nearly touch, by less than the edges are long.
        gap = cKDTree(vertices[first]).query(vertices[second])[0].min()
        usual = np.median(edge_lengths(vertices, np.unique(half_edges(faces), axis=0)))
        if gap < 0.5 * usual:
            what += f", or weld more than {gap:.2g}"
        raise ValueError(what)
    lost = f"{100 * (1 - share.max()):.1f} % of the surface"
    repairs.append(f"{count - 1} smaller components, {lost}, were dropped: a cloth is one piece")
    return faces[component == largest[0]]


def _report_short_edges(vertices: Array, faces: Ids, kept: Ids, repairs: list[str]) -> None:
    """Report a very short edge: it is legal, but the engine's collision margin follows the shortest one."""
    edges = np.unique(half_edges(faces), axis=0)
    length = edge_lengths(vertices, edges)
    a, b = kept[edges[np.argmin(length)]]
    if length.min() == 0:
        raise ValueError(f"vertices {a} and {b} are at one place; weld them")
    if length.min() < 0.05 * np.median(length):
        repairs.append(
            f"vertices {a} and {b} are only {length.min():.2g} m apart; weld them, or collisions are as thin"
        )


def _carry(given: ArrayLike, new_id: Ids, name: str) -> Ids:
    """Return the present ids of the vertices of a loop or of the grips; `new_id` has one for each vertex of the file."""
    ids = as_ids(given, name, len(new_id))
    if ids.ndim != 1:
        raise ValueError(f"{name} must be a list of vertex ids; loops is a list of lists, even of one loop")
    lost = new_id[ids] < 0
    if lost.any():
        raise ValueError(f"{name} names vertex {ids[np.argmax(lost)]}, which is in no face of the garment's component")
    if name == "grips" and (len(ids) != 2 or new_id[ids[0]] == new_id[ids[1]]):
        raise ValueError(f"grips must be two vertex ids that are not one vertex after welding, not {ids.tolist()}")
    return new_id[ids]


def _up_of_borders(vertices: Array, faces: Ids, repairs: list[str]) -> Literal["y", "z"] | None:
    """Return the axis that points up, if the widest border of a garment that is not flat shows it.

    Idea: the widest border of what is worn or carried (a hem, a waist, the rim of a bag) is level, and faces up or down. A band
    has two that are alike, and hangs with both sideways: its borders show nothing.
    """
    curves = [vertices[border] for border in border_cycles(faces)]
    areas = [float(np.linalg.norm(vector_area(curve))) for curve in curves]
    if not curves or is_flat(vertices, faces):
        return None
    *others, largest = sorted(areas)
    if others and largest < 1.5 * others[-1]:
        return None
    widest = curves[areas.index(largest)]
    _, of_y, of_z = np.abs(vector_area(widest))
    rises = np.ptp(widest, axis=0) > 0.2 * np.ptp(vertices, axis=0)
    if of_y > 2 * of_z and not rises[1]:
        repairs.append(_TURNED)
        return "y"
    if of_z > 2 * of_y and not rises[2]:
        return "z"
    return None


def _upright(vertices: Array, grips: Ids | None, up: str | None, repairs: list[str]) -> Array:
    """Return the vertices with z up. Grips are above the middle; without them, a garment hangs and does not lie."""
    if up is None:
        half = np.ptp(vertices, axis=0) / 2
        if grips is not None:
            height = vertices[grips].mean(axis=0) - (vertices.min(axis=0) + half)
            y_is_up = height[1] > abs(height[2])
        elif half[2] < half[1] <= _LONGER * half[2]:
            y_is_up = _is_upright_along_y(vertices)
        else:
            y_is_up = half[1] > _LONGER * half[2]
        if grips is None and not y_is_up and _LONGER * half[1] > half[2]:
            repairs.append(_UNCLEAR)
        up = "z"
        if y_is_up:
            up = "y"
            repairs.append(_TURNED)
    order, signs = _UP[up[-1]]
    upright = vertices[:, order] * signs
    if up[0] == "-":
        upright = upright * [-1, 1, -1]
    return upright


def _is_upright_along_y(vertices: Array) -> bool:
    """Return whether a garment is like its mirror image behind a plane of constant z, and not behind one of constant y.

    Garments are alike on the left and on the right, and often in front and behind, but not above and below.
    """
    low = vertices.min(axis=0)
    high = vertices.max(axis=0)
    tree = cKDTree(vertices)
    unlike = []
    for axis in (1, 2):
        mirrored = vertices.copy()
        mirrored[:, axis] = low[axis] + high[axis] - vertices[:, axis]
        unlike.append(float(np.quantile(tree.query(mirrored)[0], 0.99)) / float((high - low).max()))
    least, ratio = _LIKE_MIRRORED
    return unlike[0] > max(least, ratio * unlike[1])


def _facing(vertices: Array, repairs: list[str]) -> Array:
    """Return the vertices turned about the vertical so that the garment is wider from left to right (x) than deep (y).

    The rule has no range in which nothing is done: so a mesh that was turned by 90 degrees becomes the same garment.
    """
    deep_to_wide = np.ptp(vertices[:, 1]) / np.ptp(vertices[:, 0]) if np.ptp(vertices[:, 0]) else np.inf
    if 1 / _SQUARE < deep_to_wide < _SQUARE:  # as deep as it is wide: the way along which most of it lies counts
        deep_to_wide = vertices[:, 1].std() / vertices[:, 0].std()
    if deep_to_wide <= 1 + 1e-9:
        return vertices
    repairs.append("it was turned by 90 degrees about the vertical, to be wider (x) than deep (y)")
    return vertices[:, [1, 0, 2]] * [1, -1, 1]


def _report_lying(vertices: Array, grips: Ids | None, up: str | None, repairs: list[str]) -> None:
    """Refuse grips at the floor, and report a garment that seems to lie."""
    wide, deep, high = np.ptp(vertices, axis=0)
    floor = vertices[:, 2].min()
    if grips is not None and vertices[grips, 2].mean() < floor + high / 3:
        raise ValueError(
            "its grips would be in the lowest third, near the floor: say which axis is up: up='-z' (--up -z)"
        )
    if up is None and high < min(wide, deep):
        repairs.append("it seems to lie: its thinnest axis is upright; say which axis is up if it is not z")


def _report_borders(vertices: Array, faces: Ids, repairs: list[str]) -> None:
    """Report a surface that nothing can go through, and a border that runs down the front of a garment."""
    borders = border_cycles(faces)
    large = [border for border in borders if not _is_small(vertices, faces, border)]
    if len(large) == 1 and not _classes_of_large(_count_classes(vertices, faces, borders), borders, large):
        repairs.append("its only border is its own edge, as that of a disc or a sack: no rod can go through it")
        return
    for border in borders:
        if is_open_front(vertices, faces, border):
            what = f"neck, slit and hem are one border of {len(border)} vertices: an open front"
            repairs.append(f"{what}, which is no loop; close it, or give loops by vertex ids")


def _scaled(vertices: Array, size: float | None, scale: float | None, repairs: list[str]) -> tuple[Array, float]:
    """Return the vertices in metres, near the origin, and the metres in one unit of the file."""
    largest = float(np.ptp(vertices, axis=0).max())
    if largest < 1e-100:
        raise ValueError(f"its largest extent is {largest:.3g}, which is too small to measure its edges; scale it up")
    if size is not None:
        scale = size / largest
    elif scale is None:
        # The first unit that makes it as large as a garment.
        low, high = _METRES
        fitting = [(factor, unit) for factor, unit in _UNITS if low <= factor * largest <= high]
        scale, unit = (*fitting, (1 / largest, "no unit"))[0]
        if unit != "metres":
            metres = f"{unit}: {scale * largest:.3g} m; give size or scale (--size or --unit)"
            repairs.append(f"its largest extent, {largest:.4g}, was taken for {metres}")
    vertices = scale * vertices
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    if np.linalg.norm(middle) > 10 * scale * largest:  # single precision in the engine would blur it
        repairs.append(f"it lay {np.linalg.norm(middle):.3g} m from the origin, and was moved there")
        vertices = vertices - middle
    return vertices, float(scale)


def _closed(vertices: Array, faces: Ids, kept: Ids, loops: Mapping[Any, Ids], repairs: list[str]) -> tuple[Ids, ...]:
    """Return the given loops as closed cycles along edges."""
    graph = EdgeGraph(vertices, np.unique(half_edges(faces), axis=0))
    cycles = []
    for key, loop in loops.items():
        try:
            cycle, how = graph.close(loop.tolist(), kept)
        except ValueError as error:
            raise ValueError(f"loops[{key!r}] cannot be followed along the mesh: {error}") from error
        if how:
            repairs.append(f"loops[{key!r}]: {how}")
        cycles.append(cycle)
    return tuple(cycles)


def _count_classes(vertices: Array, faces: Ids, borders: Sequence[Ids], *, must_have_borders: bool = False) -> int:
    """Return how many independent classes of loops the surface has, by Euler's formula; refuse a closed solid."""
    edges = np.unique(half_edges(faces), axis=0)
    classes = 1 - len(vertices) + len(edges) - len(faces) + (not borders)
    if not borders and (must_have_borders or not classes):
        what = "every edge is in two faces or more, as of a closed solid, and a cloth has borders"
        raise ValueError(f"{what}: open it, leave out its inner side, or give loops by vertex ids")
    return classes


def _is_small(vertices: Array, faces: Ids, loop: Ids) -> bool:
    """Return whether a loop is too small for a rod, or a hole that is left where the faces around one vertex are missing.

    Such a hole lies in the surface around it. The end of a sleeve of few edges does not.
    """
    if len(loop) <= _FEW or side_lengths(vertices[loop]).sum() < _ROUND_A_ROD:
        return True
    beside = faces[np.isin(faces, loop).sum(axis=1) >= 2]
    if len(loop) > _STAR or 3 * len(loop) > len(np.unique(faces)) ** 0.5:
        return False
    a, b, c = np.moveaxis(vertices[beside], 1, 0)
    normal = np.cross(b - a, c - a).sum(axis=0)
    hole = vector_area(vertices[loop])
    return bool(abs(normal @ hole) > 0.8 * np.linalg.norm(normal) * np.linalg.norm(hole))


def _classes_of_large(classes: int, borders: Sequence[Ids], large: Sequence[Ids]) -> int:
    """Return how many classes are left when all borders but the large ones are closed, each by a disc."""
    small = len(borders) - len(large)
    return classes - small + int(small > 0 and not large)


def _found(vertices: Array, faces: Ids, rule: str, repairs: list[str]) -> tuple[Ids, ...]:
    """Return loops that nobody marked, the longest first.

    They are the borders, or with the rule "auto" those of persistence where the mesh has more classes than borders show.
    """
    cycles = border_cycles(faces)
    classes = _count_classes(vertices, faces, cycles, must_have_borders=rule == "borders")
    large = [cycle for cycle in cycles if not _is_small(vertices, faces, cycle)]
    of_large = _classes_of_large(classes, cycles, large)
    if rule == "auto" and not of_large:
        return ()  # a disc, or a sack
    what = "borders were found"
    if rule == "auto" and of_large >= max(len(large), 1):
        edges, uses = np.unique(half_edges(faces), axis=0, return_counts=True)
        cycles = EdgeGraph(vertices, edges).loops(of_large)
        if not large and (uses <= 2).all():
            # Half of the classes of a solid go around its tubes, and no rod can go through them.
            around = [cycle for cycle in cycles if not is_inside(vertices, faces, vertices[cycle].mean(axis=0))]
            cycles = sorted(around, key=lambda cycle: side_lengths(vertices[cycle]).sum())[: of_large // 2]
        what = "loops were found by persistence along the mesh"
    repairs.append(f"{len(cycles)} {what}, the longest first")
    if rule == "auto":
        kept = [cycle for cycle in cycles if not _is_small(vertices, faces, cycle)]
        what = "of them are too small for a rod, such as missing faces, and were left out"
        _note(repairs, len(cycles) - len(kept), what)
        cycles = kept
    return tuple(sorted(cycles, key=lambda cycle: -side_lengths(vertices[cycle]).sum()))


def _grips(vertices: Array, faces: Ids, kept: Ids, loops: Mapping[str, Ids], repairs: list[str]) -> Ids:
    """Return the two vertices by which a person would hold the garment to hang it.

    They are the sides of a shirt's neck, the middles of two straps, two places on one strap, or else left and right at the top.
    """
    x = vertices[:, 0]
    held = _outermost(vertices)
    straps = [loop for name, loop in loops.items() if kind(name) in ("handle", "strap", "ear", "neck", "loop")]
    if "hem" in loops and "neck" in loops:
        neck = loops["neck"]
        held = [int(neck[np.argmin(x[neck])]), int(neck[np.argmax(x[neck])])]
    elif len(straps) in (1, 2):
        middles = _middles(vertices, faces, sorted(straps, key=lambda loop: float(x[loop].mean())))
        if len(straps) == 2 and len(middles) == 2:
            # Two loops of which one is above the other, or on one strap, are not held by both hands.
            wide, deep, high = np.ptp(vertices[middles], axis=0)
            if np.hypot(wide, deep) > max(high, _APART * np.ptp(vertices[:, :2], axis=0).max()):
                held = middles
        elif len(straps) == len(middles) == 1:
            held = sorted(_beside(vertices, straps[0], middles[0]), key=lambda i: float(x[i]))
    left, right = kept[held]
    repairs.append(f"vertices {left} and {right}, left and right near the top, were taken for grips")
    return np.array(held)


def _middles(vertices: Array, faces: Ids, loops: Sequence[Ids]) -> list[int]:
    """Return for each loop of a strap the vertex in its middle: the farthest along the mesh from what is near no loop.

    A loop without a strap, such as a hole in a sheet, is about as far from the rest everywhere; it has none.
    """
    graph = weighted(vertices, np.unique(half_edges(faces), axis=0))
    lengths = [float(side_lengths(vertices[loop]).sum()) for loop in loops]
    away = dijkstra(graph, directed=False, indices=np.concatenate(loops), min_only=True)
    body = np.flatnonzero(away > _NEAR_LOOP * min(lengths))
    if not len(body):
        return [_top(vertices[loop], loop) for loop in loops] if len(loops) > 1 else []
    out = dijkstra(graph, directed=False, indices=body, min_only=True)
    pairs = zip(loops, lengths, strict=True)
    return [int(loop[np.argmax(out[loop])]) for loop, length in pairs if out[loop].max() > _STRAP * length]


def _beside(vertices: Array, loop: Ids, middle: int) -> list[int]:
    """Return two vertices of a loop on either side of one of it, each a sixth of the loop away."""
    order = np.roll(loop, -int(np.argmax(loop == middle)))
    steps = side_lengths(vertices[order])
    along = np.concatenate([[0.0], np.cumsum(steps)[:-1]])
    total = float(steps.sum())
    return [int(order[np.argmin(np.abs(along - share * total))]) for share in (1 / 6, 5 / 6)]


def _top(curve: Array, loop: Ids) -> int:
    """Return the vertex near a loop's top that is nearest to above its middle: both sides hang alike from there."""
    high = curve[:, 2] >= curve[:, 2].max() - 0.15 * np.ptp(curve[:, 2])
    beside = np.linalg.norm(curve[:, :2] - curve[:, :2].mean(axis=0), axis=1)
    return int(loop[np.argmin(np.where(high, beside, np.inf))])


def _outermost(vertices: Array) -> list[int]:
    """Return the leftmost and the rightmost vertex near the top, the higher of two as far out."""
    x, _, z = vertices.T
    for share in (0.1, 0.3, 1.0):
        top = np.flatnonzero(z >= z.max() - share * np.ptp(z))
        left = top[np.lexsort((-z[top], x[top]))][0]
        right = top[np.lexsort((-z[top], -x[top]))][0]
        if x[right] - x[left] > 0.1 * np.ptp(x):
            break
    if left == right:
        left = np.argmax(z)
        right = np.argmin(z)
    return [int(left), int(right)]
