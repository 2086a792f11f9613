"""How well identities are kept: tracked loops against the true ones.

Idea: at every frame the true loops that are there are the objects, the tracked loops the detections, and nearness of their
centres says which could be which. What is there is decided by topology, on the full cloud: a certain edge ends the class of
a true loop (`Diagram.killers_of`), and the loop counts when it has lived for alpha or longer by then. A strap that lies flat
does not count, nor does the hem of a shirt: it is the sum of the neck and the sleeves, and has no bar of its own.

Taught in chapter 6.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from topokit._curves import curve_centroid, side_lengths
from topokit._matching import assign
from topokit._validate import as_points
from topokit.rips import rips_persistence
from topokit.sampling import spacing
from topokit.state import TopologicalState

from ._scores import THRESHOLD, Overlap

Array = NDArray[np.float64]
Ids = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class TrueLoops:
    """The true loops of one frame.

    Attributes
    ----------
    centres : (L, 3) float64
        Centroids of the closed curves, by length.
    radii : (L,) float64
        Largest distance of a curve from its centre.
    killers : (L, 2) int64
        The edge of the full cloud that ends each curve, by the elder rule among them.
    present : (L,) bool
        Whether that was at least alpha after the curve's own latest edge.
    """

    centres: Array
    radii: Array
    killers: Ids
    present: NDArray[np.bool_]


def true_loops(
    points: NDArray[np.floating], loops: Sequence[NDArray[np.integer]], *, alpha: float | None = None
) -> list[TrueLoops]:
    """Find out, frame by frame, where the true loops are and which of them are there.

    Parameters
    ----------
    points : (T, N, 3) array
        All vertices, without noise, metres.
    loops : sequence of (L,) int arrays
        Closed cycles of vertex ids.
    alpha : float, optional
        How long the class of a loop must live to count; for each frame what `SeqPH` estimates when not given.
    """
    return [_true_loops(as_points(cloud, f"frame {frame}"), loops, alpha) for frame, cloud in enumerate(points)]


def _true_loops(vertices: Array, loops: Sequence[NDArray[np.integer]], alpha: float | None) -> TrueLoops:
    curves = [vertices[np.asarray(loop)] for loop in loops]
    centres, radii = zip(*map(extent, curves), strict=True) if curves else ((), ())
    killers = rips_persistence(vertices).killers_of(loops)
    lives = np.linalg.norm(vertices[killers[:, 0]] - vertices[killers[:, 1]], axis=1) / 2
    lives -= [side_lengths(curve).max() / 2 for curve in curves]
    present = lives >= (spacing(vertices) if alpha is None else alpha)
    return TrueLoops(np.reshape(centres, (-1, vertices.shape[1])), np.array(radii), killers, present)


def extent(curve: Array) -> tuple[Array, float]:
    """(d,) the centroid of a closed curve (n, d), by length, and the distance of the vertex farthest from it."""
    centre = curve_centroid(curve)
    return centre, float(np.linalg.norm(curve - centre, axis=1).max())


def by_place(truth: TrueLoops, state: TopologicalState) -> Array:
    """(L, k) similarity 1 - distance / (2 radius), not below 0, of the tracked centre from the true one.

    The threshold of a half, one radius away, lets the killers stand anywhere in the opening: along a slot they do.

    Parameters
    ----------
    truth : TrueLoops
    state : TopologicalState
        Of the same frame.
    """
    centres = np.array([loop.centre for loop in state.loops]).reshape(-1, truth.centres.shape[1])
    away = np.linalg.norm(truth.centres[:, None] - centres[None], axis=2)
    return np.asarray(np.maximum(1 - away / (2 * truth.radii[:, None]), 0))


def by_killer(truth: TrueLoops, state: TopologicalState) -> Array:
    """(L, k) similarity 1 where the true loop dies with the very killer edge of the tracked one, else 0.

    Exact and without a threshold, but only for states of the full cloud, whose vertices are those of the truth.

    Parameters
    ----------
    truth : TrueLoops
    state : TopologicalState
        Of the same frame.
    """
    killers = np.array([loop.killer_edge for loop in state.loops]).reshape(-1, 2)
    return np.asarray((truth.killers[:, None] == killers[None]).all(axis=2), dtype=np.float64)


def compare(
    states: Sequence[TopologicalState],
    truth: Sequence[TrueLoops],
    similarity: Callable[[TrueLoops, TopologicalState], Array] = by_place,
) -> list[Overlap]:
    """Bring states and truth together, frame by frame.

    A detection that fits a true loop which is not there is set aside: it is neither a find nor a false positive.

    Parameters
    ----------
    states : sequence of TopologicalState
    truth : sequence of TrueLoops
        Of the same frames.
    similarity : callable
        `by_place` or `by_killer`.

    Returns
    -------
    list of Overlap
        One a frame, for `score` and `events`.

    Raises
    ------
    ValueError
        When `states` and `truth` differ in their number of frames.
    """
    if len(states) != len(truth):
        raise ValueError(f"states has {len(states)} frames, truth {len(truth)}; track the same sequence")
    overlaps = []
    for state, true in zip(states, truth, strict=True):
        table = similarity(true, state)
        pairs = assign(1 - table, table >= THRESHOLD)
        aside = [k for i, k in pairs if not true.present[i]]
        kept = np.setdiff1d(np.arange(len(state.loops)), aside)
        ids = np.array([loop.id for loop in state.loops], dtype=np.int64)
        objects = np.flatnonzero(true.present)
        overlaps.append(Overlap(objects, ids[kept], table[np.ix_(objects, kept)]))
    return overlaps
