"""Matplotlib pictures of loops in numbers: the diagram of a frame, lifetimes over time.

An identity has one colour in all pictures: loop 3 looks the same in the diagram, on the cloth, in the player and in the next
chapter.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from topokit._validate import Array
from topokit.rips import Diagram
from topokit.seqph import TopologicalState

from ._looks import loop_colour


def lifetimes(states: Sequence[TopologicalState]) -> dict[int, Array]:
    """Return the lifetime of each identity in each of the states, nan where it is missing, in order of first appearance."""
    table: dict[int, Array] = {}
    for position, state in enumerate(states):
        for loop in state.loops:
            table.setdefault(loop.id, np.full(len(states), np.nan))[position] = loop.lifetime
    return table


def long_lived(states: Sequence[TopologicalState]) -> tuple[int, ...]:
    """Return the identities that get a name in a picture, by the sum of their lifetimes over the states, largest first."""
    total = {loop_id: float(np.nansum(values)) for loop_id, values in lifetimes(states).items()}
    least = 0.2 * max(total.values(), default=0.0)
    named = [loop_id for loop_id in total if total[loop_id] >= least]
    return tuple(sorted(named, key=lambda loop_id: (-total[loop_id], loop_id)))


def new_axes(ax: Axes | None, **options: Any) -> Axes:
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    return plt.figure(layout="constrained").add_subplot(**options)


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
        # A triangle at the top is a loop that no edge has ended yet.
        marker = "^" if np.isinf(death) else "o"
        height = min(death, high)
        style: dict[str, Any] = {"markersize": 7} if name else {"markersize": 5, "alpha": 0.8}
        axes.plot(birth, height, marker, color=colour, markeredgecolor="white", mew=0.4, **style)
        if name and death - birth >= longest / 2:
            axes.annotate(name, (birth, death), xytext=(8, 0), textcoords="offset points", va="center")
    axes.set(xlabel="birth", ylabel="death", xlim=(0, high), ylim=(0, high), aspect="equal")
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
        values = table[loop_id]
        present = np.flatnonzero(np.isfinite(values))
        style: dict[str, Any] = {"color": loop_colour(loop_id), "marker": "." if len(present) == 1 else None}
        if loop_id not in named:
            axes.plot(times, values, label=f"_{loop_id}", alpha=0.35, linewidth=1.0, **style)
            continue
        name = f"loop {loop_id}"
        axes.plot(times, values, label=name, linewidth=2.2, **style)
        middle = present[len(present) // 2]
        offset: dict[str, Any] = {"xytext": (0, 7), "textcoords": "offset points", "ha": "center"}
        axes.annotate(name, (times[middle], values[middle]), color=style["color"], **offset)
    axes.set(xlabel="time", ylabel="lifetime")
    axes.set_ylim(0.0, 1.25 * max((np.nanmax(v) for v in table.values()), default=0.8))
    return axes
