"""How good tracked loops are: where they are, and how well their identities are kept, against the true loops of an episode.

Idea: at every frame the true loops that are there are the objects, the tracked loops the detections, and nearness of their
centres says which could be which. What is there is decided by topology, on the full cloud: a certain edge ends the class of
a true loop (`Diagram.killers_of`), and the loop counts when it has lived for alpha or longer by then. A strap that lies flat
does not count, nor does the hem of a shirt: it is the sum of the neck and the sleeves, and has no bar of its own.

Source: the hull measure is that of Antonova et al. 2021, section 6. Taught in chapters 0 and 7.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._validate import Array, Ids, as_points, as_sequence
from topokit.linking import curve_centroid, side_lengths
from topokit.rips import rips_persistence
from topokit.sampling import spacing
from topokit.seqph import Candidates, SeqPH, TopologicalState, assign

from ._scores import THRESHOLD, Overlap, greatest


def distance_to_hull(point: ArrayLike, points: ArrayLike) -> float:
    """Return how far `point` is from the convex hull of `points`; zero inside, to rounding.

    Flat hulls are no special case: this is the nearest point among all convex combinations, a non-negative least-squares
    problem, not a search among facets.

    Parameters
    ----------
    point, points : (d,) and (n, d) array_like
    """
    from scipy.optimize import nnls

    offsets = as_points(points) - np.asarray(point, dtype=np.float64)
    scale = float(np.abs(offsets).max(initial=0.0))
    if scale == 0.0:
        return 0.0
    # Minimise |offsets^T w| over w >= 0 with sum(w) = 1, the sum kept by a heavily weighted row.
    system = np.vstack([offsets.T / scale, np.full((1, len(offsets)), 1e4)])
    weights, _ = nnls(system, np.append(np.zeros(offsets.shape[1]), 1e4))
    return float(np.linalg.norm(offsets.T @ (weights / weights.sum())))


@dataclass(frozen=True)
class TrackSummary:
    """One identity over a whole sequence, against the true loop it is nearest to."""

    id: int  #: the identity
    first: int  #: frame of its first appearance
    last: int  #: frame of its last appearance
    frames: int  #: in how many frames it appears
    lifetime: float  #: mean lifetime, metres
    true_loop: int  #: which of the episode's loops it is nearest to, on the mean over its frames; -1 when there is none
    distance: float  #: mean distance of the mean of its killer triangles from the mean of that loop's vertices, metres
    in_hull: float  #: share of its frames in which that mean is in the loop's convex hull


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

    Raises
    ------
    ValueError
        When `points` and `states` differ in their number of frames.
    """
    if len(points) != len(states):
        raise ValueError(f"points has {len(points)} frames, states {len(states)}")
    tracks: dict[int, list[int]] = {}
    for row, state in enumerate(states):
        for loop in state.loops:
            tracks.setdefault(loop.id, []).append(row)
    summaries = []
    for identity, rows in tracks.items():
        found = [states[row][identity] for row in rows]
        where = _nearest_loop(np.array([loop.centre for loop in found]), points[rows], loops)
        lifetime = float(np.mean([loop.lifetime for loop in found]))
        first, last = states[rows[0]].frame, states[rows[-1]].frame
        summaries.append(TrackSummary(identity, first, last, len(rows), lifetime, *where))
    return sorted(summaries, key=lambda track: (-track.frames, -track.lifetime))


def _nearest_loop(
    centres: Array, points: NDArray[np.floating], loops: Sequence[NDArray[np.integer]]
) -> tuple[int, float, float]:
    if not loops:
        return -1, float("nan"), float("nan")
    away = [np.linalg.norm(points[:, loop].mean(axis=1) - centres, axis=1).mean() for loop in loops]
    nearest = int(np.argmin(away))
    hulls = points[:, loops[nearest]]
    outside = [distance_to_hull(centre, hull) for centre, hull in zip(centres, hulls, strict=True)]
    return nearest, float(away[nearest]), float(np.mean(np.array(outside) <= 1e-9))


@dataclass(frozen=True, eq=False)
class TrueLoops:
    """The true loops of one frame."""

    centres: Array  #: (L, 3) centroids of the closed curves, by length
    radii: Array  #: (L,) largest distance of a curve from its centre
    killers: Ids  #: (L, 2) the edge of the full cloud that ends each curve, by the elder rule among them
    present: NDArray[np.bool_]  #: (L,) whether that was at least alpha after the curve's own latest edge
    tight: tuple[Ids, ...] = ()  #: of each the vertices of another curve of its class, a tight one


