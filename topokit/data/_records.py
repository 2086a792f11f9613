"""Records: what there is of an episode, and that it is whole. An episode counts once its record is in place.

A record is a small JSON file that names the objects of its episode with their SHA-256; it is renamed into place after they
are. Nothing in it depends on when, where or in which order it was made.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from topokit._archive import FormatError

__all__ = ["STATUSES", "Record", "canonical", "commit", "index_bytes", "loose", "read_index", "record_path", "total"]

STATUSES = ("ok", "rejected", "failed")


@dataclass(frozen=True)
class Record:
    """An episode in short.

    Attributes
    ----------
    episode : int
        Its number.
    status : {"ok", "rejected", "failed"}
        Rejected: the simulation was not physical. Failed: it could not be made, after three tries.
    reason : str
        Why, when the status is not ok.
    task, garment, target : str
    seed : int
        Of the episode.
    success : bool
    frames, vertices, observed : int
        0 when the status is not ok.
    sha256 : str
        Of the full record, which holds the checksums of the episode's objects.
    """

    episode: int
    status: str
    reason: str
    task: str
    garment: str
    target: str
    seed: int
    success: bool
    frames: int
    vertices: int
    observed: int
    sha256: str


COLUMNS = tuple(f.name for f in fields(Record))
_DEFAULTS = {"reason": "", "garment": "", "target": "", "task": "", "seed": 0, "success": False}


def canonical(document: Mapping[str, Any]) -> bytes:
    """Return a document as the bytes that are stored and checksummed."""
    return (json.dumps(document, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n").encode()


def record_path(index: int) -> str:
    """Return where the record of an episode lies in its group."""
    return f"records/{index:08d}.json"


def commit(folder: Path, document: Mapping[str, Any], objects: Iterable[tuple[str, bytes]] = ()) -> Record:
    """Put the objects of an episode in place and then its record.

    Everything is first written whole to a folder of its own, so that a full disk or a kill leaves nothing half-written in
    place. What was in place without a record is replaced.
    """
    index = int(document["episode"])
    stage = folder / ".part" / f"{index}-{os.getpid()}"
    stage.mkdir(parents=True, exist_ok=True)
    try:
        sums = {}
        for number, (path, content) in enumerate(objects):
            sums[path] = hashlib.sha256(content).hexdigest()
            _write(stage / str(number), content)
        content = canonical({**document, "objects": sums})
        _write(stage / "record", content)
        for number, path in enumerate(sums):
            os.replace(stage / str(number), folder / path)
        os.replace(stage / "record", folder / record_path(index))
    finally:
        shutil.rmtree(stage, ignore_errors=True)
    return parse(content, record_path(index))


def _write(path: Path, content: bytes) -> None:
    with path.open("wb") as handle:
        handle.write(content)
        handle.flush()
        os.fsync(handle.fileno())


def parse(content: bytes, where: str) -> Record:
    """Return the short form of a record."""
    try:
        document = json.loads(content)
        values = {name: document.get(name, _DEFAULTS.get(name, 0)) for name in COLUMNS if name != "sha256"}
        record = Record(**values, sha256=hashlib.sha256(content).hexdigest())
        if record.status not in STATUSES or record.episode != int(Path(where).stem):
            raise ValueError(f"it says episode {record.episode}, status {record.status!r}")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise FormatError(
            f"{where}: not a whole record ({error}); remove it and give the same command again"
        ) from error
    return record


def index_bytes(records: Iterable[Record]) -> bytes:
    """Return the index file of records: columns, so that 23,000 of them are read at once."""
    ordered = sorted(records, key=lambda record: record.episode)
    return canonical({"version": 1, **{name: [getattr(r, name) for r in ordered] for name in COLUMNS}})


def read_index(content: bytes, where: str) -> dict[int, Record]:
    """Return the records of an index file."""
    try:
        document = json.loads(content)
        rows = zip(*(document[name] for name in COLUMNS), strict=True)
        return {row[0]: Record(*row) for row in rows}
    except (ValueError, KeyError, TypeError) as error:
        raise FormatError(
            f"{where}: a damaged index ({error}); remove it, it is made again from the records"
        ) from error


def loose(names: Iterable[str], known: Mapping[int, Record]) -> list[int]:
    """Return the numbers of the records among file names that are not known yet."""
    numbers = (int(name[:8]) for name in names if len(name) == 13 and name[:8].isdigit() and name.endswith(".json"))
    return sorted(number for number in numbers if number not in known)


def total(manifest: Mapping[str, Any], records: Mapping[int, Record]) -> str:
    """Return one checksum of all: of what the dataset is, and of the records in their order."""
    digest = hashlib.sha256(canonical(manifest))
    for number in sorted(records):
        digest.update(f"{number} {records[number].sha256}\n".encode())
    return digest.hexdigest()
