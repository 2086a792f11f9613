"""Label the episodes of a dataset: the tracked state of every frame, written as safely as the episodes.

Source: Antonova et al. 2021, Algorithm 1. Taught in chapter 11.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
import re
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from topokit._archive import save_archive
from topokit.io import state_arrays
from topokit.seqph import SeqPH, track

from ._dataset import Dataset
from ._folder import archive_path, begin, failure_path, versions_of, write_json
from ._jobs import make_files
from ._labels import ABOUT, KIND, Labels, LabelSettings


def label_dataset(
    folder: str | Path,
    observation: str = "full",
    *,
    name: str | None = None,
    n_points: int | None = None,
    options: Mapping[str, Any] | None = None,
    n_workers: int | None = None,
    progress: bool = True,
) -> Labels:
    """Track every episode of a dataset and store the states, or go on with it.

    In every frame the eight loops of the longest lifetime are kept. The number of dropped loops is stored too.

    Parameters
    ----------
    folder : path
        A folder that `generate_dataset` made.
    observation : {"full", "observed", "camera"}
        Input of the tracker: all vertices, the recorded observation, or the observation of a dataset made with cameras.
    name : str, optional
        Name of this set of labels; the name of the observation when not given.
    n_points : int, optional
        Number of points to track, a farthest-point sample of an observation of vertices.
    options : mapping, optional
        Options of `topokit.SeqPH`; its defaults when not given.
    n_workers, progress
        The parameters of the same names of `generate_dataset`.

    Returns
    -------
    labels : Labels
        The set of labels, with its `folder`, `counts` and `checksum()`.

    Raises
    ------
    ValueError
        When there is no such observation, or labels of that name were begun with other options.
    FileNotFoundError
        When there is no such dataset.
    """
    dataset = Dataset(folder)
    settings = _settings(dataset, observation, n_points, options or {})
    if name is None:
        name = observation if n_points is None else f"{observation}-{n_points}"
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", name):
        raise ValueError(f"name {name!r} of labels: letters, digits, dots, hyphens and underscores only")
    target = dataset.folder / "labels" / name
    begin(target, ABOUT, dataclasses.asdict(settings))
    labels = Labels(target)
    missing = [number for number in dataset.episodes.tolist() if not labels.is_done(number)]
    job = partial(_label_episode, str(dataset.folder), name)
    make_files(target, missing, job, partial(_describe, dataset), n_workers, math.inf, progress)
    return Labels(target)


def _settings(dataset: Dataset, observation: str, n_points: int | None, options: Mapping[str, Any]) -> LabelSettings:
    """Return the settings of the labels; raise ValueError when the dataset does not allow them."""
    cameras = dataset.config.cameras
    if observation not in ("full", "observed", "camera"):
        raise ValueError(f"observation must be full, observed or camera, not {observation!r}")
    if observation == "camera" and not cameras:
        raise ValueError(f"{dataset.folder} was made without cameras: label `observed`")
    if n_points is not None and (observation != "observed" or cameras or n_points < 4):
        raise ValueError(
            f"n_points must be a number of points, at least 4, of an observation of vertices, not {n_points}"
        )
    # All options of the tracker are stored, with defaults where none was given.
    SeqPH(**options)  # refuses an unknown option
    if options.get("match") is not None:
        raise ValueError("options: match is a function, which cannot be stored beside the labels")
    parameters = inspect.signature(SeqPH).parameters
    stored = {name: options.get(name, parameter.default) for name, parameter in parameters.items() if name != "match"}
    return LabelSettings(2, observation, n_points, stored, versions_of("numpy", "scipy"))  # type: ignore[arg-type]


def _label_episode(folder: str, name: str, number: int) -> str:
    """Track an episode in a fresh process and write its labels; return the status."""
    dataset = Dataset(folder)
    labels = dataset.labels(name)
    described = _describe(dataset, number)
    episode = dataset[number]
    try:
        states = track(labels.cloud(episode), times=episode.times, n_jobs=1, **labels.options)
    except ValueError as error:
        write_json(failure_path(labels.folder, number), {**described, "status": "failed", "reason": str(error)})
        return "failed"
    header = {**described, "frames": len(states)}
    arrays = state_arrays(states)
    for name in ("values", "parameters"):
        arrays[name] = arrays[name].astype(np.float32)
    save_archive(archive_path(labels.folder, number), KIND, header, arrays)
    return "ok"


def _describe(dataset: Dataset, number: int) -> dict[str, Any]:
    """Return the header of an episode's file of labels."""
    record = dataset.record(number)
    return {name: getattr(record, name) for name in ("task", "garment", "target", "seed", "success")}
