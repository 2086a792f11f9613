"""Read PCD files, as PCL and many others write them.

Idea: the header gives the type of a point; what it declares is compared with the bytes that follow before memory is taken.
pypcd4 refuses headers that PCL reads (types in small letters, no COUNT, fields of no numbers) and reads a file that is cut off
in part; its unpacker of LZF is used here.

Source: The PCD file format, pointclouds.org/documentation/tutorials/pcd_file_format.html.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topokit._strangers import check_unpacked

Array = NDArray[Any]
_MOST_NUMBERS = 2**12  # numbers of a point
_TYPES = {"F4": "<f4", "F8": "<f8"} | {f"{c}{n}": f"<{c.lower()}{n}" for c in "IU" for n in (1, 2, 4, 8)}
_DATA = re.compile(rb"^[ \t]*DATA[ \t]+(\w+)[^\n]*\n", re.MULTILINE | re.IGNORECASE)


def read_pcd(data: bytes) -> Array:
    """Return the points of a PCD file as rows (n,) with names."""
    head = _DATA.search(data, 0, 2**16)
    if head is None or b"\0" in data[: head.end()]:
        raise ValueError("not a PCD file: its header has no line DATA")
    kind, count = _header(data[: head.start()].decode(errors="replace"))
    body = data[head.end() :]
    packing = head[1].decode().lower()
    if packing == "binary_compressed":
        return _unpacked(body, kind, count)

    if packing == "ascii":
        names = kind.names or ()
        words = body.split()
        _check_count(len(words) // len(names), count)
        numbers = np.array([float(word) for word in words[: count * len(names)]]).reshape(count, len(names))
        floats = [kind[name] if kind[name].kind == "f" else np.dtype(np.float64) for name in names]
        return rows_of({name: column.astype(to) for name, column, to in zip(names, numbers.T, floats, strict=True)})
    if packing == "binary":
        _check_count(len(body) // kind.itemsize, count)
        return np.frombuffer(body, kind, count)
    raise ValueError(f"its DATA is {packing!r:.80}: known are ascii, binary, binary_compressed")


def rows_of(columns: Mapping[str, Array]) -> Array:
    """Return columns by their names, one at least, as one array of rows."""
    first = next(iter(columns.values()))
    rows = np.empty(len(first), [(name, column.dtype) for name, column in columns.items()])
    for name, column in columns.items():
        rows[name] = column
    return rows


def _check_count(held: int, declared: int) -> None:
    """Raise ValueError when there are fewer rows than declared, or more: a part would be read as the whole."""
    if held != declared:
        raise ValueError(f"cut off or damaged: it holds {held} of {declared} points")


def _header(text: str) -> tuple[np.dtype[Any], int]:
    """Return the type of a point, and how many points there are."""
    entries: dict[str, list[str]] = {}
    for line in text.splitlines():
        words = line.split("#")[0].split()
        if words:
            entries[words[0].upper()] = words[1:]
    try:
        names = entries.get("FIELDS", entries.get("COLUMNS", []))
        usual = {"COUNT": "1", "SIZE": "4", "TYPE": "F"}
        if {"SIZE", "TYPE"} & set(entries):  # else the numbers are floats: files of version .5 may have the names alone
            usual = {"COUNT": "1"}
        columns = {word: entries.get(word, len(names) * [usual.get(word, "")]) for word in ("COUNT", "SIZE", "TYPE")}
        for word, values in columns.items():
            if len(values) != len(names):
                raise ValueError(f"{len(names)} FIELDS and {len(values)} numbers of {word}")
        counts = [int(word) for word in columns["COUNT"]]
        if sum(counts) > _MOST_NUMBERS or min(counts, default=0) < 0:
            raise ValueError(f"COUNT {max(counts)}")
        fields: dict[str, str] = {}
        for number, (name, letter, size, times) in enumerate(
            zip(names, columns["TYPE"], columns["SIZE"], counts, strict=True)
        ):
            form = _TYPES.get(letter.upper() + size)
            if form is None:
                raise ValueError(f"TYPE {letter} of SIZE {size}; known are {', '.join(_TYPES)}")
            for i in range(times):
                # A field of several numbers becomes several; gaps called "_" get numbers.
                unique = name if times == 1 else f"{name}__{i:04d}"
                if unique in fields or name == "_":
                    unique = f"{unique}_{number}"
                fields[unique] = form
        kind = np.dtype(list(fields.items()))
        points = math.prod(int(entries[word][0]) for word in ("WIDTH", "HEIGHT") if word in entries)
        declared = int(entries["POINTS"][0]) if "POINTS" in entries else points
    except (KeyError, IndexError, ValueError, TypeError) as error:
        raise ValueError(f"its header is not understood: {error}") from error
    if not fields or declared < 0 or ("WIDTH" in entries and points != declared):
        raise ValueError(f"its header declares {declared} points, in an image of {points}, of {len(fields)} numbers")
    return kind, declared


def _unpacked(body: bytes, kind: np.dtype[Any], points: int) -> Array:
    """Return the points of packed columns, which follow one another."""
    import lzf  # type: ignore[import-not-found]

    packed, size = (int.from_bytes(body[at : at + 4], "little") for at in (0, 4))
    if size != points * kind.itemsize or packed + 8 > len(body):
        held = f"{size} bytes unpacked, and {len(body) - 8} of {packed} packed"
        raise ValueError(f"cut off or damaged: it declares {points} points, {held}")
    check_unpacked(size, len(body))
    columns = lzf.decompress(body[8 : 8 + packed], size) if size else b""
    if columns is None or len(columns) != size:
        raise ValueError("cut off or damaged: it does not unpack to what its header declares")
    rows = np.empty(points, kind)
    start = 0
    for name in kind.names or ():
        rows[name] = np.frombuffer(columns, kind[name], points, start)
        start += points * kind[name].itemsize
    return rows
