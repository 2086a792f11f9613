"""How a dataset lies on disk: a Zarr v3 group, one array for every field, the episode as first axis.

Idea: every object of the store belongs to one episode, so that episodes are written by many processes without a lock and
are there wholly or not at all. Coordinates are 16-bit integers in units of 0.1 mm, an error of 0.05 mm at most.

    zarr.json               what the dataset is: configuration, seed, number of episodes, versions
    points/c.7.0.0.0        the vertices of episode 7: one shard, whose inner chunks are 16 frames
    records/00000007.json   what episode 7 is, and the SHA-256 of its objects: written last, it makes the episode count
    index.json              the records in short, for opening quickly; it may lag behind
    labels/NAME/...         a group with records of its own, laid out in the same way
"""

from __future__ import annotations

import hashlib
import json
import math
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topokit._archive import FREE, RATIO
from topokit.io import HISTORY, Episode
from topokit.rips import Diagram, rips_persistence
from topokit.seqph import Loop, TopologicalState, loop_of

METRE = 10_000  # units of a stored coordinate in a metre
_METRES = ("points", "actions", "grippers", "centre_line")
_RECORDED = ("garment", "target", "task", "success", "seed", "dt", "observation", "physics")
_COORDINATES = {"units": "m", "scale_factor": 1 / METRE, "add_offset": 0.0}
SIMPLICES = {
    "birth_edge": slice(0, 2),
    "killer_edge": slice(2, 4),
    "killer_triangles": slice(4, 10),
    "neighbours": slice(10, 22),
}
VALUES = ("birth", "death", "step", "neighbour_0", "neighbour_1", "neighbour_2", "neighbour_3")
PARAMETERS = ("alpha", "beta", "epsilon", "dropped")
ABSENT = 65535
_ROOM = ("frames", "vertices", "observed", "seen", "faces", "loops", "loop", "line")


@dataclass(frozen=True)
class Field:
    """An array of the store, without its first axis, the episode."""

    name: str
    shape: tuple[int, ...]  # what the largest episode needs; others fill a corner, whose extent their records give
    dtype: str
    axes: tuple[str, ...]
    attributes: Mapping[str, Any] = field(default_factory=dict)
    fill: int = 0

    @property
    def split(self) -> bool:
        """Whether an object is a shard of chunks of `HISTORY` frames; the others are a few kB: chunks would only add to them."""
        return self.name in ("points", "observed")

    @property
    def time_last(self) -> bool:
        """With time innermost, neighbours in memory differ by what a vertex moves in a frame: half the bytes of mesh order."""
        return self.axes[0] == "frame" and len(self.shape) > 1

    def path(self, index: int) -> str:
        """Where an episode's object is."""
        return f"{self.name}/c.{index}" + ".0" * len(self.shape)


def episode_fields(size: Mapping[str, int]) -> tuple[Field, ...]:
    """Return the arrays of a dataset with room for episodes of a size (`room`); ValueError when no dataset has that."""
    for name, most in {**dict.fromkeys(_ROOM, 2**20), "vertices": 2**15}.items():  # `loops` has 15 bits for an id
        if type(size.get(name)) is not int or not 0 <= size[name] <= most:
            raise ValueError(f"room.{name} must be a whole number up to {most}, not {size.get(name)!r:.50}")
    if size["frames"] % HISTORY:
        raise ValueError(f"room.frames must be a multiple of {HISTORY}, not {size['frames']}")
    frames, steps = size["frames"], ("frame", "gripper", "xyz")
    ids = {"units": "1", "description": "vertex ids"}
    farthest = {**ids, "description": "vertex ids, farthest-point order: the first m are the sample of m points"}
    held = {"units": "1", "description": "1 while the grippers hold the cloth"}
    if size["seen"]:
        observed = Field("observed", (frames, size["seen"], 3), "int16", ("frame", "observation", "xyz"), _COORDINATES)
    else:
        observed = Field("observed", (frames, size["observed"]), "uint16", ("frame", "observation"), farthest)
    return (
        Field("points", (frames, size["vertices"], 3), "int16", ("frame", "vertex", "xyz"), _COORDINATES),
        observed,
        Field("actions", (frames, 2, 3), "int16", steps, _COORDINATES),
        Field("grippers", (frames, 2, 3), "int16", steps, _COORDINATES),
        Field("held", (frames,), "uint8", ("frame",), held),
        Field("faces", (size["faces"], 3), "uint16", ("face", "corner"), ids),
        Field("loops", (size["loops"], size["loop"]), "int16", ("loop", "place"), ids, -1),
        Field("centre_line", (size["line"], 3), "int16", ("place", "xyz"), _COORDINATES),
    )


