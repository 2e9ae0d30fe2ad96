"""Definition and result of one simulated flight.

A `FlightSpec` fixes everything: equal specs give bit-identical flights in any process. A
`FlightResult` holds scores and, if kept, signals.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

TURBULENCE_W20_KT: Mapping[str, float] = MappingProxyType(
    {"none": 0.0, "light": 15.0, "moderate": 30.0, "severe": 45.0}
)
"""Wind at 20 ft of each intensity [kt] (MIL-F-8785C 3.7.3.2, Fig 7)."""

TURBULENCE_CEILING_M = 304.8
"""Ceiling of MIL-F-8785C's low-altitude model, 1000 ft above the ground (3.7.3.4) [m]."""

BELOW_CEILING = (
    'begin lower, or fly with turbulence = "none", or with turbulence_source = "jsbsim" if the'
    " aircraft has the air system (docs/air.md)"
)
"""Advice for a flight that starts above TURBULENCE_CEILING_M."""

DEFAULT_TURBULENCE_SOURCE: Literal["jsbsim", "spec"] = "spec"
"""Dryden model used by default: the one without a mean gust in a turn (docs/air.md)."""

COEFFICIENTS = ("CX", "CY", "CZ", "Cl", "Cm", "Cn")
"""Body-axis force and moment coefficients in their usual order."""

DIVERGED_FPS = 3e5
"""Speed [ft/s] from which a flight has diverged: an integration that explodes, finite or not."""

STATUSES = ("ok", "diverged", "ground-contact", "crashed", "timeout")
"""How a flight ends. ``crashed``: an exception, the loss of its process, and in campaigns older
than ``ground-contact`` also ground contact.
"""


@dataclass(frozen=True)
class LevelDriver:
    """Motion of the levels of one epistemic sample in flight.

    Attributes
    ----------
    kind : str
        ``white`` (redrawn in each step) or ``walk`` (reflecting random walk).
    root_seed, epistemic_id
        Key of the streams, together with the coefficient.
    coefficients : tuple of str
        Coefficients whose levels move. Constant levels are plain properties.
    rates_per_sqrt_s : tuple of float
        Rate of each walk [1/sqrt(s)]; empty for ``white``.
    """

    kind: Literal["white", "walk"]
    root_seed: int
    epistemic_id: str
    coefficients: tuple[str, ...]
    rates_per_sqrt_s: tuple[float, ...] = ()


@dataclass(frozen=True)
class TransientDriver:
    """Motion of the transient model error: reflecting walks of uq/<C>/transient-level in -1..1.

    Attributes
    ----------
    root_seed, aleatory_id : int
        Key of the streams, together with the coefficient: chance, equal at all corners of one air.
    coefficients : tuple of str
        Coefficients that have a transient error.
    rates_per_sqrt_s : tuple of float
        Rates relative to the walk's width [1/sqrt(s)], one for each coefficient.
    """

    root_seed: int
    aleatory_id: int
    coefficients: tuple[str, ...]
    rates_per_sqrt_s: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class FlightSpec:
    """One flight of a mission script.

    Attributes
    ----------
    aircraft, script : Path
        What is flown.
    duration_s, burn_in_s : float
        Scored time, and time flown before it [s].
    wind_mps, wind_from_deg : float
        Steady wind [m/s] and the direction it blows from [deg].
    turbulence, turbulence_source : str
        Intensity, and the Dryden model ("jsbsim" or "spec").
    sensor_noise : bool
        Whether sensors are noisy.
    seed_turbulence, seed_noise : int
        Streams of air and sensors, at least 0.
    properties : mapping
        Set after loading and before initialising; they replace the script's run properties.
    excursion_radius_m, rearm_m
        Radii of excursions, and re-arming distance inside them [m].
    record_rate_hz : float
        Recorded rows per second [Hz].
    levels, transient
        What moves uq/<C>/level and uq/<C>/transient-level in each step.
    """

    aircraft: Path
    script: Path
    duration_s: float
    burn_in_s: float = 0.0
    wind_mps: float = 0.0
    wind_from_deg: float = 270.0
    turbulence: str = "none"
    turbulence_source: str = DEFAULT_TURBULENCE_SOURCE
    sensor_noise: bool = False
    seed_turbulence: int = 0
    seed_noise: int = 0
    properties: Mapping[str, float] = field(default_factory=dict)
    excursion_radius_m: tuple[float, ...] = (15.0, 25.0)
    rearm_m: float = 2.0
    record_rate_hz: float = 10.0
    levels: LevelDriver | None = None
    transient: TransientDriver | None = None


@dataclass(frozen=True)
class FlightResult:
    """Result of one flight.

    Attributes
    ----------
    status, reason : str
        One of STATUSES, and why it is not ``ok``.
    flown_s : float
        Time at the end [s].
    metrics : mapping
        Finite numbers, or NaN for undefined quantities.
    undefined : mapping
        Undefined metric to the reason.
    signals : mapping
        Signal of the scored part to (n,), ``time_s`` included; empty if not kept.
    """

    status: str
    reason: str
    flown_s: float
    metrics: Mapping[str, float]
    undefined: Mapping[str, str]
    signals: Mapping[str, NDArray[np.float64]]
