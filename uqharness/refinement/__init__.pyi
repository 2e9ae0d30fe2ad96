from .run import Job as Job
from .run import Refinement as Refinement