def episode_arrays(episode: Episode) -> dict[str, NDArray[Any]]:
    """Return what the arrays hold of an episode, each in its own extent."""
    longest = max((len(loop) for loop in episode.loops), default=0)
    loops = np.full((len(episode.loops), longest), -1, dtype=np.int16)
    for row, loop in zip(loops, episode.loops, strict=True):
        row[: len(loop)] = loop
    arrays: dict[str, NDArray[Any]] = {"held": episode.held.astype(np.uint8), "faces": episode.faces.astype(np.uint16)}
    arrays |= {name: pack(name, getattr(episode, name)) for name in _METRES}
    of_vertices = episode.observation["kind"] == "vertices"
    seen = vertex_ids(episode.points, episode.observed) if of_vertices else pack("observed", episode.observed)
    return {**arrays, "observed": seen, "loops": loops}


def episode_of(stored: Mapping[str, NDArray[Any]], document: Mapping[str, Any], manifest: Mapping[str, Any]) -> Episode:
    """Return an episode from its arrays, its record, and what its dataset says of itself."""
    metres: dict[str, Any] = {name: unpack(stored[name]) for name in _METRES}
    if not all(0 <= n <= stored["loops"].shape[1] for n in document["loops"]):
        raise ValueError(f"loops of lengths {document['loops']}, of {stored['loops'].shape[1]} at most")
    return Episode(
        **metres,
        observed=unpack(observed(stored)),
        held=stored["held"].astype(np.bool_),
        faces=stored["faces"].astype(np.int32),
        loops=tuple(row[:n].astype(np.int32) for row, n in zip(stored["loops"], document["loops"], strict=True)),
        **{name: document[name] for name in _RECORDED},
        provenance={**manifest["versions"], "dataset_seed": manifest["seed"], "episode": document["episode"]},
    )


def observed(stored: Mapping[str, NDArray[Any]]) -> NDArray[np.int16]:
    """(T, M, 3) an observation from what is stored of it: places, or which of the points they are."""
    points, seen = stored["points"], stored["observed"]
    return seen if seen.ndim == 3 else points[np.arange(len(points))[:, None], seen]


def cloud_of(stored: Mapping[str, NDArray[Any]], labels: Mapping[str, Any]) -> NDArray[np.int16]:
    """(T, n, 3) what labels of that manifest are of: all vertices, or the first points of what was observed."""
    return stored["points"] if labels["observation"] == "full" else observed(stored)[:, : labels["n_points"]]


def vertex_ids(points: NDArray[np.float32], observed: NDArray[np.float32]) -> NDArray[np.uint16]:
    """(T, M) which vertices an observation of vertices is: the same numbers are in `points`."""
    ids = np.empty(observed.shape[:2], dtype=np.uint16)
    for row, cloud, seen in zip(ids, points, observed, strict=True):
        number = {place.tobytes(): i for i, place in enumerate(cloud)}
        row[:] = [number[place.tobytes()] for place in seen]
    return ids


def pack(name: str, values: NDArray[Any]) -> NDArray[np.int16]:
    scaled = np.rint(np.asarray(values, dtype=np.float64) * METRE)
    if scaled.size and np.abs(scaled).max() > np.iinfo(np.int16).max:
        far = np.abs(scaled).max() / METRE
        raise ValueError(f"{name} reaches {far:.2f} m from the origin; a dataset holds coordinates up to 3.27 m")
    return scaled.astype(np.int16)


def unpack(values: NDArray[Any]) -> NDArray[np.float32]:
    return np.asarray(values / METRE, dtype=np.float32)


