"""From a flight log to an identified model with honest bounds. Knows nothing of JSBSim."""

from sysid.flight_record import FlightRecord
from sysid.log_errors import LogError

__all__ = ["FlightRecord", "LogError"]
