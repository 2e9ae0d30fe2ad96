"""Results of export: loss.json."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from uqharness.results.base import Number, Part, Texts


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
