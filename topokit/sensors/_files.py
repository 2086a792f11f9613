"""Raw clouds from files and streams. What a file declares is compared with what it holds before memory is taken."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topokit._archive import HEADER, FormatError, check_size, existing, read_json
from topokit._validate import as_reals, positive

Array = NDArray[Any]
Frames = Iterator[tuple[float | None, Array]]

UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_INTRINSICS = "intrinsics.json"
_LARGEST = 30.0  # metres across: a room
_SMALLEST = 0.02  # metres across: smaller than any garment
_WIDEST = 16  # columns of a point, at most; an image has more
_IMAGE_SIZES = {(240, 320), (424, 512), (480, 640), (480, 848), (576, 640), (720, 1280), (1080, 1920)}  # depth cameras
_MOST_POINTS_A_BYTE = 100
_MOST_PIXELS = 2**26
_MOST_NUMBERS = 2**12  # numbers in a field of a point
_LARGEST_FRAME = 2**28  # bytes of a streamed cloud: eleven million points in space
_ROS_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_ROS_DEPTHS = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}


@dataclass(frozen=True)
class _Declared:
    """The caller's declarations about clouds."""

    unit: str | None = None
    columns: Sequence[int | str] | None = None
    intrinsics: Any = None
    topic: str | None = None

    def __post_init__(self) -> None:
        if self.unit not in (None, *UNITS):
            raise ValueError(f"unit must be one of {', '.join(UNITS)}, not {self.unit!r}")


def read_clouds(
    path: str | Path,
    *,
    unit: str | None = None,
    columns: Sequence[int | str] | None = None,
    intrinsics: Mapping[str, Any] | str | Path | None = None,
    topic: str | None = None,
    fps: float | None = None,
) -> Frames:
    """Yield the clouds (n, 3) of a film, raw and in metres, each with its time in seconds, or None when it has none.

    Files of NumPy need no extra; the others need ``pip install 'topokit[sensors]'``. `Cleaner` makes the clouds ready.

    Parameters
    ----------
    path : path
        A file .npy or .npz ((n, 3), (T, n, 3), (T, h, w, 3); or depth (h, w), (T, h, w)), .ply, .pcd, .png (depth of 16 bits);
        a bag of ROS 2; a folder or a pattern (``"film/*.pcd"``) of numbered files of one kind. An array (480, 640, 3), or of
        another size that depth cameras have, is one cloud; a film of that shape is stored as (480, 1, 640, 3).
    unit : {"m", "cm", "mm"}, optional
        Unit of the numbers: by default metres, and millimetres for depth in whole numbers. A cloud of an impossible size is
        refused. With a declared "m" the size is not checked.
    columns : sequence, optional
        Indices or names of the three numbers of a point that are its place; x, y and z, when the numbers have names.
    intrinsics : mapping or path, optional
        Intrinsics of a depth camera without distortion: fx, fy, cx, cy (or K), or a JSON file of them. By default they are
        read from the bag, or from intrinsics.json beside the image.
    topic : str, optional
        Topic of a bag.
    fps : float, optional
        Frames a second, for files without times.

    Raises
    ------
    FileNotFoundError, FormatError
        When a file is missing or unsound. The message names the file, the problem and a remedy.
    """
    declared = _Declared(unit, columns, intrinsics, topic)
    if fps is None:
        return _read(Path(path), declared)
    rate = positive(fps, "fps", zero=False)
    return ((number / rate, cloud) for number, (_, cloud) in enumerate(_read(Path(path), declared)))


