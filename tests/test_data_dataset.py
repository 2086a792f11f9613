"""A dataset reads back what was simulated; damage of every kind is found; splits do not leak."""

from __future__ import annotations

import pickle
import shutil

import numpy as np
import pytest

from topokit import track
from topokit._archive import load_archive, save_archive
from topokit.data import Dataset, DatasetConfig, _label, label_dataset
from topokit.data._dataset import LABELS_KIND, Record
from topokit.data._folder import write_json
from topokit.io import state_arrays

from small_datasets import OPTIONS, SEED, TINY, contents, labelled

EPISODES = 8


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A dataset with two sets of labels; not to be changed."""
    return labelled(tmp_path_factory.mktemp("made") / "data", EPISODES)


@pytest.fixture
def copy(made, tmp_path):
    return shutil.copytree(made, tmp_path / "copy")


def test_what_a_dataset_says_of_itself(made):
    dataset = Dataset(made)
    assert (dataset.config, dataset.seed) == (TINY, SEED)
    assert len(dataset) == EPISODES == len(dataset.records)
    assert dataset.counts == {"ok": EPISODES}
    assert dataset.garments == ("mask", "sheet", "sheet2")
    assert dataset.failures == ()
    assert dataset.label_names == ("full", "observed-40")
    assert [episode.seed for episode in dataset] == [record.seed for record in dataset.records]
    assert dataset.record(2).physics == dataset[2].physics
    assert dataset.record(2).frames == len(dataset[2]) == 20
    with pytest.raises(KeyError, match=f"no episode {EPISODES}"):
        dataset[EPISODES]
    with pytest.raises(FileNotFoundError, match=r"'none'; it has full, observed-40"):
        dataset.labels("none")
    with pytest.raises(FileNotFoundError, match="there is no dataset"):
        Dataset(made.parent)


# -- labels -----------------------------------------------------------------------------------------------------------------


def test_labels_are_the_states_of_the_stored_clouds(made):
    """And their loops find their cycles: by persistence of the stored cloud, the ones that the tracker would name."""
    dataset, cycles = Dataset(made), 0
    for name, cloud in (("full", lambda e: e.points), ("observed-40", lambda e: e.observed[:, :40])):
        for i in (0, 4):
            episode = dataset[i]
            states = track(cloud(episode), times=episode.times, **OPTIONS)
            found = pickle.loads(pickle.dumps(dataset.states(i, name)))
            ids = [[loop.id for loop in state.loops] for state in found]
            assert ids == [[loop.id for loop in state.loops][:8] for state in states]
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
                    lengths = [[loop.birth, loop.death, loop.killer_shift] for loop in (a, b)]
                    np.testing.assert_allclose(*lengths, rtol=1e-6)
                    np.testing.assert_allclose(a.neighbour_values, b.neighbour_values, rtol=1e-6)
                    if one.frame % 5 == 0:
                        cycles += 1
                        assert a.cycle.tolist() == b.cycle.tolist()
                        np.testing.assert_array_equal(a.cycle_points, cloud(episode)[one.frame][a.cycle])
    assert cycles > 4


def test_loops_without_a_slot_are_counted(made):
    episode = Dataset(made)[0]
    states = track(episode.points, alpha=0.0)  # also what is noise
    assert max(len(state) for state in states) > 2
    stored = state_arrays(states, 2)
    assert [int(n) for n in stored["parameters"][:, 3]] == [max(0, len(state) - 2) for state in states]
    assert stored["id"][0].tolist() == [loop.id for loop in states[0].loops[:2]]  # the longest-lived ones


def test_labels_go_on_and_refuse_other_options(copy, made):
    whole = (copy / "labels/full/00000004.npz").read_bytes()
    (copy / "labels/full/00000004.npz").unlink()
    labels = label_dataset(copy, options=OPTIONS, progress=False)
    assert (copy / "labels/full/00000004.npz").read_bytes() == whole
    assert labels.checksum() == Dataset(made).labels("full").checksum()
    refused = [
        ({"options": {**OPTIONS, "memory": 0}}, r"options\.memory = 40.*= 0"),
        ({"observation": "nothing"}, "observation"),
        ({"observation": "observed", "n_points": 3}, "n_points"),
        ({"observation": "observed", "options": {"match": dict}}, "not JSON serializable"),
    ]
    for options, says in refused:
        with pytest.raises((TypeError, ValueError), match=says):
            label_dataset(copy, progress=False, **options)


def test_labels_that_are_stopped_leave_whole_files_and_go_on(copy, monkeypatch):
    """Ctrl-C comes while the second of two episodes is tracked: the first is kept, and nothing is half written."""
    whole = contents(copy / "labels/full")
    for number in (4, 5):
        (copy / f"labels/full/{number:08d}.npz").unlink()
    real = _label.track
    calls = []

    def stopped_at_the_second(*arguments, **options):
        calls.append(arguments)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return real(*arguments, **options)

    monkeypatch.setattr(_label, "track", stopped_at_the_second)
    with pytest.raises(KeyboardInterrupt):
        label_dataset(copy, options=OPTIONS, progress=False)
    left = contents(copy / "labels/full")
    assert left == {name: content for name, content in whole.items() if name != "00000005.npz"}
    label_dataset(copy, options=OPTIONS, progress=False)
    assert contents(copy / "labels/full") == whole


# -- damage -----------------------------------------------------------------------------------------------------------------


def flip(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def relabel(folder, change):
    path = folder / "labels/full/00000002.npz"
    header, arrays = load_archive(path, LABELS_KIND)
    change(header, arrays)
    save_archive(path, LABELS_KIND, header, arrays)


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda f: flip(f / "00000002.npz"), r"00000002\.npz"),
        (lambda f: shutil.copy(f / "labels/full/00000002.npz", f / "00000002.npz"), "topokit-labels"),
        (lambda f: flip(f / "labels/full/00000002.npz"), r"full.00000002\.npz"),
        (lambda f: relabel(f, lambda h, a: a.pop("id")), "id"),
        (lambda f: relabel(f, lambda h, a: np.copyto(a["simplices"], 60_000)), "names point 60000"),
        (lambda f: relabel(f, lambda h, a: a.update({k: v[:9] for k, v in a.items()})), "9 frames"),
        (lambda f: (f / "labels/full/labels.json").write_text("x"), r"labels\.json"),
        (lambda f: (f / "dataset.json").write_text('{"schema": 1}'), r"dataset\.json"),
    ],
)
def test_damage_is_refused_by_every_reader(copy, damage, says):
    damage(copy)
    with pytest.raises(ValueError, match=says):
        Dataset(copy).states(2, "full")


# -- splits -----------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def many(tmp_path_factory):
    """A dataset of 2,000 numbers, of 21 tasks, without episodes."""
    return without_episodes(tmp_path_factory.mktemp("many"), 2000)


def without_episodes(folder, n):
    config = DatasetConfig()
    about = {"schema": 2, "config": config.to_json(), "seed": 0, "episodes": n, "versions": {}}
    write_json(folder / "dataset.json", about)
    dataset = Dataset(folder)
    dataset.episodes = np.arange(n)
    for i in range(n):
        garment, _, target = config.draw(0, i)[0].partition("-")
        dataset._records[i] = Record(episode=i, status="ok", garment=garment, target=target)
    return dataset


def test_splits_are_parts_and_do_not_change(many, tmp_path):
    parts = many.split(seed=1)
    assert list(parts) == ["train", "validation", "test"]
    assert (np.sort(np.concatenate(list(parts.values()))) == many.episodes).all()
    assert all((parts[name] == again).all() for name, again in many.split(seed=1).items())
    assert all(len(part) for part in parts.values())
    assert any(len(parts[name]) != len(part) for name, part in many.split(seed=2).items())
    assert abs(len(parts["train"]) / 2000 - 0.8) < 0.04
    small = without_episodes(tmp_path, 500).split(seed=1)  # what was there before it grew stays in its part
    assert all((small[name] == part[part < 500]).all() for name, part in parts.items())
    shares = {"test": 0.1, "validation": 0.1, "train": 0.8}
    assert all((parts[name] == part).all() for name, part in many.split(shares, seed=1).items())


def test_parts_have_nothing_to_do_with_what_was_drawn(many):
    """The draw that gives a part is not the one that gave the task: every garment has its share of the test part."""
    test = many.split(shares={"train": 0.5, "test": 0.5})["test"]
    for garment in many.garments:
        own = [i for i in range(2000) if many.record(i).garment == garment]
        assert abs(np.isin(own, test).mean() - 0.5) < 4 * np.sqrt(0.25 / len(own))


def garments_of(dataset, part):
    return {dataset.record(i).garment for i in part}


def test_a_split_by_episode_may_hold_garments_out(many):
    """Training and validation know the same garments, and every other episode keeps the part it would have had."""
    bags = {"tote", "tote2"}
    without, whole = many.split(held_out=sorted(bags)), many.split()
    worn = {name: garments_of(many, part) for name, part in without.items()}
    assert worn["train"] == worn["validation"] == set(many.garments) - bags
    for name in ("train", "validation"):
        assert without[name].tolist() == [i for i in whole[name].tolist() if many.record(i).garment not in bags]
    assert len(np.concatenate(list(without.values()))) == 2000


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"shares": {"train": 1, "test": 0}}, "share"),
        ({"shares": {"train": 1}}, "share"),
        ({"held_out": ["kilt"]}, "kilt"),
    ],
)
def test_a_wrong_split_is_refused(many, options, says):
    with pytest.raises(ValueError, match=says):
        many.split(**options)
