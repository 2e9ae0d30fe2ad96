from .content import Refinement as Refinement
