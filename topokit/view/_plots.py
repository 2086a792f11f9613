"""Matplotlib pictures: the diagram of a frame, lifetimes over time, the cloth with its killers, all of them together.

Taught in chapter 0.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._validate import as_points
from topokit.io import Episode
from topokit.rips import Diagram
from topokit.state import Loop, TopologicalState
from topokit.view._geometry import as_faces, as_line, face_light, rod_radius, subdivide, tube
from topokit.view._palette import long_lived, loop_colour

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["plot_cloth", "plot_diagram", "plot_tracks", "track_figure"]

_CLOTH, _ROD, _INK = "#E8E2D4", "#5B6B7C", "#1C2733"


def plot_diagram(diagram: Diagram | TopologicalState, ax: Axes | None = None, *, alpha: float | None = None) -> Axes:
    """Draw a persistence diagram: one dot a loop, birth against death, both half the length of an edge.

    Parameters
    ----------
    diagram : Diagram or TopologicalState
        The loops of a state have the colour of their identity and, when they live longer than the rest, its name; those
        of a diagram have no identity and are drawn in one colour.
    ax : matplotlib Axes, optional
        A new figure's when not given.
    alpha : float, optional
        Lifetime below which loops are dropped, drawn as a dashed line; that of the state when not given.

    Returns
    -------
    Axes
    """
    axes = _axes(ax)
    if isinstance(diagram, TopologicalState):
        points = [(loop.birth, loop.death, loop_colour(loop.id), f"loop {loop.id}") for loop in diagram.loops]
        alpha = diagram.parameters.get("alpha") if alpha is None else alpha
    else:
        points = [(float(b), float(d), loop_colour(1), "") for b, d in zip(diagram.birth, diagram.death, strict=True)]
    finite = [value for birth, death, _, _ in points for value in (birth, death) if np.isfinite(value)]
    high = 1.12 * max([*finite, 2 * (alpha or 0.0)]) or 1.0
    axes.plot([0, high], [0, high], color="0.55", linewidth=1, label="birth = death")
    if alpha:
        axes.plot([0, high - alpha], [alpha, high], color="0.55", linewidth=1, linestyle="--", label="lifetime = alpha")
    longest = max((death - birth for birth, death, _, _ in points), default=0.0)
    for birth, death, colour, name in points:
        alive = not np.isfinite(death)  # a loop that no edge has ended yet stands on the upper border
        style: dict[str, Any] = {"color": colour, "markersize": 7 if name else 5, "alpha": 1.0 if name else 0.8}
        axes.plot(birth, high if alive else death, "^" if alive else "o", markeredgecolor="white", mew=0.4, **style)
        if name and death - birth >= longest / 2:
            axes.annotate(name, (birth, death), xytext=(8, 0), textcoords="offset points", va="center")
    axes.set(xlabel="birth (m)", ylabel="death (m)", xlim=(0, high), ylim=(0, high), aspect="equal")
    return axes


def plot_tracks(states: Sequence[TopologicalState], ax: Axes | None = None) -> Axes:
    """Draw the lifetime of every identity over time, the weighty ones boldly and by name, the rest faintly.

    A line is broken where its loop is not there; a loop of a single frame is a dot.

    Parameters
    ----------
    states : sequence of TopologicalState
    ax : matplotlib Axes, optional
        A new figure's when not given.

    Returns
    -------
    Axes
    """
    axes = _axes(ax)
    times = np.array([state.time for state in states])
    named = long_lived(states)
    lifetimes: dict[int, NDArray[np.float64]] = {}
    for position, state in enumerate(states):
        for loop in state.loops:
            lifetimes.setdefault(loop.id, np.full(len(states), np.nan))[position] = loop.lifetime
    for loop_id in sorted(lifetimes, key=lambda i: i in named):
        values, bold = lifetimes[loop_id], loop_id in named
        there = np.flatnonzero(np.isfinite(values))
        style: dict[str, Any] = {"color": loop_colour(loop_id), "alpha": 1.0 if bold else 0.35}
        style |= {"marker": "." if len(there) == 1 else None, "linewidth": 2.2 if bold else 1.0}
        axes.plot(times, values, label=f"loop {loop_id}" if bold else f"_{loop_id}", **style)
        if bold:
            middle = there[len(there) // 2]
            offset: dict[str, Any] = {"xytext": (0, 7), "textcoords": "offset points", "ha": "center"}
            axes.annotate(f"loop {loop_id}", (times[middle], values[middle]), color=loop_colour(loop_id), **offset)
    axes.set(xlabel="time (s)", ylabel="lifetime (m)")
    axes.set_ylim(0.0, 1.25 * max((np.nanmax(v) for v in lifetimes.values()), default=0.8))
    return axes


def plot_cloth(
    points: ArrayLike,
    faces: ArrayLike = (),
    *,
    loops: Iterable[Loop] = (),
    true_loops: Sequence[ArrayLike] = (),
    centre_line: ArrayLike | None = None,
    thickness: float = 0.01,
    ax: Axes | None = None,
    view: tuple[float, float] = (-60.0, 15.0),
    zoom: float = 1.0,
    focus: ArrayLike | None = None,
) -> Axes:
    """Draw a cloth in space with the killer triangles of its loops, by Matplotlib alone: it works on every machine.

    `render_cloth` draws the same with PyVista, and better.

    Parameters
    ----------
    points : (N, 3) array_like
        Metres, z up.
    faces : (F, 3) array_like of int
        The points alone are drawn when there are none.
    loops : iterable of Loop
        Killer triangles in the colour of the identity, the killer edge as a thick line; above everything.
    true_loops : sequence of (L,) array_like of int
        Closed cycles of vertex ids, drawn as dark lines.
    centre_line : (K, 3) array_like, optional
        The target's, drawn as a rod of radius `thickness`.
    ax : matplotlib Axes of projection "3d", optional
        A new figure's when not given.
    view : (2,) float
        Azimuth and elevation of the eye in degrees.
    zoom : float
        Above one comes nearer than the fit around everything.
    focus : (3,) array_like, optional
        The point in the middle of the picture; the middle of everything when not given.

    Returns
    -------
    Axes

    Raises
    ------
    ValueError
        When `points` are not in space, or `faces`, `centre_line` or `ax` is not of its kind.
    """
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

    cloud = as_points(points)
    if cloud.shape[1] != 3:
        raise ValueError(f"points must lie in space, (N, 3), not of shape {cloud.shape}")
    triangles, rod = as_faces(faces, len(cloud)), as_line(centre_line, "centre_line")
    axes: Any = _axes(ax, projection="3d")
    if not hasattr(axes, "add_collection3d"):
        raise ValueError("ax must be a 3D one: plt.figure().add_subplot(projection='3d')")
    axes.set_autoscale_on(False)  # `_frame` sets the limits
    axes.computed_zorder = False  # the killers stand above the cloth, whatever their depth
    # Cloth and rod are one collection, because Matplotlib sorts by depth only inside a collection; all triangles, because
    # it would pad faces of several lengths with whatever is in memory, and now and then fail on what it finds there.
    polygons = np.concatenate([cloud[triangles], tube(subdivide(rod, 40), thickness)])
    colours = _shaded(polygons, len(triangles), view)
    axes.add_collection3d(Poly3DCollection(polygons, facecolors=colours, edgecolors=colours, linewidths=0.8, zorder=1))
    if not len(triangles):
        axes.scatter(*cloud.T, s=4, color=_ROD, zorder=1)
    for ids in true_loops:
        cycle = np.asarray(ids, dtype=np.int64)
        axes.plot(*cloud[np.append(cycle, cycle[:1])].T, color=_INK, linewidth=1.6, zorder=2)
    for loop in loops:
        colour = loop_colour(loop.id)
        killers = Poly3DCollection(list(loop.killer_triangles), zorder=3)
        killers.set(facecolor=(colour, 0.45), edgecolor=colour)
        axes.add_collection3d(killers)
        axes.add_collection3d(Line3DCollection([loop.killer_edge_points], colors=colour, linewidths=3, zorder=4))
    _frame(axes, np.concatenate([cloud, rod]), view, zoom, focus)
    drawn: Axes = axes
    return drawn


def track_figure(episode: Episode, states: Sequence[TopologicalState]) -> Figure:
    """Return one picture of a tracked episode: the cloth at four moments, lifetimes over time, the diagram of a frame.

    This is what `topokit track --plot` saves. The figure belongs to no window: a notebook shows it when it is the value
    of a cell, and nothing has to be closed.

    Parameters
    ----------
    episode : Episode
    states : sequence of TopologicalState
        One a frame, as `topokit.track` returns them.

    Raises
    ------
    ValueError
        When `states` has another length than the episode.
    """
    from matplotlib.figure import Figure

    if len(states) != len(episode):
        raise ValueError(f"states has {len(states)} frames where episode has {len(episode)}; track the same episode")
    figure = Figure(figsize=(11, 6.4), dpi=120)
    grid = figure.add_gridspec(
        2, 12, height_ratios=(1.05, 1), left=0.07, right=0.98, top=0.95, bottom=0.08, hspace=0.12
    )
    moments = np.linspace(0, len(episode) - 1, 4).round().astype(int)
    named = long_lived(states)
    for column, frame in enumerate(moments):
        plot_cloth(
            episode.points[frame],
            episode.faces,
            loops=[loop for loop in states[frame].loops if loop.id in named],
            centre_line=episode.centre_line,
            thickness=rod_radius(episode),
            ax=figure.add_subplot(grid[0, 3 * column : 3 * column + 3], projection="3d"),
        ).set_title(f"{states[frame].time:.2f} s", fontsize="medium", y=-0.06)
    tracks = plot_tracks(states, figure.add_subplot(grid[1, :7]))
    for frame in moments:
        tracks.axvline(states[frame].time, color="0.6", linewidth=0.8, linestyle=":")
    plot_diagram(states[moments[2]], figure.add_subplot(grid[1, 8:])).set_title(
        f"diagram at {states[moments[2]].time:.2f} s", fontsize="medium"
    )
    return figure


def _axes(ax: Axes | None, **options: Any) -> Axes:
    """Return `ax`, or the axes of a new pyplot figure."""
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    axes: Axes = plt.figure(layout="constrained").add_subplot(**options)
    return axes


def _shaded(polygons: NDArray[np.float64], n_cloth: int, view: tuple[float, float]) -> NDArray[np.float64]:
    """(m, 3) colours of cloth faces, then of the rod's, in the light of `face_light`."""
    from matplotlib.colors import to_rgb

    base = np.array([to_rgb(_CLOTH)] * n_cloth + [to_rgb(_ROD)] * (len(polygons) - n_cloth)).reshape(-1, 3)
    light = face_light(polygons, view)
    shaded: NDArray[np.float64] = base * light[:, None]
    return shaded


