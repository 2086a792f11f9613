"""A group of a dataset, the episodes or a set of labels: opened from anywhere, made and grown on a local disk.

An episode counts once its record is in place: a small JSON file that names the objects of its episode with their SHA-256 and
is renamed into place after they are. Nothing in it depends on when, where or in which order it was made.
"""

import contextlib
import hashlib
import json
import platform
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topokit import __version__
from topokit._archive import FormatError, atomic_file

from ._layout import Field, cloud_of, skeleton, unpack


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
    return (json.dumps(document, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n").encode()


def record_path(index: int) -> str:
    return f"records/{index:08d}.json"


def commit(folder: Path, document: Mapping[str, Any], objects: Iterable[tuple[str, bytes]] = ()) -> None:
    """Put the objects of an episode in place, each whole, and then its record: what has none is made again."""
    sums = {}
    with contextlib.ExitStack() as stack:  # none is there before all are written: a full disk leaves nothing
        for path, content in objects:
            stack.enter_context(atomic_file(folder / path)).write(content)
            sums[path] = hashlib.sha256(content).hexdigest()
    replace(folder / record_path(document["episode"]), canonical({**document, "objects": sums}))


def parse(content: bytes, where: str) -> tuple[Record, dict[str, Any]]:
    """The short and the full form of a record."""
    try:
        document = json.loads(content)
        known = {name: document[name] for name in _COLUMNS if name in document}
        record = Record(**{**known, "sha256": hashlib.sha256(content).hexdigest()})
        if record.status not in ("ok", "rejected", "failed") or record.episode != int(Path(where).stem):
            raise ValueError(f"it says episode {record.episode}, status {record.status!r}")
        if not isinstance(document["objects"], dict):
            raise ValueError("its objects have no names")
    except (ValueError, KeyError, TypeError) as error:
        raise FormatError(f"{where}: not a whole record ({error}); remove it, the same command goes on") from error
    return record, document


def index_bytes(records: Iterable[Record]) -> bytes:
    """The index file of records: columns, so that 23,000 of them are read at once."""
    ordered = sorted(records, key=lambda record: record.episode)
    return canonical({"version": 1, **{name: [getattr(r, name) for r in ordered] for name in _COLUMNS}})


def read_index(content: bytes, where: str) -> dict[int, Record]:
    try:
        document = json.loads(content)
        rows = zip(*(document[name] for name in _COLUMNS), strict=True)
        return {row[0]: Record(*row) for row in rows}
    except (ValueError, KeyError, TypeError) as error:
        raise FormatError(f"{where}: a damaged index ({error}); remove it, it is made again") from error


class Group:
    """Records and arrays of a group, read only."""

    def __init__(self, url: str | Path, prefix: str = "") -> None:
        import fsspec

        self.url, self.prefix = str(url), prefix
        self._fs, self._root = fsspec.core.url_to_fs(self.url)
        self._arrays: dict[str, Any] = {}
        content = self.read("zarr.json")
        if content is None:
            raise FileNotFoundError(f"{self.where()}: there is no dataset (no zarr.json)")
        try:
            self.manifest: dict[str, Any] = json.loads(content)["attributes"]["topokit"]  #: what the group is
            number = self.manifest["version"]
        except (ValueError, KeyError, TypeError) as error:
            raise FormatError(f"{self.where('zarr.json')}: not the group of a topokit dataset ({error})") from error
        if number != 1:
            raise FormatError(f"{self.where()}: of version {number}; this topokit reads version 1")

    def where(self, path: str = "") -> str:
        return _join(self.url, self.prefix, path)

    @property
    def numbers(self) -> list[int]:
        """The episodes that it is to have."""
        return list(self.manifest.get("numbers") or range(self.manifest["episodes"]))

    @cached_property
    def records(self) -> dict[int, Record]:
        """Of the episodes that were tried, in short."""
        content = self.read("index.json")
        records = {} if content is None else read_index(content, self.where("index.json"))
        if len(records) < len(self.numbers):  # only then can there be records that the index does not know
            numbers = {int(name[:8]) for name in self.names("records") if name[:8].isdigit()}
            for number in sorted(numbers - records.keys()):
                path = record_path(number)
                if (content := self.read(path)) is not None:  # it may just have been removed, to be made again
                    records[number], _ = parse(content, path)
        return records

    @cached_property
    def whole(self) -> NDArray[np.int64]:
        """(n,) the episodes that are there, in order."""
        return np.array(sorted(i for i, r in self.records.items() if r.status == "ok"), dtype=np.int64)

    def checksum(self) -> str:
        """Return one SHA-256 of all: of what the group is, and of its records in their order."""
        digest = hashlib.sha256(canonical(self.manifest))
        for number in sorted(self.records):
            digest.update(f"{number} {self.records[number].sha256}\n".encode())
        return digest.hexdigest()

    def read(self, path: str) -> bytes | None:
        """Return the content of a file, None when there is none."""
        with contextlib.suppress(FileNotFoundError, NotADirectoryError, KeyError):
            return bytes(self._fs.cat_file(_join(self._root, self.prefix, path)))
        return None

    def names(self, folder: str) -> list[str]:
        """Return the names of the files in place in a folder; none when there is no such folder."""
        try:
            entries = self._fs.ls(_join(self._root, self.prefix, folder), detail=False)
        except (FileNotFoundError, NotImplementedError):
            return []
        found = (name.rstrip("/").rpartition("/")[2] for name in entries)
        return sorted(name for name in found if not name.startswith("."))

    def document(self, index: int) -> dict[str, Any]:
        """Return the full record of an episode."""
        content = self.read(record_path(index))
        if content is None:
            raise KeyError(f"{self.where()} has no episode {index}")
        return parse(content, record_path(index))[1]

    def array(self, name: str) -> Any:
        """Return an array as Zarr gives it."""
        if name not in self._arrays:
            import zarr

            path = _join(self._root, self.prefix, name)
            local = "file" in np.atleast_1d(self._fs.protocol)
            self._arrays[name] = zarr.open_array(Path(path) if local else self._fs.get_mapper(path), mode="r")
        return self._arrays[name]


def _join(*parts: str) -> str:
    return "/".join(part.rstrip("/") for part in parts if part)


def open_episodes(url: str | Path) -> Group:
    group = Group(url)
    if group.manifest.get("format") != "topokit-dataset":
        raise FormatError(f"{url}: labels, not the dataset that they are of; open the folder that holds `labels`")
    return group


def decode(group: Group, document: Mapping[str, Any], names: tuple[str, ...] = ()) -> dict[str, NDArray[Any]]:
    """Return the arrays of an episode as they are stored, each in its own extent; all of them when none is named."""
    index, shapes = document["episode"], document["shapes"]
    return {name: np.asarray(group.array(name)[(index, *map(slice, shapes[name]))]) for name in names or shapes}


def tracked_cloud(group: Group, document: Mapping[str, Any], labels: Mapping[str, Any]) -> NDArray[np.float32]:
    """(T, n, 3) the cloud of an episode that labels of that manifest are of, in metres."""
    return unpack(cloud_of(decode(group, document, ("points", "observed")), labels))


def prepare(folder: Path, manifest: Mapping[str, Any], fields: Iterable[Field]) -> None:
    """Make a group, or open it to go on: only its number of episodes may have grown."""
    if (folder / "zarr.json").exists():
        old, episodes = Group(folder).manifest, manifest["episodes"]
        refuse_another(old, manifest, str(folder))
        if episodes < old["episodes"]:
            raise ValueError(f"{folder} has been given {old['episodes']} episodes; it cannot shrink to {episodes}")
    elif any(path.name != ".lock" for path in folder.iterdir()):
        raise ValueError(f"{folder} holds other files and is no dataset: name a new folder, or an empty one")
    for path, content in skeleton(fields, manifest).items():  # also to go on: it may have been killed here
        replace(folder / path, content)
    (folder / "records").mkdir(exist_ok=True)


def replace(path: Path, content: bytes) -> None:
    if not path.exists() or path.read_bytes() != content:
        with atomic_file(path) as handle:
            handle.write(content)


def refuse_another(old: Any, new: Any, where: str, name: str = "") -> None:
    """Raise ValueError when two manifests differ in anything but the number of episodes."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted({*old, *new} - ({"episodes"} if not name else set())):
            refuse_another(old.get(key), new.get(key), where, f"{name}.{key}" if name else key)
    elif old != new:
        cure = "bytes might differ: use the same versions" if name.startswith("versions") else "give the same"
        raise ValueError(f"{where} was begun with {name} = {old!r}, this is {name} = {new!r}; {cure}, or a new folder")


def compact(folder: Path) -> Group:
    """Bring the index up to the records that are there."""
    group = Group(folder)
    replace(folder / "index.json", index_bytes(group.records.values()))
    return group


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep a folder for one writing command at a time; the system lets it go when that ends, in whatever way."""
    import fcntl

    folder.mkdir(parents=True, exist_ok=True)
    with (folder / ".lock").open("w") as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise OSError(f"{folder}: another topokit command is writing there; wait for it, or stop it") from error
        _sweep(folder)
        yield
        _sweep(folder)


def _sweep(folder: Path) -> None:
    """Remove what processes that were killed had begun to write."""
    for path in (*folder.glob(".*.part"), *folder.glob("*/.*.part")):
        path.unlink(missing_ok=True)


def versions_of(*packages: str) -> dict[str, str]:
    """Return the versions on which bytes may depend."""
    return {
        "machine": platform.machine(),
        "topokit": __version__,
        **{package: version(package) for package in packages},
    }
