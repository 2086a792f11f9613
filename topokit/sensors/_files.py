"""Raw clouds from files and streams. What a file declares is compared with what it holds before memory is taken."""

from __future__ import annotations

import codecs
import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import count
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topokit._archive import HEADER, FormatError, check_size, existing, read_array_header, read_json
from topokit._ply import read_ply
from topokit._strangers import check_unpacked
from topokit._validate import as_reals, positive

from ._pcd import read_pcd, rows_of

Array = NDArray[Any]
Frames = Iterator[tuple[float | None, Array]]

UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_INTRINSICS = "intrinsics.json"
_LARGEST = 30.0  # metres across: a room
_SMALLEST = 0.02  # metres across: smaller than any garment
_WIDEST = 16  # columns of a point, at most; an image has more
_IMAGE_SIZES = {(240, 320), (424, 512), (480, 640), (480, 848), (576, 640), (720, 1280), (1080, 1920)}  # depth cameras
_MOST_PIXELS = 1e6  # of a focal length
_BYTES_A_PIXEL = 4  # of a depth image, in the reckoning of what it may unpack to; its cloud takes ten times as much
_NUMBER = re.compile(r"((?<![0-9A-Za-z])-(?=\.?\d)|)((?<![A-Za-z])(?:\d+\.\d+|\.\d+)|\d+)")
_ROS_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_ROS_DEPTHS = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}


@dataclass(frozen=True)
class _Declared:
    """The caller's declarations about clouds."""

    unit: str | None = None
    columns: Sequence[int | str] | None = None
    intrinsics: Any = None
    topic: str | None = None
    fps: float | None = None

    def __post_init__(self) -> None:
        if self.unit not in (None, *UNITS):
            raise ValueError(f"unit must be one of {', '.join(UNITS)}, not {self.unit!r}")
        if not isinstance(self.intrinsics, (str, Path, Mapping, type(None))):
            kinds = "a mapping such as {'fx': 600, 'fy': 600, 'cx': 320, 'cy': 240}, or the path of a JSON file"
            raise TypeError(f"intrinsics must be {kinds}, not {type(self.intrinsics).__name__}")


def read_clouds(
    path: str | Path,
    *,
    unit: str | None = None,
    columns: Sequence[int | str] | None = None,
    intrinsics: Mapping[str, Any] | str | Path | None = None,
    topic: str | None = None,
    fps: float | None = None,
) -> Frames:
    """Yield the clouds of a film, raw and in metres, each with its time in seconds, or None when it has none.

    A cloud is (n, 3), or (n, 2) where the file has two numbers a point.

    Files of NumPy need no extra; the others need ``pip install 'topokit[sensors]'``. `Cleaner` makes the clouds ready.

    Parameters
    ----------
    path : path
        A file .npy or .npz ((n, 3), (T, n, 3), (T, h, w, 3); or depth (h, w), (T, h, w)), .ply, .pcd, .png (depth of 16 bits);
        a bag of ROS 1 or ROS 2; a folder or a pattern (``"film/*.pcd"``) of numbered files of one kind. An array (480, 640, 3),
        or of another size that depth cameras have, is one cloud; a film of that shape is stored as (480, 1, 640, 3).
    unit : {"m", "cm", "mm"}, optional
        Unit of the numbers: by default metres, and millimetres for depth in whole numbers. A cloud of an impossible size is
        refused. With a declared "m" the size is not checked.
    columns : sequence, optional
        Indices or names of the three numbers of a point that are its place; x, y and z, when the numbers have names.
    intrinsics : mapping or path, optional
        Intrinsics of a depth camera without distortion: fx, fy, cx, cy (or K), or a JSON file of them. By default they are
        read from the bag, or from intrinsics.json beside the image. With a width and a height they are scaled to an image of
        another size, and an image of another shape is refused.
    topic : str, optional
        Topic of a bag.
    fps : float, optional
        Frames a second, for files without times, or in place of the times that they have.

    Raises
    ------
    FileNotFoundError, FormatError
        When a file is missing or unsound, or unpacks to more than 64 MiB plus 100 times its size (the environment variable
        TOPOKIT_UNPACKED raises the 64 MiB). Files are opened when the first cloud is asked for. The message names the file, the
        problem and a remedy.
    TypeError, ValueError
        When an option has another kind or value than those above.
    ImportError
        When a package is missing that files of this kind need.
    """
    rate = None if fps is None else positive(fps, "fps", zero=False)
    return _read(Path(path), _Declared(unit, columns, intrinsics, topic, rate))


