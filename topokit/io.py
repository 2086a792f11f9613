"""Episodes and tracked states on disk: one compressed `.npz` each, without pickle, checksummed, replaced in one piece.

Coordinates are packed to 16 bits with one scale an array (2 m of room costs an error of 0.015 mm; a float16 would cost
0.5 mm at one metre), everything else is stored as it is. The text parts are one JSON document beside the arrays.

Source: the paper's section 6 says what an episode holds; the format is ours. Taught in chapter 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._archive import FormatError, load_archive, save_archive
from ._validate import WrongKindError, as_ids, as_reals
from .state import Loop, TopologicalState

__all__ = [
    "FEWEST_FRAMES",
    "HISTORY",
    "HORIZON",
    "SCHEMA",
    "Episode",
    "FormatError",
    "load_episode",
    "load_states",
    "save_episode",
    "save_states",
]

SCHEMA = 1
HISTORY, HORIZON = 16, 60  # frames that a forecast looks back on, and ahead to (Antonova et al. 2021, section 5)
FEWEST_FRAMES = HISTORY + HORIZON
_KIND = "topokit-episode"
_STATES_KIND, _STATES_SCHEMA = "topokit-states", 2
_MAX_PACKING_ERROR = 1e-4  # metres
_PACKED = ("points", "observed", "actions", "grippers", "centre_line")
_KINDS: dict[str, Any] = {"loops": list | tuple, "success": bool, "seed": int, "dt": int | float}
_KINDS |= dict.fromkeys((*_PACKED, "held", "faces"), np.ndarray) | dict.fromkeys(("garment", "target", "task"), str)
_KINDS |= dict.fromkeys(("observation", "physics", "provenance"), dict)
_TEXT = ("garment", "target", "task", "success", "seed", "dt", "observation", "physics", "provenance", "schema")


@dataclass(frozen=True, eq=False)
class Episode:
    """One recorded run of two grippers carrying a garment to a target. Arrays are held as they are given, not copied."""

    points: NDArray[np.float32]  #: (T, N, 3) all vertices of the garment in mesh order, metres
    #: (T, M, 3) what an observer sees: farthest-point samples of the vertices, or of what cameras see (`observation` says which)
    observed: NDArray[np.float32]
    actions: NDArray[np.float32]  #: (T, 2, 3) where the two grippers were told to be
    grippers: NDArray[np.float32]  #: (T, 2, 3) where they were
    held: NDArray[np.bool_]  #: (T,) whether the grippers hold the garment at that frame
    faces: NDArray[np.int32]  #: (F, 3)
    #: the true loops, each a closed cycle (L,) of vertex ids, the last joins the first
    loops: tuple[NDArray[np.int32], ...]
    centre_line: NDArray[np.float32]  #: (K, 3) the target's centre line, an open polyline
    garment: str  #: its name
    target: str  #: its name
    success: bool  #: whether the task's true loops hang on the target, at rest, after release
    seed: int  #: of everything random
    dt: float  #: seconds between frames
    task: str = ""  #: garment and target
    #: how `observed` was made: its kind and, for cameras, all their parameters
    observation: dict[str, Any] = field(default_factory=dict)
    #: all parameters of the simulation, the target's sizes and position, what was randomised and in which ranges
    physics: dict[str, Any] = field(default_factory=dict)
    provenance: dict[str, Any] = field(default_factory=dict)  #: the command and the versions that made it
    schema: int = SCHEMA  #: of the file format

    def __len__(self) -> int:
        return len(self.points)

    @property
    def times(self) -> NDArray[np.float64]:
        """(T,) seconds since the first frame."""
        return np.arange(len(self), dtype=np.float64) * self.dt


def save_episode(path: str | Path, episode: Episode) -> Path:
    """Write `episode` to `path` (`.npz`) in one piece: a reader sees the old file or the whole new one.

    Parameters
    ----------
    path : path
        It ends in .npz.
    episode : Episode
        What `check_episode` finds whole, with no coordinate so far outside that 16 bits would cost more than 0.1 mm.
    """
    check_episode(episode)
    arrays: dict[str, NDArray[Any]] = {}
    for name in _PACKED:
        arrays[name], arrays[f"{name}_scale"] = _pack(name, getattr(episode, name))
    arrays["held"] = np.asarray(episode.held, dtype=np.bool_)
    arrays["faces"] = np.asarray(episode.faces, dtype=np.int32)
    loops = [np.asarray(loop, dtype=np.int32) for loop in episode.loops]
    arrays["loop_vertices"] = np.concatenate(loops) if loops else np.empty(0, np.int32)
    arrays["loop_lengths"] = np.array([len(loop) for loop in loops], dtype=np.int32)
    text = {name: getattr(episode, name) for name in _TEXT}
    return save_archive(path, _KIND, text, arrays)


def load_episode(path: str | Path) -> Episode:
    """Read an episode that `save_episode` wrote.

    Raises
    ------
    FileNotFoundError, FormatError
        When there is no such file, or it is empty, damaged, of another format or of a newer schema; the message says which.
    """
    text, arrays = _load(path, _KIND, (SCHEMA,), "record it again")
    try:
        loops = tuple(_split(arrays.pop("loop_vertices"), arrays.pop("loop_lengths"), "loop_lengths"))
        for name in _PACKED:
            arrays[name] = _unpack(name, arrays[name], arrays.pop(f"{name}_scale"))
        parts: dict[str, Any] = {**arrays, **text}
        episode = Episode(loops=loops, **parts)
        check_episode(episode)
    except ValueError as error:
        raise FormatError(f"{path}: {error}") from error
    except (KeyError, TypeError) as error:
        raise FormatError(f"{path}: an episode with a missing or an unknown part: {error}; record it again") from error
    return episode


def check_episode(episode: Episode) -> None:
    """Raise ValueError unless the parts of an episode fit each other; the message says which do not, and where."""
    for name, kind in _KINDS.items():
        value = getattr(episode, name)
        if not isinstance(value, kind):
            raise WrongKindError(f"{name} must be {getattr(kind, '__name__', kind)}, not {repr(value)[:80]}")
    for name in (*_PACKED, "held"):
        as_reals(getattr(episode, name), name)
    frames, vertices = episode.points.shape[:2] if episode.points.ndim == 3 else (0, 0)
    if episode.points.ndim == 3 and frames == 0:
        raise ValueError("points holds no frame")
    for name, rows in (("points", None), ("observed", None), ("actions", 2), ("grippers", 2)):
        shape = getattr(episode, name).shape
        if len(shape) != 3 or shape != (frames, rows or shape[1], 3):
            raise ValueError(f"{name} has shape {shape}; expected ({frames or 'T'}, {rows or 'N'}, 3), a row a frame")
    for name in ("faces", "centre_line"):
        shape = getattr(episode, name).shape
        if len(shape) != 2 or shape[1] != 3:
            raise ValueError(f"{name} has shape {shape}; expected (K, 3)")
    if episode.held.shape != (frames,):
        raise ValueError(f"held has shape {episode.held.shape}; expected ({frames},)")
    for name in _PACKED:
        finite = np.isfinite(getattr(episode, name)).all(axis=-1)
        if not finite.all():
            where = "corner" if name == "centre_line" else "frame"
            raise ValueError(f"{name} has a NaN or infinite coordinate in {where} {np.argwhere(~finite)[0, 0]}")
    if not 0 < episode.dt < np.inf:
        raise ValueError(f"dt must be the seconds between two frames, not {episode.dt}")
    for name, ids in (("faces", episode.faces), *((f"loops[{i}]", loop) for i, loop in enumerate(episode.loops))):
        if as_ids(ids, name, vertices).ndim != 1 + (name == "faces"):
            raise ValueError(f"{name} has shape {np.shape(ids)}; a loop is a list of vertex ids")


def _pack(name: str, values: NDArray[Any]) -> tuple[NDArray[np.uint16], NDArray[np.float64]]:
    """Return 16-bit integers and (step, low x, low y, low z) so that values = low + step * integers, to within step / 2."""
    values = np.asarray(values, dtype=np.float64)
    low = values.reshape(-1, 3).min(axis=0) if values.size else np.zeros(3)
    span = max(float((values - low).max()) if values.size else 0.0, 1e-9)
    step = span / 65535
    if step / 2 > _MAX_PACKING_ERROR:
        raise ValueError(f"{name} spans {span:.1f} m: 16 bits would cost {1e3 * step / 2:.2f} mm, more than 0.1 mm")
    return np.round((values - low) / step).astype(np.uint16), np.array([step, *low])


def _unpack(name: str, values: NDArray[Any], scale: NDArray[Any]) -> NDArray[np.float32]:
    if values.shape[-1:] != (3,) or scale.shape != (4,) or not {values.dtype.kind, scale.dtype.kind} <= set("uf"):
        raise ValueError(f"{name} has shape {values.shape}, its scale {scale.shape}; expected (..., 3) and (4,)")
    with np.errstate(over="ignore", invalid="ignore"):  # what is infinite is refused
        return np.asarray(values * scale[0] + scale[1:], dtype=np.float32)


def _split(values: NDArray[Any], counts: NDArray[Any], name: str) -> list[NDArray[Any]]:
    """Runs of rows, as many as there are counts."""
    if not len(counts):
        counts = np.zeros(0, np.int64)  # an array of nothing has no type
    if counts.ndim != 1 or counts.dtype.kind not in "iu" or (counts < 0).any() or sum(counts.tolist()) != len(values):
        raise ValueError(f"{name} must be counts that sum to {len(values)}")
    return np.split(values, np.cumsum(counts)[:-1]) if len(counts) else []


def _load(
    path: str | Path, kind: str, schemas: tuple[int, ...], remedy: str
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read an archive of a kind, of a schema that is known."""
    text, arrays = load_archive(path, kind)
    if text.get("schema") not in schemas:
        known = " and ".join(map(str, schemas))
        raise FormatError(f"{path}: of schema {text.get('schema')}, not {known}: update topokit or {remedy}")
    return text, arrays