def read_stream(
    stream: Any,
    *,
    unit: str | None = None,
    columns: Sequence[int | str] | None = None,
    intrinsics: Mapping[str, Any] | str | Path | None = None,
    check_unit: bool = True,
) -> Iterator[Array]:
    """Yield the clouds (n, d) of a stream of .npy arrays, one after another, until it ends.

    Parameters
    ----------
    stream : io.BufferedReader
        Stream to read, for example ``sys.stdin.buffer``.
    unit, columns, intrinsics
        The parameters of the same names of `read_clouds`.
    check_unit : bool
        Refuse clouds of an implausible size, unless the unit is declared as "m".

    Raises
    ------
    FormatError
        When a frame is unsound; the message names the frame and the problem. No array of more than 256 MiB is read.
    """
    declared = _Declared(unit, columns, intrinsics)
    unsure = check_unit and unit != "m"
    for number in count():
        if not stream.peek(1):
            return
        try:
            array = _next_array(stream)
        except Exception as error:  # a header can be wrong in a dozen ways
            raise FormatError(f"frame {number} on standard input is no whole .npy array: {error}") from error
        try:
            cloud = _as_cloud(array, declared, None)
            if unsure and _size_is_plausible(cloud, declared):
                unsure = False
        except ValueError as error:
            raise FormatError(f"frame {number} on standard input: {error}") from error
        yield cloud


def _next_array(stream: Any) -> Array:
    """Read the next array of a stream; memory is taken only when its header declares no more than a cloud."""
    version = np.lib.format.read_magic(stream)
    if version == (1, 0):
        shape, columns_first, kind = np.lib.format.read_array_header_1_0(stream)
    else:
        shape, columns_first, kind = np.lib.format.read_array_header_2_0(stream)
    size = math.prod(shape) * kind.itemsize
    if kind.hasobject or not 0 <= size <= _LARGEST_FRAME:
        raise ValueError(f"its header declares {size} bytes of {kind}; {_LARGEST_FRAME} of numbers at most")
    data = stream.read(size)
    if len(data) < size:
        raise ValueError(f"{len(data)} of {size} bytes")
    return np.ndarray(shape, kind, data, order="F" if columns_first else "C")


# -- the files of a film ----------------------------------------------------------------------------------------------------


def _read(path: Path, declared: _Declared) -> Frames:
    """Yield the clouds of a film in metres, each with its time; errors name the file."""
    unsure = declared.unit != "m"
    try:
        for file in _files_of(path):
            path = file  # the file that an error names
            for time, cloud in _READERS[_kind(file)](file, declared):
                if unsure and _size_is_plausible(cloud, declared):
                    unsure = False
                yield time, cloud
    except ModuleNotFoundError as error:
        package = str(error.name).partition(".")[0]
        raise ImportError(f"{path}: reading it needs {package}: pip install 'topokit[sensors]'") from error
    except FileNotFoundError:
        raise
    except ValueError as error:
        raise FormatError(f"{path}: {error}") from error
    except Exception as error:  # damage shows in a dozen ways
        raise FormatError(f"{path}: cut off or damaged: {type(error).__name__} {error}") from error


def _files_of(path: Path) -> list[Path]:
    """Return the files of a folder or of a pattern, in the order of the numbers in their names, or one file alone."""
    if path.is_dir() and _kind(path) not in _READERS:
        files = [file for file in path.iterdir() if _kind(file) in _READERS and not file.name.endswith(".tracks.npz")]
    elif not path.exists() and set(path.name) & set("*?["):
        files = list(path.parent.glob(path.name))
    elif path.is_dir():
        files = [path]
    else:
        files = [existing(path)]
    kinds = sorted({_kind(file) for file in files})
    if len(kinds) != 1 or kinds[0] not in _READERS:
        held = "no cloud"
        if kinds:
            held = "files " + ", ".join(kinds)
        raise FormatError(f"{path}: holds {held}; a film is one of {', '.join(_READERS)}")
    return sorted(files, key=_number_order)


def _number_order(file: Path) -> list[str]:
    return [word.zfill(20) for word in re.split(r"(\d+)", file.name)]


def _kind(path: Path) -> str:
    """Return the suffix of a name; a folder with a `metadata.yaml` is a bag of ROS 2."""
    if (path / "metadata.yaml").is_file():
        return ".mcap"
    return path.suffix.lower()


# -- from numbers to places in metres ---------------------------------------------------------------------------------------


