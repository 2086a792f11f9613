"""What the lemmas assume, measured: how far points move, how far from a killer its rivals lie, how far apart loops are.

Source: Antonova et al. 2021, Assumptions 2 and 3. Taught in chapters 4 and 5. (Assumption 1's alpha is `covering_radius`.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import cdist

from .._validate import as_points, positive
from ..rips import Diagram, rips_persistence
from ._critical import first_critical

__all__ = [
    "Beta",
    "beta_all",
    "beta_critical",
    "distortion",
    "edge_distances",
    "farthest_edges",
    "feature_separation",
    "killer_separation",
    "max_displacement",
]

Array = NDArray[np.float64]
ROUNDING = 1e-12  # relative to the longest edge; windows are wider by it


@dataclass(frozen=True, eq=False)
class Beta:
    """How far from a loop's killer edge the edges lie that could be taken for it.

    Attributes
    ----------
    value : (k,) float64
        For each of the k longest-lived loops of the diagram, the largest Hausdorff distance to a rival, in the unit of the
        points.
    edge : (k, 2) int64
        That rival; the killer itself when there is no other.
    """

    value: Array
    edge: NDArray[np.int64]

    @property
    def max(self) -> float:
        """The paper's beta, one number for all loops: 0.0 when there are none."""
        return float(self.value.max(initial=0.0))


def max_displacement(before: ArrayLike, after: ArrayLike) -> float:
    """Return the largest distance that a point moves: the paper's epsilon, in the unit of the points.

    Parameters
    ----------
    before, after : (n, d) array_like
        Row i of both is the same point.

    Examples
    --------
    >>> max_displacement([[0.0, 0.0], [1.0, 0.0]], [[0.0, 0.5], [1.0, 0.0]])
    0.5
    """
    a, b = same_points(before, after)
    return float(np.linalg.norm(b - a, axis=1).max(initial=0.0))


def distortion(before: ArrayLike, after: ArrayLike) -> float:
    """Return half the largest change of a distance between two points: what a motion does to the filtration.

    Never above `max_displacement`, and zero for a rigid motion, however fast. Wherever a statement needs epsilon for a change
    of filtration values this number does instead; only where it says how far an edge moves must epsilon stay.

    Parameters
    ----------
    before, after : (n, d) array_like
        Row i of both is the same point.

    Notes
    -----
    The correspondence between before and after has twice this distortion in the sense of Gromov and Hausdorff; that it bounds
    the bottleneck distance of Rips diagrams is the theorem of Chazal, de Silva and Oudot 2014.

    Examples
    --------
    >>> distortion([[0.0], [1.0]], [[5.0], [6.5]])
    0.25
    """
    a, b = same_points(before, after)
    return float(np.abs(cdist(b, b) - cdist(a, a)).max(initial=0.0)) / 2


def same_points(before: ArrayLike, after: ArrayLike) -> tuple[Array, Array]:
    """Both clouds, or ValueError when row i of both cannot be the same point."""
    a, b = as_points(before, "before"), as_points(after, "after")
    if a.shape != b.shape:
        raise ValueError(f"before has shape {a.shape}, after {b.shape}; row i of both must be the same point")
    return a, b


def beta_all(
    points: ArrayLike, alpha: float, *, min_lifetime: float | None = None, diagram: Diagram | None = None
) -> Beta:
    """Measure the beta of the paper's Assumption 3, over all edges.

    For every loop with a lifetime above `min_lifetime`: the largest Hausdorff distance from its killer edge to any edge whose
    filtration value is within `alpha` of the loop's death. Edges of about that length lie everywhere in a large object, so
    this is about as large as the object.

    Parameters
    ----------
    points : (n, d) array_like
        The dense state S_t.
    alpha : float
        How far from the death, in the unit of the points.
    min_lifetime : float, optional
        `alpha` when not given, as in the paper.
    diagram : Diagram, optional
        Of `points`, when it is known.

    Examples
    --------
    >>> square = [[0, 0], [1, 0], [1, 1], [0, 1]]
    >>> beta_all(square, 0.1).value  # the other diagonal
    array([1.])
    """
    array, alpha = as_points(points), positive(alpha, "alpha")
    diagram = rips_persistence(array) if diagram is None else diagram
    shortest = alpha if min_lifetime is None else positive(min_lifetime, "min_lifetime")
    return farthest_edges(cdist(array, array), diagram, shortest, (alpha, alpha))


