"""Docstrings of the public face, by their numpydoc sections."""

from __future__ import annotations

import inspect
import re

import sysid
import uqharness

_HEADING = re.compile(r"^(\w[\w ]*)\n-{3,}$", re.M)


def sections(docstring: str) -> dict[str, str]:
    """Heading -> text of a numpydoc docstring."""
    parts = _HEADING.split(inspect.cleandoc(docstring))
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def example_of(thing: object) -> str:
    """The examples of a docstring."""
    return sections(thing.__doc__ or "").get("Examples", "")


def public_functions() -> list[tuple[str, str]]:
    """(package, name) of the public functions, none of them loaded: those of their names that do
    not begin like a class.
    """
    faces = (uqharness, sysid, uqharness.sensitivity)
    return [
        (face.__name__, name)
        for face in faces
        for name in face.__all__
        if name[0].islower() and name != "sensitivity"
    ]
