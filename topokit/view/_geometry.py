"""Small geometry that the pictures share: tubes around lines, the light on a face, a box around everything."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit.io import Episode

__all__ = ["as_faces", "as_line", "face_light", "rod_radius", "subdivide", "tube"]

Array = NDArray[np.float64]


def rod_radius(episode: Episode) -> float:
    """Return the radius of an episode's target in metres, 0.01 when its physics does not tell."""
    target = episode.physics.get("target")
    return float(target.get("radius", 0.01)) if isinstance(target, dict) else 0.01


def as_faces(faces: ArrayLike, n_points: int) -> NDArray[np.int64]:
    """Return triangles as (F, 3) int64, F = 0 included; ValueError when they are no triangles of `n_points` vertices."""
    array = np.asarray(faces, dtype=np.int64)
    if array.size == 0:
        return np.zeros((0, 3), dtype=np.int64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"faces must be an (F, 3) array of vertex ids, not of shape {array.shape}")
    if array.min() < 0 or array.max() >= n_points:
        raise ValueError(f"faces names vertex {array.max()}; points has {n_points}, numbered from 0")
    return array


def as_line(line: ArrayLike | None, name: str) -> Array:
    """Return a polyline as (K, 3) float64, K = 0 for None; ValueError when it is none."""
    array = np.zeros((0, 3)) if line is None else np.asarray(line, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name} must be a (K, 3) array of points in space, not of shape {array.shape}")
    return array


def subdivide(line: Array, pieces: int = 60) -> Array:
    """Cut a (K, 3) polyline into short pieces, so that sorting them by depth puts each before or behind the cloth."""
    if len(line) < 2:
        return line
    walked = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    at = np.union1d(np.linspace(0.0, walked[-1], pieces), walked)
    return np.stack([np.interp(at, walked, line[:, axis]) for axis in range(3)], axis=1)


def tube(line: Array, radius: float, sides: int = 8) -> Array:
    """Return the (m, 3, 3) triangles of a tube around a polyline; none when it has fewer than two points.

    Idea: carry one normal along the line, at each point made perpendicular to the direction there, so that the tube
    does not twist.
    """
    if len(line) < 2:
        return np.zeros((0, 3, 3))
    along = np.gradient(line, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    normal = np.eye(3)[np.argmin(np.abs(along[0]))]
    angles = np.linspace(0.0, 2 * np.pi, sides, endpoint=False)
    rings = []
    for point, direction in zip(line, along, strict=True):
        normal = normal - (normal @ direction) * direction
        normal /= max(float(np.linalg.norm(normal)), 1e-12)
        other = np.cross(direction, normal)
        rings.append(point + radius * (np.cos(angles)[:, None] * normal + np.sin(angles)[:, None] * other))
    ring = np.array(rings)  # (K, sides, 3)
    turned = np.roll(ring, -1, axis=1)
    halves = [ring[:-1], ring[1:], turned[1:]], [ring[:-1], turned[1:], turned[:-1]]
    return np.concatenate([np.stack(half, axis=2).reshape(-1, 3, 3) for half in halves])


def face_light(corners: Array, eye: tuple[float, float]) -> Array:
    """Return (F,) brightness from 0.45 to 1 of (F, m, 3) faces seen from (azimuth, elevation) in degrees.

    The lamp stands above the eye's left shoulder and shines on both sides of the cloth.
    """
    azimuth, elevation = np.radians(eye)
    lamp_azimuth, lamp_elevation = azimuth - 0.6, min(elevation + 0.6, 1.4)
    lamp = np.array(
        [
            np.cos(lamp_elevation) * np.cos(lamp_azimuth),
            np.cos(lamp_elevation) * np.sin(lamp_azimuth),
            np.sin(lamp_elevation),
        ]
    )
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-15)
    light: Array = 0.45 + 0.55 * np.abs(normals @ lamp)
    return light
