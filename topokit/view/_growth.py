"""The figure in which a Rips complex grows: balls, edges, triangles, loops that are born and die, without a kernel.

Idea: the page gets the points and nothing else. `rips.js` computes their loops, by the same lunes as `topokit.rips`, in
a few milliseconds; so the reader can drag a point and see what changes. A test holds its answers to topokit's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from topokit._validate import as_points, positive
from topokit.view._frame import Framed, framed_page
from topokit.view._palette import OKABE_ITO

__all__ = ["MOST_POINTS", "Growth", "growth"]

MOST_POINTS = 60  # as many as the script can follow while a point is dragged


@dataclass(frozen=True, repr=False)
class Growth(Framed):
    """A figure in which the Rips complex of a planar cloud grows; the last value of a notebook cell shows it.

    Attributes are those of `Framed`.
    """


def growth(
    points: ArrayLike,
    *,
    height: int = 500,
    start: float | None = None,
    max_radius: float | None = None,
    balls: bool = True,
    title: str = "drag a point",
) -> Growth:
    """Return an interactive figure of the Rips complex of a planar cloud as the radius grows, and of its loops.

    Beside the complex stand its diagram, where a loop is a circle while it lives and a dot once it is dead, and its bars.
    The tightest cycle of a living loop, its killer edge and its killer triangles have one colour. Points can be dragged;
    the page then computes their loops anew.

    Parameters
    ----------
    points : (n, 2) array_like
        At most 60 points. Radii, births and deaths are in their unit, and half the length of an edge.
    height : int
        Height of the frame in CSS pixels; a narrow page stacks the parts and takes more.
    start : float, optional
        The radius shown before anyone touches the figure; in the middle of the longest life by default.
    max_radius : float, optional
        Where the slider ends; a little after the last death by default.
    balls : bool
        Whether the balls are drawn from the start; the reader can turn them off and on.
    title : str
        The caption in the corner of the figure.

    Raises
    ------
    TypeError, ValueError
        When `points` is no planar cloud of at most 60 points, or a radius is not a positive number.

    Examples
    --------
    >>> growth([[0, 0], [4, 0], [4, 3], [0, 3]], start=2)
    Growth('Rips complex of 4 points', ... kB)
    """
    cloud = as_points(points)
    if cloud.shape[1] != 2:
        raise ValueError(
            f"points must lie in the plane, not in {cloud.shape[1]} dimensions; choose two, as points[:, :2]"
        )
    if not 1 <= len(cloud) <= MOST_POINTS:
        raise ValueError(f"growth shows 1 to {MOST_POINTS} points, not {len(cloud)}; see topokit.farthest_point_sample")
    first = None if start is None else positive(start, "start")
    last = None if max_radius is None else positive(max_radius, "max_radius", zero=False)
    if first is not None and last is not None and first > last:
        raise ValueError(f"start must be at most max_radius, {last}, not {first}")
    data: dict[str, Any] = {
        "points": cloud.tolist(),  # every digit: ties must stay ties
        "start": first,
        "end": last,
        "balls": bool(balls),
        "height": int(height),
        "title": title,
        "palette": list(OKABE_ITO),
    }
    return Growth(framed_page("growth", data, "rips.js"), height, f"Rips complex of {len(cloud)} points")
