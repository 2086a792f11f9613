"""Episodes as a dataset of LeRobot (layout 3.0), and clouds out of one (2.1 or 3.0).

Source: Cadene et al. 2024, *LeRobot: State-of-the-art Machine Learning for Real-World Robotics in PyTorch*.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topokit._archive import FREE, RATIO, FormatError, existing
from topokit._validate import as_reals, whole
from topokit.io import Episode
from topokit.sensors._files import Asked, as_cloud

Columns = dict[str, NDArray[Any]]
_DATA, _A_CHUNK = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet", 1000
_CLOUD, _HANDS = "observation.pointcloud", ("observation.state", "action")
_NAMES = [f"gripper{i}.{axis}" for i in (0, 1) for axis in "xyz"] + ["held"]


def to_lerobot(folder: str | Path, episodes: Iterable[Episode], *, n_points: int | None = None) -> Path:
    """Write what was observed in episodes as a dataset that `LeRobotDataset` opens, without pictures.

    Its features are ``observation.pointcloud`` (n_points, 3), ``observation.state`` (7,), where the two grippers are and whether
    they hold, ``action`` (7,), what they are told for the next frame (in the last one once more), ``next.done`` and
    ``next.success``. The task names garment and target in a sentence.

    Parameters
    ----------
    folder, episodes
        A new folder; episodes with the same `dt`, which may come from a generator.
    n_points : int, optional
        In every frame, since a feature has one shape: of fewer, the first come once more. By default all must have as many.

    Raises
    ------
    FileExistsError, ValueError
        When there is such a folder; when an episode does not fit those before, with its number.
    """
    folder, n, dt, start, columns = Path(folder), n_points and whole(n_points, "n_points", 1), 0.0, 0, Columns()
    if folder.exists():
        raise FileExistsError(f"{folder}: it is there already; name a new folder")
    folder.parent.mkdir(parents=True, exist_ok=True)
    tasks, rows, hands = dict[str, int](), list[dict[str, Any]](), list[Columns]()
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".topokit-") as made:
        for i, episode in enumerate(episodes):
            dt, n, has = dt or episode.dt, n or episode.observed.shape[1], episode.observed.shape[1]
            if not np.isclose(episode.dt, dt, rtol=1e-6):
                raise ValueError(f"episodes[{i}] has {episode.dt:g} s a frame, those before it {dt:g} s")
            if has > n or (has < n and not n_points):
                raise ValueError(f"episodes[{i}] has {has} points, not {n}: give the most of any as n_points")
            task, (chunk, file) = f"Hang the {episode.garment} on the {episode.target}.", divmod(i, _A_CHUNK)
            columns = _columns(episode, n, i, start, tasks.setdefault(task, len(tasks)))
            hands.append({name: columns[name] for name in _HANDS})
            lists = {name: list(map(list, some)) if some.ndim == 3 else list(some) for name, some in columns.items()}
            _write(Path(made, "set", _DATA.format(chunk_index=chunk, file_index=file)), lists)
            row = {"episode_index": i, "tasks": [task], "length": len(episode), "dataset_from_index": start}
            row |= {"data/chunk_index": chunk, "data/file_index": file, "dataset_to_index": start + len(episode)}
            rows.append(row | {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0})
            start += len(episode)
        whole(len(rows), "the number of episodes", 1)
        _write_meta(Path(made, "set/meta"), rows, list(tasks), hands, columns, round(1 / dt, 9))
        os.replace(Path(made, "set"), folder)
    return folder


def _columns(episode: Episode, n_points: int, number: int, start: int, task: int) -> Columns:
    """The features of all frames of an episode, a row a frame."""
    n, points, frame = len(episode), episode.observed, np.arange(len(episode))
    parts = (episode.grippers, episode.actions)
    hands, told = (np.column_stack([some.reshape(n, 6), episode.held]).astype(np.float32) for some in parts)
    clouds, times = points[:, np.arange(n_points) % points.shape[1]], episode.times.astype(np.float32)
    columns: Columns = {_CLOUD: clouds, "timestamp": times}
    columns |= dict(zip(_HANDS, (hands, told[np.minimum(frame + 1, n - 1)]), strict=True))
    columns |= {"next.done": frame == n - 1, "next.success": (frame == n - 1) & episode.success, "frame_index": frame}
    return columns | {"episode_index": 0 * frame + number, "index": start + frame, "task_index": 0 * frame + task}


def _arrow() -> Any:
    try:
        import pyarrow.parquet
    except ModuleNotFoundError as error:
        raise ImportError("a dataset of LeRobot needs pyarrow: pip install 'topokit[pyarrow]'") from error
    return pyarrow


def _write(path: Path, columns: dict[str, Any], told: dict[str, str] | None = None) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    _arrow().parquet.write_table(_arrow().table(columns, metadata=told), path)


def _write_meta(path: Path, rows: Any, tasks: list[str], hands: list[Columns], last: Columns, fps: float) -> None:
    _write(path / "episodes/chunk-000/file-000.parquet", {name: [row[name] for row in rows] for name in rows[0]})
    index = {"name": "task", "field_name": "task", "pandas_type": "unicode", "numpy_type": "object", "metadata": None}
    of_pandas = {"pandas": json.dumps({"index_columns": ["task"], "columns": [index]})}
    _write(path / "tasks.parquet", {"task_index": range(len(tasks)), "task": tasks}, of_pandas)
    n, stats = rows[-1]["dataset_to_index"], dict[str, Any]()
    for name in _HANDS:
        some = np.concatenate([columns[name] for columns in hands]).astype(np.float64)
        stats[name] = {of: getattr(some, of)(axis=0).tolist() for of in ("min", "max", "mean", "std")} | {"count": [n]}
    told: Any = {name: {"dtype": str(one.dtype), "shape": [*one.shape[1:]] or [1]} for name, one in last.items()}
    features = {name: one | {"names": _NAMES if name in _HANDS else None} for name, one in told.items()}
    info: Any = {"codebase_version": "v3.0", "robot_type": "two grippers", "video_path": None, "features": features}
    info |= {"total_episodes": len(rows), "total_frames": n, "total_tasks": len(tasks), "chunks_size": _A_CHUNK}
    info |= {"splits": {"train": f"0:{len(rows)}"}, "fps": int(fps) if fps % 1 == 0 else fps, "data_path": _DATA}
    info |= {"data_files_size_in_mb": 100, "video_files_size_in_mb": 200}
    for name, text in {"info": info, "stats": stats}.items():
        (path / f"{name}.json").write_text(json.dumps(text, indent=4))


def from_lerobot(folder: str | Path, episode: int = 0, *, cloud: str = _CLOUD, columns: Any = None) -> Any:
    """Return the clouds (n, 3) of an episode and their times in seconds, two lists, out of a dataset of LeRobot.

    Parameters
    ----------
    folder, episode, cloud, columns
        Where ``meta`` and ``data`` are; a number; the name of the feature; which three numbers of a point are its place.

    Raises
    ------
    FileNotFoundError, FormatError
        The message says which file, what is wrong, and what to do.
    """
    path, number, parquet = existing(Path(folder, "meta/info.json")), whole(episode, "episode"), _arrow().parquet
    one = sorted(Path(folder).glob(f"data/*/episode_{number:06d}.parquet"))  # as version 2.1 has it
    wanted = [cloud, "timestamp", "frame_index", "episode_index"]
    try:
        for path in one or sorted(Path(folder).glob("data/*/*.parquet")):
            told, names, size = parquet.read_metadata(path), parquet.read_schema(path).names, path.stat().st_size
            groups = map(told.row_group, range(told.num_row_groups))
            held = 8 * sum(group.column(i).num_values for group in groups for i in range(told.num_columns))
            if held > FREE + RATIO * size:
                raise ValueError(f"its {size} bytes claim to hold {held}")
            if missing := [name for name in wanted if name not in names]:
                raise ValueError(f"it has no column {missing[0]}: it has {', '.join(names)}")
            table = parquet.read_table(path, columns=wanted, filters=[("episode_index", "=", number)])
            if len(table):
                table = table.sort_by("frame_index")
                frames = (as_reals(frame, cloud) for frame in table[cloud].to_pylist())
                clouds = [as_cloud(frame, Asked(columns=columns), path) for frame in frames]
                return clouds, table["timestamp"].to_pylist()
    except Exception as error:  # damage shows in a dozen ways
        raise FormatError(f"{path}: {error}") from error
    raise FormatError(f"{folder}: no file of data holds episode {number}")
