"""The lens of an edge, drawn: why an edge is critical, or which path holds its lune together.

Taught in chapter 5.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._validate import as_points, positive
from topokit.view._lunes import _ends
from topokit.view._palette import OKABE_ITO
from topokit.view._plots import _axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["plot_lens"]

Array = NDArray[np.float64]
_BLOCKED, _PATH = OKABE_ITO[3], OKABE_ITO[2]


def plot_lens(
    points: ArrayLike, edge: Sequence[int], alpha: float, epsilon: float = 0.0, ax: Axes | None = None
) -> Axes:
    """Draw whether an edge of a planar cloud is (alpha, epsilon)-critical, as `topokit.lemmas.beta_critical` says it.

    The dashed lens holds the points that may be in the edge's lune, the shaded one those that surely are and so may carry
    paths; these are joined where a step surely survives. Two points of the dashed lens are marked: of a critical edge two
    that no path joins, of another one the two farthest apart, with a path between them.

    Parameters
    ----------
    points : (n, 2) array_like
    edge : (2,) sequence of int
        Its two ends.
    alpha, epsilon : float
        Covering radius of the observations and largest displacement, in the unit of the points.
    ax : matplotlib Axes, optional
        A new figure's when not given.

    Returns
    -------
    Axes

    Raises
    ------
    ValueError
        When `points` do not lie in the plane, `edge` is not a pair of two of them, or a number is negative.

    Examples
    --------
    >>> from topokit import view
    >>> view.plot_lens([[0, 0], [2, 0], [2, 2], [0, 2]], (0, 2), alpha=0.1).get_title()
    'critical'
    """
    from matplotlib.collections import LineCollection
    from scipy.spatial.distance import cdist

    cloud, alpha, epsilon = as_points(points), positive(alpha, "alpha"), positive(epsilon, "epsilon")
    if cloud.shape[1] != 2:
        raise ValueError(f"points must lie in the plane, (n, 2), not of shape {cloud.shape}")
    x, y = _ends(edge, len(cloud))
    distances = cdist(cloud, cloud)
    length = distances[x, y]
    pair, path, inner = _witness(distances, x, y, alpha, epsilon)
    steps = np.argwhere(np.triu(distances[np.ix_(inner, inner)] < length - 2 * alpha - 4 * epsilon, 1))

    axes = _axes(ax)
    reach = length - alpha - 4 * epsilon
    axes.fill(*_outline(cloud[x], cloud[y], length + 4 * epsilon).T, facecolor="none", edgecolor="0.4", linestyle="--")
    axes.fill(*_outline(cloud[x], cloud[y], reach).T, facecolor="0.5", alpha=0.18)
    axes.add_collection(LineCollection(list(cloud[inner[steps]]), colors="0.75", linewidths=0.3, zorder=1))
    axes.plot(*cloud.T, "o", color="0.55", markersize=2.5, zorder=2)
    axes.plot(*cloud[inner].T, "o", color="0.3", markersize=3, zorder=2)
    axes.plot(*cloud[[x, y]].T, "o-", color=OKABE_ITO[0], linewidth=2.6, markersize=6, zorder=4)
    critical = bool(len(pair)) and not len(path)
    if len(path):
        axes.plot(*cloud[path].T, "-", color=_PATH, linewidth=2.2, zorder=3)
    axes.plot(*cloud[pair].T, "o", color=_BLOCKED if critical else _PATH, markersize=8, zorder=5)
    axes.set_title("critical" if critical else "not critical")
    axes.set_aspect("equal")
    axes.set_axis_off()
    return axes


def _witness(
    distances: Array, x: int, y: int, alpha: float, epsilon: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Two points of the lens, a path between them (empty when none may be), and the points that may carry paths.

    The pair is one without a path if there is one, else the one farthest apart; of equals the first. No pair when no two
    points of the lens are far enough apart.
    """
    from scipy.sparse.csgraph import dijkstra

    length, farther = distances[x, y], np.maximum(distances[x], distances[y])
    lens = np.flatnonzero(farther <= length + 4 * epsilon)
    lens = lens[(lens != x) & (lens != y)]
    inner = np.flatnonzero(farther < length - alpha - 4 * epsilon)
    none = np.empty(0, np.int64)
    if len(lens) < 2:
        return none, none, inner
    # Places of a path: the lens twice, where it may begin and where it may end, and the carriers in between.
    n, m = len(lens), len(inner)
    ends, between = distances[np.ix_(lens, inner)], distances[np.ix_(inner, inner)]
    graph = np.zeros((2 * n + m, 2 * n + m))
    graph[:n, 2 * n :] = np.where(ends < length - alpha - 4 * epsilon, ends + 1e-9 * length, 0)
    graph[2 * n :, n : 2 * n] = graph[:n, 2 * n :].T
    graph[2 * n :, 2 * n :] = np.where(between < length - 2 * alpha - 4 * epsilon, between + 1e-9 * length, 0)
    np.fill_diagonal(graph, 0.0)
    walked, before = dijkstra(graph, indices=np.arange(n), return_predecessors=True)
    apart = distances[np.ix_(lens, lens)]
    asked = np.triu(apart >= length - 4 * epsilon, 1)
    if not asked.any():
        return none, none, inner
    blocked = asked & np.isinf(walked[:, n : 2 * n])
    i, j = np.unravel_index(int(np.argmax(np.where(blocked if blocked.any() else asked, apart, -1.0))), apart.shape)
    pair = lens[[i, j]]
    if blocked.any():
        return pair, none, inner
    place, path = n + int(j), []
    while place >= 0:
        path.append(place)
        place = int(before[i, place])
    vertex = np.concatenate([lens, lens, inner])
    return pair, vertex[path[::-1]], inner


def _outline(a: Array, b: Array, radius: float) -> Array:
    """(k, 2) the outline of all places within `radius` of both a and b; degenerate when it is below half their distance."""
    direction = np.arctan2(*(b - a)[::-1])
    half = float(np.hypot(*(b - a))) / 2
    arc = np.arccos(min(1.0, half / radius)) * np.linspace(-1, 1, 40) if radius > 0 else np.zeros(40)
    arcs = [
        centre + max(radius, half) * np.column_stack([np.cos(way + arc), np.sin(way + arc)])
        for centre, way in ((a, direction), (b, direction + np.pi))
    ]
    return np.concatenate(arcs)
