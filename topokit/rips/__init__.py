"""Exact degree-1 Vietoris-Rips persistence with, for every loop, the simplices that create and end it.

Source: Antonova et al. 2021, section 3 (definitions); Koyama, Memoli, Robins, Turner 2023 (the lune reduction).
Taught in chapter 0.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._validate import as_points, positive
from ._diagram import Diagram

__all__ = ["Diagram", "rips_persistence"]


def rips_persistence(
    points: ArrayLike,
    *,
    max_radius: float = np.inf,
    min_lifetime: float = 0.0,
    metric: str = "euclidean",
) -> Diagram:
    """Compute the loops of a point cloud: degree-1 Vietoris-Rips persistence, exactly.

    Edges are ordered by (length, smaller index, larger index); this order decides every tie, so the answer is
    deterministic, and births and deaths do not depend on the order of the points.

    Parameters
    ----------
    points : (n, d) array_like
        Coordinates, or with ``metric="precomputed"`` the (n, n) symmetric matrix of distances.
    max_radius : float
        Stop the filtration there; loops still alive get death inf.
    min_lifetime : float
        Leave out loops with a shorter lifetime. Loops of lifetime zero are always left out.
    metric : {"euclidean", "precomputed"}

    Returns
    -------
    Diagram
        Longest lifetime first. Empty for fewer than four points, which can have no loop.

    Raises
    ------
    TypeError, ValueError
        When `points` is not a finite (n, d) array, the matrix is not square, symmetric, zero on its diagonal and not
        negative, or an option is out of range.

    Examples
    --------
    Four corners of a square: the loop is born with the last side and dies with the first diagonal.

    >>> dgm = rips_persistence([[0, 0], [2, 0], [2, 2], [0, 2]])
    >>> dgm.birth, dgm.death.round(4), dgm.killer_edge
    (array([1.]), array([1.4142]), array([[0, 2]]))
    """
    cutoff = positive(max_radius, "max_radius", infinite=True)
    shortest = positive(min_lifetime, "min_lifetime", infinite=True)
    if metric not in ("euclidean", "precomputed"):
        raise ValueError(f'metric must be "euclidean" or "precomputed", not {metric!r}')
    array = as_points(points)
    precomputed = metric == "precomputed"
    if precomputed:
        _check_distances(array)
    created, killed, birth, death = _pairs(array, cutoff, precomputed)
    keep = np.flatnonzero((death > birth) & (death - birth >= shortest))
    keep = keep[np.lexsort((created[keep, 1], created[keep, 0], birth[keep], -(death - birth)[keep]))]
    return Diagram(
        birth=birth[keep],
        death=death[keep],
        birth_edge=created[keep],
        killer_edge=killed[keep, :2],
        killer_triangles=killed[keep][:, [[0, 1, 3], [0, 1, 2]]],
        n_points=len(array),
        max_radius=cutoff,
        _points=array,
        _precomputed=precomputed,
    )


def _pairs(
    array: NDArray[np.float64], max_radius: float, precomputed: bool
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Creating edges (c, 2), killer edges with their apexes (c, 4), births and deaths (c,)."""
    n = len(array)
    if n < 4:  # the smallest loop has four vertices
        return np.empty((0, 2), np.int64), np.empty((0, 4), np.int64), np.empty(0), np.empty(0)
    if precomputed:
        from ._dense import dense_pairs  # numba takes a while to import

        i, j = np.triu_indices(n, k=1)
        lengths = array[i, j]
        order = np.argsort(lengths, kind="stable")  # (i, j) come in order, so a stable sort breaks ties by them
        created, killed = dense_pairs(array, i[order], j[order], 2 * max_radius)
    else:
        from ._reduce import tree_pairs

        created, killed = tree_pairs(array, (0,) * array.shape[1], (2 * max_radius) ** 2)
    birth = _lengths(array, created, precomputed) / 2
    death = np.where(killed[:, 0] >= 0, _lengths(array, killed, precomputed) / 2, np.inf)
    return created, killed, birth, death


def _lengths(array: NDArray[np.float64], edges: NDArray[np.int64], precomputed: bool) -> NDArray[np.float64]:
    """Lengths of the edges in the first two columns."""
    x, y = edges[:, 0], edges[:, 1]
    return array[x, y] if precomputed else np.sqrt(((array[x] - array[y]) ** 2).sum(axis=1))


def _check_distances(matrix: NDArray[np.float64]) -> None:
    """Raise ValueError when the matrix cannot be one of distances; the message names the entry."""
    if matrix.shape[0] != matrix.shape[1]:
        raise ValueError(
            f'with metric="precomputed", points must be a square matrix of distances, not of shape {matrix.shape}'
        )
    for wrong, what in (
        (matrix < 0, "negative"),
        (matrix != matrix.T, "not symmetric"),
        (np.diag(np.diag(matrix) != 0), "not zero on the diagonal"),
    ):
        if wrong.any():
            i, j = np.argwhere(wrong)[0].tolist()
            raise ValueError(
                f"the matrix of distances is {what} at [{i}, {j}]: {matrix[i, j]} there and {matrix[j, i]} at [{j}, {i}]"
            )
