"""A group of a dataset, the episodes or a set of labels: opened from anywhere, made and grown on a local disk."""

from __future__ import annotations

import contextlib
import importlib.metadata
import json
import platform
import shutil
from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topokit._archive import FormatError, atomic_file

from ._layout import Field, skeleton
from ._records import Record, index_bytes, loose, parse, read_index, record_path

__all__ = ["Group", "compact", "locked", "prepare", "versions_of"]


class Group:
    """Records and arrays of a group, read only.

    Attributes
    ----------
    manifest : dict
        What the group is.
    records : dict of int to Record
    """

    def __init__(self, url: str | Path, prefix: str = "", *, index: bool = True, records: bool = True) -> None:
        import fsspec

        self.url, self.prefix = str(url), prefix
        self._fs, root = fsspec.core.url_to_fs(self.url)
        self._root = "/".join(part for part in (root.rstrip("/"), prefix.strip("/")) if part)
        self._arrays: dict[str, Any] = {}
        content = self.read("zarr.json")
        if content is None:
            raise FileNotFoundError(f"{self.where()}: there is no dataset (no zarr.json)")
        try:
            self.manifest: dict[str, Any] = json.loads(content)["attributes"]["topokit"]
        except (ValueError, KeyError, TypeError) as error:
            raise FormatError(f"{self.where('zarr.json')}: not the group of a topokit dataset ({error})") from error
        if self.manifest.get("version") != 1:
            raise FormatError(
                f"{self.where()}: of version {self.manifest.get('version')}; this topokit reads version 1"
            )
        self.records = self._read_records(index) if records else {}

    def where(self, path: str = "") -> str:
        """Return a path as messages name it."""
        return "/".join(part for part in (self.url.rstrip("/"), self.prefix, path) if part)

    @property
    def numbers(self) -> list[int]:
        """The episodes that it is to have."""
        return list(self.manifest.get("numbers") or range(self.manifest["episodes"]))

    @cached_property
    def whole(self) -> NDArray[np.int64]:
        """(n,) the episodes that are there, in order."""
        return np.array(sorted(i for i, r in self.records.items() if r.status == "ok"), dtype=np.int64)

    def read(self, path: str) -> bytes | None:
        """Return the content of a file, None when there is none."""
        try:
            content: bytes = self._fs.cat_file(f"{self._root}/{path}" if self._root else path)
        except (FileNotFoundError, KeyError):
            return None
        return content

    def names(self, folder: str) -> list[str]:
        """Return the names of the files in a folder; none when there is no such folder."""
        try:
            entries = self._fs.ls(
                f"{self._root}/{folder}".strip("/") if not self._root.startswith("/") else f"{self._root}/{folder}",
                detail=False,
            )
        except (FileNotFoundError, NotImplementedError):
            return []
        return sorted(name.rstrip("/").rpartition("/")[2] for name in entries)

    def document(self, index: int) -> dict[str, Any]:
        """Return the full record of an episode."""
        content = self.read(record_path(index))
        if content is None:
            raise KeyError(f"{self.where()} has no episode {index}")
        parse(content, record_path(index))
        document: dict[str, Any] = json.loads(content)
        return document

    def array(self, name: str) -> Any:
        """Return an array as Zarr gives it."""
        if name not in self._arrays:
            import zarr

            self._arrays[name] = zarr.open_array(self._store, path=name, mode="r")
        return self._arrays[name]

    @cached_property
    def _store(self) -> Any:
        from zarr.storage import FsspecStore, LocalStore

        if "file" in np.atleast_1d(self._fs.protocol):
            return LocalStore(self._root, read_only=True)
        if self._fs.async_impl:
            return FsspecStore(self._fs, path=self._root, read_only=True)
        from fsspec.implementations.asyn_wrapper import AsyncFileSystemWrapper

        return FsspecStore(AsyncFileSystemWrapper(self._fs, asynchronous=True), path=self._root, read_only=True)

    def _read_records(self, index: bool) -> dict[int, Record]:
        content = self.read("index.json") if index else None
        records = {} if content is None else read_index(content, self.where("index.json"))
        if len(records) < len(self.numbers):  # only then can there be records that the index does not know
            for number in loose(self.names("records"), records):
                found = self.read(record_path(number))
                if found is not None:
                    records[number] = parse(found, record_path(number))
        return records


def prepare(folder: Path, manifest: Mapping[str, Any], fields: Iterable[Field]) -> Group:
    """Make a group, or open it to go on: only its number of episodes may have grown.

    Raises
    ------
    ValueError
        When the folder holds something else, or what differs; the message names the field.
    """
    old: dict[str, Any] | None = None
    if (folder / "zarr.json").exists():
        old = Group(folder).manifest
        _same(old, manifest, str(folder))
        if manifest["episodes"] < old["episodes"]:
            raise ValueError(
                f"{folder} has been given {old['episodes']} episodes; it cannot shrink to {manifest['episodes']}"
            )
    elif folder.is_dir() and any(name.name not in _OURS for name in folder.iterdir()):
        raise ValueError(f"{folder} holds other files and is no dataset: name a new folder, or an empty one")
    elif folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder} is a file: name a folder")
    if old != manifest:
        fields = list(fields)
        for f in fields:
            (folder / f.name).mkdir(parents=True, exist_ok=True)
        (folder / "records").mkdir(exist_ok=True)
        for path, content in skeleton(fields, manifest["episodes"], {"topokit": dict(manifest)}).items():
            with atomic_file(folder / path) as handle:
                handle.write(content)
    return Group(folder)


_OURS = (".lock", ".part")


def _same(old: Any, new: Any, where: str, name: str = "") -> None:
    """Raise ValueError when two manifests differ in anything but the number of episodes."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted({*old, *new} - ({"episodes"} if not name else set())):
            _same(old.get(key), new.get(key), where, f"{name}.{key}" if name else key)
    elif old != new:
        because = (
            "the bytes might differ: use the same versions" if name.startswith("versions") else "give the same one"
        )
        raise ValueError(
            f"{where} was begun with {name} = {old!r}, this is {name} = {new!r}; {because}, or name a new folder"
        )


def compact(folder: Path) -> Group:
    """Bring the index up to the records that are there."""
    group = Group(folder)
    content = index_bytes(group.records.values())
    if group.read("index.json") != content:
        with atomic_file(folder / "index.json") as handle:
            handle.write(content)
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
        shutil.rmtree(folder / ".part", ignore_errors=True)  # of a command that was killed
        yield


def versions_of(*packages: str) -> dict[str, str]:
    """Return the versions on which bytes may depend."""
    return {"machine": platform.machine(), **{package: _version(package) for package in packages}}


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:  # run from a source tree that is not installed
        return "0+unknown"
