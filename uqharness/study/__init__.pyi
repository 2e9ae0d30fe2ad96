from .run import run_chain as run_chain
from .spec import read_chain as read_chain
