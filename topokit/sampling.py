"""Farthest-point subsamples, covering radii, Hausdorff distances and outliers.

Source: Gonzalez 1985 (farthest-point traversal); Antonova et al. 2021, Assumption 1 (the covering radius alpha).
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._validate import Array, Ids, as_points, as_reals, positive, whole

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

__all__ = ["covering_radius", "farthest_point_sample", "hausdorff", "inliers", "spacing", "spoil"]

_MARGIN = 0.1  # metres around a cloud's box in which outliers of `spoil` lie


def farthest_point_sample(points: ArrayLike, n: int, start: int | None = 0) -> tuple[Ids, float]:
    """Choose `n` points, each the farthest from those chosen before it.

    Parameters
    ----------
    points : (m, d) array_like
    n : int
        Number of points to choose, 1 to m.
    start : int, optional
        Index of the first point. For None it is the point farthest from the mean, so the order of the points is irrelevant.

    Returns
    -------
    idx : (n,) int64
        Indices of the chosen points, in the order chosen. Ties go to the smaller index.
    radius : float
        The covering radius: every point is within this distance of a chosen one. It is at most twice the smallest
        possible radius (Gonzalez 1985).

    Raises
    ------
    ValueError
        When `n` or `start` is out of range, or `points` is no point cloud.

    Examples
    --------
    >>> farthest_point_sample([[0.0], [1.0], [2.0], [4.0]], 2)
    (array([0, 3]), 2.0)
    """
    array = _measurable(points, "points")
    if not len(array):
        raise ValueError("points is empty: there is nothing to choose from")
    n = whole(n, "n", 1, len(array))
    if start is None:
        from_mean = array - array.mean(axis=0)
        start = int(np.square(from_mean).sum(axis=1).argmax())
    following = whole(start, "start", -len(array), len(array) - 1) % len(array)

    # Idea: a new point changes only what is within the covering radius of it, at first all points, and soon few. With the
    # points sorted along the widest axis those are in a slice. The margin makes sure that rounding leaves none out.
    widest = np.ptp(array, axis=0).argmax()
    order = np.argsort(array[:, widest], kind="stable")
    axes = array[order].T.copy()
    along = axes[widest].tolist()
    squared = np.full(len(array), np.inf)  # distance of each point from the nearest of those chosen so far
    new = int(np.flatnonzero(order == following)[0])
    reach = math.inf
    chosen = []
    for _ in range(n):
        chosen.append(new)
        near = slice(bisect_left(along, along[new] - reach), bisect_right(along, along[new] + reach))
        steps = axes[:, near] - axes[:, new, None]
        steps *= steps
        from_new = steps[0]
        for more in steps[1:]:
            from_new += more
        nearby = squared[near]
        np.minimum(nearby, from_new, out=nearby)

        # The farthest point from all that are chosen comes next; among several, the one with the smallest index.
        new = int(squared.argmax())
        farthest = squared[new]
        reach = math.sqrt(farthest) * (1 + 1e-12)
        ties = (squared == farthest).nonzero()[0]
        if len(ties) > 1:
            new = int(ties[order[ties].argmin()])
    return order[chosen], math.sqrt(farthest)


def covering_radius(dense: ArrayLike, sample: ArrayLike | cKDTree) -> float:
    """Return the largest distance from a point of `dense` to its nearest point of `sample`: the paper's alpha.

    This is the directed Hausdorff distance, in the unit of the points.

    Parameters
    ----------
    dense, sample : (n, d), (m, d) array_like
        Point sets with at least one point each; `sample` may be a tree of its points.

    Raises
    ------
    ValueError
        When a set has no point, or the sets differ in dimension.

    Examples
    --------
    >>> covering_radius([[0.0], [1.0], [3.0]], [[0.0]])
    3.0
    """
    return _farthest(_measurable(dense, "dense"), as_tree(sample, "sample"), "dense", "sample")


def _farthest(points: Array, tree: cKDTree, name: str, name_of_tree: str) -> float:
    """Return the largest distance from a point to its nearest one of a tree; the names are for errors."""
    if len(points) == 0 or tree.n == 0:
        raise ValueError(f"{name} and {name_of_tree} need at least one point each")
    if points.shape[1] != tree.m:
        raise ValueError(f"{name} has {points.shape[1]} dimensions, {name_of_tree} {tree.m}")
    return float(tree.query(points)[0].max())


def hausdorff(a: ArrayLike | cKDTree, b: ArrayLike | cKDTree) -> float:
    """Return the Hausdorff distance between two finite point sets, in the unit of the points.

    For two edges this is the paper's distance between killer edges: each edge is the set of its two end points.

    Parameters
    ----------
    a, b : (n, d), (m, d) array_like
        Point sets with at least one point each, or trees of them.

    Raises
    ------
    ValueError
        When a set is empty or no point cloud, or their dimensions differ.

    Examples
    --------
    >>> hausdorff([[0.0, 0.0], [1.0, 0.0]], [[0.0, 0.0], [1.0, 2.0]])
    2.0
    """
    tree_a = as_tree(a, "a")
    tree_b = as_tree(b, "b")
    return max(_farthest(tree_a.data, tree_b, "a", "b"), _farthest(tree_b.data, tree_a, "b", "a"))


def hausdorff_table(a: Array, b: Array) -> Array:
    """Return the (m, k) Hausdorff distances between small sets of points, each of `a` and each of `b`.

    Parameters
    ----------
    a, b : (m, p, d), (k, q, d) float64
    """
    distances = np.linalg.norm(a[:, None, :, None] - b[None, :, None], axis=-1)  # (m, k, p, q)
    a_to_b = distances.min(axis=3).max(axis=2)
    b_to_a = distances.min(axis=2).max(axis=2)
    return np.asarray(np.maximum(a_to_b, b_to_a))


def inliers(points: ArrayLike | cKDTree, *, neighbours: int = 5, factor: float = 2.5) -> Ids:
    """Return the ids of the points that are not alone: statistical outlier removal.

    A point is left out when its `neighbours`-th nearest other place is farther than `factor` times the median of these
    distances. This is done twice, since outliers raise the median. Repeated points count as one place. On cloth, however it was
    sampled, the ratio was never above 2.1; of points strewn about it few are below the default.

    Parameters
    ----------
    points : (n, d) array_like
        Points, or a tree of them.
    neighbours : int
    factor : float

    Returns
    -------
    (k,) int64
        Ids of the points that are kept, in ascending order.

    Raises
    ------
    ValueError
        When `neighbours` or `factor` is not a positive number.

    Notes
    -----
    Rusu, Marton, Blodow, Dolha and Beetz 2008, *Towards 3D point cloud based object maps for household environments*.

    Examples
    --------
    >>> inliers([[x] for x in (0, 1, 2, 3, 4, 5, 6, 100)])
    array([0, 1, 2, 3, 4, 5, 6])
    """
    neighbours = whole(neighbours, "neighbours", 1)
    factor = positive(factor, "factor", zero=False)
    return inliers_and_tree(as_tree(points), neighbours, factor)[0]


def inliers_and_tree(tree: cKDTree, neighbours: int = 5, factor: float = 2.5) -> tuple[Ids, cKDTree, Array]:
    """Return what a tracker needs of the points that are not alone.

    Parameters
    ----------
    tree : cKDTree
        Tree of the points.
    neighbours : int
    factor : float

    Returns
    -------
    ids : (k,) int64
        Numbers of these points in the cloud.
    tree : cKDTree
        Tree of their p places; points that coincide are one place.
    nearest : (p, neighbours) float64
        Distances of each place from its nearest other places.
    """
    ids = np.arange(tree.n)
    copies = None
    if _repeats(tree):
        places, copies = np.unique(tree.data + 0.0, axis=0, return_inverse=True)  # -0.0 and 0.0 are one place
        tree = as_tree(places)
        ids = np.arange(len(places))

    # Each place is its own nearest one, so the query is for one more.
    nearest, neighbour_ids = tree.query(tree.data, k=min(neighbours + 1, max(tree.n, 2)))
    for _ in range(2):
        if tree.n <= neighbours:
            break
        near = nearest[:, -1] <= factor * np.median(nearest[:, -1])
        if near.all():
            break

        # Leave out isolated places. Only places that lose a neighbour by it need a new query.
        tree = as_tree(tree.data[near])
        ids = ids[near]
        k = min(neighbours + 1, max(near.sum(), 2))
        lost = ~near[neighbour_ids[near]].all(axis=1) | (k <= neighbours)
        renumbered = np.cumsum(near) - 1
        nearest = nearest[near, :k]
        neighbour_ids = renumbered[neighbour_ids[near, :k]]
        nearest[lost], neighbour_ids[lost] = tree.query(tree.data[lost], k=k)

    if copies is not None:
        ids = np.flatnonzero(np.isin(copies.ravel(), ids))
    return ids, tree, nearest[:, 1:]


def spacing(points: ArrayLike | cKDTree) -> float:
    """Return half the largest distance from a point to its nearest other one; repeated points count once.

    If every connected piece of the scene contains at least two of the points, the covering radius cannot be smaller. A tree is
    accepted, too.

    Raises
    ------
    ValueError
        When squares of distances overflow or vanish.

    Examples
    --------
    >>> spacing([[0.0], [1.0], [3.0], [3.0]])
    1.0
    """
    tree = as_tree(points)
    if _repeats(tree):
        tree = as_tree(np.unique(tree.data + 0.0, axis=0))  # -0.0 and 0.0 are one place
    if tree.n < 2:
        return 0.0
    widest = float(tree.query(tree.data, k=[2])[0].max())
    if widest == 0:
        raise ValueError(
            "points differ so little, compared with their size, that squares of their distances are 0: round them"
        )
    return widest / 2


def spoil(
    clouds: NDArray[np.floating],
    rng: np.random.Generator | int,
    *,
    noise: ArrayLike = 0.0,
    outliers: ArrayLike = 0.0,
    keep: ArrayLike = 1.0,
) -> Array:
    """Return clouds (..., P, 3) float64 with missing points, noise and outliers, drawn for every cloud separately.

    Parameters
    ----------
    clouds : (..., P, 3) array
    rng : numpy.random.Generator or int
        A generator or the seed of one.
    noise : float or array that broadcasts to the leading axes of `clouds`
        Standard deviation of each coordinate, metres.
    outliers : float or such an array
        Share of the points that are anywhere in the cloud's box, which is grown by 10 cm on each side.
    keep : float or such an array
        Share of the points that are kept, at least one. They come first, in the order in which they were; repeats of them, in
        their order, replace the others. Both shares are rounded to whole points.

    Raises
    ------
    ValueError
        When a coordinate is not finite, a share is not from 0 to 1, or the noise is negative.
    """
    rng = np.random.default_rng(rng)
    clouds = as_reals(clouds, "clouds").astype(np.float64)
    if clouds.ndim < 2 or not np.isfinite(clouds).all():
        raise ValueError(f"clouds must be finite and of shape (..., P, 3); theirs is {clouds.shape}")
    for name, values, most in (("noise", noise, np.inf), ("outliers", outliers, 1.0), ("keep", keep, 1.0)):
        numbers = as_reals(values, name)
        if not ((numbers >= 0) & (numbers <= most) & np.isfinite(numbers)).all():
            bound = "0 or more" if most == np.inf else "from 0 to 1"
            raise ValueError(f"{name} must be finite and {bound}, not {np.asarray(values).tolist()!s:.80}")
    n_points = clouds.shape[-2]
    noise, outliers, keep = [np.broadcast_to(one, clouds.shape[:-2])[..., None] for one in (noise, outliers, keep)]
    places = np.broadcast_to(np.arange(n_points), clouds.shape[:-1])

    # Points that are kept come first, in their order; then they are repeated.
    n_kept = np.maximum(np.round(keep * n_points), 1).astype(np.int64)
    is_lost = rng.permuted(places, axis=-1) >= n_kept
    order = np.argsort(is_lost, axis=-1, kind="stable")
    kept = np.take_along_axis(order, places % n_kept, axis=-1)
    spoilt = np.take_along_axis(clouds, kept[..., None], axis=-2) + noise[..., None] * rng.standard_normal(clouds.shape)

    # Outliers lie anywhere in the box around the cloud.
    low = clouds.min(axis=-2, keepdims=True) - _MARGIN
    high = clouds.max(axis=-2, keepdims=True) + _MARGIN
    is_outlier = rng.permuted(places, axis=-1) < np.round(outliers * n_points)
    return np.where(is_outlier[..., None], rng.uniform(low, high, clouds.shape), spoilt)


def _repeats(tree: cKDTree) -> bool:
    """Return whether some points may be repeated.

    One number a point, a sum of its coordinates, is compared. Irrational weights keep different points apart: plain sums of
    coordinates in whole millimetres would often be equal.
    """
    keys = sum(np.sqrt(k + 2) * axis for k, axis in enumerate(tree.data.T))
    return len(np.unique(keys)) < tree.n


def as_tree(points: ArrayLike | cKDTree, name: str = "points", *, copy: bool = False) -> cKDTree:
    """Return a tree of checked points: built once, it serves several distances. A tree is returned as it is.

    Parameters
    ----------
    points : (n, d) array_like
        Points, or a tree of them.
    name : str
        Name of the points in error messages.
    copy : bool
        Keep a copy of the points in the tree.
    """
    from scipy.spatial import cKDTree  # here, because importing topokit must be quick

    if isinstance(points, cKDTree):
        return points
    return cKDTree(_measurable(points, name), copy_data=copy)


def _measurable(points: ArrayLike, name: str) -> Array:
    """Return checked points whose distances have squares that neither overflow nor vanish."""
    array = as_points(points, name)
    largest = np.abs(array).max(initial=0.0)
    if largest > 1e150 or 0 < largest < 1e-150:
        reason = "floating point cannot hold the squares of distances between them; convert them to another unit"
        raise ValueError(f"{name} has coordinates of up to {largest:.3g}: {reason}")
    return array