def label_fields(frames: int, slots: int) -> tuple[Field, ...]:
    """Return the arrays of a set of labels."""
    axes = ("frame", "slot", "column")
    identity = {"units": "1", "description": "identity; -1: no loop"}
    simplices = {
        "units": "1",
        "columns": {name: [part.start, part.stop] for name, part in SIMPLICES.items()},
        "description": f"ids into the cloud that was tracked; {ABSENT}: no neighbour",
    }
    parameters = {"units": "m, dropped: 1", "columns": PARAMETERS}
    return (
        Field("id", (frames, slots), "int32", axes[:2], identity, -1),
        Field("simplices", (frames, slots, 22), "uint16", axes, simplices),
        Field("values", (frames, slots, len(VALUES)), "float32", axes, {"units": "m", "columns": VALUES}),
        Field("parameters", (frames, len(PARAMETERS)), "float32", ("frame", "column"), parameters),
    )


def arrays_of(states: list[TopologicalState], slots: int) -> dict[str, NDArray[Any]]:
    """Return states as the arrays of labels; loops beyond `slots` in a frame, the shortest-lived ones, are dropped."""
    arrays = {f.name: np.full(f.shape, f.fill, dtype=f.dtype) for f in label_fields(len(states), slots)}
    for frame, state in enumerate(states):
        given = [state.parameters[name] for name in PARAMETERS[:3]]
        arrays["parameters"][frame] = *given, max(0, len(state) - slots)
        for slot, loop in enumerate(state.loops[:slots]):
            neighbours = np.full((4, 3), ABSENT)
            neighbours[: len(loop.neighbour_ids)] = loop.neighbour_ids
            parts = (loop.birth_edge, loop.killer_edge, loop.killer_triangle_ids, neighbours)
            numbers = [loop.birth, loop.death, loop.killer_shift, *loop.neighbour_values]
            arrays["id"][frame, slot] = loop.id
            arrays["simplices"][frame, slot] = np.concatenate([np.ravel(part) for part in parts])
            arrays["values"][frame, slot, : len(numbers)] = numbers
    return arrays


@dataclass(frozen=True)
class _Frame:
    """A tracked cloud, whose persistence is computed once: when the first of its loops is asked for its cycle."""

    points: NDArray[np.float64]

    @cached_property
    def diagram(self) -> Diagram:
        return rips_persistence(self.points)

    def cycle(self, edges: list[int]) -> NDArray[np.int64]:
        """That of the loop with those birth and killer edges."""
        pairs = np.column_stack([self.diagram.birth_edge, self.diagram.killer_edge])
        return self.diagram.cycle(pairs.tolist().index(edges))


def states_of(stored: Mapping[str, NDArray[Any]], cloud: NDArray[np.float32], dt: float) -> list[TopologicalState]:
    """Return the tracked states that labels hold, in the coordinates of the cloud that was tracked."""
    states = []
    for number, points in enumerate(cloud.astype(np.float64)):
        slots, frame = np.flatnonzero(stored["id"][number] >= 0).tolist(), _Frame(points)
        loops = tuple(_loop(stored, (number, slot), frame) for slot in slots)
        parameters = dict(zip(PARAMETERS, stored["parameters"][number].tolist(), strict=True))
        states.append(TopologicalState(number, number * dt, loops, parameters))
    return states


def _loop(stored: Mapping[str, NDArray[Any]], where: tuple[int, int], frame: _Frame) -> Loop:
    simplices = stored["simplices"][where].astype(np.int64)
    ids = {name: simplices[part] for name, part in SIMPLICES.items()}
    neighbours = ids["neighbours"].reshape(4, 3)
    neighbours = neighbours[neighbours[:, 0] != ABSENT]
    values = stored["values"][where].tolist()
    return loop_of(
        frame.points,
        partial(frame.cycle, simplices[:4].tolist()),
        id=int(stored["id"][where]),
        **dict(zip(("birth", "death", "killer_shift"), values[:3], strict=True)),
        birth_edge=ids["birth_edge"],
        killer_edge=ids["killer_edge"],
        killer_triangle_ids=ids["killer_triangles"].reshape(2, 3),
        neighbour_ids=neighbours,
        neighbour_values=np.array(values[3 : 3 + len(neighbours)]),
    )


def needed(name: str) -> Any:
    """A package of the extra `data`, imported now; an ImportError tells how it is had."""
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        later = ", on Python 3.11 or later" if sys.version_info < (3, 11) else ""  # as Zarr 3 wants it
        raise ImportError(f"datasets need {error.name or name}: pip install 'topokit[data]'{later}") from error


