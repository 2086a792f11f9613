"""Degree-1 persistence of one cloud and of many clouds: pairs of edges, by the engine or in plain Python, become diagrams."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import ArrayLike

from .._cores import n_cores
from .._validate import Array, Ids, as_sequence, positive, whole
from . import pairing
from ._cloud import Cloud, check_memory
from ._diagram import Diagram
from ._engine import ask_for_engine, engine_is_ready

# A killer edge (0, 1) with its two apexes (2, 3) gives two triangles; that of the second apex is first.
TRIANGLES = np.array([[0, 1, 3], [0, 1, 2]])


def rips_persistence(
    points: ArrayLike, *, max_radius: float = np.inf, min_lifetime: float = 0.0, metric: str = "euclidean"
) -> Diagram:
    """Compute the loops of a point cloud: degree-1 Vietoris-Rips persistence, exactly.

    Edges are ordered by (length, smaller index, larger index); this order decides every tie. The first clouds of a process
    are computed in plain Python, until numba has loaded the engine, or compiled it in the background.

    Parameters
    ----------
    points : (n, d) array_like
        Coordinates, or with ``metric="precomputed"`` the (n, n) symmetric matrix of distances. One that differs from a symmetric
        one, or from zero on its diagonal, by rounding is made so.
    max_radius : float
        Radius at which the filtration stops; loops that are still alive then get death inf.
    min_lifetime : float
        Leave out loops with a shorter lifetime. Loops of lifetime zero are always left out.
    metric : {"euclidean", "precomputed"}

    Raises
    ------
    MemoryError
        When the tables would take more than 4.3 GB: from 185,000 points on, and from 23,000 for more than three dimensions or a
        matrix of distances. Take a subset then (`farthest_point_sample`); births and deaths change by at most its covering
        radius.

    Examples
    --------
    The loop of a square is born with its last side and dies with its first diagonal.

    >>> dgm = rips_persistence([[0, 0], [2, 0], [2, 2], [0, 2]])
    >>> dgm.birth, dgm.death.round(4), dgm.killer_edge
    (array([1.]), array([1.4142]), array([[0, 2]]))
    """
    (diagram,) = _diagrams([Cloud.of(points, metric)], 1, max_radius, min_lifetime)
    return diagram


def rips_persistence_many(
    clouds: ArrayLike | Sequence[ArrayLike],
    n_jobs: int | None = None,
    *,
    progress: bool = False,
    max_radius: float = np.inf,
    min_lifetime: float = 0.0,
) -> list[Diagram]:
    """Compute the diagrams of many point clouds on all cores.

    The clouds are shared with threads, not copied: the compiled engine runs without Python's lock.

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

    Examples
    --------
    >>> square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    >>> [len(dgm) for dgm in rips_persistence_many([square, 2 * square, square[:3]])]
    [1, 1, 0]
    """
    checked = [Cloud.of_points(points) for points in as_sequence(clouds, "clouds")]
    workers = n_cores() if n_jobs is None else whole(n_jobs, "n_jobs", 1)
    diagrams = list[Diagram]()
    for diagram in _diagrams(checked, workers, max_radius, min_lifetime):
        diagrams.append(diagram)
        if progress:
            end = "" if len(diagrams) < len(checked) else "\n"
            print(f"\rpersistence: {len(diagrams)} of {len(checked)} clouds", end=end, file=sys.stderr, flush=True)
    return diagrams


def _diagrams(clouds: Sequence[Cloud], workers: int, max_radius: float, min_lifetime: float) -> Iterator[Diagram]:
    """Yield the diagrams of clouds in their order."""
    cutoff = positive(max_radius, "max_radius", infinite=True)
    shortest = positive(min_lifetime, "min_lifetime", infinite=True)
    stop = np.zeros(1, np.int64)
    ask_for_engine([len(cloud) for cloud in clouds])

    def diagram_of(cloud: Cloud) -> Diagram:
        key = cloud.key_of(cutoff)
        if engine_is_ready() and len(cloud) > 3:  # a matrix with three columns would look like points
            check_memory(len(cloud), is_matrix=cloud.is_matrix)
            from .engine.pairing import pair_edges  # numba is imported here

            return _diagram(cloud, pair_edges(cloud.data, key, stop), cutoff, shortest)
        return _diagram(cloud, pairing.pair_edges(cloud, key), cutoff, shortest)

    # Long work of the engine is done by other threads, so that Ctrl-C, which the main thread alone hears, can end it.
    is_long = sum(len(cloud) ** 2 for cloud in clouds) > 5e5
    if not (engine_is_ready() and is_long):
        yield from map(diagram_of, clouds)
        return
    size = -(-len(clouds) // (8 * workers))
    chunks = [clouds[start : start + size] for start in range(0, len(clouds), size)]
    with ThreadPoolExecutor(workers) as pool:
        try:
            for diagrams in pool.map(lambda chunk: list(map(diagram_of, chunk)), chunks):
                yield from diagrams
        finally:
            stop[0] = 1


def _diagram(cloud: Cloud, loops: tuple[Ids, Ids, Array, Array], cutoff: float, shortest: float) -> Diagram:
    """Return the diagram of the loops that live long enough, longest lifetime first; ties keep the order of birth."""
    created, killed, birth, death = loops
    if cutoff < np.inf:  # its key was rounded up
        late = death > cutoff
        death[late] = np.inf
        killed[late] = -1
        inside = birth <= cutoff
        created, killed, birth, death = created[inside], killed[inside], birth[inside], death[inside]

    lifetime = death - birth
    order = (-lifetime).argsort(kind="stable")
    lifetime = lifetime[order]
    keep = order[(lifetime > 0) & (lifetime >= shortest)]
    killers = killed[keep]
    return Diagram(
        birth=birth[keep],
        death=death[keep],
        birth_edge=created[keep],
        killer_edge=killers[:, :2],
        killer_triangles=killers.take(TRIANGLES, axis=1),
        n_points=len(cloud),
        max_radius=cutoff,
        _cloud=cloud,
        _simplices=(created, killed),
    )
