"""Test the page's readers of files, run by node, on files that other libraries write, and on damaged ones."""

from __future__ import annotations

import gzip
import re
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from chapter_tools.figures import cloud
from topokit.io import load_episode

from pages import by_script, needs_node

trimesh = pytest.importorskip("trimesh", reason="pip install 'topokit[sensors]'")
pypcd4 = pytest.importorskip("pypcd4", reason="pip install 'topokit[sensors]'")
pytestmark = needs_node
EPISODE = Path(__file__).parents[1] / "data_small" / "apron_hook_0.npz"
POINTS = np.random.default_rng(0).normal(size=(40, 3)).astype(np.float32)
FACES = np.arange(39).reshape(-1, 3)
INTERNAL = ("undefined", "not a function", "Offset", "outside", "Invalid", "null", "NaN", "Infinity")
READ = """async (paths) => {
  const files = paths.map((path) => ({ name: require("path").basename(path), bytes: require("fs").readFileSync(path) }));
  const blobs = files.map(({ name, bytes }) => Object.assign(new Blob([bytes]), { name }));
  const { frames, ...film } = await fileReaders().readFilm(blobs);
  return { ...film, left: frames.map((f) => f.left), frames: frames.map((f) => [...(f.all ?? f.order)]) };
}"""


def read(*films: list[Path]) -> list[dict]:
    """Return what the page reads of each list of files."""
    return by_script(["sampling.js", "files.js"], READ, [[str(path) for path in film] for film in films])


def clouds(film: dict) -> list[np.ndarray]:
    assert film["errors"] == []
    return [np.reshape(frame, (-1, 3)) for frame in film["frames"]]


def save_pcd(path: Path, encoding: str) -> None:
    """With colours, as PCL writes them."""
    colours = pypcd4.PointCloud.encode_rgb(np.full((len(POINTS), 3), 200, np.uint8))
    cloud = pypcd4.PointCloud.from_xyzrgb_points(np.column_stack([POINTS, colours.ravel()]))
    cloud.save(path, pypcd4.Encoding(encoding))


def save_ply(path: Path, encoding: str) -> None:
    mesh = trimesh.Trimesh(POINTS, FACES, process=False, vertex_colors=np.full((40, 4), 9, np.uint8))
    path.write_bytes(trimesh.exchange.ply.export_ply(mesh, encoding=encoding))


def save_big_endian_ply(path: Path) -> None:
    """With an element before the vertices, and a list among their properties."""
    header = "ply\nformat binary_big_endian 1.0\nelement camera 2\nproperty list uchar short of\nelement vertex 40\n"
    header += "property double x\nproperty list uchar int seen\nproperty double z\nproperty double y\nend_header\n"
    rows = [struct.pack(">dBiidd", x, 2, 5, 6, z, y) for x, y, z in POINTS]
    path.write_bytes(header.encode() + b"\x02\0\1\0\2\0" + b"".join(rows))


def save_text(path: Path, delimiter: str, header: str = "") -> None:
    np.savetxt(path, POINTS.astype(float), fmt="%.17g", delimiter=delimiter, header=header, comments="")


WRITERS: dict[str, Callable[[Path], object]] = {
    "text.ply": lambda path: save_ply(path, "ascii"),
    "little.ply": lambda path: save_ply(path, "binary"),
    "big.ply": save_big_endian_ply,
    "text.pcd": lambda path: save_pcd(path, "ascii"),
    "binary.pcd": lambda path: save_pcd(path, "binary"),
    "packed.pcd": lambda path: save_pcd(path, "binary_compressed"),
    "plain.npy": lambda path: np.save(path, POINTS),
    "fortran.npy": lambda path: np.save(path, np.asfortranarray(POINTS)),
    "big.npy": lambda path: np.save(path, POINTS.astype(">f8")),
    "packed.npz": lambda path: np.savez_compressed(path, points=POINTS, times=np.arange(2)),
    "plain.npz": lambda path: np.savez(path, only=POINTS),
    "commas.csv": lambda path: save_text(path, ",", "x, y, z"),
    "semicolons.csv": lambda path: save_text(path, ";"),
    "blanks.xyz": lambda path: save_text(path, "  "),
    "tabs.txt": lambda path: save_text(path, "\t", "# a\n\nfirst second third"),
    "mesh.obj": lambda path: trimesh.Trimesh(POINTS, FACES, process=False).export(path, digits=9),
    "text.stl": lambda path: trimesh.Trimesh(POINTS[:39], FACES, process=False).export(path, file_type="stl_ascii"),
    "binary.stl": lambda path: trimesh.Trimesh(POINTS[:39], FACES, process=False).export(path),
}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("files")
    for name, write in WRITERS.items():
        write(folder / name)
    return {name: folder / name for name in WRITERS}


def test_every_kind_of_file_holds_the_points_that_were_written(files):
    for name, film in zip(files, read(*([path] for path in files.values())), strict=True):
        [cloud] = clouds(film)
        expected = POINTS[: len(cloud)]
        assert len(cloud) >= 39, name
        np.testing.assert_allclose(cloud, expected, atol=1e-6 if "text" in name else 0, err_msg=name)