def canonical(document: Mapping[str, Any]) -> bytes:
    return (json.dumps(document, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n").encode()


def skeleton(fields: Iterable[Field], manifest: Mapping[str, Any]) -> dict[str, bytes]:
    """Return the `zarr.json` of a group and of its arrays: path in the group -> content."""
    zarr, store = needed("zarr"), dict[str, Any]()
    attributes = {"topokit": dict(manifest), "sha256": hashlib.sha256(canonical(manifest)).hexdigest()}
    zarr.create_group(store, attributes=attributes, zarr_format=3)
    for f in fields:
        _create(store, f, manifest["episodes"])
    return {path: buffer.to_bytes() for path, buffer in store.items()}


def encode(fields: Iterable[Field], index: int, arrays: Mapping[str, NDArray[Any]]) -> Iterator[tuple[str, bytes]]:
    """Yield the objects of an episode: path in the group and content. What is all fill value has none."""
    for f in fields:
        store: dict[str, Any] = {}
        _create(store, f, index + 1)[(index, *map(slice, arrays[f.name].shape))] = arrays[f.name]
        for path, buffer in store.items():
            if not path.endswith("zarr.json"):
                yield path, buffer.to_bytes()


def decoded(f: Field, content: bytes | None, extent: Sequence[int]) -> NDArray[Any]:
    """Return an array of an episode in its own extent, from its object; None when all of it is the fill value.

    Idea: what is declared (extents, places in a shard, sizes of Blosc's frames) is compared with the field and with what is
    there before memory is taken; Zarr would take what it is told.
    """
    blosc = needed("numcodecs").blosc
    blosc.use_threads = False  # as Zarr has it: threads of Blosc's own do not outlive a fork
    dtype, stored = np.dtype(f.dtype).newbyteorder("<"), content or b""
    fits = [type(n) for n in extent] == [int] * len(f.shape)
    if not fits or any(not 0 <= n <= most for n, most in zip(extent, f.shape, strict=True)):
        raise ValueError(f"of shape {extent!r:.200} in room for {f.shape}")
    chunk = (HISTORY, *f.shape[1:]) if f.split else f.shape
    size = dtype.itemsize * math.prod(chunk)
    if max(size, dtype.itemsize * math.prod(extent)) > FREE + RATIO * len(stored):
        raise ValueError(f"of shape {extent} from {len(stored)} bytes: too much")
    values = np.full(extent, f.fill, dtype=f.dtype)
    for start, frame in (_chunks(f, stored) if content is not None else {}).items():
        if len(frame) < 16 or np.frombuffer(frame[4:16], dtype="<u4")[[0, 2]].tolist() != [size, len(frame)]:
            raise ValueError(f"the object does not hold the {size} bytes of a chunk")
        flat = np.frombuffer(blosc.decompress(frame), dtype=dtype)
        whole = np.moveaxis(flat.reshape(*chunk[1:], chunk[0]), -1, 0) if f.time_last else flat.reshape(chunk)
        part = values[start : start + chunk[0]]
        part[...] = whole[tuple(map(slice, part.shape))]
    return values


def _chunks(f: Field, content: bytes) -> dict[int, bytes]:
    """The chunks of an object by their first row; the index of a shard, at its end, says where they are."""
    if not f.split:
        return {0: content}
    count = f.shape[0] // HISTORY
    index = np.frombuffer(content[-16 * count - 4 : -4], dtype="<u8").reshape(count, 2).tolist()
    return {i * HISTORY: content[at : at + size] for i, (at, size) in enumerate(index) if at != 2**64 - 1}


def _create(store: dict[str, Any], f: Field, episodes: int) -> Any:
    zarr, codecs = needed("zarr"), needed("zarr.codecs")
    time_last = codecs.TransposeCodec(order=(0, *range(2, len(f.shape) + 1), 1))
    return zarr.create_array(
        store,
        name=f.name,
        shape=(episodes, *f.shape),
        dtype=f.dtype,
        chunks=(1, HISTORY, *f.shape[1:]) if f.split else (1, *f.shape),
        shards=(1, *f.shape) if f.split else None,
        filters=[time_last] if f.time_last else None,
        compressors=codecs.BloscCodec(typesize=np.dtype(f.dtype).itemsize, cname="zstd", clevel=5, shuffle="shuffle"),
        fill_value=f.fill,
        chunk_key_encoding={"name": "default", "separator": "."},  # a file an episode, not four folders
        dimension_names=("episode", *f.axes),
        attributes=dict(f.attributes),
        zarr_format=3,
    )
