"""Packages that can be called as functions.

``uq.report(folder)`` is a function of the Python API, but importing the package
``uqharness.report`` makes Python set that module under the same name. `make_callable` lets the
module stand for both.
"""

from __future__ import annotations

import importlib
import inspect
import sys
from types import ModuleType
from typing import Any


def make_callable(package: str, module: str) -> None:
    """Make a package callable as the function of the same name in ``module``.

    ``module`` is imported at the first call.
    """
    name = package.rpartition(".")[2]

    def function() -> Any:
        return getattr(importlib.import_module(module), name)

    class CallableModule(ModuleType):
        """Module that forwards calls, signature and documentation to a function."""

        @property
        def __signature__(self) -> inspect.Signature:
            return inspect.signature(function())

        @property
        def __doc__(self) -> str | None:  # type: ignore[override]
            """Return the function's documentation, which is what a user asks for."""
            return inspect.getdoc(function())

        def __call__(self, *args: Any, **keywords: Any) -> Any:
            return function()(*args, **keywords)

    # Python allows the class of a module that is already imported to be replaced.
    sys.modules[package].__class__ = CallableModule
