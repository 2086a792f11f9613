"""Checks that turn bad input into an error that says what was wrong, where, and what to do."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Ids = NDArray[np.int64]


class WrongKindError(TypeError, ValueError):
    """An argument of the wrong kind: a `TypeError` of ours, which the command line tells from a mistake in the code."""


def as_reals(values: Any, name: str) -> NDArray[Any]:
    """Return an array of real numbers; a masked entry is an error, because NumPy would use the number under the mask."""
    if np.ma.is_masked(values):
        raise ValueError(f"{name} has masked entries: leave them out, or give {name}.filled(value)")
    array = np.asarray(values)
    if array.dtype == object:  # numbers that may be missing, as of pandas
        array = np.array(array.tolist())
    if array.dtype.kind not in "biuf":
        held = next((f"; give {name}.{part}" for part in ("vertices", "points") if hasattr(values, part)), "")
        raise WrongKindError(f"{name} must hold real numbers, not {array.dtype}{held}")
    return array


def as_points(points: ArrayLike, name: str = "points", *, copy: bool = False) -> Array:
    """Return points as a C-contiguous (n, d) float64 array of finite numbers; a `copy` shares no memory with them."""
    array = as_reals(points, name)
    if array.ndim != 2 or array.shape[1] == 0:
        hint = "; for a sequence of clouds use topokit.track" if array.ndim == 3 else ""
        raise ValueError(f"{name} must be an (n, d) array, one row a point, not of shape {array.shape}{hint}")

    # Three points have no loop: three long rows are most likely a transposed cloud.
    n, d = array.shape
    if 0 < n < 4 and d > 32:
        raise ValueError(f"{name} has {n} rows and {d} columns: for {d} points in {n} dimensions give {name}.T")

    array = np.array(array, dtype=np.float64, order="C", copy=copy or None)
    finite = np.isfinite(array).all(axis=1)
    if not finite.all():
        row = int(finite.argmin())
        problem = f"{(~finite).sum()} of {n} points with a NaN or infinite coordinate, the first at row {row}"
        cure = "drop them first, for example points[np.isfinite(points).all(axis=1)]"
        raise ValueError(f"{name} has {problem}: {array[row].tolist()}; {cure}")
    largest = np.abs(array).max(initial=0.0)
    if largest > 1e150 or 0 < largest < 1e-150:
        unit = "take another unit, as squares of lengths are computed"
        raise ValueError(f"the largest coordinate of {name} is {largest:.3g}: {unit}")
    return array


def as_sequence(sequence: ArrayLike | Sequence[ArrayLike], name: str = "sequence") -> list[Array]:
    """Return clouds as a list of copies (n_t, d) float64, all of one d; one that is None or empty has no points."""
    clouds: list[Array] = []
    before = 0  # the dimension of the clouds so far
    for frame, cloud in enumerate(sequence):  # type: ignore[arg-type]
        if is_empty(cloud):
            clouds.append(np.empty((0, 3)))
            continue
        clouds.append(as_points(cloud, f"{name}[{frame}]", copy=True))
        now = clouds[-1].shape[1]
        before = before or now
        if now != before:
            raise ValueError(f"{name}[{frame}] has {now} dimensions, the frames before it {before}")
    return clouds


def is_empty(cloud: Any) -> bool:
    """Return whether a frame has no points: None, an empty list, or an array (0, d)."""
    return cloud is None or np.shape(cloud)[:1] == (0,)


def as_number(value: Any, name: str, kind: str = "number") -> Any:
    """Return a number, an array or a tensor of one, as a number of Python; truth values and times with a unit are no numbers."""
    array = np.asarray(value)
    if array.ndim or array.dtype.kind not in "iuf":
        raise WrongKindError(f"{name} must be a {kind}, not {value!r}")
    return array.item()


def positive(value: float, name: str, *, zero: bool = True, infinite: bool = False) -> float:
    """Return `value` as a float, or raise an error unless it is a (finite) number that is not negative."""
    number = float(as_number(value, name))
    if not number >= 0 or (number == 0 and not zero) or (np.isinf(number) and not infinite):
        bound = "zero or more" if zero else "more than zero"
        raise ValueError(f"{name} must be {bound}{'' if infinite else ' and finite'}, not {value!r}")
    return number


def whole(value: Any, name: str, low: int = 0, high: float = float("inf")) -> int:
    """Return `value` as an int, or raise an error unless it is a whole number from `low` to `high`."""
    number = as_number(value, name, "whole number")
    if not low <= number <= high or number % 1 != 0:
        bound = f"{low} or more" if high == float("inf") else f"{low} to {high}"
        raise ValueError(f"{name} must be {bound}, a whole number, not {value!r}")
    return int(number)


def as_ids(values: object, name: str, n_vertices: int) -> Ids:
    """Return vertex ids as int64, or raise an error that names an id that is no vertex."""
    ids = as_reals(values, name)
    if not np.issubdtype(ids.dtype, np.integer):
        raise WrongKindError(f"{name} must hold whole numbers (vertex ids), not {ids.dtype}")
    outside = ids[(ids < 0) | (ids >= n_vertices)]
    if len(outside):
        raise ValueError(f"{name} names vertex {outside[0]}; there are {n_vertices}, numbered from 0")
    return ids.astype(np.int64)


def own_arrays(record: object) -> None:
    """Replace the arrays of a frozen dataclass by read-only copies, so that it shares no memory with its maker."""
    for name, value in vars(record).items():
        if isinstance(value, np.ndarray):
            own = value.copy()
            own.setflags(write=False)
            object.__setattr__(record, name, own)
