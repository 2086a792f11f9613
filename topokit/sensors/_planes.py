"""Tables and walls of a scene: planes that are not seen through, without the cloth that lies on them.

Idea: cloth on a table is as near to it as the noise of one point. The mean height of a small cell of the plane is more exact.
So cells are judged, not points. The surface of the table is fitted to the lowest cells, which are around the cloth; their scatter
decides how high a cell of cloth is at least. Cloth that touches the table is not lower than the table, and a hole is: so a part
that cloth encloses is a hole only when it is as low as the table all over. Otherwise it is cloth.

Source: Fischler and Bolles 1981 (RANSAC); Koenker and Bassett 1978 (the lowest cells, by quantile regression). The constants were
chosen on made frames of cloth on a table.
"""

from __future__ import annotations

import contextlib
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topokit._validate import Array

Mask = NDArray[np.bool_]
_SHARE = 0.1  # least share of the points that are on a table or a wall
_BEHIND = 0.03  # largest share of the points behind it: otherwise it is cloth with the room behind
_TURN = np.cos(np.radians(10))  # a plane turns less from one frame to the next

_A_CELL = 9  # points of a cell
_CELLS = 2_000_000  # cells at most
_FITTED = 2000  # cells that the surface of the table is fitted to, about
_LOW = 0.15  # quantile of the heights of cells where the fit begins
_SURE = 3.0  # height of cloth, in deviations of the cells of the table
_PATCH = 10.0  # least area of cloth, in squares of the plane's thickness
_REACH = 1.5  # half the width of gaps in cloth that are closed, in thicknesses
_HOLE = 4.0  # least area of a hole, in squares of the thickness
_SPREAD = 3  # cells that smoothing spreads heights over
_RIM = 4.0  # height of a cell of cloth at its border, in median deviations of the cells of the table
_THIN = 0.25  # least height of cloth, in thicknesses, up to which cells alone tell a hole from cloth


def fitted(points: Array) -> Array:
    """Return the plane of least squares: its unit normal, and the product of the normal with its points."""
    middle = points.mean(axis=0)
    normal = np.linalg.eigh((points - middle).T @ (points - middle))[1][:, 0]
    return np.array([*normal, normal @ middle])


def near(points: Any, plane: Array, thickness: float) -> Mask:
    """Return which points (n, 3) are within a distance of a plane."""
    return np.asarray(np.abs(_heights(points, plane)) <= thickness)


def _heights(points: Any, plane: Array) -> Any:
    plane = plane.astype(points.dtype)
    return points @ plane[:3] - plane[3]


def followed(points: Array, plane: Array, thickness: float) -> Array | None:
    """Return the present place of a plane of the last frame; None when it is gone."""
    for width in (3 * thickness, thickness):
        on_plane = near(points, plane, width)
        if on_plane.sum() < max(3, _SHARE * len(points)):
            return None
        before = plane
        plane = fitted(points[on_plane])
        if abs(before[:3] @ plane[:3]) < _TURN:
            return None
    return plane


def found(sample: Array, thickness: float, eye: Array) -> Array | None:
    """Return the plane with the most points, among the planes that are not seen through.

    RANSAC looks for it along each axis, and least squares refine it.
    """
    from sklearn.linear_model import RANSACRegressor

    points = sample[::4]
    best = np.zeros(len(points), bool)
    for axis in range(3):
        # Along this axis the plane is a function of the other two coordinates.
        others = np.delete(points, axis, axis=1)
        search = RANSACRegressor(
            residual_threshold=thickness,
            max_trials=300,
            random_state=0,
            is_model_valid=partial(_is_opaque, points=points, axis=axis, thickness=thickness, eye=eye),
        )
        with contextlib.suppress(ValueError):  # none of its trials was valid
            on_plane = search.fit(others, points[:, axis]).inlier_mask_
            if on_plane.sum() > best.sum():
                best = on_plane
    if not best.any():
        return None
    return followed(sample, fitted(points[best]), thickness)


