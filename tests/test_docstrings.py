"""Docstrings of what is public keep step with the signatures: by numpydoc's own checks."""

from __future__ import annotations

import dataclasses
import importlib
import inspect

import numpydoc.validate
import pytest

FACES = """
topokit topokit.control topokit.data topokit.evaluate topokit.io topokit.lemmas topokit.linking topokit.mixture topokit.models
topokit.rips topokit.rips.reduction topokit.sampling topokit.sensors topokit.seqph topokit.sim topokit.view
"""
PARAMETERS = ("PR01", "PR02", "PR03")  # one is not documented, is not there, or stands in another place


def has_parameters(thing: object) -> bool:
    """Return True for what lists its arguments: not for one of a single argument, a dataclass or an interface."""
    if "Parameters\n" in (thing.__doc__ or ""):
        return True
    if dataclasses.is_dataclass(thing) or getattr(thing, "_is_protocol", False):
        return False
    try:
        names = {*inspect.signature(thing).parameters}
    except ValueError:  # a class of the interpreter's own, such as an error
        return False
    return len(names - {"self", "cls"}) > 1


@pytest.mark.parametrize("face", FACES.split())
def test_every_argument_is_told(face):
    module = importlib.import_module(face)
    shown = {name: getattr(module, name) for name in module.__all__}
    shown |= {
        f"{name}.{part}": getattr(method, "__func__", method)
        for name, kind in shown.items()
        if inspect.isclass(kind)
        for part, method in vars(kind).items()
        if not part.startswith("_") and inspect.isfunction(getattr(method, "__func__", method))
    }
    for name, thing in shown.items():
        if inspect.isclass(thing) or inspect.isfunction(thing):
            assert inspect.getdoc(thing), f"{name} has no docstring"
            errors = numpydoc.validate.validate(f"{face}.{name}")["errors"] if has_parameters(thing) else []
            assert not [words for code, words in errors if code in PARAMETERS], name
