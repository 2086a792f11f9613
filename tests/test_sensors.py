"""What sensors write, each kind written by the library that others write it with, and the pipeline that cleans it."""

from __future__ import annotations

import io
import json
import subprocess
import sys

import numpy as np
import pytest
import trimesh
from PIL import Image
from pypcd4 import Encoding
from rosbags.rosbag2 import StoragePlugin
from sensor_files import (
    LENS,
    MESSAGES,
    cloud_message,
    clouds,
    depth_image,
    image_message,
    info_message,
    npy,
    ring,
    save_bag,
    save_pcd,
)
from sklearn.linear_model import RANSACRegressor

import topokit as tk
from topokit._config import from_mapping
from topokit.io import FormatError
from topokit.sensors import Cleaner, Pipeline, read_clouds, read_stream

# Each kind of file: a film of the ring at 0 and 1, or its first frame.


@pytest.mark.parametrize("encoding", [Encoding.ASCII, Encoding.BINARY, Encoding.BINARY_COMPRESSED])
def test_pcd_with_colours(encoding, tmp_path):
    (found,) = clouds(save_pcd(tmp_path / "ring.pcd", ring(), encoding))
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, ring(), atol=1e-6)


@pytest.mark.parametrize("points", [ring(), ring()[:1]], ids=["ring", "one point"])
def test_ascii_pcd_with_more_blanks_than_are_needed(points, tmp_path):
    text = save_pcd(tmp_path / "ring.pcd", points, Encoding.ASCII).read_text()
    (tmp_path / "ring.pcd").write_bytes(text.replace(" ", "  ").replace("\n", " \r\n").encode())
    np.testing.assert_allclose(clouds(tmp_path / "ring.pcd")[0], points, atol=1e-6)


def test_ply_after_many_comments(tmp_path):
    """Big-endian doubles in an order of their own, as other programs write them."""
    kind = [("red", "u1"), ("z", ">f8"), ("y", ">f8"), ("x", ">f8")]
    rows = np.zeros(60, kind)
    for axis, name in enumerate("xyz"):
        rows[name] = ring()[:, axis]
    head = ["ply", "format binary_big_endian 1.0", *["comment " + 80 * "-"] * 100, "element vertex 60"]
    head += ["property uchar red", *(f"property double {axis}" for axis in "zyx"), "end_header\n"]
    (tmp_path / "ring.ply").write_bytes("\n".join(head).encode() + rows.tobytes())
    np.testing.assert_array_equal(clouds(tmp_path / "ring.ply")[0], ring())


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_ply_with_colours(encoding, tmp_path):
    cloud = trimesh.PointCloud(ring(), colors=np.full((60, 4), 200, np.uint8))
    (tmp_path / "ring.ply").write_bytes(trimesh.exchange.ply.export_ply(cloud, encoding=encoding))
    np.testing.assert_allclose(clouds(tmp_path / "ring.ply")[0], ring(), atol=1e-6)


@pytest.mark.parametrize("shape", [(60, 3), (2, 30, 3), (2, 5, 6, 3)], ids=["cloud", "film", "organised film"])
@pytest.mark.parametrize("suffix", [".npy", ".npz"])
def test_numpy(shape, suffix, tmp_path):
    points = ring().reshape(shape)
    path = tmp_path / f"film{suffix}"
    np.save(path, points) if suffix == ".npy" else np.savez(path, points)
    frames = points[None] if len(shape) == 2 else points
    found = clouds(path)
    assert len(found) == len(frames)
    for cloud, frame in zip(found, frames, strict=True):
        np.testing.assert_array_equal(cloud, frame.reshape(-1, 3))


