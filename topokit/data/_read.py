"""Read an episode, or its labels, from the arrays of a group."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topokit.io import Episode
from topokit.state import Loop, TopologicalState

from ._group import Group
from ._layout import unpack

__all__ = ["cloud_of", "decode", "states_of", "to_episode"]


def decode(group: Group, document: Mapping[str, Any], names: tuple[str, ...] = ()) -> dict[str, NDArray[Any]]:
    """Return the arrays of an episode as they are stored, each in its own extent; all of them when none is named."""
    index, shapes = document["episode"], document["shapes"]
    return {
        name: np.asarray(group.array(name)[(index, *(slice(n) for n in shapes[name]))])
        for name in names or tuple(shapes)
    }


def to_episode(group: Group, document: Mapping[str, Any]) -> Episode:
    """Return an episode from its record and the arrays of its group."""
    stored = decode(group, document)
    points = unpack(stored["points"])
    return Episode(
        points=points,
        observed=_observed(points, stored["observed"]),
        actions=unpack(stored["actions"]),
        grippers=unpack(stored["grippers"]),
        held=stored["held"].astype(np.bool_),
        faces=stored["faces"].astype(np.int32),
        loops=tuple(row[:n].astype(np.int32) for row, n in zip(stored["loops"], document["loops"], strict=True)),
        centre_line=unpack(stored["centre_line"]),
        **{
            name: document[name]
            for name in ("garment", "target", "task", "success", "seed", "dt", "observation", "physics")
        },
        provenance={
            **group.manifest["versions"],
            "dataset_seed": group.manifest["seed"],
            "episode": document["episode"],
        },
    )


def cloud_of(
    group: Group, document: Mapping[str, Any], observation: str, n_points: int | None = None
) -> NDArray[np.float32]:
    """(T, n, 3) what an observer sees: all vertices ("full"), or the observation that was recorded ("observed").

    Of an observation of vertices the first `n_points` are a farthest-point sample of that many.
    """
    if observation == "full":
        return unpack(decode(group, document, ("points",))["points"])
    seen = decode(group, document, ("observed",))["observed"][:, :n_points]
    if seen.ndim == 3:
        return unpack(seen)
    return _observed(unpack(decode(group, document, ("points",))["points"]), seen)


def _observed(points: NDArray[np.float32], stored: NDArray[Any]) -> NDArray[np.float32]:
    return unpack(stored) if stored.ndim == 3 else points[np.arange(len(points))[:, None], stored]


SIMPLICES = {
    "birth_edge": slice(0, 2),
    "killer_edge": slice(2, 4),
    "killer_triangles": slice(4, 10),
    "neighbours": slice(10, 22),
}
VALUES = ("birth", "death", "step", "neighbour_0", "neighbour_1", "neighbour_2", "neighbour_3")
PARAMETERS = ("alpha", "beta", "epsilon", "dropped")
ABSENT = 65535


def states_of(
    stored: Mapping[str, NDArray[Any]], cloud: NDArray[np.float32], times: NDArray[np.float64]
) -> list[TopologicalState]:
    """Return the tracked states that labels hold, in the coordinates of the cloud that was tracked."""
    states = []
    for frame, (points, time) in enumerate(zip(cloud.astype(np.float64), times, strict=True)):
        loops = [
            _loop(
                int(stored["id"][frame, slot]), stored["simplices"][frame, slot], stored["values"][frame, slot], points
            )
            for slot in np.flatnonzero(stored["id"][frame] >= 0)
        ]
        parameters = dict(zip(PARAMETERS, stored["parameters"][frame].tolist(), strict=True))
        states.append(TopologicalState(frame, float(time), tuple(loops), parameters))
    return states


def _loop(identity: int, simplices: NDArray[Any], values: NDArray[Any], points: NDArray[np.float64]) -> Loop:
    ids = simplices.astype(np.int64)
    neighbours = ids[SIMPLICES["neighbours"]].reshape(4, 3)
    neighbours = neighbours[neighbours[:, 0] != ABSENT]
    killers, edge = ids[SIMPLICES["killer_triangles"]].reshape(2, 3), ids[SIMPLICES["killer_edge"]]
    birth, death, step = (float(value) for value in values[:3])
    return Loop(
        id=identity,
        birth=birth,
        death=death,
        birth_edge=ids[SIMPLICES["birth_edge"]],
        killer_edge=edge,
        killer_triangle_ids=killers,
        neighbour_ids=neighbours,
        killer_edge_points=points[edge],
        killer_triangles=points[killers],
        neighbours=points[neighbours],
        killer_values=np.array([death, death]),
        neighbour_values=values[3 : 3 + len(neighbours)].astype(np.float64),
        step=step,
    )
