"""What strangers send: a table of files that are refused, one of files that are read, a runner for each; and damage of all kinds.

The runners hold every reader to the same: an error of ours that names the file and the fault and is safe to print, in ten
seconds, with 256 MB of memory. So that bombs are small, the bound on what a file unpacks to is 1 MiB here.
"""

from __future__ import annotations

import bz2
import contextlib
import io
import json
import os
import re
import resource
import signal
import sqlite3
import struct
import zipfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import lzf
import numpy as np
import pytest
from backports import zstd
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.lib import recfunctions
from pypcd4 import Encoding
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from sensor_files import (
    LENS,
    MESSAGES,
    cloud_message,
    clouds,
    depth_image,
    image_message,
    info_message,
    npy,
    npz,
    pcd,
    ply,
    png,
    ring,
    save_bag,
    save_ros1_bag,
)

from topokit._archive import load_archive, save_archive
from topokit._config import load
from topokit.cli import main
from topokit.data import Dataset
from topokit.io import FormatError, load_episode, load_states, save_episode, save_states
from topokit.models import TrainConfig
from topokit.sensors import read_clouds, read_stream
from topokit.seqph import track
from topokit.sim import Garment, HangEnv, SimulationConfig
from topokit.view import player

from conftest import DATA, memory

if not Path("/proc/self/statm").exists():
    pytest.skip("the runners measure the memory as Linux tells it", allow_module_level=True)

ZEROS = bytes(2**22)  # four times the bound
EPISODE = "topokit-episode"


@contextlib.contextmanager
def bounded(room: int = 2**28, seconds: int = 10) -> Iterator[None]:
    """Let the block take so much more memory, and so much time."""

    def late(*_: object) -> None:
        raise AssertionError(f"not done after {seconds} s")

    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    handler = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    resource.setrlimit(resource.RLIMIT_AS, (taken + room, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
        signal.alarm(0)
        signal.signal(signal.SIGALRM, handler)


@pytest.fixture(autouse=True)
def small_bound(monkeypatch) -> None:
    monkeypatch.setenv("TOPOKIT_UNPACKED", str(2**20))


# -- what is sent -----------------------------------------------------------------------------------------------------------


TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 3\n"
PLY = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
PLY += "property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 0 1\n3 0 1 2\n"
POINTS = PLY.split("element face")[0] + "end_header\n0 0 1\n1 0 1\n0 1 1\n"
PCD = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 3\nHEIGHT 1\nPOINTS 3\nDATA ascii\n"
PCD += "0 0 1\n1 0 1\n0 1 1\n"
CORNERS = [[0, 0, 1], [1, 0, 1], [0, 1, 1]]
XYI = recfunctions.unstructured_to_structured(ring(), names=["x", "y", "intensity"])
CLOUD = {"/points": [cloud_message(ring().reshape(6, 10, 3), 1)]}


def npy_header(shape: str, content: bytes = b"", kind: str = "<f8", version: bytes = b"\1\0") -> bytes:
    head = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}}}\n".encode()
    return b"\x93NUMPY" + version + len(head).to_bytes(2 * version[0], "little") + head + content


def zip_of(path: Path, method: int = zipfile.ZIP_DEFLATED, **entries: bytes) -> None:
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, data in entries.items():
            archive.writestr(name.replace("__", "."), data)


def episode_with(change: Callable[[dict[str, Any], dict[str, Any]], object]) -> Callable[[Path], None]:
    """What writes an episode sealed anew, after a change of its header and its arrays."""

    def write(path: Path) -> None:
        header, arrays = load_archive(DATA / "apron_hook_0.npz", EPISODE)
        change(header, arrays)
        save_archive(path, EPISODE, header, arrays)

    return write


def edited(bag: Path, statement: str) -> Path:
    """Change the tables of a bag in SQLite."""
    save_bag(bag, CLOUD, StoragePlugin.SQLITE3)
    with contextlib.closing(sqlite3.connect(next(bag.glob("*.db3")))) as tables:
        tables.executescript(statement)
    return bag


def computed_messages(bag: Path) -> None:
    edited(
        bag,
        "ALTER TABLE messages RENAME TO old; CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER,"
        "timestamp INTEGER, data BLOB AS (zeroblob(500000000)));"
        "INSERT INTO messages(id, topic_id, timestamp) SELECT id, topic_id, timestamp FROM old; DROP TABLE old;",
    )


def packed_message(bag: Path) -> None:
    edited(bag, f"UPDATE messages SET data = x'{zstd.compress(ZEROS).hex()}';")


def packed_file(bag: Path) -> None:
    save_bag(bag, CLOUD)
    (file,) = bag.glob("*.mcap")
    file.with_name(f"{file.name}.zstd").write_bytes(zstd.compress(file.read_bytes() + ZEROS))
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace(file.name, f"{file.name}.zstd"))
    file.unlink()


