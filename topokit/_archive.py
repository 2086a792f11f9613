"""Archives: the one way in which topokit writes arrays with a JSON header beside them.

An archive is a zip file of NumPy arrays (an `.npz`) with one more entry, `header.json`. It holds no pickle. Its time stamps are
fixed, so that the same content gives the same bytes, and it replaces an older file in one piece. A reader trusts the CRC-32
that a zip file holds of every entry, and compares every size that the file declares with what is there before it takes memory.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import os
import re
import secrets
import shutil
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ._strangers import check_unpacked, printable

HEADER = "header.json"
_MOST_HEADER = 2**24  # bytes: Python's objects take twenty times as much
_MOST_ROWS = 2**20  # of an array without elements: a list of its empty rows would fill the memory
_MOST_ARRAY_HEADER = 2**16  # bytes
_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:[/\\]")  # one letter alone is a disk of Windows
_LOCAL_HEADER = b"PK\x03\x04"
_unfinished: set[tuple[int, Path]] = set()  # files and folders to be removed, each with the process that writes them


class FormatError(ValueError):
    """A file that is not a whole one of the kind and schema asked for. The message names the file and the fault.

    The message is safe to print: what a stranger wrote into a file cannot steer a terminal.
    """

    def __init__(self, message: str) -> None:
        super().__init__(printable(message))


def existing(path: str | Path) -> Path:
    """Return the path of a regular file; a FileNotFoundError says what is there instead."""
    path = Path(path)
    if path.is_file():
        return path
    if path.is_dir():
        raise FileNotFoundError(f"{path}: a folder, not a file")
    if path.exists():
        raise FileNotFoundError(f"{path}: a device or a pipe, not a file")
    raise FileNotFoundError(f"{path}: there is no such file")


def read_json(content: bytes | str) -> Any:
    """Return what a JSON document holds; raise ValueError also when it is nested too deeply for Python."""
    try:
        return json.loads(content)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def save_archive(path: str | Path, kind: str, header: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Path:
    """Write a header and arrays to one `.npz`; the same input gives the same bytes."""
    path = Path(path)
    if path.suffix != ".npz":
        raise ValueError(f"{path}: the name of an archive ends in .npz")
    # Every entry is made in memory first: an error leaves no file.
    document = json.dumps({**header, "kind": kind}, sort_keys=True, ensure_ascii=False)
    entries = {HEADER: document.encode()}
    if len(entries[HEADER]) > _MOST_HEADER:
        raise ValueError(f"{path}: its header has more than {_MOST_HEADER} bytes, which no reader takes: store less")
    for name in sorted(arrays):
        buffer = io.BytesIO()
        np.lib.format.write_array(buffer, np.ascontiguousarray(arrays[name]), allow_pickle=False)
        entries[f"{name}.npy"] = buffer.getvalue()
    size = sum(map(len, entries.values()))
    with atomic_file(path) as handle:
        _write(handle, entries, zipfile.ZIP_DEFLATED)
        try:
            check_unpacked(size, handle.tell())
        except ValueError:  # a reader would refuse to unpack so much from so little: store it unpacked
            handle.seek(0)
            handle.truncate()
            _write(handle, entries, zipfile.ZIP_STORED)
    return path


def _write(handle: IO[bytes], entries: dict[str, bytes], method: int) -> None:
    with zipfile.ZipFile(handle, "w") as archive:
        for name, content in entries.items():
            entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))  # np.savez stamps the time of day
            entry.compress_type = method
            archive.writestr(entry, content)


def load_archive(path: str | Path, kind: str) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read what `save_archive` wrote: the header and the arrays by their names."""
    with _opened(path, kind) as (archive, header):
        arrays = {}
        for entry in archive.infolist():
            if entry.filename != HEADER:
                arrays[entry.filename.removesuffix(".npy")] = _array(archive, entry)
        return header, arrays


def load_header(path: str | Path, kind: str) -> dict[str, Any]:
    """Read the header of an archive alone."""
    with _opened(path, kind) as (_, header):
        return header


def is_archive(path: str | Path) -> bool:
    """Return whether a file is an archive that topokit wrote, of whatever kind; one that is damaged counts as one."""
    try:
        with zipfile.ZipFile(existing(path)) as archive:
            return HEADER in archive.namelist()
    except FileNotFoundError:
        raise
    except Exception:  # damage shows in a dozen ways, and its reader finds the words for it
        return True


@contextlib.contextmanager
def _opened(path: str | Path, kind: str) -> Iterator[tuple[zipfile.ZipFile, dict[str, Any]]]:
    """Open an archive of a kind and read its header; whatever goes wrong is a FormatError."""
    path = existing(path)
    size = path.stat().st_size
    if size == 0:
        raise FormatError(f"{path}: the file is empty (0 bytes)")
    with path.open("rb") as handle:
        if handle.read(4) != _LOCAL_HEADER:
            raise FormatError(f"{path}: not a {_in_words(kind)}: the file is no .npz archive")
        try:
            with zipfile.ZipFile(handle) as archive:
                check_size(archive.infolist(), size)
                yield archive, _header(archive, path, kind)
        except FormatError:
            raise
        except Exception as error:  # damage shows in a dozen ways: bad zip, bad deflate, bad array header
            raise FormatError(f"{path}: the file is truncated or damaged ({error}); copy or make it again") from error


