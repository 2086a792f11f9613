"""Read the vertices and the polygons of an OBJ, PLY or STL file, with the ids that the file gives them.

General readers are not used for files, because an id of a loop must mean the same vertex as in the file, and because a
damaged file must be refused. trimesh 5.2, for one, loses the first vertex behind a byte order mark, and splits vertices that
have several texture coordinates. Here all but places and polygons is skipped.
"""

import codecs
import itertools
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from topokit._archive import FormatError, existing
from topokit._ply import read_ply
from topokit._validate import as_ids

from ._surface import Array

Polygons = list[list[int]]
_MOST_CORNERS = 1000  # of a face: the time to cut it into triangles grows with the square
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_mesh(path: str | Path, most_vertices: float) -> tuple[Array, Polygons]:
    """Return vertices (n, 3) in the file's units and the polygons as lists of vertex ids counted from 0.

    A file of more vertices than `most_vertices` is refused as soon as that many are read.
    An STL file has no vertex ids: corner k of triangle i is vertex 3 i + k.
    """
    path = existing(path)
    readers: dict[str, Callable[[bytes, float], tuple[Array, Polygons]]] = {".obj": _obj, ".ply": _ply, ".stl": _stl}
    suffix = path.suffix.lower()
    if suffix not in readers:
        raise FormatError(f"{path}: a mesh file ends in {', '.join(readers)}, not in {path.suffix!r}; export it as one")
    data = path.read_bytes().removeprefix(codecs.BOM_UTF8)
    try:
        _check_start(data)
        vertices, polygons = readers[suffix](data, most_vertices)
        if not polygons:
            raise ValueError(f"{len(vertices)} vertices and no faces; a garment needs a surface")
        as_ids(list(itertools.chain(*polygons)), "a face", len(vertices))
        largest = max(map(len, polygons))
        if largest > _MOST_CORNERS:
            raise ValueError(f"a face of {largest} corners; cut those of more than {_MOST_CORNERS}")
    except ValueError as error:
        raise FormatError(f"{path}: {error}") from error
    return vertices, polygons


def _check_count(n_vertices: int, most: float) -> None:
    if n_vertices > most:
        raise ValueError(
            f"it has more than {most:,} vertices; decimate the mesh, or raise max_vertices (--max-vertices)"
        )


def _check_start(data: bytes) -> None:
    """Raise ValueError when the file is empty, or is something else that often has the name of a mesh."""
    start = data.lstrip()[:200].lower()
    if not start:
        raise ValueError("the file is empty")
    if start.startswith(b"version https://git-lfs"):
        raise ValueError("a pointer of git-lfs and not the mesh itself; fetch that with 'git lfs pull'")
    if start.startswith((b"<!doctype", b"<html", b"<?xml")):
        raise ValueError("a web page and not a mesh; download the file itself, not the page that shows it")


def _obj(data: bytes, most: float) -> tuple[Array, Polygons]:
    """Read all objects and groups of an OBJ file together.

    Ids in faces count from 1, or backwards from the last vertex before the face.
    """
    vertices: list[list[float]] = []
    polygons: Polygons = []
    # A backslash at the end of a line continues it. Files that were joined have byte order marks between.
    text = data.decode(errors="replace").replace("\r\n", "\n").replace("\r", "\n").replace("\\\n", " ")
    for number, line in enumerate(text.replace("\ufeff", "").split("\n"), 1):
        words = line.split("#")[0].split()
        if not words or words[0] not in ("v", "f"):
            continue
        if words[0] == "v":
            try:
                x, y, z = map(float, words[1:4])
            except ValueError as error:
                raise ValueError(f"line {number} should hold three coordinates: {line.strip()[:60]!r}") from error
            vertices.append([x, y, z])
            _check_count(len(vertices), most)
            continue
        # A corner is vertex/texture/normal; the vertex alone counts here.
        try:
            corners = [int(word.split("/")[0]) for word in words[1:]]
        except ValueError as error:
            raise ValueError(f"line {number} should hold vertex numbers: {line.strip()[:60]!r}") from error
        if len(corners) < 3 or 0 in corners:
            raise ValueError(f"line {number} is no face of three corners, numbered from 1: {line.strip()[:60]!r}")
        polygons.append([corner - 1 if corner > 0 else len(vertices) + corner for corner in corners])
    return np.array(vertices, dtype=np.float64).reshape(-1, 3), polygons


def _stl(data: bytes, most: float) -> tuple[Array, Polygons]:
    """Read an STL file: binary when its length fits the count of triangles in its header, ASCII otherwise."""
    count = int.from_bytes(data[80:84], "little")
    if len(data) >= 84 and len(data) == 84 + count * _TRIANGLE.itemsize:
        _check_count(3 * count, most)
        corners = np.frombuffer(data, _TRIANGLE, offset=84)["corners"].reshape(-1, 3)
    elif data.lstrip()[:5].lower() == b"solid":
        text = data.decode("ascii", errors="replace").lower()
        rows = re.findall(r"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", text)
        facets = len(re.findall(r"\bfacet\s+normal", text))
        if len(rows) != 3 * facets or "endsolid" not in text:
            raise ValueError(f"cut off or damaged: {facets} facets have {len(rows)} corners, or endsolid is missing")
        _check_count(len(rows), most)
        corners = np.array(rows, dtype=np.float64).reshape(-1, 3)
    else:
        raise ValueError(f"neither ASCII STL nor whole binary STL: {len(data)} bytes; it counts {count} triangles")
    with np.errstate(invalid="ignore"):  # a signalling NaN would warn; it is refused later
        corners = corners.astype(np.float64)
    return corners, np.arange(len(corners)).reshape(-1, 3).tolist()


def _ply(data: bytes, most: float) -> tuple[Array, Polygons]:
    """Read a PLY file: the places of its vertices and the lists of its faces."""
    elements = read_ply(data)
    vertex = elements.get("vertex", {})
    face = elements.get("face", {})
    corners = face["vertex_index"] if "vertex_index" in face else face.get("vertex_indices", [])
    columns = [column for axis in "xyz" if isinstance(column := vertex.get(axis), np.ndarray)]
    if (
        len(columns) < 3
        or not isinstance(corners, list)
        or (face and not {"vertex_index", "vertex_indices"} & set(face))
    ):
        raise ValueError("its vertices have no x, y and z, or its faces no list vertex_indices")
    _check_count(len(columns[0]), most)
    polygons: Polygons = []
    for number, polygon in enumerate(corners):
        if len(polygon) < 3:
            raise ValueError(f"face {number} has {len(polygon)} corners; three at least make a face")
        polygons.append([_id(corner, number) for corner in polygon])
    return np.column_stack(columns).astype(np.float64), polygons


def _id(corner: float, face: int) -> int:
    if corner % 1:
        raise ValueError(f"face {face} names vertex {corner}: an id is a whole number")
    return int(corner)
