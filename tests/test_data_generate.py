"""Datasets come out the same whatever happens to the processes that make them."""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import hashlib
import json
import os
import signal

import psutil
import pytest
from topokit.data._layout import encode, episode_arrays, episode_fields
from topokit.data._records import index_bytes, read_index

from topokit import _archive
from topokit.cli import main
from topokit.data import (
    Dataset,
    DatasetConfig,
    WindowDataset,
    _generate,
    _group,
    check_dataset,
    generate_dataset,
    label_dataset,
    make_episode,
)
from topokit.data._recipe import room
from topokit.sim import _process

from small_datasets import OPTIONS, SEED, TINY, command, wait_until, without_dask, write_cloth

EPISODES = 16


def contents(folder):
    """All files whose bytes count."""
    names = (path for path in folder.rglob("*") if path.is_file() and path.name not in (".lock", "timing.jsonl"))
    return {str(path.relative_to(folder)): path.read_bytes() for path in names}


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("undisturbed") / "data"
    generate_dataset(TINY, folder, EPISODES, SEED, n_workers=1, progress=False)
    return folder


@pytest.fixture
def started(tmp_path, monkeypatch):
    """A dataset with nothing in it, and its maker in this process."""
    monkeypatch.setattr(_generate, "run_jobs", lambda *_: (pair for pair in ()))
    generate_dataset(TINY, tmp_path / "data", 4, SEED, progress=False)
    monkeypatch.setattr(_generate, "_forge", None)
    yield tmp_path / "data"
    if _generate._forge is not None:
        _generate._forge.close()


def test_two_workers_write_the_bytes_of_one_and_more_are_added_to_those_there(undisturbed, tmp_path):
    generate_dataset(TINY, tmp_path / "data", 3, SEED, n_workers=1, progress=False)
    assert len(Dataset(tmp_path / "data")) == 3
    generate_dataset(TINY, tmp_path / "data", EPISODES, SEED, n_workers=2, progress=False)
    assert contents(tmp_path / "data") == contents(undisturbed)
    assert check_dataset(tmp_path / "data") == []


@pytest.mark.parametrize("index", [0, 1])
def test_an_episode_is_what_anyone_simulates(undisturbed, index):
    """In a process of its own, started afresh: the forge's forks write the same bytes."""
    episode = make_episode(TINY, SEED, index)
    objects = dict(encode(episode_fields(room(TINY)), index, episode_arrays(episode)))
    assert objects == {
        path: (undisturbed / path).read_bytes() for path in Dataset(undisturbed).document(index)["objects"]
    }


def test_killed_in_every_way_it_goes_on(undisturbed, tmp_path):
    """A worker killed, the command killed, the command stopped by Ctrl-C: each time the same command goes on."""
    folder, config = tmp_path / "data", tmp_path / "config.json"
    config.write_text(json.dumps(TINY.to_json()))
    arguments = ["generate", "--config", config, "--out", folder, "--episodes", EPISODES, "--seed", SEED]
    arguments += ["--workers", 2, "--quiet"]
    records = folder / "records"

    def done(n):
        return lambda: records.is_dir() and len(list(records.iterdir())) >= n

    process = command(*map(str, arguments))
    wait_until(done(2), process)
    family = psutil.Process(process.pid).children(recursive=True)
    worker = next(child for child in family if "spawn_main" in " ".join(child.cmdline()))
    os.kill(worker.pid, signal.SIGKILL)
    wait_until(done(5), process)
    family = psutil.Process(process.pid).children(recursive=True)
    process.kill()
    process.communicate()
    _, alive = psutil.wait_procs(family, timeout=30)
    assert not alive  # nobody goes on writing
    assert {problem.where for problem in check_dataset(folder)} <= {"records"} | {
        p.where for p in check_dataset(folder) if "stopped" in p.what
    }
    before = Dataset(folder)
    assert 5 <= len(before) < EPISODES
    assert all(len(episode) == 20 for episode in before)

    process = command(*map(str, arguments))
    wait_until(done(len(before) + 2), process)
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert "the same command goes on" in said

    assert main([*map(str, arguments), "--workers", "1"]) == 0
    assert contents(folder) == contents(undisturbed)


def test_ctrl_c_is_not_for_the_workers():
    """A terminal sends it to them, too; one that died of it would be started anew while its cluster closes."""
    with _generate._client(_generate.Cluster(n_workers=1), 1) as (client, _):
        (deaf,) = client.run(signal.pthread_sigmask, signal.SIG_BLOCK, []).values()
    assert signal.SIGINT in deaf
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])  # but for us


