"""Clouds of files, each kind written by another library, and the steps that clean them."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh
from PIL import Image
from sensor_files import ring

from topokit._archive import FormatError
from topokit.io import load_episode
from topokit.sensors import Cleaner, read_clouds

from conftest import DATA

LENS = {"fx": 30.0, "fy": 40.0, "cx": 20.0, "cy": 15.0}


def clouds(path, **options):
    return [cloud for _, cloud in read_clouds(path, **options)]


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_ply_with_colours(encoding, tmp_path):
    cloud = trimesh.PointCloud(ring(), colors=np.full((60, 4), 200, np.uint8))
    path = tmp_path / "ring.ply"
    path.write_bytes(trimesh.exchange.ply.export_ply(cloud, encoding=encoding))
    np.testing.assert_allclose(clouds(path, scale=0.5)[0], ring() / 2, atol=1e-6)
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(FormatError, match=r"ring\.ply"):
        clouds(path)


@pytest.mark.parametrize(
    ("shape", "layout", "frames"),
    [((60, 3), None, 1), ((2, 30, 3), "film", 2), ((2, 30, 3), "organised", 1), ((2, 5, 6, 3), None, 2)],
)
@pytest.mark.parametrize("suffix", [".npy", ".npz"])
def test_arrays(shape, layout, frames, suffix, tmp_path):
    points = ring().reshape(shape)
    path = tmp_path / f"film{suffix}"
    np.save(path, points) if suffix == ".npy" else np.savez(path, clouds=points)
    found = clouds(path, layout=layout)
    np.testing.assert_array_equal(found, points.reshape(frames, -1, 3))


def test_times_of_an_archive_and_frames_a_second(tmp_path):
    path = tmp_path / "film.npz"
    np.savez(path, points=[ring(), ring(1)], times=[0.5, 0.75], colours=np.zeros(4))
    assert [time for time, _ in read_clouds(path, layout="film")] == [0.5, 0.75]
    assert [time for time, _ in read_clouds(path, layout="film", fps=10)] == [0.0, 0.1]


def test_the_observed_points_of_an_episode_are_a_film():
    episode = load_episode(DATA / "apron_hook_1.npz")
    times, clouds = zip(*read_clouds(DATA / "apron_hook_1.npz"), strict=True)
    assert np.allclose(times, episode.times)
    assert np.array_equal(clouds, episode.observed.astype(float))


@pytest.mark.parametrize(
    ("text", "columns"),
    [
        ("{0} {1} {2}", None),
        ("{0},{1},{2},7", None),
        ("{2}; {1}; {0}", (2, 1, 0)),
        ("id,Z,Y,X\n7,{2},{1},{0}", None),
        ("id,up,north,east\n7,{2},{1},{0}", ("east", "north", "up")),
        ("60\n{0} {1} {2} 255", None),
    ],
    ids=["xyz", "csv", "semicolons", "header", "names", "pts"],
)
def test_tables_of_text(text, columns, tmp_path):
    head, _, row = text.rpartition("\n")
    lines = [head, *(row.format(*place) for place in ring().tolist())]
    (tmp_path / "ring.txt").write_text("\n".join(line for line in lines if line))
    np.testing.assert_allclose(clouds(tmp_path / "ring.txt", columns=columns)[0], ring(), atol=1e-6)


def test_columns_that_are_named_by_index_are_taken_by_index(tmp_path):
    rows = np.arange(24.0).reshape(4, 6)
    np.save(tmp_path / "a.npy", rows)
    (tmp_path / "b.csv").write_text("z,y,x\n" + "\n".join(",".join(map(str, row[:3])) for row in rows))
    for name in ("a.npy", "b.csv"):
        np.testing.assert_array_equal(clouds(tmp_path / name, columns=(0, 1, 2))[0], rows[:, :3])


def test_depth_images_by_a_pinhole(tmp_path):
    """The place of each pixel by the formula of the pinhole, one pixel at a time."""
    depth = np.random.default_rng(0).integers(500, 3000, (30, 40)).astype(np.uint16)
    Image.fromarray(depth).save(tmp_path / "0.png")
    with pytest.raises(FormatError, match="intrinsics"):
        clouds(tmp_path / "0.png")
    (tmp_path / "intrinsics.json").write_text(json.dumps(LENS))
    ray = np.array([[(u - 20) / 30, (v - 15) / 40, 1] for v in range(30) for u in range(40)])
    expected = ray * depth.reshape(-1, 1) / 1000
    np.testing.assert_allclose(clouds(tmp_path / "0.png")[0], expected, atol=1e-9)
    np.save(tmp_path / "a.npy", depth / 1000)
    np.testing.assert_allclose(clouds(tmp_path / "a.npy", layout="depth")[0], expected, atol=1e-9)
    scaled = clouds(tmp_path / "a.npy", intrinsics={**LENS, "depth_scale": 0.5})[0]
    np.testing.assert_allclose(scaled, expected / 2, atol=1e-9)


@pytest.mark.parametrize(
    ("entries", "named"),
    [
        ({"D": [0.1, 0, 0, 0, 0]}, "D"),
        ({"K": [30, 5, 20, 0, 40, 15, 0, 0, 1]}, "K"),
        ({"camera_matrix": [[30, 0, 20], [0, 40, 15], [0, 0, 1]], "dist_coeffs": [0.1]}, "camera_matrix, dist_coeffs"),
        ({"k1": 0.3, "k2": -0.4}, "k1, k2"),
        ({"width": 80, "height": 60}, "80 x 60"),
        ({"depth_scale": 1000}, "depth_scale"),
        ({"fx": "30"}, "fx"),
    ],
)
def test_a_lens_that_is_not_the_pinhole_of_the_image_is_refused_by_name(tmp_path, entries, named):
    np.save(tmp_path / "a.npy", np.full((30, 40), 1000, np.uint16))
    assert clouds(tmp_path / "a.npy", intrinsics={**LENS, "width": 40, "height": 30})[0][0, 2] == 1.0
    with pytest.raises(FormatError, match=named):
        clouds(tmp_path / "a.npy", intrinsics={**LENS, **entries})


@pytest.mark.parametrize("kind", ["u2", "f4", "f8"])
@pytest.mark.parametrize("scale", [0.001, 0.0002, 1 / 256])
def test_a_declared_scale_of_depth_holds_for_floats_too(tmp_path, kind, scale):
    np.save(tmp_path / "a.npy", np.full((30, 40), np.round(1.2 / scale), kind))
    depth = clouds(tmp_path / "a.npy", intrinsics={**LENS, "depth_scale": scale})[0][:, 2]
    np.testing.assert_allclose(depth, 1.2, atol=scale)


@pytest.mark.parametrize(
    ("size", "columns"), [((376, 672, 4), [0, 1, 2]), ((192, 256, 3), None), ((7, 50, 3), None), ((30, 40), None)]
)
def test_an_ambiguous_shape_is_asked_about(tmp_path, size, columns):
    np.save(tmp_path / "a.npy", np.ones(size, "f4"))
    np.savez(tmp_path / "a.npz", points=np.ones(size, "f4"))
    for name in ("a.npy", "a.npz"):
        with pytest.raises(FormatError, match="layout"):
            clouds(tmp_path / name, columns=columns)
        if len(size) == 3:
            assert len(clouds(tmp_path / name, layout="organised", columns=columns)) == 1
            assert len(clouds(tmp_path / name, layout="film", columns=columns)) == size[0]


@pytest.mark.parametrize("times", [np.array([0, 33], "m8[ms]"), np.array([0, 33], "M8[ms]"), np.array([False, True])])
def test_times_of_a_film_are_numbers_of_seconds(tmp_path, times):
    film = np.stack([ring()] * 2)
    np.savez(tmp_path / "a.npz", clouds=film, times=[0.0, 0.033])
    assert [time for time, _ in read_clouds(tmp_path / "a.npz", layout="film")] == [0.0, 0.033]
    np.savez(tmp_path / "a.npz", clouds=film, times=times)
    with pytest.raises(FormatError, match="seconds"):
        list(read_clouds(tmp_path / "a.npz", layout="film"))


def test_a_folder_is_read_in_the_order_of_its_numbers(tmp_path):
    for t in (0, 2, 10):
        np.save(tmp_path / f"frame{t}.npy", ring(t))
    assert [cloud[0, 2] for cloud in clouds(tmp_path)] == pytest.approx([1.0, 1.02, 1.1])
    (tmp_path / "a.csv").write_text("1,2,3")
    with pytest.raises(FormatError, match="one kind"):
        clouds(tmp_path)


def test_files_that_hold_no_cloud(tmp_path):
    """The error names the file. Pickles are not read."""
    with pytest.raises(FileNotFoundError, match="gone"):
        clouds(tmp_path / "gone.npy")
    (tmp_path / "a.las").write_bytes(b"LASF")
    (tmp_path / "b.npy").write_bytes(b"no array")
    np.save(tmp_path / "c.npy", np.array([{}], dtype=object))
    (tmp_path / "e.csv").write_text("x,y\n1,2\n")
    for path in tmp_path.iterdir():
        with pytest.raises(FormatError, match=path.name):
            clouds(path, layout="film", columns=("x", "y", "z") if path.suffix == ".csv" else None)


def test_each_step_removes_what_it_should():
    rng = np.random.default_rng(0)
    wall = np.column_stack([rng.uniform(-1, 1, (3000, 2)), 2 + rng.normal(0, 0.002, 3000)])
    stray, outside, blank, hole = [0, 0, 1.5], [0, 0, 9.0], [0, 0, 0], [np.nan, 0, 1]
    clean = Cleaner(crop=((-2, -2, 0), (2, 2, 3)), plane=0.01, outliers=2.5, points=50)
    left = clean(np.vstack([wall, ring(), stray, outside, blank, hole]))
    assert clean.removed == {
        "not finite": 1,
        "at (0, 0, 0)": 1,
        "outside the box": 1,
        "on the plane": 3000,
        "outliers": 1,
        "by farthest points": 10,
    }
    assert {tuple(place) for place in left.tolist()} <= {tuple(place) for place in ring().astype(float).tolist()}


def test_voxels_are_means_of_their_points():
    points = np.random.default_rng(1).uniform(0, 1, (500, 3))
    found = Cleaner(voxel=0.25, points=None)(points)
    cells = {}
    for place in points:
        cells.setdefault(tuple(np.floor(place / 0.25)), []).append(place)
    expected = np.array([np.mean(places, axis=0) for places in cells.values()])
    np.testing.assert_allclose(np.sort(found, axis=0), np.sort(expected, axis=0))


def test_a_frame_that_saw_nothing_is_empty_and_a_wrong_shape_is_named():
    clean = Cleaner(crop=((0, 0, 0), (1, 1, 1)), plane=0.01, voxel=0.1, outliers=2.5)
    assert clean(np.zeros((4, 5, 3))).shape == (0, 3)
    with pytest.raises(ValueError, match=r"\(9, 2\)"):
        clean(np.zeros((9, 2)))
    with pytest.raises(ValueError, match="crop"):
        Cleaner(crop=((0, 0, 0), (1, 1, -1)))
    with pytest.raises(ValueError, match="voxel"):
        Cleaner(voxel=1e-300)(np.ones((4, 3)))
