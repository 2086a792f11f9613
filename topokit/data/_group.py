"""A group of a dataset, the episodes or a set of labels: opened from anywhere, made and grown on a local disk.

An episode counts once its record is in place: a small JSON file that names the objects of its episode with their SHA-256 and
is renamed into place after they are. Nothing in it depends on when, where or in which order it was made.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import re
import stat
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pydantic
from numpy.typing import NDArray

from topokit import __version__
from topokit._archive import FormatError, atomic_file, read_json
from topokit._config import checked, from_mapping

from ._layout import Field, canonical, cloud_of, decoded, episode_fields, label_fields, needed, skeleton, unpack
from ._recipe import DatasetConfig
from ._records import MOST_EPISODES, Number, Record, index_bytes, parse, read_index, record_path

_MOST_BYTES = 2**30  # of a file


@checked
class _Manifest:
    """What a group says it is."""

    version: Literal[1]
    episodes: Annotated[int, pydantic.Field(ge=1, le=MOST_EPISODES)]
    versions: Mapping[str, str]
    numbers: Annotated[list[int], pydantic.Field(min_length=1)] | None


@checked
class _OfEpisodes(_Manifest):
    format: Literal["topokit-dataset"]
    config: DatasetConfig
    seed: Number
    room: Mapping[str, int]


@checked
class _OfLabels(_Manifest):
    format: Literal["topokit-labels"]
    observation: Literal["full", "observed", "camera"]
    n_points: int | None
    slots: Annotated[int, pydantic.Field(ge=1, le=256)]
    options: Mapping[str, Any]


def commit(folder: Path, document: Mapping[str, Any], objects: Iterable[tuple[str, bytes]] = ()) -> None:
    """Put the objects of an episode in place, each whole, and then its record: what has none is made again."""
    sums = {}
    with contextlib.ExitStack() as stack:  # none is there before all are written: a full disk leaves nothing
        for path, content in objects:
            stack.enter_context(atomic_file(folder / path)).write(content)
            sums[path] = hashlib.sha256(content).hexdigest()
    replace(folder / record_path(document["episode"]), canonical({**document, "objects": sums}))


class Group:
    """Records and arrays of a group, read only; labels are `of` a group of episodes."""

    def __init__(self, url: str | Path, prefix: str = "", of: Group | None = None) -> None:
        self.url, self.prefix, self.of = str(url), prefix, of
        try:
            self._fs, self._root = needed("fsspec").core.url_to_fs(self.url)
        except zipfile.BadZipFile as error:
            raise FormatError(f"{self.url}: a damaged zip file ({error}); copy it again") from error
        self._local = "file" in np.atleast_1d(self._fs.protocol)
        content = self.read("zarr.json")
        if content is None:
            raise FileNotFoundError(f"{self.where()}: there is no dataset (no zarr.json)")
        try:
            attributes = read_json(content)["attributes"]
            self.manifest: dict[str, Any] = attributes["topokit"]  #: what the group is
            self._check_manifest(attributes["sha256"])
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise FormatError(f"{self.where('zarr.json')}: not the group of a topokit dataset ({error})") from error

    def _check_manifest(self, checksum: str) -> None:
        """Raise ValueError when what the group says it is cannot be; its fields are made."""
        if checksum != hashlib.sha256(canonical(self.manifest)).hexdigest():
            raise ValueError("its checksum is another: it is damaged, copy it again")
        if self.manifest["version"] != 1:
            raise ValueError(f"of version {self.manifest['version']!r:.50}; this topokit reads version 1")
        labels = self.manifest.get("format") == "topokit-labels"
        from_mapping(_OfLabels if labels else _OfEpisodes, {"numbers": None, **self.manifest}, "what it says")
        numbers, episodes = self.manifest.get("numbers"), self.manifest["episodes"]
        if numbers and not all(a < b for a, b in zip([-1, *numbers], [*numbers, episodes], strict=True)):
            raise ValueError(f"numbers must be some of its {episodes} episodes, in order")
        if not labels:
            self.fields = episode_fields(self.manifest["room"])
        elif self.of is not None:
            self.fields = label_fields(self.of.manifest["room"]["frames"], self.manifest["slots"])

    def where(self, path: str = "") -> str:
        return _join(self.url, self.prefix, path)

    @property
    def numbers(self) -> Sequence[int]:
        """The episodes that it is to have."""
        return self.manifest.get("numbers") or range(self.manifest["episodes"])

    @cached_property
    def records(self) -> dict[int, Record]:
        """Of the episodes that were tried, in short."""
        content = self.read("index.json")
        records = {} if content is None else read_index(content, self.where("index.json"))
        if len(records) < len(self.numbers):  # only then can there be records that the index does not know
            numbers = {int(name[:8]) for name in self.names("records") if re.fullmatch(r"[0-9]{8}\.json", name)}
            for number in sorted(numbers - records.keys()):
                if (content := self.read(record_path(number))) is not None:  # it may just have gone, to be made again
                    records[number], _ = parse(content, self.where(record_path(number)))
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
        whole = _join(self._root, self.prefix, path)
        try:
            found = os.stat(whole) if self._local else None  # a pipe never ends
            if found and (not stat.S_ISREG(found.st_mode) or found.st_size > _MOST_BYTES):
                raise OSError(f"{self.where(path)}: no regular file of at most {_MOST_BYTES} bytes")
            return bytes(self._fs.cat_file(whole))
        except (FileNotFoundError, NotADirectoryError, KeyError):
            return None
        except (zipfile.BadZipFile, zlib.error, EOFError) as error:
            raise FormatError(f"{self.where(path)}: damaged in its zip file ({error}); copy it again") from error

    def verified(self, path: str, checksum: str, index: int) -> bytes:
        """Return the content of a file of an episode, which has that checksum."""
        content = self.read(path)
        if content is None or hashlib.sha256(content).hexdigest() != checksum:
            state = "missing" if content is None else "damaged"
            cure = "copy it again, or remove the record, and the same command makes it again"
            raise FormatError(f"{self.where(path)}: is {state}, of episode {index}; {cure}")
        return content

    def linked(self, path: str) -> bool:
        """Whether a file is a link, or is reached through one."""
        whole = Path(_join(self._root, self.prefix, path))
        return self._local and any(p.is_symlink() for p in (whole, *whole.parents) if Path(self._root) in p.parents)

    def names(self, folder: str) -> list[str]:
        """Return the names of the files in place in a folder; none when there is no such folder."""
        try:
            entries = self._fs.ls(_join(self._root, self.prefix, folder), detail=False)
        except (FileNotFoundError, NotADirectoryError, NotImplementedError):
            return []
        found = (name.rstrip("/").rpartition("/")[2] for name in entries)
        return sorted(name for name in found if not name.startswith("."))

    def now(self, index: int) -> tuple[Record, dict[str, Any]]:
        """Return both forms of the record of an episode that is there now, whatever the index knows."""
        return parse(self.read(record_path(index)) or b"", self.where(record_path(index)))

    def document(self, index: int) -> dict[str, Any]:
        """Return the full record of an episode: the one that the index knows and, of labels, of the episode that is there."""
        if index not in self.records:
            raise KeyError(f"{self.where()} has no episode {index}")
        where = self.where(record_path(index))
        record, document = parse(self.verified(record_path(index), self.records[index].sha256, index), where)
        if record != self.records[index]:
            raise FormatError(f"{where}: the index says other things of it; remove index.json, it is made again")
        if self.of is not None and document.get("of") != self.of.records[index].sha256:
            raise FormatError(f"{where}: is of another episode than the one that is there now; remove it, label again")
        return document


def _join(*parts: str) -> str:
    return "/".join(part.rstrip("/") for part in parts if part)


def open_episodes(url: str | Path) -> Group:
    group = Group(url)
    if group.manifest["format"] != "topokit-dataset":
        raise FormatError(f"{url}: labels, not the dataset that they are of; open the folder that holds `labels`")
    return group


def label_name(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", name):
        raise ValueError(f"name {name!r} of labels: letters, digits, dots, hyphens and underscores only")
    return name


def decode(group: Group, document: Mapping[str, Any], names: tuple[str, ...] = ()) -> dict[str, NDArray[Any]]:
    """Return the arrays of an episode, verified, each in its own extent; all of them when none is named."""
    index, arrays = document["episode"], {}
    for f in (f for f in group.fields if f.name in names or not names):
        with damage_in(group, index, f"{f.name}: "):
            checksum = document["objects"].get(f.path(index))
            content = None if checksum is None else group.verified(f.path(index), checksum, index)
            arrays[f.name] = decoded(f, content, document["shapes"][f.name])
            if f.axes[0] == "frame" and len(arrays[f.name]) != document["frames"]:
                raise ValueError(f"{len(arrays[f.name])} frames, and it says {document['frames']}")
    return arrays


@contextlib.contextmanager
def damage_in(group: Group, index: int, part: str = "") -> Iterator[None]:
    """Turn what a wrong record brings about into an error that names it."""
    try:
        yield
    except FormatError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, OverflowError, RuntimeError) as error:
        raise FormatError(f"{group.where(record_path(index))}: does not fit what is there: {part}{error}") from error


def tracked_cloud(group: Group, document: Mapping[str, Any], labels: Mapping[str, Any]) -> NDArray[np.float32]:
    """(T, n, 3) the cloud of an episode that labels of that manifest are of, in metres."""
    return unpack(cloud_of(decode(group, document, ("points", "observed")), labels))


def local_folder(url: str | Path) -> Path:
    if "://" in str(url):
        raise ValueError(f"{url} is not a folder; datasets are made in one, and `Dataset.cut` writes them elsewhere")
    return Path(url)


@contextlib.contextmanager
def writing(folder: Path, manifest: Mapping[str, Any], fields: Sequence[Field], *above: Path) -> Iterator[None]:
    """Make a group in a folder, or open it to go on, for one command at a time; all is checked before anything is written.

    Only its number of episodes may have grown; nothing in it, and nothing `above` it, may be a link.
    """
    import fcntl

    store = skeleton(fields, manifest)
    _refuse(folder, manifest, above)
    folder.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(folder / ".lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
    with os.fdopen(descriptor, "w") as handle:
        try:  # the system lets it go when this process ends, in whatever way
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise OSError(f"{folder}: another topokit command is writing there; wait for it, or stop it") from error
        _refuse(folder, manifest, above)
        _sweep(folder)
        for path, content in store.items():  # also to go on: it may have been killed here
            replace(folder / path, content)
        (folder / "records").mkdir(exist_ok=True)
        there = {path.name for path in (folder / "records").iterdir()}
        if (folder / "index.json").exists() and not {f"{i:08d}.json" for i in Group(folder).records} <= there:
            (folder / "index.json").unlink()  # it knows a record that was removed: that episode is made again
        yield
        _sweep(folder)


def _refuse(folder: Path, manifest: Mapping[str, Any], above: Iterable[Path]) -> None:
    """Raise unless a folder is not there yet, is empty, or holds what `writing` may go on with."""
    for path in (*above, *(folder.iterdir() if folder.exists() else ())):
        if path.is_symlink() or path.is_fifo() or (path.name == ".lock" and not path.is_file()):
            raise OSError(f"{path}: is a link, or no regular file, and topokit would write there; remove it")
    if (folder / "zarr.json").exists():
        old, episodes = Group(folder).manifest, manifest["episodes"]
        refuse_another(old, manifest, str(folder))
        if episodes < old["episodes"]:
            raise ValueError(f"{folder} has been given {old['episodes']} episodes; it cannot shrink to {episodes}")
    elif folder.exists() and any(not re.fullmatch(r"\.lock|\.zarr\.json\..*", path.name) for path in folder.iterdir()):
        raise ValueError(f"{folder} holds other files and is no dataset: name a new folder, or an empty one")


def replace(path: Path, content: bytes) -> None:
    if not path.is_file() or path.read_bytes() != content:
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


def _sweep(folder: Path) -> None:
    """Remove what processes that were killed had begun to write."""
    for path in (*folder.glob(".*.part"), *folder.glob("*/.*.part")):
        path.unlink(missing_ok=True)


def versions_of(*packages: str) -> dict[str, str]:
    """Return the versions on which bytes may depend."""
    ours = {"machine": platform.machine(), "topokit": __version__}
    return ours | {package: version(package) for package in packages}
