"""Check a dataset: every file, its shapes, its numbers and its identities. Taught in chapter 11."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from topokit._archive import FormatError

from ._dataset import ABOUT, Dataset
from ._folder import NumberedFiles, archive_path, failure_path, number_of
from ._labels import ABOUT as ABOUT_LABELS
from ._labels import Labels


@dataclass(frozen=True)
class Problem:
    """A problem of a dataset."""

    where: str  #: a path in the dataset
    what: str  #: description of the problem

    def __str__(self) -> str:
        return f"{self.where}: {self.what}"


def check_dataset(folder: str | Path, *, progress: bool = False) -> list[Problem]:
    """Return all problems of a dataset; none when it is whole. Missing episodes are problems too.

    Every file is read whole and compared with the CRC-32 of each part. Episodes are compared with their draws, and labels
    with their episodes.

    Parameters
    ----------
    folder : path
    progress : bool
        Show a bar on stderr.

    Raises
    ------
    FileNotFoundError
        When there is no such dataset.
    """
    dataset = Dataset(folder)
    problems = [*_strangers(dataset, {ABOUT, "labels"}, dataset.wanted, "")]
    problems += _missing(dataset, dataset.wanted, "")
    problems += _episode_problems(dataset, progress)
    for name in dataset.label_names:
        problems += _label_problems(dataset, name, progress)
    return problems


def _members(numbers: Sequence[int]) -> range | set[int]:
    """Return numbers in a form that is quick to look in; a range stays one, for it may be of a hundred million."""
    return numbers if isinstance(numbers, range) else set(numbers)


def _strangers(files: NumberedFiles, known: set[str], wanted: Sequence[int], prefix: str) -> Iterator[Problem]:
    """Yield the files that do not belong to a folder."""
    members = _members(wanted)
    for name in sorted(set(os.listdir(files.folder)) - known):
        number = number_of(name)
        if number is not None and number in members:
            continue
        what = "does not belong here"
        if name.endswith(".part"):
            what = "left by a command that was stopped; the same command removes it and goes on"
        yield Problem(prefix + name, what)


def _missing(files: NumberedFiles, wanted: Sequence[int], prefix: str) -> Iterator[Problem]:
    """Yield one problem that counts the missing episodes."""
    tried = {*files.episodes.tolist(), *files.refused}
    members = _members(wanted)
    missing = len(members) - sum(number in members for number in tried)
    if missing:
        first = next(number for number in wanted if number not in tried)
        yield Problem(f"{prefix}{first:08d}.npz", f"not there yet, the first of {missing}; the same command goes on")


def _episode_problems(dataset: Dataset, progress: bool) -> Iterator[Problem]:
    for number in _with_bar(sorted([*dataset.episodes.tolist(), *dataset.refused]), progress):
        whole = archive_path(dataset.folder, number)
        path = whole if whole.is_file() else failure_path(dataset.folder, number)
        try:
            record = dataset.record(number)
            if record.status == "ok":
                dataset[number]
        except FormatError as error:
            yield Problem(path.name, str(error).removeprefix(f"{path}: "))
            continue
        drawn = dataset.config.draw(dataset.seed, number)
        if (record.task, record.seed) != drawn:
            found = f"task {record.task} and seed {record.seed}"
            yield Problem(path.name, f"has {found}, must have {drawn.task} and {drawn.seed}")


def _label_problems(dataset: Dataset, name: str, progress: bool) -> Iterator[Problem]:
    prefix = f"labels/{name}/"
    try:
        labels = dataset.labels(name)
    except FormatError as error:
        yield Problem(prefix + ABOUT_LABELS, str(error))
        return
    yield from _strangers(labels, {ABOUT_LABELS}, dataset.wanted, prefix)
    yield from _missing(labels, dataset.episodes.tolist(), prefix)
    for number in _with_bar(np.intersect1d(dataset.episodes, labels.episodes).tolist(), progress):
        path = archive_path(labels.folder, number)
        try:
            if wrong := _wrong_labels(dataset, labels, number):
                yield Problem(prefix + path.name, wrong)
        except FormatError as error:
            if str(error).startswith(str(path)):  # else it is a problem of the episode, which is in the list already
                yield Problem(prefix + path.name, str(error).removeprefix(f"{path}: "))


def _wrong_labels(dataset: Dataset, labels: Labels, number: int) -> str | None:
    """Return the problems of the labels of an episode whose own file is sound."""
    of, labelled = dataset.record(number), labels.record(number)
    if (labelled.task, labelled.seed) != (of.task, of.seed):
        return f"labels of another episode, {labelled.task} of seed {labelled.seed}; remove the file, and label again"
    arrays = labels.arrays(number)
    labels.check_fit(number, arrays, *labels.cloud(dataset[number]).shape[:2])
    births, deaths = np.moveaxis(arrays["values"][arrays["id"] >= 0][:, :2], 1, 0)
    if not (births < deaths).all():
        return "has a loop that dies before it is born"
    return None


def _with_bar(numbers: Sequence[int], progress: bool) -> Iterable[int]:
    from tqdm import tqdm

    bar: Iterable[int] = tqdm(numbers, unit="episode", disable=not progress, file=sys.stderr)
    return bar
