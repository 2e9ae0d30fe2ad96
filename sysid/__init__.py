"""Flight logs, identification and model-form uncertainty. Knows nothing of JSBSim."""

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
