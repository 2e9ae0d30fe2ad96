from .flights import AnyAircraft as AnyAircraft
from .flights import AnyFlight as AnyFlight
from .flights import AnyPath as AnyPath
from .flights import Flight as Flight
from .flights import aircraft_of as aircraft_of
from .flights import carded_aircraft as carded_aircraft
from .flights import content_sha256 as content_sha256
from .flights import flights_of as flights_of
