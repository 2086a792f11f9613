"""Matplotlib pictures of loops: the diagram of a frame, lifetimes over time, both beside the cloth. Taught in chapter 0."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from topokit.io import Episode
from topokit.rips import Diagram
from topokit.state import TopologicalState
from topokit.view._cloth import one_a_frame, plot_cloth, rod_radius
from topokit.view._palette import long_lived, loop_colour, new_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_GREY = "0.55"


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
    """
    axes = new_axes(ax)
    if isinstance(diagram, TopologicalState):
        points = [(loop.birth, loop.death, loop_colour(loop.id), f"loop {loop.id}") for loop in diagram.loops]
        alpha = diagram.parameters.get("alpha") if alpha is None else alpha
    else:
        points = [(float(b), float(d), loop_colour(1), "") for b, d in zip(diagram.birth, diagram.death, strict=True)]
    finite = [value for birth, death, _, _ in points for value in (birth, death) if np.isfinite(value)]
    high = 1.12 * max([*finite, 2 * (alpha or 0.0)]) or 1.0
    axes.plot([0, high], [0, high], color=_GREY, linewidth=1, label="birth = death")
    if alpha:
        axes.plot([0, high - alpha], [alpha, high], color=_GREY, linewidth=1, linestyle="--", label="lifetime = alpha")
    longest = max((death - birth for birth, death, _, _ in points), default=0.0)
    for birth, death, colour, name in points:
        _draw_loop(axes, birth, death, high, colour, name)
        if name and death - birth >= longest / 2:
            axes.annotate(name, (birth, death), xytext=(8, 0), textcoords="offset points", va="center")
    axes.set(xlabel="birth (m)", ylabel="death (m)", xlim=(0, high), ylim=(0, high), aspect="equal")
    return axes


def _draw_loop(axes: Axes, birth: float, death: float, high: float, colour: str, name: str) -> None:
    """A loop that no edge has ended yet stands on the upper border."""
    alive = not np.isfinite(death)
    style: dict[str, Any] = {"color": colour, "markersize": 7 if name else 5, "alpha": 1.0 if name else 0.8}
    axes.plot(birth, high if alive else death, "^" if alive else "o", markeredgecolor="white", mew=0.4, **style)


def plot_tracks(states: Sequence[TopologicalState], ax: Axes | None = None) -> Axes:
    """Draw the lifetime of every identity over time, the weighty ones boldly and by name, the rest faintly.

    A line is broken where its loop is not there; a loop of a single frame is a dot.

    Parameters
    ----------
    states : sequence of TopologicalState
        In order.
    ax : matplotlib Axes, optional
        A new figure's when not given.
    """
    axes = new_axes(ax)
    times = np.array([state.time for state in states])
    named = long_lived(states)
    lifetimes: dict[int, NDArray[np.float64]] = {}
    for position, state in enumerate(states):
        for loop in state.loops:
            lifetimes.setdefault(loop.id, np.full(len(states), np.nan))[position] = loop.lifetime
    for loop_id in sorted(lifetimes, key=lambda i: i in named):
        _draw_track(axes, times, lifetimes[loop_id], loop_id, bold=loop_id in named)
    axes.set(xlabel="time (s)", ylabel="lifetime (m)")
    axes.set_ylim(0.0, 1.25 * max((np.nanmax(v) for v in lifetimes.values()), default=0.8))
    return axes


def _draw_track(
    axes: Axes, times: NDArray[np.float64], values: NDArray[np.float64], loop_id: int, *, bold: bool
) -> None:
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

    This is what `topokit track --plot` saves. The figure belongs to no window: a notebook shows it when it is the value
    of a cell, and nothing has to be closed.

    Parameters
    ----------
    episode : Episode
        Its cloth and its target are drawn.
    states : sequence of TopologicalState
        One a frame, as `topokit.track` returns them.
    """
    from matplotlib.figure import Figure

    one_a_frame(episode, states)
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
    diagram = plot_diagram(states[moments[2]], figure.add_subplot(grid[1, 8:]))
    diagram.set_title(f"diagram at {states[moments[2]].time:.2f} s", fontsize="medium")
    return figure
