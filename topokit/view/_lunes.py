"""The lune of an edge, drawn: what it joins and fills when it arrives, and why it is critical or not.

Taught in chapters 2 and 5.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial.distance import cdist

from topokit._validate import Array, Ids, positive
from topokit.view._pages import MOST_POINTS, PALETTE, Framed, framed, planar, shapes
from topokit.view._plots import new_axes

_EDGE, *_COMPONENTS = PALETTE
_BLOCKED, _PATH = PALETTE[3], PALETTE[2]


def plot_lune(points: ArrayLike, edge: Sequence[int], ax: Axes | None = None) -> Axes:
    """Draw the lune of an edge of a planar cloud at the moment the edge arrives, a colour for each component.

    Faint lines are the edges that came before it. When the lune is disconnected, the triangles by which the edge joins its
    components are filled: on each component the apex whose longer edge to the two ends is shortest, ties by index.

    Parameters
    ----------
    points : (n, 2) array_like
    edge : (2,) sequence of int
    ax : matplotlib Axes, default a new figure's
    """
    cloud = planar(points, "points")
    x, y = _ends(edge, len(cloud))
    joined = _joined_before(cloud, x, y)
    components = _components(np.flatnonzero(joined[x] & joined[y]), joined)
    axes = new_axes(ax)
    _draw_edges(axes, cloud, joined, colors="0.72", linewidths=0.7, zorder=1)
    outline = _outline(cloud[x], cloud[y], float(np.hypot(*(cloud[y] - cloud[x]))))
    axes.fill(*outline.T, facecolor="0.5", alpha=0.14, edgecolor="0.4", linestyle="--", zorder=0)
    _draw_dots(axes, cloud, "0.45", 3.5, zorder=3)
    for i, vertices in enumerate(components):
        part, colour = cloud[vertices], _COMPONENTS[i % len(_COMPONENTS)]
        _draw_edges(axes, part, joined[np.ix_(vertices, vertices)], colors=colour, linewidths=1.6, zorder=2)
        _draw_dots(axes, part, colour, 7, zorder=4)
        if len(components) > 1:
            longer = np.linalg.norm(part[:, None] - cloud[[x, y]], axis=2).max(axis=1)
            triangle = np.vstack([cloud[[x, y]], part[np.argmin(longer)]])
            axes.fill(*triangle.T, facecolor=_EDGE, alpha=0.22, zorder=1)
    title = {0: "empty", 1: "connected"}.get(len(components), f"{len(components)} components")
    return _finished(axes, cloud[[x, y]], title)


def lunes(points: ArrayLike | Mapping[str, ArrayLike]) -> Framed:
    """Return an interactive figure of the lune of one edge after another, in the order in which the edges arrive.

    The lune has a colour for each component, and the edge is said to join, to begin or to kill a loop, or to do neither. Beside
    the cloud the lune is drawn alone: its points and the edge's two ends, by whose suspension the lune theorem is proved.

    Parameters
    ----------
    points : (n, 2) array_like, or mapping of str to (n, 2) array_like
        2 to 60 points; or several such clouds by name, of which the reader chooses.

    Raises
    ------
    ValueError
        When there is no cloud, or a cloud of one point.
    """
    clouds, many = shapes(points, MOST_POINTS)
    if min(map(len, clouds.values())) < 2:
        raise ValueError("one point has no edge; give at least two")
    title, scripts = f"The lunes of {many} points", ("rips.js", "planar.js", "places.js")
    return framed("lunes", scripts, {"shapes": clouds}, 500, "drag a point, or click two", title)


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
    alpha, epsilon : float
        Covering radius of the observations and largest displacement, in the unit of the points.
    ax : matplotlib Axes, default a new figure's
    """
    cloud, alpha, epsilon = planar(points, "points"), positive(alpha, "alpha"), positive(epsilon, "epsilon")
    x, y = _ends(edge, len(cloud))
    distances = cdist(cloud, cloud)
    length = distances[x, y]
    pair, path, inner = _witness(distances, x, y, alpha, epsilon)
    critical = len(pair) > 0 and len(path) == 0
    axes = new_axes(ax)
    outer, sure = (_outline(cloud[x], cloud[y], length + slack) for slack in (4 * epsilon, -alpha - 4 * epsilon))
    axes.fill(*outer.T, facecolor="none", edgecolor="0.4", linestyle="--")
    axes.fill(*sure.T, facecolor="0.5", alpha=0.18)
    steps = distances[np.ix_(inner, inner)] < length - 2 * alpha - 4 * epsilon
    np.fill_diagonal(steps, False)
    _draw_edges(axes, cloud[inner], steps, colors="0.75", linewidths=0.3, zorder=1)
    _draw_dots(axes, cloud, "0.55", 2.5, zorder=2)
    _draw_dots(axes, cloud[inner], "0.3", 3, zorder=2)
    axes.plot(*cloud[path].T, "-", color=_PATH, linewidth=2.2, zorder=3)
    _draw_dots(axes, cloud[pair], _BLOCKED if critical else _PATH, 8, zorder=5)
    return _finished(axes, cloud[[x, y]], "critical" if critical else "not critical")


