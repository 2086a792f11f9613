"""Read the vertices and the polygons of an OBJ, PLY or STL file, with the ids that the file gives them.

General readers are not used for files, because an id of a loop must mean the same vertex as in the file, and because a
damaged file must be refused. trimesh 5.2, for one, reads a PLY file of triangles and quads with a wrong triangle, takes
half a file for a whole one where the counts of the header are wrong, loses the first vertex behind a byte order mark, and
splits vertices that have several texture coordinates. Here all but places and polygons is skipped.
"""

import io
import itertools
import re
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

from topokit._archive import FormatError, existing
from topokit._validate import as_ids

from ._surface import Array

Polygons = list[list[int]]
Properties = list[tuple[str, list[str]]]  # the name of a property, and its one type, or the two types of a list
_PLY_CODES = {
    "char": "b",
    "uchar": "B",
    "short": "h",
    "ushort": "H",
    "int": "i",
    "uint": "I",
    "float": "f",
    "double": "d",
}
_PLY_TYPES = _PLY_CODES | {np.dtype(code).name: code for code in _PLY_CODES.values()}
_MOST_CORNERS = 1000  # of a face: the time to cut it into triangles grows with the square
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_mesh(path: str | Path) -> tuple[Array, Polygons]:
    """Return vertices (n, 3) in the file's units and the polygons as lists of vertex ids counted from 0.

    An STL file has no vertex ids: corner k of triangle i is vertex 3 i + k.
    """
    path = existing(path)
    readers: dict[str, Callable[[bytes], tuple[Array, Polygons]]] = {".obj": _obj, ".ply": _ply, ".stl": _stl}
    suffix = path.suffix.lower()
    if suffix not in readers:
        raise FormatError(f"{path}: a mesh file ends in {', '.join(readers)}, not in {path.suffix!r}; export it as one")
    data = path.read_bytes()
    try:
        _check_start(data)
        vertices, polygons = readers[suffix](data)
        if not polygons:
            raise ValueError(f"{len(vertices)} vertices and no faces; a garment needs a surface")
        as_ids(list(itertools.chain(*polygons)), "a face", len(vertices))
        largest = max(map(len, polygons))
        if largest > _MOST_CORNERS:
            raise ValueError(f"a face of {largest} corners; cut those of more than {_MOST_CORNERS}")
    except ValueError as error:
        raise FormatError(f"{path}: {error}") from error
    return vertices, polygons


def _check_start(data: bytes) -> None:
    """Raise ValueError when the file is empty, or is something else that often has the name of a mesh."""
    start = data.lstrip()[:200].lower()
    if not start:
        raise ValueError("the file is empty")
    if start.startswith(b"version https://git-lfs"):
        raise ValueError("a pointer of git-lfs and not the mesh itself; fetch that with 'git lfs pull'")
    if start.startswith((b"<!doctype", b"<html", b"<?xml")):
        raise ValueError("a web page and not a mesh; download the file itself, not the page that shows it")


def _obj(data: bytes) -> tuple[Array, Polygons]:
    """Read all objects and groups of an OBJ file together.

    Ids in faces count from 1, or backwards from the last vertex before the face.
    """
    vertices: list[list[float]] = []
    polygons: Polygons = []
    # A backslash at the end of a line continues it. A byte order mark is no part of the first line.
    text = data.decode("utf-8-sig", errors="replace").replace("\\\r\n", " ").replace("\\\n", " ")
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split("#")[0].split()
        if not words or words[0] not in ("v", "f"):
            continue
        if words[0] == "v":
            try:
                x, y, z = map(float, words[1:4])
            except ValueError as error:
                raise ValueError(f"line {number} should hold three coordinates: {line.strip()[:60]!r}") from error
            vertices.append([x, y, z])
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


