"""Whether this installation can compile."""

from __future__ import annotations

from importlib.util import find_spec


def available() -> str | None:
    """Return None if the batch engine can be used, else a sentence that says why not."""
    if find_spec("llvmlite") is None:
        return (
            "llvmlite is not installed, so flights are flown by JSBSim; pip install llvmlite for"
            " the batch engine"
        )
    return None
