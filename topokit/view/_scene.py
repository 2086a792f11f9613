"""What a picture of a cloth shows, checked once for both that draw it: PyVista and Matplotlib."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._validate import as_points
from topokit.io import Episode
from topokit.state import Loop, TopologicalState

__all__ = ["Scene", "as_line", "direction", "one_a_frame", "rod_radius"]

Array = NDArray[np.float64]


class Scene:
    """A cloth with its loops and its target, and the eye that sees them.

    Parameters
    ----------
    points : (N, 3) array_like
        Metres, z up.
    faces : (F, 3) array_like of int
        The points alone are drawn when there are none.
    loops : iterable of Loop
        Killer triangles in the colour of the identity, translucent, and the killer edge as a thick line.
    true_loops : sequence of (L,) array_like of int
        Closed cycles of vertex ids, drawn as dark lines.
    centre_line : (K, 3) array_like, optional
        The target's, drawn as a rod of radius `thickness`; not drawn where there are `rods`.
    rods : iterable of (start, end, radius)
        The target's capsules (`Target.rods`), metres.
    thickness : float
        Radius of the rod around `centre_line`.
    view : (2,) float
        Azimuth and elevation of the eye in degrees.
    zoom : float
        Above one comes nearer than the fit around everything.
    focus : (3,) array_like, optional
        The point in the middle of the picture; the middle of everything when not given.

    Raises
    ------
    ValueError
        When `points` do not lie in space.
    """

    def __init__(
        self,
        points: ArrayLike,
        faces: ArrayLike = (),
        *,
        loops: Iterable[Loop] = (),
        true_loops: Sequence[ArrayLike] = (),
        centre_line: ArrayLike | None = None,
        rods: Iterable[tuple[ArrayLike, ArrayLike, float]] = (),
        thickness: float = 0.01,
        view: tuple[float, float] = (-60.0, 15.0),
        zoom: float = 1.0,
        focus: ArrayLike | None = None,
    ) -> None:
        self.points = as_points(points)
        if self.points.shape[1] != 3:
            raise ValueError(f"points must lie in space, (N, 3), not of shape {self.points.shape}")
        self.faces = _as_faces(faces, len(self.points))
        self.loops = list(loops)
        cycles = (np.asarray(ids, dtype=np.int64) for ids in true_loops)
        self.true_loops = [self.points[np.append(ids, ids[:1])] for ids in cycles]
        line = as_line(centre_line, "centre_line")
        capsules = [(as_line(np.array([*map(np.asarray, ends)]), "rods"), float(radius)) for *ends, radius in rods]
        self.rods = capsules or [(line, thickness)] * (len(line) > 1)
        self.everything = np.concatenate([self.points, line, *(rod for rod, _ in capsules)])
        self.view, self.zoom = view, zoom
        self.focus = None if focus is None else np.asarray(focus, dtype=np.float64)


def _as_faces(faces: ArrayLike, n_points: int) -> NDArray[np.int64]:
    """Triangles as (F, 3), F = 0 included; ValueError when they are no triangles of `n_points` vertices."""
    array = np.asarray(faces, dtype=np.int64)
    if array.size == 0:
        return np.zeros((0, 3), dtype=np.int64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"faces must be an (F, 3) array of vertex ids, not of shape {array.shape}")
    if array.min() < 0 or array.max() >= n_points:
        raise ValueError(f"faces names vertex {array.max()}; points has {n_points}, numbered from 0")
    return array


def as_line(line: ArrayLike | None, name: str) -> Array:
    """A polyline as (K, 3), K = 0 for None; ValueError when it is none."""
    array = np.zeros((0, 3)) if line is None else np.asarray(line, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name} must be a (K, 3) array of points in space, not of shape {array.shape}")
    return array


def one_a_frame(episode: Episode, states: Sequence[TopologicalState]) -> None:
    if len(states) != len(episode):
        raise ValueError(f"states has {len(states)} frames where episode has {len(episode)}; track the same episode")


def rod_radius(episode: Episode) -> float:
    """Radius of an episode's target in metres, 0.01 when its physics does not tell."""
    target = episode.physics.get("target")
    return float(target.get("radius", 0.01)) if isinstance(target, dict) else 0.01


def direction(azimuth: float, elevation: float) -> Array:
    """Unit vector towards an eye at these degrees."""
    a, e = np.radians([azimuth, elevation])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
