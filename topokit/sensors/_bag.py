"""The messages of bags of ROS 1 (.bag) and ROS 2 (.mcap, .db3), with clouds, depth images and their cameras.

Idea: rosbags decodes messages. Its readers of files are not used, because they unpack without bound, parse YAML that a stranger
wrote, take a path for a URI and compile the definitions of messages that a file brings. Of a file only its records are needed:
they are read one after another, and all that they unpack to is counted (`topokit._strangers`).

Sources: the formats MCAP (mcap.dev/spec), ROS bag 2.0 (wiki.ros.org/Bags/Format/2.0) and the tables of rosbag2_storage_sqlite3.
"""

from __future__ import annotations

import bz2
import contextlib
import functools
import io
import re
import sqlite3
import struct
import sys
import zlib
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from topokit._archive import FormatError, existing, temporary_folder
from topokit._strangers import Budget

from ._files import natural_order

STORAGE = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")
METADATA = "metadata.yaml"
_MAGIC = b"\x89MCAP0\r\n"
_PIECE = 2**20  # bytes that are copied at a time
_ZSTD = b"\x28\xb5\x2f\xfd"
_LISTED = re.compile(r"^ *relative_file_paths:[ \t]*((?:\n *- .+)+)", re.MULTILINE)


@dataclass(frozen=True)
class Message:
    """A message as it is stored."""

    topic: str
    kind: str  #: its type without package, as "PointCloud2"
    received: int  #: nanoseconds
    data: bytes
    of_ros1: bool = False

    def decoded(self) -> Any:
        """Return the message; its type is ROS's own, whatever the file declares."""
        if self.of_ros1:
            return _types("ROS1_NOETIC").deserialize_ros1(self.data, self._type)
        return _types("LATEST").deserialize_cdr(self.data, self._type)

    @property
    def _type(self) -> str:
        package = "std_msgs" if self.kind == "Float32" else "sensor_msgs"
        return f"{package}/msg/{self.kind}"


@functools.cache
def _types(version: str) -> Any:
    """Return the types of messages of a version of ROS; code that decodes each of them is made once."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores[version])


class Bag:
    """A bag: a file, or the files of a folder of `ros2 bag record`."""

    def __init__(self, path: Path) -> None:
        self._files = [path]
        if path.is_dir():
            self._files = _files_of(path)
        self.kinds: dict[str, str] = {}  #: type of each topic
        for file in self._files:
            with _storage(file) as storage:
                self.kinds |= storage.kinds()

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Yield the messages of some topics, in the order in which they were received."""
        for file in self._files:
            with _storage(file) as storage:
                yield from storage.messages(topics)


def _files_of(folder: Path) -> list[Path]:
    """Return the files of a bag, in the order of its metadata."""
    names = sorted((path.name for path in folder.iterdir() if path.name.endswith(STORAGE)), key=natural_order)
    listed = _LISTED.search(existing(folder / METADATA).read_text(errors="replace"))
    if listed is not None:
        names = [Path(line.strip()[2:].strip().strip("\"'")).name for line in listed[1].strip().splitlines()]
    if not names:
        raise FormatError(f"{folder}: it holds no file {', '.join(STORAGE)}")
    return [existing(folder / name) for name in names]


@contextlib.contextmanager
def _storage(path: Path) -> Iterator[_Mcap | _Ros1 | _Sqlite]:
    """Open a file of a bag; it is unpacked into a temporary folder first when it is packed as a whole."""
    with temporary_folder() as folder:
        if path.suffix == ".zstd":
            budget = Budget(path.stat().st_size)
            unpacked = folder / path.stem
            with path.open("rb") as packed, unpacked.open("wb") as target:
                stream = _zstd().open(packed, "rb")
                while piece := stream.read(_PIECE):
                    budget.take(len(piece))
                    target.write(piece)
            path = unpacked
        kinds: dict[str, type[_Mcap] | type[_Ros1] | type[_Sqlite]]
        kinds = {".mcap": _Mcap, ".bag": _Ros1, ".db3": _Sqlite}
        with path.open("rb") as file, contextlib.closing(kinds[path.suffix.lower()](path, file)) as storage:
            yield storage


def _zstd() -> Any:
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd
    return zstd


def _unpackers() -> dict[str, Callable[[], Any]]:
    """Return what makes a decompressor, by the names of MCAP and of ROS 1."""
    from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

    return {"zstd": _zstd().ZstdDecompressor, "lz4": LZ4FrameDecompressor, "bz2": bz2.BZ2Decompressor}


