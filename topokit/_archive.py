"""Archives: the one way in which topokit writes arrays with a JSON header beside them.

An archive is a zip file of NumPy arrays (an `.npz`) with one more entry, `header.json`. It holds no pickle. Its time stamps are
fixed, so that the same content gives the same bytes, and it replaces an older file in one piece. Every size that the file
declares is compared with what is there before memory is taken.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import os
import secrets
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

HEADER = "header.json"


class FormatError(ValueError):
    """A file that is not a whole one of the kind and schema asked for. The message names the file and the fault."""


def existing(path: str | Path) -> Path:
    """Return the path of a regular file; raise FileNotFoundError if there is none."""
    path = Path(path).expanduser()
    if not path.is_file():
        what = "a folder, not a file" if path.is_dir() else "there is no such file"
        raise FileNotFoundError(f"{path}: {what}")
    return path


def save_archive(path: str | Path, kind: str, header: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Path:
    """Write a header and arrays to one `.npz`; the same input gives the same bytes."""
    path = Path(path)
    if path.suffix != ".npz":
        raise ValueError(f"{path}: the name of an archive ends in .npz")
    # Every entry is made in memory first: an error leaves no file.
    document = json.dumps({**header, "kind": kind}, sort_keys=True, ensure_ascii=False)
    entries = {HEADER: document.encode()}
    for name in sorted(arrays):
        buffer = io.BytesIO()
        np.lib.format.write_array(buffer, np.ascontiguousarray(arrays[name]), allow_pickle=False)
        entries[f"{name}.npy"] = buffer.getvalue()
    with atomic_file(path) as handle, zipfile.ZipFile(handle, "w") as archive:
        for name, content in entries.items():
            entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))  # np.savez stamps the time of day
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, content)
    return path


def load_archive(path: str | Path, kind: str) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read what `save_archive` wrote: the header and the arrays by their names."""
    with _opened(path, kind) as (archive, header):
        names = [name for name in archive.namelist() if name != HEADER]
        return header, {name.removesuffix(".npy"): _array(archive, name) for name in names}


def load_header(path: str | Path, kind: str) -> dict[str, Any]:
    """Read the header of an archive alone."""
    with _opened(path, kind) as (_, header):
        return header


def is_archive(path: str | Path) -> bool:
    """Return whether a file is an archive that topokit wrote, of whatever kind."""
    if not zipfile.is_zipfile(existing(path)):
        return False
    with zipfile.ZipFile(path) as archive:
        return HEADER in archive.namelist()


@contextlib.contextmanager
def _opened(path: str | Path, kind: str) -> Iterator[tuple[zipfile.ZipFile, dict[str, Any]]]:
    """Open an archive of a kind and read its header; whatever goes wrong is a FormatError."""
    path = existing(path)
    wanted = kind.replace("topokit-", "topokit ")
    if not zipfile.is_zipfile(path):
        raise FormatError(f"{path}: not a {wanted}: the file is no whole .npz archive")
    try:
        with zipfile.ZipFile(path) as archive:
            if HEADER not in archive.namelist():
                raise FormatError(f"{path}: not a {wanted}: an .npz archive that topokit did not write")
            header = json.loads(archive.read(HEADER))
            found = header.pop("kind", None)
            if found != kind:
                raise FormatError(f"{path}: holds {found!r}, not a {wanted}")
            yield archive, header
    except FormatError:
        raise
    except Exception as error:  # damage shows in a dozen ways: bad zip, bad deflate, bad array header
        raise FormatError(f"{path}: the file is truncated or damaged ({error}); copy or make it again") from error


def _array(archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    """Read an array whose header declares the very size that its entry has."""
    with archive.open(name) as stream:
        np.lib.format.read_magic(stream)
        shape, column_major, dtype = np.lib.format.read_array_header_1_0(stream)
        if dtype.hasobject or column_major:
            raise ValueError(f"{name} is pickled, or in an order that topokit does not write")
        declared = stream.tell() + dtype.itemsize * math.prod(shape)
        if declared != archive.getinfo(name).file_size:
            raise ValueError(f"{name} declares {declared} bytes and has {archive.getinfo(name).file_size}")
        content = bytearray(stream.read())  # to the end, where the CRC-32 is compared
    return np.frombuffer(content, dtype).reshape(shape)


@contextlib.contextmanager
def atomic_file(path: str | Path) -> Iterator[IO[bytes]]:
    """Open a file that takes the place of `path` when the block ends well, and is removed when it does not."""
    path = Path(path).expanduser()
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        with temporary.open("xb") as handle:
            yield handle
            handle.flush()
            os.fsync(handle.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
