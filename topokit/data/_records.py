"""Records: what there is of an episode, and that it is whole. An episode counts once its record is in place.

A record is a small JSON file that names the objects of its episode with their SHA-256; it is renamed into place after they
are. Nothing in it depends on when, where or in which order it was made.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from topokit._archive import FormatError, atomic_file

STATUSES = ("ok", "rejected", "failed")


@dataclass(frozen=True)
class Record:
    """An episode in short."""

    episode: int
    status: str  # "ok"; "rejected": the simulation was not physical; "failed": it could not be made, after three tries
    reason: str = ""  # why, when the status is not ok
    task: str = ""
    garment: str = ""
    target: str = ""
    seed: int = 0  # of the episode
    success: bool = False
    frames: int = 0  # with the two below: 0 when the status is not ok
    vertices: int = 0
    observed: int = 0
    sha256: str = ""  # of the full record, which holds the checksums of the episode's objects


_COLUMNS = tuple(f.name for f in fields(Record))


def canonical(document: Mapping[str, Any]) -> bytes:
    """Return a document as the bytes that are stored and checksummed."""
    return (json.dumps(document, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n").encode()


def record_path(index: int) -> str:
    """Return where the record of an episode lies in its group."""
    return f"records/{index:08d}.json"


def commit(folder: Path, document: Mapping[str, Any], objects: Iterable[tuple[str, bytes]] = ()) -> None:
    """Put the objects of an episode in place, each whole, and then its record.

    None is there before all are written, so that a full disk leaves nothing; what a kill leaves without a record is replaced.
    """
    sums = {}
    with contextlib.ExitStack() as stack:
        for path, content in objects:
            stack.enter_context(atomic_file(folder / path)).write(content)
            sums[path] = hashlib.sha256(content).hexdigest()
    with atomic_file(folder / record_path(document["episode"])) as handle:
        handle.write(canonical({**document, "objects": sums}))


def parse(content: bytes, where: str) -> tuple[Record, dict[str, Any]]:
    """Return the short and the full form of a record."""
    try:
        document = json.loads(content)
        known = {name: document[name] for name in _COLUMNS if name in document}
        record = Record(**{**known, "sha256": hashlib.sha256(content).hexdigest()})
        if record.status not in STATUSES or record.episode != int(Path(where).stem):
            raise ValueError(f"it says episode {record.episode}, status {record.status!r}")
        if not isinstance(document["objects"], dict):
            raise ValueError("its objects have no names")
    except (ValueError, KeyError, TypeError) as error:
        message = f"{where}: not a whole record ({error}); remove it and give the same command again"
        raise FormatError(message) from error
    return record, document


def index_bytes(records: Iterable[Record]) -> bytes:
    """Return the index file of records: columns, so that 23,000 of them are read at once."""
    ordered = sorted(records, key=lambda record: record.episode)
    return canonical({"version": 1, **{name: [getattr(r, name) for r in ordered] for name in _COLUMNS}})


def read_index(content: bytes, where: str) -> dict[int, Record]:
    """Return the records of an index file."""
    try:
        document = json.loads(content)
        rows = zip(*(document[name] for name in _COLUMNS), strict=True)
        return {row[0]: Record(*row) for row in rows}
    except (ValueError, KeyError, TypeError) as error:
        message = f"{where}: a damaged index ({error}); remove it, it is made again from the records"
        raise FormatError(message) from error
