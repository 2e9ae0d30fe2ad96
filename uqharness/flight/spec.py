"""What defines one simulated flight, and what comes back from it."""

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
"""Wind at 20 ft for each intensity, knots (MIL-F-8785C 3.7.3.2, Fig 7)."""

TURBULENCE_CEILING_M = 304.8
"""Height above the ground up to which the low-altitude model of MIL-F-8785C is defined: 1000 ft
(3.7.3.4).
"""

BELOW_CEILING = (
    'begin lower, or fly with turbulence = "none", or with turbulence_source = "jsbsim" if the'
    " aircraft has the air system (docs/air.md)"
)
"""What to do about a flight that begins above TURBULENCE_CEILING_M."""

DEFAULT_TURBULENCE_SOURCE: Literal["jsbsim", "spec"] = "spec"
"""Which Dryden model flies unless asked otherwise: the one without a mean gust in a turn
(docs/air.md).
"""

COEFFICIENTS = ("CX", "CY", "CZ", "Cl", "Cm", "Cn")
"""Body-axis force and moment coefficients, in the order in which they are always listed."""

STATUSES = ("ok", "diverged", "ground-contact", "crashed", "timeout")
"""How a flight ends. crashed: an exception, the loss of its process, and in campaigns older than
ground-contact the ground.
"""


@dataclass(frozen=True)
class LevelDriver:
    """How the levels of one epistemic sample move in flight: ``kind`` white (redrawn each step) or
    walk (reflecting random walk).

    ``coefficients`` move, each in the stream (root seed, epistemic id, coefficient);
    ``rates_per_sqrt_s`` (1/sqrt(s), one per coefficient) belong to a walk and are empty for white.
    Levels that stand still are plain ``properties``."""

    kind: Literal["white", "walk"]
    root_seed: int
    epistemic_id: str
    coefficients: tuple[str, ...]
    rates_per_sqrt_s: tuple[float, ...] = ()


@dataclass(frozen=True)
class TransientDriver:
    """How the transient model error moves in flight: reflecting random walks of
    uq/<C>/transient-level in -1..1.

    Each of ``coefficients`` walks in the stream (root seed, aleatory id, coefficient): chance, the
    same at every corner of one air. ``rates_per_sqrt_s`` (1/sqrt(s), one per coefficient) are of
    the walk's width, as those of a LevelDriver."""

    root_seed: int
    aleatory_id: int
    coefficients: tuple[str, ...]
    rates_per_sqrt_s: tuple[float, ...]


@dataclass(frozen=True)
class FlightSpec:
    """One flight of a mission script, complete: the same spec gives the same bytes in any process.

    ``duration_s`` is scored and follows ``burn_in_s``, which is flown and not scored.
    ``seed_turbulence`` and ``seed_noise`` are the streams of the air and of the sensors (any
    integers >= 0). ``properties`` are set after loading, before initialising (levels, bounds,
    coefficients, gains); they win over the script's own run properties. ``levels`` moves
    uq/<C>/level each step, ``transient`` uq/<C>/transient-level."""

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
    """Outcome of one flight.

    ``status`` is one of STATUSES; ``reason`` says why it is not ``ok``. ``metrics`` holds finite
    numbers, or NaN where the quantity is undefined (the reason is then in ``undefined[name]``).
    ``signals`` is the record of the scored part, (samples,) arrays at ``record_rate_hz`` by name,
    ``time_s`` included; empty if it was not kept."""

    status: str
    reason: str
    flown_s: float
    metrics: Mapping[str, float]
    undefined: Mapping[str, str]
    signals: Mapping[str, NDArray[np.float64]]
