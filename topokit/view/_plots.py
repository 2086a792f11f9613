"""Matplotlib pictures: a cloth with its loops, the diagram of a frame, lifetimes over time.

An identity has one colour in all pictures: loop 3 looks the same in the diagram, on the cloth, in the player and in the next
chapter. `Scene` checks once, for this module and for `_render`, what a picture of a cloth shows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from mpl_toolkits.mplot3d.proj3d import proj_transform
from numpy.typing import ArrayLike, NDArray

from topokit._validate import Array, Ids, as_ids, as_points, as_reals
from topokit.io import Episode
from topokit.rips import Diagram
from topokit.seqph import Loop, TopologicalState
from topokit.view._looks import cloth_marks, face_normals, loop_colour, shadow, smoothed

CLOTH = "#E8E2D4"
LINING = "#C8C9D0"  # the inner side of cloth
ROD = "#5B6B7C"
INK = "#1C2733"

# ---- identities over time ------------------------------------------------------------------------------------------


def lifetimes(states: Sequence[TopologicalState]) -> dict[int, Array]:
    """Return the lifetime of each identity in each of the states, nan where it is missing, in order of first appearance."""
    table: dict[int, Array] = {}
    for position, state in enumerate(states):
        for loop in state.loops:
            table.setdefault(loop.id, np.full(len(states), np.nan))[position] = loop.lifetime
    return table


def appearances(states: Sequence[TopologicalState]) -> dict[int, Ids]:
    """Return the positions in `states` at which each identity is present, in order of first appearance.

    Parameters
    ----------
    states : sequence of TopologicalState
    """
    return {loop_id: np.flatnonzero(~np.isnan(values)) for loop_id, values in lifetimes(states).items()}


def long_lived(states: Sequence[TopologicalState]) -> tuple[int, ...]:
    """Return the identities that get a name in a picture, by the sum of their lifetimes over the states, largest first."""
    total = {loop_id: float(np.nansum(values)) for loop_id, values in lifetimes(states).items()}
    least = 0.2 * max(total.values(), default=0.0)
    named = [loop_id for loop_id in total if total[loop_id] >= least]
    return tuple(sorted(named, key=lambda loop_id: (-total[loop_id], loop_id)))


# ---- the scene -----------------------------------------------------------------------------------------------------


def new_axes(ax: Axes | None, **options: Any) -> Axes:
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    return plt.figure(layout="constrained").add_subplot(**options)


@dataclass(eq=False)
class Scene:
    """A cloth with its loops and its target, and the eye that looks at them."""

    points: Any  #: (N, 3) array_like, metres, z up
    faces: Any = ()  #: (F, 3) array_like of int; without faces only the points are drawn
    _: KW_ONLY
    loops: Sequence[Loop] = ()  #: loops whose killer triangles and edges are drawn in the colour of the identity
    true_loops: Sequence[ArrayLike] = ()  #: closed cycles of vertex ids, (L,) each, drawn as dark lines
    centre_line: Any = None  #: (K, 3) array_like, the target's, drawn as a rod unless there are `rods`
    rods: Sequence[tuple[ArrayLike, ArrayLike, float]] = ()  #: start, end, radius of the target's capsules, in metres
    thickness: float = 0.01  #: radius of the rod around `centre_line`
    rest: Any = None  #: (N, 3) array_like, the cloth lying smooth, on which its check is measured; default `points`
    view: tuple[float, float] = (-60.0, 15.0)  #: azimuth and elevation of the eye in degrees
    zoom: float = 1.0  #: enlargement of the fit around everything
    focus: Any = None  #: (3,) array_like, the middle of the picture; default the middle of everything

    def __post_init__(self) -> None:
        self.points = triples(as_points(self.points), "points")
        self.faces = as_ids(triples(self.faces, "faces", np.int64), "faces", len(self.points))
        rest = self.points if self.rest is None else triples(as_points(self.rest), "rest")
        if len(rest) != len(self.points):
            raise ValueError(f"rest has {len(rest)} points where the cloth has {len(self.points)}; pass another frame")
        self.marks = cloth_marks(rest, self.faces, smooth=self.rest is not None)
        self.shadow, self.darkness = shadow(self.points)
        if self.view[1] < 0:  # an eye below the floor does not see it
            self.shadow = self.shadow[:0]
        self.cycles = [self.points[np.append(ids, np.asarray(ids)[:1])] for ids in self.true_loops]
        line = triples(self.centre_line, "centre_line")
        capsules = [(triples(np.array(ends), "rods"), radius) for *ends, radius in self.rods]
        if not capsules and len(line) > 1:
            capsules = [(line, self.thickness)]
        self.capsules = capsules
        self.everything = np.concatenate([self.points, line, *(rod for rod, _ in capsules)])
        floor_in_view = self.everything[:, 2].min(initial=1.0) < 0.05
        if floor_in_view and len(self.shadow):
            self.everything = np.concatenate([self.everything, self.shadow[1]])


def triples(values: ArrayLike | None, name: str, kind: type[np.generic] = np.float64) -> NDArray[Any]:
    """Return points in space or triangles as (K, 3), K = 0 for None or nothing, or raise ValueError."""
    if values is None or not np.size(values):
        return np.zeros((0, 3), kind)
    array = as_reals(values, name).astype(kind)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name} must be a (K, 3) array, not of shape {array.shape}")
    return array


def check_one_state_a_frame(episode: Episode, states: Sequence[TopologicalState]) -> None:
    if len(states) != len(episode):
        raise ValueError(f"states has {len(states)} frames where episode has {len(episode)}; track the same episode")


def rod_radius(episode: Episode) -> float:
    """Return the radius of an episode's target in metres, 0.01 when its physics has none."""
    target = episode.physics.get("target")
    if isinstance(target, dict):
        return float(target.get("radius", 0.01))
    return 0.01


