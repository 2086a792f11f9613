"""Drawings of an edge's lune: what the edge joins and fills when it arrives, and why it is critical or not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial.distance import cdist

from topokit.view import loop_colour

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
Mask = NDArray[np.bool_]

EDGE = loop_colour(0)
PATH = loop_colour(2)
BLOCKED = loop_colour(3)
COMPONENTS = [loop_colour(k) for k in range(1, 6)]


def plot_lune(points: ArrayLike, edge: Sequence[int], ax: Axes | None = None) -> Axes:
    """Draw the lune of an edge of a planar cloud at the moment the edge arrives, with a colour for each component.

    Faint lines are the edges that came before. When the lune is disconnected, the triangles by which the edge joins its
    components are filled: on each component the apex whose longer edge to the two ends is shortest, ties by index.

    Parameters
    ----------
    points : (n, 2) array_like
    edge : (2,) sequence of int
    ax : matplotlib Axes, default a new figure's
    """
    cloud = np.asarray(points, dtype=np.float64)
    x, y = sorted(edge)
    joined = joined_before(cloud, x, y)
    components = lune_components(joined, x, y)
    axes = _axes(ax)

    # the cloud, the edges that came before, and the outline of the lune
    _draw_edges(axes, cloud, joined, colors="0.72", linewidths=0.7, zorder=1)
    outline = _lens_outline(cloud[x], cloud[y], float(np.linalg.norm(cloud[y] - cloud[x])))
    axes.fill(*outline.T, facecolor="0.5", alpha=0.14, edgecolor="0.4", linestyle="--", zorder=0)
    _draw_dots(axes, cloud, "0.45", 3.5, zorder=3)

    # the components and their triangles
    for i, vertices in enumerate(components):
        component = cloud[vertices]
        colour = COMPONENTS[i % len(COMPONENTS)]
        _draw_edges(axes, component, joined[np.ix_(vertices, vertices)], colors=colour, linewidths=1.6, zorder=2)
        _draw_dots(axes, component, colour, 7, zorder=4)
        if len(components) > 1:
            longer = cdist(component, cloud[[x, y]]).max(axis=1)
            triangle = np.vstack([cloud[[x, y]], component[np.argmin(longer)]])
            axes.fill(*triangle.T, facecolor=EDGE, alpha=0.22, zorder=1)

    titles = {0: "empty", 1: "connected"}
    title = titles.get(len(components), f"{len(components)} components")
    return _finish(axes, cloud[[x, y]], title)


def plot_lens(
    points: ArrayLike, edge: Sequence[int], alpha: float, epsilon: float = 0.0, ax: Axes | None = None
) -> Axes:
    """Draw whether an edge of a planar cloud is (alpha, epsilon)-critical, as `topokit.lemmas.beta_critical` decides it.

    The dashed lens holds the points that may be in the edge's lune. The shaded lens holds the points that surely are in it and
    so may carry paths; lines join them where a step surely survives. Two points of the dashed lens are marked: when the edge
    is critical, two that no path joins; otherwise the two farthest apart, with a path between them.

    Parameters
    ----------
    points : (n, 2) array_like
    edge : (2,) sequence of int
    alpha, epsilon : float
        Covering radius of the observations and largest displacement, in the unit of the points.
    ax : matplotlib Axes, default a new figure's
    """
    cloud = np.asarray(points, dtype=np.float64)
    x, y = sorted(edge)
    distances = cdist(cloud, cloud)
    length = distances[x, y]
    pair, path, inner = lens_witness(distances, x, y, alpha, epsilon)
    critical = len(pair) > 0 and len(path) == 0
    axes = _axes(ax)

    # the two lenses
    possible = _lens_outline(cloud[x], cloud[y], length + 4 * epsilon)
    sure = _lens_outline(cloud[x], cloud[y], length - alpha - 4 * epsilon)
    axes.fill(*possible.T, facecolor="none", edgecolor="0.4", linestyle="--")
    axes.fill(*sure.T, facecolor="0.5", alpha=0.18)

    # the points that may carry paths, and the steps between them
    steps = distances[np.ix_(inner, inner)] < length - 2 * alpha - 4 * epsilon
    np.fill_diagonal(steps, False)
    _draw_edges(axes, cloud[inner], steps, colors="0.75", linewidths=0.3, zorder=1)
    _draw_dots(axes, cloud, "0.55", 2.5, zorder=2)
    _draw_dots(axes, cloud[inner], "0.3", 3, zorder=2)

    # the witness
    axes.plot(*cloud[path].T, "-", color=PATH, linewidth=2.2, zorder=3)
    _draw_dots(axes, cloud[pair], BLOCKED if critical else PATH, 8, zorder=5)
    return _finish(axes, cloud[[x, y]], "critical" if critical else "not critical")


# ---- what is decided -----------------------------------------------------------------------------------------------


def joined_before(cloud: Array, x: int, y: int) -> Mask:
    """Return (n, n) whether two vertices are joined before {x, y}: by length, then by smaller, then by larger index."""
    squared = ((cloud[:, None] - cloud[None, :]) ** 2).sum(axis=2)
    index = np.arange(len(cloud))
    smaller = np.minimum.outer(index, index)
    larger = np.maximum.outer(index, index)
    earlier = (smaller < x) | ((smaller == x) & (larger < y))
    joined = (squared < squared[x, y]) | ((squared == squared[x, y]) & earlier)
    return np.asarray(joined & (smaller < larger))


def lune_components(joined: Mask, x: int, y: int) -> list[Ids]:
    """Return the connected components of the lune of {x, y}, each in order, by their smallest vertex."""
    lune = np.flatnonzero(joined[x] & joined[y])
    return _components(lune, joined)


def _components(vertices: Ids, joined: Mask) -> list[Ids]:
    count, label = connected_components(joined[np.ix_(vertices, vertices)], directed=False)
    return [vertices[label == i] for i in range(count)]


def lens_witness(distances: Array, x: int, y: int, alpha: float, epsilon: float) -> tuple[Ids, Ids, Ids]:
    """Return two points of the lens, a path between them, and the points that may carry paths.

    The pair has no path if such a pair exists; otherwise it is the pair farthest apart, and of equal pairs the first. It is
    empty when no two points of the lens are far enough apart.
    """
    length = distances[x, y]
    end_step = length - alpha - 4 * epsilon
    step = end_step - alpha
    farther = np.maximum(distances[x], distances[y])
    lens = np.setdiff1d(np.flatnonzero(farther <= length + 4 * epsilon), (x, y))
    inner = np.flatnonzero(farther < end_step)
    nothing = np.empty(0, np.int64)

    # the pairs that the lemma asks for a path
    apart = distances[np.ix_(lens, lens)]
    asked = np.triu(apart >= length - 4 * epsilon, 1)
    if not asked.any():
        return nothing, nothing, inner

    # a path joins two points of the lens that reach the same component of inner points
    blocked = asked
    if len(inner):
        components = _components(np.arange(len(inner)), distances[np.ix_(inner, inner)] < step)
        touches = distances[np.ix_(lens, inner)] < end_step
        reached = np.array([touches[:, component].any(axis=1) for component in components], dtype=int)
        blocked = asked & (reached.T @ reached == 0)

    critical = bool(blocked.any())
    candidates = blocked if critical else asked
    farthest = int(np.argmax(np.where(candidates, apart, -1)))
    pair = lens[[*divmod(farthest, len(lens))]]
    if critical:
        return pair, nothing, inner
    return pair, _shortest_path(distances, pair, inner, end_step, step), inner


def _shortest_path(distances: Array, pair: Ids, inner: Ids, end_step: float, step: float) -> Ids:
    """Return the shortest path between two points through inner points, by steps below `step`, or `end_step` at the ends."""
    places = np.concatenate([inner, pair])
    last = len(inner)
    lengths = distances[np.ix_(places, places)]
    limit = np.full(lengths.shape, step)
    limit[last:] = end_step
    limit[:, last:] = end_step
    limit[last:, last:] = 0.0
    tiny = 1e-9 * float(lengths.max())  # dijkstra takes a step of length zero for no step
    graph = np.where(lengths < limit, lengths + tiny, 0.0)
    np.fill_diagonal(graph, 0.0)
    _, before = dijkstra(graph, indices=last, return_predecessors=True)
    path = [last + 1]
    while path[-1] != last:
        path.append(int(before[path[-1]]))
    return np.asarray(places[path[::-1]])


# ---- drawing -------------------------------------------------------------------------------------------------------


def _axes(ax: Axes | None) -> Axes:
    if ax is not None:
        return ax
    return plt.figure(layout="constrained").add_subplot()


def _draw_dots(axes: Axes, places: Array, colour: str, size: float, zorder: float) -> None:
    axes.plot(*places.T, "o", color=colour, markersize=size, zorder=zorder)


def _draw_edges(axes: Axes, cloud: Array, joined: Mask, **look: Any) -> None:
    axes.add_collection(LineCollection(list(cloud[np.argwhere(np.triu(joined))]), **look))


def _finish(axes: Axes, ends: Array, title: str) -> Axes:
    axes.plot(*ends.T, "o-", color=EDGE, linewidth=2.6, markersize=6, zorder=4.5)
    axes.set(title=title, aspect="equal")
    axes.set_axis_off()
    return axes


def _lens_outline(a: Array, b: Array, radius: float) -> Array:
    """Return (k, 2) the outline of all places within `radius` of a and b, or of half their distance if that is more."""
    half = float(np.linalg.norm(b - a)) / 2
    radius = max(radius, half)
    opening = np.arccos(half / radius) if radius else 0.0
    angles = np.arctan2(b[1] - a[1], b[0] - a[0]) + opening * np.linspace(-1, 1, 40)
    arc = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    return np.concatenate([a + arc, b - arc])
