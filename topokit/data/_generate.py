"""Make the episodes of a dataset in parallel; a run that was stopped goes on with the episodes that are missing.

Source: the 23,000 trajectories of Antonova et al. 2021, section 6. Taught in chapter 11.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from topokit._validate import positive, whole
from topokit.io import save_episode
from topokit.sim import SimulationError

from ._dataset import ABOUT, Dataset
from ._folder import archive_path, begin, failure_path, versions_of, write_json
from ._jobs import make_files
from ._recipe import DatasetConfig, make_episode, task_of


def generate_dataset(
    config: DatasetConfig,
    out: str | Path,
    episodes: int,
    seed: int,
    *,
    n_workers: int | None = None,
    time_limit: float = 600.0,
    progress: bool = True,
) -> Dataset:
    """Make the dataset of a configuration and a seed in a folder, or go on with one that was begun.

    Every episode is made by `make_episode` from the configuration, the seed and the episode's number, in a fresh process. So
    its bytes do not depend on how many workers there are, in which order they work, or how often they were stopped.

    Parameters
    ----------
    config : DatasetConfig
    out : path
        A folder. Finished episodes in it are kept.
    episodes : int
        Final number of episodes of the dataset; a larger number than before adds episodes.
    seed : int
        Seed of the dataset, from which the seeds of the episodes are drawn.
    n_workers : int, optional
        Number of processes on this machine; one for each core when not given.
    time_limit : float
        Seconds after which the simulation of an episode is stopped and tried again.
    progress : bool
        Show a progress bar with the time left on stderr.

    Returns
    -------
    dataset : Dataset
        The dataset in the folder.

    Raises
    ------
    ValueError
        When the folder was begun with another configuration, seed or version; the message
        names the difference.
    FileNotFoundError
        When the file of a mesh does not exist.
    ImportError
        When PyBullet is not installed.
    """
    if find_spec("pybullet") is None:
        raise ImportError("generate_dataset needs PyBullet: pip install 'topokit[sim,data]'")
    whole(episodes, "episodes", 1)
    whole(seed, "seed")
    positive(time_limit, "time_limit", zero=False)
    # Read meshes of one's own before anything is written.
    for task in config.tasks:
        if task.rpartition("-")[0] in config.meshes:
            task_of(config, task, config.garment(task))
    # Begin the folder, or check that it was begun with the same configuration, seed and versions.
    folder = Path(out)
    about = {"schema": 2, "config": config.to_json(), "seed": seed, "episodes": episodes}
    begin(folder, ABOUT, {**about, "versions": versions_of("numpy", "scipy", "pybullet")})
    dataset = Dataset(folder)
    # Make the episodes that are missing.
    missing = [number for number in range(episodes) if not dataset.is_done(number)]
    job = partial(_make_file, str(folder))
    make_files(folder, missing, job, partial(_describe, dataset), n_workers, time_limit, progress)
    return Dataset(folder)


def _make_file(folder: str, number: int) -> str:
    """Simulate an episode and write its file, or a record of its failure; return the status.

    This runs in a fresh process. Errors that are no fault of the episode, such as a full disk, are raised, and stop the
    whole command.
    """
    dataset = Dataset(folder)
    description = _describe(dataset, number)
    try:
        episode = make_episode(dataset.config, dataset.seed, number, time_limit=None)
    except OSError:  # a fault of the disk, not of the episode
        raise
    except Exception as error:
        # Cloth that explodes does so on every try, so the episode is rejected for good. Any other error may not come again.
        status = "failed"
        reason = f"{type(error).__name__}: {error}"
        if isinstance(error, SimulationError):
            status = "rejected"
            reason = str(error)
        write_json(failure_path(dataset.folder, number), {**description, "status": status, "reason": reason})
        return status
    provenance = {**episode.provenance, "dataset_seed": dataset.seed, "episode": number}
    save_episode(archive_path(dataset.folder, number), dataclasses.replace(episode, provenance=provenance))
    return "ok"


def _describe(dataset: Dataset, number: int) -> dict[str, Any]:
    """Return the task, garment, target and seed of an episode, which are drawn before it is simulated."""
    task, seed = dataset.config.draw(dataset.seed, number)
    garment, _, target = task.rpartition("-")
    return {"task": task, "garment": garment, "target": target, "seed": seed}
