"""The linking number of two closed curves: how often one winds through the other.

Idea: for a segment of either curve the differences `b - a` fill a parallelogram. Its solid angle from the origin, summed
over all pairs of segments, is 4 pi times the Gauss integral, hence 4 pi times an integer.

Source: van Oosterom and Strackee, *The solid angle of a plane triangle*, 1983; Arai, *A rigorous numerical algorithm for
computing the linking number of links*, 2013. Taught in chapters 9 and 10.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._validate import Array, as_points, as_reals, positive

__all__ = ["close_far", "linking_number", "linking_numbers"]


def side_lengths(curve: Array) -> Array:
    """Return the lengths (..., n) of the sides of closed curves (..., n, d); the last one joins the last corner to the first."""
    return np.asarray(np.linalg.norm(np.roll(curve, -1, axis=-2) - curve, axis=-1))


def curve_centroid(curve: Array) -> Array:
    """Return the centroid (d,) of a closed curve (n, d) by length: its corners may crowd on one side."""
    middles = (curve + np.roll(curve, -1, axis=0)) / 2
    return np.asarray(np.average(middles, axis=0, weights=side_lengths(curve)))


def linking_number(curve_a: ArrayLike, curve_b: ArrayLike) -> int:
    """Return the linking number of two disjoint closed polygonal curves.

    Look at `curve_a` from the side on which it runs counterclockwise. The number is 1 if `curve_b` passes once through it towards
    you, and -1 if away from you. Its sign changes when one curve is reversed, and not when the two are exchanged.

    Parameters
    ----------
    curve_a, curve_b : (n, 3), (m, 3) array_like
        Corners in order, three at least; the last joins the first. Close a curve with ends, such as a hook, by `close_far`
        first.

    Raises
    ------
    ValueError
        When a curve is not in space or has fewer than three corners, or when the curves touch; the message names the
        place. Also when they come so close that rounding leaves no integer.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    >>> circle = np.column_stack([np.cos(t), np.sin(t), 0 * t])
    >>> through = np.column_stack([1 + np.cos(t), 0 * t, np.sin(t)])
    >>> abs(linking_number(circle, through)), linking_number(circle, through + [5, 0, 0])
    (1, 0)
    """
    a = _as_curve(curve_a, "curve_a")
    b = _as_curve(curve_b, "curve_b")
    return round(_gauss_integral(a, b, "curve_a", "curve_b"))


def linking_numbers(curves_a: ArrayLike, curves_b: ArrayLike) -> tuple[NDArray[np.int64], Array]:
    """Return the linking numbers (B,) of many pairs of curves at once, and the rounding errors (B,) of their Gauss integrals.

    An error is about 1e-14 for a hundred segments that are not close.

    Parameters
    ----------
    curves_a : (B, n, 3) or (n, 3) array_like
    curves_b : (B, m, 3) or (m, 3) array_like
        Closed curves as in `linking_number`. A single curve is linked with each of the others.

    Examples
    --------
    >>> square = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
    >>> pole = close_far([[0, 0, 0], [0, 0, 1]])
    >>> linking_numbers([square + [0, 0, 0.5], square + [3, 0, 0.5]], pole)[0].tolist()
    [1, 0]
    """
    a = _batch(curves_a, "curves_a")
    b = _batch(curves_b, "curves_b")
    if len(a) != len(b) and 1 not in (len(a), len(b)):
        raise ValueError(
            f"curves_a and curves_b must be equally many, or one a single curve; they are {len(a)} and {len(b)}"
        )
    pairs = [(k % len(a), k % len(b)) for k in range(max(len(a), len(b)))]
    integrals = np.array([_gauss_integral(a[i], b[j], f"curves_a[{i}]", f"curves_b[{j}]") for i, j in pairs])
    numbers = np.rint(integrals).astype(np.int64)
    return numbers, integrals - numbers


def close_far(
    curve: ArrayLike, *, start: ArrayLike = (0.0, 0.0, -1.0), end: ArrayLike = (0.0, 0.0, 1.0), far: float = 100.0
) -> Array:
    """Return an open curve, such as the centre line of a hook or a pole, closed far away and always in the same way.

    Four corners are added. The first continues the curve along `end`, the last continues its start along `start`, both by
    `far` times the size of the curve. From there both go as far again along start x end (any direction orthogonal to the two
    when they are parallel), and are joined. Apart from the two straight leads, the addition keeps that distance from the
    curve. So the linking number with a loop that is small against `far` does not depend on the side of the closing.

    Parameters
    ----------
    curve : (n, 3) array_like
        Corners in order, two different ones at least. The default directions suit a curve from its foot up to its tip: it
        then continues down through the floor and up from the tip.
    start, end : (3,) array_like
        Directions of any length except zero.
    far : float
        Length of the leads, in sizes of the curve (its longest extent along an axis).

    Examples
    --------
    >>> close_far([[0, 0, 0], [0, 0, 2]]).tolist()[2:]
    [[0.0, 0.0, 202.0], [200.0, 0.0, 202.0], [200.0, 0.0, -200.0], [0.0, 0.0, -200.0]]
    """
    points = as_points(curve, "curve")
    if points.shape[1] != 3 or len(points) < 2:
        raise ValueError(f"curve must be an (n, 3) array of at least 2 corners, not of shape {points.shape}")
    reach = positive(far, "far", zero=False) * float(np.ptp(points, axis=0).max())
    if reach == 0:
        raise ValueError("curve has no extent: all its corners are one point")

    down = _direction(start, "start")
    up = _direction(end, "end")
    sideways = np.cross(down, up)
    if np.linalg.norm(sideways) < 1e-6:
        # The two are parallel: take the axis that is least along them, made orthogonal to them.
        sideways = np.eye(3)[np.argmin(np.abs(up))]
        sideways = sideways - (sideways @ up) * up
    sideways = reach * sideways / np.linalg.norm(sideways)

    foot = points[0] + reach * down
    tip = points[-1] + reach * up
    return np.vstack([points, tip, tip + sideways, foot + sideways, foot])


def _direction(vector: ArrayLike, name: str) -> Array:
    """Return a direction (3,) of length 1."""
    value = as_reals(vector, name).astype(np.float64)
    length = float(np.linalg.norm(value))
    if value.shape != (3,) or not 0 < length < np.inf:
        raise ValueError(f"{name} must be a direction of three numbers, not {vector!r}")
    return value / length


def _batch(curves: ArrayLike, name: str) -> list[Array]:
    """Return checked curves (n, 3): a single curve is a batch of one."""
    array = as_reals(curves, name)
    if array.ndim == 2:
        array = array[None]
    if array.ndim != 3 or not len(array):
        raise ValueError(f"{name} must be a (B, n, 3) array of curves or one (n, 3) curve, not of shape {array.shape}")
    return [_as_curve(curve, f"{name}[{i}]") for i, curve in enumerate(array)]


def _as_curve(curve: ArrayLike, name: str) -> Array:
    """Return a closed curve (n, 3) in space, or raise ValueError when it is none."""
    corners = as_points(curve, name)
    if corners.shape[1] != 3 or len(corners) < 3:
        wrong = f"{name} must be an (n, 3) array of at least 3 corners, not of shape {corners.shape}"
        raise ValueError(f"{wrong}; close an open curve first, for example by topokit.linking.close_far")
    return corners


def _gauss_integral(a: Array, b: Array, name_a: str, name_b: str) -> float:
    """Return the Gauss integral over two closed curves, or raise an error when they touch or it is no integer."""
    # The unit is the size of the curves. Curves nearer than 1e-12 touch; far from the origin, where digits are lost, sooner.
    middle = a[0]
    size = max(float(np.abs(a - middle).max()), float(np.abs(b - middle).max()))
    largest = max(float(np.abs(a).max()), float(np.abs(b).max()))
    touch = 1e-12 + 4 * float(np.finfo(float).eps) * largest / size
    first_closed = np.vstack([a, a[:1]])
    first_closed = (first_closed - middle) / size
    second = (b - middle) / size
    second_closed = np.vstack([second, second[:1]])

    # Sum over runs of segments of the first curve: 2**17 pairs with segments of the second take some 30 MB.
    rows = max(1, 2**17 // len(second))
    total = 0.0
    for row in range(0, len(a), rows):
        block = first_closed[row : row + rows + 1]
        pair = _touching_pair(block, second, touch)
        if pair is not None:
            where = f"segment {row + pair[0]} of {name_a} meets segment {pair[1]} of {name_b}"
            raise ValueError(f"the curves touch: {where}; no linking number exists")
        total += _half_solid_angles(block, second_closed) / (2 * np.pi)
    if abs(total - np.rint(total)) > 1e-3:  # the digits are lost
        close = f"{name_a} and {name_b} come too close: their Gauss integral is {total:.6f}, no integer"
        raise ValueError(f"{close}; move them apart or subdivide long segments")
    return total


def _half_solid_angles(a: Array, b: Array) -> float:
    """Return half the solid angle of all parallelograms of differences of the open polylines (n + 1, 3) and (m + 1, 3)."""
    # Directions of b - a for every pair of corners. Each pair of segments has four of them: u, v, w, x around its
    # parallelogram, which its diagonal from u to w cuts into two triangles.
    unit = b[None] - a[:, None]
    unit /= np.linalg.norm(unit, axis=-1, keepdims=True)
    u = unit[:-1, :-1]
    v = unit[1:, :-1]
    w = unit[1:, 1:]
    x = unit[:-1, 1:]

    # Van Oosterom and Strackee: tan(angle / 2) of a triangle is its triple product by 1 + its three scalar products.
    normal = np.cross(w, u)
    diagonal = _dot(u, w)
    first = np.arctan2(_dot(v, normal), 1 + _dot(u, v) + _dot(v, w) + diagonal)
    second = np.arctan2(-_dot(x, normal), 1 + _dot(w, x) + _dot(x, u) + diagonal)
    return float((first + second).sum())


def _dot(u: Array, v: Array) -> Array:
    """Return scalar products along the last axis."""
    return np.einsum("...i,...i", u, v)


def _touching_pair(a: Array, b: Array, touch: float) -> tuple[int, int] | None:
    """Return a segment of the polyline `a` and one of the closed curve `b` that are nearer than `touch`, or None."""
    a_start = a[:-1]
    a_end = a[1:]
    b_start = b
    b_end = np.roll(b, -1, axis=0)

    # Where the middles are farther apart than half the lengths together, nothing needs to be measured: nearly everywhere.
    gap = np.linalg.norm((a_start + a_end)[:, None] - (b_start + b_end)[None], axis=-1)
    reach = np.linalg.norm(a_end - a_start, axis=-1)[:, None] + np.linalg.norm(b_end - b_start, axis=-1)
    i, j = np.nonzero(gap <= reach + 4 * touch)
    if not len(i):
        return None
    distances = _segment_distances(a_start[i], a_end[i], b_start[j], b_end[j])
    nearest = int(np.argmin(distances))
    if distances[nearest] > touch:
        return None
    return int(i[nearest]), int(j[nearest])


def _segment_distances(a: Array, a_end: Array, b: Array, b_end: Array) -> Array:
    """Return the distances (k,) between segments from `a` to `a_end` and from `b` to `b_end`, all (k, 3)."""
    # Either an end of one of them is a nearest point ...
    from_ends = [to_segment(point, b, b_end) for point in (a, a_end)]
    from_ends += [to_segment(point, a, a_end) for point in (b, b_end)]

    # ... or both nearest points lie inside, a + s u and b + t v, along a line that is orthogonal to both.
    u = a_end - a
    v = b_end - b
    w = b - a
    uu = _dot(u, u)
    vv = _dot(v, v)
    uv = _dot(u, v)
    uw = _dot(u, w)
    vw = _dot(v, w)
    determinant = uu * vv - uv**2
    skew = determinant > 1e-14 * uu * vv  # for parallel segments an end is always a nearest point
    divisor = np.where(skew, determinant, 1.0)
    s = (uw * vv - vw * uv) / divisor
    t = (uw * uv - vw * uu) / divisor
    inside = skew & (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    gap = np.linalg.norm(w + t[..., None] * v - s[..., None] * u, axis=-1)
    return np.minimum.reduce([*from_ends, np.where(inside, gap, np.inf)])


def to_segment(point: Array, start: Array, end: Array) -> Array:
    """Return the distances (...) from points to segments, (..., d) each, broadcast over the leading axes."""
    along = end - start
    t = np.clip(_dot(point - start, along) / np.maximum(_dot(along, along), np.finfo(float).tiny), 0, 1)
    return np.linalg.norm(point - start - t[..., None] * along, axis=-1)
