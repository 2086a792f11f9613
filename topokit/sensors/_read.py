"""Raw clouds from files: arrays of NumPy, PLY, tables of text, and depth images.

Shapes follow one rule. (n, 2) and (n, 3) are a cloud. (T, h, w, 3) is a film of T organised clouds. An array with three axes may
be a film (T, n, 3), an organised cloud (h, w, 3) or a film of depth images (T, h, w): the caller says which.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from topokit._archive import FormatError, existing, is_archive
from topokit._validate import Array, as_number, as_reals, positive
from topokit.io import load_episode

Frames = Iterator[tuple[float | None, Array]]


def read_clouds(
    path: str | Path,
    *,
    layout: str | None = None,
    scale: float | None = None,
    columns: Sequence[int | str] | None = None,
    intrinsics: Mapping[str, Any] | None = None,
    fps: float | None = None,
) -> Frames:
    """Yield the clouds (n, 3) of a film in metres, raw, each with its time in seconds, or None when it has none.

    Bags of ROS, PCD files and other formats are read by their own packages: the page *Coming from ...* has recipes. `Cleaner`
    makes the clouds ready for the tracker.

    Parameters
    ----------
    path : path
        A file, or a folder of numbered files of one kind: .npy, .npz (its arrays `clouds` or `points`, and `times`; of an episode
        its observed points), .ply, .png (depth of 16 bits), or a table of text (.csv, .txt, .xyz, .pts), one point a row. .ply
        needs trimesh and .png needs pillow (``pip install 'topokit[sensors]'``).
    layout : {"film", "organised", "depth"}, optional
        Meaning of an array of numbers in a .npy or .npz file: clouds (T, n, 3) or (T, h, w, 3); one organised cloud (h, w, 3); or
        depth images (h, w) or (T, h, w). It is asked for where the shape leaves it open.
    scale : float, optional
        Metres in a unit of the file. By default 1, and for depth of whole numbers 0.001, or `depth_scale` of the intrinsics.
    columns : sequence, optional
        The numbers of a point that are its place, by index, or by name where the first line of a table has names. By default x,
        y and z where a table names them, and else the first three.
    intrinsics : mapping, optional
        The lens of a depth camera without distortion: fx, fy, cx, cy in pixels, and no other numbers but `depth_scale`, metres
        in a unit of the depth, and the size of the image as `width` and `height`. With it an array is depth. By default the
        file intrinsics.json beside the image.
    fps : float, optional
        Frames a second, for files without times.

    Raises
    ------
    FileNotFoundError
        When there is no such file.
    FormatError
        When a file is damaged, of another kind, or ambiguous. The message names the file, the problem and a remedy.
    """
    if fps is not None:
        positive(fps, "fps", zero=False)
    if scale is not None:
        positive(scale, "scale", zero=False)
    options = _Options(layout, scale, None if columns is None else tuple(columns), intrinsics)
    clouds = (pair for file in _files_of(Path(path).expanduser()) for pair in _clouds_in(file, options))
    for number, (time, cloud) in enumerate(clouds):
        yield (time if fps is None else number / fps), cloud


@dataclass(frozen=True)
class _Options:
    """Options of `read_clouds` for the numbers of a file."""

    layout: str | None
    scale: float | None
    columns: tuple[int | str, ...] | None
    intrinsics: Mapping[str, Any] | None


def _files_of(path: Path) -> list[Path]:
    """Return the files of a folder, in the order of the numbers in their names, or one file alone."""
    every = path.iterdir() if path.is_dir() else [existing(path)]
    files = [file for file in every if file.suffix.lower() in _READERS or file == path]
    kinds = sorted({file.suffix.lower() for file in files})
    if len(kinds) != 1 or kinds[0] not in _READERS:
        held = ", ".join(kinds) or "no cloud"
        cure = f"; np.save the points of {_ELSEWHERE[held]}" if held in _ELSEWHERE else ""
        raise FormatError(f"{path}: holds {held}; a film is of one kind: {', '.join(_READERS)}{cure}")
    return sorted(
        files, key=lambda file: [int(word) if word.isdigit() else word for word in re.split(r"(\d+)", file.stem)]
    )


def _clouds_in(file: Path, options: _Options) -> Frames:
    """Yield the clouds of a file; errors name the file."""
    try:
        yield from _READERS[file.suffix.lower()](file, options)
    except ModuleNotFoundError as error:
        raise ImportError(f"{file}: reading it needs {error.name}: pip install 'topokit[sensors]'") from error
    except Exception as error:  # damage shows in a dozen ways
        raise FormatError(f"{file}: {error}") from error


def _clouds_of(array: Array, file: Path, options: _Options) -> Iterator[Array]:
    """Yield the clouds of an array of numbers, by the rule of this module."""
    array = as_reals(array, "the array")
    layout = "depth" if options.intrinsics is not None else options.layout
    if layout is None and array.ndim == 2 and array.shape[1] > 3 and options.columns is None:
        question = f"are its {array.shape[1]} columns numbers of a point (say which are its place, as columns=), or is it depth"
        raise ValueError(f"an array of shape {array.shape}: {question} (layout='depth')?")
    if layout is None and array.ndim == 3:
        raise ValueError(f"an array of shape {array.shape}: is its layout 'film', 'organised' or 'depth'? Say layout=")
    if layout == "depth":
        for image in array.reshape(-1, *array.shape[-2:]):
            yield _seen_by_pixels(image, file, options)
        return
    for frame in array if layout == "film" or array.ndim == 4 else array[None]:
        yield _places(frame.reshape(-1, frame.shape[-1]), options)


def _places(rows: Array, options: _Options) -> Array:
    """Return the columns of rows that are a place, in metres."""
    asked = options.columns or (0, 1, 2)[: rows.shape[1]]
    columns = [column for column in asked if isinstance(column, int) and column < rows.shape[1]]
    if len(columns) < 2 or len(columns) < len(asked):
        raise ValueError(f"a row has {rows.shape[1]} numbers, and the columns {asked} are no place among them")
    return np.asarray(rows[:, columns] * (1.0 if options.scale is None else options.scale))


def _seen_by_pixels(depth: Array, file: Path, options: _Options) -> Array:
    """Return the places (h * w, 3) of pixels: right, down and forward; (0, 0, 0) for pixels without depth."""
    lens = options.intrinsics
    if lens is None:
        beside = file.with_name("intrinsics.json")
        if not beside.is_file():
            raise ValueError(f"a depth image {depth.shape} needs its lens: intrinsics=, or {beside.name} beside it")
        lens = json.loads(beside.read_text(encoding="utf-8"))
    others = sorted(set(lens) - {"fx", "fy", "cx", "cy", "width", "height", "depth_scale"})
    if others:
        cure = "give fx, fy, cx, cy of a lens without distortion or skew (cv2.undistort)"
        raise ValueError(f"its lens has {', '.join(others)}: {cure}")
    height, width = depth.shape
    if (lens.get("width", width), lens.get("height", height)) != (width, height):
        raise ValueError(f"its lens is of an image of {lens['width']} x {lens['height']}, not {width} x {height}")
    number = {name: float(as_number(lens.get(name), name)) for name in ("fx", "fy", "cx", "cy")}

    scale = options.scale
    if scale is None:
        scale = positive(lens.get("depth_scale", 0.001 if depth.dtype.kind in "iu" else 1.0), "depth_scale", zero=False)
        if scale > 1:
            raise ValueError(f"depth_scale is metres in a unit of the depth, not units in a metre: 1 / {scale:g}?")
    z = depth * scale
    rows, columns = np.indices(depth.shape)
    x = z * (columns - number["cx"]) / number["fx"]
    y = z * (rows - number["cy"]) / number["fy"]
    return np.stack([x, y, z], axis=-1).reshape(-1, 3)


# -- one reader a kind of file ----------------------------------------------------------------------------------------------


def _npy(file: Path, options: _Options) -> Frames:
    for cloud in _clouds_of(np.load(file, allow_pickle=False), file, options):
        yield None, cloud


def _npz(file: Path, options: _Options) -> Frames:
    if is_archive(file):
        episode = load_episode(file)
        yield from zip(episode.times.tolist(), episode.observed.astype(np.float64), strict=True)
        return
    with file.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
        name = next((name for name in ("clouds", "points") if name in archive), None)
        if name is None:
            raise ValueError(f"it has {', '.join(archive)}, and no array 'clouds' or 'points'")
        clouds = list(_clouds_of(archive[name], file, options))
        given = archive.get("times", [None] * len(clouds))
        times = [None if time is None else float(as_number(time, "times", "number of seconds")) for time in given]
    yield from zip(times, clouds, strict=True)


def _ply(file: Path, options: _Options) -> Frames:
    import trimesh

    vertices = np.asarray(trimesh.load(file, process=False).vertices)  # type: ignore[attr-defined]
    header = re.search(rb"element vertex (\d+)", file.read_bytes())
    if header is None or int(header[1]) != len(vertices):
        raise ValueError(f"{len(vertices)} vertices were read, and its header counts another number: it is damaged")
    yield None, _places(vertices, options)


def _png(file: Path, options: _Options) -> Frames:
    from PIL import Image

    with Image.open(file, formats=["PNG"]) as picture:
        if not picture.mode.startswith("I"):
            raise ValueError(f"a picture of mode {picture.mode}: a depth image has 16 bits a pixel")
        yield None, _seen_by_pixels(np.asarray(picture), file, options)


def _table(file: Path, options: _Options) -> Frames:
    """Read a table of text: numbers apart by commas, semicolons or blanks; its first line may name them."""
    text = file.read_text(encoding="utf-8")
    lines = [re.split(r"[,;\s]+", line.strip()) for line in text.splitlines() if line.strip()]
    names: list[str] = []
    if not re.fullmatch(r"[-+.\d].*", lines[0][0]):
        names = [name.strip('"#').lower() for name in lines.pop(0)]
    elif len(lines[0]) == 1:
        lines.pop(0)  # .pts begins with the number of points
    rows = np.array(lines, dtype=np.float64)
    columns = options.columns
    if columns is None:
        columns = ("x", "y", "z") if {"x", "y", "z"} <= set(names) else (0, 1, 2)[: rows.shape[1]]
    try:
        numbers = tuple(names.index(column) if isinstance(column, str) else column for column in columns)
    except ValueError as error:
        raise ValueError(f"it has no such column ({error}): it has {', '.join(names) or 'no names'}") from error
    yield None, _places(rows, replace(options, columns=numbers))


_READERS = {".npy": _npy, ".npz": _npz, ".ply": _ply, ".png": _png}
_READERS |= dict.fromkeys((".csv", ".txt", ".xyz", ".pts"), _table)

# What reads the points of other files.
_ELSEWHERE = dict.fromkeys(
    (".glb", ".gltf", ".obj", ".off", ".stl"), "trimesh.load(path, process=False, force='mesh').vertices"
)
_ELSEWHERE |= {
    ".las": "laspy.read(path).xyz",
    ".laz": "laspy.read(path).xyz",
    ".pcd": "pypcd4.PointCloud.from_path(path).numpy()",
}
_ELSEWHERE |= dict.fromkeys((".vtk", ".vtp", ".vtu"), "pyvista.read(path).points")