def read_stream(
    stream: Any,
    *,
    unit: str | None = None,
    columns: Sequence[int | str] | None = None,
    intrinsics: Mapping[str, Any] | str | Path | None = None,
    check_unit: bool = True,
) -> Iterator[Array]:
    """Yield the clouds, in metres, of a stream of .npy arrays, one after another, until it ends.

    A cloud is (n, 3) or (n, 2). An array may hold one cloud or several, as a file may for `read_clouds`.

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
        When a frame is unsound; the message names the frame and the problem. No array of more than 64 MiB is read, unless the
        environment variable TOPOKIT_UNPACKED allows it.
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
        for frame in _frames_of(array):
            try:
                cloud = _as_cloud(frame, declared, None)
                if unsure and _size_is_plausible(cloud, declared):
                    unsure = False
            except ValueError as error:
                raise FormatError(f"frame {number} on standard input: {error}") from error
            yield cloud


def _next_array(stream: Any) -> Array:
    """Read the next array of a stream; memory is taken only when its header declares no more than a cloud."""
    shape, columns_first, kind = read_array_header(stream)
    size = math.prod(shape) * kind.itemsize
    check_unpacked(size, 0)
    data = stream.read(size)
    if len(data) < size:
        raise ValueError(f"{len(data)} of {size} bytes")
    return np.ndarray(shape, kind, data, order="F" if columns_first else "C")


# -- the files of a film ----------------------------------------------------------------------------------------------------


def _read(path: Path, declared: _Declared) -> Frames:
    """Yield the clouds of a film in metres, each with its time; errors name the file."""
    unsure = declared.unit != "m"
    numbers = count()
    before: float | None = None
    try:
        for file in _files_of(path):
            path = file  # the file that an error names
            for time, cloud in _READERS[_kind(file)](file, declared):
                if unsure and _size_is_plausible(cloud, declared):
                    unsure = False
                number = next(numbers)
                if declared.fps is not None:
                    time = number / declared.fps
                elif time is not None and before is not None and time <= before:
                    told = f"frame {number} has the time {time:.9g} s, the frame before it {before:.9g} s"
                    raise ValueError(f"{told}: give the frames a second, as fps= or --fps, to count them instead")
                before = time
                yield time, cloud
    except ModuleNotFoundError as error:
        package = str(error.name).partition(".")[0]
        raise ImportError(f"{path}: reading it needs {package}: pip install 'topokit[sensors]'") from error
    except (FileNotFoundError, FormatError):  # they name the file
        raise
    except ValueError as error:
        raise FormatError(f"{path}: {error}") from error
    except MemoryError as error:
        raise FormatError(f"{path}: reading it takes more memory than there is") from error
    except Exception as error:  # damage shows in a dozen ways
        raise FormatError(f"{path}: cut off or damaged: {type(error).__name__} {error}") from error


def _files_of(path: Path) -> list[Path]:
    """Return the files of a folder or of a pattern, in the order of the numbers in their names, or one file alone."""
    if path.is_dir() and _kind(path) not in _READERS:
        files = [file for file in path.iterdir() if _kind(file) in _READERS and not file.name.endswith(".tracks.npz")]
    elif not path.exists() and set(path.name) & set("*?["):
        files = list(path.parent.glob(path.name))
    elif path.is_dir():
        return [path]
    else:
        files = [path]
    files = [file if file.is_dir() else existing(file) for file in files]
    kinds = sorted({_kind(file) for file in files})
    if len(kinds) != 1 or kinds[0] not in _READERS:
        held = "no cloud"
        if kinds:
            held = "files " + ", ".join(kinds)
        raise FormatError(f"{path}: holds {held}; a film is one of {', '.join(_READERS)}")
    return sorted(files, key=lambda file: natural_order(file.stem))


def natural_order(name: str) -> list[Any]:
    """Return a key that sorts names by the numbers in them: -2, -1, 0.1, 0.25, 0.3, 9, 10.

    A minus or a point behind a letter separates words (frame-1, frame.10).
    """
    key: list[Any] = []
    end = 0
    for match in _NUMBER.finditer(name):
        key += [name[end : match.start()], Decimal(match[0])]
        end = match.end()
    return [*key, name[end:]]


def _kind(path: Path) -> str:
    """Return the suffix of a name; a folder with a `metadata.yaml` is a bag of ROS 2, and so is a packed file of one."""
    if (path / "metadata.yaml").is_file() or path.name.endswith((".mcap.zstd", ".db3.zstd")):
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
    return size > 0


def _as_cloud(frame: Array, declared: _Declared, camera: Path | Mapping[str, Any] | None) -> Array:
    """Return places (n, 3) in metres from rows or from an image.

    `camera` replaces intrinsics that were not declared: a description of the camera, or the folder of the image.
    """
    names = frame.dtype.names
    if names is None and frame.ndim == 3 and frame.shape[2] == 1:
        frame = frame[..., 0]  # an image with its one channel on an axis of its own
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
    if len(columns) < 2 or len(set(columns)) < len(columns):
        raise ValueError(f"the place of a point is three different numbers, or two in the plane, not {list(columns)}")

    if names:
        places = np.stack([as_reals(frame[name].ravel(), str(name)) for name in columns], axis=-1)
    else:
        places = as_reals(frame, "the array").reshape(-1, len(known))
        if columns != known:
            places = places[:, list(columns)]
    # In float64: 16 bits of floating point hold no hundredth of a millimetre.
    scaled = places * np.float64(UNITS[declared.unit or "m"])
    return np.asarray(scaled, np.result_type(places.dtype, np.float32))


def _seen_by_pixels(depth: Array, camera: Any, unit: str | None) -> Array:
    """Return the places of pixels (h, w): right, down and forward; (0, 0, 0) for pixels without depth."""
    lens = _lens(camera, depth.shape)
    scale = lens[4]
    if unit is not None:
        scale = UNITS[unit]
    elif depth.dtype.kind not in "iu":
        scale = 1.0
    z = np.asarray(
        depth.astype(np.float64) * scale, np.float32
    )  # millimetres do not fit into 16 bits of floating point
    fx, fy, cx, cy = np.array(lens[:4], np.float32)
    rows, columns = (np.arange(n, dtype=np.float32) for n in depth.shape)
    x = z * ((columns - cx) / fx)
    y = z * ((rows - cy) / fy)[:, None]
    return np.stack([x, y, z], axis=-1).reshape(-1, 3)


def _lens(camera: Any, shape: tuple[int, ...]) -> list[float]:
    """Return fx, fy, cx, cy in pixels of an image (h, w) and the metres in a unit of depth, from a maker's description."""
    if camera is None or isinstance(camera, Mapping):
        return _numbers_of_lens(camera or {}, shape)
    file = Path(camera)
    if file.is_dir():
        file /= _INTRINSICS
        if not file.exists():
            return _numbers_of_lens({}, shape)
    try:
        entries = read_json(existing(file).read_bytes())
        if not isinstance(entries, Mapping):
            raise ValueError("it must be an object with named entries")
        return _numbers_of_lens(entries, shape)
    except (ValueError, TypeError, KeyError) as error:
        raise FormatError(f"{file}: {error}") from error


