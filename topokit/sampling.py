"""Farthest-point subsamples, covering radii, Hausdorff distances and outliers.

Source: Gonzalez 1985 (farthest-point traversal); Antonova et al. 2021, Assumption 1 (the covering radius alpha).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ._validate import Array, Ids, as_points, positive, whole

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

__all__ = ["covering_radius", "farthest_point_sample", "hausdorff", "inliers", "spacing"]


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

    Examples
    --------
    >>> farthest_point_sample([[0.0], [1.0], [2.0], [4.0]], 2)
    (array([0, 3]), 2.0)
    """
    array = as_points(points)
    if not len(array):
        raise ValueError("points is empty: there is nothing to choose from")
    n = whole(n, "n", 1, len(array))
    if start is None:
        from_mean = array - array.mean(axis=0)
        start = int(np.square(from_mean).sum(axis=1).argmax())
    newest = whole(start, "start", -len(array), len(array) - 1) % len(array)

    # The squared distance of each point from the nearest of those chosen so far; the farthest point is chosen next.
    axes = np.ascontiguousarray(array.T)
    squared = np.full(len(array), np.inf)
    chosen = []
    for _ in range(n):
        chosen.append(newest)
        from_newest = np.square(axes - axes[:, newest, None]).sum(axis=0)
        np.minimum(squared, from_newest, out=squared)
        newest = int(squared.argmax())
    return np.array(chosen, dtype=np.int64), float(np.sqrt(squared[newest]))


def covering_radius(dense: ArrayLike, sample: ArrayLike) -> float:
    """Return the largest distance from a point of `dense` to its nearest point of `sample`: the paper's alpha, in their unit.

    Parameters
    ----------
    dense, sample : (n, d), (m, d) array_like
        Point sets with at least one point each.

    Examples
    --------
    >>> covering_radius([[0.0], [1.0], [3.0]], [[0.0]])
    3.0
    """
    return _farthest(as_points(dense, "dense"), as_tree(sample, "sample"), "dense", "sample")


def _farthest(points: Array, tree: cKDTree, name: str, name_of_tree: str) -> float:
    """Return the largest distance from a point to its nearest one of a tree; the names are for errors."""
    if len(points) == 0 or tree.n == 0:
        raise ValueError(f"{name} and {name_of_tree} need at least one point each")
    return float(tree.query(points)[0].max())


def hausdorff(a: ArrayLike | cKDTree, b: ArrayLike | cKDTree) -> float:
    """Return the Hausdorff distance between two finite point sets, in the unit of the points.

    For two edges this is the paper's distance between killer edges: each edge is the set of its two end points.

    Parameters
    ----------
    a, b : (n, d), (m, d) array_like
        Point sets with at least one point each, or trees of them.

    Examples
    --------
    >>> hausdorff([[0.0, 0.0], [1.0, 0.0]], [[0.0, 0.0], [1.0, 2.0]])
    2.0
    """
    tree_a = as_tree(a, "a")
    tree_b = as_tree(b, "b")
    return max(_farthest(tree_a.data, tree_b, "a", "b"), _farthest(tree_b.data, tree_a, "b", "a"))


def hausdorff_table(a: Array, b: Array) -> Array:
    """Return the (m, k) Hausdorff distances between small sets of points, each of `a` (m, p, d) and each of `b` (k, q, d)."""
    distances = np.linalg.norm(a[:, None, :, None] - b[None, :, None], axis=-1)  # (m, k, p, q)
    a_to_b = distances.min(axis=3).max(axis=2)
    b_to_a = distances.min(axis=2).max(axis=2)
    return np.asarray(np.maximum(a_to_b, b_to_a))


def inliers(points: ArrayLike | cKDTree, *, factor: float = 2.5) -> Ids:
    """Return the ids (k,) of the points that are not alone, in ascending order: statistical outlier removal.

    A point is left out when its fifth nearest other place is farther than `factor` times the median of these distances. This is
    done twice, since outliers raise the median. Repeated points count as one place. On cloth, however it was sampled, the
    ratio was never above 2.1; of points strewn about it few are below the default.

    Source: Rusu et al. 2008, *Towards 3D point cloud based object maps for household environments*.

    Parameters
    ----------
    points : (n, d) array_like
        Points, or a tree of them.
    factor : float

    Examples
    --------
    >>> inliers([[x] for x in (0, 1, 2, 3, 4, 5, 6, 100)])
    array([0, 1, 2, 3, 4, 5, 6])
    """
    return inliers_and_tree(as_tree(points), positive(factor, "factor", zero=False))[0]


def inliers_and_tree(tree: cKDTree, factor: float = 2.5) -> tuple[Ids, cKDTree, Array]:
    """Return the ids (k,) of points that are not alone, the tree of their p places, and (p, 5) distances of nearest places."""
    tree, place_of_point = _places(tree)
    place_ids = np.arange(tree.n)
    nearest = _five_nearest(tree)
    for _ in range(2):
        fifth = nearest[:, -1]
        is_near = fifth <= factor * np.median(fifth)
        if tree.n <= 5 or is_near.all():
            break
        tree = as_tree(tree.data[is_near])
        place_ids = place_ids[is_near]
        nearest = _five_nearest(tree)
    return np.flatnonzero(np.isin(place_of_point, place_ids)), tree, nearest


def _five_nearest(tree: cKDTree) -> Array:
    """Return the distances (n, 5) of points from their nearest other ones, or to all others when there are fewer."""
    distances = tree.query(tree.data, k=min(6, max(tree.n, 2)))[0]
    return np.asarray(distances[:, 1:])  # each point is its own nearest one


def spacing(points: ArrayLike | cKDTree) -> float:
    """Return half the largest distance from a point to its nearest other one; repeated points count once.

    If every connected piece of the scene contains at least two of the points, the covering radius cannot be smaller. A tree is
    accepted, too.

    Examples
    --------
    >>> spacing([[0.0], [1.0], [3.0], [3.0]])
    1.0
    """
    tree, _ = _places(as_tree(points))
    if tree.n < 2:
        return 0.0
    return float(tree.query(tree.data, k=[2])[0].max()) / 2


def _places(tree: cKDTree) -> tuple[cKDTree, Ids]:
    """Return a tree of the different places of points, and the number of each point's place."""
    places, place_of_point = np.unique(tree.data + 0.0, axis=0, return_inverse=True)  # -0.0 and 0.0 are one place
    if len(places) == tree.n:
        return tree, np.arange(tree.n)
    return as_tree(places), place_of_point.ravel()


def as_tree(points: ArrayLike | cKDTree, name: str = "points", *, copy: bool = False) -> cKDTree:
    """Return a tree of checked points (n, d), built once for several distances; a tree is returned as it is."""
    from scipy.spatial import cKDTree  # here, because importing topokit must be quick

    if isinstance(points, cKDTree):
        return points
    return cKDTree(as_points(points, name), copy_data=copy)
