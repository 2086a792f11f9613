"""How tracked states lie in the arrays of a set of labels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topokit.state import Loop, TopologicalState

from ._layout import Field

SIMPLICES = {
    "birth_edge": slice(0, 2),
    "killer_edge": slice(2, 4),
    "killer_triangles": slice(4, 10),
    "neighbours": slice(10, 22),
}
VALUES = ("birth", "death", "step", "neighbour_0", "neighbour_1", "neighbour_2", "neighbour_3")
PARAMETERS = ("alpha", "beta", "epsilon", "dropped")
ABSENT = 65535


def label_fields(frames: int, slots: int) -> tuple[Field, ...]:
    """Return the arrays of a set of labels."""
    axes = ("frame", "slot", "column")
    identity = {"units": "1", "description": "identity; -1: no loop"}
    simplices = {
        "units": "1",
        "columns": {name: [part.start, part.stop] for name, part in SIMPLICES.items()},
        "description": f"ids into the cloud that was tracked; {ABSENT}: no neighbour",
    }
    values = {"units": "m", "columns": VALUES}
    parameters = {"units": "m, dropped: 1", "columns": PARAMETERS}
    return (
        Field("id", (frames, slots), "int32", axes[:2], identity, -1),
        Field("simplices", (frames, slots, 22), "uint16", axes, simplices),
        Field("values", (frames, slots, len(VALUES)), "float32", axes, values),
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
            numbers = [loop.birth, loop.death, loop.step, *loop.neighbour_values]
            arrays["id"][frame, slot] = loop.id
            arrays["simplices"][frame, slot] = np.concatenate([np.ravel(part) for part in parts])
            arrays["values"][frame, slot, : len(numbers)] = numbers
    return arrays


def states_of(
    stored: Mapping[str, NDArray[Any]], cloud: NDArray[np.float32], times: NDArray[np.float64]
) -> list[TopologicalState]:
    """Return the tracked states that labels hold, in the coordinates of the cloud that was tracked."""
    states = []
    for frame, (points, time) in enumerate(zip(cloud.astype(np.float64), times, strict=True)):
        loops = tuple(
            _loop({name: array[frame, slot] for name, array in stored.items() if name != "parameters"}, points)
            for slot in np.flatnonzero(stored["id"][frame] >= 0)
        )
        parameters = dict(zip(PARAMETERS, stored["parameters"][frame].tolist(), strict=True))
        states.append(TopologicalState(frame, float(time), loops, parameters))
    return states


def _loop(stored: Mapping[str, NDArray[Any]], points: NDArray[np.float64]) -> Loop:
    ids = {name: stored["simplices"][part].astype(np.int64) for name, part in SIMPLICES.items()}
    edge, killers = ids["killer_edge"], ids["killer_triangles"].reshape(2, 3)
    neighbours = ids["neighbours"].reshape(4, 3)
    neighbours = neighbours[neighbours[:, 0] != ABSENT]
    birth, death, step, *neighbour_values = stored["values"].tolist()
    return Loop(
        id=int(stored["id"]),
        birth=birth,
        death=death,
        birth_edge=ids["birth_edge"],
        killer_edge=edge,
        killer_triangle_ids=killers,
        neighbour_ids=neighbours,
        killer_edge_points=points[edge],
        killer_triangles=points[killers],
        neighbours=points[neighbours],
        killer_values=np.array([death, death]),
        neighbour_values=np.array(neighbour_values[: len(neighbours)]),
        step=step,
    )
