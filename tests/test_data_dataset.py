"""A dataset reads back what was simulated, from anywhere; damage of every kind is found; splits do not leak."""

from __future__ import annotations

import itertools
import json
import pickle
import shutil
from dataclasses import replace
from types import SimpleNamespace

import fsspec
import numpy as np
import pytest
import zarr
from distributed import KilledWorker
from topokit.data._layout import arrays_of, states_of
from topokit.data._records import index_bytes

from topokit import track
from topokit._archive import FormatError
from topokit.cli import main
from topokit.data import (
    Dataset,
    DatasetConfig,
    _generate,
    _layout,
    check_dataset,
    generate_dataset,
    label_dataset,
    make_episode,
)
from topokit.rips import rips_persistence

from small_datasets import OPTIONS, SEED, TINY, labelled, without_dask

EPISODES = 10


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A dataset with two sets of labels; not to be changed."""
    return labelled(tmp_path_factory.mktemp("made") / "data", EPISODES)


@pytest.fixture
def copy(made, tmp_path):
    return shutil.copytree(made, tmp_path / "copy")


def test_an_episode_is_what_was_simulated(made):
    dataset, episode = Dataset(made), make_episode(TINY, SEED, 3)
    found = dataset[3]
    for name in ("points", "observed", "actions", "grippers", "centre_line"):
        assert np.abs(getattr(found, name) - getattr(episode, name)).max() < 0.51e-4, name
        assert getattr(found, name).dtype == np.float32
    for name in ("held", "faces"):
        assert (getattr(found, name) == getattr(episode, name)).all()
    assert [loop.tolist() for loop in found.loops] == [loop.tolist() for loop in episode.loops]
    for name in ("garment", "target", "task", "success", "seed", "dt", "observation", "physics"):
        assert getattr(found, name) == getattr(episode, name), name


def test_what_a_dataset_says_of_itself(made):
    dataset = Dataset(made)
    assert dataset.config == TINY
    assert dataset.seed == SEED
    assert len(dataset) == EPISODES == len(dataset.records)
    assert dataset.garments == ("mask", "sheet", "sheet2")
    assert dataset.failures == ()
    assert "10 of 10 episodes" in repr(dataset)
    assert dataset.group.names("labels") == ["full", "observed-40"]
    assert [episode.seed for episode in dataset] == [record.seed for record in dataset.records]
    with pytest.raises(KeyError, match="no episode 10"):
        dataset[10]
    with pytest.raises(FileNotFoundError, match=r"no labels 'none'; it has full, observed-40"):
        dataset.labels("none")


def test_units_are_in_the_attributes(made):
    for name in ("points", "actions", "grippers", "centre_line"):
        attributes = dict(zarr.open_array(made / name, mode="r").attrs)
        assert attributes["units"] == "m"
        assert attributes["scale_factor"] == 1e-4
    columns = zarr.open_array(made / "labels" / "full" / "values", mode="r").attrs["columns"]
    assert columns[:3] == ["birth", "death", "step"]


def test_labels_are_the_states_of_the_stored_clouds(made):
    dataset = Dataset(made)
    for name, cloud in (("full", lambda e: e.points), ("observed-40", lambda e: e.observed[:, :40])):
        for i in (0, 4):
            episode = dataset[i]
            states = track(cloud(episode), times=episode.times, **OPTIONS)
            found = dataset.states(i, name)
            assert [[loop.id for loop in state.loops] for state in found] == [
                [loop.id for loop in state.loops][:8] for state in states
            ]
            assert any(len(state) for state in states)
            for one, other in zip(found, states, strict=True):
                assert one.time == other.time
                for a, b in zip(one.loops, other.loops, strict=False):
                    for part in (
                        "killer_triangles",
                        "neighbours",
                        "killer_triangle_ids",
                        "neighbour_ids",
                        "birth_edge",
                    ):
                        assert (getattr(a, part) == getattr(b, part)).all(), part
                    np.testing.assert_allclose(
                        [a.birth, a.death, a.killer_shift], [b.birth, b.death, b.killer_shift], rtol=1e-6
                    )
                    np.testing.assert_allclose(a.neighbour_values, b.neighbour_values, rtol=1e-6)


def test_a_stored_loop_finds_its_cycle(made):
    """By persistence of the stored cloud, when asked for: the one that the tracker would name."""
    dataset, asked = Dataset(made), 0
    for name, cloud in (("full", dataset[4].points), ("observed-40", dataset[4].observed[:, :40])):
        states = pickle.loads(pickle.dumps(dataset.states(4, name)))
        for one, other in zip(states[::5], track(cloud, **OPTIONS)[::5], strict=True):
            for a, b in zip(one.loops, other.loops, strict=False):
                asked += 1
                assert a.cycle.tolist() == b.cycle.tolist()
                assert set(a.birth_edge.tolist()) == {a.cycle[0], a.cycle[-1]}
                np.testing.assert_array_equal(a.cycle_points, cloud[one.frame][a.cycle])
    assert asked > 4


def test_the_cycles_of_a_frame_share_its_persistence(made, monkeypatch):
    calls, episode = [], Dataset(made)[0]
    monkeypatch.setattr(_layout, "rips_persistence", lambda points: calls.append(points) or rips_persistence(points))
    states = track(episode.points[:2], alpha=0.0)
    found = states_of(arrays_of(states, 8), episode.points[:2], episode.dt)
    assert calls == []
    for one, other in zip(found, states, strict=True):
        assert len(one) > 1
        for a, b in zip(one.loops, other.loops, strict=False):
            assert a.cycle.tolist() == b.cycle.tolist()
    assert len(calls) == 2


def test_loops_without_a_slot_are_counted(made):
    episode = Dataset(made)[0]
    states = track(episode.points, alpha=0.0)  # also what is noise
    most = max(len(state) for state in states)
    assert most > 2
    stored = arrays_of(states, 2)
    assert [int(n) for n in stored["parameters"][:, 3]] == [max(0, len(state) - 2) for state in states]
    found = states_of(stored, episode.points, episode.dt)
    assert [loop.id for loop in found[0].loops] == [loop.id for loop in states[0].loops[:2]]  # the longest-lived ones


@pytest.mark.parametrize("url", ["memory://data", "zip://::{}/data.zip", "file://{}/data"])
def test_it_reads_from_any_url(made, tmp_path, url):
    shutil.make_archive(str(tmp_path / "data"), "zip", made)
    shutil.copytree(made, tmp_path / "data")
    memory = fsspec.filesystem("memory")
    memory.put(str(made), "/data", recursive=True)
    try:
        dataset = Dataset(url.format(tmp_path))
        assert dataset.checksum() == Dataset(made).checksum()
        assert (dataset[2].points == Dataset(made)[2].points).all()
        assert len(dataset.states(2, "full")) == 20
        assert check_dataset(url.format(tmp_path)) == []
    finally:
        memory.rm("/data", recursive=True)


def test_a_cut_keeps_numbers_checksums_and_labels(made, tmp_path):
    whole, cut = Dataset(made), Dataset(made).cut([7, 2, 5], tmp_path / "cut")
    assert cut.episodes.tolist() == [2, 5, 7]
    assert [record.sha256 for record in cut.records] == [whole.records[i].sha256 for i in (2, 5, 7)]
    assert (cut[5].points == whole[5].points).all()
    assert len(cut.states(7, "observed-40")) == 20
    assert check_dataset(tmp_path / "cut") == []
    assert cut.checksum() != whole.checksum()
    with pytest.raises(KeyError, match="no episode 3"):
        cut[3]
    with pytest.raises(ValueError, match="not an empty folder"):
        whole.cut([1], tmp_path / "cut")
    with pytest.raises(ValueError, match="begun with numbers"):
        generate_dataset(TINY, tmp_path / "cut", EPISODES, SEED, progress=False)


def test_labels_go_on_with_new_episodes_and_refuse_other_options(copy):
    (copy / "labels" / "full" / "records" / "00000004.json").unlink()
    (copy / "labels" / "full" / "index.json").unlink()
    assert [p.where for p in check_dataset(copy)].count("labels/full/records") == 1
    with without_dask():
        label_dataset(copy, options=OPTIONS, progress=False)
    assert check_dataset(copy) == []
    with pytest.raises(ValueError, match=r"begun with options.memory = 20, this is options.memory = 0"):
        label_dataset(copy, options={**OPTIONS, "memory": 0}, progress=False)
    with pytest.raises(ValueError, match="made without cameras"):
        label_dataset(copy, "camera", progress=False)
    with pytest.raises(ValueError, match="match is a function"):
        label_dataset(copy, options={"match": dict}, progress=False)
    with pytest.raises(ValueError, match="letters, digits"):
        label_dataset(copy, name="../full", progress=False)


def test_labels_whose_workers_died_are_recorded(copy, monkeypatch):
    (copy / "labels" / "full" / "records" / "00000004.json").unlink()
    (copy / "labels" / "full" / "index.json").unlink()
    monkeypatch.setattr(_generate, "run_jobs", lambda *_: (pair for pair in [(4, KilledWorker("job", None, 10))]))
    record = label_dataset(copy, options=OPTIONS, progress=False).records[4]
    assert (record.status, record.garment) == ("failed", Dataset(copy).records[4].garment)
    assert {problem.where.split("/")[0] for problem in check_dataset(copy)} == {"labels"}  # what it had is left over


def first(folder, name):
    return sorted(path for path in (folder / name).iterdir() if path.name != "zarr.json")[0]


def flip(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def edit(path, change):
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document, sort_keys=True, ensure_ascii=False) + "\n")


def reindexed(folder, i, **changes):
    """Another index, with the checksum that fits it."""
    records = Dataset(folder).group.records
    records[i] = replace(records[i], **changes)
    (folder / "index.json").write_bytes(index_bytes(records.values()))


def record(folder, i=0):
    return folder / "records" / f"{i:08d}.json"


@pytest.mark.parametrize(
    ("damage", "where", "says"),
    [
        (
            lambda f: flip(first(f, "points")),
            "points/c.0",
            "is damaged: its checksum is not that in the record of episode 0",
        ),
        (lambda f: first(f, "held").unlink(), "held/c.0", "is missing, of episode 0"),
        (lambda f: record(f).write_text('{"episode"'), "records/00000000.json", "not a whole record"),
        (lambda f: record(f, 6).unlink(), "records", "1 episodes are not there yet, the first is 6"),
        (lambda f: shutil.copy(record(f), record(f, 3)), "records/00000003.json", "it says episode 0"),
        (lambda f: shutil.copy(record(f), f / "records" / "copy.json"), "records/copy.json", "not a whole record"),
        (lambda f: edit(record(f), lambda d: d.update(seed=1)), "records/00000000.json", "and seed 1, must have"),
        (lambda f: edit(record(f), lambda d: d.update(frames=7)), "records/00000000.json", "frames"),
        (
            lambda f: edit(record(f), lambda d: d["shapes"].update(points=[20, 9, 3])),
            "records/00000000.json",
            "cannot be read",
        ),
        (
            lambda f: edit(record(f), lambda d: d["objects"].pop("faces/c.0.0.0")),
            "faces/c.0.0.0",
            "belongs to no record",
        ),
        (
            lambda f: edit(f / "points/zarr.json", lambda d: d["attributes"].update(units="mm")),
            "points/zarr.json",
            "units",
        ),
        (lambda f: edit(f / "held/zarr.json", lambda d: d.update(shape=[9, 32])), "held/zarr.json", "shape is [9, 32]"),
        (lambda f: (f / "faces/zarr.json").unlink(), "faces/zarr.json", "is missing"),
        (
            lambda f: shutil.copy(first(f, "points"), f / "points/c.99.0.0.0"),
            "points/c.99.0.0.0",
            "belongs to no record",
        ),
        (lambda f: (f / "index.json").write_text("{}"), "index.json", "a damaged index"),
        (lambda f: edit(f / "index.json", lambda d: d["sha256"].reverse()), "index.json", "its checksum is another"),
        (
            lambda f: reindexed(f, 0, seed=1),
            "index.json",
            "not what its record says",
        ),
        (lambda f: flip(first(f, "labels/full/id")), "labels/full/id/c.0", "is damaged"),
        (lambda f: (f / "labels/full/zarr.json").write_text("x"), "labels/full", "not the group of a topokit dataset"),
        (
            lambda f: edit(f / "labels/full/records/00000002.json", lambda d: d.update(of="0" * 64)),
            "labels/full/records/00000002.json",
            "is of another episode",
        ),
    ],
)
def test_check_finds_damage_and_says_where(copy, damage, where, says):
    damage(copy)
    problems = check_dataset(copy)
    assert any(problem.where.startswith(where) and says in problem.what for problem in problems), list(
        map(str, problems)
    )


def test_check_answers_programs(made, copy, capsys):
    record(copy).unlink()
    assert main(["check", str(copy), "--quiet"]) == 1
    assert "records: 1 episodes are not there yet, the first is 0" in capsys.readouterr().out
    assert main(["check", str(made), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"dataset": str(made), "problems": []}
    assert main(["check", str(made.parent)]) == 2
    assert "there is no dataset" in capsys.readouterr().err


def test_what_is_no_dataset(tmp_path, made):
    with pytest.raises(FileNotFoundError, match="there is no dataset"):
        Dataset(tmp_path)
    (tmp_path / "zarr.json").write_text('{"attributes": {}}')
    with pytest.raises(FormatError, match="not the group of a topokit dataset"):
        Dataset(tmp_path)
    with pytest.raises(ValueError, match="labels, not the dataset"):
        Dataset(made / "labels" / "full")


class Many(Dataset):
    """The records of a dataset of 21 tasks, without episodes."""

    def __init__(self, n):
        from topokit.data._records import Record

        config = DatasetConfig()
        tasks = [config.draw(0, i).task for i in range(n)]
        rows = [Record(i, "ok", "", t, *t.split("-"), 0, True, 80, 9, 9, "") for i, t in enumerate(tasks)]

        self.group = SimpleNamespace(records=dict(enumerate(rows)), manifest={"config": config.to_json()})
        self.episodes = np.arange(n)


@pytest.mark.parametrize("by", ["episode", "garment"])
def test_splits_are_parts_and_do_not_change(by):
    dataset = Many(2000)
    parts = dataset.split(by, seed=1)
    assert list(parts) == ["train", "validation", "test"]
    assert (np.sort(np.concatenate(list(parts.values()))) == dataset.episodes).all()
    assert all((parts[name] == again).all() for name, again in Many(2000).split(by, seed=1).items())
    assert len(parts["test"]) > 0
    assert any(len(parts[name]) != len(part) for name, part in dataset.split(by, seed=2).items())
    if by == "episode":
        assert abs(len(parts["train"]) / 2000 - 0.8) < 0.04
        small = Many(500).split(by, seed=1)  # what was there before the dataset grew stays in its part
        assert all((small[name] == part[part < 500]).all() for name, part in parts.items())


@pytest.mark.parametrize("names", [("train", "validation", "test"), ("train", "dev", "tune", "test"), ("b", "a")])
@pytest.mark.parametrize(("by", "held_out"), [("episode", ()), ("garment", ()), ("garment", ("tote", "tote2"))])
def test_a_split_does_not_depend_on_the_order_in_which_its_shares_are_named(by, held_out, names):
    """A checkpoint keeps them in a JSON object, sorted: the same shares must stay the same episodes."""
    shares, dataset = dict(zip(names, (4, 2, 3, 1), strict=False)), Many(500)
    parts = dataset.split(by, shares, seed=1, held_out=held_out)
    for other in itertools.permutations(shares.items()):
        again = dataset.split(by, dict(other), seed=1, held_out=held_out)
        assert {name: part.tolist() for name, part in again.items()} == {k: v.tolist() for k, v in parts.items()}
    if "test" in names:
        assert list(parts) == list(names)  # train first and test last, whatever is between them
    if held_out:
        assert {dataset.group.records[i].garment for i in list(parts.values())[-1]} == set(held_out)


def test_every_garment_is_in_every_part_of_a_split_by_episode():
    """Also with the seed that the episodes were made with: their first draw, the task, must not decide the part."""
    seed = 0
    first = [np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,))).random() for i in range(1000)]
    for part in Many(1000).split("episode", seed=seed).values():
        draws = np.sort(np.array(first)[part])
        assert np.diff(draws, prepend=0, append=1).max() < 0.15  # from all of [0, 1), in every part


def test_a_split_by_garment_shares_none():
    dataset = Many(2000)
    for seed in range(5):
        worn = [
            {dataset.group.records[i].garment for i in part} for part in dataset.split("garment", seed=seed).values()
        ]
        assert all(worn)
        assert sum(map(len, worn)) == len(set.union(*worn)) == len(dataset.garments)
    parts = dataset.split("garment", {"train": 9, "test": 1}, held_out=["tote", "tote2"])
    assert {dataset.group.records[i].garment for i in parts["test"]} == {"tote", "tote2"}
    assert len(parts["train"]) + len(parts["test"]) == 2000


def test_a_split_by_episode_may_hold_garments_out():
    """Training and validation know the same garments, and every other episode keeps the part it would have had."""
    dataset, bags = Many(2000), {"tote", "tote2"}
    without, whole = dataset.split(held_out=sorted(bags)), dataset.split()
    worn = {name: {dataset.group.records[i].garment for i in part} for name, part in without.items()}
    assert worn["train"] == worn["validation"] == set(dataset.garments) - bags
    for name in ("train", "validation"):
        others = [i for i in whole[name].tolist() if dataset.group.records[i].garment not in bags]
        assert without[name].tolist() == others
    assert len(np.concatenate(list(without.values()))) == 2000


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("frame",), "by must be"),
        (("garment", {"train": 1, "test": 0}), "a positive share"),
        (("garment", {"train": 1, "test": 1}, ["kilt"]), "no garment kilt"),
        (("episode", {"train": 1, "test": 1}, ["kilt"]), "no garment kilt"),
    ],
)
def test_a_wrong_split_is_refused(arguments, says):
    by, *rest = arguments
    shares, held_out = (*rest, {"train": 1, "test": 1}, ())[:2] if len(rest) < 2 else rest
    with pytest.raises(ValueError, match=says):
        Many(50).split(by, shares, held_out=held_out or ())
