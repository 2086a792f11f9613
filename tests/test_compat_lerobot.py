"""Episodes as a dataset of LeRobot, read back by pandas and by topokit, and datasets that others wrote."""

from __future__ import annotations

import dataclasses
import json
import sys

import numpy as np
import pandas as pd
import pytest
from test_io import small_episode

pytest.importorskip("pyarrow")

import pyarrow as pa
from pyarrow import parquet

from topokit import track
from topokit._archive import FREE, RATIO
from topokit.compat import from_lerobot, to_lerobot
from topokit.io import FormatError, load_episode

from conftest import DATA


@pytest.fixture
def film():
    return small_episode()


@pytest.fixture
def folder(tmp_path, film):
    other = dataclasses.replace(
        film, observed=film.observed[:, :7] + np.float32(1), garment="tote", success=not film.success
    )
    return to_lerobot(tmp_path / "set", iter([film, other, film]), n_points=film.observed.shape[1])


def frames(folder, number):
    return pd.read_parquet(folder / f"data/chunk-000/file-{number:03d}.parquet")


def test_nothing_of_an_episode_is_lost(folder, film):
    table, n = frames(folder, 0), len(film)
    np.testing.assert_array_equal(np.array([np.stack(one) for one in table["observation.pointcloud"]]), film.observed)
    state, action = (np.stack(table[name]) for name in ("observation.state", "action"))
    assert state.dtype == action.dtype == np.float32
    np.testing.assert_array_equal(state[:, :6].reshape(n, 2, 3), film.grippers)
    np.testing.assert_array_equal(state[:, 6], film.held)
    told = np.append(np.arange(1, n), n - 1)  # what is told in a frame is where to be in the next
    np.testing.assert_array_equal(action[:, :6].reshape(n, 2, 3), film.actions[told])
    np.testing.assert_array_equal(action[:, 6], film.held[told])
    np.testing.assert_array_equal(table["timestamp"], film.times.astype(np.float32))
    assert table["next.done"].tolist() == [False] * (n - 1) + [True]
    assert [frames(folder, i)["next.success"].iloc[-1] for i in (0, 1)] == [film.success, not film.success]


def test_the_metadata_say_what_the_frames_hold(folder, film):
    info, stats = (json.loads((folder / f"meta/{name}.json").read_text()) for name in ("info", "stats"))
    n = len(film)
    whole = pd.concat([frames(folder, i) for i in range(3)])
    assert (info["codebase_version"], info["total_episodes"], info["total_frames"]) == ("v3.0", 3, 3 * n)
    assert info["fps"] == pytest.approx(1 / film.dt)
    assert set(info["features"]) == set(whole.columns)
    for name, told in info["features"].items():
        first = np.array(whole[name].iloc[0].tolist() if told["shape"] != [1] else [whole[name].iloc[0]])
        assert list(np.stack(first).shape) == told["shape"], name
    assert whole["index"].tolist() == list(range(3 * n))
    assert whole["frame_index"].tolist() == 3 * list(range(n))
    rows = pd.read_parquet(folder / "meta/episodes/chunk-000/file-000.parquet")
    tasks = pd.read_parquet(folder / "meta/tasks.parquet")
    for row in rows.to_dict("records"):
        path = info["data_path"].format(chunk_index=row["data/chunk_index"], file_index=row["data/file_index"])
        part = pd.read_parquet(folder / path)
        assert set(part["episode_index"]) == {row["episode_index"]}
        assert (part["index"].min(), part["index"].max() + 1) == (row["dataset_from_index"], row["dataset_to_index"])
        assert set(part["task_index"]) == {tasks.loc[row["tasks"][0]].task_index}
    assert tasks.index.tolist() == [f"Hang the {one} on the {film.target}." for one in (film.garment, "tote")]
    for name in ("observation.state", "action"):
        np.testing.assert_allclose(stats[name]["std"], np.stack(whole[name]).astype(float).std(axis=0))
        assert stats[name]["count"] == [3 * n]


def test_clouds_come_back_and_are_tracked(folder, film):
    for number, expected in ((0, film.observed), (1, film.observed[:, :7] + np.float32(1))):
        clouds, times = from_lerobot(folder, number)
        np.testing.assert_array_equal(np.array(clouds)[:, : expected.shape[1]], expected)
        np.testing.assert_array_equal(times, film.times.astype(np.float32))
    padded = from_lerobot(folder, 1)[0][0]
    np.testing.assert_array_equal(padded[7:], padded[np.arange(7, len(padded)) % 7])


def test_points_that_come_twice_change_no_loop(tmp_path):
    film = load_episode(DATA / "apron_hook_0.npz")
    cut = dataclasses.replace(
        film, **{name: getattr(film, name)[:3] for name in ("points", "observed", "actions", "grippers", "held")}
    )
    clouds, times = from_lerobot(to_lerobot(tmp_path / "set", [cut], n_points=620))
    known, found = (track(some, times=times) for some in (cut.observed, clouds))
    for one, other in zip(known, found, strict=True):
        assert [(loop.id, loop.birth, loop.death) for loop in one.loops] == [
            (loop.id, loop.birth, loop.death) for loop in other.loops
        ]
        assert len(one) > 0