def mcap_bomb(path: Path) -> None:
    chunk = zstd.compress(ZEROS)
    record = struct.pack("<QQQI", 0, 1, len(ZEROS), 0) + b"\4\0\0\0zstd" + len(chunk).to_bytes(8, "little") + chunk
    magic = b"\x89MCAP0\r\n"
    footer = b"\2" + (20).to_bytes(8, "little") + bytes(20)
    path.write_bytes(magic + b"\6" + len(record).to_bytes(8, "little") + record + footer + magic)


def ros1_bomb(path: Path) -> None:
    def fields(**values: bytes) -> bytes:
        parts = [name.encode() + b"=" + value for name, value in values.items()]
        joined = b"".join(len(part).to_bytes(4, "little") + part for part in parts)
        return len(joined).to_bytes(4, "little") + joined

    start = fields(
        op=b"\3", index_pos=(13).to_bytes(8, "little"), conn_count=bytes(4), chunk_count=b"\1\0\0\0"
    ) + bytes(4)
    chunk = bz2.compress(ZEROS)
    size = len(chunk).to_bytes(4, "little")
    path.write_bytes(b"#ROSBAG V2.0\n" + start + fields(op=b"\5", compression=b"bz2", size=size) + size + chunk)


def lzf_bomb(path: Path) -> None:
    packed = lzf.compress(ZEROS)
    head = PCD.replace("3\nHEIGHT", "349525\nHEIGHT").replace("POINTS 3", "POINTS 349525")
    head = head.split("DATA")[0] + "DATA binary_compressed\n"
    path.write_bytes(head.encode() + struct.pack("<II", 100, 349525 * 12) + packed[:100])


def folder_with_pipe(path: Path) -> None:
    path.mkdir()
    np.save(path / "0.npy", ring())
    os.mkfifo(path / "1.npy")


def image_beside_lens(lens: object, path: Path) -> None:
    path.mkdir()
    (path / "0.png").write_bytes(png(depth_image()))
    text = lens if isinstance(lens, str) else json.dumps(lens)
    (path / "intrinsics.json").write_text(text)


def depth_bag(path: Path, info: str, frame: str = "colour", empty: bool = False) -> None:
    """A bag of a depth image, and of a camera whose topic may have no message."""
    messages = [info_message(0, frame)]
    save_bag(
        path, {"/camera/depth/image": [image_message(depth_image(), 0)], info: messages}, empty=[info] if empty else []
    )