def _stl(data: bytes) -> tuple[Array, Polygons]:
    """Read an STL file: binary when its length fits the count of triangles in its header, ASCII otherwise."""
    count = int.from_bytes(data[80:84], "little")
    if len(data) >= 84 and len(data) == 84 + count * _TRIANGLE.itemsize:
        corners = np.frombuffer(data, _TRIANGLE, offset=84)["corners"].reshape(-1, 3)
    elif data.lstrip()[:5].lower() == b"solid":
        text = data.decode("ascii", errors="replace").lower()
        rows = re.findall(r"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", text)
        facets = len(re.findall(r"\bfacet\s+normal", text))
        if len(rows) != 3 * facets or "endsolid" not in text:
            raise ValueError(f"cut off or damaged: {facets} facets have {len(rows)} corners, or endsolid is missing")
        corners = np.array(rows, dtype=np.float64).reshape(-1, 3)
    else:
        raise ValueError(f"neither ASCII STL nor whole binary STL: {len(data)} bytes; it counts {count} triangles")
    with np.errstate(invalid="ignore"):  # a signalling NaN would warn; it is refused later
        corners = corners.astype(np.float64)
    return corners, np.arange(len(corners)).reshape(-1, 3).tolist()


def _ply(data: bytes) -> tuple[Array, Polygons]:
    """Read a PLY file, ASCII or binary of either byte order: the places of its vertices and the lists of its faces."""
    head, mark, body = data.partition(b"end_header")
    header = [line.split() for line in head.decode("ascii", errors="replace").splitlines()]
    if not mark or not header or header[0] != ["ply"]:
        raise ValueError("not a PLY file: it must begin with 'ply' and have a header that ends in 'end_header'")
    formats = [line[1] for line in header if len(line) > 1 and line[0] == "format"] or ["missing"]
    byte_orders = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
    if formats[0] not in byte_orders:
        raise ValueError(f"PLY format {formats[0]!r}; expected one of {', '.join(byte_orders)}")
    take = _taker(body, byte_orders[formats[0]])
    vertices: list[list[float]] = []
    polygons: Polygons = []
    elements = _ply_elements(header)
    try:
        for name, count, properties in elements:
            if not properties:
                continue
            if not 0 <= count <= len(body):  # a row of anything takes a byte or more
                raise ValueError(f"the file has {len(body)} bytes for them")
            for _ in range(count):
                row = {key: _ply_numbers(take, types) for key, types in properties}
                if name == "vertex":
                    vertices.append([row[axis][0] for axis in "xyz"])
                elif name == "face":
                    corners = row["vertex_index"] if "vertex_index" in row else row["vertex_indices"]
                    polygons.append([int(corner) for corner in corners])
    except KeyError as error:
        raise ValueError("its vertices have no x, y and z, or its faces no list vertex_indices") from error
    except (ValueError, IndexError, OverflowError, StopIteration, struct.error) as error:
        where = f"cut off or damaged among the {count} rows of its element {name!r}"
        raise ValueError(f"{where}: {str(error) or 'the file ends there'}") from error
    for face, polygon in enumerate(polygons):
        if len(polygon) < 3:
            raise ValueError(f"face {face} has {len(polygon)} corners; three at least make a face")
    return np.array(vertices).reshape(-1, 3), polygons


def _ply_elements(header: list[list[str]]) -> list[tuple[str, int, Properties]]:
    """Return the name, the number of rows and the properties of each element that a PLY header declares."""
    elements: list[tuple[str, int, Properties]] = []
    line: list[str] = []
    try:
        for line in header:
            if line[:1] == ["element"]:
                elements.append((line[1], int(line[2]), []))
            elif line[:1] == ["property"]:
                # "property TYPE NAME", or "property list TYPE_OF_COUNT TYPE NAME"
                words = line[1:]
                if words[0] == "list" and len(words) > 3:
                    words = words[1:]
                *types, name = words
                elements[-1][2].append((name, [_PLY_TYPES[kind] for kind in types]))
    except (IndexError, KeyError, ValueError) as error:
        raise ValueError(f"a line of the PLY header is not understood: {' '.join(line)!r}") from error
    return elements


def _ply_numbers(take: Callable[[str], float], types: list[str]) -> list[float]:
    """Take the next number, or, where there are two types, the next list; the first type is that of its length."""
    count = 1
    if len(types) == 2:
        count = int(take(types[0]))
    return [take(types[-1]) for _ in range(count)]


def _taker(body: bytes, byte_order: str) -> Callable[[str], float]:
    """Return a function that takes the next number of a type from a body: binary of a byte order, or text."""
    if not byte_order:
        words = iter(body.split())
        return lambda _: float(next(words))
    stream = io.BytesIO(body.split(b"\n", 1)[-1])

    def take(code: str) -> float:
        code = byte_order + code
        return float(struct.unpack(code, stream.read(struct.calcsize(code)))[0])

    return take
