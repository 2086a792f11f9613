"""Read PLY files of clouds and of meshes: ASCII and binary of either byte order, with any elements and properties.

Idea: a file is one stream of numbers, of words or of bytes. Elements without lists, and with lists of one length, are read at
once as rows of one NumPy type; all others number by number. A file that ends early is refused, and so is one with more rows
than its header counts: it would be read in part.

General readers are not used: trimesh 5.2 takes half a file for a whole one where the counts of the header are wrong, reads
triangles and quads together with a wrong triangle, and refuses rows that share a line; plyfile is under the GPL.
"""

from __future__ import annotations

import re
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

Column = NDArray[Any] | list[list[float]]
Properties = list[tuple[str, list[str]]]  # the name of a property, and its one type, or the two types of a list
_CODES = {
    **{
        "char": "i1",
        "uchar": "u1",
        "short": "i2",
        "ushort": "u2",
        "int": "i4",
        "uint": "u4",
        "float": "f4",
        "double": "f8",
    },
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4"},
    **{"float64": "f8"},
}
_STRUCT = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f4": "f", "f8": "d"}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_MOST_REGULAR = 100  # numbers of a row that is read as a type of its own
_END = re.compile(rb"^end_header[ \t]*(\r\n|\n|\r)", re.MULTILINE)


class _NoMoreError(ValueError):
    """The file ends before its rows do."""


def read_ply(data: bytes) -> dict[str, dict[str, Column]]:
    """Return the elements of a PLY file: for each its properties, an array (n,), or n lists.

    Raises
    ------
    ValueError
        When the header is none, or counts other rows than there are; the message names the element.
    """
    # A file of an old Mac ends its lines with a carriage return alone, so that ^ finds none.
    end = _END.search(data)
    if end is None and b"\n" not in data[: data.find(b"end_header") + 11]:
        end = re.search(rb"\rend_header[ \t]*(\r)", data)
    lines = [line.split() for line in data[: end.start() if end else 0].decode("ascii", errors="replace").splitlines()]
    if end is None or not lines or lines[0] != ["ply"]:
        raise ValueError("not a PLY file: it must begin with 'ply' and have a header that ends in 'end_header'")
    formats = [line[1] for line in lines if len(line) > 1 and line[0] == "format"] or ["missing"]
    if formats[0] not in _ORDERS:
        raise ValueError(f"PLY format {formats[0]!r:.80}; expected one of {', '.join(_ORDERS)}")

    body = data[end.end() :]
    source: _Words | _Bytes = _Words(body)
    if formats[0] != "ascii":
        source = _Bytes(body, _ORDERS[formats[0]])
    found: dict[str, dict[str, Column]] = {}
    row = 0
    for name, count, properties in _elements(lines):
        if not properties:
            continue
        try:
            if not 0 <= count <= len(body):  # a row of anything takes a byte or more
                raise ValueError(f"the file has {len(body)} bytes for them")
            before = source.at
            found[name] = _rows(source, count, properties)
        except (ValueError, OverflowError, struct.error) as error:
            where = f"cut off or damaged among the {count} rows of its element {name!r:.80}"
            raise ValueError(f"{where}: {error}") from error
        if count:
            row = (source.at - before) // count
    if row and source.left >= row:
        raise ValueError(f"{source.left} {source.unit} follow the rows that its header counts: it counts too few")
    return found


def _elements(lines: list[list[str]]) -> list[tuple[str, int, Properties]]:
    """Return the name, the number of rows and the properties of each element that a header declares."""
    elements: list[tuple[str, int, Properties]] = []
    line: list[str] = []
    try:
        for line in lines:
            if line[:1] == ["element"]:
                elements.append((line[1], int(line[2]), []))
            elif line[:1] == ["property"]:
                # "property TYPE NAME", or "property list TYPE_OF_COUNT TYPE NAME"
                words = line[1:]
                if words[0] == "list" and len(words) > 3:
                    words = words[1:]
                *types, name = words
                if len(types) not in (1, 2):
                    raise ValueError("one type, or two of a list")
                elements[-1][2].append((name, [_CODES[kind] for kind in types]))
    except (IndexError, KeyError, ValueError) as error:
        raise ValueError(f"a line of the PLY header is not understood: {' '.join(line)!r:.80}") from error
    return elements


