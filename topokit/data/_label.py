"""Label the episodes of a dataset: what the tracker sees in every frame, written as safely as the episodes are.

Source: Antonova et al. 2021, Algorithm 1. Taught in chapter 9.
"""

from __future__ import annotations

import inspect
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from topokit.seqph import SeqPH, track

from ._generate import Cluster, make_missing, manifest_here
from ._group import Group, commit, label_name, local_folder, open_episodes, tracked_cloud, versions_of, writing
from ._layout import arrays_of, encode, label_fields

_OBSERVATIONS = ("full", "observed", "camera")
_SLOTS = 8  # of a frame
_PACKAGES = ("numpy", "scipy", "numba", "zarr", "numcodecs")


def label_dataset(
    dataset: str | Path,
    observation: str = "full",
    *,
    name: str | None = None,
    n_points: int | None = None,
    options: Mapping[str, Any] | None = None,
    scheduler: str | None = None,
    n_workers: int | None = None,
    dashboard: str | None = None,
    progress: bool = True,
) -> Group:
    """Track every episode of a dataset and store the states, or go on with it.

    The eight loops of the longest lifetime are kept in a frame; how many were dropped is stored beside them.

    Parameters
    ----------
    dataset : path
        A folder that `generate_dataset` made.
    observation : {"full", "observed", "camera"}
        What the tracker sees: all vertices, the observation that was recorded, or that of a dataset made with cameras.
    name : str, optional
        Of this set of labels; that of the observation when not given.
    n_points : int, optional
        Track so many points of an observation of vertices, a farthest-point sample.
    options : mapping, optional
        Of `topokit.SeqPH`; its own when not given.
    scheduler, n_workers, dashboard, progress
        As in `generate_dataset`.

    Raises
    ------
    ValueError
        When there is no such observation, or labels of that name were begun with other options.
    """
    folder = local_folder(dataset)
    group = open_episodes(folder)
    manifest = _manifest(group, observation, n_points, options or {})
    name = label_name(name or observation + (f"-{n_points}" if n_points else ""))
    target, cluster = folder / "labels" / name, Cluster(scheduler, n_workers, dashboard)
    job = partial(_label_episode, str(folder), name)
    fields = label_fields(group.manifest["room"]["frames"], _SLOTS)
    with writing(target, manifest, fields, target.parent, target):
        return make_missing(target, group.whole.tolist(), job, partial(_identity, group), cluster, progress)


def _manifest(group: Group, observation: str, n_points: int | None, options: Mapping[str, Any]) -> dict[str, Any]:
    """What the group of the labels says it is; a ValueError when that cannot be."""
    cameras = group.manifest["config"]["cameras"]
    if observation not in _OBSERVATIONS:
        raise ValueError(f"observation must be one of {', '.join(_OBSERVATIONS)}, not {observation!r}")
    if observation == "camera" and not cameras:
        raise ValueError(f"{group.url} was made without cameras: label `observed`")
    if n_points is not None and (observation != "observed" or cameras or n_points < 4):
        raise ValueError(f"n_points = {n_points}: a number of points, at least 4, of an observation of vertices")
    return {
        "format": "topokit-labels",
        "version": 1,
        "observation": observation,
        "n_points": n_points,
        "slots": _SLOTS,
        "options": _all_options(options),
        "episodes": group.manifest["episodes"],
        "versions": versions_of(*_PACKAGES),
        **{name: group.manifest[name] for name in ("numbers",) if name in group.manifest},
    }


def _all_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options of a tracker, also those that were not given."""
    SeqPH(**options)  # refuses what it does not know
    if options.get("match") is not None:
        raise ValueError("options: match is a function, which cannot be stored beside the labels")
    defaults = {name: p.default for name, p in inspect.signature(SeqPH).parameters.items() if name != "match"}
    return {name: options.get(name, default) for name, default in defaults.items()}


def _label_episode(folder: str, name: str, index: int) -> dict[str, Any]:
    """What a Dask worker does for an episode."""
    start, target, group = time.monotonic(), Path(folder, "labels", name), open_episodes(folder)
    manifest, (_, episode) = manifest_here(target, _PACKAGES), group.now(index)
    try:
        cloud = tracked_cloud(group, episode, manifest)
        states = track(cloud, times=np.arange(len(cloud)) * episode["dt"], n_jobs=1, **manifest["options"])
    except ValueError as error:
        commit(target, {**_identity(group, index), "status": "failed", "reason": str(error)})
        return {"status": "failed", "seconds": round(time.monotonic() - start, 3)}
    arrays = arrays_of(states, manifest["slots"])
    document = {
        **_identity(group, index),
        "status": "ok",
        "frames": len(states),
        "observed": cloud.shape[1],
        "vertices": episode["vertices"],
        "identities": len({loop.id for state in states for loop in state.loops}),
        "dropped": int(arrays["parameters"][:, 3].sum()),
        "shapes": {key: list(values.shape) for key, values in arrays.items()},
    }
    fields = label_fields(group.manifest["room"]["frames"], manifest["slots"])
    commit(target, document, encode(fields, index, arrays))
    return {"status": "ok", "seconds": round(time.monotonic() - start, 3)}


def _identity(group: Group, index: int) -> dict[str, Any]:
    record, document = group.now(index)  # not by the index: 23,000 lines for every episode
    known = {key: document[key] for key in ("episode", "task", "garment", "target", "seed", "success")}
    return {**known, "of": record.sha256}