REFUSED: list[tuple[str, str, Any, str]] = [
    # Clouds: reader, name, content, what the error mentions beside the name.
    ("cloud", "none.pcd", None, "no such file"),
    ("cloud", "cloud.txt", b"1 2 3", ".txt"),
    ("cloud", "empty.npy", b"", ""),
    ("cloud", "pickled.npy", npy(np.array([{}])), "pickled"),
    ("cloud", "half.npy", npy(ring())[:300], "720 bytes"),
    ("cloud", "longer.npy", npy(ring()) + bytes(12), "732 follow"),
    ("cloud", "version.npy", npy_header("(4, 3)", bytes(96), version=b"\4\0"), "version"),
    ("cloud", "rows.npy", npy_header("(1000000000, 0, 3)"), "is empty and claims"),
    ("cloud", "nothing.npy", npy_header("(1000000000, 3, 3)", kind="|S0"), "is empty and claims"),
    ("cloud", "words.npy", npy(np.array([["a", "b", "c"]])), "real numbers"),
    ("cloud", "flat.npy", npy(np.zeros(3)), r"\(3,\)"),
    ("cloud", "number.npy", npy(3.0), r"\(\)"),
    ("cloud", "columns.npy", npy(ring().T), r"\(3, 60\)"),
    ("cloud", "colours.npy", npy(np.ones((9, 6))), r"columns=\(0, 1, 2\)"),
    ("cloud", "named.npy", npy(XYI), "no z: .* intensity"),
    ("cloud", "depth.npy", npy(np.ones((30, 40), np.float32)), "fx, fy, cx and cy"),
    ("cloud", "millimetres.npy", npy(1000 * ring()), "unit='mm'"),
    ("cloud", "two.npz", npz(a=ring(), b=ring()), "a, b: .*'points'"),
    ("cloud", "late.npz", npz(points=[ring()], times=[0.0, 1.0]), "times"),
    ("cloud", "again.npz", npz(points=[ring(), ring()], times=[2.0, 2.0]), "frame 1 .*--fps"),
    ("cloud", "bomb.npz", partial(zip_of, points__npy=npy(np.zeros(2**22, np.uint8))), "TOPOKIT_UNPACKED"),
    ("cloud", "lying.npz", partial(zip_of, points__npy=npy_header("(10000000, 3)")), "240000"),
    ("cloud", "times.npz", partial(zip_of, points__npy=npy([ring()]), times__npy=npy_header("(100000000,)")), "times"),
    ("cloud", "escape.npz", npz(**{"\x1b[31m": ring(), "\u202eb": ring()}), r"\\x1b\[31m, \\u202eb"),
    ("cloud", "ours.npz", lambda path: save_states(path, track([ring()])), "load_states"),
    ("cloud", "colour.png", png(np.zeros((30, 40, 3), np.uint8)), "RGB"),
    ("cloud", "depth.png", png(depth_image()), "fx, fy, cx and cy"),
    ("cloud", "bomb.png", png(np.zeros((4000, 4000), np.uint16)), "TOPOKIT_UNPACKED"),
    ("cloud", "no.png", b"hello", ""),
    ("cloud", "half.ply", ply()[:-8], "'vertex'.* ends"),
    ("cloud", "fewer.ply", ply("ascii")[:-40], "'vertex'.* ends"),
    ("cloud", "part.ply", POINTS.replace("vertex 3", "vertex 2"), "3 numbers follow"),
    ("cloud", "many.ply", POINTS.replace("vertex 3", "vertex 3000000000"), "3000000000 rows"),
    ("cloud", "no.ply", b"hello", "PLY"),
    ("cloud", "half.pcd", pcd(encoding=Encoding.BINARY)[:-8], "59 of 60"),
    ("cloud", "fewer.pcd", pcd(encoding=Encoding.BINARY)[:-12], "59 of 60"),
    ("cloud", "part.pcd", PCD.replace("WIDTH 3", "WIDTH 2").replace("POINTS 3", "POINTS 2"), "3 of 2"),
    ("cloud", "size.pcd", PCD.replace("WIDTH 3", "WIDTH 4"), "3 points, in an image of 4"),
    ("cloud", "many.pcd", pcd().replace(b"POINTS 60", b"POINTS 600000000"), "600000000"),
    ("cloud", "fields.pcd", pcd().replace(b"COUNT 1", b"COUNT 9999999"), "9999999"),
    ("cloud", "type.pcd", PCD.replace("TYPE F", "TYPE Q"), "header .* TYPE Q of SIZE 4"),
    ("cloud", "count.pcd", PCD.replace("COUNT 1 1 1", "COUNT 1"), "3 FIELDS and 1 numbers of COUNT"),
    ("cloud", "bomb.pcd", lzf_bomb, "TOPOKIT_UNPACKED"),
    ("cloud", "no.pcd", b"hello", "DATA"),
    ("cloud", "zero.npy", lambda path: path.symlink_to("/dev/zero"), "a device"),
    ("cloud", "pipe.npy", os.mkfifo, "a pipe"),
    ("cloud", "film", folder_with_pipe, "1.npy: a device or a pipe"),
    ("cloud", "lens", partial(image_beside_lens, "{"), r"intrinsics\.json: "),
    ("cloud", "list", partial(image_beside_lens, []), r"intrinsics\.json: it must be an object"),
    ("cloud", "focal", partial(image_beside_lens, {**LENS, "fx": "wide"}), r"intrinsics\.json: fx .* 'wide'"),
    ("cloud", "large", partial(image_beside_lens, {**LENS, "fx": 1e300}), r"intrinsics\.json: .* fx, fy"),
    ("cloud", "matrix", partial(image_beside_lens, {"K": {"rows": 3}}), r"intrinsics\.json: .* nine numbers"),
    ("cloud", "shape", partial(image_beside_lens, {**LENS, "width": 80, "height": 30}), "80 by 30, .* 40 by 30"),
    ("cloud", "width", partial(image_beside_lens, {**LENS, "width": 80}), r"80 by \?, .* 40 by 30"),
    ("cloud", "middle", partial(image_beside_lens, {**LENS, "cx": 60}), "cx 60 and cy 15, .* 40 by 30"),
    # Bags.
    ("cloud", "no.mcap", b"hello", "MCAP"),
    ("cloud", "no.db3", b"hello", "SQLite"),
    ("cloud", "no.bag", b"hello", "ROS 1"),
    ("cloud", "bomb.mcap", mcap_bomb, "TOPOKIT_UNPACKED"),
    ("cloud", "bomb.bag", ros1_bomb, "TOPOKIT_UNPACKED"),
    ("cloud", "message", packed_message, "TOPOKIT_UNPACKED"),
    ("cloud", "file", packed_file, "TOPOKIT_UNPACKED"),
    ("cloud", "computed", computed_messages, "messages"),
    ("cloud", "times", lambda path: edited(path, "UPDATE messages SET timestamp = 'now'"), "no time"),
    ("cloud", "colour", partial(depth_bag, info="/camera/colour/camera_info"), "needs its camera"),
    ("cloud", "silent", partial(depth_bag, info="/camera/depth/camera_info", empty=True), "needs its camera"),
    # Meshes.
    ("mesh", "a.obj", " \n\n", "empty"),
    ("mesh", "a.obj", "v 0 0 0\nv 1 0 0\n", "2 vertices"),
    ("mesh", "a.obj", TRIANGLE + "f 1 2 9\n", "vertex 8"),
    ("mesh", "a.obj", TRIANGLE + "f -9 2 3\n", "vertex -6"),
    ("mesh", "a.obj", TRIANGLE + "f 0 1 2\n", "line 5"),
    ("mesh", "a.obj", TRIANGLE + "f 1 2\n", "line 5"),
    ("mesh", "a.obj", TRIANGLE + "f 1 2 x\n", "line 5"),
    ("mesh", "a.obj", TRIANGLE + "v 0,5 1 2\n", "line 5"),
    ("mesh", "a.obj", "v 0 0\n" + TRIANGLE, "line 1"),
    ("mesh", "a.obj", TRIANGLE.replace("v 1 0 0", "v nan 0 0"), r"vertex 1 is at \[nan"),
    ("mesh", "a.obj", TRIANGLE.replace("v 1 0 0", "v 1e200 0 0"), r"vertex 1 is at \[1e\+200"),
    ("mesh", "a.obj", TRIANGLE.replace("v 1 0 0", "v 0 0 0"), "three different vertices"),
    ("mesh", "a.obj", TRIANGLE.replace(" 1", " 1e-120").replace("f 1e-120", "f 1"), "1e-120"),
    ("mesh", "a.obj", TRIANGLE + "f" + 400 * " 1 2 3" + "\n", "1200"),
    ("mesh", "a.obj", "\n<!DOCTYPE html><html><body>v 0 0 0</body></html>", "web page"),
    ("mesh", "a.obj", "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n", "git lfs pull"),
    ("mesh", "a.dae", TRIANGLE, r"\.dae"),
    ("mesh", "a.stl", os.mkfifo, "a pipe"),
    ("mesh", "a.ply", TRIANGLE, "PLY"),
    ("mesh", "a.ply", PLY.replace("ascii", "zip"), "zip"),
    ("mesh", "a.ply", PLY.replace("float y", "complex y"), "property complex y"),
    ("mesh", "a.ply", PLY.replace("property list uchar int", "property list"), "property list"),
    ("mesh", "a.ply", PLY.replace("element vertex", "element\nelement vertex"), "element"),
    ("mesh", "a.ply", PLY.replace("property float z", "property float w"), "x, y and z"),
    ("mesh", "a.ply", PLY.replace("property float x", "property list uchar float x"), ""),
    ("mesh", "a.ply", PLY.replace("element vertex", "property float w\nelement vertex"), ""),
    ("mesh", "a.ply", PLY.replace("vertex_indices", "corners"), "vertex_indices"),
    ("mesh", "a.ply", PLY.replace("3 0 1 2", "2 0 1"), "face 0"),
    ("mesh", "a.ply", PLY.replace("3 0 1 2", "3 0 1 7"), "vertex 7"),
    ("mesh", "a.ply", PLY.replace("3 0 1 2", "3 0 .5 2"), "face 0 names vertex 0.5"),
    ("mesh", "a.ply", PLY.replace("3 0 1 2", "3 0 1"), "1 rows .*'face'"),
    ("mesh", "a.ply", PLY.replace("3 0 1 2", "inf 0 1 2"), "1 rows .*'face'"),
    ("mesh", "a.ply", PLY.replace("3 0 1 2", "3 0 1 nan"), "face 0 names vertex nan"),
    ("mesh", "a.ply", PLY.replace("3 0 1 2", "900000000 0 1 2"), "'face'"),
    ("mesh", "a.ply", PLY.replace("1 0 0", "1 zero 0"), "3 rows .*'vertex'"),
    ("mesh", "a.ply", PLY.replace("vertex 3", "vertex 2000000000"), "2000000000 rows .*'vertex'"),
    ("mesh", "a.ply", PLY.replace("vertex 3", "vertex 9" + "9" * 30), "9" * 31),
    ("mesh", "a.ply", PLY.replace("vertex 3", "vertex -3"), "-3 rows .*'vertex'"),
    ("mesh", "a.ply", PLY.replace("element face", "element evil 2000000000\nproperty char x\nelement face"), "'evil'"),
    ("mesh", "a.stl", "no stl at all", "STL"),
    ("mesh", "a.stl", "solid x\nendsolid x\n", "no faces"),
    ("mesh", "a.stl", "solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n", "cut off"),
    ("mesh", "a.stl", "\0" * 80 + "\x09\0\0\0" + "\0" * 50, "9 triangles"),
    # Archives, whole ones whose parts do not fit among them.
    ("episode", "a.npz", b"", "empty"),
    ("episode", "a.npz", b"a,b,c\n1,2,3\n", "not a topokit episode"),
    ("episode", "a.npz", (DATA / "apron_hook_0.npz").read_bytes()[:3000], "truncated"),
    ("episode", "a.npz", npz(points=np.zeros((3, 4, 3))), "topokit did not write"),
    ("episode", "a.npz", lambda path: save_states(path, []), "holds a topokit states, not a topokit episode"),
    ("episode", "a.npz", None, "no such file"),
    ("episode", "folder.npz", Path.mkdir, "a folder"),
    ("episode", "null.npz", lambda path: path.symlink_to("/dev/null"), "a device"),
    ("episode", "a.npz", partial(zip_of, header__json=b"[" * 100_000), "nested"),
    ("episode", "a.npz", partial(zip_of, header__json=b"[]"), "no JSON object"),
    ("episode", "a.npz", partial(zip_of, header__json=b"\xff"), ""),
    ("episode", "a.npz", partial(zip_of, method=zipfile.ZIP_LZMA, header__json=b"{}"), "another method than deflate"),
    ("episode", "a.npz", partial(zip_of, header__json=b"{}", points__npy=ZEROS), "TOPOKIT_UNPACKED"),
    ("episode", "a.npz", episode_with(lambda head, _: head.update(schema=99)), "schema 99"),
    ("episode", "a.npz", episode_with(lambda head, _: head.update(loops=[[0.5, 1]])), "loop"),
    ("episode", "a.npz", episode_with(lambda head, _: head.update(loops=[[1, 10**30]])), "vertex 10{30}"),
    ("states", "a.npz", None, "no such file"),
    # Configurations.
    ("config", "a.json", "[" * 100_000, "a.json.*nested"),
    ("config", "a.json", "[1]", "object"),
    ("config", "a.json", '{"dt": NaN}', "dt"),
    ("config", "a.json", os.mkfifo, "a pipe"),
    ("training", "a.json", '{"model": "mlp", "split": {"share": 1}}', "split.share"),
    ("training", "a.json", '{"model": "mlp", "split": {"seed": -1}}', "split.seed"),
    ("training", "a.json", '{"model": "mlp", "windows": {"strides": 1}}', "windows.strides"),
    ("training", "a.json", '{"model": "motion", "windows": {"labels": "full"}}', "windows.labels"),
    ("training", "a.json", '{"model": "mlp", "rehearse": "a.json"}', "rehearse"),
]
READERS: dict[str, Callable[[Path], object]] = {
    "cloud": clouds,
    "mesh": Garment.from_mesh,
    "episode": load_episode,
    "states": load_states,
    "config": partial(load, SimulationConfig),
    "training": lambda path: TrainConfig.load(path).open_windows(),
}


