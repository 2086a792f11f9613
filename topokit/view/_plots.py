"""One colour for one identity, and Matplotlib pictures: a cloth with its loops, the diagram of a frame, lifetimes over time.

The six colours are those of Okabe and Ito that read on white and on near-black alike; they stay apart for the common kinds
of colour blindness. Loop 3 looks the same in the diagram, on the cloth, in the player and in the next chapter. What a picture
of a cloth shows is checked once, by `Scene`, for this module and for `_render`. Taught in chapter 0.
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
from topokit.seqph import Loop, TopologicalState, loop_colour
from topokit.view._looks import cloth_marks, face_normals, shadow, smoothed

CLOTH, LINING, ROD, INK = "#E8E2D4", "#C8C9D0", "#5B6B7C", "#1C2733"


def lifetimes(states: Sequence[TopologicalState]) -> dict[int, Array]:
    """For every identity, in order of first appearance, its lifetime in each of the states, nan where it is not there."""
    table: dict[int, Array] = {}
    for position, state in enumerate(states):
        for loop in state.loops:
            table.setdefault(loop.id, np.full(len(states), np.nan))[position] = loop.lifetime
    return table


def appearances(states: Sequence[TopologicalState]) -> dict[int, Ids]:
    """Return for every identity the positions in `states` at which it is there, identities in order of first appearance."""
    return {loop_id: np.flatnonzero(~np.isnan(values)) for loop_id, values in lifetimes(states).items()}


def long_lived(states: Sequence[TopologicalState]) -> tuple[int, ...]:
    """Identities worth a name in a picture, the weightiest first; each weighs the sum of its lifetimes over the states."""
    weight = {loop_id: float(np.nansum(values)) for loop_id, values in lifetimes(states).items()}
    least = 0.2 * max(weight.values(), default=0.0)
    return tuple(sorted((i for i in weight if weight[i] >= least), key=lambda i: (-weight[i], i)))


def new_axes(ax: Axes | None, **options: Any) -> Axes:
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    return plt.figure(layout="constrained").add_subplot(**options)


@dataclass(eq=False)
class Scene:
    """A cloth with its loops and its target, and the eye that sees them."""

    points: Any  #: (N, 3) array_like, metres, z up
    faces: Any = ()  #: (F, 3) array_like of int; the points alone are drawn when there are none
    _: KW_ONLY
    loops: Sequence[Loop] = ()  #: their killer triangles and edges are drawn in the colour of the identity
    true_loops: Sequence[ArrayLike] = ()  #: closed cycles of vertex ids, (L,) each, drawn as dark lines
    centre_line: Any = None  #: (K, 3) array_like, the target's, drawn as a rod; not drawn where there are `rods`
    rods: Sequence[tuple[ArrayLike, ArrayLike, float]] = ()  #: start, end, radius of the target's capsules, in metres
    thickness: float = 0.01  #: radius of the rod around `centre_line`
    rest: Any = None  #: (N, 3) array_like, the cloth lying smooth, where its check is measured; `points` when not given
    view: tuple[float, float] = (-60.0, 15.0)  #: azimuth and elevation of the eye in degrees
    zoom: float = 1.0  #: above one comes nearer than the fit around everything
    focus: Any = None  #: (3,) array_like, the middle of the picture; the middle of everything when not given

    def __post_init__(self) -> None:
        self.points = triples(as_points(self.points), "points")
        self.faces = as_ids(triples(self.faces, "faces", np.int64), "faces", len(self.points))
        rest = self.points if self.rest is None else triples(as_points(self.rest), "rest")
        if len(rest) != len(self.points):
            raise ValueError(f"rest has {len(rest)} points where the cloth has {len(self.points)}; pass another frame")
        self.marks = cloth_marks(rest, self.faces, smooth=self.rest is not None)
        self.shadow, self.darkness = shadow(self.points)
        self.cycles = [self.points[np.append(ids, np.asarray(ids)[:1])] for ids in self.true_loops]
        line = triples(self.centre_line, "centre_line")
        capsules = [(triples(np.array(ends), "rods"), radius) for *ends, radius in self.rods]
        self.capsules = capsules or [(line, self.thickness)] * (len(line) > 1)
        self.everything = np.concatenate([self.points, line, *(rod for rod, _ in capsules)])
        if self.everything[:, 2].min(initial=1.0) < 0.05:  # the floor is in view
            self.everything = np.concatenate([self.everything, *self.shadow[1:2]])


def triples(values: ArrayLike | None, name: str, kind: type[np.generic] = np.float64) -> NDArray[Any]:
    """Points in space or triangles as (K, 3), K = 0 for None or nothing; ValueError when they are none."""
    array = np.zeros((0, 3), kind) if values is None or not np.size(values) else as_reals(values, name).astype(kind)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name} must be a (K, 3) array, not of shape {array.shape}")
    return array


def check_one_state_a_frame(episode: Episode, states: Sequence[TopologicalState]) -> None:
    if len(states) != len(episode):
        raise ValueError(f"states has {len(states)} frames where episode has {len(episode)}; track the same episode")


def rod_radius(episode: Episode) -> float:
    """Radius of an episode's target in metres, 0.01 when its physics does not tell."""
    target = episode.physics.get("target")
    return float(target.get("radius", 0.01)) if isinstance(target, dict) else 0.01