def true_loops(
    points: NDArray[np.floating], loops: Sequence[NDArray[np.integer]], *, alpha: float | None = None
) -> list[TrueLoops]:
    """Return, frame by frame, where the true loops are and which of them are there.

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
    diagram = rips_persistence(vertices)
    killers, bars = diagram.killers_of(loops), {tuple(edge): i for i, edge in enumerate(diagram.killer_edge.tolist())}
    ends = [bars.get(tuple(edge)) for edge in killers.tolist()]
    tight = tuple(np.asarray(loop) if i is None else diagram.cycle(i) for i, loop in zip(ends, loops, strict=True))
    lives = np.linalg.norm(vertices[killers[:, 0]] - vertices[killers[:, 1]], axis=1) / 2
    lives -= [side_lengths(curve).max() / 2 for curve in curves]
    present = lives >= (spacing(vertices) if alpha is None else alpha)
    return TrueLoops(np.reshape(centres, (-1, vertices.shape[1])), np.array(radii), killers, present, tight)


def extent(curve: Array) -> tuple[Array, float]:
    """(d,) the centroid of a closed curve (n, d), by length, and the distance of the vertex farthest from it."""
    centre = curve_centroid(curve)
    return centre, float(np.linalg.norm(curve - centre, axis=1).max())


def by_place(truth: TrueLoops, state: TopologicalState) -> Array:
    """(L, k) similarity 1 - distance / (2 radius), not below 0, of the tracked centre from the true one.

    The threshold of a half, one radius away, lets the killers stand anywhere in the opening: along a slot they do.

    Parameters
    ----------
    truth, state : TrueLoops and TopologicalState
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
    truth, state : TrueLoops and TopologicalState
        Of the same frame.
    """
    killers = np.array([loop.killer_edge for loop in state.loops]).reshape(-1, 2)
    return np.asarray((truth.killers[:, None] == killers[None]).all(axis=2), dtype=np.float64)


def compare(
    states: Sequence[TopologicalState],
    truth: Sequence[TrueLoops],
    similarity: Callable[[TrueLoops, TopologicalState], Array] = by_place,
) -> list[Overlap]:
    """Bring states and truth together, one overlap a frame, for `score` and `events`.

    A detection that fits a true loop which is not there is set aside: it is neither a find nor a false positive.

    Parameters
    ----------
    states, truth : sequences of TopologicalState and TrueLoops
        Of the same frames.
    similarity : callable
        `by_place` or `by_killer`.

    Raises
    ------
    ValueError
        When `states` and `truth` differ in their number of frames.
    """
    if len(states) != len(truth):
        raise ValueError(f"states has {len(states)} frames, truth {len(truth)}; track the same sequence")
    overlaps = []
    for true, state in zip(truth, states, strict=True):
        table, objects = similarity(true, state), np.flatnonzero(true.present)
        aside = [k for i, k in assign(1 - table, table >= THRESHOLD) if not true.present[i]]
        kept = np.setdiff1d(np.arange(len(state.loops)), aside)
        ids = np.array([loop.id for loop in state.loops], dtype=np.int64)
        overlaps.append(Overlap(objects, ids[kept], table[np.ix_(objects, kept)]))
    return overlaps


def by_diagram(loops: Candidates) -> list[tuple[int, int]]:
    """Match by birth and death alone, as a distance between persistence diagrams does: ``SeqPH(match=by_diagram)``.

    A pair costs the larger of the changes of birth and death, a loop left alone half its lifetime, which is as far as it is
    from the diagonal; the cheapest of all matchings is taken: the 1-Wasserstein distance under the maximum norm
    (Cohen-Steiner, Edelsbrunner, Harer 2007).
    """
    alone = ((loops.death - loops.birth)[:, None] + (loops.known_death - loops.known_birth)) / 2
    return greatest(np.maximum(alone - np.maximum(*loops.changes()), 0))


def by_midpoint(loops: Candidates) -> list[tuple[int, int]]:
    """Match by the midpoints of the killer edges alone, which may go as far as seqPH's killer edges."""
    distance = np.linalg.norm(loops.places.mean(axis=1)[:, None] - loops.known_places.mean(axis=1), axis=2)
    return assign(distance, distance < 2 * loops.alpha + loops.beta + loops.motion)


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
