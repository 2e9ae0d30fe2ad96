"""Flight logs, identification and model-form uncertainty. Knows nothing of JSBSim."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sysid.errors import LogError
    from sysid.estimation.filter_error import filter_error
    from sysid.estimation.output_error import output_error
    from sysid.estimation.regression import equation_error
    from sysid.estimation.stepwise import stepwise
    from sysid.model_form.model_form import ModelForm, read_model_form
    from sysid.record import FlightRecord

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
    "FlightRecord": "record",
    "LogError": "errors",
    "ModelForm": "model_form.model_form",
    "equation_error": "estimation.regression",
    "filter_error": "estimation.filter_error",
    "output_error": "estimation.output_error",
    "read_model_form": "model_form.model_form",
    "stepwise": "estimation.stepwise",
}


def __getattr__(name: str) -> Any:
    """Names are loaded at their first use: what needs one small module does not wait for scipy, pandas and pyarrow."""
    if name not in _HOMES:
        raise AttributeError(f"module 'sysid' has no attribute '{name}'")
    return getattr(importlib.import_module(f"sysid.{_HOMES[name]}"), name)
