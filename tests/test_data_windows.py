"""Windows hold what the episode and its labels hold, in fixed slots."""

from __future__ import annotations

import dataclasses
import pickle

import numpy as np
import pytest
import torch

from topokit import track
from topokit.data import Dataset, WindowDataset
from topokit.io import save_episode
from topokit.sampling import farthest_point_sample

from conftest import polygon
from small_datasets import labelled, part_of

H, K = 4, 6
SIZES = ("history", "horizon", "n_points", "slots", "stride")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return Dataset(labelled(tmp_path_factory.mktemp("windows") / "data", 6))


@pytest.fixture(scope="module")
def windows(dataset):
    return WindowDataset(dataset, history=H, horizon=K, n_points=30, slots=3)


def test_there_is_a_window_for_every_frame_that_has_a_past_and_a_future(dataset, windows):
    assert len(windows) == 6 * (20 - H - K + 1)
    assert windows.index[:12].tolist() == [[0, t] for t in range(H - 1, 20 - K)] + [[1, H - 1]]
    assert WindowDataset(dataset, [3], history=H, horizon=K, stride=4).index.tolist() == [[3, 3], [3, 7], [3, 11]]
    assert WindowDataset(dataset, [3], history=H, horizon=8, stride=4).index.tolist() == [[3, 3], [3, 7], [3, 11]]
    assert WindowDataset(dataset, [3], history=H, horizon=9, stride=4).index.tolist() == [[3, 3], [3, 7]]
    assert windows.index.dtype == np.int64
    assert repr(windows) == "WindowDataset(66 windows of 6 episodes, labels 'full')"
    assert WindowDataset(dataset, [4, 2], history=H, horizon=K).episodes.tolist() == [2, 4]
    assert len(WindowDataset(dataset, history=4, horizon=16)) == 6  # of the very length of an episode


@pytest.mark.parametrize("i", [0, 10, 25, 65])
def test_a_window_is_a_piece_of_its_episode(dataset, windows, i):
    window = windows[i]
    number, t = windows.index[i]
    episode = dataset[int(number)]
    past, future = slice(t - H + 1, t + 1), slice(t + 1, t + K + 1)
    np.testing.assert_allclose(window["clouds"], resampled(episode.observed[past], 30), atol=1e-6)
    np.testing.assert_allclose(window["grippers"], episode.grippers[past], atol=1e-6)
    np.testing.assert_allclose(window["actions"], episode.actions[future], atol=1e-6)
    assert (window["held"].numpy() == episode.held[past]).all()
    assert (window["actions_held"].numpy() == episode.held[future]).all()
    assert (window["episode"], window["frame"]) == (number, t)
    assert dataset.garments[window["garment"]] == episode.garment
    assert all(value.dtype in (torch.float32, torch.bool, torch.int64) for value in window.values())


def resampled(clouds, n):
    whole = np.rint(10_000 * clouds)  # as they are stored: else ties fall otherwise
    return np.array([c[farthest_point_sample(w, n, None)[0]] for c, w in zip(clouds, whole, strict=True)])


def test_the_order_of_the_mesh_says_nothing(dataset, tmp_path):
    """Whichever vertex is the first: the same points in the same order."""
    mixed = part_of(dataset, [0], tmp_path / "mixed")
    episode = dataset[0]
    order = np.random.default_rng(0).permutation(episode.observed.shape[1])
    save_episode(mixed.path_of(0), dataclasses.replace(episode, observed=episode.observed[:, order]))
    options = {"episodes": [0], "history": H, "horizon": K, "n_points": 30}
    one, other = (WindowDataset(d, **options)[5]["clouds"] for d in (dataset, mixed))
    assert one.equal(other)


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
                for key in ("triangles", "values", "birth", "death", "killer_shift", "present")
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
    np.testing.assert_allclose(part["killer_shift"], 0 if np.isnan(loop.killer_shift) else loop.killer_shift, rtol=1e-6)


def test_what_is_seen_is_in_metres(dataset, windows):
    number = int(windows.episodes[0])
    clouds, target = windows.seen(number)
    episode = dataset[number]
    assert np.allclose(clouds, episode.points, atol=1e-6)
    assert np.allclose(target, episode.centre_line, atol=1e-6)

    def shifted(_, clouds):
        return clouds[:, ::2] + 0.5

    windows_seen = WindowDataset(dataset, [number], history=H, horizon=K, observe=shifted)
    expected = resampled(episode.observed, min(windows_seen.n_points, episode.observed.shape[1]))[:, ::2] + 0.5
    assert np.allclose(windows_seen.seen(number)[0], expected, atol=1e-4)


def test_true_loops_are_those_of_the_episode(dataset, windows):
    number, t = windows.index[25]
    episode = dataset[int(number)]
    found = windows.true_loops(25)
    assert len(found) == len(episode.loops) > 0
    for curve, loop in zip(found, episode.loops, strict=True):
        assert (curve == episode.points[t + 1 : t + K + 1, loop]).all()


