"""How far what locates a loop jumps between two clouds: the killer edge, the killer triangle, its barycentre, a tight cycle.

Taught in chapter 5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._curves import curve_centroid
from .._validate import as_points, positive
from ..rips import Diagram, rips_persistence
from ..sampling import hausdorff
from ._matching import match_diagrams

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Jump:
    """How far the places of one loop lie apart in two clouds, in the unit of the points.

    Attributes
    ----------
    loop, image : int
        Indices in the two diagrams.
    lifetime : float
        In the first.
    length : float
        Of the killer edge in the first, twice the death: what the distances are large or small against.
    edge, triangle : float
        Hausdorff distance of the killer edges' end points, of the thick killer triangles' vertices.
    barycentre : float
        Distance of the thick killer triangles' barycentres.
    cycle : float
        Distance of the centroids of tight cycles at birth.
    """

    loop: int
    image: int
    lifetime: float
    length: float
    edge: float
    triangle: float
    barycentre: float
    cycle: float


def killer_jumps(before: ArrayLike, after: ArrayLike, min_lifetime: float = 0.0) -> list[Jump]:
    """Measure how stable the places of loops are between two clouds.

    Parameters
    ----------
    before, after : (n, d) and (m, d) array_like
        Two clouds of one object: a moment later, or sampled again. They need not have the same points.
    min_lifetime : float
        Only loops of `before` with a lifetime above it.

    Returns
    -------
    list of Jump
        Longest lifetime first; loops that an optimal bottleneck matching leaves alone are not in it.

    Examples
    --------
    A motion of 1e-9 and the other diagonal of the square is the killer; the triangle's barycentre jumps a third as far, the
    cycle stays.

    >>> square = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
    >>> jump = killer_jumps(square, square + [[1e-9, 0], [0, 0], [0, 0], [0, 0]])[0]
    >>> round(jump.edge, 3), round(jump.barycentre, 3), round(jump.cycle, 3)
    (1.414, 0.471, 0.0)
    """
    clouds = as_points(before, "before"), as_points(after, "after")
    first, second = (rips_persistence(cloud) for cloud in clouds)
    partner = match_diagrams(first, second).partner
    kept = (first.lifetime > positive(min_lifetime, "min_lifetime")) & (partner >= 0)
    return [_jump(*clouds, first, second, i, int(partner[i])) for i in np.flatnonzero(kept).tolist()]


def _jump(a: Array, b: Array, first: Diagram, second: Diagram, i: int, j: int) -> Jump:
    thick, later = a[first.killer_triangles[i, 0]], b[second.killer_triangles[j, 0]]
    centroids = curve_centroid(a[first.cycle(i)]), curve_centroid(b[second.cycle(j)])
    return Jump(
        loop=i,
        image=j,
        lifetime=float(first.lifetime[i]),
        length=2 * float(first.death[i]),
        edge=hausdorff(a[first.killer_edge[i]], b[second.killer_edge[j]]),
        triangle=hausdorff(thick, later),
        barycentre=float(np.linalg.norm(thick.mean(axis=0) - later.mean(axis=0))),
        cycle=float(np.linalg.norm(centroids[0] - centroids[1])),
    )
