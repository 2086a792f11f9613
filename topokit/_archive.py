"""Archives: the one way in which topokit writes arrays with a JSON document beside them.

An archive is an `.npz` without pickle, checksummed, of fixed time stamps (same content, same bytes), replaced in one piece.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

_VERSION = 2  # of the checksum: the first covered the arrays alone, and still reads
FREE, RATIO = 2**28, 100  # what a file may unpack to: so many bytes, and so many times its own


class FormatError(ValueError):
    """A file that is not a whole one of the kind and schema asked for. The message says which and what is wrong."""


def existing(path: str | Path) -> Path:
    path = Path(path)
    if not path.is_file():
        there = "a folder, not a file" if path.is_dir() else "a device or a pipe, not a file"
        raise FileNotFoundError(f"{path}: {there if path.exists() else 'there is no such file'}")
    return path


def read_json(content: bytes | str) -> Any:
    """What JSON of any origin holds; a ValueError also when it is nested so deeply that Python gives up."""
    try:
        return json.loads(content)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def save_archive(path: str | Path, kind: str, text: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Path:
    """Write arrays and a JSON document to one `.npz`, both checksummed; same input, same bytes."""
    path = Path(path)
    if path.suffix != ".npz":
        raise ValueError(f"{path}: the name of an archive ends in .npz")
    document = {**text, "kind": kind, "archive": _VERSION}
    document["sha256"] = _digest(arrays, document)
    parts = {**arrays, "json": np.frombuffer(json.dumps(document, sort_keys=True).encode(), dtype=np.uint8)}
    with atomic_file(path) as handle:
        _write(handle, parts, zipfile.ZIP_DEFLATED)
        if 2 * sum(part.nbytes for part in parts.values()) > FREE + RATIO * handle.tell():
            handle.seek(0)
            handle.truncate()
            _write(handle, parts, zipfile.ZIP_STORED)  # so dense, it would not be read
    return path


def _write(handle: IO[bytes], parts: dict[str, NDArray[Any]], method: int) -> None:
    with zipfile.ZipFile(handle, "w") as archive:
        for name in sorted(parts):
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, np.ascontiguousarray(parts[name]), allow_pickle=False)
            entry = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))  # np.savez stamps the time of day
            entry.compress_type = method
            archive.writestr(entry, buffer.getvalue())


def load_archive(path: str | Path, kind: str) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read what `save_archive` wrote: the JSON document (without kind and checksum) and the arrays."""
    path = existing(path)
    size = path.stat().st_size
    if size == 0:
        raise FormatError(f"{path}: the file is empty (0 bytes)")
    with path.open("rb") as handle:
        if handle.read(4) != b"PK\x03\x04":
            raise FormatError(f"{path}: not a {_words(kind)}: the file is no .npz archive")
        handle.seek(0)
        try:
            with np.load(handle, allow_pickle=False) as archive:
                check_size(archive.zip.infolist(), size)
                document, digest = _document(archive, path, kind)
                arrays = {name: archive[name] for name in archive.files if name != "json"}
        except FormatError:
            raise
        except Exception as error:  # damage shows in a dozen ways: bad zip, bad deflate, unknown compression
            raise FormatError(f"{path}: the file is truncated or damaged ({error}); copy or record it again") from error
    for name, part in arrays.items():
        if part.size == 0 and max(part.shape) > FREE // 256:  # lists made of its nothings would fill the memory
            raise FormatError(f"{path}: {name} is empty and claims the shape {part.shape}")
    if _digest(arrays, document if "archive" in document else None) != digest:
        raise FormatError(f"{path}: the checksum does not match: changed or damaged; copy or record it again")
    return {name: value for name, value in document.items() if name not in ("kind", "archive")}, arrays


def check_size(entries: list[zipfile.ZipInfo], size: int) -> None:
    """Whether an archive of so many bytes may hold these entries."""
    whole = sum(entry.file_size for entry in entries)
    if whole > FREE + RATIO * size:
        raise ValueError(f"its {size} bytes claim to hold {whole}")
    for entry in entries:
        if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):  # the others unpack without bound
            raise ValueError(f"{entry.filename} is packed by another method than deflate")


def _document(archive: Any, path: Path, kind: str) -> tuple[dict[str, Any], Any]:
    """The JSON document of an archive of that kind, and the checksum that it held."""
    try:
        document = read_json(archive["json"].tobytes())
        found, digest = document["kind"], document.pop("sha256")
    except (KeyError, ValueError, AttributeError, TypeError) as error:
        raise FormatError(f"{path}: not a {_words(kind)}: an .npz archive that topokit did not write") from error
    if found != kind:
        raise FormatError(f"{path}: holds a {_words(found)}, not a {_words(kind)}")
    return document, digest


def _words(kind: object) -> str:
    return str(kind).replace("topokit-", "topokit ")


@contextlib.contextmanager
def atomic_file(path: str | Path) -> Iterator[IO[bytes]]:
    """Open a file that takes the place of `path` when the block ends well, and leaves no trace when it does not."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
    try:
        with os.fdopen(descriptor, "wb") as handle:
            yield handle
            handle.flush()
            os.fsync(handle.fileno())
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(temporary, 0o666 & ~umask)  # mkstemp makes files that only their owner can read
        os.replace(temporary, path)
    except BaseException as error:
        if isinstance(error, OSError) and error.errno and error.filename is None:
            error.filename = str(path)  # of a disk that is full, Python does not say which file was to be written
        with contextlib.suppress(FileNotFoundError):
            os.unlink(temporary)
        raise


def _digest(arrays: dict[str, NDArray[Any]], document: dict[str, Any] | None) -> str:
    """SHA-256 over names, types, shapes and values, in the order of the names, and over the document, if any."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name}|{array.dtype.str}|{array.shape}|".encode())
        digest.update(array.tobytes())
    if document is not None:
        digest.update(json.dumps(document, sort_keys=True).encode())
    return digest.hexdigest()
