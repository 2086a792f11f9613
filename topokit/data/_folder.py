"""A folder of numbered files, one an episode: a dataset, and beside its episodes a set of labels.

    dataset.json         settings of the dataset: configuration, seed, number of episodes, versions
    00000007.npz         episode 7
    00000008.json        the reason why there is no episode 8
    labels/NAME/         a folder of labels.json and of files of the same numbers

Every file is written aside and moved into place. So a file that is there is whole, and a command that was stopped goes on by
making what is not there yet.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
import zlib
from collections.abc import Mapping
from dataclasses import field, fields
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from topokit import __version__
from topokit._archive import FormatError, atomic_file, existing, load_header
from topokit._config import checked, from_mapping
from topokit._validate import whole

NotNegative = Annotated[int, Field(ge=0)]


@checked
class Record:
    """A summary of an episode."""

    episode: NotNegative
    #: result: ok (there is a file), rejected (it was not physical) or failed (it could not be made)
    status: Literal["ok", "rejected", "failed"]
    reason: str = ""  #: reason of a status other than ok
    task: str = ""
    garment: str = ""
    target: str = ""
    seed: NotNegative = 0  #: seed of the episode
    success: bool = False
    frames: NotNegative = 0
    physics: Mapping[str, Any] = field(default_factory=dict)


class NumberedFiles:
    """The files of a folder, one file an episode.

    Parameters
    ----------
    folder : path
    kind : str
        Kind of its archives.
    about : str
        Name of the file with the settings of the folder.
    """

    def __init__(self, folder: str | Path, kind: str, about: str) -> None:
        self.folder = Path(folder)  #: folder of the files
        self._kind = kind
        self._about = about
        self._known: dict[int, Record] = {}
        # Names are listed now; a header is read on first use of its record.
        matches = [re.fullmatch(r"(\d{8})\.(npz|json)", name) for name in os.listdir(self.folder)]
        numbers = {kind: {int(match[1]) for match in matches if match and match[2] == kind} for kind in ("npz", "json")}
        self.episodes = np.array(sorted(numbers["npz"]), dtype=np.int64)  #: (n,) numbers of the whole episodes
        self.refused = sorted(numbers["json"] - numbers["npz"])  #: numbers of the rejected and failed episodes

    @cached_property
    def records(self) -> tuple[Record, ...]:
        """Return a record for every episode that was tried, in order."""
        return tuple(self.record(number) for number in sorted([*self.episodes.tolist(), *self.refused]))

    @property
    def failures(self) -> tuple[Record, ...]:
        """Return the records of rejected and failed episodes, each with its `reason`."""
        return tuple(self.record(number) for number in self.refused)

    @property
    def counts(self) -> dict[str, int]:
        """Return the numbers of "ok", "rejected" and "failed" episodes, each only when there are any."""
        statuses = ["ok"] * len(self.episodes) + [record.status for record in self.failures]
        return {status: statuses.count(status) for status in sorted(set(statuses))}

    def record(self, episode: int) -> Record:
        """Return the summary of an episode, read from the header of its file.

        Raises
        ------
        KeyError
            When the episode was not tried.
        FormatError
            When its file is damaged.
        """
        number = whole(episode, "an episode")
        if number not in self._known:
            self._known[number] = self._read_record(number)
        return self._known[number]

    def _read_record(self, number: int) -> Record:
        path = archive_path(self.folder, number)
        if path.is_file():
            document = {**load_header(path, self._kind), "status": "ok"}
        else:
            path = failure_path(self.folder, number)
            if not path.is_file():
                raise KeyError(f"{self.folder} has no episode {number}")
            try:
                document = dict(json.loads(existing(path).read_bytes()))
            except (ValueError, TypeError) as error:
                raise FormatError(f"{path}: damaged ({error}); remove it, and the same command goes on") from error
        known = {f.name: document[f.name] for f in fields(Record) if f.name in document}
        try:
            return Record(**{**known, "episode": number})
        except ValueError as error:
            raise FormatError(f"{path}: {error}") from error

    def is_done(self, episode: int) -> bool:
        """Return True if an episode was tried and the header of its file is sound."""
        try:
            self.record(episode)
        except (KeyError, FormatError):
            return False
        return True

    def path_of(self, episode: int) -> Path:
        """Return the file of a whole episode; raise KeyError with the reason when there is none."""
        path = archive_path(self.folder, whole(episode, "an episode"))
        if not path.is_file():
            record = self.record(episode)
            raise KeyError(f"episode {episode} was {record.status}: {record.reason}")
        return path

    def checksum(self) -> str:
        """Return one SHA-256 of the settings and of all episodes; it does not depend on how the folder was made."""
        digest = hashlib.sha256(existing(self.folder / self._about).read_bytes())
        paths = [archive_path(self.folder, number) for number in self.episodes.tolist()]
        paths += [failure_path(self.folder, number) for number in self.refused]
        for path in sorted(paths):
            digest.update(f"{path.name} {hashlib.sha256(existing(path).read_bytes()).hexdigest()}\n".encode())
        return digest.hexdigest()


def archive_path(folder: Path, number: int) -> Path:
    """Return the path of a whole episode."""
    return folder / f"{number:08d}.npz"


def failure_path(folder: Path, number: int) -> Path:
    """Return the path of the file with the reason why an episode is missing."""
    return folder / f"{number:08d}.json"


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Write a JSON document in one piece; an existing file is left alone."""
    content = (json.dumps(document, indent=1, sort_keys=True, ensure_ascii=False) + "\n").encode()
    if not path.is_file() or path.read_bytes() != content:
        with atomic_file(path) as handle:
            handle.write(content)


