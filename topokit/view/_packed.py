"""What pages hold in few bytes: arrays in base64, and films of clouds with the loops of every frame."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topokit.io import packed
from topokit.rips import Diagram, rips_persistence

MOST_GROWN = (16, 160)  # frames, and points: edges and triangles are drawn one by one


def pack(array: NDArray[Any]) -> dict[str, Any]:
    """An array as a JSON-ready dict: little-endian bytes in base64, in the smallest type the player reads."""
    whole = "u2" if array.min(initial=0) >= 0 and array.max(initial=0) < 2**16 else "i4"
    kind = {"f": "f4", "b": "u1"}.get(array.dtype.kind, whole)
    values = np.ascontiguousarray(array, dtype=f"<{kind}")
    return {"type": kind, "shape": list(array.shape), "values": base64.b64encode(values.tobytes()).decode("ascii")}


def pack_coordinates(points: NDArray[np.floating[Any]]) -> dict[str, Any]:
    """(..., 3) coordinates packed to 16 bits with one scale for the three axes; the error is at most half the scale."""
    steps, scale = packed(points)
    return pack(steps) | {"scale": float(scale[0]), "low": scale[1:].tolist()}


def grown(film: list[NDArray[np.float64]], end: float | None) -> dict[str, Any]:
    """A film of space, packed, and the loops of each frame as the script sees it: what bears, kills and goes around them."""
    shape = np.shape(film)
    if not (1 <= shape[0] <= MOST_GROWN[0] and 1 <= shape[1] <= MOST_GROWN[1] and shape[2] == 3):
        most = f"{MOST_GROWN[0]} frames of {MOST_GROWN[1]} points of space"
        raise ValueError(f"a film must be at most {most}, not {shape}")
    steps, scale = packed(np.array(film))
    diagrams = [rips_persistence(cloud) for cloud in np.float32(steps * scale[0] + scale[1:]).astype(float)]
    return {
        "film": pack_coordinates(np.array(film)),
        "told": [pack(_loops(diagram)) for diagram in diagrams],
        "view": [-60, 15],
        "frame": len(film) // 2,
        "longest": max(float(dgm.lifetime.max(initial=0.0)) for dgm in diagrams),
        "end": end or 1.15 * max(float(dgm.death.max(initial=0.0)) for dgm in diagrams) or 1.0,
    }


def _loops(diagram: Diagram) -> NDArray[np.int64]:
    rows = [np.zeros(0, np.int64)]
    for i in range(len(diagram)):
        cycle, apexes = diagram.cycle(i), diagram.killer_triangles[i, :, 2]
        rows += [diagram.birth_edge[i], diagram.killer_edge[i], apexes, np.array([len(cycle)]), cycle]
    return np.concatenate(rows)
