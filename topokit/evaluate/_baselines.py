"""Trackers to compare seqPH with: the same loops, found and dropped in the same way, matched by something else.

Source: Cohen-Steiner, Edelsbrunner, Harer 2007 (diagram matchings); Cohen-Steiner, Edelsbrunner, Morozov 2006 (vines).
Taught in chapter 6.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._validate import as_sequence
from topokit.rips import Diagram
from topokit.seqph import SeqPH, assign
from topokit.state import TopologicalState

from ._scores import greatest

__all__ = ["DiagramMatching", "NearestMidpoint", "track_vines"]

Array = NDArray[np.float64]


class DiagramMatching(SeqPH):
    """Match by birth and death alone, as a distance between persistence diagrams does; places count for nothing.

    A pair costs the larger of the changes of birth and death, a loop left alone half its lifetime, which is as far as it is
    from the diagonal; the cheapest of all matchings is taken (the 1-Wasserstein distance under the maximum norm).
    """

    def _match(
        self, diagram: Diagram, found: list[int], places: list[Array], known: list[Any], _: Any
    ) -> dict[int, int]:
        if not found or not known:
            return {}
        births = np.abs(diagram.birth[found][:, None] - [k.loop.birth for k in known])
        deaths = np.abs(diagram.death[found][:, None] - [k.loop.death for k in known])
        alone = (diagram.lifetime[found][:, None] + [k.loop.lifetime for k in known]) / 2
        return dict(greatest(np.maximum(alone - np.maximum(births, deaths), 0)))


class NearestMidpoint(SeqPH):
    """Match by the midpoints of the killer edges alone, as one tracks points; births and deaths count for nothing.

    A midpoint may go as far as seqPH's killer edge.
    """

    def _match(
        self, diagram: Diagram, found: list[int], places: list[Array], known: list[Any], sizes: tuple[float, float]
    ) -> dict[int, int]:
        if not found or not known:
            return {}
        alpha, beta = sizes
        here = np.array([place.mean(axis=0) for place in places])
        there = np.array([k.place.mean(axis=0) for k in known])
        distance = np.linalg.norm(here[:, None] - there, axis=2)
        return dict(assign(distance, distance < 2 * alpha + beta + np.array([k.motion for k in known])))


def track_vines(sequence: ArrayLike | Sequence[ArrayLike], *, steps: int = 8, **options: Any) -> list[TopologicalState]:
    """Follow the points of the diagram while every vertex moves straight from one frame to the next.

    Idea: along that motion births and deaths are continuous, each a curve (a *vine*). Diagrams of `steps` clouds a frame,
    matched by birth and death one after the other, follow the vines as long as they stay apart. It needs what a camera
    does not give: the same vertices in the same order in every frame.

    Raises
    ------
    ValueError
        When the frames differ in their number of points, or `steps` is not positive.
    """
    clouds = as_sequence(sequence)
    if len({len(cloud) for cloud in clouds}) > 1:
        raise ValueError("vines need the same vertices in every frame; the clouds differ in size")
    if steps < 1:
        raise ValueError(f"steps must be 1 or more, not {steps}")
    tracker, states = DiagramMatching(**options), []
    for number, cloud in enumerate(clouds):
        before = clouds[max(number - 1, 0)]
        for step in range(1, steps + 1) if number else [steps]:
            state = tracker.update(before + (cloud - before) * (step / steps))
        states.append(TopologicalState(number, float(number), state.loops, state.parameters))
    return states