def direction(azimuth: float, elevation: float) -> Array:
    """Unit vector towards an eye at these degrees."""
    a, e = np.radians([azimuth, elevation])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def plot_cloth(points: ArrayLike, faces: ArrayLike = (), *, ax: Axes | None = None, **scene: Any) -> Axes:
    """Draw a cloth in space with the killer triangles of its loops, by Matplotlib alone; `render_cloth` draws it better.

    Parameters
    ----------
    points, faces : (N, 3) and (F, 3) array_like
        As of `Scene`.
    ax : matplotlib Axes of projection "3d", default a new figure's
    **scene
        What else is drawn, and from where: the other parameters of `Scene`.
    """
    checked = Scene(points, faces, **scene)
    axes = new_axes(ax, projection="3d")
    draw_cloth(axes, checked)
    return axes


def draw_cloth(axes: Any, scene: Scene) -> None:
    if not hasattr(axes, "add_collection3d"):
        raise ValueError("ax must be a 3D one: plt.figure().add_subplot(projection='3d')")
    axes.set_autoscale_on(False)  # `_fit` sets the limits
    axes.computed_zorder = False
    # In SVG thousands of faces stay pixels.
    # Matplotlib sorts by depth only inside a collection; it would pad faces of several lengths with what is in memory.
    rods = np.concatenate([np.zeros((0, 3, 3)), *(tube(subdivide(line, 40), r) for line, r in scene.capsules)])
    parts = [*_cloth(scene), (rods, _shaded(-face_normals(rods), ROD, scene.view))]
    polygons, colours = (np.concatenate(part) for part in zip(*parts, strict=True))
    if len(scene.shadow):
        dark = {"facecolors": (0, 0, 0, scene.darkness)}
        axes.add_collection3d(Poly3DCollection(scene.shadow, zorder=0, rasterized=True, **dark))
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
    """Fit the axes tightly around everything as the eye sees it, without box or ticks."""
    everything = scene.everything if len(scene.everything) else np.zeros((1, 3))
    low, high = everything.min(axis=0), everything.max(axis=0)
    size = np.maximum(high - low, 1e-3 * max(float((high - low).max()), 1e-6))
    middle = (low + high) / 2
    axes.set(**{f"{name}lim": (m - s / 2, m + s / 2) for name, m, s in zip("xyz", middle, size, strict=True)})
    axes.set_box_aspect(size)
    axes.view_init(elev=scene.view[1], azim=scene.view[0])
    axes.set_axis_off()
    # Matplotlib frames the box's diagonal; its flat view limits are set to what is seen, in a square.
    flat = np.array(proj_transform(*everything.T, axes.get_proj())[:2])
    half = 0.53 * float(np.ptp(flat, axis=1).max()) / scene.zoom or 0.1
    centre = (flat.min(axis=1) + flat.max(axis=1)) / 2
    if scene.focus is not None:
        centre = np.array(proj_transform(*scene.focus, axes.get_proj())[:2])
    axes.viewLim.intervalx, axes.viewLim.intervaly = (tuple(m + half * np.array([-1, 1])) for m in centre)


