"""Degree-1 persistence of one cloud, of many clouds on all cores, and of the frames of a film."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._cores import n_cores
from .._validate import Array, as_sequence, positive, whole
from ._cloud import Cloud
from ._diagram import Diagram
from ._pairs import LONG, Pairs, compiled_pays, new_stop, pairs, pairs_of_many, stop_run


def rips_persistence(
    points: ArrayLike, *, max_radius: float = np.inf, min_lifetime: float = 0.0, metric: str = "euclidean"
) -> Diagram:
    """Compute the loops of a point cloud: degree-1 Vietoris-Rips persistence, exactly.

    Edges are ordered by (length, smaller index, larger index); this order decides every tie. Ctrl-C ends a long computation.

    Parameters
    ----------
    points : (n, d) array_like
        Coordinates, or with ``metric="precomputed"`` the (n, n) symmetric matrix of distances.
    max_radius : float
        Radius at which the filtration stops; loops that are still alive then get death inf.
    min_lifetime : float
        Leave out loops with a shorter lifetime. Loops of lifetime zero are always left out.
    metric : {"euclidean", "precomputed"}

    Raises
    ------
    ValueError
        When the points or the matrix are not valid, as with nan or an asymmetric matrix.
    MemoryError
        When the tables would take more than 4.3 GB; take a subset of the points then (`farthest_point_sample`). Points in up
        to three dimensions need at most 2 kB each, and more when many edges have the same length. Points of more dimensions, and
        a matrix, need 8 bytes and 1 bit for each pair, and 36 bytes for each edge that is sorted at a time: four million edges,
        or more when more have the same length.

    Examples
    --------
    The loop of a square is born with its last side and dies with its first diagonal.

    >>> dgm = rips_persistence([[0, 0], [2, 0], [2, 2], [0, 2]])
    >>> dgm.birth, dgm.death.round(4), dgm.killer_edge
    (array([1.]), array([1.4142]), array([[0, 2]]))
    """
    cutoff = positive(max_radius, "max_radius", infinite=True)
    shortest = positive(min_lifetime, "min_lifetime", infinite=True)
    cloud = Cloud.of(points, metric)
    if metric == "euclidean":
        _suspect_distances(points)
    return _diagrams([cloud], [pairs(cloud, cutoff * cloud.scale)], cutoff, shortest)[0]


def _suspect_distances(points: ArrayLike) -> None:
    """Warn when points look like a matrix of distances: square, symmetric, and zero on the diagonal."""
    table = np.asarray(points)
    is_square = 4 <= table.shape[0] == table.shape[1]
    if is_square and not table.diagonal().any() and np.array_equal(table, table.T):
        message = 'points are a symmetric matrix with a zero diagonal: if they are distances, give metric="precomputed"'
        warnings.warn(message, stacklevel=3)


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
        Matrices of distances are not accepted: call `rips_persistence` for each.
    n_jobs : int, optional
        Number of threads; by default one for each core.
    progress : bool
        Write the number of clouds done to stderr.
    max_radius, min_lifetime : float
        As in `rips_persistence`.

    Raises
    ------
    TypeError, ValueError
        When `n_jobs` is not a whole number of 1 or more, or a cloud is not valid.

    Examples
    --------
    >>> square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    >>> [len(dgm) for dgm in rips_persistence_many([square, 2 * square, square[:3]])]
    [1, 1, 0]
    """
    arrays = as_sequence(clouds, "clouds")
    workers = n_cores() if n_jobs is None else whole(n_jobs, "n_jobs", 1)
    cutoff = positive(max_radius, "max_radius", infinite=True)
    shortest = positive(min_lifetime, "min_lifetime", infinite=True)

    # Of all clouds together, compiling may pay. Clouds of more than three dimensions are read as matrices.
    if arrays and arrays[0].shape[1] <= 3:
        compiled_pays(list(map(len, arrays)))

    # A call of the kernel takes many small clouds, or one large cloud.
    clouds_per_call = 1
    if max(map(len, arrays), default=0) < LONG:
        clouds_per_call = min(64, -(-len(arrays) // workers) or 1)

    diagrams: list[Diagram] = []
    stops: list[NDArray[np.int64]] = []
    jobs = []
    with ThreadPoolExecutor(workers) as pool:
        try:
            for first in range(0, len(arrays), clouds_per_call):
                stops.append(new_stop())
                batch = arrays[first : first + clouds_per_call]
                jobs.append(pool.submit(_diagrams_of_batch, batch, cutoff, shortest, stops[-1]))
            for job in jobs:
                diagrams += job.result()
                if progress:
                    line = f"\rpersistence: {len(diagrams)} of {len(arrays)} clouds"
                    print(line, end="", file=sys.stderr, flush=True)
        finally:
            # After an error or Ctrl-C, stop the other threads instead of waiting for them.
            pool.shutdown(wait=False, cancel_futures=True)
            for stop in stops:
                stop_run(stop)
            if progress and jobs:
                print(file=sys.stderr)
    return diagrams


def _diagrams_of_batch(
    arrays: Sequence[Array], cutoff: float, shortest: float, stop: NDArray[np.int64]
) -> list[Diagram]:
    """Compute the diagrams of checked clouds with one call of the kernel."""
    clouds = [Cloud.of_points(array) for array in arrays]
    return _diagrams(clouds, pairs_of_many(clouds, cutoff, stop), cutoff, shortest)


def _diagrams(clouds: Sequence[Cloud], found: Sequence[Pairs], cutoff: float, shortest: float) -> list[Diagram]:
    """Return for each cloud the diagram of the loops that live long enough, longest lifetime first, in the unit of the cloud."""
    created, killed, birth, death = (np.concatenate(columns) for columns in zip(*found, strict=True))
    number = np.repeat(np.arange(len(clouds)), [len(loops.birth) for loops in found])
    scale = np.array([cloud.scale for cloud in clouds])[number]
    lifetime = death - birth

    # All clouds at once, and then the rows of each. Ties keep the order of birth.
    order = np.lexsort((-lifetime, number))
    keep = order[((lifetime > 0) & (lifetime >= shortest * scale))[order]]
    killed = killed[keep]
    birth = birth[keep] / scale[keep]
    death = death[keep] / scale[keep]
    created = created[keep]
    # A killer edge (0, 1) with its two apexes (2, 3) gives two triangles; that of the second apex is first.
    triangles = killed[:, [[0, 1, 3], [0, 1, 2]]]
    ends = np.searchsorted(number[keep], np.arange(len(clouds) + 1)).tolist()
    return [
        Diagram(
            birth=birth[a:b],
            death=death[a:b],
            birth_edge=created[a:b],
            killer_edge=killed[a:b, :2],
            killer_triangles=triangles[a:b],
            n_points=len(cloud),
            max_radius=cutoff,
            _cloud=cloud,
            _simplices=(loops.created, loops.killed),
        )
        for cloud, loops, (a, b) in zip(clouds, found, pairwise(ends), strict=True)
    ]
