"""Raw clouds from files. What a file declares is compared with what it holds before memory is taken."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from topokit._archive import FormatError, check_size, existing, read_json
from topokit._validate import as_reals, positive

Array = NDArray[Any]
Frames = Iterator[tuple[float | None, Array]]
UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_LENS = "intrinsics.json"
_LARGEST, _SMALLEST = 30.0, 0.02  # metres across: of a room, and of a garment
_WIDEST = 16  # columns that a point has; an image has more
_IMAGES = {(240, 320), (424, 512), (480, 640), (480, 848), (576, 640), (720, 1280), (1080, 1920)}  # of depth cameras
_RATIO, _PIXELS, _MOST_NUMBERS = 100, 2**26, 2**12  # what a file of a byte, an image, a field of a point may hold
_ROS_TYPES = dict(enumerate(("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"), 1))
_ROS_DEPTHS = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}


class Asked(NamedTuple):
    """What the caller declared."""

    unit: str | None = None
    columns: Sequence[int | str] | None = None
    intrinsics: Any = None
    topic: str | None = None


def _files(path: Path) -> list[Path]:
    """The files of a film in the order of the numbers in their names: those of a folder or of a pattern, or one alone."""
    if path.is_dir() and _kind(path) not in _READERS:
        files = [file for file in path.iterdir() if _kind(file) in _READERS and not file.name.endswith(".tracks.npz")]
    elif not path.exists() and set(path.name) & set("*?["):
        files = list(path.parent.glob(path.name))
    else:
        files = [path if path.is_dir() else existing(path)]
    kinds = sorted({_kind(file) for file in files})
    if len(kinds) != 1 or kinds[0] not in _READERS:
        held = "files " + ", ".join(kinds) if kinds else "no cloud"
        raise FormatError(f"{path}: holds {held}; a film is one of {', '.join(_READERS)}")
    return sorted(files, key=lambda file: [part.zfill(20) for part in re.split(r"(\d+)", file.name)])


def _kind(path: Path) -> str:
    """How a name ends; a folder with a `metadata.yaml` is a bag of ROS 2."""
    return ".mcap" if (path / "metadata.yaml").is_file() else path.suffix.lower()


def read(path: Path, asked: Asked) -> Frames:
    """The clouds of a film in metres, each with its time; whatever is wrong with a file names it."""
    unsure, files = asked.unit != "m", _files(path)
    try:
        for path in files:
            for time, cloud in _READERS[_kind(path)](path, asked):
                unsure = unsure and not has_unit(cloud, asked)
                yield time, cloud
    except ModuleNotFoundError as error:
        wanted = str(error.name).partition(".")[0]
        raise ImportError(f"{path}: reading it needs {wanted}: pip install 'topokit[sensors]'") from error
    except FileNotFoundError:
        raise
    except ValueError as error:
        raise FormatError(f"{path}: {error}") from error
    except Exception as error:  # damage shows in a dozen ways
        raise FormatError(f"{path}: cut off or damaged: {type(error).__name__} {error}") from error


def has_unit(cloud: Array, asked: Asked) -> bool:
    """Whether there is something, which is then of a size that can be meant."""
    unit = asked.unit or "m"
    seen = cloud[np.isfinite(cloud).all(axis=1) & cloud.any(axis=1)]
    if len(seen):
        size = float(np.ptp(np.quantile(seen[:: 1 + len(seen) // 10_000], (0.05, 0.95), axis=0), axis=0).max())
        across = f"it is {size / UNITS[unit]:.4g} {unit} across"
        if size > _LARGEST:
            raise ValueError(f"{across}: are these millimetres? Declare unit='mm' (--unit mm), or 'm' for metres")
        if 0 < size < _SMALLEST:
            raise ValueError(f"{across}: are these metres? Declare unit='m' (--unit m)")
    return len(seen) > 0


def as_cloud(frame: Array, asked: Asked, camera: Path | Mapping[str, Any]) -> Array:
    """Places (n, 3) in metres, of rows or of an image; its camera, when none was declared, or the folder of its file."""
    names: Any = frame.dtype.names
    if names is None and (frame.ndim < 2 or len(frame) < 4 < _WIDEST < frame.shape[-1]):
        raise ValueError(f"it is of shape {frame.shape}; a cloud is (n, 3), one row a point")
    if names is None and asked.columns is None and frame.ndim == 2 and frame.shape[1] > _WIDEST:
        return _seen(as_reals(frame, "depth"), asked.intrinsics or camera, asked.unit)
    known = names or range(frame.shape[-1])
    columns: Any = asked.columns or (("x", "y", "z") if names else known)
    if missing := [name for name in columns if name not in known]:
        raise ValueError(f"its points have no {missing[0]}: they have {', '.join(map(str, known))}")
    if len(columns) > 3:
        three = "a place has three: say which, as columns=(0, 1, 2) or --columns 0,1,2; the others may be colours"
        raise ValueError(f"{len(columns)} numbers a point, and {three}")
    if names:
        places = np.stack([as_reals(frame[name].ravel(), str(name)) for name in columns], axis=-1)
    else:
        places = as_reals(frame, "the array").reshape(-1, len(known))
        places = places if columns == known else places[:, list(columns)]
    return np.asarray(places * UNITS[asked.unit or "m"], np.result_type(places.dtype, np.float32))


def _seen(depth: Array, camera: Any, unit: str | None) -> Array:
    """What pixels (h, w) see, to the right, down and forward; (0, 0, 0) where they see nothing."""
    fx, fy, cx, cy, scale = _lens(camera)
    scale = np.float32(UNITS[unit] if unit else scale if depth.dtype.kind in "iu" else 1.0)
    z = depth.astype(np.float32) * scale
    rows, columns = (np.arange(n, dtype=np.float32) for n in depth.shape)
    return np.stack([z * ((columns - cx) / fx), z * ((rows - cy) / fy)[:, None], z], axis=-1).reshape(-1, 3)


def _lens(source: Any) -> Array:
    """fx, fy, cx, cy in pixels and the metres of a unit of depth: of a camera without distortion, as its makers write it."""
    if isinstance(source, Path) and source.is_dir():
        source = source / _LENS if (source / _LENS).is_file() else {}
    entries = source if isinstance(source, Mapping) else read_json(existing(source).read_bytes())
    matrix = next((entries[name] for name in ("K", "k", "camera_matrix", "intrinsic_matrix") if name in entries), None)
    if matrix is not None:
        k = np.array(matrix["data"] if isinstance(matrix, Mapping) else matrix, float).reshape(3, 3)
        k = k if k[0, 2] else k.T  # Open3D writes it column by column
        entries = {**entries, "fx": k[0, 0], "fy": k[1, 1], "cx": k[0, 2], "cy": k[1, 2]}
    names = (("fx",), ("fy",), ("cx", "ppx"), ("cy", "ppy"))
    lens = [next((float(entries[name]) for name in some if name in entries), np.nan) for some in names]
    scale = float(entries.get("depth_scale", 1e-3))
    if not np.isfinite([*lens, scale]).all() or not min(*lens[:2], scale) > 0:
        where = f"(JSON, as in a CameraInfo), as intrinsics=, --intrinsics FILE, or {_LENS} beside it"
        raise ValueError(f"a depth image needs its camera: fx, fy, cx and cy in pixels {where}")
    return np.array([*lens, scale if scale < 1 else 1 / scale], np.float32)


def _film(array: Array) -> list[Array]:
    """The frames of (n, 3), (T, n, 3), (T, h, w, 3), (h, w) or (T, h, w); (h, w, 3) is one, when of a camera's size."""
    is_image = array.ndim == 3 and array.shape[:2] in _IMAGES and array.shape[2] <= _WIDEST
    return [array] if array.ndim < 3 or array.dtype.names or is_image else list(array)


