from .run import Refinement as Refinement
from .run import Request as Request