@pytest.mark.parametrize("shape", [(480, 640, 3), (1, 480, 640, 3)])
def test_an_array_of_the_size_of_a_cameras_image_is_one_cloud(shape, tmp_path):
    """As drivers save it: in millimetres, NaN where nothing is seen, the first rows among them."""
    points = np.full(shape, np.nan, np.float32)
    points.reshape(480, 640, 3)[300:306, :10] = 1000 * ring().reshape(6, 10, 3)
    np.save(tmp_path / "organised.npy", points)
    (found,) = clouds(tmp_path / "organised.npy", unit="mm")
    assert found.shape == (480 * 640, 3)
    np.testing.assert_allclose(found[np.isfinite(found).all(axis=1)], ring(), atol=1e-6)


def test_arrays_without_names_in_an_archive_are_the_clouds_of_a_film(tmp_path):
    np.savez(tmp_path / "film.npz", *(ring(t, 60 + t) for t in range(12)))
    found = clouds(tmp_path / "film.npz")
    assert [len(cloud) for cloud in found] == list(range(60, 72))


def test_units_are_looked_at_where_something_is_seen(tmp_path):
    """Not in the first frame, where the lens was covered."""
    blank = np.full((60, 3), np.nan)
    for t, cloud in enumerate([blank, np.zeros((60, 3)), 1000 * ring(), 1000 * ring(1)]):
        np.save(tmp_path / f"{t}.npy", cloud)
    np.save(tmp_path / "film.npy", [blank, 1000 * ring()])
    for path, name in ((tmp_path / "[0-9].npy", "2.npy"), (tmp_path / "film.npy", "film.npy")):
        with pytest.raises(FormatError, match=rf"{name}: .*--unit mm"):
            clouds(path)


def test_numpy_by_names_and_with_times(tmp_path):
    kind = [("rgb", "u1"), ("z", "f4"), ("x", "f4"), ("y", "f8")]
    named = np.zeros(60, kind)
    named["x"], named["y"], named["z"] = ring().T
    np.save(tmp_path / "named.npy", named)
    np.testing.assert_allclose(clouds(tmp_path / "named.npy")[0], ring())
    np.savez(tmp_path / "film.npz", points=[ring(), ring(1)], times=[0.5, 0.75], colours=np.zeros(4))
    assert [time for time, _ in read_clouds(tmp_path / "film.npz")] == [0.5, 0.75]
    assert [time for time, _ in read_clouds(tmp_path / "film.npz", fps=10)] == [0, 0.1]


def test_a_folder_or_a_pattern_of_numbered_files_is_a_film(tmp_path):
    for t in (10, 9, 0):
        save_pcd(tmp_path / f"frame{t}.pcd", ring(t))
    (tmp_path / "readme.txt").write_text("a film")
    for path in (tmp_path, tmp_path / "frame*.pcd"):
        assert [cloud[0, 2] for cloud in clouds(path)] == pytest.approx([1, 1.09, 1.1])


LENSES = {
    "plain": LENS,
    "RealSense": {"width": 40, "height": 30, "fx": 30, "fy": 30, "ppx": 20, "ppy": 15, "coeffs": [0] * 5},
    "CameraInfo": {"height": 30, "width": 40, "k": [30, 0, 20, 0, 30, 15, 0, 0, 1]},
    "calibration": {"camera_matrix": {"rows": 3, "cols": 3, "data": [30, 0, 20, 0, 30, 15, 0, 0, 1]}},
    "Open3D": {"intrinsic_matrix": [30, 0, 0, 0, 30, 0, 20, 15, 1], "depth_scale": 1000.0},
}


@pytest.mark.parametrize("maker", LENSES)
def test_depth_images_with_their_camera(maker, tmp_path):
    for t in range(2):
        Image.fromarray(depth_image(t)).save(tmp_path / f"{t}.png")
    (tmp_path / "intrinsics.json").write_text(json.dumps(LENSES[maker]))
    first, _ = clouds(tmp_path)
    assert first.shape == (1200, 3)
    assert not first.reshape(30, 40, 3)[:3, :3].any()
    np.testing.assert_allclose(first.reshape(30, 40, 3)[15, 27], [7 / 30, 0, 1], atol=1e-6)
    np.testing.assert_allclose(first.reshape(30, 40, 3)[25, 39], [19 / 15, 2 / 3, 2], atol=1e-6)