def _npy(path: Path, asked: Asked) -> Frames:
    film = _film(np.load(path, mmap_mode="r", allow_pickle=False))
    yield from ((None, as_cloud(frame, asked, path.parent)) for frame in film)


def _npz(path: Path, asked: Asked) -> Frames:
    """The array `points`, or the only one besides `times`; several without names are a cloud each."""
    with np.load(path, allow_pickle=False) as archive:
        check_size(archive.zip.infolist(), path.stat().st_size)
        names = [name for name in archive.files if name != "times"]
        if "json" in names:
            raise ValueError("topokit wrote it, and it holds no film: read it by load_episode or load_states")
        names = ["points"] if "points" in names else names
        if len(names) != 1 and not all(name.startswith("arr_") for name in names or ["nothing"]):
            raise ValueError(f"it holds {', '.join(names) or 'nothing'}: name the array of clouds 'points'")
        parts = [archive[name] for name in names]
        film = _film(parts[0]) if len(parts) == 1 else parts
        times = archive["times"].tolist() if "times" in archive else [None] * len(film)
    if np.shape(times) != (len(film),):
        raise ValueError(f"times has shape {np.shape(times)}; there are {len(film)} clouds")
    yield from ((time, as_cloud(frame, asked, path.parent)) for time, frame in zip(times, film, strict=True))


