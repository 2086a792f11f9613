"""Exact degree-1 Vietoris-Rips persistence with, for every loop, the simplices that create and end it.

Source: Antonova et al. 2021, section 3 (definitions); Koyama, Memoli, Robins, Turner 2023 (the lune reduction).
Taught in chapter 0.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._cores import n_cores
from .._validate import as_sequence, positive
from ._cloud import Cloud, Film, pairs
from ._diagram import Diagram, tighten

__all__ = ["Diagram", "rips_persistence", "rips_persistence_many", "tighten"]

_AT_ONCE = 64  # clouds in one compiled call, which Ctrl-C cannot end
_FEW_POINTS = 1 << 17  # in such a call


def rips_persistence(
    points: ArrayLike,
    *,
    max_radius: float = np.inf,
    min_lifetime: float = 0.0,
    metric: str = "euclidean",
) -> Diagram:
    """Compute the loops of a point cloud: degree-1 Vietoris-Rips persistence, exactly.

    Edges are ordered by (length, smaller index, larger index), which decides every tie.

    Parameters
    ----------
    points : (n, d) array_like
        Coordinates, or with ``metric="precomputed"`` the (n, n) symmetric matrix of distances.
    max_radius : float
        Stop the filtration there; loops still alive get death inf.
    min_lifetime : float
        Leave out loops with a shorter lifetime. Loops of lifetime zero are always left out.
    metric : {"euclidean", "precomputed"}

    Raises
    ------
    MemoryError
        When the tables would take more than 4.3 GB. They hold a bit for each pair of points (0.3 GB for 50,000 points), a
        sixteenth of a byte for each pair of loops, however short, and 108 bytes for each of the edges sorted at a time: four
        million, or as many as have the same length. More than three dimensions are read as distances, 8 bytes for each two
        points. Take a subset then (`farthest_point_sample`).

    Examples
    --------
    The loop of a square is born with the last side and dies with the first diagonal.

    >>> dgm = rips_persistence([[0, 0], [2, 0], [2, 2], [0, 2]])
    >>> dgm.birth, dgm.death.round(4), dgm.killer_edge
    (array([1.]), array([1.4142]), array([[0, 2]]))
    """
    cutoff = positive(max_radius, "max_radius", infinite=True)
    shortest = positive(min_lifetime, "min_lifetime", infinite=True)
    return _diagrams([Cloud.of(points, metric)], cutoff, shortest)[0]


def next_persistence(points: NDArray[np.float64], film: Film) -> Diagram:
    """The diagram of the next frame of a film, found faster when the points moved little."""
    return _diagrams([Cloud.of(points)], np.inf, 0.0, film)[0]


def rips_persistence_many(
    clouds: ArrayLike | Sequence[ArrayLike],
    n_jobs: int | None = None,
    *,
    progress: bool = False,
    max_radius: float = np.inf,
    min_lifetime: float = 0.0,
) -> list[Diagram]:
    """Compute the diagrams of many point clouds on all cores.

    The clouds are shared with threads, not copied: the compiled kernel runs without Python's lock.

    Parameters
    ----------
    clouds : (T, n, d) array_like or list of (n_t, d) array_like
    n_jobs : int, optional
        Threads; by default one for each core.
    progress : bool
        Count the clouds done on stderr.
    max_radius, min_lifetime : float
        As in `rips_persistence`.

    Raises
    ------
    ValueError
        When `n_jobs` is less than 1.

    Examples
    --------
    >>> square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    >>> [len(dgm) for dgm in rips_persistence_many([square, 2 * square, square[:3]])]
    [1, 1, 0]
    """
    arrays = as_sequence(clouds, "clouds")
    if n_jobs is not None and n_jobs < 1:
        raise ValueError(f"n_jobs must be 1 or more, not {n_jobs}")
    bounds = (positive(max_radius, "max_radius", infinite=True), positive(min_lifetime, "min_lifetime", infinite=True))
    workers, diagrams = n_jobs or n_cores(), list[Diagram]()
    at_once = min(_AT_ONCE, -(-len(arrays) // workers))
    with ThreadPoolExecutor(workers) as pool:
        jobs = [pool.submit(_some, arrays[i : i + at_once], *bounds) for i in range(0, len(arrays), at_once or 1)]
        try:
            for job in jobs:
                diagrams += job.result()
                if progress:
                    print(
                        f"\rpersistence: {len(diagrams)} of {len(arrays)} clouds", end="", file=sys.stderr, flush=True
                    )
        finally:
            pool.shutdown(cancel_futures=True)  # an error or Ctrl-C does not wait for the rest
            if progress and jobs:
                print(file=sys.stderr)
    return diagrams


def _some(arrays: list[NDArray[np.float64]], cutoff: float, shortest: float) -> list[Diagram]:
    """Diagrams of some clouds: of points in space in one call, unless they need much memory."""
    clouds = [Cloud.of(array) for array in arrays]
    if clouds[0].axes and sum(map(len, clouds)) <= _FEW_POINTS:
        return _diagrams(clouds, cutoff, shortest)
    return [diagram for cloud in clouds for diagram in _diagrams([cloud], cutoff, shortest)]


def _diagrams(clouds: list[Cloud], cutoff: float, shortest: float, film: Film | None = None) -> list[Diagram]:
    created, killed, birth, death, number = pairs(clouds, cutoff, film)
    keep = np.lexsort((birth - death, number))  # births come in the total order, which decides ties
    keep = keep[(death > birth)[keep] & (death - birth >= shortest)[keep]]
    of, number_kept = (np.searchsorted(n, np.arange(len(clouds) + 1)) for n in (number, number[keep]))
    diagrams = []
    for c, cloud in enumerate(clouds):
        mine, found = keep[number_kept[c] : number_kept[c + 1]], slice(of[c], of[c + 1])
        diagrams.append(
            Diagram(
                birth=birth[mine],
                death=death[mine],
                birth_edge=created[mine],
                killer_edge=killed[mine, :2],
                killer_triangles=killed[mine][:, [[0, 1, 3], [0, 1, 2]]],
                n_points=len(cloud),
                max_radius=cutoff,
                _cloud=cloud,
                _simplices=(created[found], killed[found]),
            )
        )
    return diagrams