def test_depth_in_metres_and_in_other_units(tmp_path):
    metres = depth_image() / np.float32(1000)
    np.save(tmp_path / "depth.npy", [metres, metres])
    np.savez(tmp_path / "depth.npz", points=depth_image())
    film, (image,) = (clouds(tmp_path / name, intrinsics=LENS) for name in ("depth.npy", "depth.npz"))
    np.testing.assert_allclose(film[1], image, atol=1e-6)
    (other,) = clouds(tmp_path / "depth.npz", intrinsics=LENS, unit="cm")
    np.testing.assert_allclose(other, 10 * image, rtol=1e-6)


@pytest.mark.parametrize("storage", StoragePlugin)
def test_a_bag_of_clouds(storage, tmp_path):
    organised = np.stack([ring(t).reshape(6, 10, 3) for t in range(2)])
    organised[:, 2, 3] = np.nan
    messages = [cloud_message(points, 7.25 + t, "<>"[t]) for t, points in enumerate(organised)]
    bag = save_bag(tmp_path / "bag", {"/camera/points": messages}, storage)
    (first, one), (second, two) = read_clouds(bag)
    assert (first, second) == (7.25, 8.25)
    np.testing.assert_array_equal([one, two], organised.reshape(2, 60, 3))
    alone = next(path for path in bag.iterdir() if path.suffix in (".mcap", ".db3"))
    np.testing.assert_array_equal(clouds(alone)[1], two)


def test_a_bag_of_depth_images(tmp_path):
    images = {"16UC1": depth_image(), "32FC1": depth_image() / np.float32(1000)}
    topics = {f"/{name}/depth/image": [image_message(image, 0, name)] for name, image in images.items()}
    topics |= {f"/{name}/depth/camera_info": [info_message(0)] for name in images}
    topics["/rgb/image"] = [image_message(np.zeros((30, 40), np.uint8), 0, "mono8")]
    bag = save_bag(tmp_path / "bag", topics)
    found = [next(read_clouds(bag, topic=f"/{name}/depth/image")) for name in images]
    assert [time for time, _ in found] == [100, 100]  # no stamp: when it was received
    np.testing.assert_allclose(found[0][1], found[1][1], atol=1e-6)
    np.testing.assert_allclose(found[0][1].reshape(30, 40, 3)[15, 27], [7 / 30, 0, 1], atol=1e-6)
    with pytest.raises(FormatError, match=r"/16UC1/depth/image, .*topic="):
        next(read_clouds(bag))
    with pytest.raises(FormatError, match="/16UC1/depth/image"):
        next(read_clouds(bag, topic="/nothing"))
    with pytest.raises(FormatError, match="mono8"):
        next(read_clouds(bag, topic="/rgb/image"))


def test_a_part_of_an_image_is_seen_where_the_whole_one_shows_it(tmp_path):
    """A camera that reads out a region of interest describes the lens of the whole image."""
    info = info_message(0)
    info.roi = MESSAGES.types["sensor_msgs/msg/RegionOfInterest"](10, 5, 15, 20, True)
    part = np.ascontiguousarray(depth_image()[5:20, 10:30])
    topics = {"/depth/image": [image_message(part, 0)], "/depth/camera_info": [info]}
    (found,) = clouds(save_bag(tmp_path / "part", topics))
    topics = {"/depth/image": [image_message(depth_image(), 0)], "/depth/camera_info": [info_message(0)]}
    (whole,) = clouds(save_bag(tmp_path / "whole", topics))
    np.testing.assert_allclose(found, whole.reshape(30, 40, 3)[5:20, 10:30].reshape(-1, 3), atol=1e-6)


# What is refused, and in which words.


