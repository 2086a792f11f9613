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
import platform
import zlib
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from topokit import __version__
from topokit._archive import FormatError, atomic_file


class NumberedFiles:
    """The files of a folder, one file an episode, as they are now, and the one `about` its settings."""

    def __init__(self, folder: str | Path, about: str) -> None:
        self.folder = Path(folder).expanduser()  #: folder of the files
        self._about = self.folder / about
        # An archive comes before the reason why there was none.
        found = [path for suffix in (".json", ".npz") for path in self.folder.glob(8 * "[0-9]" + suffix)]
        self._paths = {int(path.stem): path for path in found}
        whole = sorted(number for number, path in self._paths.items() if path.suffix == ".npz")
        self.episodes = np.array(whole, dtype=np.int64)  #: (n,) numbers of the whole episodes

    def path_of(self, episode: int) -> Path:
        """Return the file of an episode; raise KeyError when it was not tried."""
        if episode not in self._paths:
            raise KeyError(f"{self.folder} has no episode {episode}")
        return self._paths[episode]

    def missing(self, numbers: list[int]) -> list[int]:
        """Return those of some numbers that were not tried."""
        return [number for number in numbers if number not in self._paths]

    def checksum(self) -> str:
        """Return one SHA-256 of the settings and of all episodes; it does not depend on how the folder was made."""
        digest = hashlib.sha256(self._about.read_bytes())
        for _, path in sorted(self._paths.items()):
            digest.update(f"{path.name} {hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
        return digest.hexdigest()


def archive_path(folder: Path, number: int) -> Path:
    """Return the path of a whole episode."""
    return folder / f"{number:08d}.npz"


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Write a JSON document in one piece."""
    content = json.dumps(document, indent=1, sort_keys=True, ensure_ascii=False) + "\n"
    with atomic_file(path) as file:
        file.write(content.encode())


def begin(folder: Path, about: str, settings: Mapping[str, Any]) -> None:
    """Make a folder, or open one to go on; raise ValueError when it was begun with other settings."""
    path = folder / about
    if path.is_file():
        try:
            old = dict(json.loads(path.read_bytes()))
        except (TypeError, ValueError) as error:
            raise FormatError(f"{path}: damaged ({error}); copy it again, or name another folder") from error
        _refuse_other(old, dict(settings), str(folder))
        if settings.get("episodes", 0) < old.get("episodes", 0):
            raise ValueError(f"{folder} has {old['episodes']} episodes; it cannot shrink to {settings['episodes']}")
    write_json(path, settings)


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
