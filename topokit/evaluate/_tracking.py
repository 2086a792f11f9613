"""Measures of tracked loops: where they are, and how well their identities are kept, against the true loops of an episode.

Idea: at every frame the true loops that are present are the objects, and the tracked loops are the detections. Nearness of
their centres decides which can be matched to which. Topology decides what is present, on the full cloud: a certain edge ends
the class of a true loop (`Diagram.killers_of`), and the loop counts when it has lived for alpha or longer by then. A strap that
lies flat does not count, nor does the hem of a shirt: it is the sum of the neck and the sleeves, and has no bar of its own.

Source: the hull measure is that of Antonova et al. 2021, section 6. Taught in chapters 0 and 8.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._validate import Array, Ids, as_points
from topokit.linking import curve_centroid, side_lengths
from topokit.rips import rips_persistence
from topokit.sampling import spacing
from topokit.seqph import TopologicalState

from ._scores import THRESHOLD, Overlap, greatest


def distance_to_hull(point: ArrayLike, points: ArrayLike) -> float:
    """Return how far `point` is from the convex hull of `points`, in their unit; zero inside, to rounding.

    Flat hulls are no special case: this is the nearest point among all convex combinations, a least-squares problem with
    bounds, not a search among facets. The active-set solver is exact; `nnls` of SciPy 1.15 is not.

    Parameters
    ----------
    point, points : (d,) and (n, d) array_like
    """
    from scipy.optimize import lsq_linear

    offsets = as_points(points) - np.asarray(point, np.float64)
    scale = float(np.abs(offsets).max())
    if scale == 0.0:
        return 0.0
    # Minimise |offsets^T w| over w >= 0 with sum(w) = 1, the sum kept by a heavily weighted row.
    system = np.vstack([offsets.T / scale, np.full((1, len(offsets)), 1e4)])
    weights = lsq_linear(system, np.append(np.zeros(offsets.shape[1]), 1e4), (0, np.inf), method="bvls").x
    return float(np.linalg.norm(offsets.T @ (weights / weights.sum())))


@dataclass(frozen=True)
class TrackSummary:
    """One identity over a whole sequence, against the true loop that it is nearest to."""

    id: int  #: the identity
    first: int  #: frame of its first appearance
    last: int  #: frame of its last appearance
    frames: int  #: in how many frames it appears
    lifetime: float  #: mean lifetime, metres
    #: which of the episode's loops it is nearest to, on the mean over its frames; -1 when there is none
    true_loop: int = -1
    #: mean distance of the mean of its killer triangles from the mean of that loop's vertices, metres
    distance: float = float("nan")
    in_hull: float = float("nan")  #: share of its frames in which that mean is in the loop's convex hull


def summarise_tracks(
    states: Sequence[TopologicalState], points: NDArray[np.floating], loops: Sequence[NDArray[np.integer]]
) -> list[TrackSummary]:
    """Summarise every identity, the one seen in most frames first.

    Parameters
    ----------
    states : sequence of TopologicalState
    points : (T, N, 3) array
        Positions of the garment's vertices, a row a frame of `states`.
    loops : sequence of (L,) int arrays
        True loops as vertex ids into `points`; there may be none.
    """
    rows_of: dict[int, list[int]] = {}
    for row, state in enumerate(states):
        for loop in state.loops:
            rows_of.setdefault(loop.id, []).append(row)
    summaries = []
    for identity, rows in rows_of.items():
        tracked = [states[row][identity] for row in rows]
        lifetime = float(np.mean([loop.lifetime for loop in tracked]))
        summary = TrackSummary(identity, states[rows[0]].frame, states[rows[-1]].frame, len(rows), lifetime)
        if len(loops):
            # Compare the centres with the true loop that is nearest on the mean over the frames.
            centres = np.array([loop.centre for loop in tracked])
            curves = [points[rows][:, loop] for loop in loops]
            distances = [np.linalg.norm(curve.mean(axis=1) - centres, axis=1).mean() for curve in curves]
            nearest = int(np.argmin(distances))
            pairs = zip(centres, curves[nearest], strict=True)
            in_hull = float(np.mean([distance_to_hull(centre, hull) <= 1e-9 for centre, hull in pairs]))
            summary = replace(summary, true_loop=nearest, distance=float(distances[nearest]), in_hull=in_hull)
        summaries.append(summary)
    return sorted(summaries, key=lambda summary: (-summary.frames, -summary.lifetime))


@dataclass(frozen=True, eq=False)
class TrueLoops:
    """The true loops of one frame."""

    centres: Array  #: (L, 3) centroids of the closed curves, by length
    radii: Array  #: (L,) largest distance of a curve from its centre
    killers: Ids  #: (L, 2) the edge of the full cloud that ends each curve, by the elder rule among them
    present: NDArray[np.bool_]  #: (L,) whether that was at least alpha after the curve's own latest edge
    tight: tuple[Ids, ...] = ()  #: of each the vertices of another curve of its class, a tight one


def true_loops(points: NDArray[np.floating], loops: Sequence[NDArray[np.integer]]) -> list[TrueLoops]:
    """Return, frame by frame, where the true loops are and which of them are there.

    A loop counts when its class lives for alpha or longer. Here alpha is `topokit.sampling.spacing` of the frame's vertices, as
    in `SeqPH(loops="alpha")`; the default tracker estimates a smaller one.

    Parameters
    ----------
    points : (T, N, 3) array
        All vertices, without noise, metres.
    loops : sequence of (L,) int arrays
        Closed cycles of vertex ids.
    """
    return [_true_loops(as_points(cloud, f"frame {frame}"), loops) for frame, cloud in enumerate(points)]


def _true_loops(vertices: Array, loops: Sequence[NDArray[np.integer]]) -> TrueLoops:
    curves = [vertices[np.asarray(loop)] for loop in loops]
    centres = [curve_centroid(curve) for curve in curves]
    radii = [np.linalg.norm(curve - centre, axis=1).max() for curve, centre in zip(curves, centres, strict=True)]
    diagram = rips_persistence(vertices)
    killers = diagram.killers_of(loops)

    # Another curve of the class, a tight one, from the bar that the same edge ends; the curve itself where there is no bar.
    bars = {tuple(edge): i for i, edge in enumerate(diagram.killer_edge.tolist())}
    tight = []
    for edge, loop in zip(killers.tolist(), loops, strict=True):
        bar = bars.get(tuple(edge))
        tight.append(np.asarray(loop) if bar is None else diagram.cycle(bar))

    # The class lives from the curve's own longest edge to its killer edge.
    births = np.array([side_lengths(curve).max() / 2 for curve in curves])
    deaths = np.linalg.norm(vertices[killers[:, 0]] - vertices[killers[:, 1]], axis=1) / 2
    return TrueLoops(
        centres=np.reshape(centres, (-1, vertices.shape[1])),
        radii=np.array(radii),
        killers=killers,
        present=deaths - births >= spacing(vertices),
        tight=tuple(tight),
    )


def by_place(truth: TrueLoops, state: TopologicalState) -> Array:
    """Return (L, k) similarities 1 - distance / (2 radius), not below 0; half is one radius away, anywhere in the opening."""
    centres = np.array([loop.centre for loop in state.loops]).reshape(-1, truth.centres.shape[1])
    distances = np.linalg.norm(truth.centres[:, None] - centres[None], axis=2)
    return np.asarray(np.maximum(1 - distances / (2 * truth.radii[:, None]), 0))


def compare(
    states: Sequence[TopologicalState],
    truth: Sequence[TrueLoops],
    similarity: Callable[[TrueLoops, TopologicalState], Array] = by_place,
) -> list[Overlap]:
    """Bring states and truth together, one overlap a frame, for `score` and `events`.

    A detection that fits a true loop which is not present is set aside: it is neither a match nor a false positive.

    Parameters
    ----------
    states, truth : sequences of TopologicalState and TrueLoops
        One of each for every frame.
    similarity : callable
        Takes the `TrueLoops` and the `TopologicalState` of a frame, and returns similarities (true loops, tracked loops) from 0
        to 1. The default is 1 - distance of the centres / (2 radius of the true loop), not below 0.
    """
    overlaps = []
    for true, state in zip(truth, states, strict=True):
        table = similarity(true, state)
        # Take out detections that fit a true loop which is not present, in the matching of greatest similarity.
        pairs = greatest(np.where(table >= THRESHOLD, table, 0))
        absent = [column for row, column in pairs if not true.present[row]]
        columns = np.setdiff1d(np.arange(len(state.loops)), absent)
        objects = np.flatnonzero(true.present)
        ids = np.array([loop.id for loop in state.loops], dtype=np.int64)
        overlaps.append(Overlap(objects, ids[columns], table[np.ix_(objects, columns)]))
    return overlaps
