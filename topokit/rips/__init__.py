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
from ._cloud import TIME, Cloud, own_halt, pairs
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
    created, killed, birth, death = pairs(
        cloud, cutoff * cloud.scale, positive(time_limit, "time_limit", infinite=True)
    )
    keep = np.argsort(birth - death, kind="stable")  # births come in the total order, which decides ties
    keep = keep[(death > birth)[keep] & (death - birth >= shortest * cloud.scale)[keep]]
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
    workers = n_jobs or n_cores()
    diagrams = []
    halts: list[NDArray[np.int64]] = []
    with ThreadPoolExecutor(workers, initializer=own_halt, initargs=(halts,)) as pool:
        jobs = [pool.submit(rips_persistence, a, max_radius=max_radius, min_lifetime=min_lifetime) for a in arrays]
        try:
            for done, job in enumerate(jobs, 1):
                diagrams.append(job.result())
                if progress:
                    print(f"\rpersistence: {done} of {len(jobs)} clouds", end="", file=sys.stderr, flush=True)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)  # an error or Ctrl-C does not wait for the rest
            for halt in halts:
                halt[0] = 1
            if progress and jobs:
                print(file=sys.stderr)
    return diagrams
