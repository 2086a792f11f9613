"""Windows hold what the episode and its labels hold, in fixed slots."""

from __future__ import annotations

import copy
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from topokit.data import Dataset, WindowDataset, generate, label
from topokit.data._label import TRACKER
from topokit.data._windows import _Episode

from small_datasets import SEED, TINY, without_dask

H, K = 4, 6


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("windows") / "data"
    with without_dask():
        generate(TINY, folder, 6, SEED, progress=False)
        label(folder, options={**TRACKER, "alpha": 0.003}, progress=False)
        label(folder, "observed", n_points=40, options={**TRACKER, "alpha": 0.003}, progress=False)
    return Dataset(folder)


@pytest.fixture(scope="module")
def windows(dataset):
    return WindowDataset(dataset, history=H, horizon=K, n_points=30, slots=3)


def test_there_is_a_window_for_every_frame_that_has_a_past_and_a_future(dataset, windows):
    assert len(windows) == 6 * (20 - H - K + 1)
    assert windows.index[:12].tolist() == [[0, t] for t in range(H - 1, 20 - K)] + [[1, H - 1]]
    assert len(WindowDataset(dataset, history=H, horizon=K, stride=4)) == 6 * 3
    assert WindowDataset(dataset, [4, 2], history=H, horizon=K).episodes.tolist() == [2, 4]
    assert len(WindowDataset(dataset, history=4, horizon=16)) == 6  # of the very length of an episode


@pytest.mark.parametrize("i", [0, 10, 25, 65])
def test_a_window_is_a_piece_of_its_episode(dataset, windows, i):
    window = windows[i]
    number, t = windows.index[i]
    episode = dataset[int(number)]
    past, future = slice(t - H + 1, t + 1), slice(t + 1, t + K + 1)
    np.testing.assert_allclose(window["clouds"], episode.observed[past, :30], atol=1e-6)
    np.testing.assert_allclose(window["grippers"], episode.grippers[past], atol=1e-6)
    np.testing.assert_allclose(window["actions"], episode.actions[future], atol=1e-6)
    assert (window["held"].numpy() == episode.held[past]).all()
    assert (window["actions_held"].numpy() == episode.held[future]).all()
    assert (window["episode"], window["frame"]) == (number, t)
    assert dataset.garments[window["garment"]] == episode.garment
    assert all(value.dtype in (torch.float32, torch.bool, torch.int64) for value in window.values())


@pytest.mark.parametrize("name", ["full", "observed-40"])
def test_slots_are_identities_and_hold_the_states(dataset, name):
    windows = WindowDataset(dataset, labels=name, history=H, horizon=K, n_points=30, slots=3)
    seen = 0
    for i in range(0, len(windows), 3):
        window = windows[i]
        number, t = (int(n) for n in windows.index[i])
        states = dataset.states(number, name)
        past, future = states[t - H + 1 : t + 1], states[t + 1 : t + K + 1]
        order = expected_order(past, future)[:3]
        for span, prefix in ((past, "past_"), (future, "")):
            part = {
                key: window[prefix + key].numpy()
                for key in ("triangles", "values", "birth", "death", "step", "present")
            }
            for frame, state in enumerate(span):
                loops = {loop.id: loop for loop in state.loops}
                for slot in range(3):
                    loop = loops.get(order[slot]) if slot < len(order) else None
                    assert part["present"][frame, slot] == (loop is not None)
                    if loop is None:
                        assert not any(part[key][frame, slot].any() for key in part)
                        continue
                    seen += 1
                    same_loop({key: part[key][frame, slot] for key in part}, loop)
    assert seen > 100


def expected_order(past, future):
    """By the definition, slowly."""
    total = {}
    for state in past:
        for loop in state.loops:
            total[loop.id] = total.get(loop.id, 0.0) + loop.lifetime
    order = sorted(total, key=lambda i: -total[i])
    return order + list(dict.fromkeys(loop.id for state in future for loop in state.loops if loop.id not in total))


def same_loop(part, loop):
    m = len(loop.neighbours)
    filled = [*loop.killer_triangles, *loop.neighbours, *[loop.killer_triangles[0]] * (4 - m)]
    np.testing.assert_allclose(part["triangles"], filled, atol=1e-6)
    values = [loop.death, loop.death, *loop.neighbour_values, *[0] * (4 - m)]
    np.testing.assert_allclose(part["values"], values, rtol=1e-6)
    np.testing.assert_allclose(part["birth"], loop.birth, rtol=1e-6)
    np.testing.assert_allclose(part["death"], loop.death, rtol=1e-6)
    np.testing.assert_allclose(part["step"], 0 if np.isnan(loop.step) else loop.step, rtol=1e-6)


