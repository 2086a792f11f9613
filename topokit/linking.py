"""The linking number of two closed curves: how often one winds through the other.

Idea: for a segment of either curve the differences `b - a` fill a parallelogram; the solid angle under which the origin
sees it, summed over all pairs of segments, is 4 pi times the Gauss integral, hence 4 pi times an integer.

Source: van Oosterom and Strackee, *The solid angle of a plane triangle*, 1983; Arai, *A rigorous numerical algorithm for
computing the linking number of links*, 2013.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._validate import as_points

__all__ = ["linking_number"]

Array = NDArray[np.float64]


def linking_number(curve_a: ArrayLike, curve_b: ArrayLike) -> int:
    """Return the linking number of two disjoint closed polygonal curves.

    Parameters
    ----------
    curve_a, curve_b : (n, 3), (m, 3) array_like
        Corners in order; the last joins the first. Three at least.

    Returns
    -------
    int
        Its sign changes when one curve is reversed, and not when the two are exchanged.

    Raises
    ------
    ValueError
        When a curve has fewer than three corners or is not in space, or when the curves touch.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    >>> circle = np.column_stack([np.cos(t), np.sin(t), 0 * t])
    >>> through = np.column_stack([1 + np.cos(t), 0 * t, np.sin(t)])
    >>> abs(linking_number(circle, through)), linking_number(circle, through + [5, 0, 0])
    (1, 0)
    """
    a, b = _curve(curve_a, "curve_a"), _curve(curve_b, "curve_b")
    distance = _segment_distances(a, np.roll(a, -1, axis=0), b, np.roll(b, -1, axis=0))
    scale = float(max(np.ptp(a, axis=0).max(), np.ptp(b, axis=0).max()))
    i, j = np.unravel_index(np.argmin(distance), distance.shape)
    if distance[i, j] <= 1e-12 * scale:
        raise ValueError(
            f"the curves touch: segment {i} of curve_a meets segment {j} of curve_b; no linking number exists"
        )
    total = float(_gauss_terms(a, b).sum() / (2 * np.pi))
    return round(total)


def _curve(curve: ArrayLike, name: str) -> Array:
    points = as_points(curve, name)
    if points.shape[1] != 3 or len(points) < 3:
        raise ValueError(f"{name} must be an (n, 3) array of at least 3 corners, not of shape {points.shape}")
    return points


def _gauss_terms(a: Array, b: Array) -> Array:
    """(n, m) half the signed solid angle of each parallelogram of differences."""
    a_next, b_next = np.roll(a, -1, axis=0)[:, None], np.roll(b, -1, axis=0)[None]
    a, b = a[:, None], b[None]
    corners = (b - a, b - a_next, b_next - a_next, b_next - a)
    first, second = (corners[0], corners[1], corners[2]), (corners[2], corners[3], corners[0])
    return _half_solid_angle(*first) + _half_solid_angle(*second)


def _half_solid_angle(u: Array, v: Array, w: Array) -> Array:
    """Half the signed solid angle of the triangles u, v, w (..., 3) seen from the origin."""
    lu, lv, lw = (np.linalg.norm(x, axis=-1) for x in (u, v, w))
    volume = np.einsum("...i,...i", u, np.cross(v, w))
    dot_uv, dot_vw, dot_wu = (np.einsum("...i,...i", x, y) for x, y in ((u, v), (v, w), (w, u)))
    half: Array = np.arctan2(volume, lu * lv * lw + dot_uv * lw + dot_vw * lu + dot_wu * lv)
    return half


def _segment_distances(a: Array, a_end: Array, b: Array, b_end: Array) -> Array:
    """(n, m) distances between the segments (a, a_end) and (b, b_end).

    The minimum is taken at an end of one segment, or inside both where the joining line is orthogonal to the two.
    """
    a, a_end, b, b_end = a[:, None], a_end[:, None], b[None], b_end[None]
    ends = [
        _to_segment(a, b, b_end),
        _to_segment(a_end, b, b_end),
        _to_segment(b, a, a_end),
        _to_segment(b_end, a, a_end),
    ]
    u, v, w = a_end - a, b_end - b, b - a
    uu, vv, uv = (np.einsum("...i,...i", x, y) for x, y in ((u, u), (v, v), (u, v)))
    uw, vw = np.einsum("...i,...i", u, w), np.einsum("...i,...i", v, w)
    determinant = uu * vv - uv**2
    skew = determinant > 1e-14 * uu * vv  # for parallel segments an end is always a nearest point
    divisor = np.where(skew, determinant, 1.0)
    s, t = (uw * vv - vw * uv) / divisor, (uw * uv - vw * uu) / divisor
    inside = skew & (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    gap = np.linalg.norm(w + t[..., None] * v - s[..., None] * u, axis=-1)
    nearest: Array = np.minimum.reduce([*ends, np.where(inside, gap, np.inf)])
    return nearest


def _to_segment(point: Array, start: Array, end: Array) -> Array:
    """Distances from points to segments, broadcast over the leading axes."""
    along = end - start
    length = np.maximum(np.einsum("...i,...i", along, along), np.finfo(float).tiny)
    t = np.clip(np.einsum("...i,...i", point - start, along) / length, 0, 1)
    distance: Array = np.linalg.norm(point - start - t[..., None] * along, axis=-1)
    return distance
