from .errors import LogError as LogError
from .estimation.equation_error import equation_error as equation_error
from .estimation.filter_error import filter_error as filter_error
from .estimation.output_error import output_error as output_error
from .estimation.stepwise import stepwise as stepwise
from .model_form.model_form import ModelForm as ModelForm
from .model_form.model_form import read_model_form as read_model_form
from .record import FlightRecord as FlightRecord
