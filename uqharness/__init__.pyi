from . import sensitivity as sensitivity
from .api.aircraft import find_trim as find_trim
from .api.aircraft import instrument as instrument
from .api.aircraft import linearise as linearise
from .api.campaigns import pbox as pbox
from .api.campaigns import read_campaign as read_campaign
from .api.campaigns import run_campaign as run_campaign
from .api.errors import BadInputError as BadInputError
from .api.errors import LogError as LogError
from .api.flights import fly as fly
from .api.flights import propose_map as propose_map
from .api.flights import read_flights as read_flights
from .api.identification import compare as compare
from .api.identification import fit_model_form as fit_model_form
from .api.identification import identify as identify
from .api.refinement import refine as refine
from .report.plots import plot_pbox as plot_pbox
from .simulator.aircraft import find_aircraft as find_aircraft

__version__: str