def _frame(
    axes: Any, everything: NDArray[np.float64], view: tuple[float, float], zoom: float, focus: ArrayLike | None
) -> None:
    """Fit a 3D axes tightly around the points as the eye sees them, without box or ticks."""
    from mpl_toolkits.mplot3d.proj3d import proj_transform

    if not len(everything):
        everything = np.zeros((1, 3))
    low, high = everything.min(axis=0), everything.max(axis=0)
    size = np.maximum(high - low, 1e-3 * max(float((high - low).max()), 1e-6))
    middle = (low + high) / 2
    axes.set(**{f"{name}lim": (m - s / 2, m + s / 2) for name, m, s in zip("xyz", middle, size, strict=True)})
    axes.set_box_aspect(size)
    axes.view_init(elev=view[1], azim=view[0])
    axes.set_axis_off()
    # Matplotlib frames the box's diagonal; its flat view limits are set to what is seen, in a square.
    flat = np.array(proj_transform(*everything.T, axes.get_proj())[:2])
    half = 0.53 * float(np.ptp(flat, axis=1).max()) / zoom or 0.1
    centre = (flat.min(axis=1) + flat.max(axis=1)) / 2
    if focus is not None:
        centre = np.array(proj_transform(*np.asarray(focus, dtype=np.float64), axes.get_proj())[:2])
    axes.viewLim.intervalx, axes.viewLim.intervaly = (tuple(m + half * np.array([-1, 1])) for m in centre)