def written(path: Path, content: Any) -> Path:
    """Write what was sent: bytes, text, or by a function of the path."""
    if callable(content):
        content(path)
    elif content is not None:
        path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


@pytest.mark.parametrize(
    ("reader", "name", "content", "says"), REFUSED, ids=[f"{i}-{r[1]}" for i, r in enumerate(REFUSED)]
)
def test_refused_in_words(reader, name, content, says, tmp_path):
    path = written(tmp_path / name, content)
    with bounded(), pytest.raises((ValueError, OSError)) as caught:
        READERS[reader](path)
    message = str(caught.value)
    assert name in message
    assert re.search(says, message), message
    assert message.isprintable()
    assert len(message) < 1000


# What is read, and as what: three corners, unless the row says other points.
READ: list[tuple[str, Any, Any]] = [
    ("small.pcd", PCD.replace("TYPE F F F", "TYPE f f f").replace("COUNT 1 1 1\n", ""), CORNERS),
    ("old.pcd", "# made long ago\n" + PCD.replace(".7", ".5").replace("FIELDS", "COLUMNS"), CORNERS),
    (
        "gap.pcd",
        PCD.replace("x y z", "_ x _ y z n")
        .replace("4 4 4", "4 4 4 4 4 4")
        .replace("F F F", "F F U F F F")
        .replace("1 1 1", "1 1 1 1 1 0")
        .split("0 0 1\n")[0]
        + "9 0 9 0 1\n9 1 9 0 1\n9 0 9 1 1\n",
        CORNERS,
    ),
    ("bom.pcd", "\ufeff" + PCD, CORNERS),
    ("blanks.pcd", PCD.replace("\n0 ", "\n\n 0  ").replace("\n", "\r\n"), CORNERS),
    (
        "names.pcd",
        PCD.replace("SIZE 4 4 4\n", "").replace("TYPE F F F\n", "").replace("COUNT 1 1 1\n", "").replace(".7", ".5"),
        CORNERS,
    ),
    (
        "none.pcd",
        PCD.split("0 0 1\n")[0].replace("WIDTH 3", "WIDTH 0").replace("POINTS 3", "POINTS 0"),
        np.zeros((0, 3)),
    ),
    ("blanks.ply", POINTS.replace("\n0 0 1", "\n\n0  0 1").replace("element vertex", "element  vertex"), CORNERS),
    ("line.ply", POINTS.replace("\n1 0 1\n", " 1 0 1 "), CORNERS),
    ("returns.ply", POINTS.replace("\n", "\r"), CORNERS),
    ("bom.ply", "\ufeff" + POINTS, CORNERS),
    ("after.ply", POINTS + "\x1a", CORNERS),
    ("comment.ply", POINTS.replace("element", "comment end_header is below\nelement", 1), CORNERS),
    ("none.ply", POINTS.split("0 0 1\n")[0].replace("vertex 3", "vertex 0"), np.zeros((0, 3))),
    ("mesh.ply", PLY, [[0, 0, 0], [1, 0, 0], [0, 0, 1]]),
    (
        "lists.ply",
        PLY.replace("ascii", "binary_big_endian").split("0 0 0\n")[0].replace("face 1", "face 2").encode()
        + np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1]], ">f4").tobytes()
        + b"\3"
        + np.arange(3, dtype=">i4").tobytes()
        + b"\2"
        + np.arange(2, dtype=">i4").tobytes(),
        [[0, 0, 0], [1, 0, 0], [0, 0, 1]],
    ),
    ("half.npy", npy((1000 * ring()).astype(np.float16)), ring()),
    ("channel.npy", npy(depth_image()[..., None]), None),
    ("a%20b#?.npz", npz(points=ring()), ring()),
    ("b%20c#?", lambda path: edited(path.with_name("bag"), "").rename(path), ring()),
    ("a b.bag", partial(save_ros1_bag, topics=CLOUD), ring()),
    ("packed", partial(save_bag, topics=CLOUD, storage=StoragePlugin.SQLITE3, mode=CompressionMode.MESSAGE), ring()),
    ("file", partial(save_bag, topics=CLOUD, mode=CompressionMode.FILE), ring()),
    ("chunks", partial(save_bag, topics=CLOUD, mode=CompressionMode.STORAGE), ring()),
    ("depth", partial(depth_bag, info="/camera/depth/camera_info"), None),
    ("frame", partial(depth_bag, info="/elsewhere/camera_info", frame="camera"), None),
]


