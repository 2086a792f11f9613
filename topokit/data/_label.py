"""Label the episodes of a dataset: what the tracker sees in every frame, written as safely as the episodes are.

Source: Antonova et al. 2021, Algorithm 1. Taught in chapter 8.
"""

from __future__ import annotations

import hashlib
import inspect
import re
import time
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topokit.seqph import SeqPH, track
from topokit.state import TopologicalState

from ._generate import follow, same_versions
from ._group import Group, locked, prepare, versions_of
from ._layout import Field, encode
from ._parallel import Cluster, run_jobs
from ._read import ABSENT, PARAMETERS, SIMPLICES, VALUES, cloud_of
from ._records import commit, record_path

__all__ = ["OBSERVATIONS", "TRACKER", "label", "label_fields"]

OBSERVATIONS = ("full", "observed", "camera")
TRACKER: Mapping[str, Any] = {"identity": "killer-triangles", "gates": "proved", "memory": 8}
"""Options of the tracker that labels are made with when nothing else is asked for: the fewest switches of identity."""
_PACKAGES = ("topokit", "numpy", "scipy", "numba", "zarr", "numcodecs")


def label_fields(frames: int, slots: int) -> tuple[Field, ...]:
    """Return the arrays of a set of labels."""
    columns = {name: [part.start, part.stop] for name, part in SIMPLICES.items()}
    about = {
        "units": "1",
        "columns": columns,
        "description": f"ids into the cloud that was tracked; {ABSENT}: no neighbour",
    }
    return (
        Field(
            "id",
            (frames, slots),
            "int32",
            ("frame", "slot"),
            {"units": "1", "description": "identity; -1: no loop"},
            -1,
        ),
        Field("simplices", (frames, slots, 22), "uint16", ("frame", "slot", "column"), about),
        Field(
            "values",
            (frames, slots, len(VALUES)),
            "float32",
            ("frame", "slot", "column"),
            {"units": "m", "columns": VALUES},
        ),
        Field(
            "parameters",
            (frames, len(PARAMETERS)),
            "float32",
            ("frame", "column"),
            {"units": "m, dropped: 1", "columns": PARAMETERS},
        ),
    )


def label(
    dataset: str | Path,
    observation: str = "full",
    *,
    name: str | None = None,
    n_points: int | None = None,
    slots: int = 8,
    options: Mapping[str, Any] | None = None,
    scheduler: str | None = None,
    n_workers: int | None = None,
    dashboard: str | None = None,
    progress: bool = True,
) -> Group:
    """Track every episode of a dataset and store the states, or go on with it.

    Parameters
    ----------
    dataset : path
        A folder that `generate` made.
    observation : {"full", "observed", "camera"}
        What the tracker sees: all vertices, the observation that was recorded, or that of a dataset made with cameras.
    name : str, optional
        Of this set of labels; that of the observation when not given.
    n_points : int, optional
        Track so many points of an observation of vertices, a farthest-point sample.
    slots : int
        Loops kept in a frame, those of the longest lifetime; how many were dropped is stored beside them.
    options : mapping, optional
        Of `topokit.SeqPH`; `TRACKER` when not given.
    scheduler, n_workers, dashboard, progress
        As in `generate`.

    Raises
    ------
    ValueError
        When there is no such observation, or labels of that name were begun with other options.
    OSError, ConnectionError, Interrupted
        As in `generate`.
    """
    folder = Path(dataset)
    group = Group(folder)
    options = dict(TRACKER if options is None else options)
    SeqPH(**options)  # refuses what it does not know
    if group.manifest.get("format") != "topokit-dataset":
        raise ValueError(f"{folder} is not a dataset")
    if observation not in OBSERVATIONS:
        raise ValueError(f"observation must be one of {', '.join(OBSERVATIONS)}, not {observation!r}")
    cameras = group.manifest["config"]["cameras"]
    if observation == "camera" and not cameras:
        raise ValueError(f"{folder} was made without cameras: generate it with --cameras 1, or label what was observed")
    if n_points is not None and (observation != "observed" or cameras or n_points < 4):
        raise ValueError(f"n_points = {n_points}: a number of points, at least 4, of an observation of vertices")
    if slots < 1:
        raise ValueError(f"slots must be at least 1, not {slots}")
    name = name or observation + (f"-{n_points}" if n_points else "")
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", name):
        raise ValueError(f"name {name!r}: letters, digits, dots, hyphens and underscores only")
    given = {key: options.get(key, p.default) for key, p in inspect.signature(SeqPH).parameters.items()}
    manifest = {
        "format": "topokit-labels",
        "version": 1,
        "observation": observation,
        "n_points": n_points,
        "slots": slots,
        "options": given,
        "episodes": group.manifest["episodes"],
        "versions": versions_of(*_PACKAGES),
    }
    if "numbers" in group.manifest:
        manifest["numbers"] = group.manifest["numbers"]
    target = folder / "labels" / name
    with locked(target):
        done = prepare(target, manifest, label_fields(group.manifest["room"]["frames"], slots)).records
        todo = [int(i) for i in group.whole if i not in done]
        jobs = run_jobs(_work, todo, (str(folder), name), Cluster(scheduler, n_workers, dashboard))
        return follow(target, jobs, len(todo), len(group.whole), progress)


