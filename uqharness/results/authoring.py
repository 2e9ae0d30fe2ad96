"""Results of author, performance and export."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from uqharness.results.base import Ends, Number, Numbers, Part, Texts


class AuthoredTerm(Part):
    """A term of an authored model."""

    value: Number = Field(description="value in body axes about the centre of gravity")
    mean: Number = Field(description="mean of the prior: the value, moved by the bias of its class")
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
    static_margin_mean: Number = Field(description="mean of its prior")
    static_margin_std: Number = Field(description="standard deviation of its prior")
    speed_mps: Number = Field(
        description="true airspeed of the steady flight in campaign.toml, m/s"
    )
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


# Results of export: loss.json.


class LossOfCoefficient(Part):
    """Difference between target and source of one dimensionless coefficient over the states."""

    max: Number = Field(description="largest absolute difference")
    rms: Number = Field(description="root mean square of the difference")
    quantile_95: Number = Field(description="95 % of the absolute differences lie below it")
    source_std: Number = Field(description="standard deviation of the source over the states")
    half_width: Number = Field(
        description="mean half-width of the model form; null without one, or without its states"
    )
    beyond: bool = Field(description="whether the 95 % quantile exceeds the half-width")


class Loss(Part):
    """loss.json of `uqharness export`: what the format loses."""

    aircraft: str = Field(description="source")
    format: str = Field(description="format of the model")
    speed_mps: Number = Field(description="true airspeed of the trim, m/s")
    states: int = Field(description="states that were compared")
    verdict: Literal["within", "beyond", "no bounds"] = Field(
        description="within or beyond the half-widths, or without a model form to compare with"
    )
    coefficients: dict[str, LossOfCoefficient] = Field(description="loss by coefficient")
    lost: Texts = Field(description="what the format cannot hold")
    notes: Texts = Field(default=[], description="what the files assume")
    files: Texts = Field(description="files that were written")
    command: str | None = Field(default=None, description="command that made the file")


class ModelSlip(Part):
    """A difference between two models and its usual cause."""

    where: str = Field(description="coefficient and variable, or a quantity with its unit")
    first: Number = Field(description="value in the first model, in the common reference")
    second: Number = Field(description="value in the second model, in the common reference")
    cause: str = Field(description="usual cause; empty where none fits")


class ModelDifference(Part):
    """What `uqharness diff` prints for model files of other programs."""

    models: Texts = Field(description="the two models")
    differ: bool = Field(description="whether they differ; true: exit code 1")
    findings: list[ModelSlip] = Field(description="slopes, geometry and mass that differ")
    coefficients: dict[str, LossOfCoefficient] = Field(
        description="difference of each coefficient over the states"
    )
    states: int = Field(description="states that were compared")
