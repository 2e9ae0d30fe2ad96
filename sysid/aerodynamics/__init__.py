"""Aerodynamic coefficients from flight data, their residuals against a model, and linearised
flights.

`coefficients` computes demanded coefficients, `residuals` subtracts a model, `sensor_noise` and
`air_motion` describe the noise and the air in the difference; `rigid_body` and `flight_equations`
linearise a flight for estimators.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
