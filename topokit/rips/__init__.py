"""Exact degree-1 Vietoris-Rips persistence with, for every loop, the simplices that create and end it.

Source: Antonova et al. 2021, section 3 (definitions); Koyama, Memoli, Robins, Turner 2023 (the lune reduction).
Taught in chapter 0.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._cores import n_cores
from .._validate import as_sequence, positive, whole
from ._cloud import TIME, WATCHED, Cloud, Pairs, end, own_halt, pairs, pairs_of_many
from ._diagram import Diagram, tighten

__all__ = ["Diagram", "rips_persistence", "rips_persistence_many", "tighten"]


def rips_persistence(
    points: ArrayLike,
    *,
    max_radius: float = np.inf,
    min_lifetime: float = 0.0,
    metric: str = "euclidean",
    time_limit: float = TIME,
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
    time_limit : float
        Seconds that it may take; inf for as many as it needs. Many points are refused at once when random parts of them say
        that all would take longer, and what does take longer is stopped.

    Raises
    ------
    MemoryError, ValueError
        When it would take longer than `time_limit`, or its tables more than 4.3 GB. They hold a bit for each pair of points
        (0.3 GB for 50,000 points), a sixteenth of a byte for each pair of loops, however short, and 108 bytes for each of the
        edges sorted at a time: four million, or as many as have the same length. More than three dimensions are read as
        distances, 8 bytes for each two points. Take a subset then (`farthest_point_sample`).

    Examples
    --------
    The loop of a square is born with the last side and dies with the first diagonal.

    >>> dgm = rips_persistence([[0, 0], [2, 0], [2, 2], [0, 2]])
    >>> dgm.birth, dgm.death.round(4), dgm.killer_edge
    (array([1.]), array([1.4142]), array([[0, 2]]))
    """
    cutoff = positive(max_radius, "max_radius", infinite=True)
    shortest = positive(min_lifetime, "min_lifetime", infinite=True)
    cloud = Cloud.of(points, metric)
    found = pairs(cloud, cutoff * cloud.scale, positive(time_limit, "time_limit", infinite=True))
    return _diagram(cloud, found, cutoff, shortest)


def next_persistence(points: ArrayLike, film: list[Any]) -> Diagram:
    """The diagram of the next frame of a film, found faster when points moved little; `film` is empty before the first."""
    return _diagrams([points], np.inf, 0.0, film)[0]


def _diagrams(arrays: Sequence[ArrayLike], cutoff: float, shortest: float, film: list[Any]) -> list[Diagram]:
    clouds = [Cloud.of(array) for array in arrays]
    found = pairs_of_many(clouds, cutoff, film)
    return [_diagram(cloud, some, cutoff, shortest) for cloud, some in zip(clouds, found, strict=True)]


def _diagram(cloud: Cloud, found: Pairs, cutoff: float, shortest: float) -> Diagram:
    created, killed, birth, death = found
    lifetime = death - birth
    count = np.count_nonzero((lifetime > 0) & (lifetime >= shortest * cloud.scale))
    keep = np.argsort(-lifetime, kind="stable")[:count]  # births come in the total order, which decides ties
    return Diagram(
        birth=birth[keep] / cloud.scale,
        death=death[keep] / cloud.scale,
        birth_edge=created[keep],
        killer_edge=killed[keep, :2],
        killer_triangles=killed[keep][:, [[0, 1, 3], [0, 1, 2]]],
        n_points=len(cloud),
        max_radius=cutoff,
        _cloud=cloud,
        _simplices=(created, killed),
    )


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
    TypeError, ValueError
        When `n_jobs` is not a whole number, 1 or more.

    Examples
    --------
    >>> square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    >>> [len(dgm) for dgm in rips_persistence_many([square, 2 * square, square[:3]])]
    [1, 1, 0]
    """
    arrays = as_sequence(clouds, "clouds")
    workers = n_cores() if n_jobs is None else whole(n_jobs, "n_jobs", 1)
    bounds = (positive(max_radius, "max_radius", infinite=True), positive(min_lifetime, "min_lifetime", infinite=True))
    short = max(map(len, arrays), default=0) < WATCHED
    some = min(64, -(-len(arrays) // workers) or 1) if short else 1  # clouds in one compiled call
    diagrams: list[Diagram] = []
    halts: list[NDArray[np.int64]] = []
    with ThreadPoolExecutor(workers, initializer=own_halt, initargs=(halts,)) as pool:
        jobs = [pool.submit(_diagrams, arrays[i : i + some], *bounds, []) for i in range(0, len(arrays), some)]
        try:
            for job in jobs:
                diagrams += job.result()
                if progress:
                    counted = f"\rpersistence: {len(diagrams)} of {len(arrays)} clouds"
                    print(counted, end="", file=sys.stderr, flush=True)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)  # an error or Ctrl-C does not wait for the rest
            end(halts)
            if progress and jobs:
                print(file=sys.stderr)
    return diagrams
