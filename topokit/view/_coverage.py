"""The figure in which a scene is seen through some of its points: the covering radius, and the loops of both.

Idea: the page gets the scene and which of its points are observed. The reader hides points, draws others, drags them; both
diagrams and the matching that the observability lemma speaks about are computed anew. Taught in chapter 3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from topokit._validate import as_points
from topokit.view._frame import Framed, framed_page
from topokit.view._growth import MOST_POINTS
from topokit.view._palette import OKABE_ITO

__all__ = ["Coverage", "coverage"]


@dataclass(frozen=True, repr=False)
class Coverage(Framed):
    """A figure of a planar scene and its observed points; the last value of a notebook cell shows it.

    Attributes are those of `Framed`.
    """


def coverage(
    points: ArrayLike, observed: ArrayLike, *, height: int = 500, title: str = "click a point to hide or show it"
) -> Coverage:
    """Return an interactive figure of a planar scene of which some points are observed.

    Balls of the covering radius alpha stand around the observed points. In the diagram every loop of the scene that lives
    longer than alpha has a square of side alpha, in which it must be seen. The third part shows alpha against the number of
    points for farthest-point samples, with the lifetimes of the long-lived loops as dashed lines.

    Parameters
    ----------
    points : (n, 2) array_like
        The scene S, at most 60 points. Radii, births and deaths are in their unit.
    observed : (m,) array_like of int
        Which of them are observed at first, O.
    height : int
        Height of the frame in CSS pixels; a narrow page stacks the parts and takes more.
    title : str
        The caption in the corner of the figure.

    Raises
    ------
    TypeError, ValueError
        When `points` is no planar cloud of at most 60 points, or `observed` does not name one or more of them.

    Examples
    --------
    >>> coverage([[0, 0], [4, 0], [4, 3], [0, 3]], [0, 1, 2])
    Coverage('3 of 4 points observed', ... kB)
    """
    cloud = planar(points, "points")
    ids = np.unique(np.asarray(observed))
    if ids.ndim != 1 or not len(ids) or not np.issubdtype(ids.dtype, np.integer):
        raise TypeError(f"observed must be one or more ids of points, not {observed!r}")
    if ids[0] < 0 or ids[-1] >= len(cloud):
        raise ValueError(f"observed must name points from 0 to {len(cloud) - 1}, not {ids[0]} to {ids[-1]}")
    data = {
        "points": cloud.tolist(),
        "observed": ids.tolist(),
        "height": int(height),
        "title": title,
        "palette": list(OKABE_ITO),
    }
    page = framed_page("coverage", data, "rips.js", "match.js", "planar.js")
    return Coverage(page, height, f"{len(ids)} of {len(cloud)} points observed")


def planar(points: ArrayLike, name: str) -> np.ndarray:
    """A cloud of the plane that the script can follow while the reader drags, or ValueError."""
    cloud = as_points(points, name)
    if cloud.shape[1] != 2:
        raise ValueError(
            f"{name} must lie in the plane, not in {cloud.shape[1]} dimensions; choose two, as {name}[:, :2]"
        )
    if not 1 <= len(cloud) <= MOST_POINTS:
        raise ValueError(
            f"{name} must be 1 to {MOST_POINTS} points, not {len(cloud)}; see topokit.farthest_point_sample"
        )
    return cloud
