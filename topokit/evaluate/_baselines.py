"""Trackers to compare seqPH with: the same loops, found and dropped in the same way, matched by something else.

    SeqPH(match=by_diagram)

Source: Cohen-Steiner, Edelsbrunner, Harer 2007 (diagram matchings); Cohen-Steiner, Edelsbrunner, Morozov 2006 (vines).
Taught in chapter 6.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from topokit._matching import assign
from topokit._validate import as_sequence
from topokit.seqph import Candidates, SeqPH
from topokit.state import TopologicalState

from ._scores import greatest


def by_diagram(loops: Candidates) -> list[tuple[int, int]]:
    """Match by birth and death alone, as a distance between persistence diagrams does; places count for nothing.

    A pair costs the larger of the changes of birth and death, a loop left alone half its lifetime, which is as far as it is
    from the diagonal; the cheapest of all matchings is taken (the 1-Wasserstein distance under the maximum norm).
    """
    alone = ((loops.death - loops.birth)[:, None] + (loops.known_death - loops.known_birth)) / 2
    return greatest(np.maximum(alone - np.maximum(*loops.changes()), 0))


def by_midpoint(loops: Candidates) -> list[tuple[int, int]]:
    """Match by the midpoints of the killer edges alone, as one tracks points; births and deaths count for nothing.

    A midpoint may go as far as seqPH's killer edge.
    """
    distance = np.linalg.norm(loops.places.mean(axis=1)[:, None] - loops.known_places.mean(axis=1), axis=2)
    return assign(distance, distance < 2 * loops.alpha + loops.beta + loops.motion)


def track_vines(sequence: ArrayLike | Sequence[ArrayLike], *, steps: int = 8, **options: Any) -> list[TopologicalState]:
    """Follow the points of the diagram while every vertex moves straight from one frame to the next.

    Idea: along that motion births and deaths are continuous, each a curve (a *vine*). Diagrams of `steps` clouds a frame,
    matched by birth and death one after the other, follow the vines as long as they stay apart. It needs what a camera
    does not give: the same vertices in the same order in every frame.

    Parameters
    ----------
    sequence : (T, n, d) array_like
    steps : int
        Diagrams from one frame to the next.
    **options
        Those of `topokit.SeqPH`.

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
    tracker, states = SeqPH(match=by_diagram, **options), []
    for number, cloud in enumerate(clouds):
        before = clouds[max(number - 1, 0)]
        for step in range(1, steps + 1) if number else [steps]:
            state = tracker.update(before + (cloud - before) * (step / steps))
        states.append(TopologicalState(number, float(number), state.loops, state.parameters))
    return states
