"""Ripser for Python, by another engine.

Source: Tralie, Saul, Bar-On 2018, *Ripser.py: a lean persistent homology library for Python*.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._validate import Array, as_points, as_reals, positive, whole
from topokit.rips import Diagram, rips_persistence
from topokit.rips._merges import merges


def ripser(
    X: ArrayLike,
    maxdim: int = 1,
    thresh: float = np.inf,
    coeff: int = 2,
    distance_matrix: bool = False,
    do_cocycles: bool = False,
    metric: str | Callable[[Array, Array], float] = "euclidean",
    n_perm: int | None = None,
    *,
    do_cycles: bool = False,
) -> dict[str, Any]:
    """Compute persistence diagrams as `ripser.ripser` does: its arguments, its result, and where the loops are.

    Births and deaths are whole lengths of edges, as in Ripser, not halves as elsewhere in topokit; they have the digits of a
    float64, Ripser's those of a float32.

    Parameters
    ----------
    X : (n, d) array_like
        Points, or with `distance_matrix` the (n, n) distances, dense or sparse; edges infinite or not stored are not there.
    maxdim : {1, 0}
    thresh : float
        The longest edge that is looked at.
    coeff : {2}
        The field is Z/2.
    distance_matrix : bool
    do_cocycles : {False}
        Cocycles are not offered; see `do_cycles`.
    metric : str or callable
        "euclidean", or any other that `sklearn.metrics.pairwise_distances` takes, which needs scikit-learn.
    n_perm : int, optional
        As many farthest points, the first one first, stand for all.
    do_cycles : bool
        Also find a closed walk around each loop, as `Diagram.cycle` does.

    Returns
    -------
    dict
        As of Ripser: ``dgms``, ``cocycles`` (empty), ``num_edges``, ``dperm2all``, ``idx_perm``, ``r_cover``. Besides, for the
        rows of ``dgms[1]``: ``birth_edge`` and ``killer_edge`` (n, 2), numbers of rows of `X`, -1 where a loop stays; and
        ``cycles``, a list of arrays of such numbers, which is empty without `do_cycles`.

    Raises
    ------
    ValueError
        When something is asked for that is not offered, or `X` cannot be meant.

    Examples
    --------
    >>> from topokit.compat import ripser
    >>> found = ripser([[0, 0], [2, 0], [2, 2], [0, 2], [1, 2]], do_cycles=True)
    >>> found["dgms"][1].round(3), found["killer_edge"], found["cycles"]
    (array([[2.   , 2.236]]), array([[1, 4]]), [array([1, 0, 3, 4, 2])])
    """
    _refuse(maxdim, coeff, do_cocycles, n_perm and hasattr(X, "tocsr"))
    bound, is_sparse = positive(thresh, "thresh", infinite=True), hasattr(X, "tocsr")
    distances, most = filled(X, "X") if distance_matrix else (_distances(X, metric), np.inf)
    if distances.ndim != 2 or len(distances) != distances.shape[1]:
        raise ValueError(f"Distance matrix is not square: X has shape {distances.shape}")
    index, cover, from_all = np.arange(len(distances)), 0.0, X if distance_matrix else distances
    if n_perm and whole(n_perm, "n_perm", 1, len(distances)) < len(distances):
        index, cover = _greedy(distances, n_perm)
        from_all, distances = distances[index], distances[np.ix_(index, index)]
    if distance_matrix or metric != "euclidean":
        diagram = rips_persistence(distances, metric="precomputed", max_radius=min(bound, most) / 2)
    else:
        diagram = rips_persistence(as_points(X)[index], max_radius=bound / 2)
    rows = np.argsort(-diagram.birth, kind="stable") if maxdim else np.empty(0, np.int64)
    dgms = [_components(diagram), 2 * np.column_stack([diagram.birth, diagram.death])[rows]][: maxdim + 1]
    if bound == np.inf and not is_sparse:  # beyond the enclosing radius nothing is left to die
        most = distances.max(axis=1, initial=0.0).min(initial=np.inf)
    lengths = distances[np.triu_indices(len(distances), 1)].astype(np.float32)  # as Ripser counts
    return {
        "dgms": dgms,
        "cocycles": [[] for _ in dgms],
        "num_edges": int(np.count_nonzero(lengths <= np.float32(min(bound, most)))),
        "dperm2all": from_all,
        "idx_perm": index,
        "r_cover": cover,
        "birth_edge": index[diagram.birth_edge[rows]],
        "killer_edge": np.append(index, -1)[diagram.killer_edge[rows]],
        "cycles": [index[diagram.cycle(i)] for i in rows.tolist()] if do_cycles else [],
    }


def _refuse(maxdim: int, coeff: int, do_cocycles: bool, few_of_sparse: Any) -> None:
    if whole(maxdim, "maxdim") > 1:
        raise ValueError(f"maxdim={maxdim} is not offered: topokit finds components and loops, maxdim=1")
    if coeff != 2:
        raise ValueError(f"coeff={coeff} is not offered: topokit computes over Z/2, coeff=2")
    if do_cocycles:
        raise ValueError("do_cocycles=True is not offered: do_cycles=True finds closed walks around the loops instead")
    if few_of_sparse:
        raise ValueError("n_perm: Greedy permutation is not supported for sparse distance matrices")


def _distances(X: ArrayLike, metric: Any) -> Array:
    """The (n, n) distances of points; Ripser's question about an array whose rows may be no points."""
    points = as_points(X, "X")
    if len(points) <= points.shape[1]:
        what = "its transpose, or distance_matrix=True" if len(set(points.shape)) == 1 else "its transpose"
        warnings.warn(f"X has shape {points.shape}, each row a point: did you mean {what}?", stacklevel=3)
    if metric == "euclidean":
        from scipy.spatial.distance import cdist  # SciPy takes a while to import

        return cdist(points, points)
    from sklearn.metrics.pairwise import pairwise_distances

    return np.asarray(filled(pairwise_distances(points, metric=metric), "the distances")[0])


