"""Packages that are functions as well: ``uq.report(folder)`` beside ``uqharness.report``, which
Python sets under the same name.
"""

from __future__ import annotations

import importlib
import inspect
import sys
from types import ModuleType
from typing import Any


def make_callable(package: str, module: str) -> None:
    """Let ``package`` be called as the function of its last name in ``module``, which is loaded at
    the first call.
    """
    name = package.rpartition(".")[2]

    def function() -> Any:
        return getattr(importlib.import_module(module), name)

    class CallableModule(ModuleType):
        """A module that is a function too."""

        @property
        def __signature__(self) -> inspect.Signature:
            return inspect.signature(function())

        @property
        def __doc__(self) -> str | None:  # type: ignore[override]
            """Return the function's documentation, which is what a user asks for."""
            return inspect.getdoc(function())

        def __call__(self, *args: Any, **keywords: Any) -> Any:
            return function()(*args, **keywords)

    sys.modules[package].__class__ = CallableModule