@pytest.mark.parametrize(("name", "content", "points"), READ, ids=[row[0] for row in READ])
def test_read_as_it_is(name, content, points, tmp_path):
    """A depth image is compared with itself as a picture beside its lens."""
    path = written(tmp_path / name, content)
    asked: dict[str, Any] = {"unit": "mm"} if name == "half.npy" else {}
    if points is None:
        image_beside_lens(LENS, tmp_path / "other")
        (points,) = clouds(tmp_path / "other")
        asked = {"intrinsics": LENS} if name == "channel.npy" else {}
    with bounded():
        (found,) = clouds(path, **asked)
    np.testing.assert_allclose(found, points, atol=1e-3 if name == "half.npy" else 1e-6)


def test_mixed_binary_lists_are_refused_by_a_mesh_for_its_face_alone(tmp_path):
    path = written(tmp_path / "lists.ply", dict((row[0], row[1]) for row in READ)["lists.ply"])
    with pytest.raises(FormatError, match="face 1 has 2 corners"):
        Garment.from_mesh(path)


def test_yaml_and_definitions_of_messages_are_not_read(tmp_path):
    """Nine lists of nine aliases each would be 400 million words, and an array of a definition 8 GB."""
    bag = save_bag(tmp_path / "bag", CLOUD, StoragePlugin.SQLITE3)
    lines = [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9) if i else 'x'}]" for i in range(9)]
    metadata = bag / "metadata.yaml"
    metadata.write_text("\n".join(lines) + "\n" + metadata.read_text().replace("version: 9", "version: *a8"))
    with contextlib.closing(sqlite3.connect(next(bag.glob("*.db3")))) as tables:
        tables.executescript(
            "UPDATE message_definitions SET encoded_message_definition = 'float64[1000000000] a';"
            "UPDATE topics SET offered_qos_profiles = '&a [*a]';"
        )
    with bounded():
        np.testing.assert_array_equal(clouds(bag)[0], ring())
    (bag / "bag.db3").rename(bag / "other.db3")
    with pytest.raises(FileNotFoundError, match=r"bag\.db3"):
        clouds(bag)


