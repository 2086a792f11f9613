"""The record of an episode, and the index of all of them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import fields
from typing import Annotated, Any, Literal

import pydantic

from topokit._archive import FormatError, read_json
from topokit._config import checked

from ._layout import canonical

MOST_EPISODES = 100_000_000  # a record's name has eight digits
Number = Annotated[int, pydantic.Field(ge=0)]


@checked
class Record:
    """An episode in short."""

    episode: Annotated[int, pydantic.Field(ge=0, lt=MOST_EPISODES)]
    status: Literal["ok", "rejected", "failed"]  # rejected: it was not physical; failed: it could not be made
    reason: str = ""  # why, when the status is not ok
    task: str = ""
    garment: str = ""
    target: str = ""
    seed: Number = 0  # of the episode
    success: bool = False
    frames: Number = 0  # with the two below: 0 when the status is not ok
    vertices: Number = 0
    observed: Number = 0
    sha256: str = ""  # of the full record, which holds the checksums of the episode's objects


_COLUMNS = tuple(f.name for f in fields(Record))


def record_path(index: int) -> str:
    return f"records/{index:08d}.json"


def parse(content: bytes, where: str) -> tuple[Record, dict[str, Any]]:
    """The short and the full form of a record."""
    try:
        document = read_json(content)
        known = {name: document[name] for name in _COLUMNS if name in document}
        record = Record(**{**known, "sha256": hashlib.sha256(content).hexdigest()})
        if f"{record.episode:08d}.json" != where.rpartition("/")[2]:
            raise ValueError(f"it says episode {record.episode}")
        if not isinstance(document["objects"], dict):
            raise ValueError("its objects have no names")
    except (ValueError, KeyError, TypeError) as error:
        raise FormatError(f"{where}: not a whole record ({error}); remove it, the same command goes on") from error
    return record, document


def index_bytes(records: Iterable[Record]) -> bytes:
    """The index file of records: columns, so that 23,000 of them are read at once, and their checksum."""
    ordered = sorted(records, key=lambda record: record.episode)
    columns = {"version": 1, **{name: [getattr(r, name) for r in ordered] for name in _COLUMNS}}
    return canonical({**columns, "checksum": hashlib.sha256(canonical(columns)).hexdigest()})


def read_index(content: bytes, where: str) -> dict[int, Record]:
    try:
        document = read_json(content)
        if document.pop("checksum") != hashlib.sha256(canonical(document)).hexdigest():
            raise ValueError("its checksum is another")
        rows = zip(*(document[name] for name in _COLUMNS), strict=True)
        return {record.episode: record for record in (Record(*row) for row in rows)}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise FormatError(f"{where}: a damaged index ({error}); remove it, it is made again") from error
