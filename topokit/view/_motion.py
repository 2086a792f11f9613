"""The figure in which points move within small discs: the loops before and after, without a kernel.

Idea: the page gets the points, the radius of the discs, and perhaps where a prepared motion takes them. The reader drags them
and sees what stability promises, and what it does not. Taught in chapter 4.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from topokit._validate import positive
from topokit.view._coverage import planar
from topokit.view._frame import Framed, framed_page
from topokit.view._palette import OKABE_ITO

__all__ = ["Motion", "motion"]


@dataclass(frozen=True, repr=False)
class Motion(Framed):
    """A figure of planar points that move a little; the last value of a notebook cell shows it.

    Attributes are those of `Framed`.
    """


def motion(
    points: ArrayLike,
    epsilon: float,
    after: ArrayLike | None = None,
    *,
    height: int = 440,
    title: str = "drag the points within their discs",
) -> Motion:
    """Return an interactive figure of a planar cloud whose points can be dragged, each within `epsilon` of where it was.

    Dragging beside all points moves them together. The diagram shows every loop before, with the square of side 2 epsilon
    around it, and after; the dashed lines are lifetimes of epsilon and of 2 epsilon.

    Parameters
    ----------
    points : (n, 2) array_like
        At most 60 points, where they are before the motion.
    epsilon : float
        Radius of the discs at first; the reader can change it up to its double.
    after : (n, 2) array_like, optional
        Where the play button takes them, as far as the discs allow; without it there is no such button.
    height : int
        Height of the frame in CSS pixels; a narrow page stacks the parts and takes more.
    title : str
        The caption in the corner of the figure.

    Raises
    ------
    TypeError, ValueError
        When `points` is no planar cloud of at most 60 points, `after` differs in shape, or `epsilon` is not positive.

    Examples
    --------
    >>> motion([[0, 0], [4, 0], [4, 3], [0, 3]], 0.3)
    Motion('4 points, each within 0.3 of its place', ... kB)
    """
    cloud, radius = planar(points, "points"), positive(epsilon, "epsilon", zero=False)
    target = None if after is None else planar(after, "after")
    if target is not None and target.shape != cloud.shape:
        raise ValueError(f"after must have a row for each of the {len(cloud)} points, not {len(target)}")
    data: dict[str, Any] = {
        "points": cloud.tolist(),
        "after": None if target is None else target.tolist(),
        "epsilon": radius,
        "height": int(height),
        "title": title,
        "palette": list(OKABE_ITO),
    }
    page = framed_page("motion", data, "rips.js", "match.js", "planar.js")
    return Motion(page, height, f"{len(cloud)} points, each within {radius:g} of its place")
