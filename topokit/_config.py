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

from ._archive import existing, read_json

T = TypeVar("T")

Count = Annotated[int, Field(ge=1)]
NotNegative = Annotated[float, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]


def as_tuple(values: Any) -> Any:
    """Lists and arrays are tuples in configurations, which do not change."""
    return tuple(np.asarray(values).tolist()) if isinstance(values, (np.ndarray, list)) else values


Place = Annotated[tuple[float, float, float], BeforeValidator(as_tuple)]


@dataclass_transform(frozen_default=True, field_specifiers=(field,))
def checked(kind: type[T]) -> type[T]:
    """Make a class a frozen dataclass whose fields are checked; what they refuse is a ValueError of one line."""
    made: Any = dataclass(kind, frozen=True, config=ConfigDict(extra="forbid", strict=True, allow_inf_nan=False))
    start = made.__init__

    def __init__(self: Any, *arguments: Any, **values: Any) -> None:
        try:
            start(self, *arguments, **values)
        except ValidationError as error:
            raise ValueError(_told(error, kind)) from error

    made.__init__ = __init__
    return made


def from_mapping(kind: type[T], entries: Any, where: str) -> T:
    """A checked dataclass from plain numbers, strings, lists and dicts, nested ones too; errors name `where` and the entry."""
    if not isinstance(entries, Mapping):
        raise ValueError(f"{where} must be an object with named entries, not {entries!r:.200}")
    try:
        plain = json.dumps(dict(entries), default=str)  # JSON, because its lists may be tuples
    except (TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"{where}: {error}") from error
    try:
        return TypeAdapter(kind).validate_json(plain)
    except ValidationError as error:
        raise ValueError(f"{where}: {_told(error, kind)}") from error


def load(kind: type[T], path: str | Path) -> T:
    """A checked dataclass from a JSON file; errors name the file and the entry."""
    path = existing(path)
    try:
        entries = read_json(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:  # nested a thousand deep
        raise ValueError(f"{path}: not JSON: {error}") from error
    return from_mapping(kind, entries, str(path))


def _told(error: ValidationError, kind: Any) -> str:
    """The first thing that is wrong, in a line; a name that is not known before one that is missing."""
    known = [part.name for part in fields(kind)]
    found = error.errors(include_url=False)
    first = next((one for one in found if one["type"] == "unexpected_keyword_argument"), found[0])
    head, *rest = first["loc"] or ("",)
    name_of: dict[Any, str] = dict(enumerate(known))  # arguments may be given by place
    place = ".".join(map(str, (name_of.get(head, head), *rest)))
    if first["type"] == "unexpected_keyword_argument":
        return f"there is no {place!r}" + (f"; there are {', '.join(known)}" if not rest else "")
    if first["type"] == "missing":
        return f"{place!r} is missing"
    message = first["msg"].removeprefix("Value error, ")
    if first["type"] == "value_error" and not place:
        return message
    return f"{place}: {message}, not {first['input']!r:.200}"