def _greedy(distances: Array, n: int) -> tuple[NDArray[np.int64], float]:
    """Farthest points from the first on, and how far the farthest point is from them."""
    index, nearest = [0], distances[0]
    while len(index) < n:
        index.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, distances[index[-1]])
    return np.array(index), float(nearest.max())


def _components(diagram: Diagram) -> Array:
    """Degree 0: a bar from 0 for each component, those that never end last; points at one place are one component."""
    radii = merges(diagram._cloud, diagram.max_radius)[1]
    deaths = np.append(2 * radii[radii > 0], np.full(diagram.n_points - len(radii), np.inf))
    return np.column_stack([np.zeros(len(deaths)), deaths])


def filled(matrix: Any, name: str) -> tuple[NDArray[np.float64], float]:
    """A whole matrix, of its upper triangle if it has one, and the longest edge: those infinite or not stored are longer."""
    from scipy.sparse import csr_array, issparse  # SciPy takes a while to import

    if issparse(matrix):
        entries: Any = csr_array(matrix).tocoo()
        (row, column), value = entries.coords, as_reals(entries.data, name)
        dense, upper = np.full(entries.shape, np.inf), row < column
        np.fill_diagonal(dense, matrix.diagonal())
        for part in (~upper & (row != column), upper):
            dense[row[part], column[part]] = dense[column[part], row[part]] = value[part]
    else:
        dense = np.array(as_reals(matrix, name), np.float64)
        mirrored = np.triu(dense) + np.triu(dense, 1).T if dense.ndim == 2 and len(dense) == dense.shape[1] else dense
        dense = mirrored if np.allclose(dense, mirrored, rtol=1e-6, atol=0) else dense  # by rounding, not by mistake
    there = np.isfinite(dense)
    longest = float(dense.max(initial=0.0, where=there))
    dense[np.isposinf(dense)] = 2 * longest or 1.0
    return dense, np.inf if there.all() else longest