def _size_is_plausible(cloud: Array, declared: _Declared) -> bool:
    """Return True if a cloud has a size to check; raise ValueError when that size is implausible."""
    seen = cloud[np.isfinite(cloud).all(axis=1) & cloud.any(axis=1)]
    if not len(seen):
        return False
    unit = declared.unit or "m"
    sample = seen[:: 1 + len(seen) // 10_000]
    low, high = np.quantile(sample, (0.05, 0.95), axis=0)
    size = float((high - low).max())
    across = f"it is {size / UNITS[unit]:.4g} {unit} across"
    if size > _LARGEST:
        raise ValueError(f"{across}: are these millimetres? Declare unit='mm' (--unit mm), or 'm' for metres")
    if 0 < size < _SMALLEST:
        raise ValueError(f"{across}: are these metres? Declare unit='m' (--unit m)")
    return True


def _as_cloud(frame: Array, declared: _Declared, camera: Path | Mapping[str, Any] | None) -> Array:
    """Return places (n, 3) in metres from rows or from an image.

    `camera` replaces intrinsics that were not declared: a description of the camera, or the folder of the image.
    """
    names = frame.dtype.names
    if names is None:
        if frame.ndim < 2 or len(frame) < 4 < _WIDEST < frame.shape[-1]:
            raise ValueError(f"it is of shape {frame.shape}; a cloud is (n, 3), one row a point")
        if declared.columns is None and frame.ndim == 2 and frame.shape[1] > _WIDEST:
            return _seen_by_pixels(as_reals(frame, "depth"), declared.intrinsics or camera, declared.unit)

    # Find the three numbers, by index or by name, that are the place.
    known: Any = names or range(frame.shape[-1])
    columns: Any = known
    if declared.columns:
        columns = declared.columns
    elif names:
        columns = ("x", "y", "z")
    missing = [name for name in columns if name not in known]
    if missing:
        raise ValueError(f"its points have no {missing[0]}: they have {', '.join(map(str, known))}")
    if len(columns) > 3:
        three = "a place has three: say which, as columns=(0, 1, 2) or --columns 0,1,2; the others may be colours"
        raise ValueError(f"{len(columns)} numbers a point, and {three}")

    if names:
        places = np.stack([as_reals(frame[name].ravel(), str(name)) for name in columns], axis=-1)
    else:
        places = as_reals(frame, "the array").reshape(-1, len(known))
        if columns != known:
            places = places[:, list(columns)]
    return np.asarray(places * UNITS[declared.unit or "m"], np.result_type(places.dtype, np.float32))


def _seen_by_pixels(depth: Array, camera: Any, unit: str | None) -> Array:
    """Return the places of pixels (h, w): right, down and forward; (0, 0, 0) for pixels without depth."""
    fx, fy, cx, cy, scale = _lens(camera)
    if unit is not None:
        scale = np.float32(UNITS[unit])
    elif depth.dtype.kind not in "iu":
        scale = np.float32(1.0)
    z = depth.astype(np.float32) * scale
    rows, columns = (np.arange(n, dtype=np.float32) for n in depth.shape)
    x = z * ((columns - cx) / fx)
    y = z * ((rows - cy) / fy)[:, None]
    return np.stack([x, y, z], axis=-1).reshape(-1, 3)


def _lens(camera: Any) -> Array:
    """Return fx, fy, cx, cy in pixels and the metres in a unit of depth, from a maker's description of a camera."""
    entries: Mapping[str, Any] = {}
    if isinstance(camera, Mapping):
        entries = camera
    elif isinstance(camera, Path) and camera.is_dir():
        if (camera / _INTRINSICS).is_file():
            entries = read_json((camera / _INTRINSICS).read_bytes())
    elif camera is not None:
        entries = read_json(existing(camera).read_bytes())

    # A matrix, as of a CameraInfo, or single entries.
    matrices = [entries[name] for name in ("K", "k", "camera_matrix", "intrinsic_matrix") if name in entries]
    if matrices:
        numbers = matrices[0]
        if isinstance(numbers, Mapping):
            numbers = numbers["data"]  # the form of OpenCV
        k = np.array(numbers, float).reshape(3, 3)
        if not k[0, 2]:
            k = k.T  # the form of Open3D, column by column
        entries = {**entries, "fx": k[0, 0], "fy": k[1, 1], "cx": k[0, 2], "cy": k[1, 2]}
    lens = []
    for names in (("fx",), ("fy",), ("cx", "ppx"), ("cy", "ppy")):
        values = [float(entries[name]) for name in names if name in entries]
        lens.append(values[0] if values else np.nan)
    scale = float(entries.get("depth_scale", 1e-3))
    if not np.isfinite([*lens, scale]).all() or not min(*lens[:2], scale) > 0:
        where = f"(JSON, as in a CameraInfo), as intrinsics=, --intrinsics FILE, or {_INTRINSICS} beside it"
        raise ValueError(f"a depth image needs its camera: fx, fy, cx and cy in pixels {where}")
    if scale >= 1:
        scale = 1 / scale  # units a metre
    return np.array([*lens, scale], np.float32)


# -- one reader for each kind of file ---------------------------------------------------------------------------------------


def _frames_of(array: Array) -> list[Array]:
    """Return the frames of (n, 3), (T, n, 3), (T, h, w, 3), (h, w) or (T, h, w); (h, w, 3) of a camera's size is one."""
    is_image = array.ndim == 3 and array.shape[:2] in _IMAGE_SIZES and array.shape[2] <= _WIDEST
    if array.ndim < 3 or array.dtype.names or is_image:
        return [array]
    return list(array)


def _npy(path: Path, declared: _Declared) -> Frames:
    for frame in _frames_of(np.load(path, mmap_mode="r", allow_pickle=False)):
        yield None, _as_cloud(frame, declared, path.parent)


def _npz(path: Path, declared: _Declared) -> Frames:
    """Yield the frames of the array `points`, or of its only array; several unnamed arrays are a cloud each."""
    with np.load(path, allow_pickle=False) as archive:
        check_size(archive.zip.infolist(), path.stat().st_size)
        names = [name for name in archive.files if name != "times"]
        if HEADER in names:
            raise ValueError("it is a file of topokit, not a film of clouds: read it by load_episode or load_states")
        if "points" in names:
            names = ["points"]
        is_film = bool(names) and all(name.startswith("arr_") for name in names)
        if len(names) != 1 and not is_film:
            raise ValueError(f"it holds {', '.join(names) or 'nothing'}: name the array of clouds 'points'")
        arrays = [archive[name] for name in names]
        frames = arrays
        if len(arrays) == 1:
            frames = _frames_of(arrays[0])
        times: Any = [None] * len(frames)
        if "times" in archive:
            times = archive["times"].tolist()
    if np.shape(times) != (len(frames),):
        raise ValueError(f"times has shape {np.shape(times)}; there are {len(frames)} clouds")
    for time, frame in zip(times, frames, strict=True):
        yield time, _as_cloud(frame, declared, path.parent)


def _ply(path: Path, declared: _Declared) -> Frames:
    from trimesh.exchange.ply import load_ply

    with path.open("rb") as handle:
        counted = re.search(rb"\nelement vertex (\d+)", handle.read(1 << 16))
        handle.seek(0)
        points = np.asarray(load_ply(handle, fix_texture=False, skip_materials=True).get("vertices", ()))
    if counted is None or int(counted[1]) != len(points):
        raise ValueError(f"cut off or damaged: it holds {len(points)} points, and its header declares another number")
    yield None, _as_cloud(points, declared, path.parent)


def _pcd(path: Path, declared: _Declared) -> Frames:
    from pypcd4.pypcd4 import MetaData, PointCloud

    data = path.read_bytes()
    head = re.match(rb"[^\0]{0,4096}?^DATA\s+(\w+)[^\n]*\n", data, re.MULTILINE)
    if head is None:
        raise ValueError("not a PCD file: its header has no line DATA")

    # What the header declares is compared with the file before anything is unpacked.
    header = MetaData.parse_header(head[0].decode(errors="replace").splitlines())
    numbers = max(header.count)
    unpacked = 0
    if b"compressed" in head[1]:
        unpacked = int.from_bytes(data[head.end() + 4 : head.end() + 8], "little")
    if max(header.points, unpacked) > _MOST_POINTS_A_BYTE * len(data) or numbers > _MOST_NUMBERS:
        raise ValueError(f"its {len(data)} bytes claim to hold {header.points} points, {numbers} numbers in a field")
    if header.data == "ascii":  # its reader takes one blank between numbers, and no other
        data = b"\n".join(b" ".join(line.split()) for line in data.splitlines())
    rows = np.atleast_1d(PointCloud.from_fileobj(io.BufferedReader(io.BytesIO(data))).pc_data)
    if len(rows) != header.points:
        raise ValueError(f"cut off or damaged: {len(rows)} of {header.points} points")
    yield None, _as_cloud(rows, declared, path.parent)


def _png(path: Path, declared: _Declared) -> Frames:
    from PIL import Image

    with Image.open(path, formats=["PNG"]) as picture:
        if not picture.mode.startswith("I") or np.prod(picture.size) > _MOST_PIXELS:
            words = f"a picture {picture.size} of mode {picture.mode}: a depth image has 16 bits a pixel"
            raise ValueError(f"{words}; a pattern ('depth*.png') leaves others out")
        yield None, _as_cloud(np.asarray(picture), declared, path.parent)


def _bag(path: Path, declared: _Declared) -> Frames:
    """Yield the messages of one topic of a bag, at the times in their headers."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as bag:

        def messages(topic: str) -> Iterator[tuple[float, Any]]:
            connections = [connection for connection in bag.connections if connection.topic == topic]
            for connection, received, raw in bag.messages(connections):
                yield 1e-9 * received, bag.deserialize(raw, connection.msgtype)

        kinds = {connection.topic: connection.msgtype.split("/")[-1] for connection in bag.connections}
        topic = _topic(kinds, declared.topic)

        # The camera of a depth image: the only one of its namespace, or of the bag.
        camera: dict[str, Any] = {}
        cameras = [name for name, kind in kinds.items() if kind == "CameraInfo"]
        namespace = PurePosixPath(topic).parent
        cameras = [name for name in cameras if PurePosixPath(name).parent == namespace] or cameras
        if len(cameras) == 1:
            camera["K"] = next(messages(cameras[0]))[1].k

        for received, message in messages(topic):
            stamp = message.header.stamp
            time = stamp.sec + 1e-9 * stamp.nanosec
            yield time or received, _as_cloud(_rows_of_message(message), declared, camera)


def _topic(kinds: Mapping[str, str], asked: str | None) -> str:
    """Return the named topic, or else the only topic of clouds, or the only topic of depth images."""
    clouds = [name for name, kind in kinds.items() if kind == "PointCloud2"]
    images = [name for name, kind in kinds.items() if kind == "Image"]
    if asked is None:
        likely = clouds or [name for name in images if "depth" in name]
    else:
        likely = [name for name in clouds + images if name == asked]
    if len(likely) != 1:
        listed = ", ".join(clouds + images) or "none of the types PointCloud2 and Image"
        raise ValueError(f"the topic is ambiguous; there is {listed}: name one as topic= or --topic")
    return likely[0]


def _rows_of_message(message: Any) -> Array:
    """Return the points of a PointCloud2, by their names, or the depths of an Image."""
    order = ">" if message.is_bigendian else "<"
    if hasattr(message, "fields"):
        kind = np.dtype(
            {
                "names": [field.name for field in message.fields],
                "formats": [order + _ROS_TYPES[field.datatype] for field in message.fields],
                "offsets": [field.offset for field in message.fields],
                "itemsize": message.point_step,
            }
        )
        steps = (message.row_step, message.point_step)
    elif message.encoding in _ROS_DEPTHS:
        kind = np.dtype(order + _ROS_DEPTHS[message.encoding])
        steps = (message.step, kind.itemsize)
    else:
        raise ValueError(f"images of encoding {message.encoding}: depth is one of {', '.join(_ROS_DEPTHS)}")
    # One place in the memory would be read as many points.
    if message.height > 1 and steps[0] < message.width * steps[1]:
        raise ValueError(f"rows of {steps[0]} bytes are none of {message.width} points")
    return np.ndarray((message.height, message.width), kind, message.data, strides=steps)


_READERS = {".npy": _npy, ".npz": _npz, ".ply": _ply, ".pcd": _pcd, ".png": _png, ".mcap": _bag, ".db3": _bag}
