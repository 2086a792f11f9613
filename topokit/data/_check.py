"""Check a dataset: every checksum, shape, unit and identity. Taught in chapter 9."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from topokit._archive import FormatError, read_json
from topokit.io import check_episode

from ._group import Group, decode, open_episodes, tracked_cloud
from ._layout import Field, episode_of, skeleton, states_of
from ._recipe import DatasetConfig, room
from ._records import Record, parse, read_index, record_path

Records = dict[int, Record]
Content = Callable[[dict[str, Any]], str | None]  # what is wrong with an episode whose objects are whole


@dataclass(frozen=True)
class Problem:
    """What is wrong with a dataset."""

    where: str  #: a path in the dataset
    what: str  #: what is wrong there

    def __str__(self) -> str:
        return f"{self.where}: {self.what}"


def check_dataset(url: str | Path, *, progress: bool = False) -> list[Problem]:
    """Return all that is wrong with a dataset; nothing when it is whole. Episodes that are still to be made are named too.

    Arrays are compared with the configuration and with each other, records with what was drawn, objects with their SHA-256,
    the index with the records, and labels with the episodes they are of.

    Parameters
    ----------
    url : str or path
    progress : bool
        Show a bar on stderr.
    """
    group, records = open_episodes(url), Records()
    problems = [*_episode_problems(group, records, progress)]
    for name in group.names("labels"):
        problems += _label_problems(group, f"labels/{name}", records, progress)
    return problems


def _episode_problems(group: Group, records: Records, progress: bool) -> Iterator[Problem]:
    manifest = group.manifest
    config = DatasetConfig.from_json(manifest["config"])
    needed = room(config)
    if manifest["room"] != needed:
        yield Problem("zarr.json", f"room {manifest['room']} is not what the configuration needs, {needed}")

    def content(document: dict[str, Any]) -> str | None:
        drawn = config.draw(manifest["seed"], document["episode"])
        if (document["task"], document["seed"]) != drawn:
            return f"has task {document['task']} and seed {document['seed']}, must have {drawn.task} and {drawn.seed}"
        if document["status"] != "ok":
            return None
        episode = episode_of(decode(group, document), document, manifest)
        check_episode(episode)
        sizes = {"frames": len(episode), "vertices": episode.points.shape[1], "observed": episode.observed.shape[1]}
        wrong = {name: document[name] for name, size in sizes.items() if document[name] != size}
        return f"has by its record {wrong}, and by its arrays {sizes}" if wrong else None

    yield from _group_problems(group, group.numbers, content, records, progress)


def _label_problems(group: Group, prefix: str, episodes: Records, progress: bool) -> Iterator[Problem]:
    try:
        labels = Group(group.url, prefix, group)
    except (FileNotFoundError, FormatError) as error:
        yield Problem(prefix, str(error))
        return
    manifest = labels.manifest

    def content(document: dict[str, Any]) -> str | None:
        index = document["episode"]
        if index not in episodes or document.get("of") != episodes[index].sha256:
            return "is of another episode than the one that is there now: remove the record, and label again"
        if document["status"] != "ok":
            return None
        cloud = tracked_cloud(group, group.now(index)[1], manifest)
        states = states_of(decode(labels, document), cloud, 1.0)  # an error when a frame or a point is not there
        fine = all(-np.inf < loop.birth < loop.death for state in states for loop in state.loops)
        return None if fine else "has a loop that dies before it is born"

    wanted = sorted(i for i, record in episodes.items() if record.status == "ok" and i in labels.numbers)
    for problem in _group_problems(labels, wanted, content, {}, progress):
        yield Problem(f"{prefix}/{problem.where}", problem.what)


def _group_problems(
    group: Group, wanted: Sequence[int], content: Content, records: Records, show: bool
) -> Iterator[Problem]:
    """What is wrong with a group; its records go into `records`."""
    from tqdm import tqdm

    fields = group.fields
    yield from _skeleton_problems(group, fields)
    owned: set[str] = set()
    for name in tqdm(group.names("records"), unit="record", disable=not show, file=sys.stderr):
        path = f"records/{name}"
        try:
            record, document = parse(group.read(path) or b"", path)
        except FormatError as error:
            yield Problem(path, str(error).removeprefix(f"{path}: "))
            continue
        if path != record_path(record.episode) or record.episode not in wanted:
            yield Problem(path, f"episode {record.episode} does not belong here")
        records[record.episode] = record
        owned.update(document["objects"])
        if damage := [*_object_problems(group, fields, document)]:
            yield from damage
        elif wrong := _wrong_content(content, document):
            yield Problem(path, f"episode {record.episode} {wrong}")
    paths = {f"{f.name}/{name}" for f in fields for name in group.names(f.name) if name != "zarr.json"}
    for path in sorted(paths - owned):
        yield Problem(path, "belongs to no record: left by a command that was stopped, and the same command goes on")
    first = next((i for i in wanted if i not in records), None)
    if first is not None:
        missing = len(wanted) - sum(i in wanted for i in records)
        yield Problem("records", f"{missing} episodes are not there yet, the first is {first}")
    yield from _index_problems(group, records)


def _skeleton_problems(group: Group, fields: tuple[Field, ...]) -> Iterator[Problem]:
    for path, content in skeleton(fields, group.manifest).items():
        found = group.read(path)
        if found is None:
            yield Problem(path, "is missing")
        elif wrong := _difference(found, json.loads(content)):
            yield Problem(path, wrong)


def _difference(found: bytes, wanted: dict[str, Any]) -> str:
    """How a file differs from what is wanted."""
    try:
        there = dict(read_json(found))
    except (ValueError, TypeError) as error:
        return f"is damaged: {error}"
    keys = sorted(key for key in {*there, *wanted} if there.get(key) != wanted.get(key))
    return "; ".join(f"{key} is {there.get(key)!r:.200}, must be {wanted.get(key)!r}" for key in keys)


def _object_problems(group: Group, fields: tuple[Field, ...], document: Mapping[str, Any]) -> Iterator[Problem]:
    index, expected = document["episode"], set()
    if document["status"] == "ok":
        expected = {f.path(index) for f in fields}
    for path, checksum in sorted(document["objects"].items()):
        content = group.read(path) if path in expected else b""
        if path not in expected:
            yield Problem(path, f"is named by the record of episode {index} and is not its own")
        elif content is None:
            yield Problem(path, f"is missing, of episode {index}")
        elif hashlib.sha256(content).hexdigest() != checksum:
            yield Problem(path, f"is damaged: its checksum is not that in the record of episode {index}")


def _wrong_content(content: Content, document: dict[str, Any]) -> str | None:
    try:
        return content(document)
    except Exception as error:  # damage shows in a dozen ways
        return f"cannot be read: {type(error).__name__}: {error}"


def _index_problems(group: Group, records: Records) -> Iterator[Problem]:
    content = group.read("index.json")
    try:
        known = {} if content is None else read_index(content, "index.json")
    except FormatError as error:
        yield Problem("index.json", str(error))
        return
    for index in sorted(index for index, record in known.items() if records.get(index) != record):
        yield Problem("index.json", f"episode {index} is not what its record says: remove the index, it is made again")