class _Mcap:
    """Records of an MCAP file: a byte for its kind, eight for its length, its content."""

    def __init__(self, path: Path, file: IO[bytes]) -> None:
        self._file = file
        self._size = path.stat().st_size
        start = file.read(len(_MAGIC))
        file.seek(max(0, self._size - len(_MAGIC)))
        if start != _MAGIC or file.read() != _MAGIC or self._size < 2 * len(_MAGIC):
            raise ValueError("not a whole MCAP file: it must begin and end with the mark of one")

    def close(self) -> None:
        """Do nothing; the file is closed by its owner."""

    def kinds(self) -> dict[str, str]:
        """Return the type of each topic, by the index at the end, or else by all records."""
        self._file.seek(max(0, self._size - len(_MAGIC) - 20))
        (start,) = _numbers("<Q", self._file)
        kinds: dict[int, tuple[str, str]] = {}
        for _ in self._messages(kinds, start or len(_MAGIC)):
            pass
        return dict(kinds.values())

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Yield the messages of some topics."""
        kinds: dict[int, tuple[str, str]] = {}
        for channel, received, data in self._messages(kinds, len(_MAGIC)):
            topic, kind = kinds.get(channel, ("", ""))
            if topic in topics:
                yield Message(topic, kind, received, _plain(data, self._budget))

    def _messages(self, kinds: dict[int, tuple[str, str]], start: int) -> Iterator[tuple[int, int, bytes]]:
        """Yield channel, time and bytes of each message, and fill in topic and type of each channel."""
        self._budget = Budget(self._size)
        schemas: dict[int, str] = {}
        self._file.seek(start)
        for code, record in _mcap_records(self._file, self._size):
            records = [(code, record)]
            if code == 6:
                unpacked = self._chunk(record)
                records = list(_mcap_records(io.BytesIO(unpacked), len(unpacked)))
            for code, record in records:
                stream = io.BytesIO(record)
                if code == 3:
                    (number,) = _numbers("<H", stream)
                    schemas[number] = _text(stream).rpartition("/")[2]
                elif code == 4:
                    number, schema = _numbers("<HH", stream)
                    kinds[number] = (_text(stream), schemas.get(schema, ""))
                elif code == 5:
                    number, _, received, _ = _numbers("<HIQQ", stream)
                    yield number, received, stream.read()

    def _chunk(self, record: bytes) -> bytes:
        """Return the records of a chunk."""
        stream = io.BytesIO(record)
        _, _, size, checksum = _numbers("<QQQI", stream)
        packing = _text(stream)
        (packed_size,) = _numbers("<Q", stream)
        data = _exactly(stream, packed_size)
        if packing:
            data = self._budget.unpack(_unpacker(packing), data)
        if len(data) != size or (checksum and zlib.crc32(data) != checksum):
            raise ValueError("a chunk is damaged: its size or its checksum is another one")
        return data


def _mcap_records(file: IO[bytes], end: int) -> Iterator[tuple[int, bytes]]:
    """Yield kind and content of each record up to the end of the data."""
    while file.tell() < end:
        code, size = _numbers("<BQ", file)
        if code in (0x0F, 0x02):  # the end of the data, the footer: an index follows, which repeats what was read
            return
        if size > end - file.tell():
            raise ValueError("cut off or damaged: a record is longer than the file")
        yield code, _exactly(file, size)


class _Ros1:
    """Records of a bag of ROS 1: a header of named fields, and its content."""

    def __init__(self, path: Path, file: IO[bytes]) -> None:
        self._file = file
        self._size = path.stat().st_size
        if file.readline(32) != b"#ROSBAG V2.0\n":
            raise ValueError("not a bag of ROS 1, version 2.0")
        self._head, _ = next(_ros1_records(file, self._size))
        self._start = file.tell()

    def close(self) -> None:
        """Do nothing; the file is closed by its owner."""

    def kinds(self) -> dict[str, str]:
        """Return the type of each topic, by the index at the end."""
        kinds: dict[bytes, tuple[str, str]] = {}
        (start,) = struct.unpack("<Q", self._head["index_pos"])
        if not start:
            raise ValueError("its recording was not finished: repair it by 'rosbag reindex'")
        for _ in self._messages(kinds, start):
            pass
        return dict(kinds.values())

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Yield the messages of some topics."""
        kinds: dict[bytes, tuple[str, str]] = {}
        for connection, received, data in self._messages(kinds, self._start):
            topic, kind = kinds.get(connection, ("", ""))
            if topic in topics:
                yield Message(topic, kind, received, data, of_ros1=True)

    def _messages(self, kinds: dict[bytes, tuple[str, str]], start: int) -> Iterator[tuple[bytes, int, bytes]]:
        """Yield connection, time and bytes of each message, and fill in topic and type of each connection."""
        budget = Budget(self._size)
        self._file.seek(start)
        for head, content in _ros1_records(self._file, self._size):
            records = [(head, content)]
            if head["op"] == b"\5":
                packing = head["compression"].decode()
                if packing != "none":
                    content = budget.unpack(_unpacker(packing), content)
                records = list(_ros1_records(io.BytesIO(content), len(content)))
            for head, content in records:
                if head["op"] == b"\7":
                    kind = _fields(content)["type"].decode()
                    kinds[head["conn"]] = (head["topic"].decode(), kind.rpartition("/")[2])
                elif head["op"] == b"\2":
                    seconds, nanoseconds = struct.unpack("<II", head["time"])
                    yield head["conn"], 10**9 * seconds + nanoseconds, content