class _Words:
    """The body of an ASCII file: numbers with blanks or new lines between, however many."""

    unit = "numbers"

    def __init__(self, body: bytes) -> None:
        self._words = body.split()
        self.at = 0

    @property
    def left(self) -> int:
        """Return how many numbers were not taken."""
        return len(self._words) - self.at

    def take(self, code: str) -> float:
        """Return the next number."""
        if not self.left:
            raise _NoMoreError("the file ends there")
        self.at += 1
        return float(self._words[self.at - 1])

    def rows(self, count: int, codes: list[str]) -> list[NDArray[Any]]:
        """Return the columns of so many rows."""
        size = count * len(codes)
        if size > self.left:
            raise _NoMoreError("the file ends there")
        numbers = np.array([float(word) for word in self._words[self.at : self.at + size]])
        self.at += size
        return list(numbers.reshape(count, len(codes)).T)


class _Bytes:
    """The body of a binary file."""

    unit = "bytes"

    def __init__(self, body: bytes, order: str) -> None:
        self._body = body
        self._order = order
        self.at = 0

    @property
    def left(self) -> int:
        """Return how many bytes were not taken."""
        return len(self._body) - self.at

    def take(self, code: str) -> float:
        """Return the next number."""
        layout = self._order + _STRUCT[code]
        if self.left < struct.calcsize(layout):
            raise _NoMoreError("the file ends there")
        (number,) = struct.unpack_from(layout, self._body, self.at)
        self.at += struct.calcsize(layout)
        return float(number)

    def rows(self, count: int, codes: list[str]) -> list[NDArray[Any]]:
        """Return the columns of so many rows."""
        kind = np.dtype([(f"{i}", self._order + code) for i, code in enumerate(codes)])
        if count * kind.itemsize > self.left:
            raise _NoMoreError("the file ends there")
        rows = np.frombuffer(self._body, kind, count, self.at)
        self.at += count * kind.itemsize
        return [rows[f"{i}"] for i in range(len(codes))]


def _rows(source: _Words | _Bytes, count: int, properties: Properties) -> dict[str, Column]:
    """Return the columns of an element; where a name comes twice, the first of them."""
    columns: dict[str, Column] = {}
    if all(len(types) == 1 for _, types in properties):
        arrays = source.rows(count, [types[0] for _, types in properties])
        for (name, _), array in zip(properties, arrays, strict=True):
            columns.setdefault(name, array)
        return columns

    # Lists: those of the first row may have the lengths of all others, as the corners of triangles.
    start = source.at
    lengths: list[int] = []
    try:
        lengths = [len(numbers) for numbers in _one_row(source, properties)] if count else []
        source.at = start
        if sum(lengths) > _MOST_REGULAR:
            raise _OtherLengthsError
        arrays = source.rows(count, _flat_codes(properties, lengths)) if count else []
        return _regular(properties, lengths, arrays)
    except (_NoMoreError, _OtherLengthsError):
        source.at = start
    lists: list[list[list[float]]] = [[] for _ in properties]
    for _ in range(count):
        for column, numbers in zip(lists, _one_row(source, properties), strict=True):
            column.append(numbers)
    for (name, types), column in zip(properties, lists, strict=True):
        values: Column = column
        if len(types) == 1:
            values = np.array([number for (number,) in column])
        columns.setdefault(name, values)
    return columns


class _OtherLengthsError(ValueError):
    """Lists of several lengths."""


def _one_row(source: _Words | _Bytes, properties: Properties) -> list[list[float]]:
    """Return the numbers of each property of the next row."""
    row = []
    for _, types in properties:
        length = 1
        if len(types) == 2:
            length = int(source.take(types[0]))
        if not 0 <= length <= source.left:
            raise ValueError(f"a list of {length} numbers")
        row.append([source.take(types[-1]) for _ in range(length)])
    return row


def _flat_codes(properties: Properties, lengths: list[int]) -> list[str]:
    """Return the types of the numbers in a row whose lists have these lengths, their own lengths among them."""
    codes = []
    for (_, types), length in zip(properties, lengths, strict=True):
        codes += types[:-1] + length * types[-1:]
    return codes


def _regular(properties: Properties, lengths: list[int], arrays: list[NDArray[Any]]) -> dict[str, Column]:
    """Return the columns of rows that were read as if their lists had these lengths; raise an error if they have not."""
    columns: dict[str, Column] = {}
    left = iter(arrays)
    for (name, types), length in zip(properties, lengths or [0] * len(properties), strict=True):
        if not arrays:
            columns.setdefault(name, [] if len(types) == 2 else np.zeros(0))
            continue
        if len(types) == 2 and (next(left) != length).any():
            raise _OtherLengthsError
        parts = [next(left) for _ in range(length)]
        if len(types) == 1:
            columns.setdefault(name, parts[0])
        else:
            columns.setdefault(name, np.column_stack(parts).tolist() if parts else [[] for _ in arrays[0]])
    return columns