def _draw_dots(axes: Axes, places: Array, colour: str, size: float, zorder: float) -> None:
    axes.plot(*places.T, "o", color=colour, markersize=size, zorder=zorder)


def _draw_edges(axes: Axes, cloud: Array, joined: NDArray[np.bool_], **look: Any) -> None:
    axes.add_collection(LineCollection(list(cloud[np.argwhere(np.triu(joined))]), **look))


def _finished(axes: Axes, ends: Array, title: str) -> Axes:
    axes.plot(*ends.T, "o-", color=_EDGE, linewidth=2.6, markersize=6, zorder=4.5)
    axes.set(title=title, aspect="equal")
    axes.set_axis_off()
    return axes


def _ends(edge: Sequence[int], n: int) -> tuple[int, int]:
    ends = np.asarray(edge)
    pair = ends.shape == (2,) and np.issubdtype(ends.dtype, np.integer)
    x, y = sorted(ends.tolist()) if pair else (0, 0)
    if not 0 <= x < y < n:
        raise ValueError(f"edge must be the ids of two different vertices from 0 to {n - 1}, not {edge!r}")
    return x, y


def _joined_before(cloud: Array, x: int, y: int) -> NDArray[np.bool_]:
    """(n, n) whether two vertices are joined before {x, y}: by length, then smaller, then larger index."""
    squared = ((cloud[:, None] - cloud[None, :]) ** 2).sum(axis=2)
    index = np.arange(len(cloud))
    low, high = np.minimum.outer(index, index), np.maximum.outer(index, index)
    tie = (low < x) | ((low == x) & (high < y))
    joined = (squared < squared[x, y]) | ((squared == squared[x, y]) & tie)
    return np.asarray(joined & (low < high))


def _components(vertices: Ids, joined: NDArray[np.bool_]) -> list[Ids]:
    """The connected components of a set of vertices, each in order, by their smallest vertex."""
    count, label = connected_components(joined[np.ix_(vertices, vertices)], directed=False)
    return [vertices[label == i] for i in range(count)]


def _outline(a: Array, b: Array, radius: float) -> Array:
    """(k, 2) the outline of all places within `radius` of both a and b; degenerate when it is below half their distance."""
    ahead = np.arctan2(*(b - a)[::-1])
    half = float(np.hypot(*(b - a))) / 2
    radius = max(radius, half)
    angles = ahead + np.arccos(half / radius if radius else 1.0) * np.linspace(-1, 1, 40)
    arc = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    return np.concatenate([a + arc, b - arc])


def _witness(distances: Array, x: int, y: int, alpha: float, epsilon: float) -> tuple[Ids, Ids, Ids]:
    """Two points of the lens (none when none are far enough apart), a path between them, and the points that may carry paths.

    The pair is one without a path if there is one, else the one farthest apart; of equals the first.
    """
    length, farther = distances[x, y], np.maximum(distances[x], distances[y])
    end_step = length - alpha - 4 * epsilon
    lens = np.setdiff1d(np.flatnonzero(farther <= length + 4 * epsilon), (x, y))
    inner = np.flatnonzero(farther < end_step)
    none = np.empty(0, np.int64)
    apart = distances[np.ix_(lens, lens)]
    asked = np.triu(apart >= length - 4 * epsilon, 1)
    if not asked.any():
        return none, none, inner
    steps = distances[np.ix_(inner, inner)] < end_step - alpha
    ends = distances[np.ix_(lens, inner)] < end_step
    reached = np.array([ends[:, part].any(axis=1) for part in _components(np.arange(len(inner)), steps)], dtype=int)
    blocked = asked & (reached.T @ reached == 0) if len(inner) else asked
    farthest = np.argmax(np.where(blocked if blocked.any() else asked, apart, -1))
    pair = lens[[*divmod(int(farthest), len(lens))]]
    return pair, none if blocked.any() else _path(distances, pair, inner, end_step, end_step - alpha), inner


def _path(distances: Array, pair: Ids, inner: Ids, end_step: float, step: float) -> Ids:
    """The shortest path between two points through others, by steps below a limit, which is another at the ends."""
    places, last = np.concatenate([inner, pair]), len(inner)
    graph = distances[np.ix_(places, places)]
    limit = np.full(graph.shape, step)
    limit[last:], limit[:, last:] = end_step, end_step
    limit[last:, last:] = 0.0
    tiny = 1e-9 * float(graph.max())  # a step of no length is a step
    graph = np.where(graph < limit, graph + tiny, 0.0)
    np.fill_diagonal(graph, 0.0)
    _, before = dijkstra(graph, indices=last, return_predecessors=True)
    path = [last + 1]
    while path[-1] != last:
        path.append(int(before[path[-1]]))
    return places[path[::-1]]
