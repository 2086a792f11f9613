"""A cloth in space with its loops and its target, drawn by Matplotlib."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from mpl_toolkits.mplot3d.proj3d import proj_transform
from numpy.typing import ArrayLike

from topokit._validate import Array, Ids, as_ids, as_points
from topokit.seqph import Loop

from ._diagrams import new_axes
from ._looks import cloth_marks, face_normals, loop_colour, shadow, smoothed

CLOTH = "#E8E2D4"
LINING = "#C8C9D0"  # the inner side of cloth
ROD = "#5B6B7C"
INK = "#1C2733"


def plot_cloth(
    points: ArrayLike,
    faces: ArrayLike = (),
    *,
    ax: Axes | None = None,
    loops: Sequence[Loop] = (),
    true_loops: Sequence[ArrayLike] = (),
    centre_line: ArrayLike | None = None,
    thickness: float = 0.01,
    rest: ArrayLike | None = None,
    view: tuple[float, float] = (-60.0, 15.0),
    zoom: float = 1.0,
    focus: ArrayLike | None = None,
) -> Axes:
    """Draw a cloth in space with the killer triangles of its loops, and return the axes.

    Parameters
    ----------
    points : (N, 3) array_like
        Vertices in metres, z up.
    faces : (F, 3) array_like of int
        Triangles; without faces only the points are drawn.
    ax : matplotlib Axes of projection "3d", default a new figure's
    loops : sequence of Loop
        Loops whose killer triangles and edges are drawn in the colour of the identity.
    true_loops : sequence of (L,) array_like of int
        Closed cycles of vertex ids, drawn as dark lines.
    centre_line : (K, 3) array_like, optional
        The target's, drawn as a rod.
    thickness : float
        Radius of the rod in metres.
    rest : (N, 3) array_like, optional
        The cloth lying smooth, on which its check is measured; default `points`.
    view : (2,) float
        Azimuth and elevation of the eye in degrees.
    zoom : float
        Enlargement of the fit around everything.
    focus : (3,) array_like, optional
        The middle of the picture; default the middle of everything.
    """
    vertices = as_points(points)
    triangles = as_ids(np.reshape(faces, (-1, 3)).astype(int), "faces", len(vertices))
    line = np.zeros((0, 3)) if centre_line is None else np.reshape(centre_line, (-1, 3)).astype(float)
    rings, darkness = shadow(vertices, seen_from_above=view[1] >= 0)
    axes: Any = new_axes(ax, projection="3d")
    axes.set_autoscale_on(False)  # `_fit` sets the limits
    axes.computed_zorder = False
    if len(rings):
        axes.add_collection3d(Poly3DCollection(rings, zorder=0, rasterized=True, facecolors=(0, 0, 0, darkness)))

    # Cloth and target are one collection, since Matplotlib sorts by depth only inside a collection. Lines are triangles of two
    # corners, since it would pad polygons of several lengths with uninitialised memory. Thousands of faces stay pixels in SVG.
    walls = tube(subdivide(line, 40), thickness) if len(line) > 1 else np.zeros((0, 3, 3))
    smooth = None if rest is None else as_points(rest, "rest")
    parts = [*_surface(vertices, triangles, smooth, view), (walls, _shaded(-face_normals(walls), ROD, view))]
    polygons = np.concatenate([corners for corners, _ in parts])
    colours = np.concatenate([part_colours for _, part_colours in parts])
    look = {"facecolors": colours, "edgecolors": colours, "linewidths": 0.8}
    axes.add_collection3d(Poly3DCollection(polygons, zorder=1, rasterized=True, **look))
    if not len(triangles):
        axes.scatter(*vertices.T, s=4, color=ROD, zorder=1, rasterized=True)

    for ids in true_loops:
        axes.plot(*vertices[np.append(ids, np.asarray(ids)[:1])].T, color=INK, linewidth=1.6, zorder=2)
    for loop in loops:
        colour = loop_colour(loop.id)
        killers = Poly3DCollection(list(loop.killer_triangles), zorder=3)
        killers.set(facecolor=(colour, 0.45), edgecolor=colour)
        axes.add_collection3d(killers)
        axes.add_collection3d(Line3DCollection([loop.killer_edge_points], colors=colour, linewidths=3, zorder=4))

    # The shadow is in the picture only where the cloth comes near the floor.
    everything = np.concatenate([vertices, line])
    if len(rings) and everything[:, 2].min() < 0.05:
        everything = np.concatenate([everything, rings[1]])
    _fit(axes, everything, view, zoom, focus)
    return axes


def direction(azimuth: float, elevation: float) -> Array:
    """Return the unit vector towards an eye at these degrees."""
    a, e = np.radians([azimuth, elevation])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def _fit(axes: Any, everything: Array, view: tuple[float, float], zoom: float, focus: ArrayLike | None) -> None:
    """Fit the axes tightly around everything from the eye's direction, without box or ticks."""
    low = everything.min(axis=0)
    high = everything.max(axis=0)
    size = np.maximum(high - low, 1e-3 * max(float((high - low).max()), 1e-6))
    middle = (low + high) / 2
    axes.set(**{f"{name}lim": (m - s / 2, m + s / 2) for name, m, s in zip("xyz", middle, size, strict=True)})
    axes.set_box_aspect(size)
    axes.view_init(elev=view[1], azim=view[0])
    axes.set_axis_off()

    # Matplotlib frames the box's diagonal; its flat view limits become a square around the projected points.
    flat = np.array(proj_transform(*everything.T, axes.get_proj())[:2])
    half = 0.53 * float(np.ptp(flat, axis=1).max()) / zoom or 0.1
    centre = (flat.min(axis=1) + flat.max(axis=1)) / 2
    if focus is not None:
        centre = np.array(proj_transform(*np.asarray(focus), axes.get_proj())[:2])
    axes.viewLim.intervalx = (centre[0] - half, centre[0] + half)
    axes.viewLim.intervaly = (centre[1] - half, centre[1] + half)