def _ply(path: Path, asked: Asked) -> Frames:
    from trimesh.exchange.ply import load_ply

    with path.open("rb") as handle:
        counted = re.search(rb"\nelement vertex (\d+)", handle.read(1 << 16))
        handle.seek(0)
        points = np.asarray(load_ply(handle, fix_texture=False, skip_materials=True).get("vertices", ()))
    if counted is None or int(counted[1]) != len(points):
        raise ValueError(f"cut off or damaged: it holds {len(points)} points, and its header counts others")
    yield None, as_cloud(points, asked, path.parent)


def _pcd(path: Path, asked: Asked) -> Frames:
    from pypcd4.pypcd4 import MetaData, PointCloud

    data = path.read_bytes()
    head = re.match(rb"[^\0]{0,4096}?^DATA\s+(\w+)[^\n]*\n", data, re.MULTILINE)
    if head is None:
        raise ValueError("not a PCD file: its header has no line DATA")
    declared = MetaData.parse_header(head[0].decode(errors="replace").splitlines())
    points, count = declared.points, max(declared.count)
    packed = int.from_bytes(data[head.end() + 4 : head.end() + 8], "little") if b"compressed" in head[1] else 0
    if max(points, packed) > _RATIO * len(data) or count > _MOST_NUMBERS:
        raise ValueError(f"its {len(data)} bytes claim to hold {points} points, {count} numbers in a field")
    if declared.data == "ascii":  # its reader takes one blank between numbers, and no other
        data = b"\n".join(b" ".join(line.split()) for line in data.splitlines())
    rows = np.atleast_1d(PointCloud.from_fileobj(io.BufferedReader(io.BytesIO(data))).pc_data)
    if len(rows) != points:
        raise ValueError(f"cut off or damaged: {len(rows)} of {points} points")
    yield None, as_cloud(rows, asked, path.parent)


def _png(path: Path, asked: Asked) -> Frames:
    from PIL import Image

    with Image.open(path, formats=["PNG"]) as picture:
        if not picture.mode.startswith("I") or np.prod(picture.size) > _PIXELS:
            words = f"a picture {picture.size} of mode {picture.mode}: a depth image has 16 bits a pixel"
            raise ValueError(f"{words}; a pattern ('depth*.png') leaves others out")
        yield None, as_cloud(np.asarray(picture), asked, path.parent)


