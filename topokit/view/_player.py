"""Interactive figures of cloth: an episode with its loops, forecasts under several plans, and garments in the hand.

Idea: all that a figure shows is packed once, coordinates in 16 bits; `player.js` unpacks and draws it. Forecast clouds are sums
of a few modes, by a singular value decomposition. The figure shows one of the plans, never a blend of two (`plans.js`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit.io import Episode
from topokit.linking import close_far
from topokit.seqph import TopologicalState
from topokit.view._figure import HtmlFigure, pack_coordinates
from topokit.view._looks import cloth_marks
from topokit.view._plots import check_one_state_a_frame, lifetimes, long_lived, rod_radius, subdivide, triples

if TYPE_CHECKING:
    from topokit.sim import Garment

CLOTH_SCRIPTS = ("orbit.js", "mesh.js")  # they draw cloth that the reader turns


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
        Leave out the charts and play in a loop until the reader stops it. It does not start by itself when the reader's
        system is set to reduced motion.

    Raises
    ------
    ValueError
        When `states` has another length than the episode, or `start` is no frame of it.
    """
    check_one_state_a_frame(episode, states)
    if start is None:
        start = most_persistent_frame(states)
    if not 0 <= start < len(episode):
        raise ValueError(f"start must be a frame from 0 to {len(episode) - 1}, not {start}")
    data = _scene_data(episode)
    data["arrays"] |= _track_arrays(states)
    data["start"] = int(start)
    data["view"] = [float(view[0]), float(view[1])]
    data["long"] = list(long_lived(states))
    data["show_truth"] = bool(show_truth)
    data["film"] = bool(film)
    title = f"{episode.garment}, {episode.target}"
    return HtmlFigure.from_parts(
        "player", data, scripts=CLOTH_SCRIPTS, height=height, caption=title, title=f"Player: {title}"
    )


def most_persistent_frame(states: Sequence[TopologicalState]) -> int:
    """Return the frame at which the longest-lived identity has its longest lifetime; 0 when there are no loops."""
    names = long_lived(states)
    return int(np.nanargmax(lifetimes(states)[names[0]])) if names else 0