def subdivide(line: Array, pieces: int = 60) -> Array:
    """Cut a (K, 3) polyline into short pieces, so that sorting them by depth puts each before or behind the cloth."""
    if len(line) < 2:
        return line
    walked = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    places = np.union1d(np.linspace(0.0, walked[-1], pieces), walked)
    return np.stack([np.interp(places, walked, line[:, axis]) for axis in range(3)], axis=1)


def tube(line: Array, radius: float, sides: int = 8) -> Array:
    """(m, 3, 3) the triangles of a tube around a polyline; one normal is carried along it, so that the tube does not twist."""
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
    turned = np.roll(ring, -1, axis=1)
    halves = [ring[:-1], ring[1:], turned[1:]], [ring[:-1], turned[1:], turned[:-1]]
    return np.concatenate([np.stack(half, axis=2).reshape(-1, 3, 3) for half in halves])


def _cloth(scene: Scene) -> Iterator[tuple[Array, Array]]:
    """(m, 3, 3) and (m, 3): faces and their colours, then the check's and the seams', a line as a triangle of two corners."""
    corners = scene.points[scene.faces]
    flat, eye = face_normals(corners), direction(*scene.view)
    back = (flat @ eye < 0)[:, None]
    normals = np.where(back, -1, 1) * smoothed(flat, scene.faces)
    colours = np.where(back, *(_shaded(normals, base, scene.view) for base in (LINING, CLOTH)))
    yield corners, colours
    lift = 0.015 * float(np.ptp(scene.points, axis=0).max(initial=0.0)) * eye  # sorted before its face
    for face, ends, bright in scene.marks:
        yield (ends @ corners[face] + lift)[:, [0, 1, 1]], bright * colours[face]


def _shaded(normals: Array, base: str, view: tuple[float, float]) -> Array:
    """(m, 3) colours of surfaces of one base colour, lit from above the eye's left shoulder."""
    lamp = direction(view[0] - np.degrees(0.6), min(view[1] + np.degrees(0.6), np.degrees(1.4)))
    return np.asarray(np.array(to_rgb(base)) * np.clip(0.55 + 0.5 * (normals @ lamp), 0.2, 1.0)[:, None])


def plot_diagram(diagram: Diagram | TopologicalState, ax: Axes | None = None, *, alpha: float | None = None) -> Axes:
    """Draw a persistence diagram: one dot a loop, birth against death, both half the length of an edge.

    Parameters
    ----------
    diagram : Diagram or TopologicalState
        The loops of a state have the colour of their identity and, when they live longer than the rest, its name; those
        of a diagram have no identity and are drawn in one colour.
    ax : matplotlib Axes, default a new figure's
    alpha : float, optional
        Lifetime below which loops are dropped, drawn as a dashed line; that of the state when not given.
    """
    axes = new_axes(ax)
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
        marker, height = ("o", death) if np.isfinite(death) else ("^", high)  # no edge has ended it yet
        style: dict[str, Any] = {"color": colour, "markersize": 7 if name else 5, "alpha": 1.0 if name else 0.8}
        axes.plot(birth, height, marker, markeredgecolor="white", mew=0.4, **style)
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
    there, colour = np.flatnonzero(np.isfinite(values)), loop_colour(loop_id)
    look: dict[str, Any] = {"alpha": 1.0, "linewidth": 2.2} if bold else {"alpha": 0.35, "linewidth": 1.0}
    marker = "." if len(there) == 1 else None
    axes.plot(times, values, label=f"loop {loop_id}" if bold else f"_{loop_id}", color=colour, marker=marker, **look)
    if bold:
        middle = there[len(there) // 2]
        offset: dict[str, Any] = {"xytext": (0, 7), "textcoords": "offset points", "ha": "center"}
        axes.annotate(f"loop {loop_id}", (times[middle], values[middle]), color=colour, **offset)


def track_figure(episode: Episode, states: Sequence[TopologicalState]) -> Figure:
    """Return one picture of a tracked episode: the cloth at four moments, lifetimes over time, the diagram of a frame.

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