def test_a_film_is_of_one_kind(tmp_path):
    with pytest.raises(FormatError, match="no cloud"):
        clouds(tmp_path)
    np.save(tmp_path / "0.npy", ring())
    save_pcd(tmp_path / "1.pcd", ring())
    with pytest.raises(FormatError, match=r"\.npy, \.pcd"):
        clouds(tmp_path)
    for asked, says in (
        ({"unit": "inch"}, "unit must be one of m, cm, mm"),
        ({"fps": 0}, "fps must be more than zero"),
    ):
        with pytest.raises(ValueError, match=says):
            read_clouds(tmp_path, **asked)


def test_units_and_columns_are_declared(tmp_path):
    np.save(tmp_path / "mm.npy", np.column_stack([np.full((60, 3), 255), 1000 * ring()]).astype(np.int16))
    (found,) = clouds(tmp_path / "mm.npy", unit="mm", columns=(3, 4, 5))
    np.testing.assert_allclose(found, ring(), atol=1e-3)
    np.save(tmp_path / "m.npy", ring())
    for columns, says in (((3, 4, 6), "no 6: they have 0, 1, 2, 3, 4, 5"), (("x", "y", "z"), "no x: they have 0, 1")):
        with pytest.raises(FormatError, match=f"mm.npy: its points have {says}"):
            clouds(tmp_path / "mm.npy", unit="mm", columns=columns)
    with pytest.raises(FormatError, match="unit='m'"):
        clouds(tmp_path / "m.npy", unit="mm")
    np.save(tmp_path / "hall.npy", 1000 * ring())
    np.testing.assert_array_equal(clouds(tmp_path / "hall.npy", unit="m")[0], 1000 * ring())


def test_a_missing_reader_is_named(tmp_path):
    save_pcd(tmp_path / "ring.pcd", ring())
    code = "import sys; sys.modules['lzf'] = None\nfrom topokit.sensors import read_clouds\n"
    code += f"list(read_clouds({str(tmp_path)!r}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "ring.pcd: reading it needs lzf: pip install 'topokit[sensors]'" in done.stderr


