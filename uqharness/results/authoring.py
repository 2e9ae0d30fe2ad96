"""Results of author and performance."""

from __future__ import annotations

from pydantic import Field

from uqharness.results.base import Ends, Number, Numbers, Part, Texts


class AuthoredTerm(Part):
    """A term of an authored model."""

    value: Number = Field(description="value in body axes about the centre of gravity")
    std: Number = Field(description="standard deviation of the prior")
    unit: str = Field(description="1, 1/rad, 1/rad^2 or 1/deg")
    class_name: str = Field(description="class of the prior")


class SlipFound(Part):
    """A usual slip in a source."""

    kind: str = Field(description="such as sign, axes, deg/rad")
    place: str = Field(description="file and line")
    message: str = Field(description="received and expected")
    effect: str = Field(description="effect on the flight")


class Authored(Part):
    """What `uqharness author` prints."""

    aircraft: str | None = Field(description="folder of the aircraft; null if not written")
    tool: str = Field(description="program of the source")
    reference: Numbers = Field(description="S_m2, b_m, c_m, mass_kg")
    static_margin: Number = Field(description="neutral point behind the CG over the chord")
    static_margin_std: Number = Field(description="standard deviation of its prior")
    speed_mps: Number = Field(description="speed that makes the prior's rates dimensionless, m/s")
    terms: dict[str, AuthoredTerm] = Field(description="terms by property")
    mixing: dict[str, str] = Field(description="surfaces of each control")
    slips: list[SlipFound] = Field(description="usual slips that were found")
    notes: Texts = Field(description="assumptions")


class PerformanceFigure(Part):
    """A figure of the performance sheet."""

    value: Number = Field(description="nominal value; null where undefined")
    interval: Ends = Field(description="lowest and highest over the corners of the bounds")
    unit: str = Field(description="unit of value and interval")
    reason: str = Field(description="why it is undefined; empty otherwise")


class SpeedRow(Part):
    """The sheet at one speed."""

    V_mps: Number = Field(description="true airspeed, m/s")
    lift_to_drag: Number = Field(description="lift over drag")
    drag_N: Number = Field(description="drag, N")
    thrust_N: Number = Field(description="thrust at full throttle, N")
    climb_mps: Number = Field(description="steady rate of climb at full throttle, m/s")
    alpha_deg: Number = Field(description="angle of attack, deg")


class Performance(Part):
    """What `uqharness performance` prints."""

    aircraft: str = Field(description="the aircraft")
    altitude_m: Number = Field(description="altitude above sea level, m")
    mass_kg: Number = Field(description="mass, kg")
    figures: dict[str, PerformanceFigure] = Field(description="figures by name")
    speeds: list[SpeedRow] = Field(description="the nominal sheet against speed")
    bounds: str = Field(description="bounds behind the intervals; empty without any")
    notes: Texts = Field(description="assumptions")
