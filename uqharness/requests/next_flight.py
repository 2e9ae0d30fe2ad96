"""Request of next-flight."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator, Field

from uqharness.requests import fields
from uqharness.requests.base import (
    FilePath,
    Flag,
    Number,
    Request,
    WholeNumber,
    one_or_several,
    option,
)


def _speeds(value: Any) -> Any:
    """Return speeds as a tuple; a text is split at its commas."""
    if not isinstance(value, str):
        return one_or_several(value)
    try:
        return tuple(float(part) for part in value.split(","))
    except ValueError:
        return value


Speeds = Annotated[tuple[Annotated[Number, Field(gt=0)], ...], BeforeValidator(_speeds)]
Recordings = Annotated[tuple[FilePath, ...], BeforeValidator(one_or_several)]


def _form(text: str) -> Any:
    """Return the field of a file of bounds."""
    return option(None, text, metavar="MODEL-FORM.json", toml=False)


def _recordings(text: str, flag: str | None = None) -> Any:
    """Return the field of files of flights."""
    return option((), text, flag=flag, metavar="FILE", many=True, toml=False)


class NextFlightRequest(Request):
    """Plan the test flight that most narrows the interval of the coefficient to which the mission
    is most sensitive, in the flight states of the mission (see docs/next-flight.md).
    """

    command: ClassVar[str] = "next-flight"
    no: ClassVar[str] = (
        "no flight of that length narrows the interval by 5 % in the mission's flight states; the"
        " text names alternatives"
    )
    examples: ClassVar[str] = """
  uqharness next-flight results --bounds bounds/model-form.json --out next
  uqharness next-flight results --metric altitude_median_m --minutes 3 --out next
  uqharness fly espaaro --script next/next-flight.xml --noise --seed 1 --out rehearsal.parquet
  uqharness next-flight results --redone both/model-form.json --out next

Writes DIR/next-flight.json, DIR/next-flight.xml (a run script), DIR/test-points.csv,
DIR/report.html and DIR/figures/next-flight.svg. With --redone nothing is planned: the bounds before
and after a flight are compared."""

    folder: FilePath = option(
        ...,
        "folder of a finished corner campaign",
        flag="",
        metavar="CAMPAIGN",
        positional=True,
        toml=False,
    )
    out: FilePath = fields.out(positional=True)
    bounds: fields.OptionalPath = _form(
        "model-form.json of `uqharness bounds` (default: the bounds that the campaign flew)"
    )
    metric: str | None = option(
        None,
        "metric, a column of the campaign's table (default cross_track_median_m)",
        metavar="NAME",
        toml=False,
    )
    coefficient: fields.Coefficient | None = option(
        None,
        "coefficient (default: the one to which the metric is most sensitive)",
        toml=False,
    )
    minutes: Number = option(
        5.0, "length of the flight at most, min", gt=0, le=120, metavar="N", toml=False
    )
    speeds: Speeds = option(
        (),
        "true airspeeds of the test points, m/s (default: those of the mission)",
        metavar="V,V",
        kind="float or sequence of float",
        needed="true airspeeds in m/s, such as 19,22,25,",
        toml=False,
    )
    turbulence: fields.Turbulence = option(
        "none", "turbulence of the simulated test flight", toml=False
    )
    cases: WholeNumber = option(
        6,
        "campaign flights that are repeated to record the mission's flight states",
        ge=1,
        metavar="N",
        toml=False,
    )
    occupancy: Recordings = _recordings(
        "flight records or logs of the mission, in place of campaign flights"
    )
    flights: Recordings = _recordings(
        "flights from which the bounds were made; searched for terms that the polynomial lacks",
        "--flight",
    )
    redone: fields.OptionalPath = _form(
        "bounds that include the new flight: compares them with the old ones and plans nothing"
    )
    seed: WholeNumber = fields.seed("the simulated flights", 1)
    figures: Flag = fields.figures()
