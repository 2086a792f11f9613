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
from topokit.rips import Diagram, rips_persistence, rips_persistence_many


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
        So many farthest points, the first one first, stand for all.
    do_cycles : bool
        Also find a closed walk around each loop, as `Diagram.cycle` does.

    Returns
    -------
    dict
        The entries of Ripser: ``dgms``, ``cocycles`` (empty), ``num_edges``, ``dperm2all``, ``idx_perm``, ``r_cover``. Also, for
        the rows of ``dgms[1]``: ``birth_edge`` and ``killer_edge`` (n, 2), numbers of rows of `X`, -1 where a loop never dies;
        and ``cycles``, a list of arrays of such numbers, which is empty without `do_cycles`.

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
    is_sparse = hasattr(X, "tocsr")
    if whole(maxdim, "maxdim") > 1:
        raise ValueError(f"maxdim={maxdim} is not offered: topokit finds components and loops, maxdim=1")
    if coeff != 2:
        raise ValueError(f"coeff={coeff} is not offered: topokit computes over Z/2, coeff=2")
    if do_cocycles:
        raise ValueError("do_cocycles=True is not offered: do_cycles=True finds closed walks around the loops instead")
    if n_perm and is_sparse:
        raise ValueError("n_perm: Greedy permutation is not supported for sparse distance matrices")
    thresh = positive(thresh, "thresh", infinite=True)

    longest = np.inf
    if distance_matrix:
        distances, longest = _filled(X, "X")
    else:
        distances = _distances(X, metric)
    if distances.ndim != 2 or len(distances) != distances.shape[1]:
        raise ValueError(f"Distance matrix is not square: X has shape {distances.shape}")

    # A few farthest points stand for all.
    index = np.arange(len(distances))
    covering_radius = 0.0
    to_all: Any = distances
    if distance_matrix:
        to_all = X
    if n_perm and whole(n_perm, "n_perm", 1, len(distances)) < len(distances):
        index, covering_radius = _farthest_points(distances, n_perm)
        to_all = distances[index]
        distances = distances[np.ix_(index, index)]

    if distance_matrix or metric != "euclidean":
        diagram = rips_persistence(distances, metric="precomputed", max_radius=min(thresh, longest) / 2)
    else:
        # `rips_persistence` would ask once more whether the points are a matrix of distances.
        (diagram,) = rips_persistence_many([as_points(X)[index]], max_radius=thresh / 2)

    # Ripser lists late births first, and counts edges in float32 up to the enclosing radius, beyond which nothing dies.
    rows = np.argsort(-diagram.birth, kind="stable")
    if maxdim == 0:
        rows = rows[:0]
    loops = 2 * np.column_stack([diagram.birth, diagram.death])[rows]
    diagrams = [_components(diagram, distances), loops][: maxdim + 1]
    if thresh == np.inf and not is_sparse:
        longest = distances.max(axis=1, initial=0.0).min(initial=np.inf)
    lengths = distances[np.triu_indices(len(distances), 1)].astype(np.float32)
    cycles = [index[diagram.cycle(row)] for row in rows.tolist()] if do_cycles else []
    return {
        "dgms": diagrams,
        "cocycles": [[] for _ in diagrams],
        "num_edges": int(np.count_nonzero(lengths <= np.float32(min(thresh, longest)))),
        "dperm2all": to_all,
        "idx_perm": index,
        "r_cover": covering_radius,
        "birth_edge": index[diagram.birth_edge[rows]],
        "killer_edge": np.append(index, -1)[diagram.killer_edge[rows]],
        "cycles": cycles,
    }


def _distances(X: ArrayLike, metric: Any) -> Array:
    """Return the (n, n) distances of points, and ask as Ripser does about an array whose rows may be no points."""
    points = as_points(X, "X")
    if len(points) <= points.shape[1]:
        question = "its transpose"
        if len(points) == points.shape[1]:
            question = "its transpose, or distance_matrix=True"
        warnings.warn(f"X has shape {points.shape}, each row a point: did you mean {question}?", stacklevel=3)
    if metric == "euclidean":
        from scipy.spatial.distance import cdist  # SciPy takes a while to import

        return cdist(points, points)
    from sklearn.metrics.pairwise import pairwise_distances

    return _filled(pairwise_distances(points, metric=metric), "the distances")[0]


def _farthest_points(distances: Array, n: int) -> tuple[NDArray[np.int64], float]:
    """Return n farthest points, the first point first, and how far the farthest other point is from them."""
    chosen = [0]
    nearest = distances[0]
    while len(chosen) < n:
        chosen.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, distances[chosen[-1]])
    return np.array(chosen), float(nearest.max())


def _components(diagram: Diagram, distances: Array) -> Array:
    """Return degree 0: a bar from 0 for each component, those that never end last; points at one place are one component."""
    merges, _, never_die, _ = diagram.to_gudhi()
    deaths = np.full(len(merges) + len(never_die), np.inf)
    deaths[: len(merges)] = distances[merges[:, 1], merges[:, 2]]
    return np.column_stack([np.zeros(len(deaths)), deaths])


def _filled(matrix: Any, name: str) -> tuple[Array, float]:
    """Return a whole matrix, of its upper triangle if it has one, and its longest edge: infinite or missing edges are longer."""
    from scipy.sparse import csr_array, issparse  # SciPy takes a while to import

    if issparse(matrix):
        entries: Any = csr_array(matrix).tocoo()
        row, column = entries.coords
        value = as_reals(entries.data, name)
        dense = np.full(entries.shape, np.inf)
        np.fill_diagonal(dense, matrix.diagonal())
        upper = row < column
        lower = row > column
        for part in (lower, upper):  # the upper triangle last, because it counts
            dense[row[part], column[part]] = value[part]
            dense[column[part], row[part]] = value[part]
    else:
        dense = np.array(as_reals(matrix, name), np.float64)
        if dense.ndim == 2 and len(dense) == dense.shape[1]:
            mirrored = np.triu(dense) + np.triu(dense, 1).T
            if np.allclose(dense, mirrored, rtol=1e-6, atol=0):  # the triangles differ by rounding, not by mistake
                dense = mirrored
    finite = np.isfinite(dense)
    longest = float(dense.max(initial=0.0, where=finite))
    dense[np.isposinf(dense)] = 2 * longest or 1.0
    if finite.all():
        return dense, np.inf
    return dense, longest
