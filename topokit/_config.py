"""Configurations of the companions: frozen dataclasses, checked by pydantic, read from JSON.

A value of another type is refused, not converted (`"0.1"` is no number, `True` is no count), and so are NaN and infinity; a
name that is not known is an error that says which are.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import field, fields
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass
from typing_extensions import dataclass_transform

from ._archive import existing

T = TypeVar("T")

Count = Annotated[int, Field(ge=1)]
NotNegative = Annotated[float, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]


def as_tuple(values: Any) -> Any:
    """Return lists and arrays as tuples, since configurations do not change; leave anything else as it is."""
    if isinstance(values, np.ndarray):
        values = values.tolist()
    if isinstance(values, (tuple, list)):
        return tuple(as_tuple(value) for value in values)
    return _plain(values)


def _plain(value: Any) -> Any:
    """Return a number of NumPy as one of Python."""
    return value.item() if isinstance(value, np.generic) else value


Place = Annotated[tuple[float, float, float], BeforeValidator(as_tuple)]


@dataclass_transform(frozen_default=True, field_specifiers=(field,))
def checked(kind: type[T]) -> type[T]:
    """Make a class a frozen dataclass whose fields are checked; a value that they refuse is a ValueError of one line."""
    made: Any = dataclass(kind, frozen=True, config=ConfigDict(extra="forbid", strict=True, allow_inf_nan=False))
    start = made.__init__

    def __init__(self: Any, *arguments: Any, **values: Any) -> None:
        try:
            start(self, *map(_plain, arguments), **{name: _plain(value) for name, value in values.items()})
        except ValidationError as error:
            raise ValueError(_first_fault(error, kind)) from error

    made.__init__ = __init__
    return made


def from_mapping(kind: type[T], entries: Any, where: str) -> T:
    """Return a checked dataclass made of plain numbers, strings, lists and dicts; errors name `where` and the entry."""
    if not isinstance(entries, Mapping):
        raise ValueError(f"{where} must be an object with named entries, not {entries!r:.200}")
    plain = json.dumps(dict(entries), default=str)  # JSON, because its lists may be tuples
    try:
        return TypeAdapter(kind).validate_json(plain)
    except ValidationError as error:
        raise ValueError(f"{where}: {_first_fault(error, kind)}") from error


def load(kind: type[T], path: str | Path) -> T:
    """Return a checked dataclass that a JSON file holds; errors name the file and the entry."""
    path = existing(path)
    try:
        entries = json.loads(path.read_bytes())
    except ValueError as error:
        raise ValueError(f"{path}: not JSON: {error}") from error
    return from_mapping(kind, entries, str(path))


def _first_fault(error: ValidationError, kind: Any) -> str:
    """Return the first thing that is wrong, in a line; an unknown name comes before a missing one."""
    faults = error.errors(include_url=False)
    unknown = [fault for fault in faults if fault["type"] == "unexpected_keyword_argument"]
    fault = (unknown or faults)[0]
    place = ".".join(map(str, fault["loc"]))
    if unknown:
        known = ", ".join(entry.name for entry in fields(kind))
        return f"there is no {place!r}" + ("" if "." in place else f"; there are {known}")
    if fault["type"] == "missing":
        return f"{place!r} is missing"
    message = fault["msg"].removeprefix("Value error, ")
    if fault["type"] == "value_error" and not place:
        return message
    return f"{place}: {message}, not {fault['input']!r:.200}"