def direction(azimuth: float, elevation: float) -> Array:
    """Return the unit vector towards an eye at these degrees."""
    a, e = np.radians([azimuth, elevation])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


# ---- cloth ---------------------------------------------------------------------------------------------------------


def plot_cloth(points: ArrayLike, faces: ArrayLike = (), *, ax: Axes | None = None, **scene: Any) -> Axes:
    """Draw a cloth in space with the killer triangles of its loops, by Matplotlib alone; `render_cloth` draws it better.

    Parameters
    ----------
    points, faces : (N, 3) and (F, 3) array_like
        Vertices and triangles, as in `Scene`.
    ax : matplotlib Axes of projection "3d", default a new figure's
    **scene
        The other parameters of `Scene`.
    """
    checked = Scene(points, faces, **scene)
    axes = new_axes(ax, projection="3d")
    draw_cloth(axes, checked)
    return axes


def draw_cloth(axes: Any, scene: Scene) -> None:
    """Draw a scene in 3D axes: shadow, cloth and target, true loops, killers."""
    if not hasattr(axes, "add_collection3d"):
        raise ValueError("ax must be a 3D one: plt.figure().add_subplot(projection='3d')")
    axes.set_autoscale_on(False)  # `_fit` sets the limits
    axes.computed_zorder = False

    if len(scene.shadow):
        dark = (0, 0, 0, scene.darkness)
        axes.add_collection3d(Poly3DCollection(scene.shadow, zorder=0, rasterized=True, facecolors=dark))

    # Cloth and target are one collection, since Matplotlib sorts by depth only inside a collection. Lines are triangles of two
    # corners, since it would pad polygons of several lengths with uninitialised memory. Thousands of faces stay pixels in SVG.
    tubes = [tube(subdivide(line, 40), radius) for line, radius in scene.capsules]
    walls = np.concatenate([np.zeros((0, 3, 3)), *tubes])
    parts = [*_cloth(scene), (walls, _shaded(-face_normals(walls), ROD, scene.view))]
    polygons = np.concatenate([corners for corners, _ in parts])
    colours = np.concatenate([part_colours for _, part_colours in parts])
    look = {"facecolors": colours, "edgecolors": colours, "linewidths": 0.8}
    axes.add_collection3d(Poly3DCollection(polygons, zorder=1, rasterized=True, **look))
    if not len(scene.faces):
        axes.scatter(*scene.points.T, s=4, color=ROD, zorder=1, rasterized=True)

    for cycle in scene.cycles:
        axes.plot(*cycle.T, color=INK, linewidth=1.6, zorder=2)
    for loop in scene.loops:
        colour = loop_colour(loop.id)
        killers = Poly3DCollection(list(loop.killer_triangles), zorder=3)
        killers.set(facecolor=(colour, 0.45), edgecolor=colour)
        axes.add_collection3d(killers)
        axes.add_collection3d(Line3DCollection([loop.killer_edge_points], colors=colour, linewidths=3, zorder=4))
    _fit(axes, scene)