def read_settings(kind: type[Any], path: Path) -> Any:
    """Return the settings of a folder, a checked dataclass, from its JSON file."""
    try:
        return from_mapping(kind, json.loads(existing(path).read_bytes()), "it")
    except ValueError as error:
        raise FormatError(f"{path}: not what topokit writes there: {error}") from error


def begin(folder: Path, about: str, settings: Mapping[str, Any]) -> None:
    """Make a folder, or open one to go on; nothing is written unless all is well.

    Raises
    ------
    ValueError
        When the folder was begun with other settings, or holds other files.
    """
    path = folder / about
    # A folder that was begun goes on with the same settings only; any other must be empty.
    if path.is_file():
        old = json.loads(path.read_bytes())
        _refuse_other(old, dict(settings), str(folder))
        if settings.get("episodes", 0) < old.get("episodes", 0):
            raise ValueError(f"{folder} has {old['episodes']} episodes; it cannot shrink to {settings['episodes']}")
    elif folder.exists() and any(not name.endswith(".part") for name in os.listdir(folder)):
        raise ValueError(f"{folder} holds other files and no {about}: name a new folder, or an empty one")
    write_json(path, settings)
    remove_parts(folder)


def remove_parts(folder: Path) -> None:
    """Remove the files that killed processes left half written."""
    for left in folder.glob(".*.part"):
        left.unlink(missing_ok=True)


def _refuse_other(old: Any, new: Any, folder: str, name: str = "") -> None:
    """Raise ValueError when two settings differ in anything but the number of episodes; name the first difference."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted({*old, *new} - {"episodes"}):
            _refuse_other(old.get(key), new.get(key), folder, f"{name}.{key}".strip("."))
    elif old != new:
        cure = "give the same, or a new folder"
        raise ValueError(f"{folder} was begun with {name} = {old!r}, this is {name} = {new!r}: {cure}")


def versions_of(*packages: str) -> dict[str, str]:
    """Return the versions on which bytes may depend."""
    ours = {"machine": platform.machine(), "topokit": __version__, "zlib": zlib.ZLIB_RUNTIME_VERSION}
    return ours | {package: version(package) for package in packages}
