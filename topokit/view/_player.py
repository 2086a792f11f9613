"""The figure that plays an episode and its loops, without a kernel.

Idea: everything it shows is packed once, coordinates in 16 bits and base64; `player.js` unpacks and draws it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit.io import Episode
from topokit.state import Loop, TopologicalState
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
    data = _scene(episode) | {
        "start": int(start),
        "view": [float(view[0]), float(view[1])],
        "show_truth": bool(show_truth),
        "film": bool(film),
        "long": list(long_lived(states)),
    }
    data["arrays"] |= _tracks(states)
    return framed("player", SPACE, data, height, title, f"Player: {title}")


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
        "marks": [
            {"face": pack(face), "ends": pack_coordinates(ends), "bright": bright} for face, ends, bright in marks
        ],
        "truth": [np.asarray(loop).tolist() for loop in loops],
    }
    return told, {"points": pack_coordinates(points), "faces": pack(corners)}


def _scene(episode: Episode) -> dict[str, Any]:
    told, arrays = _mesh(np.asarray(episode.points, dtype=np.float64), episode.faces, episode.loops)
    return told | {
        "dt": float(episode.dt),
        "unit": "m",
        "thickness": rod_radius(episode),
        "arrays": arrays
        | {
            "line": pack_coordinates(subdivide(triples(episode.centre_line, "centre_line"))),
            "grippers": pack_coordinates(episode.grippers),
            "held": pack(np.asarray(episode.held, dtype=bool)),
        },
    }


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
