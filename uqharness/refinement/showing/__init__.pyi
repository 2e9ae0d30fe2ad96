from .content import Refinement as Refinement
from .words import carried_by as carried_by
from .words import left_over as left_over
from .words import nowhere as nowhere
from .words import place_says as place_says
from .words import smooth_says as smooth_says
from .words import test_says as test_says
