from .campaign import CampaignResult as CampaignResult
from .flights import AnyAircraft as AnyAircraft
from .flights import Flight as Flight
from .flights import aircraft_of as aircraft_of
from .flights import carded_aircraft as carded_aircraft
from .flights import flights_of as flights_of