def _fit(axes: Any, scene: Scene) -> None:
    """Fit the axes tightly around everything from the eye's direction, without box or ticks."""
    everything = scene.everything
    if not len(everything):
        everything = np.zeros((1, 3))
    low = everything.min(axis=0)
    high = everything.max(axis=0)
    size = np.maximum(high - low, 1e-3 * max(float((high - low).max()), 1e-6))
    middle = (low + high) / 2
    axes.set(**{f"{name}lim": (m - s / 2, m + s / 2) for name, m, s in zip("xyz", middle, size, strict=True)})
    axes.set_box_aspect(size)
    axes.view_init(elev=scene.view[1], azim=scene.view[0])
    axes.set_axis_off()

    # Matplotlib frames the box's diagonal; its flat view limits become a square around the projected points.
    flat = np.array(proj_transform(*everything.T, axes.get_proj())[:2])
    half = 0.53 * float(np.ptp(flat, axis=1).max()) / scene.zoom or 0.1
    centre = (flat.min(axis=1) + flat.max(axis=1)) / 2
    if scene.focus is not None:
        centre = np.array(proj_transform(*scene.focus, axes.get_proj())[:2])
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


def _cloth(scene: Scene) -> Iterator[tuple[Array, Array]]:
    """Yield (m, 3, 3) corners and (m, 3) colours of faces, then of check and seams, lines as triangles of two corners."""
    corners = scene.points[scene.faces]
    flat = face_normals(corners)
    eye = direction(*scene.view)
    back = (flat @ eye < 0)[:, None]  # the eye sees the inner side
    normals = np.where(back, -1, 1) * smoothed(flat, scene.faces)
    colours = np.where(back, _shaded(normals, LINING, scene.view), _shaded(normals, CLOTH, scene.view))
    yield corners, colours
    lift = 0.015 * float(np.ptp(scene.points, axis=0).max(initial=0.0)) * eye  # sorted before its face
    for face, ends, bright in scene.marks:
        yield (ends @ corners[face] + lift)[:, [0, 1, 1]], bright * colours[face]


def _shaded(normals: Array, base: str, view: tuple[float, float]) -> Array:
    """Return (m, 3) colours of surfaces with one base colour, lit from above the eye's left shoulder."""
    lamp = direction(view[0] - np.degrees(0.6), min(view[1] + np.degrees(0.6), np.degrees(1.4)))
    return np.asarray(np.array(to_rgb(base)) * np.clip(0.55 + 0.5 * (normals @ lamp), 0.2, 1.0)[:, None])


# ---- diagrams and tracks -------------------------------------------------------------------------------------------


def plot_diagram(diagram: Diagram | TopologicalState, ax: Axes | None = None, *, alpha: float | None = None) -> Axes:
    """Draw a persistence diagram: a dot for each loop, death against birth, both half the length of an edge.

    Parameters
    ----------
    diagram : Diagram or TopologicalState
        The loops of a state have the colour of their identity, and the longest-lived also its name. The loops of a diagram
        have no identity and are drawn in one colour.
    ax : matplotlib Axes, default a new figure's
    alpha : float, optional
        The lifetime below which loops are dropped, drawn as a dashed line; default the state's.
    """
    axes = new_axes(ax)
    if isinstance(diagram, TopologicalState):
        points = [(loop.birth, loop.death, loop_colour(loop.id), f"loop {loop.id}") for loop in diagram.loops]
        if alpha is None:
            alpha = diagram.parameters.get("alpha")
    else:
        points = [(float(b), float(d), loop_colour(1), "") for b, d in zip(diagram.birth, diagram.death, strict=True)]
    finite = [value for birth, death, _, _ in points for value in (birth, death) if np.isfinite(value)]
    high = 1.12 * max([*finite, 2 * (alpha or 0.0)]) or 1.0
    axes.plot([0, high], [0, high], color="0.55", linewidth=1, label="birth = death")
    if alpha:
        axes.plot([0, high - alpha], [alpha, high], color="0.55", linewidth=1, linestyle="--", label="lifetime = alpha")
    longest = max((death - birth for birth, death, _, _ in points), default=0.0)
    for birth, death, colour, name in points:
        marker = "o"
        height = death
        if np.isinf(death):  # no edge has ended it yet
            marker = "^"
            height = high
        style: dict[str, Any] = {"markersize": 7} if name else {"markersize": 5, "alpha": 0.8}
        axes.plot(birth, height, marker, color=colour, markeredgecolor="white", mew=0.4, **style)
        if name and death - birth >= longest / 2:
            axes.annotate(name, (birth, death), xytext=(8, 0), textcoords="offset points", va="center")
    axes.set(xlabel="birth (m)", ylabel="death (m)", xlim=(0, high), ylim=(0, high), aspect="equal")
    return axes


