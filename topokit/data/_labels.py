"""The labels of a dataset: the tracked loops in every frame of every episode, as arrays of one shape.

Every frame has S slots, which hold its loops of longest lifetime. Places are stored as ids of points in the cloud that was
tracked. The arrays of an episode of T frames are:

    id          (T, S)        the identity of a loop; -1: no loop
    simplices   (T, S, 22)    point ids: birth edge, killer edge, killer triangles, neighbours (65535: none)
    values      (T, S, 7)     birth, death, killer_shift and the filtration values of the neighbours, metres
    parameters  (T, 4)        alpha, beta and epsilon of the tracker, and how many loops had no slot
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from topokit._archive import FormatError, load_archive
from topokit._config import checked
from topokit.io import Episode, check_layout
from topokit.rips import Diagram, rips_persistence
from topokit.seqph import Loop, TopologicalState

from ._folder import NumberedFiles, read_settings

KIND = "topokit-labels"
ABOUT = "labels.json"
SLOTS = 8  # loops that are kept in a frame
# The columns of `simplices`.
SIMPLICES = {
    "birth_edge": slice(0, 2),
    "killer_edge": slice(2, 4),
    "killer_triangles": slice(4, 10),
    "neighbours": slice(10, 22),
}
ABSENT = 65535  # the point id that stands for "no neighbour"
_PARAMETERS = ("alpha", "beta", "epsilon", "dropped")
_LAYOUT = {"id": "i T S", "simplices": "u T S 22", "values": "f T S 7", "parameters": "f T 4"}


@checked
class LabelSettings:
    """The settings with which a set of labels was made."""

    schema: Literal[2]
    observation: Literal["full", "observed", "camera"]  #: the points that were tracked
    n_points: int | None  #: number of first points of an observation that were tracked; None for all
    options: Mapping[str, Any]  #: the options of the tracker, `topokit.SeqPH`
    versions: Mapping[str, str]  #: the versions of the packages that made the labels


class Labels(NumberedFiles):
    """One set of labels of a dataset, in a folder beside its episodes: `Dataset.labels`."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, KIND, ABOUT)
        self.settings: LabelSettings = read_settings(
            LabelSettings, folder / ABOUT
        )  #: the settings with which the labels were made

    @property
    def options(self) -> dict[str, Any]:
        """Return the options of the tracker."""
        return dict(self.settings.options)

    def cloud(self, episode: Episode) -> NDArray[np.float32]:
        """Return the cloud that was tracked in an episode, (T, n, 3) metres: all vertices, or the first observed points."""
        return cloud_of(episode, self.settings)

    def arrays(self, number: int) -> dict[str, NDArray[Any]]:
        """Return the arrays of labels of an episode."""
        path = self.path_of(number)
        _, arrays = load_archive(path, KIND)
        try:
            check_layout(arrays, _LAYOUT)
        except (KeyError, ValueError) as error:
            raise FormatError(
                f"{path}: the arrays are not those of labels: {error}; remove the file and label again"
            ) from error
        return arrays

    def check_fit(self, number: int, arrays: Mapping[str, NDArray[Any]], frames: int, points: int) -> None:
        """Raise FormatError unless the arrays of an episode fit clouds of so many frames and points."""
        simplices = arrays["simplices"][arrays["id"] >= 0]
        point_ids = simplices[simplices != ABSENT]
        # Only neighbours may be absent: the first ten ids of a loop are its edges and killer triangles.
        incomplete = (simplices[:, :10] == ABSENT).any()
        if len(arrays["id"]) != frames or incomplete or point_ids.max(initial=0) >= max(points, 1):
            problem = f"the labels are of another episode, not of {frames} frames of {points} points"
            raise FormatError(f"{self.path_of(number)}: {problem}; remove the file and label again")


def cloud_of(episode: Episode, settings: LabelSettings) -> NDArray[np.float32]:
    """Return the cloud (T, n, 3) of an episode that is tracked with these settings, metres."""
    if settings.observation == "full":
        return episode.points
    return episode.observed[:, : settings.n_points]


def arrays_of(states: list[TopologicalState], slots: int = SLOTS) -> dict[str, NDArray[Any]]:
    """Return the arrays of labels for tracked states.

    A frame keeps its `slots` longest-lived loops; the others are dropped and counted.
    """
    frames = len(states)
    arrays: dict[str, NDArray[Any]] = {
        "id": np.full((frames, slots), -1, dtype=np.int32),
        "simplices": np.zeros((frames, slots, 22), dtype=np.uint16),
        "values": np.zeros((frames, slots, 7), dtype=np.float32),
        "parameters": np.zeros((frames, 4), dtype=np.float32),
    }
    # Fill one frame after the other: first the parameters, then a slot for each loop.
    for frame, state in enumerate(states):
        estimated = [state.parameters[name] for name in _PARAMETERS[:3]]
        n_dropped = max(0, len(state) - slots)
        arrays["parameters"][frame] = [*estimated, n_dropped]
        for slot, loop in enumerate(state.loops[:slots]):
            neighbours = np.full((4, 3), ABSENT)
            neighbours[: len(loop.neighbour_ids)] = loop.neighbour_ids
            simplices = (loop.birth_edge, loop.killer_edge, loop.killer_triangle_ids, neighbours)
            values = [loop.birth, loop.death, loop.killer_shift, *loop.neighbour_values]
            arrays["id"][frame, slot] = loop.id
            arrays["simplices"][frame, slot] = np.concatenate([np.ravel(ids) for ids in simplices])
            arrays["values"][frame, slot, : len(values)] = values
    return arrays


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
        return diagram.cycle(edges_of_loops.index(edges))


def states_of(arrays: Mapping[str, NDArray[Any]], cloud: NDArray[np.float32], dt: float) -> list[TopologicalState]:
    """Return the tracked states of the arrays of labels, given the cloud (T, n, 3) that was tracked."""
    states = []
    for number, points in enumerate(cloud.astype(np.float64)):
        frame = _Frame(points)
        slots = np.flatnonzero(arrays["id"][number] >= 0).tolist()
        loops = tuple(_loop(arrays, (number, slot), frame) for slot in slots)
        parameters = dict(zip(_PARAMETERS, arrays["parameters"][number].tolist(), strict=True))
        states.append(TopologicalState(number, number * dt, loops, parameters))
    return states


def _loop(arrays: Mapping[str, NDArray[Any]], frame_and_slot: tuple[int, int], frame: _Frame) -> Loop:
    """Return the loop in a slot of a frame."""
    simplices = arrays["simplices"][frame_and_slot].astype(np.int64)
    ids = {name: simplices[columns] for name, columns in SIMPLICES.items()}
    neighbours = ids["neighbours"].reshape(4, 3)
    neighbours = neighbours[neighbours[:, 0] != ABSENT]
    birth, death, killer_shift, *neighbour_values = arrays["values"][frame_and_slot].tolist()
    return Loop.from_cloud(
        frame.points,
        partial(frame.cycle, simplices[:4].tolist()),
        id=int(arrays["id"][frame_and_slot]),
        birth=birth,
        death=death,
        killer_shift=killer_shift,
        birth_edge=ids["birth_edge"],
        killer_edge=ids["killer_edge"],
        killer_triangle_ids=ids["killer_triangles"].reshape(2, 3),
        neighbour_ids=neighbours,
        neighbour_values=np.array(neighbour_values[: len(neighbours)]),
    )