def test_images_are_seen_by_the_lens_of_their_size(tmp_path):
    """Twice as wide and as high: each pixel of the small image is four of the large one."""
    image_beside_lens({**LENS, "width": 40, "height": 30}, tmp_path / "small")
    image_beside_lens({**LENS, "width": 40, "height": 30}, tmp_path / "large")
    (tmp_path / "large" / "0.png").write_bytes(png(np.kron(depth_image(), np.ones((2, 2), np.uint16))))
    (small,), (large,) = clouds(tmp_path / "small"), clouds(tmp_path / "large")
    means = large.reshape(30, 2, 40, 2, 3).mean(axis=(1, 3)).reshape(-1, 3)
    np.testing.assert_allclose(means, small, atol=1e-5)


def test_names_are_in_the_order_of_their_numbers(tmp_path):
    for names in (
        (".1", ".25", ".3"),
        ("-2", "-1", "0"),
        ("frame-1", "frame-2"),
        ("f.2", "f.10"),
        ("t_9.5", "t_10.25"),
    ):
        folder = tmp_path / names[0]
        folder.mkdir()
        for t, name in enumerate(names):
            np.save(folder / f"{name}.npy", ring(t))
        assert [cloud[0, 2] for cloud in clouds(folder)] == pytest.approx([1 + 0.01 * t for t in range(len(names))]), (
            names
        )


