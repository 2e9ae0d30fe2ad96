"""Request of refine."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from pydantic import model_validator

from uqharness.parallel import process_count
from uqharness.requests import fields
from uqharness.requests.base import FilePath, Flag, Request, option

STAGES = {
    "reading the flights": 0.004,
    "servos": 0.006,
    "re-identifying": 0.03,
    "turbulent air": 0.06,
    "scoring": 0.004,
    "round": 0.03,
    "estimating all parameters": 0.012,
    "simulating the hold-out flights": 0.012,
    "writing the aircraft": 0.0,
    "intervals": 0.012,
    "searching the residuals for a smooth term": 0.02,
    "simulating the mission": 0.0,
    "report": 0.003,
}
"""Beginning of a stage's text -> expected duration [s per s of flight]."""
_ASSUMED_FLIGHT_S, _MISSION_S = 90.0, 60.0
"""Duration of a flight before it is read; processor time of a mission with both models."""


class RefineRequest(Request):
    """Find and name the effects that a model lacks, write them into a copy of its XML, and test the
    result on hold-out flights (see docs/refine.md).
    """

    command: ClassVar[str] = "refine"
    examples: ClassVar[str] = """
  uqharness refine espaaro --train flight1.parquet --test flight2.parquet --out refined
  uqharness refine espaaro --train a.bin b.bin --test c.bin --servos ideal --out refined
  uqharness refine espaaro --train a.csv --test b.csv --effects own.toml --out refined
  uqharness refine my-c172 --train a.csv --test b.csv --campaign campaign.toml --out refined

Writes DIR/refinement.json, DIR/report.html, DIR/aircraft/<name> (an AIRCRAFT for every command),
DIR/model.diff, DIR/figures/*.svg, DIR/histories.parquet, DIR/before/aircraft/<name> (re-identified
without effects), DIR/intervals/*.json (model forms) and DIR/pbox/* (campaign folders). Setting an
effect's property to 0 restores the model without it, bit for bit."""
    done: ClassVar[str] = "effects explain the residuals, or no effect is missing"
    no: ClassVar[str] = "a residual remains that no effect of the catalogue explains"
    keeps_stages: ClassVar[bool] = True

    aircraft: fields.AircraftSource = fields.aircraft()
    train: fields.FlightSources = fields.flights(
        "--train", "flights from which effects are chosen and estimated", positional=False
    )
    test: fields.FlightSources = fields.flights(
        "--test", "hold-out flights, used for testing only", positional=False
    )
    out: FilePath = fields.out()
    signal_map: fields.OptionalPath = fields.signal_map()
    flight_number: fields.FlightNumbers = fields.flight_number()
    manoeuvres: fields.OptionalPath = fields.manoeuvres()
    servos: fields.Servos = fields.servos()
    effects: fields.OptionalPath = option(
        None, "user effects in addition to the catalogue (docs/extend.md)", metavar="FILE.toml"
    )
    campaign: fields.OptionalPath = option(
        None,
        "mission for both models (default: the aircraft's loiter, if it has one)",
        metavar="FILE.toml",
        toml=False,
    )
    pbox: Flag = option(
        True,
        "whether the mission is simulated with both models, for p-boxes",
        flag="--no-pbox",
        off=True,
        help="no p-boxes: do not simulate the mission",
        toml=False,
    )
    bake: Flag = option(
        False,
        "write estimated scales into the numbers of the author's functions (-9.0 becomes -12.6)",
    )
    workers: fields.Workers = fields.workers()
    figures: Flag = fields.figures()
    on_stage: Callable[[str], object] | None = option(
        None,
        "called with a sentence at each stage",
        kind="callable, optional",
        needed="a function of a text",
        cli=False,
        toml=False,
    )

    @model_validator(mode="after")
    def _check_campaign(self) -> RefineRequest:
        """Refuse a campaign that would not be used."""
        if self.campaign is not None and not self.pbox:
            raise ValueError(
                "{campaign} and {pbox}: the campaign is only for the p-boxes; omit one of them"
            )
        return self

    def expected_s(self, flight_s: float | None = None) -> dict[str, float]:
        """Return the expected duration [s] of each stage for so many seconds of flight, by default
        those of usual flights.
        """
        if flight_s is None:
            flight_s = _ASSUMED_FLIGHT_S * (len(self.train) + len(self.test))
        durations = {stage: share * flight_s for stage, share in STAGES.items()}
        if self.pbox:
            durations["simulating the mission"] = _MISSION_S / process_count(self.workers)
        return durations
