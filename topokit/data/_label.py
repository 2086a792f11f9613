"""Label the episodes of a dataset: the tracked state of every frame. A run that was stopped goes on with what is missing.

Source: Antonova et al. 2021, Algorithm 1. Taught in chapter 11.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from topokit._archive import save_archive
from topokit.io import state_arrays
from topokit.seqph import SeqPH, track

from ._dataset import ABOUT_LABELS, LABELS_KIND, Dataset, Labels, LabelSettings
from ._folder import archive_path, begin, versions_of


def label_dataset(
    folder: str | Path,
    observation: str = "full",
    *,
    n_points: int | None = None,
    options: Mapping[str, Any] | None = None,
    n_workers: int | None = None,
    progress: bool = True,
) -> Labels:
    """Track every episode of a dataset and store the states, or go on with it; return the set of labels.

    In every frame the eight loops of the longest lifetime are kept. The number of dropped loops is stored too. The labels have
    the name of the observation, and of the number of points where one is given: "full", "observed-128". Labels of that name that
    were begun with other options are refused.

    Parameters
    ----------
    folder : path
        A folder that `generate_dataset` made.
    observation : {"full", "observed"}
        Input of the tracker: all vertices, or the recorded observation (of a dataset with cameras: what these saw).
    n_points : int, optional
        Number of points to track, a farthest-point sample of an observation of vertices.
    options : mapping, optional
        Options of `topokit.SeqPH`; its defaults when not given.
    n_workers : int, optional
        Number of threads; one for each core when not given.
    progress : bool
        Show a progress bar with the time left on stderr.
    """
    from tqdm import tqdm

    dataset = Dataset(folder)
    if n_points is not None and (observation != "observed" or dataset.config.cameras):
        raise ValueError("n_points is for an observation of vertices, which is in the order of a farthest-point sample")

    # All options of the tracker are stored, with defaults where none was given.
    parameters = inspect.signature(SeqPH).parameters
    defaults = {name: parameter.default for name, parameter in parameters.items() if name != "match"}
    stored = {**defaults, **(options or {})}
    SeqPH(**stored)  # refuses a wrong option
    about: dict[str, Any] = {"schema": 2, "observation": observation, "n_points": n_points, "options": stored}
    about["versions"] = versions_of("numpy", "scipy")
    LabelSettings(**about)
    target = dataset.folder / "labels" / (observation if n_points is None else f"{observation}-{n_points}")
    begin(target, ABOUT_LABELS, about)

    # The persistence of all frames of an episode is computed by threads, and the file is written in one piece.
    labels = Labels(target)
    missing = labels.missing(dataset.episodes.tolist())
    for number in tqdm(missing, unit="episode", disable=not progress):
        episode = dataset[number]
        states = track(labels.cloud(episode), times=episode.times, n_jobs=n_workers, **stored)
        arrays = state_arrays(states)
        for part in ("values", "parameters"):
            arrays[part] = arrays[part].astype(np.float32)
        described = {part: getattr(episode, part) for part in ("task", "garment", "target", "seed", "success")}
        save_archive(archive_path(target, number), LABELS_KIND, {**described, "frames": len(states)}, arrays)
    return Labels(target)
