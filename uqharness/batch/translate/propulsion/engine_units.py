"""Units of engine files and the factors by which JSBSim 1.3.3 converts them: some have fewer digits than the units themselves."""

from __future__ import annotations

import math
from collections.abc import Mapping

from sysid.units import LB_KG

UNITS: Mapping[str, Mapping[str, float]] = {
    "IN": {"IN": 1.0, "FT": 12.0, "M": 3.2808399 * 12.0},
    "FT": {"FT": 1.0, "IN": 1.0 / 12.0, "M": 3.2808399, "CM": 0.032808399},
    "FT2": {"FT2": 1.0, "IN2": 1.0 / 144.0},
    "IN3": {"IN3": 1.0, "CC": 1.0 / 16.387064, "LTR": 61.0237441},
    "LBS": {"LBS": 1.0, "KG": 1.0 / LB_KG, "N": 0.22482},
    "SLUG*FT2": {"SLUG*FT2": 1.0, "KG*M2": 1.0 / 1.35594},
    "RAD": {"RAD": 1.0, "DEG": 1.0 / (180.0 / math.pi)},
    "WATTS": {"WATTS": 1.0, "HP": 1.0 / 0.001341022},
    "HP": {"HP": 1.0, "WATTS": 0.001341022},
    "INHG": {"INHG": 1.0, "PSF": 1.0 / 70.7180803, "ATM": 29.9246899, "PSI": 2.03625437},
    "PSI": {"PSI": 1.0, "INHG": 1.0 / 2.03625437},
    "PA": {"PA": 1.0, "INHG": 3386.0},
    "KG": {"KG": 1.0, "LBS": LB_KG},
    "LBS/HP*HR": {"LBS/HP*HR": 1.0, "KG/KW*HR": 1.0 / 0.6083},
    "VOLTS": {"VOLTS": 1.0},
    "OHMS": {"OHMS": 1.0},
    "AMPERES": {"AMPERES": 1.0},
}
"""Unit that is wanted to units that may be given and the factor by which JSBSim converts them."""

MANIFOLD_PA_INHG, MANIFOLD_PA_PSF = 3386.38, 47.88
"""What JSBSim's piston engines compute with."""