def test_another_configuration_is_refused(undisturbed):
    other = dataclasses.replace(TINY, simulation=dataclasses.replace(TINY.simulation, friction=0.5))
    with pytest.raises(ValueError, match=r"begun with config.simulation.friction = 1.0, this is .* = 0.5"):
        generate_dataset(other, undisturbed, EPISODES, SEED, progress=False)
    with pytest.raises(ValueError, match=f"begun with seed = {SEED}, this is seed = 6"):
        generate_dataset(TINY, undisturbed, EPISODES, 6, progress=False)
    with pytest.raises(ValueError, match="cannot shrink to 3"):
        generate_dataset(TINY, undisturbed, 3, SEED, progress=False)


def test_other_versions_are_refused(undisturbed, monkeypatch):
    newer = {**_generate.versions_of(*_generate.PACKAGES), "numpy": "99"}
    monkeypatch.setattr(_generate, "versions_of", lambda *_: newer)
    with pytest.raises(ValueError, match=r"versions.numpy.*use the same versions"):
        generate_dataset(TINY, undisturbed, EPISODES, SEED, progress=False)


def test_a_folder_of_other_files_is_refused(tmp_path):
    (tmp_path / "thesis.tex").write_text("chapter 1")
    with pytest.raises(ValueError, match="holds other files"):
        generate_dataset(TINY, tmp_path, 1, SEED, progress=False)


@pytest.mark.parametrize("writes", range(9))
def test_killed_while_the_folder_is_made_it_goes_on(started, tmp_path, monkeypatch, writes):
    """Nine files describe a dataset and its arrays: after any number of them, and with one half-written, all come out."""
    folder, left = tmp_path / "killed", iter(range(writes))

    @contextlib.contextmanager
    def write(path):
        if next(left, None) is None:
            path.parent.mkdir(parents=True, exist_ok=True)
            (path.parent / f".{path.name}.killed.part").write_text("half")
            raise SystemExit("killed")
        with _archive.atomic_file(path) as handle:
            yield handle

    with monkeypatch.context() as patch:
        patch.setattr(_group, "atomic_file", write)
        with pytest.raises(SystemExit):
            generate_dataset(TINY, folder, 4, SEED, progress=False)
    generate_dataset(TINY, folder, 4, SEED, progress=False)
    assert contents(folder) == contents(started)


def test_two_commands_do_not_write_to_one_folder(started):
    manifest = Dataset(started).group.manifest
    with _group.writing(started, manifest, ()), pytest.raises(OSError, match="another topokit command is writing"):
        generate_dataset(TINY, started, 4, SEED, progress=False)


def test_a_crash_is_tried_three_times_and_recorded(started, monkeypatch):
    monkeypatch.setattr(_generate, "_SIMULATE", "small_datasets:crash")
    assert _generate._make_episode(str(started), 60.0, 2)["status"] == "failed"
    record = Dataset(started).failures[0]
    assert (record.episode, record.status) == (2, "failed")
    assert record.reason.startswith("after 3 tries: SIGSEGV")
    assert record.task == Dataset(started).document(2)["task"]
    with pytest.raises(KeyError, match="episode 2 was failed: after 3 tries"):
        Dataset(started)[2]


def test_a_crash_that_passes_leaves_no_trace(started, undisturbed, monkeypatch):
    monkeypatch.setattr(_generate, "_SIMULATE", "small_datasets:crash_twice")
    assert _generate._make_episode(str(started), 60.0, 1)["attempts"] == 3
    assert Dataset(started).document(1) == Dataset(undisturbed).document(1)


def test_what_hangs_is_stopped(started, monkeypatch):
    monkeypatch.setattr(_generate, "_SIMULATE", "small_datasets:hang")
    assert _generate._make_episode(str(started), 1.0, 0)["status"] == "failed"
    assert "stopped after 1 s of processor time" in Dataset(started).failures[0].reason


def test_what_is_slow_because_the_machine_is_busy_is_not(started, monkeypatch):
    monkeypatch.setattr(_generate, "_SIMULATE", "small_datasets:sleep")
    assert _generate._make_episode(str(started), 1.0, 0)["status"] == "ok"


def test_what_waits_for_ever_is_stopped_in_the_end(started, monkeypatch):
    monkeypatch.setattr(_generate, "_SIMULATE", "small_datasets:sleep")
    assert _generate._make_episode(str(started), 0.1, 0)["status"] == "failed"
    assert "stopped: no sign of life for 1 s" in Dataset(started).failures[0].reason