def _bag(path: Path, asked: Asked) -> Frames:
    """The messages of one topic of a bag, at the times in their headers."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as bag:
        kinds = {each.topic: each.msgtype.split("/")[-1] for each in bag.connections}
        topic, lens = _topic(kinds, asked.topic), dict[str, Any]()

        def messages(name: str) -> Iterator[tuple[float, Any]]:
            for each, stamp, raw in bag.messages([each for each in bag.connections if each.topic == name]):
                yield 1e-9 * stamp, bag.deserialize(raw, each.msgtype)

        infos = [name for name, kind in kinds.items() if kind == "CameraInfo"]
        beside = [name for name in infos if PurePosixPath(name).parent == PurePosixPath(topic).parent]
        if len(beside or infos) == 1:
            lens["K"] = next(messages((beside or infos)[0]))[1].k
        for received, message in messages(topic):
            stamp = message.header.stamp
            yield stamp.sec + 1e-9 * stamp.nanosec or received, as_cloud(rows_of(message), asked, lens)


def _topic(kinds: Mapping[str, str], asked: str | None) -> str:
    """The topic that was asked for, or the only one of clouds, or the only one of depth images."""
    clouds, images = ([name for name, kind in kinds.items() if kind == one] for one in ("PointCloud2", "Image"))
    likely = clouds or [name for name in images if "depth" in name]
    found = likely if asked is None else [name for name in clouds + images if name == asked]
    if len(found) != 1:
        there = ", ".join(clouds + images) or "none of the types PointCloud2 and Image"
        raise ValueError(f"which topic? There is {there}: name one as topic= or --topic")
    return found[0]


def rows_of(message: Any) -> Array:
    """The points of a PointCloud2, by their names, or the depths of an Image."""
    order = ">" if message.is_bigendian else "<"
    if hasattr(message, "fields"):
        parts = [(field.name, order + _ROS_TYPES[field.datatype], field.offset) for field in message.fields]
        layout = dict(zip(("names", "formats", "offsets"), map(list, zip(*parts, strict=True)), strict=True))
        kind = np.dtype({**layout, "itemsize": message.point_step})  # type: ignore[call-overload]
        steps = (message.row_step, message.point_step)
    elif message.encoding in _ROS_DEPTHS:
        kind = np.dtype(order + _ROS_DEPTHS[message.encoding])
        steps = (message.step, kind.itemsize)
    else:
        raise ValueError(f"images of encoding {message.encoding}: depth is one of {', '.join(_ROS_DEPTHS)}")
    if message.height > 1 and steps[0] < message.width * steps[1]:  # one place in the memory would be many points
        raise ValueError(f"rows of {steps[0]} bytes are none of {message.width} points")
    return np.ndarray((message.height, message.width), kind, message.data, strides=steps)


_READERS = {".npy": _npy, ".npz": _npz, ".ply": _ply, ".pcd": _pcd, ".png": _png, ".mcap": _bag, ".db3": _bag}


def read_clouds(
    path: str | Path,
    *,
    unit: str | None = None,
    columns: Sequence[int | str] | None = None,
    intrinsics: Mapping[str, Any] | str | Path | None = None,
    topic: str | None = None,
    fps: float | None = None,
) -> Iterator[tuple[float | None, NDArray[Any]]]:
    """Yield the clouds (n, 3) of a film, raw and in metres, each with its time in seconds, or None where none is known.

    It needs ``pip install 'topokit[sensors]'``, but for NumPy's files. `topokit.sensors.Cleaner` makes the clouds ready.

    Parameters
    ----------
    path : path
        A file .npy or .npz ((n, 3), (T, n, 3), (T, h, w, 3); or depth (h, w), (T, h, w)), .ply, .pcd, .png (depth of 16 bits);
        a bag of ROS 2; a folder or a pattern (``"film/*.pcd"``) of numbered files of one kind. An array (480, 640, 3), or of
        another size that depth cameras have, is one cloud; a film of that shape is stored as (480, 1, 640, 3).
    unit : {"m", "cm", "mm"}, optional
        Metres when not given, millimetres for depth in whole numbers; what can be neither is refused. "m" is believed.
    columns : sequence, optional
        Which three of the numbers of a point, or of their names, are its place; x, y and z, when they are named.
    intrinsics : mapping or path, optional
        Of a depth camera without distortion: fx, fy, cx, cy (or K), or a JSON file of them; when not given, those in the bag, or
        in intrinsics.json beside the image.
    topic : str, optional
        Of a bag.
    fps : float, optional
        Frames a second, for files without times.

    Raises
    ------
    FileNotFoundError, FormatError
        The message says which file, what is wrong, and what to do.
    """
    if unit not in (None, *UNITS):
        raise ValueError(f"unit must be one of {', '.join(UNITS)}, not {unit!r}")
    rate = None if fps is None else positive(fps, "fps", zero=False)
    film = enumerate(read(Path(path), Asked(unit, columns, intrinsics, topic)))
    return ((number / rate if rate else time, cloud) for number, (time, cloud) in film)