@lru_cache(maxsize=2)
def _open(folder: str, name: str) -> tuple[Group, Group]:
    return Group(folder, records=False), Group(folder, f"labels/{name}", records=False)


def _work(folder: str, name: str, index: int) -> dict[str, Any]:
    """What a Dask worker does for an episode."""
    start = time.monotonic()
    same_versions(f"{folder}/labels/{name}", _PACKAGES)
    group, labels = _open(folder, name)
    manifest, document = labels.manifest, group.document(index)
    identity = {key: document[key] for key in ("episode", "task", "garment", "target", "seed", "success")}
    identity["of"] = group_sha(group, index)
    target = Path(folder, "labels", name)
    try:
        cloud = cloud_of(group, document, manifest["observation"], manifest["n_points"])
        states = track(cloud, times=np.arange(len(cloud)) * document["dt"], n_jobs=1, **manifest["options"])
    except ValueError as error:
        commit(target, {**identity, "status": "failed", "reason": str(error)})
        return {"status": "failed", "seconds": round(time.monotonic() - start, 3)}
    arrays = arrays_of(states, manifest["slots"])
    about = {
        "status": "ok",
        "frames": len(states),
        "observed": cloud.shape[1],
        "vertices": document["vertices"],
        "identities": len({loop.id for state in states for loop in state.loops}),
        "dropped": int(arrays["parameters"][:, 3].sum()),
        "shapes": {key: list(values.shape) for key, values in arrays.items()},
    }
    fields = label_fields(group.manifest["room"]["frames"], manifest["slots"])
    commit(target, {**identity, **about}, encode(fields, index, arrays))
    return {"status": "ok", "seconds": round(time.monotonic() - start, 3)}


def group_sha(group: Group, index: int) -> str:
    """Return the checksum of the record of an episode."""
    return hashlib.sha256(group.read(record_path(index)) or b"").hexdigest()


def arrays_of(states: list[TopologicalState], slots: int) -> dict[str, NDArray[Any]]:
    """Return states as the arrays of labels; loops beyond `slots` in a frame, the shortest-lived ones, are dropped."""
    frames = len(states)
    ids = np.full((frames, slots), -1, dtype=np.int32)
    simplices = np.zeros((frames, slots, 22), dtype=np.uint16)
    values = np.zeros((frames, slots, len(VALUES)), dtype=np.float32)
    parameters = np.zeros((frames, len(PARAMETERS)), dtype=np.float32)
    for frame, state in enumerate(states):
        parameters[frame] = [*(state.parameters[key] for key in PARAMETERS[:3]), max(0, len(state) - slots)]
        for slot, loop in enumerate(state.loops[:slots]):
            neighbours = np.full((4, 3), ABSENT)
            neighbours[: len(loop.neighbour_ids)] = loop.neighbour_ids
            parts = (loop.birth_edge, loop.killer_edge, loop.killer_triangle_ids, neighbours)
            ids[frame, slot] = loop.id
            simplices[frame, slot] = np.concatenate([np.ravel(part) for part in parts])
            values[frame, slot, :3] = loop.birth, loop.death, loop.step
            values[frame, slot, 3 : 3 + len(loop.neighbour_values)] = loop.neighbour_values
    return {"id": ids, "simplices": simplices, "values": values, "parameters": parameters}
