"""Measure the assumptions of the lemmas on a state and its observation: alpha, distances of rivals from killers and
distances between loops.

Idea of a critical edge: the killer of a loop seen through samples is an edge whose lune falls apart there, see `beta_critical`.

Source: Antonova et al. 2021, Assumptions 1 and 3. Taught in chapters 3 and 5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist

from .._validate import Array, Ids, as_ids, as_points, positive
from ..rips import Diagram, rips_persistence
from ..sampling import covering_radius
from ._matching import DiagramMatching, match_diagrams

ROUNDING = 1e-12  # relative; rounding may only add rivals and make more edges critical


@dataclass(frozen=True, eq=False)
class Beta:
    """The distances from a loop's killer edge to the edges that could be taken for it."""

    value: Array  #: (k,) largest Hausdorff distance to a rival, for each of the k longest-lived loops
    edge: Ids  #: (k, 2) that rival; the killer itself when there is no other

    @property
    def max(self) -> float:
        """Return the paper's beta, one number for all loops: 0.0 when there are none."""
        return float(self.value.max(initial=0.0))


@dataclass(frozen=True, eq=False)
class State:
    """All points of the scene at one time, S, and the vertices of it that are observed, O."""

    points: Array
    ids: Ids

    @classmethod
    def of(cls, points: Array, observed: ArrayLike | None = None, name: str = "observed") -> State:
        """Return the state of points and of the observed ones, all when not given; the name of their ids is for errors."""
        everything = np.arange(len(points))
        return cls(points, everything if observed is None else np.unique(as_ids(observed, name, len(points))))

    @cached_property
    def diagram(self) -> Diagram:
        return rips_persistence(self.points)

    @cached_property
    def observed_diagram(self) -> Diagram:
        return rips_persistence(self.points[self.ids])

    @cached_property
    def alpha(self) -> float:
        return covering_radius(self.points, self.points[self.ids])

    @cached_property
    def matching(self) -> DiagramMatching:
        """Match the loops of S with those of O, one-sided."""
        return match_diagrams(self.diagram, self.observed_diagram, one_sided=True, tolerance=self.tolerance)

    @cached_property
    def tolerance(self) -> float:
        """Return the tolerance for rounding in a comparison: 1e-9 of the size of the cloud."""
        return 1e-9 * float(np.ptp(self.points, axis=0).max(initial=0.0))

    @cached_property
    def distances(self) -> Array:
        return np.asarray(cdist(self.points, self.points))

    def separation(self, min_lifetime: float) -> float:
        """Return the least distance between the killers of two loops with a lifetime above `min_lifetime`."""
        killers = self.diagram.killer_edge[self.diagram.lifetime > min_lifetime]
        pairs = (self.edge_distances(killers[:i], killers[i]).min() for i in range(1, len(killers)))
        return float(min(pairs, default=np.inf))

    def edge_distances(self, edges: Ids, edge: Ids) -> Array:
        """Return (m,) Hausdorff distances from each of (m, 2) edges to one."""
        between_ends = self.distances[edges[:, :, None], edge]  # (m, 2, 2)
        there = between_ends.min(axis=2).max(axis=1)
        back = between_ends.min(axis=1).max(axis=1)
        return np.asarray(np.maximum(there, back))

    def beta_critical(self, min_lifetime: float, alpha: float, epsilon: float, *, nearest: bool = False) -> Beta:
        """Measure the distances to rivals among critical edges, as `beta_critical` does."""
        return self.beta_all(min_lifetime, 2 * epsilon, alpha + 2 * epsilon, (alpha, epsilon), nearest)

    def beta_all(
        self, min_lifetime: float, below: float, above: float, critical: Sequence[float] = (), nearest: bool = False
    ) -> Beta:
        """Measure the distances to rivals: edges, all or the critical ones, of half length in [death - below, death + above]."""
        n_loops = int((self.diagram.lifetime > min_lifetime).sum())
        killers = self.diagram.killer_edge[:n_loops]
        value = np.zeros(n_loops)
        edge = killers.copy()
        if n_loops == 0:
            return Beta(value, edge)

        # All edges with their half lengths; for each loop those in its window are rivals.
        rounding = ROUNDING * float(self.distances.max())
        pairs = np.column_stack(np.triu_indices(len(self.distances), 1))
        half = self.distances[pairs[:, 0], pairs[:, 1]] / 2
        for i, death in enumerate(self.diagram.death[:n_loops]):
            rivals = pairs[(half >= death - below - rounding) & (half <= death + above + rounding)]
            measured = killers if nearest else killers[i : i + 1]
            away = np.min([self.edge_distances(rivals, killer) for killer in measured], axis=0)
            for j in np.argsort(-away, kind="stable"):  # farthest first
                x, y = rivals[j].tolist()
                # The killer is a rival of itself, but a lune may hold together by rounding alone.
                if not critical or is_critical(self.distances, x, y, *critical):
                    value[i] = away[j]
                    edge[i] = rivals[j]
                    break
        return Beta(value, edge)


