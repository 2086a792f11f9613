"""The figure that plays an episode and its loops, without a kernel; and forecasts under plans that bend.

Idea: everything it shows is packed once, coordinates in 16 bits and base64; `player.js` unpacks and draws it. Forecast clouds
are sums of a few modes, by a singular value decomposition. One of the plans is shown, never a blend of two (`plans.js`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit.io import Episode
from topokit.linking import close_far
from topokit.seqph import Loop, TopologicalState
from topokit.view._looks import cloth_marks
from topokit.view._packed import pack, pack_coordinates
from topokit.view._pages import Framed, framed
from topokit.view._plots import lifetimes, long_lived, one_a_frame, rod_radius, subdivide, triples

if TYPE_CHECKING:
    from topokit.sim import Garment

Points = NDArray[np.floating[Any]]
SPACE = ("orbit.js", "mesh.js")  # the scripts that draw cloth under a hand


def player(
    episode: Episode,
    states: Sequence[TopologicalState],
    *,
    height: int = 520,
    start: int | None = None,
    view: tuple[float, float] = (-60.0, 15.0),
    show_truth: bool = False,
    film: bool = False,
) -> Framed:
    """Return an interactive figure of an episode: the cloth, its loops, their diagram and their lifetimes over time.

    Parameters
    ----------
    episode : Episode
        Its cloth, its target and its grippers are drawn.
    states : sequence of TopologicalState
        One a frame, in order, as `topokit.track` returns them.
    height : int
        Height of the frame in CSS pixels.
    start : int, optional
        The frame shown before anyone touches the figure; the one where the weightiest loop lives longest by default.
    view : (2,) float
        Azimuth and elevation of the eye in degrees, as in Matplotlib's `view_init`.
    show_truth : bool
        Whether the garment's true loops are drawn from the start; the reader can turn them on and off.
    film : bool
        Without the charts, and playing again and again until a hand stops it, unless the reader asked for less motion.

    Raises
    ------
    ValueError
        When `states` has another length than the episode, or `start` is no frame of it.
    """
    one_a_frame(episode, states)
    start = telling_frame(states) if start is None else start
    if not 0 <= start < len(episode):
        raise ValueError(f"start must be a frame from 0 to {len(episode) - 1}, not {start}")
    title = f"{episode.garment}, {episode.target}"
    told = {"start": int(start), "view": [float(view[0]), float(view[1])], "long": list(long_lived(states))}
    data = _scene(episode) | told | {"show_truth": bool(show_truth), "film": bool(film)}
    data["arrays"] |= _tracks(states)
    return framed("player", SPACE, data, height, title, f"Player: {title}")


def plans(
    episode: Episode, frame: int, actions: ArrayLike, clouds: ArrayLike, ahead: ArrayLike, cycle: ArrayLike
) -> Framed:
    """Return an interactive figure of forecasts from one moment of a film, under plans that end at different places.

    The reader moves the plan's end and the horizon; cloth, loop and linking number follow. A map shows which of the plans have
    the loop around the target at that horizon. No vertex is off its forecast by more than 5 mm. Taught in chapter 12.

    Parameters
    ----------
    episode : Episode
    frame : int
        Now, in the episode.
    actions : (R, C, T, 2, 3) array_like
        Where the two grippers go in the next T frames, metres, under R x C plans: rows from low to high, columns sideways.
    clouds : (R, C, K, n, 3) array_like
        The forecast vertices, metres; between the frames that are given they go along straight lines.
    ahead : (K,) array_like of int
        How many frames ahead those are, rising; the last is T.
    cycle : (L,) array_like of int
        The loop's vertices.

    Raises
    ------
    ValueError
        When the numbers of plans, frames or vertices differ, or the episode ends before the plans.
    """
    path, forecast = (np.asarray(part, dtype=np.float64) for part in (actions, clouds))
    now, knots, grid = episode.points[frame], np.asarray(ahead, dtype=np.int64), path.shape[:2]
    wanted = (*grid, int(knots[-1]), 2, 3), (*grid, len(knots), *now.shape)
    if (path.shape, forecast.shape) != wanted or frame + knots[-1] >= len(episode):
        told = f"{knots[-1]} frames after {frame} of {len(episode)}, not {(path.shape, forecast.shape)}"
        raise ValueError(f"actions and clouds must be {wanted}, of {told}")
    later = np.concatenate([forecast, path[:, :, knots - 1]], axis=3)  # the grippers after the vertices
    first = np.broadcast_to(np.concatenate([now, episode.grippers[frame]]), (*grid, 1, *later.shape[3:]))
    shares, modes = sums(np.concatenate([first, later], axis=2).reshape(-1, *later.shape[3:]))
    held = episode.held[frame : frame + knots[-1] + 1]
    x, y, _ = (episode.grippers[frame] - path[grid[0] // 2, grid[1] // 2, -1]).mean(axis=0)
    view = [float(np.degrees(np.arctan2(y, x))) - 35, 18.0]  # from behind, a little aside
    data = _scene(replace(episode, points=forecast[0, 0], held=held)) | {"start": 0, "view": view, "long": []}
    plan = {"knots": [0, *knots.tolist()], "vertices": len(now), "cycle": np.asarray(cycle).tolist()}
    plan |= {"rows": grid[0], "columns": grid[1], "target": close_far(episode.centre_line).tolist()}
    arrays = {name: data["arrays"][name] for name in ("faces", "line", "held")} | _tracks([])
    arrays |= {"shares": pack_coordinates(shares.reshape(len(shares), -1, 3)), "modes": pack_coordinates(modes)}
    data |= {"frames": len(held), "plans": plan, "arrays": arrays}
    title = f"{episode.garment}, {episode.target}: {grid[0] * grid[1]} plans"
    return framed("player", (*SPACE, "link.js", "planar.js", "plans.js"), data, 520, title, f"Forecasts of {title}")


def sums(clouds: NDArray[np.float64], most: float = 0.005) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Clouds (m, n, 3) as shares (m, q) of so few modes (r, n, 3) that no point is farther off than `most`; q is of threes."""
    rest = clouds.reshape(len(clouds), -1)
    left, sizes, modes = np.linalg.svd(rest, full_matrices=False)
    shares, rank = left * sizes, 0
    while rank < len(sizes) and np.linalg.norm(rest.reshape(clouds.shape), axis=-1).max() > most:
        rest = rest - np.outer(shares[:, rank], modes[rank])
        rank += 1
    return np.pad(shares[:, :rank], ((0, 0), (0, -rank % 3))), modes[:rank].reshape(rank, *clouds.shape[1:])


