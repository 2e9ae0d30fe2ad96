"""Requests of bounds."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, model_validator

from uqharness.requests import fields
from uqharness.requests.base import Flag, Number, Request, option, split_names


def _by_coefficient(value: Any) -> Any:
    """Return names by coefficient with each list of names as a tuple."""
    return (
        {key: split_names(names) for key, names in value.items()}
        if isinstance(value, dict)
        else value
    )


NamesByCoefficient = Annotated[dict[str, tuple[str, ...]], BeforeValidator(_by_coefficient)]


class BoundsRequest(Request):
    """Fit intervals of the model's error as functions of the flight state, sensor noise removed
    (see docs/model-form.md).
    """

    command: ClassVar[str] = "bounds"
    summary: ClassVar[str] = "model-form bounds from flights"
    examples: ClassVar[str] = """
  uqharness bounds espaaro --flight flight2.parquet --out bounds
  uqharness bounds identified/aircraft --flight flight2.bin --roll-terms --out bounds
  uqharness bounds espaaro --flight f.csv --terms "Cm=1,alpha,q,p^2" --outside clamp --out bounds

Writes DIR/model-form.json (read by validate-bounds, instrument and campaigns), DIR/model-form.xml
(the same as a JSBSim system), DIR/report.html and DIR/figures/*.svg, drawn from DIR/bounds.json and
DIR/residuals.parquet.
--as-published keeps noise and model error together, for comparison with the dissertation.
States: V alpha beta phi theta p q r, de da dr (surface positions), dt (throttle)."""

    aircraft: fields.AircraftSource = fields.aircraft()
    flights: fields.FlightSources = fields.flights()
    out: fields.OptionalPath = fields.out(required=False)
    signal_map: fields.OptionalPath = fields.signal_map()
    flight_number: fields.FlightNumbers = fields.flight_number()
    manoeuvres: fields.OptionalPath = fields.manoeuvres()
    servos: fields.Servos = fields.servos()
    confidence: Number = option(
        0.95, "confidence of the intervals, a probability", gt=0, lt=1, metavar="P"
    )
    states: NamesByCoefficient = option(
        {},
        "states of a coefficient's polynomial; repeatable",
        metavar="C=S,S",
        repeat=True,
        needed='states by coefficient, such as {"CX": ["V", "alpha"]}',
    )
    terms: NamesByCoefficient = option(
        {},
        "terms of a coefficient, 1,V,alpha^2,alpha*q; repeatable",
        metavar="C=T,T",
        repeat=True,
        needed='terms by coefficient, such as {"Cm": ["1", "alpha", "p^2"]}',
    )
    order: Literal[0, 1, 2, 3] = option(2, "order of the full polynomials")
    roll_terms: Flag = option(False, "roll rate among the states of Cm (dissertation, Fig 2.10)")
    select: Literal["full", "stepwise"] = option(
        "full", "all terms, or those that a partial F test keeps"
    )
    as_published: Flag = option(
        False,
        "the dissertation's interval of a measured sample, sensor noise included (default: the"
        " model's error alone)",
    )
    sample_size: Literal["effective", "all"] | None = option(
        None,
        "with --as-published: count all samples (default), or the effective sample size, which"
        " allows for autocorrelation",
    )
    outside: Literal["grow", "clamp"] = option(
        "grow",
        "outside the envelope box: grow as in the dissertation, or stay constant",
    )
    cutoff_hz: Number = option(6.0, "differentiator and smoother, Hz", gt=0, metavar="F")
    airspeed_cutoff_hz: Number = option(
        2.0, "low-pass of the airspeed, Hz; 0: none", ge=0, metavar="F"
    )
    walk_cutoff_hz: Number = option(
        0.5, "low-pass for the rate of variation, Hz", gt=0, metavar="F"
    )
    checks: Flag = fields.checks("the leave-one-out check and the check with other filters")
    figures: Flag = fields.figures()

    @model_validator(mode="after")
    def _check_sample_size(self) -> BoundsRequest:
        """Refuse a sample size that has no meaning."""
        if self.sample_size is not None and not self.as_published:
            raise ValueError(
                "{sample_size} requires {as_published}: bounds of the model error account for"
                " autocorrelation already; omit it, or add {as_published}"
            )
        return self
