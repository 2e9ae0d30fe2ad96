from .coverage import coverage_page_of as coverage_page_of
from .index import kind_of as kind_of
from .model_form import RESIDUALS as RESIDUALS
from .model_form import slice_section as slice_section
from .model_form import variation_section as variation_section
from .next_flight import next_flight_page as next_flight_page
from .next_flight import uncertainty_figures as uncertainty_figures