def beta_critical(
    points: ArrayLike,
    alpha: float,
    epsilon: float = 0.0,
    *,
    nearest: bool = False,
    min_lifetime: float | None = None,
    diagram: Diagram | None = None,
) -> Beta:
    """Measure the beta of Assumption 3', over critical edges only.

    An edge e = {x, y} of length L is (alpha, epsilon)-critical in S when there are two points a, b of S other than x and y,
    both within L + 4 epsilon of x and of y, at least L - 4 epsilon apart, that no path in S joins through points nearer than
    L - alpha - 4 epsilon to x and to y, its first and last steps shorter than L - alpha - 4 epsilon and those between
    shorter than L - 2 alpha - 4 epsilon. Where such a path exists it survives the sampling and the motion, and holds
    the edge's lune together: an edge that is not critical cannot be seen as a killer. The assumption asks that the critical
    edges with half length in [death - 2 epsilon, death + alpha + 2 epsilon] lie within beta of the loop's killer.

    Parameters
    ----------
    points : (n, d) array_like
        The dense state S_t.
    alpha, epsilon : float
        Covering radius of the observations and largest displacement, in the unit of the points.
    nearest : bool
        Measure from a critical edge to the nearest killer of all loops, not to this loop's: where several loops die at about
        the same time each one's killer is a critical edge in the window of the others.
    min_lifetime : float, optional
        Loops with a lifetime above it are measured; ``alpha + 2 * epsilon`` when not given: what the corollary needs.
    diagram : Diagram, optional
        Of `points`, when it is known.

    Returns
    -------
    Beta
        Never above what all edges in the same window give.

    Notes
    -----
    The paper quantifies over all edges. This version is ours. Cost: rivals are tested from the farthest inwards, each with a
    number of operations that is quadratic in the points of its lens; of the order of 0.1 s a loop for 550 points.

    Examples
    --------
    >>> square = [[0, 0], [1, 0], [1, 1], [0, 1]]
    >>> beta_critical(square, 0.1).value
    array([1.])
    """
    array, alpha, epsilon = as_points(points), positive(alpha, "alpha"), positive(epsilon, "epsilon")
    diagram = rips_persistence(array) if diagram is None else diagram
    shortest = alpha + 2 * epsilon if min_lifetime is None else positive(min_lifetime, "min_lifetime")
    window = (2 * epsilon, alpha + 2 * epsilon)
    return farthest_edges(cdist(array, array), diagram, shortest, window, critical=(alpha, epsilon), nearest=nearest)


def farthest_edges(
    distances: Array,
    diagram: Diagram,
    min_lifetime: float,
    window: tuple[float, float],
    *,
    critical: tuple[float, float] | None = None,
    nearest: bool = False,
) -> Beta:
    """The edges, or the critical ones, farthest from the killers, of half length in [death - window[0], death + window[1]].

    The distance is to the loop's own killer, or to the nearest killer of all loops that are measured.
    """
    n_loops = int((diagram.lifetime > min_lifetime).sum())
    killers = diagram.killer_edge[:n_loops]
    value, edge = np.zeros(n_loops), killers.copy()
    if n_loops == 0:
        return Beta(value, edge)
    rounding = ROUNDING * float(distances.max())
    pairs = np.column_stack(np.triu_indices(len(distances), 1))
    half = distances[pairs[:, 0], pairs[:, 1]] / 2
    for i, death in enumerate(diagram.death[:n_loops]):
        rivals = pairs[(half >= death - window[0] - rounding) & (half <= death + window[1] + rounding)]
        away = np.min(
            [edge_distances(distances, rivals, k) for k in (killers if nearest else killers[i : i + 1])], axis=0
        )
        order = np.argsort(-away, kind="stable")  # farthest first
        place = 0 if critical is None else first_critical(distances, rivals[order], *critical)
        # The killer is a rival of itself, but a lune may hold together by rounding alone.
        if place >= 0 and len(rivals):
            value[i], edge[i] = away[order[place]], rivals[order[place]]
    return Beta(value, edge)


def edge_distances(distances: Array, edges: NDArray[np.int64], edge: NDArray[np.int64]) -> Array:
    """(m,) Hausdorff distances from each of (m, 2) edges to one, all edges of the cloud that `distances` (n, n) is of."""
    d = distances[edges[:, :, None], edge]  # (m, 2, 2)
    return np.asarray(np.maximum(d.min(axis=2).max(axis=1), d.min(axis=1).max(axis=1)))


def killer_separation(distances: Array, diagram: Diagram, min_lifetime: float) -> float:
    """The least Hausdorff distance between the killers of two loops with a lifetime above `min_lifetime`."""
    killers = diagram.killer_edge[diagram.lifetime > min_lifetime]
    pairs = (edge_distances(distances, killers[:i], killers[i]).min() for i in range(1, len(killers)))
    return float(min(pairs, default=np.inf))


def feature_separation(points: ArrayLike, min_lifetime: float = 0.0) -> float:
    """Return the least Hausdorff distance between the killer edges of two loops: inf when there are fewer than two.

    Parameters
    ----------
    points : (n, d) array_like
        The dense state S_t.
    min_lifetime : float
        Only loops with a lifetime above it.

    Examples
    --------
    >>> square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    >>> feature_separation(np.vstack([square, square + [5, 0]]), min_lifetime=0.1)
    5.0
    """
    array = as_points(points)
    return killer_separation(cdist(array, array), rips_persistence(array), positive(min_lifetime, "min_lifetime"))
