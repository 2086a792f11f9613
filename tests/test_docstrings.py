"""Docstrings of what is public keep step with the signatures: by numpydoc's own checks."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import numpydoc.docscrape
import numpydoc.validate
import pytest

FACES = (
    "topokit",
    "topokit.rips",
    "topokit.rips.reduction",
    "topokit.sampling",
    "topokit.seqph",
    "topokit.mixture",
    "topokit.linking",
    "topokit.io",
    "topokit.sensors",
    "topokit.lemmas",
    "topokit.sim",
    "topokit.control",
    "topokit.data",
    "topokit.models",
    "topokit.evaluate",
    "topokit.view",
)
PARAMETERS = ("PR01", "PR02", "PR03")  # one is not documented, is not there, or stands in another place


def public(face: str) -> Iterator[tuple[str, Any]]:
    """Functions, classes and their public methods that a module shows, by their full names."""
    module = importlib.import_module(face)
    for name in module.__all__:
        thing = getattr(module, name)
        if isinstance(thing, ModuleType) or not (inspect.isclass(thing) or inspect.isfunction(thing)):
            continue
        yield f"{face}.{name}", thing
        if inspect.isclass(thing):
            for part, method in vars(thing).items():
                if not part.startswith("_") and inspect.isfunction(getattr(method, "__func__", method)):
                    yield f"{face}.{name}.{part}", getattr(method, "__func__", method)


def arguments(thing: Any) -> list[str]:
    """Names of the arguments; none for a dataclass, whose fields are told under Attributes or beside them."""
    if dataclasses.is_dataclass(thing) and "Parameters\n" not in (thing.__doc__ or ""):
        return []
    try:
        names = list(inspect.signature(thing).parameters)
    except ValueError:  # a class of the interpreter's own, such as an error
        return []
    return [name for name in names if name not in ("self", "cls")]


def is_protocol(kind: type) -> bool:
    """Return True for an interface, which nobody calls: its methods are checked."""
    return getattr(kind, "_is_protocol", False)


@pytest.mark.parametrize("face", FACES)
def test_every_argument_is_told(face):
    wrong = []
    for name, thing in public(face):
        assert inspect.getdoc(thing), f"{name} has no docstring"
        if len(arguments(thing)) < 2 and "Parameters\n" not in (thing.__doc__ or ""):
            continue
        if inspect.isclass(thing) and (not arguments(thing) or is_protocol(thing)):
            continue
        found = numpydoc.validate.validate(name)["errors"]
        wrong += [f"{name}: {words}" for code, words in found if code in PARAMETERS]
    assert not wrong, "\n".join(wrong)