# What the loops of states hold: the type and the axes of each array, n loops in d dimensions.
_LOOP = {
    "id": "i n",
    "birth": "f n",
    "death": "f n",
    "step": "f n",
    "birth_edge": "i n 2",
    "killer_edge": "i n 2",
    "killer_triangle_ids": "i n 2 3",
    "killer_edge_points": "f n 2 d",
    "killer_triangles": "f n 2 3 d",
    "killer_values": "f n 2",
}
# The same of arrays whose length varies from loop to loop, by the name of the counts.
_LOOP_LISTS = {
    "n_neighbours": {"neighbour_ids": "i m 3", "neighbours": "f m 3 d", "neighbour_values": "f m"},
    "n_cycle": {"cycle": "i k", "cycle_points": "f k d"},
}


def save_states(path: str | Path, states: Sequence[TopologicalState]) -> Path:
    """Write tracked states to a file in one piece; `load_states` gives the same states back, to the last bit.

    Parameters
    ----------
    path : path
        It ends in .npz.
    states : sequence of TopologicalState
        The cycles of their loops are found and stored with them.
    """
    loops = [loop for state in states for loop in state.loops]
    arrays = {name: np.array([getattr(loop, name) for loop in loops]) for name in _LOOP}
    for count, names in _LOOP_LISTS.items():
        for name in names:
            arrays[name] = np.concatenate([getattr(loop, name) for loop in loops] or [np.empty(0)])
        arrays[count] = np.array([len(getattr(loop, next(iter(names)))) for loop in loops], dtype=np.int64)
    arrays["n_loops"] = np.array([len(state) for state in states], dtype=np.int64)
    arrays["frame"] = np.array([state.frame for state in states], dtype=np.int64)
    arrays["time"] = np.array([state.time for state in states], dtype=np.float64)
    text = {"schema": _STATES_SCHEMA, "parameters": [state.parameters for state in states]}
    return save_archive(path, _STATES_KIND, text, arrays)