def test_files_of_numpy_need_no_extra(tmp_path):
    np.savez(tmp_path / "film.npz", [ring(), ring(1)])
    code = "import sys\nfor name in 'pydantic pypcd4 rosbags trimesh PIL pandas sklearn'.split(): sys.modules[name] = None\n"
    code += (
        f"from topokit.sensors import read_clouds\nassert len(list(read_clouds({str(tmp_path / 'film.npz')!r}))) == 2"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


# A stream.


def stream(data: bytes) -> io.BufferedReader:
    return io.BufferedReader(io.BytesIO(data))


def test_a_stream_may_be_written_columns_first_and_in_other_units():
    found = list(read_stream(stream(npy(np.asfortranarray(1000 * ring())) * 2), unit="mm"))
    np.testing.assert_allclose(found, [ring()] * 2, rtol=1e-6)
    with pytest.raises(FormatError, match="unit='mm'"):
        list(read_stream(stream(npy(1000 * ring()))))
    assert len(list(read_stream(stream(npy(1000 * ring())), check_unit=False))) == 1


# The pipeline.


EYE = (0.0, -3.0, 1.0)


def scene(t: float = 0.0, n: int = 3000) -> np.ndarray:
    """A ring over a table that is slanted, before a wall; pixels that saw nothing, and strays. In metres, (4 n, 3)."""
    rng = np.random.default_rng(0)
    u, v = rng.uniform(-1, 1, (2, 2 * n))
    table = np.column_stack([u, v, 0.1 * u + 0.02 * t])[:n]
    wall = np.column_stack([u, np.full(2 * n, 1.0), np.abs(v)])
    angle, width = rng.uniform(0, 2 * np.pi, n), rng.uniform(0.2, 0.3, n)
    band = np.column_stack([width * np.cos(angle), 0.2 * np.sin(3 * angle), 0.7 + width * np.sin(angle)])
    band[:5] = np.nan
    band[5:12] = 0
    band[12:15] = [[0.9, 0.3, 0.6], [-0.9, 0.3, 0.7], [0.9, -0.5, 0.8]]
    return rng.permutation(np.concatenate([table, wall, band]))


def test_every_step_says_what_it_removed():
    clean = Cleaner(Pipeline(crop=((-2, -0.8, -1), (2, 2, 2)), planes=2, eye=EYE, voxel=0.02, outliers=3.0, points=200))
    for t in range(3):
        points = scene(t)
        kept = clean(points)
        assert kept.shape == (200, 3)
        assert (kept[:, 2] > 0.35).all()  # the table is gone,
        assert (kept[:, 1] < 0.5).all()  # so is the wall,
        assert (np.abs(kept[:, 0]) < 0.5).all()  # and the strays
        removed = clean.removed
        assert list(removed) == [
            *(
                "not finite",
                "at (0, 0, 0)",
                "outside the box",
                "on planes",
                "by voxels",
                "outliers",
                "by farthest points",
            )
        ]
        assert removed["not finite"] == 5
        assert removed["at (0, 0, 0)"] == 7
        assert removed["outside the box"] == (points[:, 1] < -0.8).sum()
        assert 8400 < removed["on planes"] < 8900
        assert removed["outliers"] >= 3
        assert sum(removed.values()) == len(points) - 200
    loops = tk.rips_persistence(kept).lifetime
    assert loops.max() > 0.15


@pytest.fixture
def searches(monkeypatch) -> list[int]:
    """A list that grows by one whenever a plane is searched for; a search takes long, and fits once along each axis."""
    fits: list[int] = []
    fit = RANSACRegressor.fit
    monkeypatch.setattr(RANSACRegressor, "fit", lambda *given: fits.append(1) or fit(*given))
    return fits


def test_planes_are_followed_and_searched_for_when_they_are_lost(searches):
    clean = Cleaner(Pipeline(planes=2, eye=EYE))
    for t in (0, 0.5, 1, 1.5):
        clean(scene(t))
    assert len(searches) == 2 * 3
    assert clean.removed["on planes"] > 8900
    clean((scene(0) - EYE) @ np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]]) + EYE)  # the camera fell over
    assert len(searches) == 4 * 3
    assert clean.removed["on planes"] > 8900


def test_no_plane_is_found_where_none_is(searches):
    ball = np.random.default_rng(0).standard_normal((2000, 3))
    clean = Cleaner(Pipeline(planes=1, eye=EYE, points=None))
    for _ in range(30):
        assert len(clean(ball)) == 2000
        assert clean.removed["on planes"] == 0
    assert len(searches) == 3
    assert len(clean(ring()[:4])) == 4
    assert len(searches) == 2 * 3


def test_cloth_before_a_wall_is_no_wall():
    """It is the larger plane here, and there is something behind it."""
    rng = np.random.default_rng(0)
    u, v = rng.uniform(-1, 1, (2, 4000))
    points = np.column_stack([u, v, np.where(np.arange(4000) < 3000, 1.0, 2.0)])
    kept = Cleaner(Pipeline(planes=1, points=None))(points)
    assert len(kept) == 3000
    assert (kept[:, 2] == 1).all()


def cloth_on_a_table(rng: np.random.Generator, thick: float, hole: float = 0.0, error: float = 0.001) -> np.ndarray:
    """A cloth of 40 cm with a fold across and a hole, seen from 0.8 m above; between folds it touches the table."""
    x, y = rng.uniform(-0.5, 0.5, (2, 90_000))
    fold = 0.04 * np.exp(-(((x + 0.4 * y) / 0.03) ** 2)) + 0.03 * np.exp(-(((np.hypot(x, y) - 0.16) / 0.02) ** 2))
    on_cloth = (np.abs([x, y]).max(axis=0) < 0.2) & (np.hypot(x - 0.02, y) > hole)
    height = np.where(on_cloth, thick + fold, 0) + error * rng.standard_normal(len(x)) + 0.002 * x * x
    return np.column_stack([x, y, 0.8 - height])


