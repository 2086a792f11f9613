"""Label the episodes of a dataset: what the tracker sees in every frame, written as safely as the episodes are.

Source: Antonova et al. 2021, Algorithm 1. Taught in chapter 9.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from topokit._archive import save_archive
from topokit.seqph import SeqPH, track

from ._dataset import Dataset
from ._folder import archive_path, begin, failure_path, refuse_other_versions, versions_of, write_json
from ._jobs import Workers, make_files
from ._labels import ABOUT, KIND, Labels, LabelSettings, arrays_of

_OBSERVATIONS = ("full", "observed", "camera")
_PACKAGES = ("numpy", "scipy", "numba")
_PRELOAD = ("topokit.data._warm",)


def label_dataset(
    folder: str | Path,
    observation: str = "full",
    *,
    name: str | None = None,
    n_points: int | None = None,
    options: Mapping[str, Any] | None = None,
    scheduler: str | None = None,
    n_workers: int | None = None,
    progress: bool = True,
) -> Labels:
    """Track every episode of a dataset and store the states, or go on with it.

    The eight loops of the longest lifetime are kept in a frame; how many were dropped is stored beside them.

    Parameters
    ----------
    folder : path
        A folder that `generate_dataset` made.
    observation : {"full", "observed", "camera"}
        What the tracker sees: all vertices, the observation that was recorded, or that of a dataset made with cameras.
    name : str, optional
        Of this set of labels; that of the observation when not given.
    n_points : int, optional
        Track so many points of an observation of vertices, a farthest-point sample.
    options : mapping, optional
        Of `topokit.SeqPH`; its own when not given.
    scheduler, n_workers, progress
        As in `generate_dataset`.

    Returns
    -------
    labels : Labels
        With its `folder`, `counts` and `checksum()`.

    Raises
    ------
    ValueError
        When there is no such observation, or labels of that name were begun with other options.
    """
    dataset = Dataset(folder)
    settings = _settings(dataset, observation, n_points, options or {})
    if name is None:
        name = observation if n_points is None else f"{observation}-{n_points}"
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", name):
        raise ValueError(f"name {name!r} of labels: letters, digits, dots, hyphens and underscores only")
    workers = Workers(scheduler, n_workers, preload=_PRELOAD)
    target = dataset.folder / "labels" / name
    begin(target, ABOUT, dataclasses.asdict(settings))
    labels = Labels(target)
    missing = [number for number in dataset.episodes.tolist() if not labels.is_done(number)]
    job = partial(_label_episode, str(dataset.folder), name)
    make_files(target, missing, len(dataset.episodes), job, partial(_describe, dataset), workers, progress)
    return Labels(target)


def _settings(dataset: Dataset, observation: str, n_points: int | None, options: Mapping[str, Any]) -> LabelSettings:
    """Return what the labels are to be; raise ValueError when that cannot be."""
    cameras = dataset.config.cameras
    if observation not in _OBSERVATIONS:
        raise ValueError(f"observation must be one of {', '.join(_OBSERVATIONS)}, not {observation!r}")
    if observation == "camera" and not cameras:
        raise ValueError(f"{dataset.folder} was made without cameras: label `observed`")
    if n_points is not None and (observation != "observed" or cameras or n_points < 4):
        raise ValueError(f"n_points = {n_points}: a number of points, at least 4, of an observation of vertices")
    return LabelSettings(2, observation, n_points, _all_options(options), versions_of(*_PACKAGES))  # type: ignore[arg-type]


def _all_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a tracker, with the defaults of those that were not given."""
    SeqPH(**options)  # refuses an unknown one
    if options.get("match") is not None:
        raise ValueError("options: match is a function, which cannot be stored beside the labels")
    parameters = inspect.signature(SeqPH).parameters
    return {name: options.get(name, parameter.default) for name, parameter in parameters.items() if name != "match"}


def _label_episode(folder: str, name: str, number: int) -> str:
    """Track an episode in a fresh process and write its labels; return the status."""
    dataset = Dataset(folder)
    labels = dataset.labels(name)
    refuse_other_versions(labels.folder, labels.settings.versions)
    described = _describe(dataset, number)
    episode = dataset[number]
    try:
        states = track(labels.cloud(episode), times=episode.times, n_jobs=1, **labels.options)
    except ValueError as error:
        write_json(failure_path(labels.folder, number), {**described, "status": "failed", "reason": str(error)})
        return "failed"
    header = {**described, "frames": len(states)}
    save_archive(archive_path(labels.folder, number), KIND, header, arrays_of(states))
    return "ok"


def _describe(dataset: Dataset, number: int) -> dict[str, Any]:
    """Return what is said of an episode in the file of its labels."""
    record = dataset.record(number)
    return {name: getattr(record, name) for name in ("task", "garment", "target", "seed", "success")}
