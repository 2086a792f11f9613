"""Farthest-point subsamples, covering radii and Hausdorff distances.

Source: Gonzalez 1985 (farthest-point traversal); Antonova et al. 2021, Assumption 1 (the covering radius alpha).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._validate import as_points, positive, whole

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

__all__ = ["covering_radius", "farthest_point_sample", "hausdorff", "inliers", "spacing", "spoil"]

_MARGIN = 0.1  # metres around a cloud's box in which outliers of `spoil` lie


def farthest_point_sample(points: ArrayLike, n: int, start: int | None = 0) -> tuple[NDArray[np.int64], float]:
    """Choose `n` points, each the farthest from those chosen before it.

    Parameters
    ----------
    points : (m, d) array_like
    n : int
        How many to choose, 1 to m.
    start : int, optional
        The first one. For None it is the point farthest from the mean of all, so that their order has no say.

    Returns
    -------
    idx : (n,) int64
        In the order chosen; ties go to the smaller index.
    radius : float
        The covering radius: every point is within this distance of a chosen one. At most twice the best possible
        (Gonzalez 1985).

    Raises
    ------
    ValueError
        When `n` or `start` is out of range, or `points` is no point cloud.

    Examples
    --------
    >>> farthest_point_sample([[0.0], [1.0], [2.0], [4.0]], 2)
    (array([0, 3]), 2.0)
    """
    from ._traversal import traverse

    array = _measurable(points, "points")
    n = whole(n, "n", 1, len(array))
    if start is None:
        start = int(np.square(array - array.mean(axis=0)).sum(axis=1).argmax())
    start = whole(start, "start", -len(array), len(array) - 1)
    axes = np.pad(array, ((0, 0), (0, -array.shape[1] % 3))).T.copy()
    nearest, idx = np.full(len(array), np.inf), np.empty(n, dtype=np.int64)
    for some in np.array_split(idx, 1 + n // 100):  # in between Ctrl-C is heard
        start = traverse(axes, nearest, some, start % len(array))
    return idx, float(np.sqrt(nearest.max()))


def covering_radius(dense: ArrayLike, sample: ArrayLike | cKDTree) -> float:
    """Return the largest distance from a point of `dense` to its nearest point of `sample`: the paper's alpha.

    This is the directed Hausdorff distance, in the unit of the points.

    Parameters
    ----------
    dense, sample : (n, d), (m, d) array_like
        One point each at least; `sample` may be a tree of its points.

    Raises
    ------
    ValueError
        When one of them has no point, or they differ in their dimension.

    Examples
    --------
    >>> covering_radius([[0.0], [1.0], [3.0]], [[0.0]])
    3.0
    """
    everything, some = _measurable(dense, "dense"), as_tree(sample, "sample")
    if len(everything) == 0 or some.n == 0:
        raise ValueError("dense and sample need at least one point each")
    if everything.shape[1] != some.m:
        raise ValueError(f"dense has {everything.shape[1]} dimensions, sample {some.m}")
    return float(some.query(everything)[0].max())


def hausdorff(a: ArrayLike | cKDTree, b: ArrayLike | cKDTree) -> float:
    """Return the Hausdorff distance between two finite point sets, in the unit of the points.

    For two edges this is the paper's distance between killer edges: each taken as the set of its two end points.

    Parameters
    ----------
    a, b : (n, d), (m, d) array_like
        One point each at least, or trees of them.

    Examples
    --------
    >>> hausdorff([[0.0, 0.0], [1.0, 0.0]], [[0.0, 0.0], [1.0, 2.0]])
    2.0
    """
    one, other = as_tree(a, "a"), as_tree(b, "b")
    return max(covering_radius(one.data, other), covering_radius(other.data, one))


def hausdorff_table(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (m, k) Hausdorff distances between small sets of points, each of `a` and each of `b`.

    Parameters
    ----------
    a, b : (m, p, d), (k, q, d) float64
    """
    apart = np.linalg.norm(a[:, None, :, None] - b[None, :, None], axis=-1)  # (m, k, p, q)
    return np.asarray(np.maximum(apart.min(axis=3).max(axis=2), apart.min(axis=2).max(axis=2)))


def inliers(points: ArrayLike | cKDTree, *, neighbours: int = 5, factor: float = 2.5) -> NDArray[np.int64]:
    """Return the ids of the points that are not alone: statistical outlier removal.

    A point is left out when its `neighbours`-th nearest other place is farther than `factor` times what that is in the median;
    twice, since outliers raise the median. Repeated points count as one place. On cloth, however it was sampled, no point is
    farther than 2.1 times; of points strewn about it few are nearer.

    Parameters
    ----------
    points : (n, d) array_like
        Or a tree of them.
    neighbours : int
    factor : float

    Returns
    -------
    (k,) int64
        In their order.

    Raises
    ------
    ValueError
        When `neighbours` or `factor` is no positive number.

    Notes
    -----
    Rusu, Marton, Blodow, Dolha and Beetz 2008, *Towards 3D point cloud based object maps for household environments*.

    Examples
    --------
    >>> inliers([[x] for x in (0, 1, 2, 3, 4, 5, 6, 100)])
    array([0, 1, 2, 3, 4, 5, 6])
    """
    neighbours, factor = whole(neighbours, "neighbours", 1), positive(factor, "factor", zero=False)
    return inliers_and_tree(as_tree(points), neighbours, factor)[0]


