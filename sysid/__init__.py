"""Flight logs, identification and model-form uncertainty. Knows nothing of JSBSim."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sysid.filtererror import filter_error
    from sysid.flight_record import FlightRecord
    from sysid.log_errors import LogError
    from sysid.model_form import ModelForm, read_model_form
    from sysid.outputerror import output_error
    from sysid.regression import equation_error
    from sysid.selection import stepwise

__all__ = [
    "FlightRecord",
    "LogError",
    "ModelForm",
    "equation_error",
    "filter_error",
    "output_error",
    "read_model_form",
    "stepwise",
]

_HOMES = {
    "FlightRecord": "flight_record",
    "LogError": "log_errors",
    "ModelForm": "model_form",
    "equation_error": "regression",
    "filter_error": "filtererror",
    "output_error": "outputerror",
    "read_model_form": "model_form",
    "stepwise": "selection",
}


def __getattr__(name: str) -> Any:
    """Names are loaded at their first use: what needs one small module does not wait for scipy, pandas and pyarrow."""
    if name not in _HOMES:
        raise AttributeError(f"module 'sysid' has no attribute '{name}'")
    return getattr(importlib.import_module(f"sysid.{_HOMES[name]}"), name)