@pytest.mark.parametrize(("hole", "loops"), [(0.0, 0), (0.08, 1)])
def test_cloth_that_touches_the_table_is_not_torn(hole, loops, caplog):
    points = cloth_on_a_table(np.random.default_rng(0), 0.003, hole)
    left = Cleaner(Pipeline(planes=1))(points)
    assert len(tk.track([left])[0]) == loops
    assert np.abs(left[:, :2]).max() < 0.21  # and no rim of the table is kept, outside or in the hole
    assert np.hypot(left[:, 0] - 0.02, left[:, 1]).min() > 0.94 * hole
    assert not caplog.records
    if not loops:  # the points that are farther than a centimetre from the table are not the whole cloth
        assert len(tk.track([Cleaner()(points[points[:, 2] < 0.79])])[0]) > 0


def test_cloth_that_cannot_be_told_from_the_table_is_kept_and_reported(caplog):
    """The camera errs by more than the cloth is thick, the same in cells that are close together."""
    rng = np.random.default_rng(1)
    points = cloth_on_a_table(rng, 0.001)
    waves = rng.uniform(-40, 40, (2, 60)), rng.uniform(0, 2 * np.pi, 60)
    points[:, 2] += 0.0003 * np.sin(points[:, :2] @ waves[0] + waves[1]).sum(axis=1)
    clean = Cleaner(Pipeline(planes=1))
    for _ in range(2):
        assert len(tk.track([clean(points)])[0]) == 0
    assert len(caplog.records) == 1


def test_voxels_keep_the_means_of_cubes():
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (3000, 3))
    means = Cleaner(Pipeline(voxel=0.1, points=None))(points)
    cells = np.floor(points / 0.1).astype(int)
    places, numbers = np.unique(cells, axis=0, return_inverse=True)
    expected = [points[numbers.ravel() == i].mean(axis=0) for i in range(len(places))]
    order = np.lexsort(np.floor(means / 0.1).T[::-1])
    np.testing.assert_allclose(means[order], expected)
    with pytest.raises(ValueError, match="voxel: 1e-09 m"):
        Cleaner(Pipeline(voxel=1e-9))(points)


def test_organised_clouds_and_doubles_are_cleaned_alike():
    organised = scene().reshape(100, 120, 3)
    one, two = Cleaner(), Cleaner(Pipeline(points=None))
    assert one(organised).shape == (1000, 3)
    assert len(two(organised)) == 12_000 - 12
    np.testing.assert_array_equal(Cleaner(Pipeline(points=None))(organised.reshape(-1, 3)), two(organised))
    assert one(organised.astype(np.float32)).dtype == np.float64


def test_what_cannot_be_cleaned_says_why():
    with pytest.raises(ValueError, match=r"\(9, 6\)"):
        Cleaner()(np.ones((9, 6)))
    clean = Cleaner(Pipeline(crop=((5, 5, 5), (6, 6, 6))))
    assert clean(ring()).shape == (0, 3)
    assert clean.removed["outside the box"] == 60


@pytest.mark.parametrize(
    ("entries", "says"),
    [
        ({"voxels": 1}, "voxels"),
        ({"voxel": -0.1}, "voxel"),
        ({"planes": 1.5}, "planes"),
        ({"points": "many"}, "points"),
        ({"crop": [[0, 0, 0], [1, 0, 1]]}, "crop"),
    ],
)
def test_a_wrong_pipeline_is_refused(entries, says):
    with pytest.raises(ValueError, match=f"here: .*{says}"):
        from_mapping(Pipeline, entries, "here")


def test_a_box_may_be_lists_or_an_array():
    box = ((-1.0, -1.0, 0.0), (1.0, 1.0, 2.0))
    assert Pipeline(crop=[list(corner) for corner in box]).crop == Pipeline(crop=np.array(box)).crop == box
