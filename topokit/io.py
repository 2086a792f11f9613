"""Episodes and tracked states on disk: one compressed `.npz` each, without pickle, checksummed, replaced in one piece.

Coordinates are packed to 16 bits with one scale an array (2 m of room costs an error of 0.015 mm; a float16 would cost
0.5 mm at one metre), everything else is stored as it is. The text parts are one JSON document beside the arrays.

Source: the paper's section 6 says what an episode holds; the format is ours. Taught in chapter 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._archive import FormatError, load_archive, save_archive
from ._validate import WrongKindError, as_ids, as_reals
from .sensors import read_clouds
from .seqph import Loop, TopologicalState

__all__ = ["FEWEST_FRAMES", "HISTORY", "HORIZON", "LOOP_NAMES", "SCHEMA", "Episode", "FormatError", "load_episode"]
__all__ += ["load_states", "read_clouds", "save_episode", "save_states"]

SCHEMA = 1
HISTORY, HORIZON = 16, 60  # frames that a forecast looks back on, and ahead to (Antonova et al. 2021, section 5)
FEWEST_FRAMES = HISTORY + HORIZON
#: What the loops of the wardrobe's garments are called, of which episodes need not tell.
LOOP_NAMES = {
    "apron": ("neck",),
    "apron2": ("neck", "waist"),
    "tote": ("handle",),
    "tote2": ("handle 1", "handle 2"),
    "backpack": ("strap 1", "strap 2"),
    **dict.fromkeys(("shirt", "vest"), ("neck", "arm 1", "arm 2", "hem")),
    "mask": ("ear 1", "ear 2"),
    "sheet": ("hole",),
    "sheet2": ("hole 1", "hole 2"),
    "scarf": ("neck",),
    "belt": ("loop",),
    "trousers": ("loop", "waist", "leg 1", "leg 2"),
}
_KIND = "topokit-episode"
_STATES_KIND, _STATES_SCHEMA = "topokit-states", 2
_MAX_PACKING_ERROR = 1e-4  # metres
_PACKED = ("points", "observed", "actions", "grippers", "centre_line")
_TEXT: dict[str, type] = {
    **dict.fromkeys(("garment", "target", "task"), str),
    **{"success": bool, "seed": int, "schema": int, "dt": float},
    **dict.fromkeys(("observation", "physics", "provenance"), dict),
}


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

    @property
    def named_loops(self) -> dict[str, NDArray[np.int32]]:
        """The true loops by their names; by their numbers ("loop 1") in a file that knows none."""
        names = self.physics.get("loops") or wardrobe_names(self.garment, self.physics.get("garment"))
        names = names or [f"loop {i + 1}" for i in range(len(self.loops))]
        return dict(zip(names, self.loops, strict=True))


def wardrobe_names(garment: str, sizes: object) -> tuple[str, ...]:
    """What the loops of a garment of these sizes are called if it is one of the wardrobe's; a mesh has no spacing."""
    return LOOP_NAMES.get(garment, ()) if isinstance(sizes, dict) and "spacing" in sizes else ()


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
        arrays[name], arrays[f"{name}_scale"] = packed(getattr(episode, name), name, _MAX_PACKING_ERROR)
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
        check_layout(arrays, _EPISODE_LAYOUT)
        vertices, lengths = arrays.pop("loop_vertices"), arrays.pop("loop_lengths")
        loops = tuple(_split(vertices, lengths, "loop_vertices")) if len(vertices) else ()
        for name in _PACKED:
            step, *low = scale = arrays.pop(f"{name}_scale")
            if not (0 < step <= 1 and np.abs(scale).max() < 1e30):
                raise ValueError(f"{name} cannot be unpacked: its step and its lowest values are {scale.tolist()}")
            arrays[name] = np.asarray(arrays[name] * step + low, dtype=np.float32)
        parts: dict[str, Any] = {**arrays, **text}
        episode = Episode(loops=loops, **parts)
        check_episode(episode)
    except (KeyError, TypeError) as error:
        raise FormatError(f"{path}: an episode with a missing or an unknown part: {error}; record it again") from error
    except ValueError as error:
        raise FormatError(f"{path}: {error}") from error
    return episode