def subdivide(line: Array, pieces: int = 60) -> Array:
    """Cut a (K, 3) polyline into short pieces, so that sorting them by depth puts each before or behind the cloth."""
    if len(line) < 2:
        return line
    walked = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    places = np.union1d(np.linspace(0.0, walked[-1], pieces), walked)
    return np.stack([np.interp(places, walked, line[:, axis]) for axis in range(3)], axis=1)


def tube(line: Array, radius: float, sides: int = 8) -> Array:
    """Return (m, 3, 3) the triangles of a tube around a polyline; one normal is carried along, so that it does not twist."""
    along = np.gradient(line, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    normal = np.eye(3)[np.argmin(np.abs(along[0]))]
    angles = np.linspace(0.0, 2 * np.pi, sides, endpoint=False)
    rings = []
    for point, ahead in zip(line, along, strict=True):
        normal = normal - (normal @ ahead) * ahead
        normal /= max(float(np.linalg.norm(normal)), 1e-12)
        other = np.cross(ahead, normal)
        rings.append(point + radius * (np.cos(angles)[:, None] * normal + np.sin(angles)[:, None] * other))
    ring = np.array(rings)  # (K, sides, 3)
    next_corner = np.roll(ring, -1, axis=1)
    halves = [[ring[:-1], ring[1:], next_corner[1:]], [ring[:-1], next_corner[1:], next_corner[:-1]]]
    return np.concatenate([np.stack(half, axis=2).reshape(-1, 3, 3) for half in halves])


def _surface(points: Array, faces: Ids, rest: Array | None, view: tuple[float, float]) -> Iterator[tuple[Array, Array]]:
    """Yield (m, 3, 3) corners and (m, 3) colours of faces, then of check and seams, lines as triangles of two corners."""
    corners = points[faces]
    flat = face_normals(corners)
    eye = direction(*view)
    back = (flat @ eye < 0)[:, None]  # the eye sees the inner side
    normals = np.where(back, -1, 1) * smoothed(flat, faces)
    colours = np.where(back, _shaded(normals, LINING, view), _shaded(normals, CLOTH, view))
    yield corners, colours
    lift = 0.015 * float(np.ptp(points, axis=0).max(initial=0.0)) * eye  # sorted before its face
    for face, ends, bright in cloth_marks(points if rest is None else rest, faces, smooth=rest is not None):
        yield (ends @ corners[face] + lift)[:, [0, 1, 1]], bright * colours[face]


def _shaded(normals: Array, base: str, view: tuple[float, float]) -> Array:
    """Return (m, 3) colours of surfaces with one base colour, lit from above the eye's left shoulder."""
    lamp = direction(view[0] - np.degrees(0.6), min(view[1] + np.degrees(0.6), np.degrees(1.4)))
    return np.asarray(np.array(to_rgb(base)) * np.clip(0.55 + 0.5 * (normals @ lamp), 0.2, 1.0)[:, None])
