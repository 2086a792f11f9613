"""The labels of a dataset: what the tracker saw in every frame of every episode, as arrays of one shape.

Labels keep the loops of the longest lifetime in a frame, by vertex ids of the cloud that was tracked. With T frames, S slots:

    id          (T, S)        the identity of a loop; -1: no loop
    simplices   (T, S, 22)    ids into the cloud: birth edge, killer edge, killer triangles, neighbours (65535: none)
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
SLOTS = 8  # of a frame
SIMPLICES = {
    "birth_edge": slice(0, 2),
    "killer_edge": slice(2, 4),
    "killer_triangles": slice(4, 10),
    "neighbours": slice(10, 22),
}
ABSENT = 65535
_PARAMETERS = ("alpha", "beta", "epsilon", "dropped")
_LAYOUT = {"id": "i T S", "simplices": "u T S 22", "values": "f T S 7", "parameters": "f T 4"}


@checked
class LabelSettings:
    """What a set of labels is."""

    schema: Literal[2]
    observation: Literal["full", "observed", "camera"]  #: what the tracker saw
    n_points: int | None  #: of an observation: so many of its first points, or all
    options: Mapping[str, Any]  #: of the tracker, `topokit.SeqPH`
    versions: Mapping[str, str]


class Labels(NumberedFiles):
    """One set of labels of a dataset, in a folder beside its episodes: `Dataset.labels`."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, KIND, ABOUT)
        self.settings: LabelSettings = read_settings(LabelSettings, folder / ABOUT)  #: what they are

    @property
    def options(self) -> dict[str, Any]:
        """The options of the tracker."""
        return dict(self.settings.options)

    def cloud(self, episode: Episode) -> NDArray[np.float32]:
        """Return what was tracked of an episode, (T, n, 3) metres: all vertices, or the first points of what was observed."""
        return cloud_of(episode, self.settings)

    def arrays(self, number: int) -> dict[str, NDArray[Any]]:
        """Return the arrays of an episode."""
        path = self.path_of(number)
        _, arrays = load_archive(path, KIND)
        try:
            check_layout(arrays, _LAYOUT)
        except (KeyError, ValueError) as error:
            raise FormatError(f"{path}: labels with a missing or an unknown part: {error}; label again") from error
        return arrays

    def check_fit(self, number: int, arrays: Mapping[str, NDArray[Any]], frames: int, points: int) -> None:
        """Raise FormatError unless arrays are of so many frames, of clouds of so many points."""
        simplices = arrays["simplices"][arrays["id"] >= 0]
        known = simplices[simplices != ABSENT]
        if len(arrays["id"]) != frames or (simplices[:, :10] == ABSENT).any() or known.max(initial=0) >= max(points, 1):
            raise FormatError(f"{self.path_of(number)}: labels of another episode; remove the file, and label again")


def cloud_of(episode: Episode, settings: LabelSettings) -> NDArray[np.float32]:
    """Return the cloud of an episode that labels of these settings are of, (T, n, 3) metres."""
    if settings.observation == "full":
        return episode.points
    return episode.observed[:, : settings.n_points]


def arrays_of(states: list[TopologicalState], slots: int = SLOTS) -> dict[str, NDArray[Any]]:
    """Return states as the arrays of labels; loops beyond `slots` in a frame, the shortest-lived ones, are dropped."""
    frames = len(states)
    arrays: dict[str, NDArray[Any]] = {
        "id": np.full((frames, slots), -1, dtype=np.int32),
        "simplices": np.zeros((frames, slots, 22), dtype=np.uint16),
        "values": np.zeros((frames, slots, 7), dtype=np.float32),
        "parameters": np.zeros((frames, 4), dtype=np.float32),
    }
    for frame, state in enumerate(states):
        estimated = [state.parameters[name] for name in _PARAMETERS[:3]]
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


@dataclass(frozen=True)
class _Frame:
    """A tracked cloud, whose persistence is computed once: when the first of its loops is asked for its cycle."""

    points: NDArray[np.float64]

    @cached_property
    def diagram(self) -> Diagram:
        return rips_persistence(self.points)

    def cycle(self, edges: list[int]) -> NDArray[np.int64]:
        """Return the cycle of the loop with these birth and killer edges."""
        pairs = np.column_stack([self.diagram.birth_edge, self.diagram.killer_edge])
        return self.diagram.cycle(pairs.tolist().index(edges))


def states_of(arrays: Mapping[str, NDArray[Any]], cloud: NDArray[np.float32], dt: float) -> list[TopologicalState]:
    """Return the tracked states that labels hold, in the coordinates of the cloud that was tracked."""
    states = []
    for number, points in enumerate(cloud.astype(np.float64)):
        frame = _Frame(points)
        slots = np.flatnonzero(arrays["id"][number] >= 0).tolist()
        loops = tuple(_loop(arrays, (number, slot), frame) for slot in slots)
        parameters = dict(zip(_PARAMETERS, arrays["parameters"][number].tolist(), strict=True))
        states.append(TopologicalState(number, number * dt, loops, parameters))
    return states


def _loop(arrays: Mapping[str, NDArray[Any]], place: tuple[int, int], frame: _Frame) -> Loop:
    simplices = arrays["simplices"][place].astype(np.int64)
    ids = {name: simplices[part] for name, part in SIMPLICES.items()}
    neighbours = ids["neighbours"].reshape(4, 3)
    neighbours = neighbours[neighbours[:, 0] != ABSENT]
    birth, death, killer_shift, *neighbour_values = arrays["values"][place].tolist()
    return Loop.from_cloud(
        frame.points,
        partial(frame.cycle, simplices[:4].tolist()),
        id=int(arrays["id"][place]),
        birth=birth,
        death=death,
        killer_shift=killer_shift,
        birth_edge=ids["birth_edge"],
        killer_edge=ids["killer_edge"],
        killer_triangle_ids=ids["killer_triangles"].reshape(2, 3),
        neighbour_ids=neighbours,
        neighbour_values=np.array(neighbour_values[: len(neighbours)]),
    )
