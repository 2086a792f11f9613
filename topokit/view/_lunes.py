"""The lune of an edge, drawn: which points are joined to both of its ends, in how many pieces, and what the edge fills.

Taught in chapter 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._validate import as_points
from topokit.view._palette import OKABE_ITO
from topokit.view._plots import _axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["plot_lune"]

_FAINT = "0.72"
_COMPONENTS = OKABE_ITO[1:]  # the first colour is the edge's own


def plot_lune(points: ArrayLike, edge: Sequence[int], ax: Axes | None = None) -> Axes:
    """Draw the lune of an edge of a planar cloud at the moment the edge arrives, a colour for each component.

    Faint lines are the edges that came before it. When the lune is disconnected, the triangles by which the edge joins its
    components are filled: on each component the apex whose longer edge to the two ends is shortest, ties by index.

    Parameters
    ----------
    points : (n, 2) array_like
    edge : (2,) sequence of int
        Its two ends.
    ax : matplotlib Axes, optional
        A new figure's when not given.

    Returns
    -------
    Axes

    Raises
    ------
    ValueError
        When `points` do not lie in the plane, or `edge` is not a pair of two of them.

    Examples
    --------
    >>> from topokit import view
    >>> view.plot_lune([[0, 0], [2, 0], [2, 2], [0, 2]], (0, 2)).get_title()
    '2 components'
    """
    from matplotlib.collections import LineCollection

    cloud = as_points(points)
    if cloud.shape[1] != 2:
        raise ValueError(f"points must lie in the plane, (n, 2), not of shape {cloud.shape}")
    x, y = _ends(edge, len(cloud))
    joined = _joined_before(cloud, x, y)
    components = _components(np.flatnonzero(joined[x] & joined[y]), joined)
    axes = _axes(ax)
    axes.add_collection(LineCollection(list(_segments(cloud, joined)), colors=_FAINT, linewidths=0.7, zorder=1))
    axes.fill(*_outline(cloud[x], cloud[y]).T, facecolor="0.5", alpha=0.14, edgecolor="0.4", linestyle="--", zorder=0)
    axes.plot(*cloud.T, "o", color="0.45", markersize=3.5, zorder=3)
    for i, vertices in enumerate(components):
        colour = _COMPONENTS[i % len(_COMPONENTS)]
        inside = np.zeros_like(joined)
        inside[np.ix_(vertices, vertices)] = joined[np.ix_(vertices, vertices)]
        axes.add_collection(LineCollection(list(_segments(cloud, inside)), colors=colour, linewidths=1.6, zorder=2))
        axes.plot(*cloud[vertices].T, "o", color=colour, markersize=7, zorder=4)
        if len(components) > 1:
            longer = np.linalg.norm(cloud[vertices, None] - cloud[[x, y]], axis=2).max(axis=1)
            apex = vertices[int(np.argmin(longer))]
            axes.fill(*cloud[[x, y, apex]].T, facecolor=OKABE_ITO[0], alpha=0.22, zorder=1)
    axes.plot(*cloud[[x, y]].T, "o-", color=OKABE_ITO[0], linewidth=2.6, markersize=6, zorder=5)
    count = len(components)
    axes.set_title("empty" if count == 0 else "connected" if count == 1 else f"{count} components")
    axes.set_aspect("equal")
    axes.set_axis_off()
    return axes


def _ends(edge: Sequence[int], n: int) -> tuple[int, int]:
    """The smaller end of the edge, then the larger."""
    ends = np.asarray(edge)
    if ends.shape != (2,) or not np.issubdtype(ends.dtype, np.integer):
        raise ValueError(f"edge must be two vertex ids, not {edge!r}")
    x, y = sorted(ends.tolist())
    if x == y or x < 0 or y >= n:
        raise ValueError(f"edge must join two different vertices from 0 to {n - 1}, not {x} and {y}")
    return x, y


def _joined_before(cloud: NDArray[np.float64], x: int, y: int) -> NDArray[np.bool_]:
    """(n, n) whether two vertices are joined before {x, y}: by length, then smaller, then larger index."""
    squared = ((cloud[:, None] - cloud[None, :]) ** 2).sum(axis=2)
    index = np.arange(len(cloud))
    low, high = np.minimum.outer(index, index), np.maximum.outer(index, index)
    tie = (low < x) | ((low == x) & (high < y))
    joined: NDArray[np.bool_] = (squared < squared[x, y]) | ((squared == squared[x, y]) & tie)
    np.fill_diagonal(joined, False)
    return joined


def _components(vertices: NDArray[np.int64], joined: NDArray[np.bool_]) -> list[list[int]]:
    """The connected components of a set of vertices, each in order, by their smallest vertex."""
    left, components = set(vertices.tolist()), []
    while left:
        component = [min(left)]
        left.discard(component[0])
        for v in component:
            reached = [w for w in left if joined[v, w]]
            component += reached
            left.difference_update(reached)
        components.append(sorted(component))
    return components


def _segments(cloud: NDArray[np.float64], joined: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(m, 2, 2) the edges of a graph as pairs of places."""
    segments: NDArray[np.float64] = cloud[np.argwhere(np.triu(joined))]
    return segments


def _outline(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """(k, 2) the outline of all places that are nearer to a and to b than these are to each other."""
    length, direction = np.hypot(*(b - a)), np.arctan2(*(b - a)[::-1])
    arc = np.linspace(-np.pi / 3, np.pi / 3, 40)
    arcs = [
        centre + length * np.column_stack([np.cos(way + arc), np.sin(way + arc)])
        for centre, way in ((a, direction), (b, direction + np.pi))
    ]
    return np.concatenate(arcs)