def check_size(entries: list[zipfile.ZipInfo], size: int) -> None:
    """Raise ValueError unless an archive of `size` bytes may hold these entries."""
    check_unpacked(sum(entry.file_size for entry in entries), size)
    for entry in entries:
        # The other methods unpack without bound.
        if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ValueError(f"{entry.filename} is packed by another method than deflate")


def _header(archive: zipfile.ZipFile, path: Path, kind: str) -> dict[str, Any]:
    """Return the header of an archive, without its kind."""
    if HEADER not in archive.namelist():
        raise FormatError(f"{path}: not a {_in_words(kind)}: an .npz archive that topokit did not write")
    if archive.getinfo(HEADER).file_size > _MOST_HEADER:
        raise ValueError(f"{HEADER} has more than {_MOST_HEADER} bytes")
    header = read_json(archive.read(HEADER))
    if not isinstance(header, dict):
        raise ValueError(f"{HEADER} is no JSON object")
    found = header.pop("kind", None)
    if found != kind:
        raise FormatError(f"{path}: holds a {_in_words(found)}, not a {_in_words(kind)}")
    return header


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> NDArray[Any]:
    """Read an array whose header declares the very size that its entry has."""
    with archive.open(entry) as stream:
        # The header of a .npy: its shape and type say how many bytes must follow.
        try:
            shape, column_major, dtype = read_array_header(stream)
        except ValueError as error:
            raise ValueError(f"{entry.filename}: {error}") from error
        declared = stream.tell() + dtype.itemsize * math.prod(shape)
        if declared != entry.file_size:
            raise ValueError(f"{entry.filename} declares {declared} bytes and has {entry.file_size}")
        # Reading to the end compares the CRC-32.
        content = bytearray(stream.read())
    if column_major:
        return np.frombuffer(content, dtype).reshape(shape[::-1]).T
    return np.frombuffer(content, dtype).reshape(shape)


def read_array_header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Read the header of a .npy: shape, whether columns come first, and type; at most 64 kB are read."""
    version = np.lib.format.read_magic(stream)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"version {version} of .npy: versions (1, 0) and (2, 0) hold arrays of numbers")
    length = stream.read(2 * version[0])
    if int.from_bytes(length, "little") > _MOST_ARRAY_HEADER:
        raise ValueError(f"the header of an array has more than {_MOST_ARRAY_HEADER} bytes")
    header = io.BytesIO(length + stream.read(int.from_bytes(length, "little")))
    if version == (1, 0):
        shape, columns_first, kind = np.lib.format.read_array_header_1_0(header)
    else:
        shape, columns_first, kind = np.lib.format.read_array_header_2_0(header)
    if kind.hasobject:
        raise ValueError("it holds pickled objects")
    if min(shape, default=0) < 0:
        raise ValueError(f"it claims the shape {shape}")
    if math.prod(shape) * kind.itemsize == 0 and max(shape, default=0) > _MOST_ROWS:
        raise ValueError(f"it is empty and claims the shape {shape}")
    return shape, columns_first, kind


def _in_words(kind: object) -> str:
    return str(kind).replace("topokit-", "topokit ")


@contextlib.contextmanager
def atomic_file(path: str | Path) -> Iterator[IO[bytes]]:
    """Open a file that takes the place of `path` when the block ends well, and leaves no trace when it does not."""
    path = Path(path)
    if _URL.match(str(path)):
        raise ValueError(
            f"{path}: an address, and files are written into folders alone: write here, and copy them there"
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    _unfinished.add((os.getpid(), temporary))
    try:
        with temporary.open("xb") as handle:  # follows no link, and has the usual rights
            yield handle
            handle.flush()
            os.fsync(handle.fileno())
        os.replace(temporary, path)
    except BaseException as error:
        if isinstance(error, OSError) and error.errno and error.filename is None:
            error.filename = str(path)  # Python does not name the file when a disk is full
        temporary.unlink(missing_ok=True)
        raise
    finally:
        _unfinished.discard((os.getpid(), temporary))


@contextlib.contextmanager
def temporary_folder() -> Iterator[Path]:
    """Make a folder for temporary files, which is removed when the block ends.

    Its name is noted before it is made. So a signal that comes between the two leaves nothing behind. With `tempfile` it would
    leave the folder.
    """
    folder = Path(tempfile.gettempdir(), f"topokit-{secrets.token_hex(8)}")
    _unfinished.add((os.getpid(), folder))
    try:
        folder.mkdir(mode=0o700)
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        _unfinished.discard((os.getpid(), folder))


def remove_unfinished() -> None:
    """Remove the files that this process is writing, and its temporary folders: it ends without any cleaning up."""
    for process, temporary in list(_unfinished):
        if process != os.getpid():
            continue
        if temporary.is_dir():
            shutil.rmtree(temporary, ignore_errors=True)
        else:
            temporary.unlink(missing_ok=True)