def test_clouds_with_fewer_points_are_repeated(dataset):
    window = WindowDataset(dataset, history=H, horizon=K, n_points=100)[0]
    assert window["clouds"].shape == (H, 100, 3)
    assert (window["clouds"][:, 48:96] == window["clouds"][:, :48]).all()
    assert (window["clouds"][:, 96:] == window["clouds"][:, :4]).all()


def test_what_is_observed_takes_the_place_of_the_clouds_and_is_tracked(dataset):
    """Whatever hangs there, a ring of twelve points is seen, and moves by a millimetre a frame."""
    radius, given = np.linspace(0.1, 0.11, 12)[:, None], {}
    ring = np.column_stack([radius * polygon(12), np.zeros(12)])

    def observe(number, clouds):
        given[number] = clouds
        return ring + np.arange(len(clouds))[:, None, None] * [0.001, 0, 0]

    options = {"history": H, "horizon": K, "n_points": 30, "slots": 3}
    window = WindowDataset(dataset, [2, 4], observe=observe, **options)[12]  # the second of episode 4, t = 4
    plain = WindowDataset(dataset, [2, 4], **options)[12]
    assert list(given) == [4]
    assert given[4].dtype == np.float64
    np.testing.assert_allclose(given[4], resampled(dataset[4].observed, 30), atol=1e-6)
    np.testing.assert_allclose(window["clouds"][0, :12], ring + [0.001, 0, 0], atol=1e-4)
    assert (window["clouds"][:, 12:] == window["clouds"][:, [*range(12), *range(6)]]).all()
    assert all(window[name].equal(plain[name]) for name in ("grippers", "actions", "held", "episode", "frame"))
    (state,) = track([ring])
    for prefix in ("past_", ""):
        assert window[f"{prefix}present"].all(dim=0).tolist() == [True, False, False]
        np.testing.assert_allclose(window[f"{prefix}death"][:, 0], state.loops[0].death, atol=1e-4)
        assert not window[f"{prefix}death"][:, 1:].any()
    assert window["past_killer_shift"][0, 0] == pytest.approx(0.001, abs=1e-4)  # tracked from the first frame on
    with pytest.raises(ValueError, match="no labels 'full'"):
        WindowDataset(dataset, [77], observe=observe, **options)


def test_a_selection_is_some_of_the_windows(dataset, windows):
    some = windows.select([40, 3, 3])
    assert len(some) == 3
    assert some.index.tolist() == windows.index[[40, 3, 3]].tolist()
    assert some.episodes.tolist() == [0, 3]
    for i, row in enumerate((40, 3, 3)):
        assert all(torch.equal(part, windows[row][name]) for name, part in some[i].items())
    assert len(windows) == 66


def test_what_is_done_to_a_window_does_not_reach_the_next(windows):
    before = {name: part.clone() for name, part in windows[7].items()}
    for part in windows[7].values():
        part.add_(1) if part.dtype != torch.bool else part.logical_not_()
    assert all(torch.equal(part, before[name]) for name, part in windows[7].items())


def test_it_travels_to_spawned_processes_without_its_episodes(windows):
    windows.load()
    message = pickle.dumps(windows)
    assert len(message) < 100_000
    assert (pickle.loads(message)[7]["clouds"] == windows[7]["clouds"]).all()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"horizon": 60}, r"no episode has the 64 frames of a window \(of 6 episodes\)"),
        ({"history": 15}, r"no episode has the 21 frames of a window \(of 6 episodes\)"),
        ({"episodes": []}, r"no episode has the 10 frames of a window \(of 0 episodes\)"),
        *(({name: 0}, f"{name} must be 1 or more, a whole number, not 0") for name in SIZES),
        ({"stride": True}, "stride must be a whole number, not True"),
        ({"history": 4.5}, "history must be 1 or more, a whole number, not 4.5"),
        ({"episodes": [0, 77, 78]}, "2 episodes have no labels 'full', the first is 77"),
    ],
)
def test_what_cannot_be_is_refused(dataset, options, says):
    with pytest.raises(ValueError, match=says):
        WindowDataset(dataset, **{"history": H, "horizon": K, **options})


def test_episodes_without_these_labels_are_refused(dataset, tmp_path):
    few = part_of(dataset, [0, 1], tmp_path / "few")
    (few.folder / "labels/observed-40/00000001.npz").unlink()
    options = {"history": H, "horizon": K, "labels": "observed-40"}
    with pytest.raises(ValueError, match="'observed-40', the first is 1"):
        WindowDataset(few.folder, [0, 1], **options)
    assert WindowDataset(few.folder, **options).episodes.tolist() == [0]
