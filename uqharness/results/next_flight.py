"""Results of next-flight: next-flight.json, and the comparison after the flight."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from uqharness.results.base import Ends, Number, Part, Texts

Quartiles = Annotated[list[Number], Field(min_length=3, max_length=3)]
"""25, 50 and 75 %, in the state's SI unit."""


class PlannedAircraft(Part):
    """The aircraft of a plan."""

    name: str = Field(description="name")
    sha256: str = Field(description="digest of the files that the bounds were made for")


class SimulatedFlight(Part):
    """How the test flight was simulated."""

    turbulence: str = Field(description="intensity")
    sensor_noise: bool = Field(description="with sensor noise")
    autopilot: bool = Field(description="with the autopilot")


class MissionStates(Part):
    """Where the flight states of the mission come from."""

    source: str = Field(description="campaign or files")
    flights: int = Field(description="number of flights")
    failed: int = Field(description="flights that failed and were left out")
    seconds: float = Field(description="length of all, s")
    outside_data: Number = Field(description="share of the mission outside the bounds' data")


class StateQuartiles(Part):
    """Quartiles of one state."""

    data: Quartiles = Field(description="of the data behind the bounds")
    mission: Quartiles = Field(description="of the mission")
    variance: Quartiles = Field(description="of the mission, weighted by the prediction variance")


class Prediction(Part):
    """What bounds that include the flight are compared with."""

    narrowing_redone: Number = Field(
        default=None, description="narrowing of bounds that are made again, share"
    )
    parameter_narrowing: Number = Field(
        default=None, description="narrowing of the parameters' part, share"
    )


class Predictions(Part):
    """The part of next-flight.json that is read again."""

    prospects: dict[str, Prediction] = Field(description="by coefficient")


class ProspectRow(Part):
    """Mean widths of one coefficient's interval over the mission, and their narrowing."""

    width: Number = Field(description="mean width now [-]")
    width_after: Number = Field(description="with the flight, at today's scatter [-]")
    narrowing: Number = Field(description="share by which it shrinks")
    narrowing_at_most: Number = Field(description="with unlimited data of the same kind, share")
    narrowing_same_manoeuvres: Number = Field(
        description="with as long a repetition of what was flown before, share"
    )
    width_redone: Number = Field(description="expected width of bounds that are made again [-]")
    narrowing_redone: Number = Field(description="narrowing of bounds that are made again, share")
    parameter_width: Number = Field(description="part of the width from the parameters [-]")
    parameter_width_after: Number = Field(description="the same with the flight [-]")
    parameter_narrowing: Number = Field(description="share by which that part shrinks")
    parameter_narrowing_same_manoeuvres: Number = Field(
        description="the same with a repetition of what was flown before, share"
    )


class Scatter(Part):
    """Standard deviation of the residuals about the polynomial."""

    bounds: Number = Field(description="behind the bounds [-]")
    simulated: Number = Field(description="from the model's own sensors and air [-]")


class MissingTerm(Part):
    """A term that the polynomial lacks."""

    term: str = Field(description="the term")
    share: Number = Field(description="share of the scatter that it explains")


class ControlStep(Part):
    """A movement of one control."""

    control: str = Field(description="control")
    size: float = Field(description="amplitude, in unit")
    unit: str = Field(description="unit of the control")
    unit_s: float = Field(description="length of a step, s")
    pattern: list[list[float | int]] = Field(description="number of steps and sign, one pair each")
    begins_s: float = Field(description="start within the point, s")


class PlannedPoint(Part):
    """A test point."""

    number: int = Field(description="from 1, in the order of the flight")
    name: str = Field(description="name")
    start_s: float = Field(description="start, s")
    end_s: float = Field(description="end, s")
    speed_mps: Number = Field(description="true airspeed, m/s; null: the mission's")
    bank_deg: float = Field(description="bank angle, deg")
    steps: list[ControlStep] = Field(description="movements of controls; none: steady flight")
    gain: Number = Field(description="share of the mean width that it takes, given those before")


class RefusedTestPoint(Part):
    """A test point that the model could not fly."""

    point: str = Field(description="name")
    reason: str = Field(description="reason")


class NextFlightPlan(Part):
    """next-flight.json of `uqharness next-flight`."""

    format: str = Field(description="next-flight 1")
    aircraft: PlannedAircraft = Field(description="aircraft")
    campaign: str = Field(description="folder of the campaign")
    bounds: str = Field(description="model-form.json")
    simulated: SimulatedFlight = Field(description="how the flight was simulated")
    metric: str = Field(description="column of cases.parquet that the flight serves")
    coefficient: str = Field(description="coefficient whose interval is narrowed")
    share: Ends = Field(description="its smallest and largest share of the metric's p-box")
    certain: bool = Field(description="whether it is first beyond sampling error everywhere")
    verdict: Literal["fly", "no"] = Field(description="whether the flight is worth flying")
    words: Texts = Field(description="the answer in sentences")
    mission: MissionStates = Field(description="flight states of the mission")
    where: dict[str, StateQuartiles] = Field(description="quartiles by state")
    prospects: dict[str, ProspectRow] = Field(description="widths by coefficient")
    scatter: Scatter = Field(description="residual scatter")
    missing: list[MissingTerm] | None = Field(
        description="terms that the polynomial lacks; null: no flights were given"
    )
    flight_s: float = Field(description="length of the flight, s")
    points: list[PlannedPoint] = Field(description="test points in the order of the flight")
    tried: int = Field(description="test points that were tried")
    refused: list[RefusedTestPoint] = Field(description="those that the model could not fly")
    warnings: Texts = Field(description="sentences for the user")


class AchievedRow(Part):
    """Widths before and after the flight, and what was predicted."""

    width: Number = Field(description="mean width without the flight [-]")
    width_after: Number = Field(description="with it [-]")
    narrowing: Number = Field(description="share by which it shrank")
    predicted: Number = Field(description="the same as predicted; null: no plan in the folder")
    parameter_narrowing: Number = Field(description="narrowing of the parameters' part, share")
    predicted_parameter: Number = Field(description="the same as predicted")


class AchievedNarrowing(Part):
    """Document of `uqharness next-flight --redone`."""

    coefficient: str = Field(description="coefficient that the flight served")
    achieved: dict[str, AchievedRow] = Field(description="by coefficient")
