"""A state with its observation, and two of them in succession: what the statements are about, computed once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from .._validate import as_points
from ..rips import Diagram, rips_persistence
from ..sampling import covering_radius
from ._matching import Matching, match_diagrams
from ._measures import Beta, distortion, edge_distances, farthest_edges, max_displacement, same_points

__all__ = ["Motion", "State", "View", "vertex_ids"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class State:
    """All points of the scene at one time."""

    points: Array

    @cached_property
    def diagram(self) -> Diagram:
        return rips_persistence(self.points)

    @cached_property
    def distances(self) -> Array:
        return np.asarray(cdist(self.points, self.points))

    @cached_property
    def tolerance(self) -> float:
        """What rounding may do to a comparison: 1e-9 of the size of the cloud."""
        return 1e-9 * float(np.ptp(self.points, axis=0).max(initial=0.0))

    def beta_all(self, min_lifetime: float, below: float, above: float) -> Beta:
        """Rivals among all edges of half length in [death - below, death + above]."""
        return farthest_edges(self.distances, self.diagram, min_lifetime, (below, above))

    def beta_critical(self, min_lifetime: float, alpha: float, epsilon: float, *, nearest: bool = False) -> Beta:
        """Rivals among critical edges, as `beta_critical`."""
        window, critical = (2 * epsilon, alpha + 2 * epsilon), (alpha, epsilon)
        return farthest_edges(self.distances, self.diagram, min_lifetime, window, critical=critical, nearest=nearest)

    def separation(self, min_lifetime: float) -> float:
        """As `feature_separation`."""
        killers = self.diagram.killer_edge[self.diagram.lifetime > min_lifetime]
        pairs = (edge_distances(self.distances, killers[:i], killers[i]).min() for i in range(1, len(killers)))
        return float(min(pairs, default=np.inf))


@dataclass(frozen=True, eq=False)
class View:
    """A state S and the vertices O of it that are observed."""

    state: State
    ids: NDArray[np.int64]

    @cached_property
    def diagram(self) -> Diagram:
        """Of what is observed."""
        return rips_persistence(self.state.points[self.ids])

    @cached_property
    def alpha(self) -> float:
        return covering_radius(self.state.points, self.state.points[self.ids])

    @cached_property
    def matching(self) -> Matching:
        """Of the loops of S to those of O, one-sided."""
        return match_diagrams(self.state.diagram, self.diagram, one_sided=True, tolerance=self.state.tolerance)

    def killer(self, loop: int) -> NDArray[np.int64]:
        """Vertex ids, in the state, of the killer edge of a loop that is observed."""
        return self.ids[self.diagram.killer_edge[loop]]


@dataclass(frozen=True, eq=False)
class Motion:
    """A state and the same points a moment later."""

    before: State
    after: State

    @cached_property
    def epsilon(self) -> float:
        return max_displacement(self.before.points, self.after.points)

    @cached_property
    def distortion(self) -> float:
        return distortion(self.before.points, self.after.points)

    @cached_property
    def matching(self) -> Matching:
        return match_diagrams(self.before.diagram, self.after.diagram)

    @property
    def tolerance(self) -> float:
        return max(self.before.tolerance, self.after.tolerance)


def as_view(state: ArrayLike, observed: ArrayLike, name: str = "state") -> View:
    """A state with what is observed of it, checked."""
    points = as_points(state, name)
    if len(points) == 0:
        raise ValueError(f"{name} has no points")
    return View(State(points), vertex_ids(points, observed, f"what is observed of {name}"))


def as_motion(before: ArrayLike, after: ArrayLike) -> Motion:
    a, b = same_points(before, after)
    return Motion(State(a), State(b))


def vertex_ids(
    points: ArrayLike, observed: ArrayLike, name: str = "observed", tolerance: float = 1e-4
) -> NDArray[np.int64]:
    """Return which vertices of a state are observed, each once, ascending.

    Parameters
    ----------
    points : (n, d) array_like
        The dense state.
    observed : (m,) array_like of int, or (m, d) array_like
        Vertex ids, or coordinates of vertices.
    name : str
        What messages call it.
    tolerance : float
        How far a coordinate may be from its vertex, in the unit of the points: episodes are stored with 16 bits.

    Raises
    ------
    TypeError, ValueError
        When nothing is observed, an id is out of range, or an observed point is no vertex: the statements are about subsets
        of the state.

    Examples
    --------
    >>> vertex_ids([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]], [[2.0, 0.0], [0.0, 0.0]])
    array([0, 2])
    """
    state = as_points(points)
    ids = np.asarray(observed)
    if ids.ndim == 1 and ids.size:
        if not np.issubdtype(ids.dtype, np.integer):
            raise TypeError(f"{name} must be vertex ids (integers) or an (m, d) array of points, not {ids.dtype}")
        if ids.min() < 0 or ids.max() >= len(state):
            wrong = int(ids.min() if ids.min() < 0 else ids.max())
            raise ValueError(f"{name} names vertex {wrong}; the state has {len(state)}, numbered from 0")
        return np.unique(ids).astype(np.int64)
    if ids.size == 0:
        raise ValueError(f"{name} is empty; a state without a single observed point has no covering radius")
    cloud = as_points(observed, name)
    if cloud.shape[1] != state.shape[1]:
        raise ValueError(f"{name} has {cloud.shape[1]} dimensions, the state {state.shape[1]}")
    distance, nearest = cKDTree(state).query(cloud)
    if distance.max() > tolerance:
        far = int(np.argmax(distance))
        raise ValueError(
            f"{name} must be vertices of the state: point {far} is {distance[far]:.3g} from the nearest one; "
            "what cameras see is on the surface between vertices, take a subsample of the vertices instead"
        )
    return np.unique(nearest).astype(np.int64)