def _numbers_of_lens(entries: Mapping[str, Any], shape: tuple[int, ...]) -> list[float]:
    """Return the numbers of a lens for an image of this shape; they are scaled to it from the size that they are for."""
    matrices = [entries[name] for name in ("K", "k", "camera_matrix", "intrinsic_matrix") if name in entries]
    if matrices:
        numbers = matrices[0]
        if isinstance(numbers, Mapping):
            numbers = numbers.get("data", ())  # the form of OpenCV
        k = as_reals(numbers, "the matrix of a camera").astype(float)
        if k.size != 9:
            raise ValueError(f"the matrix of a camera has nine numbers, not {k.size}")
        k = k.reshape(3, 3)
        if not k[0, 2]:
            k = k.T  # the form of Open3D, column by column
        entries = {**entries, "fx": k[0, 0], "fy": k[1, 1], "cx": k[0, 2], "cy": k[1, 2]}
    lens = []
    for name, other in (("fx", ""), ("fy", ""), ("cx", "ppx"), ("cy", "ppy")):
        value = entries.get(name, entries.get(other, math.nan))
        lens.append(_number(value, name))
    scale = _number(entries.get("depth_scale", 1e-3), "depth_scale")
    if not all(abs(number) < _MOST_PIXELS for number in [*lens, scale]) or not min(*lens[:2], scale) > 0:
        where = f"(JSON, as in a CameraInfo), as intrinsics=, --intrinsics FILE, or {_INTRINSICS} beside it"
        raise ValueError(f"a depth image needs its camera: fx, fy, cx and cy in pixels {where}")
    if scale >= 1:
        scale = 1 / scale  # units a metre

    # Centres of pixels are whole numbers, so their borders are at halves: these are what is scaled.
    size = [_number(entries.get(name, entries.get(f"image_{name}", 0)), name) for name in ("width", "height")]
    fx, fy, cx, cy = lens
    pixels = (shape[1], shape[0])
    differs = any(declared not in (0, given) for declared, given in zip(size, pixels, strict=True))
    if differs:
        factor = shape[1] / (size[0] or math.inf)
        if not math.isclose(factor, shape[0] / (size[1] or math.inf), rel_tol=0.01):
            declared = " by ".join(f"{number:g}" if number else "?" for number in size)
            raise ValueError(f"the lens is of images {declared}, and this one is {pixels[0]} by {pixels[1]} pixels")
        lens = [factor * fx, factor * fy, factor * (cx + 0.5) - 0.5, factor * (cy + 0.5) - 0.5]
    elif not all(size) and not (-0.5 <= cx <= pixels[0] - 0.5 and -0.5 <= cy <= pixels[1] - 0.5):
        where = (
            f"the middle of the lens, cx {cx:g} and cy {cy:g}, is outside of the image of {pixels[0]} by {pixels[1]}"
        )
        raise ValueError(f"{where} pixels: is the lens of another size? Give the width and height that it is for")
    return [*lens, scale]