def _ros1_records(file: IO[bytes], end: int) -> Iterator[tuple[dict[str, bytes], bytes]]:
    while file.tell() < end:
        parts = []
        for _ in range(2):
            (size,) = _numbers("<I", file)
            if size > end - file.tell():
                raise ValueError("cut off or damaged: a record is longer than the file")
            parts.append(_exactly(file, size))
        yield _fields(parts[0]), parts[1]


def _fields(content: bytes) -> dict[str, bytes]:
    """Return the named fields of a header of ROS 1."""
    stream = io.BytesIO(content)
    fields = {}
    while stream.tell() < len(content):
        (size,) = _numbers("<I", stream)
        name, _, value = _exactly(stream, size).partition(b"=")
        fields[name.decode()] = value
    return fields


class _Sqlite:
    """The tables of a bag of ROS 2 in SQLite."""

    def __init__(self, path: Path, file: IO[bytes]) -> None:
        self._size = path.stat().st_size
        if file.read(16) != b"SQLite format 3\0":
            raise ValueError("not a bag of ROS 2 in SQLite")
        self._tables = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
        self._budget = Budget(self._size)
        # A view or a generated column would compute what no byte of the file holds.
        for table in ("topics", "messages"):
            kinds = list(self._rows("SELECT type, sql FROM sqlite_master WHERE name = ?", table))
            computed = any(row[6] for row in self._rows(f"PRAGMA table_xinfo({table})"))
            if len(kinds) != 1 or kinds[0][0] != "table" or "virtual" in kinds[0][1].lower() or computed:
                self.close()
                raise ValueError(f"its {table} are no plain table")

    def close(self) -> None:
        """Close the database."""
        self._tables.close()

    def _rows(self, question: str, *values: object) -> Iterator[Any]:
        """Yield rows, at most as many as there are bytes: pages that name each other would never end."""
        try:
            for number, row in enumerate(self._tables.execute(question, values)):
                if number > self._size:
                    raise ValueError("it is damaged: its pages name each other")
                yield row
        except sqlite3.Error as error:
            raise ValueError(f"it is damaged: {error}") from error

    def kinds(self) -> dict[str, str]:
        """Return the type of each topic."""
        return {str(name): str(kind).rpartition("/")[2] for name, kind in self._rows("SELECT name, type FROM topics")}

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Yield the messages of some topics."""
        about = {
            number: (name, str(kind).rpartition("/")[2])
            for number, name, kind in self._rows("SELECT id, name, type FROM topics")
            if name in topics
        }
        rows = [
            (received, row, topic)
            for row, received, topic in self._rows("SELECT rowid, timestamp, topic_id FROM messages")
            if topic in about
        ]
        if not all(isinstance(received, int) for received, _, _ in rows):
            raise ValueError("it is damaged: a message has no time")
        for received, row, topic in sorted(rows):
            for (data,) in self._rows("SELECT data FROM messages WHERE rowid = ?", row):
                if not isinstance(data, bytes):
                    raise ValueError(f"message {row} is no bytes")
                yield Message(*about[topic], received, _plain(data, self._budget))


def _unpacker(packing: str) -> Any:
    unpackers = _unpackers()
    if packing not in unpackers:
        raise ValueError(f"it is packed by {packing!r:.80}; known are {', '.join(unpackers)}")
    return unpackers[packing]()


def _plain(data: bytes, budget: Budget) -> bytes:
    """Return the bytes of a message, which may be packed on its own."""
    if data[:4] == _ZSTD:
        return budget.unpack(_unpacker("zstd"), data)
    return data


def _numbers(layout: str, file: IO[bytes]) -> tuple[Any, ...]:
    return struct.unpack(layout, _exactly(file, struct.calcsize(layout)))


def _text(file: IO[bytes]) -> str:
    (size,) = _numbers("<I", file)
    return _exactly(file, size).decode()


def _exactly(file: IO[bytes], size: int) -> bytes:
    data = file.read(min(size, 2**62))
    if len(data) != size:
        raise ValueError("cut off or damaged: a record ends in the middle")
    return data