def is_critical(distances: Array, x: int, y: int, alpha: float, epsilon: float) -> bool:
    """Return True if the edge {x, y} is (alpha, epsilon)-critical, as `beta_critical` defines it."""
    length = distances[x, y]
    # The bound for points that carry paths, and for a path's end steps.
    inner = (length - alpha - 4 * epsilon) * (1 - ROUNDING)
    step = (length - 2 * alpha - 4 * epsilon) * (1 - ROUNDING)
    outer = (length + 4 * epsilon) * (1 + ROUNDING)
    apart = (length - 4 * epsilon) * (1 - ROUNDING)

    # Points of the lens, of which two may be the ends of a path, and points that may carry one.
    farther = np.maximum(distances[x], distances[y])
    in_lens = farther <= outer
    in_lens[[x, y]] = False
    lens = np.flatnonzero(in_lens)
    carriers = np.flatnonzero(farther < inner)

    # Two points far apart must reach a component of carriers together, by an end step each.
    joined_by_none = np.tri(len(lens), k=-1, dtype=np.bool_) & (distances[np.ix_(lens, lens)] >= apart)
    if not joined_by_none.any():
        return False
    near = distances[np.ix_(lens, carriers)] < inner
    number, component = connected_components(csr_matrix(distances[np.ix_(carriers, carriers)] < step), directed=False)
    for k in range(number):
        reached = near[:, component == k].any(axis=1)
        joined_by_none[np.ix_(reached, reached)] = False
    return bool(joined_by_none.any())


def beta_all(points: ArrayLike, alpha: float, *, min_lifetime: float | None = None) -> Beta:
    """Measure the beta of the paper's Assumption 3, over all edges.

    For every loop with a lifetime above `min_lifetime`: the largest Hausdorff distance from its killer edge to any edge whose
    filtration value is within `alpha` of the loop's death. Edges of about that length lie everywhere in a large object, so
    this is about as large as the object.

    Parameters
    ----------
    points : (n, d) array_like
        The dense state S_t.
    alpha : float
        Largest distance of a rival's filtration value from the death, in the unit of the points.
    min_lifetime : float, optional
        Loops with a longer lifetime are measured; `alpha` when not given, as in the paper.
    """
    alpha = positive(alpha, "alpha")
    shortest = alpha if min_lifetime is None else positive(min_lifetime, "min_lifetime")
    return State.of(as_points(points)).beta_all(shortest, alpha, alpha)


def beta_critical(
    points: ArrayLike,
    alpha: float,
    epsilon: float = 0.0,
    *,
    nearest: bool = False,
    min_lifetime: float | None = None,
) -> Beta:
    """Measure the beta of Assumption 3', over critical edges only. It is our variant; the paper's beta is over all edges.

    An edge e = {x, y} of length L is (alpha, epsilon)-critical in S when there are two points a, b of S other than x and y,
    both within L + 4 epsilon of x and of y, at least L - 4 epsilon apart, that no path in S joins through points nearer than
    L - alpha - 4 epsilon to x and to y, its first and last steps shorter than L - alpha - 4 epsilon and those between
    shorter than L - 2 alpha - 4 epsilon. Where such a path exists it survives the sampling and the motion, and holds
    the edge's lune together: an edge that is not critical cannot be observed as a killer. The assumption asks that the critical
    edges with half length in [death - 2 epsilon, death + alpha + 2 epsilon] lie within beta of the loop's killer.

    Parameters
    ----------
    points : (n, d) array_like
        The dense state S_t.
    alpha, epsilon : float
        Covering radius of the observations and largest displacement, in the unit of the points.
    nearest : bool
        Measure to the nearest killer of all loops, not to this loop's: where several loops die at about the same time each
        one's killer is a critical edge in the window of the others.
    min_lifetime : float, optional
        Loops with a lifetime above it are measured; ``alpha + 2 * epsilon`` when not given: what the corollary needs.
    """
    alpha = positive(alpha, "alpha")
    epsilon = positive(epsilon, "epsilon")
    shortest = alpha + 2 * epsilon if min_lifetime is None else positive(min_lifetime, "min_lifetime")
    return State.of(as_points(points)).beta_critical(shortest, alpha, epsilon, nearest=nearest)
