"""Conversion factors to SI units, and numbers as text.

``FT_M`` is the number of metres in a foot, ``RAD_DEG`` the degrees in a radian; a slug is a lbf
s2/ft and a psf a lbf/ft2. Five factors are rounded, with the exact value in a comment: existing
records, fits and tables were made with the rounded ones, and the exact ones would change their
last digits.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

IN_M = 0.0254
FT_M = 0.3048
KT_MPS = 1852.0 / 3600.0
LB_KG = 0.45359237
LBF_N = 4.4482216152605
SLUG_LB = 32.174049  # 32.1740485564304; JSBSim's own
SLUG_KG = 14.593902937206  # 14.5939029372063648
PSF_PA = 47.880258980336  # 47.8802589803358372
LBF_FT_NM = 1.3558179483314  # a moment; 1.3558179483314004
SLUG_FT2_KGM2 = 1.3558179483314004
SLUG_FT3_KGPM3 = 515.378818  # 515.3788183931961
RAD_DEG = math.degrees(1.0)
DEG_RAD = math.radians(1.0)
SHORT_DEG_RAD = 0.017453293  # JSBSim's own, where a component takes an angle in degrees
G0_MPS2 = 9.80665
"""Standard gravity, m/s2. The gravity of JSBSim depends on the place."""
SEA_LEVEL_KGPM3 = 1.225
"""Density of the standard atmosphere at sea level, kg/m3."""


UNITS: Mapping[str, Mapping[str, float]] = {
    "rad": {
        "rad": 1.0,
        "deg": DEG_RAD,
        "degree": DEG_RAD,
        "degrees": DEG_RAD,
        "°": DEG_RAD,
        "mrad": 1e-3,
    },
    "rad/s": {
        **dict.fromkeys(("rad/s", "radps", "rad/sec", "rads", "rps"), 1.0),
        **dict.fromkeys(("deg/s", "degps", "deg/sec", "dps", "degs", "°/s"), DEG_RAD),
        "mrad/s": 1e-3,
    },
    "m/s": {
        **dict.fromkeys(("m/s", "mps", "m/sec", "ms"), 1.0),
        **dict.fromkeys(("kt", "kts", "kn", "knots", "knot"), KT_MPS),
        **dict.fromkeys(("ft/s", "fps", "ft/sec"), FT_M),
        **dict.fromkeys(("ft/min", "fpm"), FT_M / 60.0),
        **dict.fromkeys(("km/h", "kmh", "kph"), 1.0 / 3.6),
        **dict.fromkeys(("mph", "mi/h"), 0.44704),
        "cm/s": 0.01,
        "cms": 0.01,
    },
    "m/s2": {
        **dict.fromkeys(("m/s2", "m/s^2", "m/s/s", "mps2", "mss", "m/s²"), 1.0),
        **dict.fromkeys(("g", "gs", "gn"), G0_MPS2),
        "mg": 1e-3 * G0_MPS2,
        **dict.fromkeys(("ft/s2", "ft/s^2", "fps2", "ft/sec2"), FT_M),
    },
    "m": {"m": 1.0, "ft": FT_M, "feet": FT_M, "cm": 0.01, "mm": 1e-3, "km": 1e3},
    "deg": {"deg": 1.0, "degree": 1.0, "degrees": 1.0, "°": 1.0, "rad": 1.0 / DEG_RAD},
    "%": {"%": 1.0, "pct": 1.0, "percent": 1.0, "norm": 100.0},
    "1/min": {"rpm": 1.0, "1/min": 1.0, "hz": 60.0, "1/s": 60.0},
    "N": {"n": 1.0, "lbf": LBF_N, "lbs": LBF_N, "lb": LBF_N, "kn": 1e3, "kgf": G0_MPS2},
    "kg/m3": {"kg/m3": 1.0, "kg/m^3": 1.0, "kgpm3": 1.0, "slug/ft3": SLUG_FT3_KGPM3},
}
"""Unit of a signal -> unit as people write it -> factor into the unit of the signal."""


def significant(value: float, digits: int = 2) -> str:
    """Format a number with `digits` significant digits, without an exponent for usual sizes.

    Parameters
    ----------
    value : float
        Any number.
    digits : int
        Significant digits.

    Returns
    -------
    str
        ``100``, ``0.035``, ``1.3``; an exponent only below 1e-4 and from 1e7 on.

    Examples
    --------
    >>> significant(104.0), significant(0.0345), significant(99.7), significant(1.2e-7)
    ('100', '0.035', '100', '1.2e-07')
    """
    rounded = float(f"{value:.{max(digits, 1) - 1}e}")
    if rounded != 0.0 and not 1e-4 <= abs(rounded) < 1e7:
        return f"{value:.{digits}g}"
    return f"{rounded:.{max(digits, 7)}g}"


def percent(share: float, digits: int = 2) -> str:
    """Format a share as a percentage: ``100 %``, ``0.34 %``.

    Examples
    --------
    >>> percent(1.0), percent(0.0034)
    ('100 %', '0.34 %')
    """
    return f"{significant(100.0 * share, digits)} %"


def counted(number: float, noun: str) -> str:
    """Format a number with its noun in the singular or plural.

    Examples
    --------
    >>> counted(1, "excursion"), counted(0.1, "excursion")
    ('1 excursion', '0.1 excursions')
    """
    return f"{number:g} {noun}" + ("" if number == 1 else "s")