def telling_frame(states: Sequence[TopologicalState]) -> int:
    """The frame at which the weightiest identity has its longest lifetime; 0 when there are no loops."""
    weightiest = long_lived(states)[:1]
    return int(np.nanargmax(lifetimes(states)[weightiest[0]])) if weightiest else 0


def wardrobe(garments: Mapping[str, Garment], *, height: int = 480, title: str = "turn it") -> Framed:
    """Return an interactive figure of garments, one at a time and in the hand, with their true loops in colours.

    Parameters
    ----------
    garments : mapping of str to topokit.sim.Garment
        By the names of which the reader chooses; the first is shown first.
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
        raise ValueError("garments names no garment; give at least one")
    meshes = []
    for name, garment in garments.items():
        mesh, arrays = _mesh(garment.vertices[None], garment.faces, garment.loops)
        meshes.append({"name": str(name)} | mesh | arrays)
    data = {"garments": meshes, "view": [-65.0, 18.0]}
    return framed("wardrobe", (*SPACE, "planar.js"), data, height, title, f"Wardrobe: {', '.join(garments)}")


def _mesh(points: Points, faces: ArrayLike, loops: Iterable[ArrayLike]) -> tuple[dict[str, Any], dict[str, Any]]:
    """What the script asks of a mesh in (T, N, 3) places, and its arrays."""
    low, high = points.min(axis=(0, 1)), points.max(axis=(0, 1))
    corners = np.asarray(faces, dtype=np.int64).reshape(-1, 3)
    marks = cloth_marks(np.asarray(points[0], dtype=np.float64), corners, smooth=True)
    told = {
        "frames": len(points),
        "centre": ((low + high) / 2).tolist(),
        "radius": float(np.linalg.norm(high - low) / 2) or 1.0,
        "marks": [{"face": pack(face), "ends": pack_coordinates(ends), "bright": light} for face, ends, light in marks],
        "truth": [np.asarray(loop).tolist() for loop in loops],
    }
    return told, {"points": pack_coordinates(points), "faces": pack(corners)}


def _scene(episode: Episode) -> dict[str, Any]:
    told, arrays = _mesh(np.asarray(episode.points, dtype=np.float64), episode.faces, episode.loops)
    arrays["line"] = pack_coordinates(subdivide(triples(episode.centre_line, "centre_line")))
    arrays["grippers"] = pack_coordinates(episode.grippers)
    arrays["held"] = pack(np.asarray(episode.held, dtype=bool))
    return told | {"dt": float(episode.dt), "unit": "m", "thickness": rod_radius(episode), "arrays": arrays}


def _tracks(states: Sequence[TopologicalState]) -> dict[str, dict[str, Any]]:
    """The loops of all frames in one table; the loops of frame t are its rows first[t] to first[t + 1]."""
    loops: list[Loop] = [loop for state in states for loop in state.loops]
    corners = [np.concatenate([loop.killer_edge_points, loop.killer_triangles.reshape(6, 3)]) for loop in loops]
    return {
        "first": pack(np.cumsum([0] + [len(state.loops) for state in states])),
        "id": pack(np.array([loop.id for loop in loops], dtype=np.int64)),
        "birth": pack(np.array([loop.birth for loop in loops], dtype=np.float64)),
        "death": pack(np.array([loop.death for loop in loops], dtype=np.float64)),
        "killer": pack_coordinates(np.array(corners, dtype=np.float64).reshape(-1, 8, 3)),
        "alpha": pack(np.array([float(state.parameters.get("alpha") or 0.0) for state in states])),
    }