def inliers_and_tree(
    tree: cKDTree, neighbours: int = 5, factor: float = 2.5
) -> tuple[NDArray[np.int64], cKDTree, NDArray[np.float64]]:
    """Ids of the points that are not alone, a tree of their places, and (p, k) how far each is from its nearest other ones."""
    ids, copies = np.arange(tree.n), None
    if _repeats(tree):
        places, copies = np.unique(tree.data + 0.0, axis=0, return_inverse=True)  # -0.0 and 0.0 are one place
        tree, ids = as_tree(places), np.arange(len(places))
    nearest, who = tree.query(tree.data, k=min(neighbours + 1, max(tree.n, 2)))
    for _ in range(2):
        near = nearest[:, -1] <= factor * np.median(nearest[:, -1]) if tree.n > neighbours else np.ones(tree.n, bool)
        if near.all():
            break
        tree, ids, k = as_tree(tree.data[near]), ids[near], min(neighbours + 1, max(near.sum(), 2))
        lost = ~near[who[near]].all(axis=1) | (k <= neighbours)  # the others have the neighbours that they had
        nearest, who = nearest[near, :k], (np.cumsum(near) - 1)[who[near, :k]]
        nearest[lost], who[lost] = tree.query(tree.data[lost], k=k)
    if copies is not None:
        ids = np.flatnonzero(np.isin(copies.ravel(), ids))
    return ids, tree, nearest[:, 1:]


def spacing(points: ArrayLike | cKDTree) -> float:
    """Return half the largest distance from a point to its nearest other one; repeated points count once.

    No smaller covering radius is possible if every connected piece of the scene holds two of them. A tree will do.

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
    apart = float(tree.query(tree.data, k=[2])[0].max())
    if apart == 0:
        raise ValueError("points differ so little beside their size that squares of their distances are 0: round them")
    return apart / 2


def spoil(
    clouds: NDArray[np.floating],
    rng: np.random.Generator,
    *,
    noise: ArrayLike = 0.0,
    outliers: ArrayLike = 0.0,
    keep: ArrayLike = 1.0,
) -> NDArray[np.float64]:
    """Return clouds with points missing, noise and outliers, every cloud for itself.

    Parameters
    ----------
    clouds : (..., P, 3) array
    rng : numpy.random.Generator
    noise : float or array that broadcasts to the leading axes of `clouds`
        Standard deviation of each coordinate, metres.
    outliers : float or such an array
        Share of the points that are anywhere in the cloud's box, which is grown by 10 cm on each side.
    keep : float or such an array
        Share of the points that are kept, at least one. They come first, in the order in which they were; repeats of them, in
        their order, stand for the others.
    """
    clouds = np.asarray(clouds, dtype=np.float64)
    noise, outliers, keep = [np.broadcast_to(one, clouds.shape[:-2])[..., None] for one in (noise, outliers, keep)]
    places = np.broadcast_to(np.arange(clouds.shape[-2]), clouds.shape[:-1])
    left = np.maximum(np.round(keep * clouds.shape[-2]), 1).astype(np.int64)
    order = np.argsort(rng.permuted(places, axis=-1) >= left, axis=-1, kind="stable")  # kept ones first, as they were
    kept = np.take_along_axis(order, places % left, axis=-1)
    spoilt = np.take_along_axis(clouds, kept[..., None], axis=-2) + noise[..., None] * rng.standard_normal(clouds.shape)
    low, high = clouds.min(axis=-2, keepdims=True) - _MARGIN, clouds.max(axis=-2, keepdims=True) + _MARGIN
    wild = rng.permuted(places, axis=-1) < np.round(outliers * clouds.shape[-2])
    return np.where(wild[..., None], rng.uniform(low, high, clouds.shape), spoilt)


def _repeats(tree: cKDTree) -> bool:
    """Whether some points may be repeated. Plain sums of coordinates in whole millimetres would often be the same."""
    return len(np.unique(sum(np.sqrt(k + 2) * axis for k, axis in enumerate(tree.data.T)))) < tree.n


def as_tree(points: ArrayLike | cKDTree, name: str = "points", *, copy: bool = False) -> cKDTree:
    """A tree of checked points, or the one that is given: built once, it answers for several distances."""
    from scipy.spatial import cKDTree  # here, because importing topokit must be quick

    return points if isinstance(points, cKDTree) else cKDTree(_measurable(points, name), copy_data=copy)


def _measurable(points: ArrayLike, name: str) -> NDArray[np.float64]:
    """Checked points whose distances have squares that neither overflow nor vanish."""
    array = as_points(points, name)
    largest = np.abs(array).max(initial=0.0)
    if largest > 1e150 or 0 < largest < 1e-150:
        why = "floating point cannot hold the squares of distances between them; convert them to another unit"
        raise ValueError(f"{name} has coordinates of up to {largest:.3g}: {why}")
    return array