def plot_tracks(states: Sequence[TopologicalState], ax: Axes | None = None) -> Axes:
    """Draw the lifetime of each identity over time, the longest-lived boldly and by name, the rest faintly.

    A line is broken where its loop is missing; a loop of a single frame is a dot.

    Parameters
    ----------
    states : sequence of TopologicalState
    ax : matplotlib Axes, default a new figure's
    """
    axes = new_axes(ax)
    times = np.array([state.time for state in states])
    named = long_lived(states)
    table = lifetimes(states)
    for loop_id in sorted(table, key=lambda i: i in named):
        _draw_track(axes, times, table[loop_id], loop_id, bold=loop_id in named)
    axes.set(xlabel="time (s)", ylabel="lifetime (m)")
    axes.set_ylim(0.0, 1.25 * max((np.nanmax(v) for v in table.values()), default=0.8))
    return axes


def _draw_track(axes: Axes, times: Array, values: Array, loop_id: int, *, bold: bool) -> None:
    present = np.flatnonzero(np.isfinite(values))
    colour = loop_colour(loop_id)
    marker = "." if len(present) == 1 else None
    if not bold:
        axes.plot(times, values, label=f"_{loop_id}", color=colour, marker=marker, alpha=0.35, linewidth=1.0)
        return
    name = f"loop {loop_id}"
    axes.plot(times, values, label=name, color=colour, marker=marker, linewidth=2.2)
    middle = present[len(present) // 2]
    offset: dict[str, Any] = {"xytext": (0, 7), "textcoords": "offset points", "ha": "center"}
    axes.annotate(name, (times[middle], values[middle]), color=colour, **offset)


def track_figure(episode: Episode, states: Sequence[TopologicalState]) -> Figure:
    """Return a picture of a tracked episode: the cloth at four moments, lifetimes over time, the diagram of a frame.

    Parameters
    ----------
    episode : Episode
        Its cloth and its target are drawn.
    states : sequence of TopologicalState
        One a frame, as `topokit.track` returns them.
    """
    check_one_state_a_frame(episode, states)
    figure = Figure(figsize=(11, 6.4), dpi=120)
    grid = figure.add_gridspec(2, 12, height_ratios=(21, 20), left=0.07, right=0.98, top=0.95, bottom=0.08, hspace=0.12)
    moments = np.linspace(0, len(episode) - 1, 4).round().astype(int)
    named = long_lived(states)
    for column, frame in enumerate(moments):
        plot_cloth(
            episode.points[frame],
            episode.faces,
            rest=episode.points[0],
            loops=[loop for loop in states[frame].loops if loop.id in named],
            centre_line=episode.centre_line,
            thickness=rod_radius(episode),
            ax=figure.add_subplot(grid[0, 3 * column : 3 * column + 3], projection="3d"),
        ).set_title(f"{states[frame].time:.2f} s", fontsize="medium", y=-0.06)
    tracks = plot_tracks(states, figure.add_subplot(grid[1, :7]))
    for frame in moments:
        tracks.axvline(states[frame].time, color="0.6", linewidth=0.8, linestyle=":")
    diagram = plot_diagram(states[moments[2]], figure.add_subplot(grid[1, 8:]))
    diagram.set_title(f"diagram at {states[moments[2]].time:.2f} s", fontsize="medium")
    return figure
