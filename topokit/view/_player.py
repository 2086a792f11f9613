"""The player: an interactive figure of an episode with its loops, which `player.js` draws."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from topokit.io import Episode
from topokit.seqph import TopologicalState

from ._cloth import subdivide
from ._diagrams import lifetimes, long_lived
from ._figure import HtmlFigure, pack_coordinates


def player(
    episode: Episode,
    states: Sequence[TopologicalState],
    *,
    height: int = 520,
    start: int | None = None,
    view: tuple[float, float] = (-60.0, 15.0),
    show_truth: bool = False,
    film: bool = False,
) -> HtmlFigure:
    """Return an interactive figure of an episode: the cloth, its loops, their diagram and their lifetimes over time.

    Parameters
    ----------
    episode : Episode
        The figure shows its cloth, its target and its grippers.
    states : sequence of TopologicalState
        States of all frames, in order, as `topokit.track` returns them.
    height : int
        Height of the frame in CSS pixels.
    start : int, optional
        The frame shown first; by default the one where the longest-lived loop has its longest lifetime.
    view : (2,) float
        Azimuth and elevation of the eye in degrees, as in Matplotlib's `view_init`.
    show_truth : bool
        Show the garment's true loops at first; the reader can turn them on and off.
    film : bool
        Leave out the charts, show points until the reader asks for the cloth, and play in a loop until the reader stops it.
        It does not start by itself when the reader's system is set to reduced motion.
    """
    if len(states) != len(episode):
        raise ValueError(f"states has {len(states)} frames where episode has {len(episode)}; track the same episode")
    named = long_lived(states)
    if start is None:
        start = int(np.nanargmax(lifetimes(states)[named[0]])) if named else 0
    cloth = HtmlFigure.cloth(episode.points, episode.faces, episode.loops)
    arrays = {"points": cloth.pop("points"), "faces": cloth.pop("faces"), **_tracks(states)}
    arrays["line"] = pack_coordinates(subdivide(np.asarray(episode.centre_line, dtype=float)))
    arrays["grippers"] = pack_coordinates(episode.grippers)
    arrays["held"] = np.asarray(episode.held, dtype=bool)
    data = {
        **cloth,
        "arrays": arrays,
        "dt": float(episode.dt),
        "unit": "m",
        "thickness": float(episode.physics.get("target", {}).get("radius", 0.01)),
        "start": int(start),
        "view": list(view),
        "long": list(named),
        "show_truth": show_truth,
        "film": film,
    }
    title = f"{episode.garment}, {episode.target}"
    scripts = ("orbit.js", "mesh.js")
    return HtmlFigure.from_parts(
        "player", data, scripts=scripts, height=height, caption=title, title=f"Player: {title}"
    )


def _tracks(states: Sequence[TopologicalState]) -> dict[str, Any]:
    """Return the loops of all frames in one table; the loops of frame t are its rows first[t] to first[t + 1]."""
    loops = [loop for state in states for loop in state.loops]
    corners = [np.concatenate([loop.killer_edge_points, loop.killer_triangles.reshape(6, 3)]) for loop in loops]
    return {
        "first": np.cumsum([0] + [len(state.loops) for state in states]),
        "id": np.array([loop.id for loop in loops], dtype=np.int64),
        "birth": np.array([loop.birth for loop in loops], dtype=np.float64),
        "death": np.array([loop.death for loop in loops], dtype=np.float64),
        "killer": pack_coordinates(np.array(corners, dtype=np.float64).reshape(-1, 8, 3)),
        "alpha": np.array([float(state.parameters.get("alpha") or 0.0) for state in states]),
    }