def load_states(path: str | Path) -> list[TopologicalState]:
    """Read states that `save_states` wrote.

    Raises
    ------
    FileNotFoundError, FormatError
        As `load_episode`.
    """
    text, arrays = _load(path, _STATES_KIND, (1, _STATES_SCHEMA), "track them again")
    try:
        loops = _loops(arrays, with_cycles=text["schema"] != 1)
        groups = _split(np.arange(len(loops)), arrays["n_loops"], "n_loops")
        rows = zip(arrays["frame"].tolist(), arrays["time"].tolist(), text["parameters"], groups, strict=True)
        return [
            TopologicalState(int(frame), float(time), tuple(loops[i] for i in group), dict(parameters))
            for frame, time, parameters, group in rows
        ]
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(f"{path}: states with a missing or an unknown part: {error}; track them again") from error


def _loops(arrays: dict[str, NDArray[Any]], with_cycles: bool) -> list[Loop]:
    """All loops of all frames; those of the first schema know no cycle."""
    lists = {count: names for count, names in _LOOP_LISTS.items() if with_cycles or count != "n_cycle"}
    number, sizes = len(arrays["id"]), {"2": 2, "3": 3}
    columns: dict[str, Any] = {}
    for name, (kind, *axes) in {
        name: form.split() for names in (_LOOP, *lists.values()) for name, form in names.items()
    }.items():
        array = arrays[name]
        shape = tuple(sizes.setdefault(axis, length) for axis, length in zip(axes, array.shape, strict=False))
        if number and (array.dtype.kind != kind or array.ndim != len(axes) or array.shape != shape):
            raise ValueError(f"{name} holds {array.dtype} of shape {array.shape}; expected ({', '.join(axes)})")
        columns[name] = array.tolist() if axes == ["n"] else array
    for count, names in lists.items():
        columns |= {name: _split(arrays[name], arrays[count], count) for name in names}
    curves: list[Any] = [None] * number
    if with_cycles:
        pairs = zip(columns.pop("cycle"), columns.pop("cycle_points"), strict=True)
        curves = [partial(tuple, pair) for _, pair in zip(range(number), pairs, strict=False)]
    return [Loop(**{name: column[i] for name, column in columns.items()}, _curve=curves[i]) for i in range(number)]
