"""Checks that turn bad input into an error that says what was wrong, where, and what to do."""

import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Ids = NDArray[np.int64]


class WrongKindError(TypeError, ValueError):
    """An argument of the wrong kind: a `TypeError` of ours, which the command line tells from a mistake in the code."""


def as_reals(values: Any, name: str, ragged: str = "its rows differ in length") -> NDArray[Any]:
    """An array of real numbers, none of them masked: NumPy would hand on what lies under the mask as if it were meant."""
    for part in values if isinstance(values, (list, tuple)) else [values]:
        if np.ma.is_masked(part):
            count = np.ma.getmaskarray(part).sum()
            raise ValueError(f"{name} has {count} masked entries: leave them out, or give {name}.filled(value)")
    try:
        array = np.asarray(values)
    except ValueError as error:  # ragged nested lists
        raise ValueError(f"{name} must be an array of numbers; {ragged}") from error
    if array.dtype.kind not in "biuf":
        raise WrongKindError(f"{name} must hold real numbers, not {array.dtype}")
    return array


def as_points(
    points: ArrayLike, name: str = "points", *, copy: bool = False, refuse_transposed: bool = False
) -> NDArray[np.float64]:
    """A C-contiguous (n, d) float64 array of finite numbers, no memory shared when it is a `copy`, or why it is none."""
    array = as_reals(points, name)
    if array.ndim != 2 or array.shape[1] == 0:
        more = "; for a sequence of clouds use topokit.track" if array.ndim == 3 else ""
        raise ValueError(f"{name} must be an (n, d) array, one row a point, not of shape {array.shape}{more}")
    n, d = array.shape
    if refuse_transposed and 0 < n < 4 and d > 32:  # where loops are looked for, which no three points have
        what = f"{name} has {n} rows and {d} columns: are they {d} points in {n} dimensions? Then give {name}.T"
        raise ValueError(f"{what}, one row a point; if not, repeat one to be told that there is no loop")
    with np.errstate(over="ignore"):  # of longer floating point: infinite here, and said so
        array = np.array(array, dtype=np.float64, order="C", copy=copy or None)
    finite = np.isfinite(array)
    if not finite.all():
        bad, them = np.flatnonzero(~finite.all(axis=1)), "points" if " " in name else name
        what = f"{len(bad)} of {len(array)} points with a NaN or infinite coordinate, the first at row {bad[0]}"
        cure = f"drop them first, for example {them}[np.isfinite({them}).all(axis=1)]"
        raise ValueError(f"{name} has {what}: {array[bad[0]].tolist()}; {cure}")
    return array


def as_sequence(
    sequence: ArrayLike | Sequence[ArrayLike], name: str = "sequence", *, copy: bool = False
) -> list[NDArray[np.float64]]:
    """A list of (n_t, d) float64 arrays: a camera sees as many points as it sees, but always in as many dimensions."""
    if isinstance(sequence, np.ndarray) and sequence.ndim != 3:
        raise ValueError(f"{name} must be a (T, n, d) array or a list of (n, d) arrays, not of shape {sequence.shape}")
    clouds: list[NDArray[np.float64]] = []
    for frame, cloud in enumerate(sequence):  # type: ignore[arg-type]
        array = as_points(cloud, f"{name}[{frame}]", copy=copy, refuse_transposed=True)
        if clouds and array.shape[1] != clouds[0].shape[1]:
            before = clouds[0].shape[1]
            raise ValueError(f"{name}[{frame}] has {array.shape[1]} dimensions, the frames before it {before}")
        clouds.append(array)
    return clouds


def positive(value: float, name: str, *, zero: bool = True, infinite: bool = False) -> float:
    """Return `value` as a float, or say that it must be a (finite) number that is not negative."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise WrongKindError(f"{name} must be a number, not {value!r}")
    exact = value.item() if isinstance(value, np.generic) else value
    number = float(exact if not abs(exact) > sys.float_info.max else "inf" if exact > 0 else "-inf")
    if np.isnan(number) or number < 0 or (number == 0 and not zero) or (np.isinf(number) and not infinite):
        bound = "zero or more" if zero else "more than zero"
        raise ValueError(f"{name} must be {bound}{'' if infinite else ' and finite'}, not {value!r}")
    return number


def whole(value: object, name: str, low: int = 0, high: float = float("inf")) -> int:
    """Return `value` as an int, or say that it must be a whole number of a range."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise WrongKindError(f"{name} must be a whole number, not {value!r}")
    if not low <= value <= high or value % 1 != 0:
        bound = f"{low} or more" if high == float("inf") else f"{low} to {high}"
        raise ValueError(f"{name} must be {bound}, a whole number, not {value!r}")
    return int(value)


def as_ids(values: object, name: str, n_vertices: int) -> NDArray[np.int64]:
    """Vertex ids as int64; a TypeError or ValueError names one that is none."""
    ids = as_reals(values, name)
    if not np.issubdtype(ids.dtype, np.integer):
        raise WrongKindError(f"{name} must hold whole numbers (vertex ids), not {ids.dtype}")
    outside = ids[(ids < 0) | (ids >= n_vertices)]
    if len(outside):
        raise ValueError(f"{name} names vertex {outside[0]}; there are {n_vertices}, numbered from 0")
    return ids.astype(np.int64)


def own_arrays(record: object) -> None:
    """Replace the arrays of a frozen dataclass by copies that nobody can write to, so that it shares none with its maker."""
    for name, value in vars(record).items():
        if isinstance(value, np.ndarray):
            own = value.copy()
            own.setflags(write=False)
            object.__setattr__(record, name, own)
