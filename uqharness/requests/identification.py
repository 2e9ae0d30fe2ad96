"""Requests of identify, compare, bounds and validate-bounds."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, model_validator

from uqharness.requests import fields
from uqharness.requests.base import Flag, Names, Number, Request, option, split_names


def _by_coefficient(value: Any) -> Any:
    """Return names by coefficient with each list of names as a tuple."""
    return (
        {key: split_names(names) for key, names in value.items()}
        if isinstance(value, dict)
        else value
    )


NamesByCoefficient = Annotated[dict[str, tuple[str, ...]], BeforeValidator(_by_coefficient)]


class IdentifyRequest(Request):
    """Estimate an aircraft's parameters from flight logs or records by output error, or by filter
    error in turbulence (see docs/identification.md).
    """

    command: ClassVar[str] = "identify"
    no: ClassVar[str] = "not converged, or no parameter identified"
    examples: ClassVar[str] = """
  uqharness identify espaaro --flight doublets.parquet --out identified
  uqharness identify espaaro --flight flight1.bin --servos ideal --out identified
  uqharness identify espaaro --flight a.csv b.csv --params aero/Cm_q,aero/Cm_de --out identified

Writes DIR/fit.json, DIR/report.html, DIR/parameters.csv, DIR/figures/*.svg, and DIR/aircraft, an
AIRCRAFT with the estimates."""

    aircraft: fields.AircraftSource = fields.aircraft()
    flights: fields.FlightSources = fields.flights()
    out: fields.OptionalPath = fields.out(required=False)
    signal_map: fields.OptionalPath = fields.signal_map()
    flight_number: fields.FlightNumbers = fields.flight_number()
    manoeuvres: fields.OptionalPath = fields.manoeuvres()
    servos: fields.Servos = fields.servos()
    biases: fields.Channels = fields.biases()
    delays: fields.DelayedSignals = fields.delays()
    parameters: Annotated[Names, Field(min_length=1)] | None = option(
        None,
        "JSBSim properties to estimate (default: the card's [parameters] that the flights excite)",
        flag="--params",
        key="params",
        metavar="P,P",
        kind="str or sequence of str, optional",
        needed="a property or several, such as aero/Cm_q,",
    )
    outputs: fields.Channels = option(
        None,
        "channels to fit, such as q,alpha,az (default: all with --params, else those that an"
        " estimated parameter affects)",
        metavar="C,C",
        kind="str or sequence of str, optional",
    )
    start: Literal["initial", "current"] = option(
        "current", "start values: `initial` of the card, or the values in the XML (current)"
    )
    method: Literal["auto", "output-error", "filter-error"] = option(
        "auto",
        "auto: output error, then filter error if its residuals show turbulence; equation error on"
        " the complete flight for a log without test manoeuvres",
    )
    prior: fields.OptionalPath = option(
        None,
        'priors of parameters: TOML with [parameters."aero/Cm_q"] mean, std, source, or the'
        " model-form.json that `author` writes",
        metavar="FILE",
    )
    split: fields.Split = fields.split()
    workers: fields.Workers = fields.workers()
    figures: Flag = fields.figures()


class CompareRequest(Request):
    """Replay a flight segment by segment and compare the residuals with the sensor noise.

    With a second aircraft: which of the two predicts the flight better.
    """

    command: ClassVar[str] = "compare"
    done: ClassVar[str] = "the model reaches the noise floor; with two aircraft, an answer"
    no: ClassVar[str] = "it does not"
    examples: ClassVar[str] = """
  uqharness compare espaaro --flight doublets.parquet --out gap
  uqharness compare identified/aircraft --flight flight3.bin --servos ideal --out gap
  uqharness compare espaaro identified/aircraft --flight flight3.bin

With two aircraft A and B: both predict the flight open loop over .2 to 10 s, from every second on.
The score is the CRPS, with predictive distributions from the errors in the other blocks of time.
The answer is A, B or no difference, by a block bootstrap (95 %), with the shortest horizon at which
they differ; DIR has compare.json.

Writes DIR/compare.json, channels.csv, coefficients.csv, manoeuvres.csv, moments.csv,
histories.parquet, report.html and figures/*.svg. The model reaches the noise floor if the rms of
measured minus model is at most 1.15 times the noise in every recorded channel of V, alpha, beta,
phi, theta, p, q, r, ax, ay and az."""

    aircraft: fields.AircraftSource = fields.aircraft()
    other: fields.AircraftSource = option(
        None,
        "second aircraft: which of the two predicts the flight better",
        flag="",
        metavar="AIRCRAFT",
        kind="str, Path or Aircraft, optional",
        toml=False,
    )
    flight: Annotated[fields.FlightSources, Field(max_length=1)] = option(
        ...,
        fields.FLIGHT_FILE,
        metavar="FILE",
        positional=True,
        kind="flight",
        needed="one flight (a path, a FlightRecord, a Flight)",
        toml=False,
    )
    out: fields.OptionalPath = fields.out(required=False)
    signal_map: fields.OptionalPath = fields.signal_map()
    flight_number: fields.FlightNumbers = fields.flight_number()
    manoeuvres: fields.OptionalPath = fields.manoeuvres()
    servos: fields.Servos = fields.servos()
    biases: fields.Channels = fields.biases()
    delays: fields.DelayedSignals = fields.delays()
    workers: fields.Workers = fields.workers()
    figures: Flag = fields.figures()

    @property
    def flights(self) -> fields.FlightSources:
        """Return the flight as commands of several flights name it."""
        return self.flight


class ValidateBoundsRequest(Request):
    """Measure how many residuals of a flight lie within bounds made from other flights, with the
    sensor noise added to the bounds.
    """

    command: ClassVar[str] = "validate-bounds"
    done: ClassVar[str] = "the bounds hold"
    no: ClassVar[str] = "some coefficient's 95 % bounds do not hold, or the flight is too short"
    examples: ClassVar[str] = """
  uqharness validate-bounds espaaro bounds/model-form.json --flight flight3.parquet
  uqharness validate-bounds espaaro bounds/model-form.json --flight flight3.bin --out check"""

    aircraft: fields.AircraftSource = fields.aircraft()
    form: fields.FileOrObject = option(
        ...,
        "model-form.json of `uqharness bounds`",
        flag="",
        metavar="MODEL-FORM.json",
        kind="str, Path, ModelForm or MadeBounds",
        positional=True,
        toml=False,
    )
    flights: fields.FlightSources = fields.flights()
    out: fields.OptionalPath = fields.out(required=False)
    signal_map: fields.OptionalPath = fields.signal_map()
    flight_number: fields.FlightNumbers = fields.flight_number()
    manoeuvres: fields.OptionalPath = fields.manoeuvres()
    servos: fields.Servos = fields.servos()


class BoundsRequest(Request):
    """Bound the model-form error as a function of the flight state, separated from sensor noise
    (see docs/model-form.md).
    """

    command: ClassVar[str] = "bounds"
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
    split: fields.Split = fields.split()
    confidence: Number = option(
        0.95, "confidence of the intervals, a probability", gt=0, lt=1, metavar="P"
    )
    states: NamesByCoefficient = option(
        {},
        "states of a coefficient's polynomial",
        metavar="C=S,S",
        repeat=True,
        needed='states by coefficient, such as {"CX": ["V", "alpha"]}',
    )
    terms: NamesByCoefficient = option(
        {},
        "terms of a coefficient, 1,V,alpha^2,alpha*q",
        metavar="C=T,T",
        repeat=True,
        needed='terms by coefficient, such as {"Cm": ["1", "alpha", "p^2"]}',
    )
    order: Literal[0, 1, 2, 3] = option(2, "order of the full polynomials")
    roll_terms: Flag = option(False, "roll rate among the states of Cm (dissertation, Fig 2.10)")
    select: Literal["full", "stepwise"] = option(
        "full", "all terms, or those that pass a partial F test"
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
    cutoff_hz: Number = option(6.0, "cut-off of differentiator and smoother, Hz", gt=0, metavar="F")
    airspeed_cutoff_hz: Number = option(
        2.0, "cut-off of the airspeed's low-pass, Hz; 0: none", ge=0, metavar="F"
    )
    walk_cutoff_hz: Number = option(0.5, "cut-off for the rate of variation, Hz", gt=0, metavar="F")
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
