"""Make the episodes of a dataset in parallel; a run that was stopped goes on with the episodes that are missing.

Idea: a process writes the same bytes for an episode whenever it does so, and it writes a file whole or not at all.

Source: the 23,000 trajectories of Antonova et al. 2021, section 6. Taught in chapter 11.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from pathlib import Path

from topokit._config import from_mapping, load
from topokit._cores import n_cores
from topokit._processes import in_fresh_processes
from topokit.io import save_episode
from topokit.sim import SimulationError

from ._dataset import ABOUT, Dataset, DatasetSettings
from ._folder import archive_path, begin, versions_of, write_json
from ._recipe import DatasetConfig, make_episode


def generate_dataset(
    config: DatasetConfig,
    out: str | Path,
    episodes: int,
    seed: int,
    *,
    n_workers: int | None = None,
    progress: bool = True,
) -> Dataset:
    """Make the dataset of a configuration and a seed in a folder, or go on with one that was begun.

    The bytes of an episode do not depend on how many workers there are, in which order they work, or how often they were stopped.
    A folder that was begun with another configuration, seed or version is refused.

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
    progress : bool
        Show a progress bar with the time left on stderr.
    """
    from tqdm import tqdm

    # Read meshes of one's own before anything is written.
    for task in config.tasks:
        config.task(task)

    # Begin the folder, or check that it was begun with the same configuration, seed and versions.
    folder = Path(out).expanduser()
    about = {"schema": 2, "config": config.to_json(), "seed": seed, "episodes": episodes}
    about["versions"] = versions_of("numpy", "scipy", "pybullet")
    settings = from_mapping(DatasetSettings, about, "the dataset")
    begin(folder, ABOUT, about)

    # Make the episodes that are missing. A fault of the disk stops the whole command; one of an episode is written down.
    missing = Dataset(folder).missing([*range(episodes)])
    work = partial(_make_file, folder)
    workers = n_cores() if n_workers is None else n_workers
    outcomes = in_fresh_processes(work, missing, n_workers=workers, time_limit=600, tries=3)
    try:
        for number, outcome in tqdm(outcomes, total=len(missing), unit="episode", disable=not progress):
            if isinstance(outcome, OSError):
                raise outcome
            if isinstance(outcome, Exception):
                _write_reason(folder, settings, number, "failed", f"{type(outcome).__name__}: {outcome}")
    finally:
        outcomes.close()
    return Dataset(folder)


def _make_file(folder: Path, number: int) -> None:
    """Simulate an episode in a fresh process, and write its file, or the reason why there is none."""
    settings = load(DatasetSettings, folder / ABOUT)
    try:
        episode = make_episode(settings.config, settings.seed, number, time_limit=None)
    except SimulationError as error:  # cloth that explodes does so on every try
        _write_reason(folder, settings, number, "rejected", str(error))
    else:
        provenance = {**episode.provenance, "dataset_seed": settings.seed, "episode": number}
        save_episode(archive_path(folder, number), dataclasses.replace(episode, provenance=provenance))


def _write_reason(folder: Path, settings: DatasetSettings, number: int, status: str, reason: str) -> None:
    """Write why there is no episode, with what was drawn for it before it was simulated."""
    task, seed = settings.config.draw(settings.seed, number)
    garment, _, target = task.rpartition("-")
    drawn = {"task": task, "garment": garment, "target": target, "seed": seed}
    write_json(archive_path(folder, number).with_suffix(".json"), {**drawn, "status": status, "reason": reason})