def test_a_full_disk_is_no_fault_of_the_episode(started, monkeypatch):
    monkeypatch.setattr(_generate, "_SIMULATE", "small_datasets:fill_the_disk")
    with pytest.raises(OSError, match="No space") as full:
        _generate._make_episode(str(started), 60.0, 0)
    assert full.value.errno == errno.ENOSPC
    assert Dataset(started).records == ()

    def jobs(*_):
        yield 0, full.value

    monkeypatch.setattr(_generate, "run_jobs", jobs)
    with pytest.raises(OSError, match="the disk is full; what was finished is whole"):
        generate_dataset(TINY, started, 4, SEED, progress=False)


def test_a_disk_that_fills_up_leaves_nothing_half_written(undisturbed, tmp_path):
    """From the fourth episode on there is no room; then there is again, and the same command goes on."""
    site, folder, config = tmp_path / "site", tmp_path / "data", tmp_path / "config.json"
    site.mkdir()
    (site / "sitecustomize.py").write_text(
        "import errno, os, pathlib\n"
        "fsync = os.fsync\n"
        f"records = pathlib.Path({str(folder / 'records')!r})\n"
        "def full(handle):\n"
        "    done = len(list(records.glob('*.json')))\n"
        "    if done > 3 and '.part' in os.readlink(f'/proc/self/fd/{handle}'):\n"
        "        raise OSError(errno.ENOSPC, 'No space left on device')\n"
        "    fsync(handle)\n"
        "os.fsync = full\n"
    )
    config.write_text(json.dumps(TINY.to_json()))
    arguments = ["generate", "--config", config, "--out", folder, "--episodes", str(EPISODES), "--seed", str(SEED)]
    process = command(*arguments, "--workers", "1", "--quiet", site=site)
    _, said = process.communicate(timeout=120)
    assert process.returncode == 2
    assert "the disk is full; what was finished is whole: make room, and the same command goes on" in said
    assert len(Dataset(folder)) == 4
    assert not [p for p in check_dataset(folder) if "not there yet" not in p.what]
    generate_dataset(TINY, folder, EPISODES, SEED, n_workers=1, progress=False)
    assert contents(folder) == contents(undisturbed)


def test_what_is_not_physical_is_recorded_as_rejected(started, monkeypatch):
    strict = dataclasses.replace(TINY, simulation=dataclasses.replace(TINY.simulation, max_stretch=1.00001))
    folder = started.parent / "strict"
    monkeypatch.setattr(_generate, "run_jobs", lambda *_: (pair for pair in ()))
    generate_dataset(strict, folder, 2, SEED, progress=False)
    assert _generate._make_episode(str(folder), 60.0, 1) | {"seconds": 0} == {
        "status": "rejected",
        "seconds": 0,
        "attempts": 1,
    }
    (record,) = Dataset(folder).failures
    assert record.status == "rejected"
    assert "stretched beyond" in record.reason
    assert len(Dataset(folder)) == 0


def test_failed_episodes_are_tried_again_when_asked(started, undisturbed, monkeypatch):
    monkeypatch.setattr(_generate, "_SIMULATE", "small_datasets:crash")
    _generate._make_episode(str(started), 60.0, 0)
    tried = []

    def jobs(job, items, *_):
        tried.append(list(items))
        yield from ()

    monkeypatch.setattr(_generate, "run_jobs", jobs)
    generate_dataset(TINY, started, 4, SEED, progress=False)
    generate_dataset(TINY, started, 4, SEED, progress=False, retry_failed=True)
    assert tried == [[1, 2, 3], [0, 1, 2, 3]]


def test_a_worker_with_other_versions_stops_the_work(started, monkeypatch):
    newer = {**_generate.versions_of(*_generate.PACKAGES), "numpy": "99"}
    monkeypatch.setattr(_generate, "versions_of", lambda *_: newer)
    with pytest.raises(ValueError, match=r"versions.numpy.*use the same versions"):
        _generate._make_episode(str(started), 60.0, 0)
    assert Dataset(started).records == ()


def test_the_index_is_brought_up_to_the_records(undisturbed):
    dataset = Dataset(undisturbed)
    (undisturbed / "index.json").unlink()
    assert Dataset(undisturbed).group.records == dataset.group.records
    (undisturbed / "index.json").write_bytes(index_bytes(dataset.records[:10]))  # as after a kill
    assert Dataset(undisturbed).checksum() == dataset.checksum()
    (undisturbed / "index.json").write_bytes(index_bytes(dataset.records))
    assert read_index((undisturbed / "index.json").read_bytes(), "index.json") == dataset.group.records