def test_films_and_shapes(tmp_path):
    film = np.random.default_rng(1).normal(size=(3, 20, 3))
    arrays = {
        "film": film,
        "plane": film[0, :, :2],
        "image": np.random.default_rng(2).normal(size=(240, 320, 3)),
        "images": film.reshape(3, 4, 5, 3),
        "half": film[0].astype(np.float16),
        "whole": np.arange(2, 62).reshape(20, 3).astype(np.int64),
        "wide": np.column_stack([film[0], film[0]]),
    }
    for name, array in arrays.items():
        np.save(tmp_path / f"{name}.npy", array)
    for k in (10, 9, 1):
        np.save(tmp_path / f"frame{k}.npy", film[k % 3])
    np.savez(tmp_path / "frames.npz", *film)
    several = [tmp_path / f"frame{k}.npy" for k in (10, 9, 1)]
    *answers, frames, natural = read(
        *([tmp_path / f"{name}.npy"] for name in arrays), [tmp_path / "frames.npz"], several
    )
    got = dict(zip(arrays, map(clouds, answers), strict=True))
    np.testing.assert_array_equal(got["film"], film)
    np.testing.assert_array_equal(got["images"], film)
    np.testing.assert_array_equal(clouds(frames), film)
    np.testing.assert_array_equal(got["plane"][0], np.column_stack([film[0, :, :2], np.zeros(20)]))
    assert [len(cloud) for cloud in got["image"]] == [800]
    for name in ("half", "whole"):
        np.testing.assert_array_equal(got[name][0], arrays[name])
    np.testing.assert_array_equal(got["wide"][0], film[0])
    assert natural["names"] == ["frame1.npy", "frame9.npy", "frame10.npy"]
    np.testing.assert_array_equal(clouds(natural), film[[1, 0, 1]])


def test_an_episode_has_its_observed_points(tmp_path):
    [film] = read([EPISODE])
    np.testing.assert_array_equal(clouds(film), load_episode(EPISODE).observed)


def test_what_is_no_point_is_left_out_and_counted(tmp_path):
    cloud = np.vstack(
        [POINTS[:5], POINTS[2:3], [[0, 0, 0]], [[np.nan, 1, 2]], POINTS[5:], [[1, np.inf, 0]], POINTS[:2]]
    )
    np.save(tmp_path / "cloud.npy", cloud)
    np.save(tmp_path / "plane.npy", [[0, 0], [1, 0], [-0.0, 0]])
    (tmp_path / "gaps.csv").write_text("x,y,z\n1,2,3\n,1,2\nnan,0,1\n4,5,6\n", encoding="utf-8")
    film, plane, gaps = read(*([tmp_path / name] for name in ("cloud.npy", "plane.npy", "gaps.csv")))
    np.testing.assert_array_equal(clouds(film)[0], POINTS)
    assert film["left"] == [{"rows": 46, "notFinite": 2, "atZero": 1, "repeats": 3}]
    np.testing.assert_array_equal(clouds(plane)[0], [[0, 0, 0], [1, 0, 0]])
    np.testing.assert_array_equal(clouds(gaps)[0], [[1, 2, 3], [4, 5, 6]])


def test_a_frame_without_points_is_named(tmp_path):
    film = np.ones((3, 2, 3))
    film[1] = 0
    np.save(tmp_path / "film.npy", film)
    [answer] = read([tmp_path / "film.npy"])
    assert answer["frames"] == []
    assert [error[:19] for error in answer["errors"]] == ["film.npy: frame 1: "]


def test_a_bad_file_is_named_and_the_others_are_read(files, tmp_path):
    bad = tmp_path / "bad.npy"
    bad.write_bytes(b"hello")
    [film] = read([files["plain.npy"], bad])
    assert len(film["frames"]) == 1
    assert [error.partition(":")[0] for error in film["errors"]] == ["bad.npy"]


def test_damaged_files_end_in_an_error_of_our_own_or_in_points(files, tmp_path):
    """Cut off anywhere, or with any byte changed: a script's own errors have other words."""
    rng = np.random.default_rng(3)
    damaged = []
    for name, path in files.items():
        whole = path.read_bytes()
        for k in range(40):
            changed = bytearray(whole[: rng.integers(len(whole))] if k % 2 else whole)
            for place in rng.integers(0, max(1, min(len(changed), 300 if k % 4 else 10**9)), k % 3):
                changed[place : place + 1] = bytes(rng.integers(0, 256, 1, dtype=np.uint8))
            damaged.append([tmp_path / f"{k}_{name}"])
            damaged[-1][0].write_bytes(changed)
    films = read(*damaged)
    for film in films:
        assert bool(film["errors"]) != bool(film["frames"])
        for error in film["errors"]:
            assert not any(word in error for word in INTERNAL), error
    assert sum(bool(film["errors"]) for film in films) > len(films) / 4


def test_the_scripts_of_the_page_stay_small():
    [script] = re.findall("<script>(.*?)</script>", cloud({}).page, re.DOTALL)
    assert len(gzip.compress(script.encode())) < 60_000
