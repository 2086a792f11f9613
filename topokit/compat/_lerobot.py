"""Episodes as a dataset of LeRobot (layout 3.0), and clouds out of one (2.1 or 3.0).

Source: Cadene et al. 2024, *LeRobot: State-of-the-art Machine Learning for Real-World Robotics in PyTorch*.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import parquet

from topokit._archive import FREE, RATIO, FormatError, existing, new_folder, read_json
from topokit._validate import WrongKindError, as_reals, whole
from topokit.io import Episode
from topokit.sensors._files import Asked, as_cloud

Columns = dict[str, NDArray[Any]]
_FILE, _A_CHUNK = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet", 1000
_CLOUD, _STATE = "observation.pointcloud", "observation.state"
_HANDS = [f"gripper{i}.{axis}" for i in (0, 1) for axis in "xyz"] + ["held"]
_NAMES = {_CLOUD: ["point", "axis"], _STATE: _HANDS, "action": _HANDS}


def to_lerobot(
    folder: str | Path, episodes: Iterable[Episode], *, cloud: str = "observed", n_points: int | None = None
) -> Path:
    """Write episodes as a dataset that `LeRobotDataset` opens, without pictures.

    Its features are ``observation.pointcloud`` (n_points, 3), ``observation.state`` (7,), where the two grippers are and whether
    they hold, ``action`` (7,), what they are told for the next frame (in the last one once more), ``next.done`` and
    ``next.success``. The task names garment and target in a sentence.

    Parameters
    ----------
    folder : path
        A new one.
    episodes : iterable of Episode
        All with the same `dt`; it may be a generator.
    cloud : {"observed", "points"}
        Which points of an episode.
    n_points : int, optional
        As many in every frame, since a feature has one shape: of an episode that has fewer, the first come once more. When not
        given, all episodes must have the same number.

    Raises
    ------
    FileExistsError, ValueError
        When there is such a folder; when an episode does not fit those before, with its number.

    Examples
    --------
    >>> from topokit.compat import from_lerobot, to_lerobot
    >>> from topokit.io import load_episode
    >>> film = load_episode("data_small/apron_hook_0.npz")
    >>> clouds, times = from_lerobot(to_lerobot(getfixture("tmp_path") / "aprons", [film]))
    >>> len(clouds), bool((clouds[0] == film.observed[0]).all())
    (96, True)
    """
    if cloud not in ("observed", "points"):
        raise ValueError(f"cloud must be 'observed' or 'points', not {cloud!r}")
    n, start, dt = n_points and whole(n_points, "n_points", 1), 0, 0.0
    tasks, rows, hands, columns = dict[str, int](), list[dict[str, Any]](), list[Columns](), Columns()
    with new_folder(folder) as new:
        for number, episode in enumerate(episodes):
            if not isinstance(episode, Episode):
                raise WrongKindError(f"episodes[{number}] must be an Episode, not {type(episode).__name__}")
            points, dt = getattr(episode, cloud), dt or episode.dt
            n, has, end = n or points.shape[1], points.shape[1], start + len(points)
            if not np.isclose(episode.dt, dt, rtol=1e-6):
                raise ValueError(f"episodes[{number}] has {episode.dt:g} s a frame, those before it {dt:g} s")
            if has > n or (has < n and not n_points):
                raise ValueError(f"episodes[{number}] has {has} points, not {n}: give the most of any as n_points")
            task = f"Hang the {episode.garment} on the {episode.target}."
            numbers = (number, start, tasks.setdefault(task, len(tasks)))
            columns = _columns(episode, points[:, np.arange(n) % has], *numbers)
            hands.append({name: columns[name] for name in (_STATE, "action")})
            place = dict(zip(("chunk_index", "file_index"), divmod(number, _A_CHUNK), strict=True))
            _write(new / "data" / _FILE.format(**place), columns)
            row = {"episode_index": number, "tasks": [task], "length": len(points), "dataset_from_index": start}
            row |= {f"data/{of}": i for of, i in place.items()} | {f"meta/episodes/{of}": 0 for of in place}
            rows.append(row | {"dataset_to_index": end})
            start = end
        if not rows:
            raise ValueError("episodes holds none: a dataset has one at least")
        _write_meta(new / "meta", rows, tasks, hands, columns, dt)
    return Path(folder)


def _columns(episode: Episode, points: NDArray[Any], number: int, start: int, task: int) -> Columns:
    """The features of all frames of an episode, a row a frame."""
    n, frame, last = len(points), np.arange(len(points)), np.arange(len(points)) == len(points) - 1
    parts = (episode.grippers, episode.actions)
    hands, told = (np.column_stack([some.reshape(n, 6), episode.held]).astype(np.float32) for some in parts)
    columns = {_CLOUD: points, _STATE: hands, "action": told[np.minimum(frame + 1, n - 1)]}
    columns |= {"next.done": last, "next.success": last & episode.success, "frame_index": frame}
    columns |= {"timestamp": (frame * episode.dt).astype(np.float32), "index": start + frame}
    return {**columns, "episode_index": np.full(n, number), "task_index": np.full(n, task)}


def _write(path: Path, columns: Columns) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    lists = {name: list(map(list, some)) if some.ndim == 3 else list(some) for name, some in columns.items()}
    parquet.write_table(pa.table(lists), path)


def _write_meta(path: Path, rows: Any, tasks: dict[str, int], hands: list[Columns], last: Columns, dt: float) -> None:
    (path / "episodes/chunk-000").mkdir(parents=True)
    parquet.write_table(pa.Table.from_pylist(rows), path / "episodes/chunk-000/file-000.parquet")
    pd.DataFrame({"task_index": list(tasks.values())}, index=list(tasks)).to_parquet(path / "tasks.parquet")
    fps, n, stats = round(1 / dt, 9), rows[-1]["dataset_to_index"], dict[str, Any]()
    for name in hands[0]:
        some = np.concatenate([part[name] for part in hands]).astype(np.float64)
        stats[name] = {of: getattr(some, of)(axis=0).tolist() for of in ("min", "max", "mean", "std")} | {"count": [n]}
    info: dict[str, Any] = {"codebase_version": "v3.0", "robot_type": "two grippers", "total_episodes": len(rows)}
    info |= {"total_frames": n, "total_tasks": len(tasks), "chunks_size": _A_CHUNK, "data_files_size_in_mb": 100}
    info |= {"video_files_size_in_mb": 200, "fps": int(fps) if fps % 1 == 0 else fps, "video_path": None}
    info |= {"splits": {"train": f"0:{len(rows)}"}, "data_path": f"data/{_FILE}", "features": {}}
    for name, one in last.items():
        shape = [*one.shape[1:]] or [1]
        info["features"][name] = {"dtype": str(one.dtype), "shape": shape, "names": _NAMES.get(name)}
    for name, text in {"info": info, "stats": stats}.items():
        (path / f"{name}.json").write_text(json.dumps(text, indent=4))


def from_lerobot(
    folder: str | Path, episode: int = 0, *, cloud: str | None = None, columns: Sequence[int] | None = None
) -> tuple[list[NDArray[Any]], list[float]]:
    """Read the clouds (n, 3) of an episode, and their times in seconds, out of a dataset of LeRobot, for `topokit.track`.

    Parameters
    ----------
    folder : path
        Of the dataset: in it are ``meta`` and ``data``.
    episode : int
    cloud : str, optional
        Which feature; when not given, the only one of shape (n, 3), or (n, 6) and the like.
    columns : sequence of int, optional
        Which three numbers of a point are its place; the others may be colours.

    Raises
    ------
    FileNotFoundError, FormatError
        The message says which file, what is wrong, and what to do.
    """
    where, number = Path(folder), whole(episode, "episode")
    path = existing(where / "meta" / "info.json")
    one = sorted(where.glob(f"data/*/episode_{number:06d}.parquet"))  # as version 2.1 has it
    try:
        name = _feature(read_json(path.read_bytes())["features"], cloud)
        for path in one or sorted(where.glob("data/*/*.parquet")):
            table = _read(path, number, [name, "timestamp", "frame_index", "episode_index"])
            if len(table):
                frames = (as_reals(frame, name) for frame in table[name].to_pylist())
                return [as_cloud(frame, Asked(columns=columns), path) for frame in frames], table[
                    "timestamp"
                ].to_pylist()
    except (pa.ArrowException, OSError, ValueError) as error:
        raise FormatError(f"{path}: {error}") from error
    except (KeyError, TypeError, AttributeError) as error:
        raise FormatError(f"{path}: damaged, or of no dataset of LeRobot: {type(error).__name__} {error}") from error
    raise FormatError(f"{where}: no file of data holds episode {number}")


def _feature(features: dict[str, Any], asked: str | None) -> str:
    clouds = [name for name, told in features.items() if len(told["shape"]) == 2 and told["shape"][1] in range(3, 17)]
    found = clouds if asked is None else [name for name in features if name == asked]
    if len(found) != 1:
        raise ValueError(f"which feature is the cloud? There is {', '.join(clouds or features)}: name one as cloud=")
    return found[0]


def _read(path: Path, episode: int, columns: list[str]) -> pa.Table:
    """The frames of an episode in a file, when its size allows what it claims to hold."""
    size, told = path.stat().st_size, parquet.read_metadata(path)
    groups = [told.row_group(i) for i in range(told.num_row_groups)]
    held = 8 * sum(group.column(i).num_values for group in groups for i in range(group.num_columns))
    if held > FREE + RATIO * size:
        raise ValueError(f"its {size} bytes claim to hold {held}")
    if missing := set(columns) - set(parquet.read_schema(path).names):
        raise ValueError(f"it has no column {min(missing)}")
    return parquet.read_table(path, columns=columns, filters=[("episode_index", "=", episode)]).sort_by("frame_index")
