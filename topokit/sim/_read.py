"""Read the vertices and the polygons of an OBJ, PLY or STL file, numbered as the file numbers them.

General readers (trimesh, for one) split, merge and drop vertices, and then an id of a loop means nothing; or they take half
a file for a whole one. Here everything but places and polygons is passed over, and what is not whole is refused.
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
Properties = list[tuple[str, list[str]]]  # names, and one type or the two of a list
_PLY_TYPES = dict(zip(("char", "uchar", "short", "ushort", "int", "uint", "float", "double"), "bBhHiIfd", strict=True))
_PLY_TYPES |= {np.dtype(code).name: code for code in "bBhHiIfd"}
_MOST_CORNERS = 1000  # of a face: cutting it into triangles takes their square
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_mesh(path: str | Path) -> tuple[Array, Polygons]:
    """Return vertices (n, 3) in the file's units and the polygons as lists of vertex ids counted from 0.

    An STL file has no vertex ids: corner k of triangle i is vertex 3 i + k.
    """
    path = existing(path)
    readers: dict[str, Callable[[bytes], tuple[Array, Polygons]]] = {".obj": _obj, ".ply": _ply, ".stl": _stl}
    if path.suffix.lower() not in readers:
        raise FormatError(f"{path}: a mesh file ends in {', '.join(readers)}, not in {path.suffix!r}; export it as one")
    data = path.read_bytes()
    try:
        if not data.strip():
            raise ValueError("the file is empty")
        start = data.lstrip()[:200].lower()
        if start.startswith(b"version https://git-lfs"):
            raise ValueError("a pointer of git-lfs and not the mesh itself; fetch that with 'git lfs pull'")
        if start.startswith((b"<!doctype", b"<html", b"<?xml")):
            raise ValueError("a web page and not a mesh; download the file itself, not the page that shows it")
        vertices, polygons = readers[path.suffix.lower()](data)
        if not polygons:
            raise ValueError(f"{len(vertices)} vertices and no faces; a garment needs a surface")
        as_ids(list(itertools.chain(*polygons)), "a face", len(vertices))
        if max(map(len, polygons)) > _MOST_CORNERS:
            raise ValueError(f"a face of {max(map(len, polygons))} corners; cut those of more than {_MOST_CORNERS}")
    except ValueError as error:
        raise FormatError(f"{path}: {error}") from error
    return vertices, polygons


def _obj(data: bytes) -> tuple[Array, Polygons]:
    """All objects and groups together; ids in faces count from 1, or backwards from the last vertex before the face."""
    vertices: list[list[float]] = []
    polygons: Polygons = []
    lines = data.decode("utf-8", errors="replace").replace("\\\r\n", " ").replace("\\\n", " ").splitlines()
    for number, line in enumerate(lines, 1):
        words = line.split("#")[0].split()
        if not words or words[0] not in ("v", "f"):
            continue
        try:
            if words[0] == "v":
                x, y, z = map(float, words[1:4])
                vertices.append([x, y, z])
                continue
            corners = [int(word.split("/")[0]) for word in words[1:]]
        except ValueError as error:
            what = "three coordinates" if words[0] == "v" else "vertex numbers"
            raise ValueError(f"line {number} should hold {what}: {line.strip()[:60]!r}") from error
        if len(corners) < 3 or 0 in corners:
            raise ValueError(f"line {number} is no face of three corners, numbered from 1: {line.strip()[:60]!r}")
        polygons.append([corner - 1 if corner > 0 else len(vertices) + corner for corner in corners])
    return np.array(vertices, dtype=np.float64).reshape(-1, 3), polygons


def _stl(data: bytes) -> tuple[Array, Polygons]:
    """Binary when its length fits the count of triangles in its header, ASCII otherwise."""
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
    with np.errstate(invalid="ignore"):  # of a NaN that signals
        corners = corners.astype(np.float64)
    return corners, np.arange(len(corners)).reshape(-1, 3).tolist()


def _ply(data: bytes) -> tuple[Array, Polygons]:
    """ASCII or binary of either byte order; of its elements only the places of vertices and the lists of faces are kept."""
    head, mark, body = data.partition(b"end_header")
    header = [line.split() for line in head.decode("ascii", errors="replace").splitlines()]
    if not mark or not header or header[0] != ["ply"]:
        raise ValueError("not a PLY file: it must begin with 'ply' and have a header that ends in 'end_header'")
    kind = next((line[1] for line in header if len(line) > 1 and line[0] == "format"), "missing")
    orders = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
    if kind not in orders:
        raise ValueError(f"PLY format {kind!r}; expected one of {', '.join(orders)}")
    take = _taker(body, orders[kind])
    vertices: list[list[float]] = []
    polygons: Polygons = []
    elements = _ply_elements(header)
    try:
        for name, count, properties in elements:
            if properties and not 0 <= count <= len(body):  # a row of anything takes a byte or more
                raise ValueError(f"the file has {len(body)} bytes for them")
            for _ in range(count if properties else 0):
                row = {key: _ply_numbers(take, *types) for key, types in properties}
                if name == "vertex":
                    vertices.append([row[axis][0] for axis in "xyz"])
                elif name == "face":
                    polygons.append(list(map(int, row["vertex_index" if "vertex_index" in row else "vertex_indices"])))
    except KeyError as error:
        raise ValueError("its vertices have no x, y and z, or its faces no list vertex_indices") from error
    except (ValueError, IndexError, OverflowError, StopIteration, struct.error) as error:
        where = f"cut off or damaged among the {count} rows of its element {name!r}"
        raise ValueError(f"{where}: {str(error) or 'the file ends there'}") from error
    short = next((i for i, polygon in enumerate(polygons) if len(polygon) < 3), None)
    if short is not None:
        raise ValueError(f"face {short} has {len(polygons[short])} corners; three at least make a face")
    return np.array(vertices).reshape(-1, 3), polygons


def _ply_elements(header: list[list[str]]) -> list[tuple[str, int, Properties]]:
    """Name, number of rows and properties of each element; a property is its name and its types, two for a list."""
    elements: list[tuple[str, int, Properties]] = []
    line: list[str] = []
    try:
        for line in header:
            if line[:1] == ["element"]:
                elements.append((line[1], int(line[2]), []))
            elif line[:1] == ["property"]:
                _, *types, name = line if line[1] != "list" or len(line) < 5 else line[1:]
                elements[-1][2].append((name, [_PLY_TYPES[kind] for kind in types]))
    except (IndexError, KeyError, ValueError) as error:
        raise ValueError(f"a line of the PLY header is not understood: {' '.join(line)!r}") from error
    return elements


def _ply_numbers(take: Callable[[str], float], *types: str) -> list[float]:
    """The next number, or the next list: of two types the first is that of its length."""
    return [take(types[-1]) for _ in range(int(take(types[0])) if len(types) == 2 else 1)]


def _taker(body: bytes, order: str) -> Callable[[str], float]:
    """A function that takes the next number of a type from a body: binary of a byte order, or text."""
    if not order:
        words = iter(body.split())
        return lambda _: float(next(words))
    stream = io.BytesIO(body.split(b"\n", 1)[-1])
    return lambda code: float(struct.unpack(order + code, stream.read(struct.calcsize(order + code)))[0])