@pytest.mark.parametrize(("stamps", "times"), [((0.0, 0.5), (0, 0.5)), ((0.0, 0.0), (100, 101)), ((5.0, 6.0), (5, 6))])
def test_simulated_time_begins_at_zero(stamps, times, tmp_path):
    points = ring().reshape(6, 10, 3)
    bag = save_bag(tmp_path / "bag", {"/points": [cloud_message(points, stamp) for stamp in stamps]})
    assert [time for time, _ in read_clouds(bag)] == pytest.approx(times)


def test_a_bag_of_realsense_viewer_brings_lens_and_unit(tmp_path):
    """Of ROS 1, with topics of the viewer's own; a unit of depth is a tenth of a millimetre here."""
    unit = MESSAGES.types["std_msgs/msg/Float32"](1e-4)
    sensor = "/device_0/sensor_0"
    topics = {
        f"{sensor}/option/Depth_Units/value": [unit],
        "/device_0/sensor_1/Color_0/info/camera_info": [info_message(0, "0", focal=99.0)],
        "/device_0/sensor_1/Color_0/image/data": [image_message(np.zeros((30, 40), np.uint8), 0, "mono8")],
        f"{sensor}/Depth_0/info/camera_info": [info_message(0, "0")],
        f"{sensor}/Depth_0/image/data": [image_message(10 * depth_image(), t, "mono16") for t in (3, 4)],
    }
    found = list(read_clouds(save_ros1_bag(tmp_path / "viewer.bag", topics)))
    assert [time for time, _ in found] == [3, 4]
    image_beside_lens(LENS, tmp_path / "same")
    np.testing.assert_allclose(found[0][1], clouds(tmp_path / "same")[0], rtol=1e-5)


# -- streams ----------------------------------------------------------------------------------------------------------------


def stream(data: bytes) -> io.BufferedReader:
    return io.BufferedReader(io.BytesIO(data))


BAD_FRAMES = {
    "a header that declares more than there is memory": npy_header("(1000000000000, 3)"),
    "a header of half a gigabyte": b"\x93NUMPY\2\0" + (500_000_000).to_bytes(4, "little"),
    "a negative shape": npy_header("(-1, -3)", bytes(24)),
    "a shape of words": npy_header("('a', 3)"),
    "a header nested deep": npy_header("-" * 9000 + "1"),
    "a header that never ends": npy_header("(" * 5000),
    "a version to come": b"\x93NUMPY\x09\x00aaaa",
    "an end in the middle": npy_header("(4, 3)", bytes(24)),
    "no array": bytes(100),
    "objects": npy_header("(1,)", kind="|O"),
    "complex numbers": npy(np.zeros((5, 3), dtype=complex)),
}


@pytest.mark.parametrize("what", BAD_FRAMES)
def test_a_frame_of_a_stream_that_is_none_is_named(what):
    frames = read_stream(stream(npy(ring()) + BAD_FRAMES[what]))
    np.testing.assert_array_equal(next(frames), ring())
    with bounded(), pytest.raises(FormatError, match="frame 1"):
        next(frames)


def test_an_element_without_properties_takes_no_memory(tmp_path):
    (tmp_path / "a.ply").write_text(PLY.replace("element face", "element evil 2000000000\nelement face"))
    assert len(Garment.from_mesh(tmp_path / "a.ply").vertices) == 3


def test_a_heap_of_vertices_at_nearly_one_place_is_refused(tmp_path):
    """Its pairs, two million here, would be welded one by one."""
    heap = "".join(f"v {1e-9 * i} 0 0\n" for i in range(2000))
    (tmp_path / "a.obj").write_text(TRIANGLE + heap)
    with pytest.raises(ValueError, match=r"most vertices lie within .* of a hundred others"):
        Garment.from_mesh(tmp_path / "a.obj")


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl"])
def test_a_mesh_takes_a_hundred_times_its_file_at_most(tmp_path, suffix):
    """The densest files: a byte or two for each number."""
    n = 20_000
    dense = PLY.replace("ascii", "binary_little_endian").replace("float", "char").replace("uchar int", "uchar uchar")
    head = dense.replace("vertex 3", f"vertex {n}").replace("face 1", f"face {n}").split("0 0 0")[0]
    facet = b"facet normal vertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
    data = {
        ".ply": head.encode() + b"\0\1\2" * n + b"\3\0\1\2" * n,
        ".obj": b"v 0 0 0\n" * n + b"f 1 2 3\n" * n,
        ".stl": b"solid\n" + facet * n + b"endsolid",
    }[suffix]
    path = tmp_path / f"cloth{suffix}"
    path.write_bytes(data)
    with memory() as peak, contextlib.suppress(ValueError):
        Garment.from_mesh(path)
    assert peak() < 100 * len(data)


