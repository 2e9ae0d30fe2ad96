from .dask import DaskExecutor as DaskExecutor
from .processes import Executor as Executor
from .processes import ProcessExecutor as ProcessExecutor
from .processes import SerialExecutor as SerialExecutor
from .worker import CaseOutcome as CaseOutcome
from .worker import FlightFunction as FlightFunction
from .worker import attempt as attempt
