"""Requests of author, performance and export: models from and for other programs."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field

from uqharness.requests import fields
from uqharness.requests.base import (
    FilePath,
    Flag,
    Names,
    Number,
    Request,
    WholeNumber,
    one_or_several,
    option,
)
from uqharness.requests.simulation import Properties

SourceFiles = Annotated[tuple[FilePath, ...], BeforeValidator(one_or_several), Field(min_length=1)]


def _inertia(about: str) -> Any:
    """Return the field of a moment or product of inertia."""
    return option(
        None,
        f"{about}, kg m2 (default: of the .mass, else assumed)",
        ge=-1e7,
        le=1e7,
        metavar="KGM2",
    )


class AuthorRequest(Request):
    """Write a JSBSim aircraft from derivatives of AVL, VSPAERO, XFLR5 or a table, with a prior of
    their errors as its model-form bounds (see docs/authoring.md).
    """

    command: ClassVar[str] = "author"
    examples: ClassVar[str] = """
  uqharness author plane.st plane.mass --out aircraft/plane
  uqharness author plane.st --mass-kg 2.1 --cg-x-m 0.31 --out aircraft/plane
  uqharness author plane.stab plane.polar --mass-kg 8 --thrust-n 40 --out aircraft/plane
  uqharness author plane.avl plane.mass --out aircraft/plane
  uqharness author plane.csv --mass-kg 900 --cd0 0.028 --out aircraft/plane

Reads AVL's ST and SB output (several alphas: several files), VSPAERO's .stab, XFLR5's stability
log, tables (.csv, .toml), and geometries of AVL (.avl, needs optvl). Writes DIR/NAME.xml,
DIR/airframe.toml, DIR/Systems and DIR/model-form.json of kind prior."""
    no: ClassVar[str] = (
        "the files hold a usual slip, named with its line; nothing is written without"
        " --accept-slips"
    )

    sources: SourceFiles = option(
        ...,
        "files of derivatives, geometry and masses of one aircraft",
        flag="",
        metavar="FILE",
        many=True,
        positional=True,
        kind="str, Path or sequence of them",
        needed="at least one file",
        toml=False,
    )
    out: FilePath = fields.out()
    name: str | None = option(None, "name of the aircraft (default: the file's)", metavar="NAME")
    mass_kg: Number | None = option(
        None, "mass, kg (default: of the .mass)", gt=0, le=1e6, metavar="KG"
    )
    ixx_kgm2: Number | None = _inertia("moment of inertia about x, body axes at the CG")
    iyy_kgm2: Number | None = _inertia("about y")
    izz_kgm2: Number | None = _inertia("about z")
    ixz_kgm2: Number | None = _inertia("product of inertia, the integral of x z over the mass")
    cg_x_m: Number | None = option(
        None,
        "centre of gravity in the source's frame, aft, m (default: of the .mass, else the moment"
        " centre)",
        metavar="M",
    )
    cg_y_m: Number | None = option(None, "to the right", metavar="M")
    cg_z_m: Number | None = option(None, "up", metavar="M")
    area_m2: Number | None = option(
        None, "reference area in place of the files', m2", gt=0, le=1e5, metavar="M2"
    )
    span_m: Number | None = option(
        None, "reference span in place of the files', m", gt=0, le=1e3, metavar="M"
    )
    chord_m: Number | None = option(
        None, "reference chord in place of the files', m", gt=0, le=1e3, metavar="M"
    )
    length_unit_m: Number | None = option(
        None,
        "length of the files' unit, m, such as 0.001 (default: Lunit of the .mass, else 1)",
        gt=0,
        le=1e3,
        metavar="M",
    )
    cd0: Number | None = option(
        None,
        "drag coefficient to add for skin friction and fuselage (default: 0.03 where the source"
        " has induced drag alone)",
        ge=0,
        le=1,
        metavar="CD",
    )
    throw_deg: Number = option(
        25.0, "deflection of each surface at full command, deg", gt=0, le=90, metavar="DEG"
    )
    thrust_n: Number | None = option(
        None,
        "static thrust at full throttle, N; 0 for a glider (default: half the weight)",
        ge=0,
        le=1e7,
        metavar="N",
    )
    pitch_speed_mps: Number | None = option(
        None,
        "airspeed at which thrust falls to zero, m/s (default: 2.5 times the source's)",
        gt=0,
        le=1e3,
        metavar="V",
    )
    controls: Names = option(
        (),
        "surfaces of a control, with sign: elevator=LEFT+RIGHT (default: by their names)",
        flag="--control",
        metavar="C=SURFACES",
        repeat=True,
    )
    contacts: Names = option(
        (),
        "ground contact NAME=X:Y:Z in the source's frame, m",
        flag="--contact",
        metavar="NAME=X:Y:Z",
        repeat=True,
    )
    accept_slips: Flag = option(False, "write the aircraft although a slip was found")


class PerformanceRequest(Request):
    """Compute an aircraft's performance from its coefficients: stall, glide, climb, ceiling and
    turn, against speed, with intervals from its model-form bounds.
    """

    command: ClassVar[str] = "performance"
    examples: ClassVar[str] = """
  uqharness performance espaaro
  uqharness performance aircraft/plane --altitude-m 1000 --json"""
    no: ClassVar[str] = "no speed of the sheet trims"

    aircraft: fields.AircraftSource = fields.aircraft()
    altitude_m: Number = option(
        0.0, "altitude above sea level of the sheet, m", ge=0, le=20_000, metavar="H"
    )
    stall_alpha_deg: Number = option(
        14.0,
        "angle of attack at which the wing stalls, where lift has no maximum before, deg",
        gt=3,
        le=45,
        metavar="DEG",
    )
    bounds: Flag = option(
        True, "whether intervals are computed", flag="--no-bounds", off=True, help="no intervals"
    )


# Requests of export: models for other simulators.

Format = Literal["ardupilot-jsbsim", "ardupilot-json", "gazebo", "px4-sih", "fmu", "csv"]


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
DIR/NAME.json, DIR/model.sdf with DIR/model-classic.sdf, DIR/NAME.params, DIR/NAME.fmu, or
DIR/coefficients.csv. The loss is the difference between the model as the other program computes it
and the source, over random states around steady flight."""
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
