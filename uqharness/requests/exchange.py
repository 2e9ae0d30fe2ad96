"""Requests of export: models for other simulators."""

from __future__ import annotations

from typing import ClassVar, Literal

from uqharness.requests import fields
from uqharness.requests.base import Flag, Number, Request, WholeNumber, option
from uqharness.requests.simulation import Properties

Format = Literal["ardupilot-jsbsim", "ardupilot-json", "gazebo", "fmu", "csv"]


class ExportRequest(Request):
    """Write an aircraft's aerodynamics in another simulator's format, and measure what the format
    loses (see docs/export.md).
    """

    command: ClassVar[str] = "export"
    examples: ClassVar[str] = """
  uqharness export espaaro --to gazebo --out espaaro-gazebo
  uqharness export espaaro --to ardupilot-json --bounds bounds/model-form.json --out espaaro-ap
  uqharness export espaaro --to csv --set uq/active=1 --set uq/CX/level=1 --out espaaro-table
  uqharness export espaaro --to ardupilot-jsbsim --member 010011 --out sitl

Writes DIR/loss.json and DIR/loss.csv, and the model: DIR/aircraft/NAME with DIR/NAME.parm,
DIR/NAME.json, DIR/model.sdf with DIR/model-classic.sdf, DIR/NAME.fmu, or DIR/coefficients.csv. The
loss is the difference between the model as the other program computes it and the source, over
random states around steady flight."""
    no: ClassVar[str] = (
        "the format loses more than the bounds of --bounds allow; without --accept-loss the model"
        " is not written"
    )

    aircraft: fields.AircraftSource = fields.aircraft()
    to: Format = option(..., "format of the model", positional=True)
    out: fields.OptionalPath = fields.out()
    bounds: fields.OptionalPath = option(
        None,
        "model form whose half-widths limit the loss (default: the loss is reported alone)",
        metavar="MODEL-FORM.json",
    )
    speed_mps: Number | None = option(
        None,
        "true airspeed of the trim, m/s (default: the middle of the speeds that trim)",
        gt=0,
        le=1000,
        metavar="V",
    )
    properties: Properties = option(
        {},
        "set a property of the source, such as a level of the model form",
        flag="--set",
        key="set",
        metavar="PROP=VALUE",
        repeat=True,
        needed='PROP=VALUE with a finite number, such as uq/active=1 ({"uq/active": 1.0}),',
    )
    member: str | None = option(
        None,
        "epistemic member to freeze: a corner's digits in the order CX CY CZ Cl Cm Cn (0 lower, 1"
        " upper end, - nominal, such as 01-011), an id of --campaign, or all of them; each is"
        " NAME_MEMBER",
        metavar="ID",
    )
    campaign: fields.OptionalPath = option(
        None, "campaign file or folder that defines the members", metavar="CAMPAIGN"
    )
    states: WholeNumber = option(2000, "random states that are compared", ge=10, le=100_000)
    seed: WholeNumber = fields.seed("the states")
    accept_loss: Flag = option(False, "write the model although its loss exceeds the bounds")
