"""Trackers and similarities to compare seqPH with. Taught in chapter 8."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit.seqph import SeqPH, TopologicalState, assign
from topokit.seqph._matching import Candidates


def by_diagram(loops: Candidates) -> list[tuple[int, int]]:
    """Match by birth and death alone, as a distance between persistence diagrams does: ``SeqPH(match=by_diagram)``.

    A pair costs the larger of the changes of birth and death. A loop left alone costs half its lifetime, its distance from the
    diagonal. The cheapest of all matchings is taken: the 1-Wasserstein distance under the maximum norm (Cohen-Steiner,
    Edelsbrunner, Harer 2007).
    """
    lifetime = loops.death - loops.birth
    known_lifetime = loops.known_death - loops.known_birth
    cost_alone = (lifetime[:, None] + known_lifetime) / 2
    cost_matched = np.maximum(*loops.changes())

    # The gain of a pair is what it costs less than leaving both loops alone.
    gain = np.maximum(cost_alone - cost_matched, 0)
    return [pair for pair in assign(-gain) if gain[pair] > 0]


def by_midpoint(loops: Candidates) -> list[tuple[int, int]]:
    """Match by the midpoints of the killer edges alone, which may go as far as seqPH's killer edges."""
    distance = np.linalg.norm(loops.places.mean(axis=1)[:, None] - loops.known_places.mean(axis=1), axis=2)
    return assign(distance, distance < 2 * loops.alpha + loops.beta + loops.motion)


def by_killer(truth: Any, state: TopologicalState) -> NDArray[np.float64]:
    """Return (L, k) similarities for `compare`: 1 where the true loop dies with the very killer edge of the tracked one, else 0.

    Exact and without a threshold, but only for states of the full cloud, whose vertices are those of the truth.
    """
    killers = np.array([loop.killer_edge for loop in state.loops]).reshape(-1, 2)
    return np.asarray((truth.killers[:, None] == killers[None]).all(axis=2), dtype=np.float64)


def track_vines(sequence: ArrayLike | Sequence[ArrayLike], *, steps: int = 8, **options: Any) -> list[TopologicalState]:
    """Follow the points of the diagram while every vertex moves straight from one frame to the next.

    Idea: along that motion births and deaths are continuous, each a curve (a *vine*). Diagrams of `steps` clouds a frame,
    matched by birth and death one after the other, follow the vines as long as they stay apart (Cohen-Steiner, Edelsbrunner,
    Morozov 2006). It needs what a camera does not give: the same vertices in the same order in every frame.

    Parameters
    ----------
    sequence : (T, n, d) array_like
    steps : int
        Diagrams from one frame to the next.
    **options
        Those of `topokit.SeqPH`.
    """
    clouds = [np.asarray(cloud, dtype=np.float64) for cloud in sequence]
    if len({len(cloud) for cloud in clouds}) > 1:
        raise ValueError("vines need the same vertices in every frame; the clouds differ in size")
    tracker = SeqPH(match=by_diagram, **options)
    state = tracker.update(clouds[0])
    states = [TopologicalState(0, 0.0, state.loops, state.parameters)]
    for number in range(1, len(clouds)):
        motion = clouds[number] - clouds[number - 1]
        for step in range(1, steps + 1):
            state = tracker.update(clouds[number - 1] + motion * (step / steps))
        states.append(TopologicalState(number, float(number), state.loops, state.parameters))
    return states
