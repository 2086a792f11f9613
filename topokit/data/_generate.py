"""Make the episodes of a dataset, in parallel, each exactly once whatever happens.

Source: the 23,000 trajectories of Antonova et al. 2021, section 6. Taught in chapter 9.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from topokit._validate import positive
from topokit.io import save_episode
from topokit.sim import SimulationError

from ._dataset import ABOUT, Dataset
from ._folder import (
    MOST_EPISODES,
    archive_path,
    begin,
    failure_path,
    refuse_other_versions,
    versions_of,
    write_json,
)
from ._jobs import Workers, make_files
from ._recipe import DatasetConfig, checked_file, make_episode, pinned

_PACKAGES = ("numpy", "scipy", "pybullet")
_PRELOAD = ("topokit.data._generate",)


def generate_dataset(
    config: DatasetConfig,
    out: str | Path,
    episodes: int,
    seed: int,
    *,
    scheduler: str | None = None,
    n_workers: int | None = None,
    time_limit: float = 600.0,
    retry_failed: bool = False,
    progress: bool = True,
) -> Dataset:
    """Make the dataset of a configuration and a seed in a folder, or go on with it.

    Every episode is `make_episode` of the configuration, the seed and its number, simulated in a fresh process: the bytes
    do not depend on how many workers there are, in which order they work or how often they were stopped.

    Parameters
    ----------
    config : DatasetConfig
    out : path
        A folder of a local disk, or of one that all workers share. What is finished there stays.
    episodes : int
        How many there are to be; more than the last time adds to them.
    seed : int
    scheduler : str, optional
        Address of a Dask scheduler whose workers see the same folder; processes of this machine when not given.
    n_workers : int, optional
        How many of those; as many as cores when not given.
    time_limit : float
        Seconds after which the simulation of an episode is stopped and tried again.
    retry_failed : bool
        Try those again that were recorded as failed.
    progress : bool
        Show a bar with the time left on stderr.

    Returns
    -------
    dataset : Dataset
        With its `folder`, `counts` and `checksum()`.

    Raises
    ------
    ValueError
        When the folder was begun with another configuration, seed or version, or a mesh in it is not the one that it was;
        the message names what differs.
    FileNotFoundError
        When the file of a mesh is not there.
    ImportError
        When PyBullet is not there.
    """
    if find_spec("pybullet") is None:
        raise ImportError("making episodes needs PyBullet: pip install 'topokit[sim,data]'")
    for name, number, least, most in (("episodes", episodes, 1, MOST_EPISODES), ("seed", seed, 0, 2**128)):
        if isinstance(number, bool) or not isinstance(number, int) or not least <= number <= most:
            raise ValueError(f"{name} must be a whole number from {least} to {most:,}")
    positive(time_limit, "time_limit", zero=False)
    workers = Workers(scheduler, n_workers, time_limit, _PRELOAD)
    folder = Path(out)
    about = {"schema": 2, "config": pinned(config).to_json(), "seed": seed, "episodes": episodes}
    begin(folder, ABOUT, {**about, "versions": versions_of(*_PACKAGES)})
    dataset = Dataset(folder)
    if retry_failed:
        for record in dataset.failures:
            if record.status == "failed":
                failure_path(folder, record.episode).unlink()
        dataset = Dataset(folder)
    missing = [number for number in range(episodes) if not dataset.is_done(number)]
    make_files(
        folder, missing, episodes, partial(_make_file, str(folder)), partial(_describe, dataset), workers, progress
    )
    return Dataset(folder)


def _make_file(folder: str, number: int) -> str:
    """Simulate an episode in a fresh process and write its file; return the status.

    What is no fault of the episode (the disk, another mesh, other versions) is raised, and stops the whole command.
    """
    dataset = Dataset(folder)
    refuse_other_versions(dataset.folder, dataset.settings.versions)
    for mesh in dataset.config.meshes.values():
        checked_file(mesh)
    described = _describe(dataset, number)
    try:
        episode = make_episode(dataset.config, dataset.seed, number, time_limit=None)
    except OSError:
        raise
    except Exception as error:
        # An exploded cloth is no mistake: the same configuration gives the same one on every try.
        status = "rejected" if isinstance(error, SimulationError) else "failed"
        reason = str(error) if status == "rejected" else f"{type(error).__name__}: {error}"
        write_json(failure_path(dataset.folder, number), {**described, "status": status, "reason": reason})
        return status
    provenance = {**episode.provenance, "dataset_seed": dataset.seed, "episode": number}
    save_episode(archive_path(dataset.folder, number), dataclasses.replace(episode, provenance=provenance))
    return "ok"


def _describe(dataset: Dataset, number: int) -> dict[str, Any]:
    """Return what is known of an episode before it is simulated."""
    task, seed = dataset.config.draw(dataset.seed, number)
    garment, _, target = task.rpartition("-")
    return {"task": task, "garment": garment, "target": target, "seed": seed}
