from .start import run as run
