"""Check a dataset: every checksum, shape, unit and identity. Taught in chapter 8."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from topokit._archive import FormatError
from topokit.io import check_episode

from ._group import Group
from ._label import label_fields
from ._layout import Field, episode_fields, room, skeleton
from ._read import cloud_of, decode, to_episode
from ._records import STATUSES, parse, read_index, record_path
from .config import DatasetConfig, draw

__all__ = ["Problem", "check"]


@dataclass(frozen=True)
class Problem:
    """What is wrong, and where: a path in the dataset."""

    where: str
    what: str

    def __str__(self) -> str:
        return f"{self.where}: {self.what}"


def check(url: str | Path, *, progress: bool = False) -> list[Problem]:
    """Return all that is wrong with a dataset; nothing when it is whole.

    Compared are: every array's shape, type, unit and layout with what the configuration asks for; every record with its
    episode's number, task and seed; every object with its SHA-256 and its number; every episode's arrays with each other;
    the index with the records; labels with the episodes they are of. Episodes that are still to be made are named too.

    Raises
    ------
    FileNotFoundError, FormatError
        When there is no dataset there at all.
    """
    group = Group(url, records=False)
    manifest = group.manifest
    if manifest.get("format") != "topokit-dataset":
        raise FormatError(f"{url}: not a topokit dataset")
    config = DatasetConfig.from_json(manifest["config"])
    space, fields = manifest["room"], episode_fields(manifest["room"])
    problems: list[Problem] = []
    if space != room(config):
        problems.append(Problem("zarr.json", f"room {space} is not what the configuration needs, {room(config)}"))

    def episode(document: dict[str, Any]) -> str | None:
        drawn = draw(config, manifest["seed"], document["episode"])
        if (document["task"], document["seed"]) != (drawn.task, drawn.seed):
            return f"has task {document['task']} and seed {document['seed']}, must have {drawn.task} and {drawn.seed}"
        if document["status"] == "ok":
            found = to_episode(group, document)
            try:
                check_episode(found)
            except ValueError as error:
                return f"does not fit together: {error}"
            sizes = {"frames": len(found), "vertices": found.points.shape[1], "observed": found.observed.shape[1]}
            wrong = {name: document[name] for name, size in sizes.items() if document[name] != size}
            if wrong:
                return f"has by its record {wrong}, and by its arrays {sizes}"
        return None

    sums = _check_group(group, fields, group.numbers, episode, problems, progress)
    whole = {i for i, (status, _) in sums.items() if status == "ok"}
    for name in group.names("labels"):
        problems += _check_labels(url, name, group, whole, {i: sha for i, (_, sha) in sums.items()}, progress)
    return problems


def _check_labels(
    url: str | Path, name: str, group: Group, whole: set[int], sums: Mapping[int, str], progress: bool
) -> list[Problem]:
    problems: list[Problem] = []
    try:
        labels = Group(url, f"labels/{name}", records=False)
    except (FileNotFoundError, FormatError) as error:
        return [Problem(f"labels/{name}", str(error))]
    manifest = labels.manifest

    def one(document: dict[str, Any]) -> str | None:
        index = document["episode"]
        if document.get("of") != sums.get(index):
            return "is of another episode than the one that is there now: remove the record, and label again"
        if document["status"] != "ok":
            return None
        stored = decode(labels, document)
        cloud = cloud_of(group, group.document(index), manifest["observation"], manifest["n_points"])
        if len(stored["id"]) != len(cloud):
            return f"has {len(stored['id'])} frames, its episode {len(cloud)}"
        there = stored["id"] >= 0
        used = stored["simplices"][there]
        if (used[:, :10] >= cloud.shape[1]).any():
            return f"names point {int(used[:, :10].max())} of a cloud of {cloud.shape[1]}"
        birth, death = stored["values"][there][:, 0], stored["values"][there][:, 1]
        return None if (np.isfinite(birth) & (birth < death)).all() else "has a loop that dies before it is born"

    fields = label_fields(group.manifest["room"]["frames"], manifest["slots"])
    _check_group(labels, fields, sorted(whole & set(labels.numbers)), one, problems, progress)
    return [Problem(f"labels/{name}/{problem.where}", problem.what) for problem in problems]


def _check_group(
    group: Group,
    fields: Iterable[Field],
    numbers: Iterable[int],
    one: Callable[[dict[str, Any]], str | None],
    problems: list[Problem],
    progress: bool,
) -> dict[int, tuple[str, str]]:
    """Add what is wrong with a group to `problems`; return status and checksum of every record."""
    from tqdm import tqdm

    fields, wanted = tuple(fields), set(numbers)
    problems += _check_skeleton(group, fields)
    names = group.names("records")
    sums: dict[int, tuple[str, str]] = {}
    seen: set[str] = set()
    for name in tqdm(names, unit="record", disable=not progress, file=sys.stderr):
        content = group.read(f"records/{name}") or b""
        where = f"records/{name}"
        try:
            record = parse(content, where)
            document = json.loads(content)
            paths = list(document["objects"])
        except (ValueError, KeyError, TypeError) as error:
            problems.append(Problem(where, str(error).removeprefix(f"{where}: ")))
            continue
        if where != record_path(record.episode) or record.episode not in wanted:
            problems.append(Problem(where, f"episode {record.episode} does not belong here"))
        sums[record.episode] = record.status, record.sha256
        seen.update(paths)
        bad = list(_check_objects(group, fields, document))
        if not bad:
            try:
                said = one(document)
            except Exception as error:  # damage shows in a dozen ways
                said = f"cannot be read: {type(error).__name__}: {error}"
            bad = [Problem(where, f"episode {record.episode} {said}")] if said else []
        problems += bad
    for f in fields:
        for name in group.names(f.name):
            path = f"{f.name}/{name}"
            if name != "zarr.json" and path not in seen:
                problems.append(
                    Problem(path, "belongs to no record: left by a command that was stopped; the same command goes on")
                )
    missing = sorted(wanted - set(sums))
    if missing:
        problems.append(Problem("records", f"{len(missing)} episodes are not there yet, the first is {missing[0]}"))
    problems += _check_index(group, {i: sha for i, (_, sha) in sums.items()})
    return sums


def _check_skeleton(group: Group, fields: tuple[Field, ...]) -> Iterator[Problem]:
    """Yield arrays whose description is not what it must be."""
    for path, content in skeleton(fields, group.manifest["episodes"], {"topokit": group.manifest}).items():
        found = group.read(path)
        if found is None:
            yield Problem(path, "is missing")
            continue
        try:
            old, new = json.loads(found), json.loads(content)
        except ValueError as error:
            yield Problem(path, f"is damaged: {error}")
            continue
        if old != new:
            keys = sorted(key for key in {*old, *new} if old.get(key) != new.get(key))
            yield Problem(path, "; ".join(f"{key} is {old.get(key)!r}, must be {new.get(key)!r}" for key in keys))


def _check_objects(group: Group, fields: tuple[Field, ...], document: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield what is wrong with the objects that a record names."""
    index, objects = document["episode"], document["objects"]
    expected = {f"{f.name}/c.{index}" + ".0" * len(f.shape) for f in fields} if document["status"] == "ok" else set()
    for path in sorted(set(objects) - expected):
        yield Problem(path, f"is named by the record of episode {index} and is not its own")
    for path in sorted(set(objects) & expected):
        content = group.read(path)
        if content is None:
            yield Problem(path, f"is missing, of episode {index}")
        elif hashlib.sha256(content).hexdigest() != objects[path]:
            yield Problem(path, f"is damaged: its checksum is not that in the record of episode {index}")


def _check_index(group: Group, sums: Mapping[int, str]) -> Iterator[Problem]:
    content = group.read("index.json")
    if content is None:
        return
    try:
        known = read_index(content, "index.json")
    except FormatError as error:
        yield Problem("index.json", str(error))
        return
    for index, record in known.items():
        if record.status not in STATUSES or sums.get(index) != record.sha256:
            yield Problem(
                "index.json", f"episode {index} is not what its record says: remove the index, it is made again"
            )
