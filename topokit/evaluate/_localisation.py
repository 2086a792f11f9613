"""Where tracked loops are, measured against the true ones of a recorded episode.

Source: the hull measure is that of Antonova et al. 2021, section 6. Taught in chapter 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._validate import as_points
from topokit.state import TopologicalState


def distance_to_hull(point: ArrayLike, points: ArrayLike) -> float:
    """Return how far `point` is from the convex hull of `points`; zero inside, to rounding.

    Flat hulls are no special case: this is the nearest point among all convex combinations, a non-negative least-squares
    problem, not a search among facets.

    Parameters
    ----------
    point : (d,) array_like
    points : (n, d) array_like

    Examples
    --------
    >>> triangle = [[0, 0, 0], [2, 0, 0], [0, 2, 0]]
    >>> round(distance_to_hull([0.5, 0.5, 0.0], triangle), 9), round(distance_to_hull([0.5, 0.5, 0.3], triangle), 9)
    (0.0, 0.3)
    """
    return nearest_in_hull(as_points(points) - np.asarray(point, dtype=np.float64))


def nearest_in_hull(offsets: NDArray[np.float64]) -> float:
    """Return how near the convex hull of `offsets` (n, d) comes to the origin: `distance_to_hull` without its checks."""
    from scipy.optimize import nnls

    scale = float(np.abs(offsets).max(initial=0.0))
    if scale == 0.0:
        return 0.0
    # Minimise |offsets^T w| over w >= 0 with sum(w) = 1, the sum kept by a heavily weighted row.
    system = np.vstack([offsets.T / scale, np.full((1, len(offsets)), 1e4)])
    weights, _ = nnls(system, np.append(np.zeros(offsets.shape[1]), 1e4))
    return float(np.linalg.norm(offsets.T @ (weights / weights.sum())))


@dataclass(frozen=True)
class TrackSummary:
    """One identity over a whole sequence, against the true loop it is nearest to.

    Attributes
    ----------
    id : int
    first, last : int
        Frames of its first and last appearance.
    frames : int
        In how many frames it appears.
    lifetime : float
        Mean lifetime, metres.
    true_loop : int
        Which of the episode's loops it is nearest to, on the mean over its frames; -1 when the episode has none.
    distance : float
        Mean distance of the mean of the killer triangles to the centroid of that loop's vertices, metres.
    in_hull : float
        Share of its frames in which that mean lies in the convex hull of the true loop, or within `tolerance` of it.
    """

    id: int
    first: int
    last: int
    frames: int
    lifetime: float
    true_loop: int
    distance: float
    in_hull: float


def summarise_tracks(
    states: Sequence[TopologicalState],
    points: NDArray[np.floating] | None = None,
    loops: Sequence[NDArray[np.integer]] = (),
    *,
    tolerance: float = 0.0,
) -> list[TrackSummary]:
    """Summarise every identity, the one seen in most frames first.

    Parameters
    ----------
    states : sequence of TopologicalState
    points : (T, N, 3) array, optional
        Positions of the garment's vertices, a row a frame of `states`.
    loops : sequence of (L,) int arrays
        True loops as vertex ids into `points`.
    tolerance : float
        How far outside the hull still counts as in it, metres. A loop that lies nearly flat has a hull without
        thickness, and a mean over a band of cloth around it is then always a little off.

    Raises
    ------
    ValueError
        When `points` and `states` differ in their number of frames.
    """
    if loops and (points is None or len(points) != len(states)):
        raise ValueError(f"points has {0 if points is None else len(points)} frames, states {len(states)}")
    tracks: dict[int, list[int]] = {}
    for row, state in enumerate(states):
        for loop in state.loops:
            tracks.setdefault(loop.id, []).append(row)
    summaries = []
    for identity, rows in tracks.items():
        found = [states[row][identity] for row in rows]
        where = -1, float("nan"), float("nan")
        if loops and points is not None:
            where = _nearest_loop(np.array([loop.centre for loop in found]), points[rows], loops, tolerance)
        lifetime = float(np.mean([loop.lifetime for loop in found]))
        first, last = states[rows[0]].frame, states[rows[-1]].frame
        summaries.append(TrackSummary(identity, first, last, len(rows), lifetime, *where))
    return sorted(summaries, key=lambda track: (-track.frames, -track.lifetime))


def _nearest_loop(
    centres: NDArray[np.float64],
    points: NDArray[np.floating],
    loops: Sequence[NDArray[np.integer]],
    tolerance: float,
) -> tuple[int, float, float]:
    """Which true loop a track is nearest to, how far from it, and its share of frames in the hull."""
    away = [np.linalg.norm(points[:, loop].mean(axis=1) - centres, axis=1).mean() for loop in loops]
    nearest = int(np.argmin(away))
    hulls = points[:, loops[nearest]]
    outside = [distance_to_hull(centre, hull) for centre, hull in zip(centres, hulls, strict=True)]
    return nearest, float(away[nearest]), float(np.mean(np.array(outside) <= max(tolerance, 1e-9)))