def test_work_for_a_mesh_is_bounded(tmp_path):
    """Cutting faces into triangles takes the square of their corners: thirty seconds here."""
    around = [f"v {np.cos(angle)} 0 {np.sin(angle)}" for angle in 2 * np.pi * np.arange(1000) / 1000]
    face = "f " + " ".join(map(str, range(1, 1001)))
    with bounded(), pytest.raises(ValueError, match=r"round.obj: 31 faces"):
        Garment.from_mesh(written(tmp_path / "round.obj", "\n".join([*around, *[face] * 31])))


# -- damage -----------------------------------------------------------------------------------------------------------------


WHOLE: dict[str, Any] = {
    "npy": npy(ring()),
    "npz": npz(points=[ring()]),
    "png": png(depth_image()),
    "ply": ply(),
    "ascii.ply": ply("ascii"),
    "pcd": pcd(),
    "binary.pcd": pcd(Encoding.BINARY),
    "mcap": partial(save_bag, topics=CLOUD, mode=CompressionMode.STORAGE),
    "db3": partial(save_bag, topics=CLOUD, storage=StoragePlugin.SQLITE3),
    "bag": partial(save_ros1_bag, topics=CLOUD),
}


@pytest.mark.parametrize("kind", WHOLE)
def test_a_cloud_of_any_bytes_is_read_or_refused(kind, tmp_path):
    """Bytes are changed, lost, or become large numbers, most of them in the header."""
    whole = WHOLE[kind]
    if callable(whole):
        path = whole(tmp_path / ("whole.bag" if kind == "bag" else "whole"))
        whole = (
            path if path.is_file() else next(file for file in path.iterdir() if file.suffix == f".{kind}")
        ).read_bytes()
    rng = np.random.default_rng(0)
    path, refused = tmp_path / f"damaged.{kind}", 0
    for _ in range(60):
        data = bytearray(whole)
        for at in rng.integers(min(len(data), 500), size=2).tolist():
            data[at : at + rng.integers(3)] = [bytes([rng.integers(256)]), b"", b"9999999"][rng.integers(3)]
        path.write_bytes(data)
        try:
            with bounded():
                clouds(path, intrinsics=LENS, unit="m")
        except FormatError:
            refused += 1
    assert refused > 5


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=200), st.sampled_from([".ply", ".obj", ".stl", ".stream"]), st.integers(0, 200))
@example(bytes(12) + b"\x81\x7f", ".stream", 190)  # a signalling NaN
def test_any_mesh_and_any_stream_is_read_or_refused(tmp_path_factory, noise, suffix, at):
    """A slice of `.github/fuzz_readers.py`, without coverage to guide it."""
    whole = {".ply": PLY.encode(), ".stream": npy(ring())}.get(suffix, TRIANGLE.encode())
    data = whole[:at] + noise + whole[at + len(noise) // 2 :]
    path = tmp_path_factory.getbasetemp() / f"fuzz{suffix}"
    path.write_bytes(data)
    with contextlib.suppress(ValueError), bounded():
        Garment.from_mesh(path) if suffix != ".stream" else list(read_stream(stream(data)))


@pytest.mark.parametrize("name", ["episode.npz", "film.npz"])
def test_a_flipped_bit_in_the_directory_of_an_archive_is_one_line(name, tmp_path, capsys):
    path = tmp_path / name
    if name == "film.npz":
        np.savez(path, points=[ring()])
    else:
        save_episode(path, load_episode(DATA / "apron_hook_0.npz"))
    raw = path.read_bytes()
    start = raw.rindex(b"PK\1\2", 0, len(raw))
    rng = np.random.default_rng(0)
    for at in rng.integers(start, len(raw), 40).tolist():
        path.write_bytes(raw[:at] + bytes([raw[at] ^ 1 << rng.integers(8)]) + raw[at + 1 :])
        code = main(["track", str(path), "--out", str(tmp_path / "none" / ".." / "a.jsonl")])
        captured = capsys.readouterr()
        assert code in (0, 2)
        assert code == 0 or captured.err.count("\n") == 1


# -- the command, and people who read what it prints --------------------------------------------------------------------------


def test_names_with_escapes_and_markup_do_not_reach_people(tmp_path, capsys):
    evil = "\x1b]0;x\x07</script><!--<script>\u202e"
    path = tmp_path / "a.npz"
    episode_with(lambda head, _: head.update(garment=evil))(path)
    assert main(["track", str(path)]) == 0
    assert all(line.isprintable() for line in capsys.readouterr().out.splitlines())
    episode = load_episode(path)
    page = player(episode, track(episode.points[:, ::20])).page
    data = page[page.index('type="application/json">') :]
    data = data[: data.index("</script>")]
    assert "<" not in data.partition(">")[2]
    assert json.loads(data.partition(">")[2])["title"].startswith(evil)


def test_a_file_is_no_garment_and_an_episode_has_a_whole_number():
    with pytest.raises(ValueError, match=r"from_mesh\('bag.obj'\)"):
        HangEnv(garment="bag.obj")
    with pytest.raises(ValueError, match="an episode"):
        Dataset(DATA / "dataset")[0.5]