def test_what_is_no_dataset_is_not_written(tmp_path, film):
    slow = dataclasses.replace(film, dt=2 * film.dt)
    fewer = dataclasses.replace(film, observed=film.observed[:, :5])
    n = film.observed.shape[1]
    refused = {
        r"episodes\[1\] has .* s a frame, those before it": ([film, slow], {}),
        rf"episodes\[1\] has 5 points, not {n}: give the most of any as n_points": ([film, fewer], {}),
        rf"episodes\[0\] has {n} points, not 5": ([film], {"n_points": 5}),
        "the number of episodes must be 1 or more": ([], {}),
        "n_points must be 1 or more": ([film], {"n_points": -1}),
    }
    for says, (episodes, how) in refused.items():
        with pytest.raises(ValueError, match=says):
            to_lerobot(tmp_path / "set", episodes, **how)
        assert list(tmp_path.iterdir()) == []
    to_lerobot(tmp_path / "set", [film])
    with pytest.raises(FileExistsError, match="there already"):
        to_lerobot(tmp_path / "set", [film])


# -- what others wrote ------------------------------------------------------------------------------------------------------


def others(folder, rows, *, name="data/chunk-000/file-000.parquet"):
    """A dataset of a cloud a frame."""
    (folder / "meta").mkdir(parents=True, exist_ok=True)
    (folder / "meta/info.json").write_text("{}")
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    parquet.write_table(pa.table(rows or {"nothing": [0]}), folder / name)
    return folder


def rows_of(clouds, episodes, frame_numbers):
    return {
        "observation.pointcloud": [list(map(list, np.asarray(cloud, np.float32))) for cloud in clouds],
        "timestamp": pa.array(np.array(frame_numbers) / 10, pa.float32()),
        "frame_index": frame_numbers,
        "episode_index": episodes,
    }


CLOUDS = np.random.default_rng(0).normal(size=(5, 4, 6)).astype(np.float32)


def test_colours_are_left_out_and_frames_are_put_in_order(tmp_path):
    others(tmp_path, rows_of(CLOUDS, [0, 1, 1, 1, 2], [0, 2, 0, 1, 0]))
    clouds, times = from_lerobot(tmp_path, 1, columns=(0, 1, 2))
    np.testing.assert_array_equal(clouds, CLOUDS[[2, 3, 1], :, :3])
    assert times == pytest.approx([0, 0.1, 0.2])
    with pytest.raises(FormatError, match="6 numbers a point, and a place has three: say which"):
        from_lerobot(tmp_path, 1)


def test_version_2_1_and_clouds_of_as_many_points_as_they_have(tmp_path):
    for number in (0, 7):
        clouds = [CLOUDS[0, : 2 + t, :3] + number for t in range(3)]
        others(tmp_path, rows_of(clouds, [number] * 3, [0, 1, 2]), name=f"data/chunk-000/episode_{number:06d}.parquet")
    found = from_lerobot(tmp_path, 7)[0]
    assert [len(cloud) for cloud in found] == [2, 3, 4]
    np.testing.assert_array_equal(found[2], (CLOUDS[0, :, :3] + 7).astype(np.float32))


def test_what_is_no_dataset_is_refused_by_name(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"info\.json: there is no such file"):
        from_lerobot(tmp_path)
    good = rows_of(CLOUDS[:2, :, :3], [0, 0], [0, 1])
    path = others(tmp_path, good) / "data/chunk-000/file-000.parquet"
    for episode, says in (
        (3, "no file of data holds episode 3"),
        (-1, "episode must be 0 or more"),
        ("a", "whole number"),
    ):
        with pytest.raises(ValueError, match=says):
            from_lerobot(tmp_path, episode)

    def without(column):
        return {name: some for name, some in good.items() if name != column}

    changed = {
        "must be an array of numbers": {**good, "observation.pointcloud": [[[1.0, 2, 3], [4.0, 5]], [[1.0, 2, 3]]]},
        "must hold real numbers, not": {**good, "observation.pointcloud": [[[1.0, None, 3]], [[1.0, 2, 3]]]},
        "it is of shape": {**good, "observation.pointcloud": [[1.0, 2, 3], [4.0, 5, 6]]},
        "it has no column timestamp": without("timestamp"),
        "it has no column observation.pointcloud": without("observation.pointcloud") | {"other": [1, 2]},
    }
    for says, rows in changed.items():
        others(tmp_path, rows)
        with pytest.raises(FormatError, match=rf"file-000\.parquet: .*{says}"):
            from_lerobot(tmp_path)
    others(tmp_path, good)
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(FormatError, match=r"file-000\.parquet: "):
        from_lerobot(tmp_path)


def test_a_small_file_that_claims_to_hold_much_is_not_unpacked(tmp_path):
    """One number, again and again: a few bytes."""
    n = (FREE + RATIO * 10**6) // 8
    zeros = pa.ListArray.from_arrays(pa.array([0, n], pa.int32()), pa.array(np.zeros(n, np.float32)))
    good = rows_of(CLOUDS[:1, :, :3], [0], [0])
    path = others(tmp_path, {**good, "other": zeros}) / "data/chunk-000/file-000.parquet"
    assert path.stat().st_size < 10**6
    with pytest.raises(FormatError, match=r"bytes claim to hold"):
        from_lerobot(tmp_path)


def test_without_pyarrow_it_is_named(tmp_path, film, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    for work in (lambda: to_lerobot(tmp_path / "other", [film]), lambda: from_lerobot(others(tmp_path, None))):
        with pytest.raises(ImportError, match=r"needs pyarrow: pip install 'topokit\[pyarrow\]'"):
            work()
    assert not (tmp_path / "other").exists()