def check_episode(episode: Episode) -> None:
    """Raise ValueError unless the parts of an episode fit each other; the message says which do not, and where."""
    for name in (*_PACKED, "held", "faces"):
        if not isinstance(as_reals(getattr(episode, name), name), type(getattr(episode, name))):
            raise WrongKindError(f"{name} must be an array, not {type(getattr(episode, name)).__name__}")
    frames, vertices = episode.points.shape[:2] if episode.points.ndim == 3 else (0, 0)
    if episode.points.ndim == 3 and frames == 0:
        raise ValueError("points holds no frame")
    for name, rows in (("points", None), ("observed", None), ("actions", 2), ("grippers", 2)):
        shape = getattr(episode, name).shape
        if len(shape) != 3 or shape != (frames, rows or shape[1], 3):
            raise ValueError(f"{name} has shape {shape}; expected ({frames or 'T'}, {rows or 'N'}, 3), a row a frame")
    if episode.held.shape != (frames,):
        raise ValueError(f"held has shape {episode.held.shape}; expected ({frames},)")
    for name in ("centre_line", "faces"):
        if np.shape(getattr(episode, name))[1:] != (3,):
            raise ValueError(f"{name} has shape {np.shape(getattr(episode, name))}; expected rows of three")
    for name in _PACKED:
        finite = np.isfinite(getattr(episode, name)).reshape(len(getattr(episode, name)), -1).all(axis=1)
        if not finite.all():
            where = f"{'row' if name == 'centre_line' else 'frame'} {np.flatnonzero(~finite)[0]}"
            raise ValueError(f"{name} has a NaN or infinite coordinate in {where}")
    for name, kind in _TEXT.items():
        value = getattr(episode, name)
        if type(value) is not kind and not (kind is float and type(value) is int):
            raise WrongKindError(f"{name} must be a {kind.__name__}, not {value!r:.80}")
    if not np.isfinite(episode.dt) or episode.dt <= 0:
        raise ValueError(f"dt must be the seconds between two frames, not {episode.dt}")
    for name, ids in (("faces", episode.faces), *((f"loops[{i}]", loop) for i, loop in enumerate(episode.loops))):
        if as_ids(ids, name, vertices).ndim != 1 + (name == "faces"):
            raise ValueError(f"{name} has shape {np.shape(ids)}; a loop is a list of vertex ids")
    names = episode.physics.get("loops", [])
    if not isinstance(names, list) or {type(name) for name in names} - {str}:
        raise WrongKindError(f"physics['loops'] must be a list of names, not {names!r:.80}")
    if names and not len(set(names)) == len(names) == len(episode.loops):
        wanted = f"{len(episode.loops)} different names, one a loop"
        raise ValueError(f"physics['loops'] must be {wanted}, not {names!r:.80}")


def packed(
    values: NDArray[Any], name: str = "", most: float = np.inf
) -> tuple[NDArray[np.uint16], NDArray[np.float64]]:
    """Return 16-bit integers and (step, low x, low y, low z) so that values = low + step * integers, to within step / 2."""
    values = np.asarray(values, dtype=np.float64)
    low = values.reshape(-1, 3).min(axis=0) if values.size else np.zeros(3)
    span = max(float((values - low).max(initial=0.0)), 1e-9)
    step = span / 65535
    if step / 2 > most:
        cost = f"16 bits would cost {1e3 * step / 2:.2f} mm, more than {1e3 * most:g} mm"
        raise ValueError(f"{name} spans {span:.1f} m: {cost}")
    return np.round((values - low) / step).astype(np.uint16), np.array([step, *low])