def _is_opaque(
    model: Any, _others: Array, _values: Array, *, points: Array, axis: int, thickness: float, eye: Array
) -> bool:
    """Return True if few points lie behind the plane of a linear model, from the eye, and some lie on it."""
    normal = np.insert(model.coef_, axis, -1.0)
    offsets = points @ normal + model.intercept_
    side_of_eye = np.sign(eye @ normal + model.intercept_)
    behind = offsets * side_of_eye < -3 * thickness * np.linalg.norm(normal)
    on_plane = np.abs(offsets) <= thickness
    return bool(behind.mean() <= _BEHIND and on_plane.sum() > 10)


def of_plane(points: Array, plane: Array, thickness: float, eye: Array) -> tuple[Mask, bool]:
    """Return which points (n, 3) a plane consists of, and whether some of what is left may be the plane.

    Points farther away than the thickness are none of it, and neither is what lies on it. A part that cloth encloses is left
    when it is neither as low as the plane nor as high as cloth.
    """
    height = _heights(points, plane)
    if eye @ plane[:3] < plane[3]:
        height = -height
    on_plane = np.abs(height) <= thickness

    # Places in the plane, and the cells that they are in. A sparse cloud has too few points a cell: each point counts for itself.
    around = (height > -3 * thickness) & (height < 10 * thickness)
    across = np.linalg.svd(plane[None, :3])[2][1:].astype(points.dtype)
    places = np.ascontiguousarray((points[around] @ across.T).T)
    grid = _Cells.of(places, on_plane[around], thickness)
    if grid is None:
        return on_plane, False
    own, smooth, known = grid.heights(np.minimum(height[around], 2 * thickness))
    bend, deviation = _bend_of_table(smooth, known, thickness)
    cloth, doubtful = _cloth(smooth - bend, known, thickness / grid.edge, min(_SURE * deviation, thickness), thickness)
    cloth, least = _without_rim(cloth, own - bend, known, thickness)
    lies_on_it = np.zeros(len(points), bool)
    cells = grid.rows, grid.columns
    lies_on_it[around] = cloth[cells] & (height[around] - bend[cells] >= least[cells])
    return on_plane & ~lies_on_it, doubtful


class _Cells:
    """Square cells of a plane, and the cell of each point."""

    def __init__(self, places: Array, edge: float) -> None:
        self.edge = edge
        self.rows, self.columns = [((axis - axis.min()) / edge).astype(np.int64) for axis in places]
        self.shape = (int(self.rows.max()) + 1, int(self.columns.max()) + 1)

    @classmethod
    def of(cls, places: Array, on_plane: Mask, thickness: float) -> _Cells | None:
        """Return cells that hold enough points, places (2, n), each; None when they would be too large or too many."""
        if not on_plane.any() or np.prod(np.ptp(places, axis=1) / thickness + 1) > _CELLS / 4:
            return None
        first = cls(places[:, on_plane], thickness)
        taken = np.count_nonzero(np.bincount(first.rows * first.shape[1] + first.columns))
        edge = thickness * max(np.sqrt(_A_CELL * taken / on_plane.sum()), 0.5)
        return None if edge > 2 * thickness else cls(places, edge)

    def heights(self, height: Array) -> tuple[Array, Array, Mask]:
        """Return the mean heights of the cells, alone and together with the cells around them, and which cells hold points."""
        from scipy.ndimage import gaussian_filter

        number = self.rows * self.shape[1] + self.columns
        size = int(np.prod(self.shape))
        count = np.bincount(number, minlength=size).reshape(self.shape)
        total = np.bincount(number, height, minlength=size).reshape(self.shape)
        own = total / np.maximum(count, 1)
        weight = gaussian_filter(np.minimum(count, 1.0), 1.0)
        smooth = gaussian_filter(own, 1.0) / np.maximum(weight, 1e-9)
        return own, smooth, count > 0