def test_who_gets_a_slot():
    """The longest mean lifetime in the history first, then those that come, in their order; who is gone before has none."""
    ids = np.full((8, 3), -1, dtype=np.int32)
    ids[0] = [9, -1, -1]  # before the history
    ids[1] = [5, 7, -1]
    ids[2] = [5, -1, -1]
    ids[3] = [7, 5, -1]
    ids[4] = [7, 2, -1]  # the future
    ids[5] = [3, 2, 9]
    numbers = np.zeros((8, 3, 3), dtype=np.float32)
    numbers[..., 1] = [1.0, 0.5, 0.25]
    numbers[3, 0, 1] = 9.0  # 7 lives longer at frame 3 than 5 in three frames
    tracked = SimpleNamespace(ids=ids, numbers=numbers)

    def order(slots):
        return WindowDataset._identities(SimpleNamespace(slots=slots), tracked, slice(1, 4), slice(4, 8)).tolist()

    assert order(6) == [7, 5, 2, 3, 9, -2]
    assert order(3) == [7, 5, 2]
    assert order(1) == [7]


def test_what_was_seen_besides_is_the_history_of_the_other_labels(dataset, windows):
    both = WindowDataset(dataset, history=H, horizon=K, n_points=30, slots=3, seen_labels="observed-40")
    other = WindowDataset(dataset, history=H, horizon=K, n_points=30, slots=3, labels="observed-40")
    assert sum(int(both[i]["seen_present"].sum()) for i in range(0, len(both), 7)) > 0
    for i in range(0, len(both), 7):
        window = both[i]
        assert all(torch.equal(part, window[name]) for name, part in windows[i].items())
        alive = other[i]["past_present"].any(dim=0)
        for name in ("triangles", "values", "birth", "death", "step", "present"):
            assert torch.equal(window[f"seen_{name}"][:, alive], other[i][f"past_{name}"][:, alive])
            assert not window[f"seen_{name}"][:, ~alive].any()
    with pytest.raises(FileNotFoundError, match="camera"):
        WindowDataset(dataset, history=H, horizon=K, seen_labels="camera")


def test_truth_is_the_true_loops(dataset, windows):
    truth = windows.truth(25)
    number, t = windows.index[25]
    episode = dataset[int(number)]
    assert len(truth.loops) == len(episode.loops)
    for found, before, loop in zip(truth.loops, truth.past_loops, episode.loops, strict=True):
        assert (found == episode.points[t + 1 : t + K + 1, loop]).all()
        assert (before == episode.points[t - H + 1 : t + 1, loop]).all()
    assert (truth.task, truth.success) == (episode.task, episode.success)


def test_clouds_with_fewer_points_are_repeated(dataset):
    window = WindowDataset(dataset, history=H, horizon=K, n_points=100)[0]
    assert window["clouds"].shape == (H, 100, 3)
    assert (window["clouds"][:, 48:96] == window["clouds"][:, :48]).all()


def test_batches(windows):
    loader = torch.utils.data.DataLoader(windows, batch_size=16, num_workers=0)
    batch = next(iter(loader))
    assert batch["triangles"].shape == (16, K, 3, 6, 3, 3)
    assert (batch["clouds"][3] == windows[3]["clouds"]).all()
    assert torch.isfinite(batch["triangles"]).all()


def test_what_is_kept_does_not_grow(dataset, windows):
    one = windows._decode(0).nbytes
    small = WindowDataset(dataset, history=H, horizon=K, n_points=30, slots=3, memory=2.5 * one)
    for i in (0, 30, 60, 0, 65):
        assert (small[i]["clouds"] == windows[i]["clouds"]).all()
        assert small._bytes == sum(episode.nbytes for episode in small._kept.values()) <= 2.5 * one
    assert isinstance(next(iter(small._kept.values())), _Episode)
    assert len(WindowDataset(dataset, history=H, horizon=K).load()._kept) == 6


def test_it_travels_to_spawned_processes_without_its_episodes(windows):
    windows.load()
    again = copy.copy(windows)  # of the state that is sent to them
    assert len(again._kept) == 0
    assert (again[7]["clouds"] == windows[7]["clouds"]).all()


def test_parts_share_no_episode(dataset):
    parts = [
        WindowDataset(dataset, part, history=H, horizon=K)
        for part in dataset.split(shares={"train": 1, "test": 1}).values()
    ]
    episodes = [set(part.index[:, 0].tolist()) for part in parts]
    assert not episodes[0] & episodes[1]
    assert sum(map(len, parts)) == len(WindowDataset(dataset, history=H, horizon=K))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"horizon": 60}, "no episode has the 64 frames of a window"),
        ({"slots": 0}, "slots must be a whole number, at least 1"),
        ({"episodes": [0, 77]}, "1 episodes have no labels 'full', the first is 77"),
    ],
)
def test_what_cannot_be_is_refused(dataset, options, says):
    with pytest.raises(ValueError, match=says):
        WindowDataset(dataset, **{"history": H, "horizon": K, **options})
