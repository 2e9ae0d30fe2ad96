"""[start] of campaign.toml: the trimmed flight of a mission that needs no script."""

from __future__ import annotations

from pydantic import Field

from uqharness.settings import Number, Section

STEADY = "steady"
"""The mission that [start] describes."""

MARK = "flight/steady-start"
"""Run property of such a mission: engines begin in the steady state of their throttles, deviations are scored from the start."""


class StartSection(Section):
    """Steady flight, wings level, controls where they trim the nominal model; above flat ground at sea level.

    ``climb_deg`` is the flight-path angle, level where it is None; it is solved for where the throttle gives no thrust.
    """

    V_mps: Number = Field(gt=0, le=1000)
    altitude_m: Number = Field(gt=0, le=30_000)
    heading_deg: Number = Field(default=0.0, ge=0, le=360)
    climb_deg: Number | None = Field(default=None, ge=-45, le=45)
