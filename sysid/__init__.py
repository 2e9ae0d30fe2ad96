"""System identification from flight records: estimators whose stated bounds tell the truth. Knows no simulator."""

from sysid.filtererror import filter_error
from sysid.outputerror import output_error
from sysid.regression import equation_error
from sysid.selection import stepwise

__all__ = ["equation_error", "filter_error", "output_error", "stepwise"]
