"""Datasets come out the same whatever happens to the processes that make them."""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import json
import os
import signal

import psutil
import pytest

from topokit._processes import ProcessError
from topokit.cli import main
from topokit.data import (
    Dataset,
    DatasetConfig,
    WindowDataset,
    _generate,
    generate_dataset,
    make_episode,
)
from topokit.io import save_episode

from small_datasets import SEED, TINY, command, contents, wait_until, write_cloth

EPISODES = 9


def episodes_in(folder):
    return len(list(folder.glob("0*.npz")))


def kills_a_job(process):
    """Kill a job of a command, and return whether there was one; jobs end by themselves at any moment."""
    family = psutil.Process(process.pid)
    for job in family.children(recursive=True):
        with contextlib.suppress(psutil.NoSuchProcess):
            job.kill()
            return True
    return False


@pytest.fixture
def start():
    """Start commands; what a test leaves running where it fails is killed."""
    with contextlib.ExitStack() as started:

        def start(*arguments):
            process = started.enter_context(command(*arguments))
            started.callback(process.kill)  # before the stack waits for it
            return process

        yield start


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("undisturbed") / "data"
    generate_dataset(TINY, folder, EPISODES, SEED, n_workers=1, progress=False)
    return folder


@pytest.fixture
def outcomes(monkeypatch):
    """Instead of doing jobs: what they come to, by number; the others are not done."""
    given = {}

    def jobs(job, numbers, **_):
        yield from ((number, given[number]) for number in numbers if number in given)

    monkeypatch.setattr(_generate, "in_fresh_processes", jobs)
    return given


def test_two_workers_write_the_bytes_of_one_and_more_are_added_to_those_there(undisturbed, tmp_path):
    generate_dataset(TINY, tmp_path / "data", 3, SEED, n_workers=1, progress=False)
    assert len(Dataset(tmp_path / "data")) == 3
    made = generate_dataset(TINY, tmp_path / "data", EPISODES, SEED, n_workers=2, progress=False)
    assert contents(tmp_path / "data") == contents(undisturbed)
    assert made.counts == {"ok": EPISODES}
    assert made.checksum() == Dataset(undisturbed).checksum()


def test_an_episode_is_what_anyone_simulates(undisturbed, tmp_path):
    """By `make_episode`: the same arrays, and the same file but for the provenance."""
    episode = make_episode(TINY, SEED, 1)
    known = {**episode.provenance, "dataset_seed": SEED, "episode": 1}
    path = save_episode(tmp_path / "1.npz", dataclasses.replace(episode, provenance=known))
    assert path.read_bytes() == (undisturbed / "00000001.npz").read_bytes()


def test_killed_in_every_way_it_goes_on(undisturbed, tmp_path, monkeypatch, start):
    """A child killed, the command killed, the command stopped by Ctrl-C: each time the same command goes on."""
    folder, config, temporary = tmp_path / "data", tmp_path / "config.json", tmp_path / "temporary"
    config.write_text(json.dumps(TINY.to_json()))
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    arguments = ["generate", "--config", config, "--out", folder, "--episodes", str(EPISODES), "--seed", str(SEED)]
    arguments += ["--workers", "2"]

    process = start(*arguments)
    wait_until(lambda: episodes_in(folder) >= 1, process)
    wait_until(lambda: kills_a_job(process), process)  # which is tried again
    wait_until(lambda: episodes_in(folder) >= 3, process)
    jobs = psutil.Process(process.pid).children(recursive=True)
    process.kill()
    process.communicate()
    psutil.wait_procs(jobs, timeout=30)
    there = episodes_in(folder)
    assert 3 <= there < EPISODES

    process = start(*arguments)
    wait_until(lambda: episodes_in(folder) > there, process)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert "Traceback" not in said
    assert not list(folder.glob(".*"))  # what was half written is removed
    assert main([*map(str, arguments)]) == 0
    assert contents(folder) == contents(undisturbed)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        (
            {"config": dataclasses.replace(TINY, simulation=dataclasses.replace(TINY.simulation, friction=0.5))},
            r"config\.simulation\.friction = 1\.0.*= 0\.5",
        ),
        ({"seed": 6}, f"seed = {SEED}.*seed = 6"),
        ({"episodes": 3}, "cannot shrink to 3"),
        ({"episodes": 0}, "episodes: "),
        ({"seed": True}, "seed: "),
    ],
)
def test_something_else_is_refused(undisturbed, changes, says):
    options = {"config": TINY, "out": undisturbed, "episodes": EPISODES, "seed": SEED, "progress": False}
    with pytest.raises(ValueError, match=says):
        generate_dataset(**options | changes)


