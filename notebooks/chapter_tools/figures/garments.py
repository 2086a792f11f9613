"""Interactive figures of cloth that the reader turns: garments in the hand, and forecasts under several plans."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit.io import Episode
from topokit.linking import close_far
from topokit.view import HtmlFigure

from .pages import HERE

if TYPE_CHECKING:
    from topokit.sim import Garment

CLOTH_SCRIPTS = ("orbit.js", "mesh.js")  # those of topokit.view that draw cloth


def wardrobe(garments: Mapping[str, Garment]) -> HtmlFigure:
    """Return an interactive figure of garments, one at a time, with their true loops in colours.

    Parameters
    ----------
    garments : mapping of str to topokit.sim.Garment
        The garments by name, of which the reader chooses one; the first is shown first.
    """
    meshes = [
        {"name": name, **HtmlFigure.cloth(garment.vertices[None], garment.faces, garment.loops)}
        for name, garment in garments.items()
    ]
    return HtmlFigure.from_parts(
        "wardrobe",
        {"garments": meshes, "view": [-65.0, 18.0]},
        scripts=(*CLOTH_SCRIPTS, "planar.js"),
        folder=HERE,
        height=480,
        caption="the wardrobe",
        title=f"Wardrobe: {', '.join(garments)}",
    )


def plans(
    episode: Episode, frame: int, actions: ArrayLike, clouds: ArrayLike, ahead: ArrayLike, cycle: ArrayLike
) -> HtmlFigure:
    """Return an interactive figure of forecasts from one moment of a film, under plans that end at different places.

    The reader moves the plan's end and the horizon; cloth, loop and linking number follow. A map shows which of the plans have
    the loop around the target at that horizon. The figure shows one of the plans, never a blend of two. No vertex is off its
    forecast by more than 5 mm.

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
    """
    paths = np.asarray(actions, dtype=np.float64)
    forecasts = np.asarray(clouds, dtype=np.float64)
    knots = np.asarray(ahead, dtype=np.int64)
    now = episode.points[frame]
    rows, columns = paths.shape[:2]

    # Vertices and grippers together become sums of few modes: now, then at each knot.
    later = np.concatenate([forecasts, paths[:, :, knots - 1]], axis=3)
    first = np.concatenate([now, episode.grippers[frame]])
    first = np.broadcast_to(first, (rows, columns, 1, *first.shape))
    shares, modes = low_rank(np.concatenate([first, later], axis=2).reshape(-1, *first.shape[3:]))

    held = episode.held[frame : frame + int(knots[-1]) + 1]
    cloth = HtmlFigure.cloth(forecasts[0, 0], episode.faces)
    x, y, _ = (episode.grippers[frame] - paths[rows // 2, columns // 2, -1]).mean(axis=0)
    data = {
        **cloth,
        "frames": len(held),
        "start": 0,
        "view": [float(np.degrees(np.arctan2(y, x))) - 35, 18.0],  # from behind, a little to the side
        "long": [],
        "dt": episode.dt,
        "unit": "m",
        "thickness": episode.physics["target"]["radius"],
        "plans": {
            "rows": rows,
            "columns": columns,
            "knots": [0, *knots.tolist()],
            "vertices": len(now),
            "cycle": np.asarray(cycle).tolist(),
            "target": close_far(episode.centre_line).tolist(),
        },
        "arrays": {
            "faces": cloth["faces"],
            "line": _in_pieces(episode.centre_line),
            "held": held,
            "shares": shares,
            "modes": modes,
            "first": np.zeros(1, np.int64),  # no tracked loops
            **{name: np.zeros(0) for name in ("id", "birth", "death", "killer", "alpha")},
        },
    }
    caption = f"{episode.garment}, {episode.target}: {rows * columns} plans"
    scripts = (*CLOTH_SCRIPTS, "link.js", "planar.js", "plans.js")
    return HtmlFigure.from_parts(
        "player", data, scripts=scripts, folder=HERE, height=520, caption=caption, title=f"Forecasts of {caption}"
    )


def _in_pieces(line: NDArray[np.floating], pieces: int = 20) -> NDArray[np.float64]:
    """Return a polyline with each side cut into pieces, which are drawn before or behind the cloth."""
    share = np.linspace(0, 1, pieces, endpoint=False)[:, None]
    cut = line[:-1, None] + share * np.diff(line, axis=0)[:, None]
    return np.concatenate([cut.reshape(-1, 3), line[-1:]])


def low_rank(clouds: NDArray[np.float64], tolerance: float = 0.005) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return clouds (m, n, 3) as shares (m, r) of the fewest modes (r, n, 3) within a tolerance for every point."""
    rest = clouds.reshape(len(clouds), -1)
    left, sizes, modes = np.linalg.svd(rest, full_matrices=False)
    shares = left * sizes
    rank = 0
    while rank < len(sizes) and np.linalg.norm(rest.reshape(clouds.shape), axis=-1).max() > tolerance:
        rest = rest - np.outer(shares[:, rank], modes[rank])
        rank += 1
    return shares[:, :rank], modes[:rank].reshape(rank, *clouds.shape[1:])
