"""The figure of plans that bend under the hand: forecasts of a grid of plans, in the player of films.

Idea: the clouds of all plans and frames are sums of a few modes, found by a singular value decomposition, so that a page can
hold them. What is shown is one of the plans, as it was forecast, and never a blend of two. `plans.js` puts it together.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit.io import Episode
from topokit.linking import close_far
from topokit.view._pages import Framed, framed
from topokit.view._player import pack_coordinates, scene_of, tracks_of

Array = NDArray[np.float64]
WITHIN = 0.005  # metres, the most that a vertex on the page is off its forecast


def plans(
    episode: Episode,
    frame: int,
    actions: ArrayLike,
    clouds: ArrayLike,
    ahead: ArrayLike,
    cycle: ArrayLike,
    *,
    height: int = 520,
    view: tuple[float, float] = (-60.0, 15.0),
) -> Framed:
    """Return an interactive figure of forecasts from one moment of a film, under plans that end at different places.

    The reader moves the plan's end and the horizon; cloth, loop and linking number follow. A map shows which of the plans have
    the loop around the target at that horizon. No vertex is off its forecast by more than 5 mm. Taught in chapter 12.

    Parameters
    ----------
    episode : Episode
        Its cloth and its target are drawn.
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
    height, view
        As of `player`.

    Raises
    ------
    ValueError
        When the numbers of plans, frames or vertices differ, or the episode ends before the plans.
    """
    path, forecast = (np.asarray(part, dtype=np.float64) for part in (actions, clouds))
    now, knots, (rows, columns) = episode.points[frame], np.asarray(ahead, dtype=np.int64), path.shape[:2]
    wanted = (rows, columns, int(knots[-1]), 2, 3), (rows, columns, len(knots), *now.shape)
    if (path.shape, forecast.shape) != wanted or frame + knots[-1] >= len(episode):
        span = f"of {knots[-1]} frames after {frame} of {len(episode)}"
        raise ValueError(f"actions and clouds must be {wanted}, {span}, not {(path.shape, forecast.shape)}")
    later = np.concatenate([forecast, path[:, :, knots - 1]], axis=3)  # the grippers after the vertices
    first = np.broadcast_to(np.concatenate([now, episode.grippers[frame]]), (rows, columns, 1, *later.shape[3:]))
    shares, modes = sums(np.concatenate([first, later], axis=2).reshape(-1, *later.shape[3:]))
    held = episode.held[frame : frame + knots[-1] + 1]
    scene = scene_of(replace(episode, points=forecast[0, 0], grippers=path[0, 0], held=held))
    arrays = {name: scene["arrays"][name] for name in ("faces", "line", "held")} | tracks_of([])
    arrays |= {"shares": pack_coordinates(shares.reshape(len(shares), -1, 3)), "modes": pack_coordinates(modes)}
    grid = {"rows": rows, "columns": columns, "knots": [0, *knots.tolist()], "vertices": len(now)}
    grid |= {"cycle": np.asarray(cycle).tolist(), "target": close_far(episode.centre_line).tolist()}
    data = scene | {
        "frames": len(held),
        "start": 0,
        "view": [*map(float, view)],
        "long": [],
        "plans": grid,
        "arrays": arrays,
    }
    title = f"{episode.garment}, {episode.target}: {rows * columns} plans"
    return framed("player", ("link.js", "planar.js", "plans.js"), data, height, title, f"Forecasts of {title}")


def sums(clouds: Array, most: float = WITHIN) -> tuple[Array, Array]:
    """Clouds (m, n, 3) as shares (m, q) of so few modes (r, n, 3) that no point is farther off than `most`; q is of threes."""
    rows = clouds.reshape(len(clouds), -1)
    left, sizes, right = np.linalg.svd(rows, full_matrices=False)
    rank, rest = 0, rows
    while rank < len(sizes) and np.linalg.norm(rest.reshape(clouds.shape), axis=-1).max() > most:
        rest = rest - np.outer(left[:, rank] * sizes[rank], right[rank])
        rank += 1
    shares = np.pad(left[:, :rank] * sizes[:rank], ((0, 0), (0, -rank % 3)))
    return shares, right[:rank].reshape(rank, *clouds.shape[1:])