def test_what_is_missing_is_made_again(undisturbed, tmp_path):
    folder = tmp_path / "data"
    generate_dataset(TINY, folder, 3, SEED, progress=False)
    whole = contents(folder)
    (folder / "00000002.npz").unlink()
    generate_dataset(TINY, folder, 3, SEED, progress=False)
    assert contents(folder) == whole
    (folder / "dataset.json").write_text("{")
    with pytest.raises(ValueError, match=r"dataset\.json"):
        generate_dataset(TINY, folder, 3, SEED, progress=False)


def test_a_crash_is_recorded_and_tried_again_when_asked(tmp_path, outcomes):
    outcomes |= {0: ProcessError("SIGSEGV"), 1: ProcessError("no sign of life")}
    dataset = generate_dataset(TINY, tmp_path, 4, SEED, progress=False)
    assert dataset.counts == {"failed": 2}
    assert [(record.episode, record.status) for record in dataset.failures] == [(0, "failed"), (1, "failed")]
    assert "SIGSEGV" in dataset.failures[0].reason
    assert (dataset.record(1).task, dataset.record(1).seed) == TINY.draw(SEED, 1)
    with pytest.raises(KeyError, match=r"episode 1 was failed: .*no sign of life"):
        dataset[1]
    outcomes.clear()
    assert generate_dataset(TINY, tmp_path, 4, SEED, progress=False).counts == {"failed": 2}


def test_what_is_not_physical_is_recorded_as_rejected(tmp_path):
    strict = dataclasses.replace(TINY, simulation=dataclasses.replace(TINY.simulation, max_stretch=1.00001))
    dataset = generate_dataset(strict, tmp_path, 2, SEED, progress=False)
    assert dataset.counts == {"rejected": 2}
    assert "max_stretch 1.00001" in dataset.failures[0].reason


def test_a_full_disk_is_no_fault_of_the_episode(tmp_path, outcomes):
    outcomes[0] = OSError(errno.ENOSPC, "No space left on device")
    with pytest.raises(OSError, match="No space left"):
        generate_dataset(TINY, tmp_path, 4, SEED, progress=False)
    assert Dataset(tmp_path).records == ()


def test_a_mesh_of_ones_own_from_a_file_to_windows(tmp_path):
    """By the command, with a path relative to the configuration; then without the mesh, and with another one."""
    mesh, folder, config = tmp_path / "bag.obj", tmp_path / "data", tmp_path / "own.json"
    bag = {"file": "bag.obj", **write_cloth(mesh)}
    simulation = {"frames": 77, "settle": 0.05, "self_collision": False}
    own = {"tasks": {"bag-hook": 1}, "meshes": {"bag": bag}, "simulation": simulation, "n_observed": 48}
    config.write_text(json.dumps(own))
    assert main(["generate", "--config", str(config), "--out", str(folder), "--episodes", "1"]) == 0
    mesh.unlink()
    dataset = Dataset(folder)
    episode = dataset[0]
    assert (episode.garment, episode.task, list(episode.named_loops)) == ("bag", "bag-hook", ["hole"])
    assert dataset.garments == ("bag",)
    assert len(WindowDataset(dataset, [0], n_points=40)) > 0

    absolute = DatasetConfig.from_json({**own, "meshes": {"bag": {**bag, "file": str(mesh)}}})
    with pytest.raises(Exception, match=r"bag\.obj"):
        generate_dataset(absolute, folder, 2, 0, progress=False)
    assert len(Dataset(folder).records) == 1


def test_nothing_is_written_for_a_mesh_that_cannot_be_hung(tmp_path):
    bag = {"file": str(tmp_path / "bag.obj"), **write_cloth(tmp_path / "bag.obj"), "loops": {}}
    config = DatasetConfig.from_json({"tasks": {"bag-hook": 1}, "meshes": {"bag": bag}})
    with pytest.raises(ValueError, match="the bag may hang"):
        generate_dataset(config, tmp_path / "data", 1, 0, progress=False)
    assert not (tmp_path / "data").exists()