def _load(
    path: str | Path, kind: str, schemas: tuple[int, ...], remedy: str
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read an archive of a kind, of a schema that is known."""
    text, arrays = load_archive(path, kind)
    if text.get("schema") not in schemas:
        raise FormatError(f"{path}: of schema {text.get('schema')}, not {schemas[-1]}: update topokit or {remedy}")
    return text, arrays


def check_layout(arrays: dict[str, NDArray[Any]], layout: dict[str, str]) -> None:
    """Raise ValueError unless all arrays of a layout are of its kind of number and its shape; a letter is one size throughout."""
    sizes: dict[str, int] = {}
    for name, told in layout.items():
        (kind, *letters), array = told.split(), arrays[name]
        known = zip(letters, array.shape, strict=False)
        shape = tuple(int(one) if one.isdigit() else sizes.setdefault(one, size) for one, size in known)
        if array.shape != (0,) and (array.dtype.kind != kind or array.shape != shape or len(letters) != array.ndim):
            raise ValueError(f"{name} is of type {array.dtype} and shape {array.shape}, and does not fit")


def _split(rows: NDArray[Any], counts: NDArray[Any], name: str) -> list[NDArray[Any]]:
    """Rows that belong to one thing after another, so many to each."""
    if (counts < 0).any() or counts.sum() != len(rows):
        raise ValueError(f"{name} has {len(rows)} rows, and they are counted otherwise")
    return np.split(rows, np.cumsum(counts)[:-1])


_EPISODE_LAYOUT = {
    **{"points": "u T N 3", "observed": "u T M 3", "actions": "u T 2 3", "grippers": "u T 2 3", "centre_line": "u K 3"},
    **{f"{name}_scale": "f 4" for name in _PACKED},
    **{"held": "b T", "faces": "i F 3", "loop_vertices": "i V", "loop_lengths": "i L"},
}
# What the loops of states hold: numbers, arrays of one shape, and arrays whose length varies.
_LOOP_NUMBERS = {"id": "i n", "birth": "f n", "death": "f n", "killer_shift": "f n"}
_LOOP_ARRAYS = {
    "birth_edge": "i n 2",
    "killer_edge": "i n 2",
    "killer_triangle_ids": "i n 2 3",
    "killer_edge_points": "f n 2 d",
    "killer_triangles": "f n 2 3 d",
    "killer_values": "f n 2",
}
_FRAMES = {"n_loops": "i t", "frame": "i t", "time": "f t"}
_NEIGHBOURS = {"n_neighbours": "i n", "neighbour_ids": "i m 3", "neighbours": "f m 3 d", "neighbour_values": "f m"}
_CYCLES = {"n_cycle": "i n", "cycle": "i c", "cycle_points": "f c d"}
_LOOP_LISTS = {count: names for count, *names in (_NEIGHBOURS, _CYCLES)}


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
    arrays = {name: np.array([getattr(loop, name) for loop in loops]) for name in _LOOP_NUMBERS | _LOOP_ARRAYS}
    for count, names in _LOOP_LISTS.items():
        for name in names:
            arrays[name] = np.concatenate([getattr(loop, name) for loop in loops] or [np.empty(0)])
        arrays[count] = np.array([len(getattr(loop, names[0])) for loop in loops], dtype=np.int64)
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
        if not all(isinstance(parameters, dict) for parameters in text["parameters"]):
            raise TypeError("parameters that have no names")
        ends = np.cumsum([0, *arrays["n_loops"]]).tolist()
        _split(arrays["id"], arrays["n_loops"], "id")
        parts = [tuple(loops[start:end]) for start, end in pairwise(ends)]
        rows = zip(arrays["frame"].tolist(), arrays["time"].tolist(), parts, text["parameters"], strict=True)
        return [TopologicalState(*row) for row in rows]
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise FormatError(f"{path}: states with a missing or an unknown part: {error}; track them again") from error


def _loops(arrays: dict[str, NDArray[Any]], with_cycles: bool) -> list[Loop]:
    """All loops of all frames; those of the first schema know no cycle."""
    check_layout(arrays, _LOOP_NUMBERS | _LOOP_ARRAYS | _NEIGHBOURS | (_CYCLES if with_cycles else {}) | _FRAMES)
    columns = {name: arrays[name].tolist() for name in _LOOP_NUMBERS} | {name: arrays[name] for name in _LOOP_ARRAYS}
    for count, names in _LOOP_LISTS.items():
        if count != "n_cycle" or with_cycles:
            columns |= {name: _split(arrays[name], arrays[count], name) for name in names}
    number = len(arrays["id"])
    curves: list[Any] = [None] * number
    if with_cycles:
        pairs = zip(columns.pop("cycle"), columns.pop("cycle_points"), strict=True)
        curves = [partial(tuple, pair) for _, pair in zip(range(number), pairs, strict=False)]
    return [Loop(**{name: column[i] for name, column in columns.items()}, _curve=curves[i]) for i in range(number)]