def test_a_scheduler_that_is_not_there(tmp_path, monkeypatch):
    monkeypatch.setattr(_generate, "_PATIENCE", 0.5)
    with pytest.raises(ConnectionError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9"):
        generate_dataset(TINY, tmp_path / "data", 1, SEED, scheduler="tcp://127.0.0.1:9", progress=False)


def test_a_system_that_does_not_say_which_cores_are_ours(tmp_path, monkeypatch):
    """macOS: there is no such function, and all the machine's cores are there to run on."""
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    group = generate_dataset(TINY, tmp_path / "data", 2, SEED, progress=False)
    assert group.whole.tolist() == [0, 1]


def test_ctrl_c_says_how_to_go_on(started, monkeypatch):
    def jobs(*_):
        raise KeyboardInterrupt
        yield

    monkeypatch.setattr(_generate, "run_jobs", jobs)
    with pytest.raises(KeyboardInterrupt, match="0 of 4 are done and kept"):
        generate_dataset(TINY, started, 4, SEED, progress=False)


@pytest.mark.parametrize(("killed", "says"), [(2, None), (99, "does not start")])
def test_a_forge_that_is_killed_while_it_starts_is_started_again(tmp_path, monkeypatch, killed, says):
    log = tmp_path / "starts"
    die = f"import os; path = {str(log)!r}; open(path, 'a').write('x')\n"
    die += f"if os.path.getsize(path) <= {killed}: os.kill(os.getpid(), 9)\n"
    monkeypatch.setattr(_process, "_MAIN", die + _process._MAIN)
    forge = _process.Forge("json:dumps")
    try:
        with contextlib.nullcontext() if says is None else pytest.raises(RuntimeError, match=says):
            assert forge.run({"a": 1}, 5.0) == {"answer": '{"a": 1}'}
    finally:
        forge.close()
    assert log.stat().st_size == (killed + 1 if says is None else _process._STARTS)


def test_a_mesh_of_ones_own_from_a_file_to_windows(tmp_path, monkeypatch):
    """By the command, with a path relative to the configuration; then without the mesh, and with another one."""
    mesh, folder, config = tmp_path / "bag.obj", tmp_path / "data", tmp_path / "own.json"
    bag = {"file": "bag.obj", "loops": {"hole": write_cloth(mesh)}, "up": "z"}
    simulation = {"frames": 77, "settle": 0.05, "self_collision": False}
    own = {"version": 2, "tasks": {"bag-hook": 1}, "meshes": {"bag": bag}, "simulation": simulation, "n_observed": 48}
    config.write_text(json.dumps(own))
    arguments = ["generate", "--config", str(config), "--out", str(folder), "--episodes", "1", "--quiet"]
    with without_dask():
        assert main(arguments) == 0
        label_dataset(folder, options=OPTIONS, progress=False)
    there = mesh.read_bytes()
    mesh.unlink()
    dataset = Dataset(folder)
    episode = dataset[0]
    assert (episode.garment, episode.task, list(episode.named_loops)) == ("bag", "bag-hook", ["hole"])
    assert dataset.garments == ("bag",)
    assert check_dataset(folder) == []
    assert len(WindowDataset(dataset, [0], labels="full", n_points=40)) > 0

    monkeypatch.setattr(_generate, "run_jobs", lambda *_: (pair for pair in ()))
    relative = DatasetConfig.from_json({**own, "meshes": {"bag": {**bag, "file": str(mesh)}}})
    with pytest.raises(FileNotFoundError, match=r"bag\.obj: there is no such file"):
        generate_dataset(relative, folder, 2, 0, progress=False)
    with pytest.raises(FileNotFoundError, match=r"bag\.obj: there is no such file"):
        _generate._make_episode(str(folder), 60.0, 0)  # the work stops: no episode is to blame
    write_cloth(mesh, stretched=1.01)
    sums = [hashlib.sha256(content).hexdigest() for content in (there, mesh.read_bytes())]
    with pytest.raises(
        ValueError, match=f"begun with config.meshes.bag.sha256 = '{sums[0]}', this is .* = '{sums[1]}'"
    ):
        generate_dataset(relative, folder, 2, 0, progress=False)
    assert len(Dataset(folder).records) == 1


def test_nothing_is_written_for_a_mesh_that_cannot_be_hung(tmp_path):
    hole = write_cloth(tmp_path / "bag.obj")
    bag = {"file": str(tmp_path / "bag.obj"), "loops": {"hem": hole}, "up": "z"}
    config = DatasetConfig.from_json({"version": 2, "tasks": {"bag-hook": 1}, "meshes": {"bag": bag}})
    with pytest.raises(ValueError, match="no loop to hang it by"):
        generate_dataset(config, tmp_path / "data", 1, 0, progress=False)
    assert not (tmp_path / "data").exists()