def _number(value: Any, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise ValueError(f"{name} must be a number, not {value!r:.80}")
    return float(min(max(value, -1e300), 1e300))  # a whole number of Python may be too large


# -- one reader for each kind of file ---------------------------------------------------------------------------------------


def _frames_of(array: Array) -> list[Array]:
    """Return the frames of (n, 3), (T, n, 3), (T, h, w, 3), (h, w) or (T, h, w); (h, w, 3) of a camera's size is one."""
    is_image = array.ndim == 3 and (
        array.shape[2] == 1 or (array.shape[:2] in _IMAGE_SIZES and array.shape[2] <= _WIDEST)
    )
    if array.ndim < 3 or array.dtype.names or is_image:
        return [array]
    return list(array)


def _npy(path: Path, declared: _Declared) -> Frames:
    with path.open("rb") as handle:
        shape, columns_first, kind = read_array_header(handle)
        start = handle.tell()
    size = math.prod(shape) * kind.itemsize
    held = path.stat().st_size - start
    if size != held:
        raise ValueError(f"cut off or damaged: its header declares {size} bytes, and {held} follow")
    array: Array = np.zeros(shape, kind)
    if size:
        array = np.memmap(path, kind, "r", start, shape, "F" if columns_first else "C")
    for frame in _frames_of(array):
        yield None, _as_cloud(frame, declared, path.parent)


def _npz(path: Path, declared: _Declared) -> Frames:
    """Yield the frames of the array `points`, or of its only array; several unnamed arrays are a cloud each."""
    with np.load(path, allow_pickle=False) as archive:
        check_size(archive.zip.infolist(), path.stat().st_size)
        names = [name for name in archive.files if name != "times"]
        if HEADER in names:
            raise ValueError(
                "it is a file of topokit, not a film of clouds: track an episode alone, or read it by load_episode or load_states"
            )
        if "points" in names:
            names = ["points"]
        is_film = bool(names) and all(name.startswith("arr_") for name in names)
        if len(names) != 1 and not is_film:
            raise ValueError(f"it holds {', '.join(names) or 'nothing'}: name the array of clouds 'points'")
        _check_rows(archive.zip, [*names, *(name for name in archive.files if name == "times")])
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


def _check_rows(archive: Any, names: Sequence[str]) -> None:
    """Raise ValueError when an array of an archive declares other bytes than its entry has."""
    for name in names:
        entry = archive.getinfo(name if name in archive.namelist() else f"{name}.npy")
        with archive.open(entry) as stream:
            shape, _, kind = read_array_header(stream)
            declared = stream.tell() + math.prod(shape) * kind.itemsize
        if declared != entry.file_size:
            raise ValueError(f"its array {name} declares {declared} bytes and has {entry.file_size}")


def _ply(path: Path, declared: _Declared) -> Frames:
    vertex = read_ply(path.read_bytes().removeprefix(codecs.BOM_UTF8)).get("vertex", {})
    columns = {name: column for name, column in vertex.items() if isinstance(column, np.ndarray)}
    if not columns:
        raise ValueError("it holds no points")
    yield None, _as_cloud(rows_of(columns), declared, path.parent)


def _pcd(path: Path, declared: _Declared) -> Frames:
    rows = read_pcd(path.read_bytes().removeprefix(codecs.BOM_UTF8))
    yield None, _as_cloud(rows, declared, path.parent)


def _png(path: Path, declared: _Declared) -> Frames:
    from PIL import Image

    with Image.open(path, formats=["PNG"]) as picture:
        if not picture.mode.startswith("I"):
            words = f"a picture {picture.size} of mode {picture.mode}: a depth image has 16 bits a pixel"
            raise ValueError(f"{words}; a pattern ('depth*.png') leaves others out")
        check_unpacked(_BYTES_A_PIXEL * math.prod(picture.size), path.stat().st_size)
        yield None, _as_cloud(np.asarray(picture), declared, path.parent)


def _bag(path: Path, declared: _Declared) -> Frames:
    """Yield the messages of one topic of a bag, at the times in their headers."""
    from ._bag import Bag

    bag = Bag(path)
    topic = _topic(bag.kinds, declared.topic)
    camera = _camera(bag, topic) if bag.kinds[topic] == "Image" and declared.intrinsics is None else {}
    messages = ((stored.received, stored.decoded()) for stored in bag.messages([topic]))

    # Headers without a stamp hold 0, and so does the first one of simulated time: the second tells.
    first = list(itertools.islice(messages, 2))
    stamped = any(_stamp(message) for _, message in first)
    for received, message in itertools.chain(first, messages):
        nanoseconds = _stamp(message) if stamped else received
        yield nanoseconds / 10**9, _as_cloud(_rows_of_message(message), declared, camera)


def _stamp(message: Any) -> int:
    """Return the nanoseconds in the header of a message."""
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


def _camera(bag: Any, topic: str) -> dict[str, Any]:
    """Return the camera of a depth image: of its namespace, or else of its frame of reference; none when there is no message.

    A camera for colours beside it has another lens.
    """
    infos = [name for name, kind in bag.kinds.items() if kind == "CameraInfo"]
    units = [name for name in bag.kinds if re.search(r"/option/Depth.Units/value$", name)]
    found: dict[str, Any] = {}
    for stored in bag.messages([topic, *infos, *units]):
        if stored.topic not in found:
            found[stored.topic] = stored.decoded()
        if len(found) == 1 + len(infos) + len(units):
            break
    if topic not in found:
        return {}

    # RealSense Viewer writes .../Depth_0/image/data and .../Depth_0/info/camera_info.
    parent = PurePosixPath(topic).parent
    near = [name for name in infos if PurePosixPath(name).parent in (parent, parent.parent / "info")]
    frame = found[topic].header.frame_id
    same_frame = [name for name in infos if name in found and frame and found[name].header.frame_id == frame]
    names = [name for name in near if name in found] or same_frame
    if len(names) != 1:
        return {}
    info = found[names[0]]
    camera = {"K": getattr(info, "k", None), "width": info.width, "height": info.height}
    if camera["K"] is None:
        camera["K"] = info.K  # ROS 1
    roi = info.roi
    if roi.width and roi.height:  # the image is a part of what the lens sees
        k = np.array(camera["K"], np.float64)
        k[[2, 5]] -= roi.x_offset, roi.y_offset
        camera.update(K=k, width=roi.width, height=roi.height)
    for name in units:
        if name in found:
            camera["depth_scale"] = found[name].data
    return camera


def _topic(kinds: Mapping[str, str], asked: str | None) -> str:
    """Return the named topic, or else the only topic of clouds, or the only topic of depth images."""
    clouds = [name for name, kind in kinds.items() if kind == "PointCloud2"]
    images = [name for name, kind in kinds.items() if kind == "Image"]
    if asked is None:
        likely = clouds or [name for name in images if "depth" in name.lower()]
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
        # Of fields of one name, as several gaps called "_", the first counts.
        fields = {field.name: field for field in reversed(message.fields) if field.datatype in _ROS_TYPES}
        kind = np.dtype(
            {
                "names": list(fields),
                "formats": [order + _ROS_TYPES[field.datatype] for field in fields.values()],
                "offsets": [field.offset for field in fields.values()],
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


_READERS = {".npy": _npy, ".npz": _npz, ".ply": _ply, ".pcd": _pcd, ".png": _png}
_READERS |= dict.fromkeys((".mcap", ".db3", ".bag"), _bag)
