"""Episodes and tracked states on disk: one compressed `.npz` each, with a JSON header and without pickle.

Positions of an episode are stored as whole ticks of 0.1 mm, so reading costs at most 0.05 mm. Along time they are stored as
differences, which are small and compress well. With ``a = archive["points"]`` the vertices in metres are
``np.cumsum(a, axis=0, dtype=a.dtype) / 10_000``: the type matters, because differences may wrap around.
Tracked states are stored as ids of points and values. Every text and number that is no array is in the header.

Source: the paper's section 6 defines the contents of an episode; the format is ours. Taught in chapters 0 and 11.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._archive import FormatError, load_archive, save_archive
from ._validate import as_ids
from .rips import Diagram, rips_persistence
from .seqph import Loop, TopologicalState

__all__ = ["Episode", "load_episode", "load_states", "save_episode", "save_states"]

Clouds = Sequence[NDArray[Any]] | NDArray[Any]  # of a film, (n, d) each
SCHEMA = 2
# Frames that a forecast looks back on, and frames that it looks ahead to (Antonova et al. 2021, section 5).
HISTORY = 16
HORIZON = 60
TICKS = 10_000  # units of a stored coordinate in a metre
#: Names of the loops of the wardrobe's garments, which files of episodes leave out.
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
}
EPISODE_KIND = "topokit-episode"
ABSENT = 65535  # the point id that stands for "no neighbour"
# Arrays: kinds of number, then sizes; one letter is one size throughout.
_EPISODE_LAYOUT = {
    "points": "if T N 3",
    "observed": "if T M 3",
    "actions": "if T 2 3",
    "grippers": "if T 2 3",
    "centre_line": "if K 3",
    "held": "b T",
    "faces": "i F 3",
}
_STATES_LAYOUT = {"id": "i T S", "simplices": "u T S 22", "values": "f T S 7", "parameters": "f T 4"}


@dataclass(frozen=True, eq=False)
class Episode:
    """One recorded run of two grippers carrying a garment to a target. Arrays are held as they are given, not copied."""

    points: NDArray[np.float32]  #: (T, N, 3) all vertices of the garment in mesh order, metres
    #: (T, M, 3) the observed points: farthest-point samples of the vertices, or of the cameras' points (see `observation`)
    observed: NDArray[np.float32]
    actions: NDArray[np.float32]  #: (T, 2, 3) commanded places of the two grippers
    grippers: NDArray[np.float32]  #: (T, 2, 3) measured places of the two grippers
    held: NDArray[np.bool_]  #: (T,) True in frames in which the grippers hold the garment
    faces: NDArray[np.int32]  #: (F, 3) vertex ids of the triangles
    #: the true loops, each a closed cycle (L,) of vertex ids, the last joins the first
    loops: tuple[NDArray[np.int32], ...]
    centre_line: NDArray[np.float32]  #: (K, 3) the target's centre line, an open polyline
    garment: str  #: name of the garment
    target: str  #: name of the target
    success: bool  #: True if the task's true loops hang on the target, at rest, after release
    seed: int  #: seed of everything random
    dt: float  #: seconds between frames
    task: str = ""  #: name of the task: garment and target
    #: description of the observation: its kind and, for cameras, all their parameters
    observation: dict[str, Any] = field(default_factory=dict)
    #: all parameters of the simulation, the target's sizes and position, what was randomised and in which ranges
    physics: dict[str, Any] = field(default_factory=dict)
    provenance: dict[str, Any] = field(default_factory=dict)  #: the command and the versions that made it
    schema: int = SCHEMA  #: version of the file format

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        sizes = f"{len(self)} frames of {self.points.shape[1]} vertices, {self.observed.shape[1]} observed points"
        return f"Episode({self.garment} and {self.target}, {sizes}, loops {list(self.named_loops)}, success={self.success})"

    @property
    def times(self) -> NDArray[np.float64]:
        """Return the times (T,) of the frames, in seconds since the first."""
        return np.arange(len(self), dtype=np.float64) * self.dt

    @property
    def named_loops(self) -> dict[str, NDArray[np.int32]]:
        """Return the true loops by their names, or by their numbers ("loop 1") in a file without names."""
        names = self.physics.get("loops") or wardrobe_names(self.garment, self.physics.get("garment"))
        if not names:
            names = [f"loop {i + 1}" for i in range(len(self.loops))]
        return dict(zip(names, self.loops, strict=True))


def wardrobe_names(garment: str, sizes: object) -> tuple[str, ...]:
    """Return the names of a garment's loops if it is one of the wardrobe; a mesh of one's own has no spacing."""
    if isinstance(sizes, dict) and "spacing" in sizes:
        return LOOP_NAMES.get(garment, ())
    return ()


def save_episode(path: str | Path, episode: Episode) -> Path:
    """Write `episode` to `path` (`.npz`) in one piece: a reader finds the old file or the whole new one.

    Parameters
    ----------
    path : path
        Name of the file, which ends in .npz.
    episode : Episode
        The episode, whose parts must fit each other. The same episode gives the same bytes.

    Raises
    ------
    ValueError
        When a part has the wrong shape or kind; the message names it.
    """
    check_episode(episode)
    # Positions become ticks, and along time differences.
    arrays: dict[str, NDArray[Any]] = {
        "held": np.asarray(episode.held, dtype=np.bool_),
        "faces": np.asarray(episode.faces, dtype=np.int32),
        "centre_line": as_ticks(episode.centre_line, "centre_line"),
    }
    for name in ("points", "actions", "grippers"):
        arrays[name] = _differences(as_ticks(getattr(episode, name), name))

    # An observation of vertices is stored as their ids, which take a third of the room.
    ids = _vertex_ids(episode.points, episode.observed)
    if ids is None:
        arrays["observed"] = _differences(as_ticks(episode.observed, "observed"))
    else:
        arrays["observed_ids"] = ids

    header: dict[str, Any] = {
        name: value for name, value in vars(episode).items() if name not in (*_EPISODE_LAYOUT, "loops")
    }
    header["frames"] = len(episode)
    header["loops"] = [np.asarray(loop).tolist() for loop in episode.loops]
    return save_archive(path, EPISODE_KIND, header, arrays)


def load_episode(path: str | Path) -> Episode:
    """Read an episode that `save_episode` wrote.

    Raises
    ------
    ValueError
        When the file is empty, damaged, of another format or of another schema; the message names the reason.
    """
    header, arrays = load_archive(path, EPISODE_KIND)
    if header.get("schema") != SCHEMA:
        raise FormatError(f"{path}: schema {header.get('schema')} where {SCHEMA} is expected: record it again")
    try:
        parts: dict[str, Any] = {"held": arrays["held"], "faces": arrays["faces"]}
        parts["centre_line"] = as_metres(arrays["centre_line"])
        for name in ("points", "actions", "grippers"):
            parts[name] = as_metres(_sums(arrays[name]), name)
        vertices = arrays["points"].shape[1]
        if "observed_ids" in arrays:
            ids = as_ids(arrays["observed_ids"], "observed_ids", vertices)
            parts["observed"] = np.take_along_axis(parts["points"], ids[:, :, None], axis=1)
        else:
            parts["observed"] = as_metres(_sums(arrays["observed"]))
        loops = [as_ids(ids, f"loops[{i}]", vertices).astype(np.int32) for i, ids in enumerate(header.pop("loops"))]
        if header.pop("frames") != len(arrays["held"]):
            raise ValueError("the header gives another number of frames than the arrays")
        episode = Episode(loops=tuple(loops), **parts, **header)
        check_episode(episode)
    except (KeyError, TypeError, IndexError, ValueError) as error:
        raise FormatError(f"{path}: a part of the episode is missing or does not fit: {error}") from error
    return episode


def check_episode(episode: Episode) -> None:
    """Raise ValueError unless the parts of an episode fit each other; the message names the part and the place."""
    if len(episode) == 0:
        raise ValueError("points holds no frame")
    check_layout({name: getattr(episode, name) for name in _EPISODE_LAYOUT}, _EPISODE_LAYOUT)
    for name in ("points", "observed", "actions", "grippers", "centre_line"):
        positions = getattr(episode, name)
        finite = np.isfinite(positions).reshape(len(positions), -1).all(axis=1)
        if not finite.all():
            raise ValueError(f"{name} has a NaN or infinite coordinate in frame or row {np.flatnonzero(~finite)[0]}")
    for i, loop in enumerate((episode.faces.ravel(), *episode.loops)):
        if as_ids(loop, "faces" if i == 0 else f"loops[{i - 1}]", episode.points.shape[1]).ndim != 1:
            raise ValueError(f"loops[{i - 1}] has shape {np.shape(loop)}; a loop is a list of vertex ids")
    if type(episode.dt) not in (int, float) or not 0 < episode.dt < np.inf:
        raise ValueError(f"dt must be a positive number of seconds between two frames, not {episode.dt!r}")


def as_ticks(positions: NDArray[Any], name: str = "positions") -> NDArray[np.signedinteger[Any]]:
    """Return positions in metres as whole ticks of 0.1 mm: 16-bit integers where they fit, else 32-bit ones."""
    ticks = np.rint(np.asarray(positions, dtype=np.float64) * TICKS)
    farthest = np.abs(ticks).max(initial=0)
    if farthest <= np.iinfo(np.int16).max:
        return ticks.astype(np.int16)
    if farthest <= np.iinfo(np.int32).max:
        return ticks.astype(np.int32)
    raise ValueError(f"{name} reaches {farthest / TICKS:.0f} m from the origin; a file holds coordinates up to 214 km")


def as_metres(ticks: NDArray[Any], name: str = "positions") -> NDArray[np.float32]:
    """Return positions in metres from ticks."""
    if ticks.dtype.kind != "i":
        raise ValueError(f"{name} must be whole ticks, not {ticks.dtype}")
    return (ticks / TICKS).astype(np.float32)


def _differences(ticks: NDArray[Any]) -> NDArray[Any]:
    """Return the first frame and the differences from frame to frame; integers wrap around, and `_sums` wraps them back."""
    return np.diff(ticks, axis=0, prepend=np.zeros_like(ticks[:1]))


def _sums(differences: NDArray[Any]) -> NDArray[Any]:
    return np.cumsum(differences, axis=0, dtype=differences.dtype)


def _vertex_ids(points: NDArray[Any], observed: NDArray[Any]) -> NDArray[np.uint16] | None:
    """Return the ids (T, M) of the observed vertices, or None when an observed point is no vertex of its frame."""
    if points.dtype != observed.dtype or points.shape[1] > np.iinfo(np.uint16).max:
        return None
    ids = np.empty(observed.shape[:2], dtype=np.uint16)
    for frame, (cloud, observed_cloud) in enumerate(zip(points, observed, strict=True)):
        id_of = {position.tobytes(): i for i, position in enumerate(cloud)}
        try:
            ids[frame] = [id_of[position.tobytes()] for position in observed_cloud]
        except KeyError:
            return None
    return ids


def check_layout(arrays: Mapping[str, NDArray[Any]], layout: dict[str, str]) -> None:
    """Raise unless these are the arrays of a layout, each of its kind of number and shape; a letter is one size throughout."""
    unknown = sorted(arrays.keys() - layout.keys())
    if unknown:
        raise KeyError(unknown[0])
    sizes: dict[str, int] = {}
    for name, described in layout.items():
        kind, *letters = described.split()
        array = arrays[name]
        expected = []
        for letter, size in zip(letters, array.shape, strict=False):
            expected.append(int(letter) if letter.isdigit() else sizes.setdefault(letter, size))
        if array.dtype.kind not in kind or array.shape != tuple(expected) or len(letters) != array.ndim:
            raise ValueError(f"{name} is of type {array.dtype} and shape {array.shape}, and does not fit")


# -- loops of tracked states, the form in which files of states and labels of datasets store them ---------------------------


def state_arrays(states: Sequence[TopologicalState], slots: int = 8) -> dict[str, NDArray[Any]]:
    """Return the longest-lived `slots` loops of T states as arrays of one shape: the form in which states are stored.

    `id` (T, S), -1 for no loop; `simplices` (T, S, 22), the point ids of birth edge, killer edge, killer triangles and
    neighbours, 65535 for no neighbour; `values` (T, S, 7), birth, death, `killer_shift` and filtration values of neighbours;
    `parameters` (T, 4), alpha, beta, epsilon and the number of loops without a slot.
    """
    frames = len(states)
    arrays: dict[str, NDArray[Any]] = {
        "id": np.full((frames, slots), -1, dtype=np.int32),
        "simplices": np.zeros((frames, slots, 22), dtype=np.uint16),
        "values": np.zeros((frames, slots, 7)),
        "parameters": np.zeros((frames, 4)),
    }
    # Fill one frame after the other: first the parameters, then a slot for each loop.
    for frame, state in enumerate(states):
        estimated = [state.parameters[name] for name in ("alpha", "beta", "epsilon")]
        arrays["parameters"][frame] = [*estimated, max(0, len(state) - slots)]
        for slot, loop in enumerate(state.loops[:slots]):
            neighbours = np.full((4, 3), ABSENT)
            neighbours[: len(loop.neighbour_ids)] = loop.neighbour_ids
            simplices = (loop.birth_edge, loop.killer_edge, loop.killer_triangle_ids, neighbours)
            values = [loop.birth, loop.death, loop.killer_shift, *loop.neighbour_values]
            arrays["id"][frame, slot] = loop.id
            arrays["simplices"][frame, slot] = np.concatenate([np.ravel(ids) for ids in simplices])
            arrays["values"][frame, slot, : len(values)] = values
    return arrays


def states_of(
    arrays: Mapping[str, NDArray[Any]], clouds: Clouds, times: Sequence[float] | NDArray[np.float64]
) -> list[TopologicalState]:
    """Return the tracked states of such arrays, given the clouds (n, d) that were tracked and their times."""
    states = []
    for number, (points, time) in enumerate(zip(clouds, times, strict=True)):
        frame = _Frame(np.asarray(points, dtype=np.float64))
        slots = np.flatnonzero(arrays["id"][number] >= 0).tolist()
        loops = tuple(_loop(arrays, (number, slot), frame) for slot in slots)
        estimates = arrays["parameters"][number].tolist()
        parameters = dict(zip(("alpha", "beta", "epsilon", "dropped"), estimates, strict=True))
        states.append(TopologicalState(number, float(time), loops, parameters))
    return states


def _loop(arrays: Mapping[str, NDArray[Any]], frame_and_slot: tuple[int, int], frame: _Frame) -> Loop:
    """Return the loop in a slot of a frame."""
    simplices = arrays["simplices"][frame_and_slot].astype(np.int64)
    neighbours = simplices[10:].reshape(4, 3)
    neighbours = neighbours[neighbours[:, 0] != ABSENT]
    birth, death, killer_shift, *neighbour_values = arrays["values"][frame_and_slot].tolist()
    return Loop.from_cloud(
        frame.points,
        partial(frame.cycle, simplices[:4].tolist()),
        id=int(arrays["id"][frame_and_slot]),
        birth=birth,
        death=death,
        killer_shift=killer_shift,
        birth_edge=simplices[:2],
        killer_edge=simplices[2:4],
        killer_triangle_ids=simplices[4:10].reshape(2, 3),
        neighbour_ids=neighbours,
        neighbour_values=np.array(neighbour_values[: len(neighbours)]),
    )


@dataclass(frozen=True)
class _Frame:
    """A tracked cloud; its persistence is computed once, when the first cycle of a loop is needed."""

    points: NDArray[np.float64]

    @cached_property
    def diagram(self) -> Diagram:
        """Return the persistence diagram of the cloud."""
        return rips_persistence(self.points)

    def cycle(self, edges: list[int]) -> NDArray[np.int64]:
        """Return the cycle of the loop with this birth edge and killer edge, four point ids."""
        diagram = self.diagram
        edges_of_loops = np.column_stack([diagram.birth_edge, diagram.killer_edge]).tolist()
        if edges not in edges_of_loops:
            raise LookupError(
                "the tracker left points of this cloud out, so its cycle is not stored: track the cloud again"
            )
        return diagram.cycle(edges_of_loops.index(edges))


def save_states(path: str | Path, states: Sequence[TopologicalState]) -> Path:
    """Write tracked states to a file in one piece; `load_states` reads them, given the clouds that were tracked.

    Parameters
    ----------
    path : path
        Name of the file, which ends in .npz; a ValueError otherwise.
    states : sequence of TopologicalState
        States to store, of clouds of fewer than 65,535 points.
    """
    slots = max((len(state) for state in states), default=0)
    arrays = state_arrays(states, slots)
    arrays["time"] = np.array([state.time for state in states], dtype=np.float64)
    return save_archive(path, "topokit-states", {"schema": 4}, arrays)


def load_states(path: str | Path, clouds: Clouds) -> list[TopologicalState]:
    """Read states that `save_states` wrote.

    Parameters
    ----------
    path : path
    clouds : sequence of (n, d) arrays
        The clouds that were tracked, whose points the stored ids name.

    Raises
    ------
    ValueError
        When the file is damaged, of another format or schema, or of other clouds; the message names the reason.
    """
    header, arrays = load_archive(path, "topokit-states")
    if header.get("schema") != 4:
        raise FormatError(f"{path}: schema {header.get('schema')} where 4 is expected: track the clouds again")
    try:
        times = arrays.pop("time")
        check_states(arrays, clouds)
        return states_of(arrays, clouds, times)
    except (KeyError, ValueError, IndexError) as error:
        raise FormatError(f"{path}: {error}; track the clouds again") from error


def check_states(arrays: Mapping[str, NDArray[Any]], clouds: Clouds) -> None:
    """Raise ValueError unless arrays of states have their layout and name points of these clouds."""
    check_layout(arrays, _STATES_LAYOUT)
    if len(arrays["id"]) != len(clouds):
        raise ValueError(f"it has {len(arrays['id'])} frames, and {len(clouds)} clouds are given")
    for frame, cloud in enumerate(clouds):
        simplices = arrays["simplices"][frame][arrays["id"][frame] >= 0]
        # Only neighbours may be absent: the first ten ids of a loop are its edges and killer triangles.
        point_ids = np.append(simplices[simplices != ABSENT], simplices[:, :10])
        if point_ids.max(initial=0) >= max(len(cloud), 1):
            raise ValueError(f"frame {frame} names point {point_ids.max()}, and its cloud has {len(cloud)} points")