def _bend_of_table(height: Array, known: Mask, thickness: float) -> tuple[Array, float]:
    """Return the height of the surface of the table in each cell, and the deviation of the table's own cells.

    Cameras see a flat table slightly bent. So the surface is quadratic.
    """
    rows, columns = np.indices(height.shape)
    u = 2 * rows / height.shape[0] - 1
    v = 2 * columns / height.shape[1] - 1
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)
    chosen = known & (np.abs(height) <= thickness)
    step = max(1, int(chosen.sum()) // _FITTED)
    system = terms[chosen][::step]
    values = height[chosen][::step]

    # A low quantile first, by least squares with weights; then the mean of the cells near it. Cloth is above, so that the
    # scatter of the table is measured below.
    surface = _least_squares(system, values, np.ones(len(values)))
    for _ in range(12):
        rest = values - system @ surface
        side = np.where(rest > 0, _LOW, 1 - _LOW)
        surface = _least_squares(system, values, side / np.maximum(np.abs(rest), thickness / 100))
    for _ in range(8):
        rest = values - system @ surface
        deviation = max(float(np.sqrt(np.mean(np.square(rest), where=rest < 0))), thickness / 60)
        table = np.abs(rest) <= 2 * deviation
        surface = _least_squares(system, values, table.astype(np.float64))
    bend = np.clip(terms @ surface, -thickness / 2, thickness / 2)
    return bend, deviation


def _least_squares(system: Array, values: Array, weights: Array) -> Array:
    """Return the solution of a weighted system of equations; the smallest one where there are several."""
    weighted = system * weights[:, None]
    return np.asarray(np.linalg.pinv(weighted.T @ system) @ (weighted.T @ values))


def _cloth(above: Array, known: Mask, scale: float, low: float, thickness: float) -> tuple[Mask, bool]:
    """Return the cells of what lies on a table, and whether some of them may be the table, given the least height of cloth.

    The scale is the number of cells in a thickness.
    """
    from scipy.ndimage import binary_fill_holes, distance_transform_edt, find_objects, label, maximum

    # Cloth is a patch of cells that are high enough, some of them by far.
    patches, count = label(known & (above > low), np.ones((3, 3)))
    area = np.bincount(patches.ravel(), minlength=count + 1)
    highest = np.append(0.0, maximum(above, patches, np.arange(1, count + 1)))
    cloth = ((area >= _PATCH * scale**2) & (highest > 2 * low))[patches]
    if not cloth.any():
        return cloth, False

    # The parts that it encloses, or nearly encloses.
    margin = int(np.ceil(_REACH * scale)) + 1
    wide = np.pad(cloth, margin)
    grown = distance_transform_edt(~wide) <= _REACH * scale
    closed = distance_transform_edt(grown) > _REACH * scale
    filled = binary_fill_holes(closed | wide)[margin:-margin, margin:-margin]
    parts, _ = label(filled & ~cloth)
    away = distance_transform_edt(~cloth)

    # A part is a hole when it is as low as the table all over, and cells are exact enough for thin cloth, or all around is high.
    kept = cloth.copy()
    doubtful = False
    for number, box in enumerate(find_objects(parts), 1):
        box = tuple(slice(max(side.start - 2, 0), side.stop + 2) for side in box)
        part = parts[box] == number
        core = above[box][part & (away[box] > 1.5) & known[box]]
        hole = False
        if len(core) >= _HOLE * scale**2:
            rim = above[box][cloth[box] & (distance_transform_edt(~part) <= 2)]
            told_apart = low <= _THIN * thickness or np.quantile(rim, 0.25) > thickness
            low_all_over = np.quantile(core, 0.75) < 0.7 * low and np.median(core) < 0.4 * low
            hole = bool(told_apart and low_all_over)
            doubtful |= not hole
        if not hole:
            kept[box] |= part
    return kept, doubtful


def _without_rim(cloth: Mask, own: Array, known: Mask, thickness: float) -> tuple[Mask, Array]:
    """Return the cells of cloth without those of the table around it, and the least height of cloth in each cell.

    Smoothing has spread the height of the cloth to the table beside it. The heights of cells alone tell, at the border of the
    cloth only. A cell of the border may hold points of both.
    """
    from scipy.ndimage import binary_erosion, maximum_filter

    least = np.full(cloth.shape, -np.inf)
    table = own[known & ~cloth]
    if not len(table):
        return cloth, least
    limit = np.median(table) + _RIM * float(np.median(np.abs(table - np.median(table))))
    kept = cloth.copy()
    for _ in range(_SPREAD):
        border = kept & ~binary_erosion(kept, np.ones((3, 3)))
        kept &= ~(border & (own < limit))
    border = kept & ~binary_erosion(kept, np.ones((3, 3)))
    highest = maximum_filter(np.where(kept, own, 0.0), 3)
    least[border] = np.minimum(highest, thickness)[border] / 2
    return kept, least
