"""Checks that turn bad input into an error that says what was wrong, where, and what to do."""

from collections.abc import Sequence
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Ids = NDArray[np.int64]


class WrongKindError(TypeError, ValueError):
    """An argument of the wrong kind: a `TypeError` of ours, which the command line tells from a mistake in the code."""


def as_reals(values: Any, name: str) -> NDArray[Any]:
    """Return an array of real numbers."""
    array = np.asarray(values)
    if array.dtype.kind not in "biuf":
        raise WrongKindError(f"{name} must hold real numbers, not {array.dtype}")
    return array


def as_points(
    points: ArrayLike, name: str = "points", *, copy: bool = False, refuse_transposed: bool = False
) -> NDArray[np.float64]:
    """Return points as a C-contiguous (n, d) float64 array of finite numbers; a `copy` shares no memory with them."""
    array = as_reals(points, name)
    if array.ndim != 2 or array.shape[1] == 0:
        hint = "; for a sequence of clouds use topokit.track" if array.ndim == 3 else ""
        raise ValueError(f"{name} must be an (n, d) array, one row a point, not of shape {array.shape}{hint}")

    # Three points have no loop. Where loops are looked for, three long rows are most likely a transposed cloud.
    n, d = array.shape
    if refuse_transposed and 0 < n < 4 and d > 32:
        question = f"{name} has {n} rows and {d} columns: are they {d} points in {n} dimensions? Then give {name}.T"
        raise ValueError(f"{question}, one row a point; if not, there is no loop: fewer than four points have none")

    array = np.array(array, dtype=np.float64, order="C", copy=copy or None)
    finite = np.isfinite(array)
    if not finite.all():
        bad = np.flatnonzero(~finite.all(axis=1))
        variable = "points" if " " in name else name
        problem = f"{len(bad)} of {len(array)} points with a NaN or infinite coordinate, the first at row {bad[0]}"
        cure = f"drop them first, for example {variable}[np.isfinite({variable}).all(axis=1)]"
        raise ValueError(f"{name} has {problem}: {array[bad[0]].tolist()}; {cure}")
    return array


def as_sequence(
    sequence: ArrayLike | Sequence[ArrayLike], name: str = "sequence", *, copy: bool = False
) -> list[NDArray[np.float64]]:
    """Return clouds as a list of (n_t, d) float64 arrays: the number of points may vary, the dimension may not."""
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


def _is_number(value: Any) -> bool:
    """Return True for Python's and NumPy's real numbers; a truth value is none."""
    return isinstance(value, Real) and not isinstance(value, bool)


def positive(value: float, name: str, *, zero: bool = True, infinite: bool = False) -> float:
    """Return `value` as a float, or raise an error unless it is a (finite) number that is not negative."""
    if not _is_number(value):
        raise WrongKindError(f"{name} must be a number, not {value!r}")
    number = float(value)
    large_enough = number >= 0 if zero else number > 0
    if not large_enough or (np.isinf(number) and not infinite):
        bound = "zero or more" if zero else "more than zero"
        if not infinite:
            bound += " and finite"
        raise ValueError(f"{name} must be {bound}, not {value!r}")
    return number


def whole(value: Any, name: str, low: int = 0, high: float = float("inf")) -> int:
    """Return `value` as an int, or raise an error unless it is a whole number from `low` to `high`."""
    if not _is_number(value):
        raise WrongKindError(f"{name} must be a whole number, not {value!r}")
    if not low <= value <= high or value % 1 != 0:
        bound = f"{low} or more" if high == float("inf") else f"{low} to {high}"
        raise ValueError(f"{name} must be {bound}, a whole number, not {value!r}")
    return int(value)


def as_ids(values: object, name: str, n_vertices: int) -> NDArray[np.int64]:
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
