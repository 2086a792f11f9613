"""A recording for the Rerun viewer: clouds, loops, target and plan over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from topokit._archive import atomic_file
from topokit.io import Episode
from topokit.seqph import Loop, TopologicalState
from topokit.view._plots import ROD, check_one_state_a_frame, loop_colour

_GREY, _ROD = (138, 147, 160), tuple(bytes.fromhex(ROD[1:]))  # of what is no loop: seen on white and on black


def rerun(film: Episode | Sequence[ArrayLike], states: Sequence[TopologicalState], path: str | Path) -> Path:
    """Write what was tracked as a recording that Rerun's viewer opens (``rerun tracks.rrd``).

    Each identity has its colour, killer triangles, cycle, and curve of lifetimes; an episode also its target and its grippers,
    with what they will be told.

    Parameters
    ----------
    film : Episode or sequence of (n, 3) array_like
    states : sequence of TopologicalState
        One a frame, as `topokit.track` returns them.
    path : str or Path

    Raises
    ------
    ImportError, ValueError
        When Rerun is not installed; when there is not one state a frame.
    """
    rr, episode = sdk(), film if isinstance(film, Episode) else None
    clouds: Any = film if episode is None else episode.points
    check_one_state_a_frame(clouds, states)
    with atomic_file(path) as file, rr.RecordingStream("topokit") as stream:
        recorded = stream.binary_stream()
        curves = rr.blueprint.TimeSeriesView(origin="lifetimes", name="lifetimes, metres")
        shown = rr.blueprint.Horizontal(rr.blueprint.Spatial3DView(name="scene"), curves, column_shares=[2, 1])
        stream.send_blueprint(rr.blueprint.Blueprint(shown, collapse_panels=True))
        if episode is not None:
            stream.log("target", rr.LineStrips3D([episode.centre_line], colors=_ROD), static=True)
        for t, state in enumerate(states):
            stream.set_time("frame", sequence=state.frame)
            stream.set_time("time", duration=state.time)
            if episode is not None:
                stream.log("grippers", rr.Points3D(episode.grippers[t], radii=0.01, colors=_ROD))
                stream.log("plan", rr.LineStrips3D(np.moveaxis(episode.actions[t:], 1, 0), colors=_GREY))
            stream.log("cloud", rr.Points3D(clouds[t], colors=_GREY))
            before = states[t - 1].loops if t else ()
            for gone in {loop.id for loop in before} - {loop.id for loop in state.loops}:
                for place in ("loops", "lifetimes"):
                    stream.log(f"{place}/{gone}", rr.Clear(recursive=True))
            for loop in state.loops:
                _log(rr, stream, loop)
        file.write(recorded.read() or b"")
    return Path(path)


def sdk() -> Any:
    """Rerun, or what to install."""
    try:
        import rerun
    except ModuleNotFoundError as error:
        raise ImportError("topokit.view.rerun needs rerun: pip install 'topokit[rerun]'") from error
    return rerun


def _log(rr: Any, stream: Any, loop: Loop) -> None:
    place, colour = f"loops/{loop.id}", [list(bytes.fromhex(loop_colour(loop.id)[1:]))]
    closed = np.concatenate([loop.cycle_points, loop.cycle_points[:1]])
    stream.log(f"{place}/cycle", rr.LineStrips3D([closed], colors=colour, labels=f"loop {loop.id}"))
    stream.log(f"{place}/killer", rr.LineStrips3D(loop.killer_triangles[:, [0, 1, 2, 0]], colors=colour))
    curve = rr.SeriesLines(colors=colour, names=f"loop {loop.id}")
    stream.log(f"lifetimes/{loop.id}", rr.Scalars(loop.lifetime), curve)
