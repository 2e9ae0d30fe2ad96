"""Flight logs, identification and model-form uncertainty. Knows nothing of JSBSim."""

from sysid.filtererror import filter_error
from sysid.outputerror import output_error
from sysid.regression import equation_error
from sysid.selection import stepwise

__all__ = ["equation_error", "filter_error", "output_error", "stepwise"]
