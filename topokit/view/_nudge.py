"""The figure in which one point moves by next to nothing and the killer edge leaps, without a kernel.

Idea: as in the growing complex the page gets the points, and `rips.js` computes their loops, here for every position of a
slider. A test holds the three places that it follows to topokit's. Taught in chapter 5.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from numpy.typing import ArrayLike

from topokit._validate import as_points
from topokit.view._frame import Framed, framed_page
from topokit.view._palette import OKABE_ITO

__all__ = ["Nudge", "nudge"]

_MOST_POINTS = 24  # the script computes 121 clouds at every change
_REACHES = (0.05, 1e-3, 1e-6, 1e-9)
_DIRECTIONS = ("outward", "along")


@dataclass(frozen=True, repr=False)
class Nudge(Framed):
    """A figure in which a slider moves one point of a planar cloud; the last value of a notebook cell shows it.

    Attributes are those of `Framed`.
    """


def nudge(
    points: ArrayLike | Mapping[str, ArrayLike],
    *,
    vertex: int = 0,
    direction: str = "outward",
    height: int = 480,
    title: str = "nudge a point, or drag one",
) -> Nudge:
    """Return an interactive figure of how far three places of the longest-lived loop move when one point does.

    The places are the killer edge (compared by Hausdorff distance), the barycentre of the thick killer triangle, and the
    centroid of the representative cycle, by length. A slider moves the point by at most a twentieth, a thousandth, a millionth
    or a billionth of a unit; charts beside the picture show the moves, and birth and death, over its whole range. Any point
    can be chosen and dragged; the page then computes everything anew.

    Parameters
    ----------
    points : (n, 2) array_like, or mapping of str to (n, 2) array_like
        At most 24 points, about a unit in size; or several such clouds by name, of which the reader chooses.
    vertex : int
        The point that is nudged until the reader chooses another.
    direction : {"outward", "along"}
        Where it is nudged at first: away from the middle of the cloud, or along the circle around that. The reader can change it.
    height : int
        Height of the frame in CSS pixels; a narrow page stacks the parts and takes more.
    title : str
        The caption in the corner of the figure.

    Raises
    ------
    TypeError, ValueError
        When a cloud is no planar cloud of 1 to 24 points, it has no such vertex, or the direction is none of the two.

    Examples
    --------
    >>> nudge([[0, 0], [4, 0], [4, 3], [0, 3]])
    Nudge('Loop of 4 points, nudged', ... kB)
    """
    clouds = dict(points) if isinstance(points, Mapping) else {"points": points}
    if not clouds:
        raise ValueError("points names no cloud; give at least one")
    shapes = {}
    for name, cloud in clouds.items():
        array = as_points(cloud, name)
        if array.shape[1] != 2:
            raise ValueError(f"{name} must lie in the plane, not in {array.shape[1]} dimensions; choose two")
        if not 1 <= len(array) <= _MOST_POINTS:
            raise ValueError(
                f"nudge shows 1 to {_MOST_POINTS} points, not {len(array)}; see topokit.farthest_point_sample"
            )
        if not 0 <= vertex < len(array):
            raise ValueError(f"{name} has no vertex {vertex}; its {len(array)} points are numbered from 0")
        shapes[str(name)] = array.tolist()  # every digit: ties must stay ties
    if direction not in _DIRECTIONS:
        raise ValueError(f"direction must be one of {_DIRECTIONS}, not {direction!r}")
    data = {
        "shapes": shapes,
        "vertex": int(vertex),
        "direction": direction,
        "reaches": list(_REACHES),
        "height": int(height),
        "title": title,
        "palette": list(OKABE_ITO),
    }
    many = " or ".join(str(len(cloud)) for cloud in shapes.values())
    return Nudge(
        framed_page("nudge", data, "rips.js", "planar.js", "places.js"), height, f"Loop of {many} points, nudged"
    )
