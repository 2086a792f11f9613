"""What the Matplotlib pictures share: axes of a new figure where none are given, and dots and edges of planar clouds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["bare", "draw_dots", "draw_edges", "new_axes"]


def new_axes(ax: Axes | None, **options: Any) -> Axes:
    """`ax`, or the axes of a new pyplot figure."""
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    axes: Axes = plt.figure(layout="constrained").add_subplot(**options)
    return axes


def draw_dots(axes: Axes, places: NDArray[np.float64], colour: str, size: float, zorder: float) -> None:
    axes.plot(*places.T, "o", color=colour, markersize=size, zorder=zorder)


def draw_edges(axes: Axes, cloud: NDArray[np.float64], joined: NDArray[np.bool_], **look: Any) -> None:
    """The edges of a graph of places."""
    from matplotlib.collections import LineCollection

    axes.add_collection(LineCollection(list(cloud[np.argwhere(np.triu(joined))]), **look))


def bare(axes: Axes, title: str) -> Axes:
    """One scale for both directions, and no frame."""
    axes.set_title(title)
    axes.set_aspect("equal")
    axes.set_axis_off()
    return axes