def plans(
    episode: Episode, frame: int, actions: ArrayLike, clouds: ArrayLike, ahead: ArrayLike, cycle: ArrayLike
) -> HtmlFigure:
    """Return an interactive figure of forecasts from one moment of a film, under plans that end at different places.

    The reader moves the plan's end and the horizon; cloth, loop and linking number follow. A map shows which of the plans have
    the loop around the target at that horizon. No vertex is off its forecast by more than 5 mm.

    Parameters
    ----------
    episode : Episode
    frame : int
        The current frame of the episode, from which the forecasts start.
    actions : (R, C, T, 2, 3) array_like
        Places of the two grippers in the next T frames, metres, under R x C plans: rows from low to high, columns sideways.
    clouds : (R, C, K, n, 3) array_like
        The forecast vertices, metres; between the given frames they move along straight lines.
    ahead : (K,) array_like of int
        The number of frames ahead of each forecast, ascending; the last is T.
    cycle : (L,) array_like of int
        The loop's vertices.

    Raises
    ------
    ValueError
        When the numbers of plans, frames or vertices differ, or the episode ends before the plans.
    """
    paths = np.asarray(actions, dtype=np.float64)
    forecasts = np.asarray(clouds, dtype=np.float64)
    knots = np.asarray(ahead, dtype=np.int64)
    now = episode.points[frame]
    rows, columns = paths.shape[:2]
    horizon = int(knots[-1])
    path_shape = (rows, columns, horizon, 2, 3)
    cloud_shape = (rows, columns, len(knots), *now.shape)
    if paths.shape != path_shape or forecasts.shape != cloud_shape or frame + horizon >= len(episode):
        raise ValueError(
            f"actions and clouds must have the shapes {path_shape} and {cloud_shape}, of {horizon} frames after "
            f"{frame} of {len(episode)}, not {paths.shape} and {forecasts.shape}"
        )

    # Vertices and grippers together become sums of few modes: now, then at each knot.
    later = np.concatenate([forecasts, paths[:, :, knots - 1]], axis=3)
    first = np.concatenate([now, episode.grippers[frame]])
    first = np.broadcast_to(first, (rows, columns, 1, *first.shape))
    shares, modes = low_rank(np.concatenate([first, later], axis=2).reshape(-1, *first.shape[3:]))

    held = episode.held[frame : frame + horizon + 1]
    scene = _scene_data(replace(episode, points=forecasts[0, 0], held=held))
    arrays = {name: scene["arrays"][name] for name in ("faces", "line", "held")}
    arrays |= _track_arrays([])
    arrays["shares"] = pack_coordinates(shares.reshape(len(shares), -1, 3))
    arrays["modes"] = pack_coordinates(modes)
    middle_end = paths[rows // 2, columns // 2, -1]
    x, y, _ = (episode.grippers[frame] - middle_end).mean(axis=0)
    data = scene | {
        "frames": len(held),
        "start": 0,
        "view": [float(np.degrees(np.arctan2(y, x))) - 35, 18.0],  # from behind, a little to the side
        "long": [],
        "plans": {
            "rows": rows,
            "columns": columns,
            "knots": [0, *knots.tolist()],
            "vertices": len(now),
            "cycle": np.asarray(cycle).tolist(),
            "target": close_far(episode.centre_line).tolist(),
        },
        "arrays": arrays,
    }
    caption = f"{episode.garment}, {episode.target}: {rows * columns} plans"
    scripts = (*CLOTH_SCRIPTS, "link.js", "planar.js", "plans.js")
    return HtmlFigure.from_parts(
        "player", data, scripts=scripts, height=520, caption=caption, title=f"Forecasts of {caption}"
    )


def low_rank(clouds: NDArray[np.float64], tolerance: float = 0.005) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return clouds (m, n, 3) as shares (m, q) of the fewest modes (r, n, 3) within a tolerance for every point.

    q is r rounded up to a multiple of three, so that shares can be packed as coordinates.
    """
    rest = clouds.reshape(len(clouds), -1)
    left, sizes, modes = np.linalg.svd(rest, full_matrices=False)
    shares = left * sizes
    rank = 0
    while rank < len(sizes) and np.linalg.norm(rest.reshape(clouds.shape), axis=-1).max() > tolerance:
        rest = rest - np.outer(shares[:, rank], modes[rank])
        rank += 1
    padded = np.pad(shares[:, :rank], ((0, 0), (0, -rank % 3)))
    return padded, modes[:rank].reshape(rank, *clouds.shape[1:])


def wardrobe(garments: Mapping[str, Garment], *, height: int = 480, title: str = "turn it") -> HtmlFigure:
    """Return an interactive figure of garments, one at a time and in the hand, with their true loops in colours.

    Parameters
    ----------
    garments : mapping of str to topokit.sim.Garment
        The garments by name, of which the reader chooses one; the first is shown first.
    height : int
        Height of the frame in CSS pixels.
    title : str
        The caption in the corner of the figure.

    Raises
    ------
    ValueError
        When there is no garment.
    """
    if not garments:
        raise ValueError("garments is empty; give at least one garment")
    meshes = []
    for name, garment in garments.items():
        mesh, arrays = _mesh_data(garment.vertices[None], garment.faces, garment.loops)
        meshes.append({"name": str(name), **mesh, **arrays})
    data = {"garments": meshes, "view": [-65.0, 18.0]}
    scripts = (*CLOTH_SCRIPTS, "planar.js")
    names = ", ".join(garments)
    return HtmlFigure.from_parts(
        "wardrobe", data, scripts=scripts, height=height, caption=title, title=f"Wardrobe: {names}"
    )


# ---- the data of a page --------------------------------------------------------------------------------------------


def _mesh_data(
    points: NDArray[np.floating[Any]], faces: ArrayLike, loops: Iterable[ArrayLike]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the data of a mesh with vertices (T, N, 3), and its arrays."""
    low = points.min(axis=(0, 1))
    high = points.max(axis=(0, 1))
    corners = np.asarray(faces, dtype=np.int64).reshape(-1, 3)
    marks = cloth_marks(np.asarray(points[0], dtype=np.float64), corners, smooth=True)
    mesh = {
        "frames": len(points),
        "centre": ((low + high) / 2).tolist(),
        "radius": float(np.linalg.norm(high - low) / 2) or 1.0,
        "marks": [{"face": face, "ends": pack_coordinates(ends), "bright": bright} for face, ends, bright in marks],
        "truth": [np.asarray(loop).tolist() for loop in loops],
    }
    return mesh, {"points": pack_coordinates(points), "faces": corners}


def _scene_data(episode: Episode) -> dict[str, Any]:
    mesh, arrays = _mesh_data(np.asarray(episode.points, dtype=np.float64), episode.faces, episode.loops)
    arrays["line"] = pack_coordinates(subdivide(triples(episode.centre_line, "centre_line")))
    arrays["grippers"] = pack_coordinates(episode.grippers)
    arrays["held"] = np.asarray(episode.held, dtype=bool)
    return {**mesh, "dt": float(episode.dt), "unit": "m", "thickness": rod_radius(episode), "arrays": arrays}


def _track_arrays(states: Sequence[TopologicalState]) -> dict[str, Any]:
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
