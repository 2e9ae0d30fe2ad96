"""Requests about simulated models: flights, trim and modes, margins, differences, the plugin."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, model_validator

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

MISSION_SUFFIXES = (".plan", ".waypoints", ".mission", ".txt")
"""Endings of missions of ground stations."""
MISSIONS = ("steady", "doublets", "3-2-1-1")
"""Manoeuvres that are generated from a trim of any aircraft."""
Category = Literal["A", "B", "C"]
"""Flight-phase categories of MIL-F-8785C."""
AircraftClass = Literal["I", "II-L", "II-C", "III", "IV"]
"""Classes of aircraft of MIL-F-8785C."""
Loop = Literal["elevator", "aileron", "rudder", "throttle"]


def _mapping(value: Any) -> Any:
    """Return a mapping as a dictionary, None as an empty one."""
    return {} if value is None else dict(value) if isinstance(value, Mapping) else value


Properties = Annotated[dict[str, Number], BeforeValidator(_mapping)]
Loops = Annotated[tuple[Loop, ...], BeforeValidator(one_or_several)]
Scripts = Annotated[tuple[FilePath, ...], BeforeValidator(one_or_several)]
Speed = Annotated[Number, Field(gt=0, le=1000)]
Speeds = Annotated[tuple[Speed, ...], BeforeValidator(one_or_several)]


def _properties() -> Any:
    """Return the field of JSBSim properties."""
    return option(
        {},
        "JSBSim property set before the flight",
        flag="--set",
        key="set",
        metavar="PROP=VALUE",
        repeat=True,
        kind="Mapping, optional",
        needed='PROP=VALUE with a finite number, such as aero/Cm_q=-10 ({"aero/Cm_q": -10.0}),',
    )


class FlyRequest(Request):
    """Simulate a flight and write its record (SI, body axes; see docs/commands.md)."""

    command: ClassVar[str] = "fly"
    examples: ClassVar[str] = """
  uqharness fly espaaro --script scripts/doublet-elevator.xml --out doublet.csv
  uqharness fly espaaro --duration-s 600 --wind-mps 3 --turbulence moderate --noise --out x.parquet
  uqharness fly c172p --mission doublets --speed-mps 50 --noise --seed 1 --out doublets.parquet
  uqharness fly espaaro --autopilot my-plane.param --duration-s 300 --wind-mps 3 --out mine.csv
  uqharness fly espaaro --set aero/Cm_q=-10 --set uq/active=1 --set uq/CX/level=1 --out new.csv"""
    no: ClassVar[str] = "the flight ended early; the record ends there"

    aircraft: fields.AircraftSource = fields.aircraft()
    script: FilePath = fields.script()
    mission: fields.OptionalPath = option(
        None,
        "steady, doublets or 3-2-1-1: manoeuvres from trim, for any aircraft, instead of a script;"
        " or a mission of QGroundControl (.plan) or ArduPilot (.waypoints) for the built-in"
        " autopilot; or a run script",
        metavar="M",
        kind="str or Path, optional",
    )
    speed_mps: Number | None = option(
        None, "true airspeed of the generated manoeuvres, m/s", gt=0, le=1000, metavar="V"
    )
    altitude_m: Number = fields.altitude("the generated manoeuvres above flat ground at sea level")
    duration_s: Number | None = option(
        None, "length of the flight, s (default: the script's end)", gt=0, le=1e6, metavar="T"
    )
    wind_mps: Number = option(0.0, "steady wind, m/s", ge=0, le=100, metavar="W")
    wind_from_deg: Number = option(270.0, "true direction the wind blows from, deg", metavar="D")
    turbulence: fields.Turbulence = fields.turbulence("")
    turbulence_source: Literal["jsbsim", "spec"] = option(
        "spec", "Dryden model: after the specification, or JSBSim's"
    )
    seed: WholeNumber = fields.seed("turbulence and noise")
    noise: Flag = option(False, "add sensor noise to the autopilot's inputs and to the record")
    properties: Properties = _properties()
    autopilot: fields.OptionalPath = fields.autopilot()
    autopilot_process: str | None = option(
        None,
        "command that starts a real autopilot, such as 'arduplane --model JSON:127.0.0.1', which"
        " controls the aircraft in lock step (docs/autopilot.md)",
        metavar="COMMAND",
    )
    autopilot_protocol: Literal["ardupilot-json", "px4-hil"] = option(
        "ardupilot-json",
        "connection of the real autopilot: ArduPilot's JSON back-end (UDP port 9002), or PX4's"
        " simulation link (MAVLink, TCP port 4560)",
    )
    autopilot_warmup_s: Number = option(
        0.0,
        "time before the real autopilot takes over from the run script, s",
        ge=0,
        le=1e5,
        metavar="T",
    )
    rate_hz: Number = option(50.0, "rows per second", gt=0, le=1e5, metavar="R")
    out: fields.RecordFile | None = option(
        None,
        "flight record: .csv, .parquet or .bin (ArduPilot DataFlash) (default: nothing is written)",
        metavar="FILE",
        provenance=False,
        toml=False,
    )
    page: fields.Page = fields.page("the ground track and every channel over time", "--page")

    @property
    def generated(self) -> bool:
        """Return whether the manoeuvres are generated from a trim."""
        return str(self.mission) in MISSIONS

    @property
    def waypoints(self) -> Path | None:
        """Return the mission if it is a file of waypoints."""
        is_file = self.mission is not None and self.mission.suffix.lower() in MISSION_SUFFIXES
        return self.mission if is_file else None

    @model_validator(mode="after")
    def _check_speed(self) -> FlyRequest:
        """Require the airspeed of generated manoeuvres, and refuse it otherwise."""
        if self.waypoints is not None and self.autopilot_process is not None:
            raise ValueError(
                f"{{mission}} {self.mission}: only the built-in autopilot takes it; load the"
                " mission into the real autopilot, or omit {autopilot_process}"
            )
        if self.autopilot_process is None and self.autopilot_protocol != "ardupilot-json":
            raise ValueError(
                "{autopilot_protocol}: add {autopilot_process}, the command that starts the"
                " autopilot"
            )
        if self.generated and self.speed_mps is None:
            raise ValueError(
                f"{{mission}} {self.mission}: add {{speed_mps}}, at which the aircraft trims"
                " (uqharness modes)"
            )
        if self.speed_mps is not None and not self.generated:
            raise ValueError(f"{{speed_mps}}: belongs to {{mission}}, one of {', '.join(MISSIONS)}")
        return self


class TrimRequest(Request):
    """Trim an aircraft in steady flight in still air."""

    aircraft: fields.AircraftSource = fields.aircraft()
    V_mps: Number = option(..., "true airspeed [m/s]", gt=0, positional=True)
    altitude_m: Number = option(0.0, "altitude above sea level [m]")
    # The limits of `modes`, 60 and 85 degrees.
    climb_rad: Number = option(0.0, "flight-path angle [rad]", gt=-1.0472, lt=1.0472)
    bank_rad: Number = option(0.0, "bank of a coordinated turn [rad]", gt=-1.4836, lt=1.4836)
    heading_rad: Number = option(0.0, "true heading [rad]")
    properties: Properties = _properties()


def _speed_range(value: Any) -> Any:
    """Return ``LO:HI`` as two numbers; anything else unchanged, which is refused."""
    try:
        low, high = value.split(":") if isinstance(value, str) else value
        ends = float(low), float(high)
    except (TypeError, ValueError):
        ends = (0.0, 0.0)
    if not 0.0 < ends[0] < ends[1] < float("inf"):
        raise ValueError(
            "LO:HI, two true airspeeds in m/s above 0, LO below HI, is needed, such as 16:30"
        )
    return ends


class ModesRequest(Request):
    """Trim the aircraft in steady flight, linearise the JSBSim model about it, and name its
    modes.
    """

    command: ClassVar[str] = "modes"
    examples: ClassVar[str] = """
  uqharness modes espaaro --speed-mps 22.2
  uqharness modes espaaro --speed-mps 22.2 --bank-deg 25 --altitude-m 100 --json
  uqharness modes espaaro --speed-mps 22.2 --out modes.html --speeds 16:30"""
    no: ClassVar[str] = "no trim was found"

    aircraft: fields.AircraftSource = fields.aircraft()
    speed_mps: Number = option(..., "true airspeed, m/s", gt=0, metavar="V")
    altitude_m: Number = option(0.0, "altitude above sea level, m", metavar="H")
    climb_deg: Number = option(
        0.0,
        "flight-path angle, deg; solved for where the throttle gives no thrust",
        gt=-60,
        lt=60,
        metavar="G",
    )
    bank_deg: Number = option(0.0, "bank of a coordinated turn, deg", gt=-85, lt=85, metavar="B")
    wind_mps: Number = option(0.0, "steady wind, m/s; moves the path only", ge=0, metavar="W")
    wind_from_deg: Number = option(270.0, "true direction the wind blows from, deg", metavar="D")
    heading_deg: Number = option(0.0, "true heading, deg", metavar="P")
    category: Category = option("B", "flight-phase category; B: cruise, loiter")
    aircraft_class: AircraftClass = option("I", "aircraft class; I: light", flag="--class")
    out: fields.Page = fields.page("the root locus over airspeed and the Levels")
    speeds: Annotated[tuple[float, float], BeforeValidator(_speed_range)] | None = option(
        None,
        "speeds of the page's root locus, m/s (default 0.7 to 1.6 times V)",
        metavar="LO:HI",
        write=lambda ends: f"{ends[0]:g}:{ends[1]:g}",
    )
    model_form: fields.OptionalPath = option(
        None,
        "model form of the intervals (default: model-form.json of the aircraft's folder, if any)",
        flag="--bounds",
        metavar="MODEL-FORM.json",
    )
    bounds: Flag = option(
        True, "whether intervals are computed", flag="--no-bounds", off=True, help="no intervals"
    )

    @model_validator(mode="after")
    def _check_page(self) -> ModesRequest:
        """Refuse speeds without the page that shows them."""
        if self.speeds is not None and self.out is None:
            raise ValueError("{speeds}: belongs to the page; add {out} FILE.html")
        return self


class MarginsRequest(Request):
    """Measure the autopilot's stability margins in flight, loop by loop, by injecting a multisine
    at each controller's output.
    """

    command: ClassVar[str] = "margins"
    examples: ClassVar[str] = """
  uqharness margins espaaro
  uqharness margins espaaro --loop elevator --flight straight --json
  uqharness margins espaaro --autopilot my-plane.param --loop aileron
  uqharness margins espaaro --out margins.html"""

    aircraft: fields.AircraftSource = fields.aircraft()
    script: FilePath = fields.script("run script that engages the autopilot", positional=False)
    loop: Loops = option((), "only this actuator (default: all)", repeat=True)
    flight: Literal["loiter", "straight"] = option("loiter", "on the circle or straight")
    autopilot: fields.OptionalPath = fields.autopilot()
    out: fields.Page = fields.page("Bode and Nichols charts of every loop, margins marked")


def _model(name: str) -> Any:
    """Return the field of one of two models."""
    return option(
        ...,
        "aircraft: name, folder, or REVISION:FOLDER of a git repository",
        flag="",
        metavar=name,
        kind="str, Path or Aircraft",
        positional=True,
    )


MODEL_FILES = (".json", ".sdf")
"""Endings of models of other programs: ArduPilot's JSON, Gazebo's AdvancedLiftDrag."""


class DiffRequest(Request):
    """Simulate the same manoeuvres with two models (same start, controls and air) and list the
    outputs that differ by more than rounding, the likeliest cause first, with the XML that differs.
    Model files of ArduPilot and Gazebo are compared by coefficients, and usual slips are named.
    """

    command: ClassVar[str] = "diff"
    examples: ClassVar[str] = """
  uqharness diff espaaro espaaro_truth --speed-mps 22
  uqharness diff HEAD~1:aircraft/espaaro aircraft/espaaro --speed-mps 22 --out diff.html
  uqharness diff c172p my/c172p --speed-mps 45 --speed-mps 60 --json
  uqharness diff c172p c172p --speed-mps 50 --python-b other-jsbsim/bin/python
  uqharness diff espaaro espaaro-gazebo/model.sdf"""
    no: ClassVar[str] = "the models differ"

    a: Any = _model("A")
    b: Any = _model("B")
    speed_mps: Speeds = option(
        (),
        "true airspeed of A's trim and manoeuvres, m/s",
        metavar="V",
        repeat=True,
        kind="float or sequence of float",
        needed="a number above 0 and up to 1000",
    )
    altitude_m: Number = fields.altitude("the manoeuvres above sea level")
    script: Scripts = option(
        (),
        "run script for both models, 60 s at most",
        metavar="S",
        repeat=True,
        kind="str, Path or sequence of them",
        needed="a path or a name",
    )
    turbulence: fields.Turbulence = fields.turbulence(", the same for both models")
    seed: WholeNumber = fields.seed("turbulence")
    properties: Names = option(
        (),
        "JSBSim property to compare in addition",
        flag="--property",
        metavar="PROP",
        repeat=True,
    )
    tolerance: Number | None = option(
        None,
        "differences up to this share of a channel's range count as equal (default 1e-09:"
        " rounding)",
        ge=0,
        le=1,
        metavar="R",
    )
    repeats: WholeNumber = option(
        0,
        "repeat A N times in other turbulence; differences of that size count as equal",
        ge=0,
        le=1000,
        metavar="N",
    )
    bounds: Flag = option(False, "differences within A's model-form bounds count as equal")
    python_b: fields.OptionalPath = option(
        None,
        "interpreter for B, of an environment with another JSBSim (default: this one)",
        metavar="PYTHON",
    )
    out: fields.Page = fields.page("the histories that differ")

    @model_validator(mode="after")
    def _check_flights(self) -> DiffRequest:
        """Require manoeuvres; files of other programs have coefficients alone."""
        files = any(str(model).endswith(MODEL_FILES) for model in (self.a, self.b))
        if not (self.speed_mps or self.script or files):
            raise ValueError(
                "no manoeuvre: give {speed_mps}, an airspeed at which A trims (uqharness modes A"
                " --speed-mps V shows the trim), or {script}"
            )
        return self


def _constant_bounds(value: Any) -> Any:
    """Return ``C=B,C=LOWER:UPPER`` or a mapping as lower and upper bounds by coefficient.

    >>> _constant_bounds("CX=0.008,CZ=-0.05:0.08")
    {'CX': (-0.008, 0.008), 'CZ': (-0.05, 0.08)}
    """
    if isinstance(value, str):
        pairs = [part.partition("=")[::2] for part in value.split(",") if value]
        if len({name.strip() for name, _ in pairs}) < len(pairs):
            raise ValueError("a coefficient is given twice")
        value = {name.strip(): tuple(text.split(":")) for name, text in pairs}
    if not isinstance(value, Mapping):
        return value
    bounds = {}
    for name, ends in value.items():
        try:
            values = [float(end) for end in (ends if isinstance(ends, tuple | list) else (ends,))]
            low, high = values if len(values) == 2 else (-values[0], *values)
        except (TypeError, ValueError):
            low = high = float("nan")
        if not -float("inf") < low <= 0.0 <= high < float("inf"):
            raise ValueError(
                f"{name}: a half width B, or a lower bound <= 0 and an upper bound >= 0, is needed,"
                " so that the model lies inside"
            )
        bounds[name] = (low + 0.0, high)
    return bounds


def _write_constant(bounds: Mapping[str, tuple[float, float]]) -> str:
    """Return constant bounds as the command line has them."""
    return ",".join(
        f"{name}={high!r}" if low == -high else f"{name}={low!r}:{high!r}"
        for name, (low, high) in bounds.items()
    )


MASS_PROPERTIES = (
    "mass_kg",
    "ixx_kgm2",
    "iyy_kgm2",
    "izz_kgm2",
    "ixz_kgm2",
    "cg_x_m",
    "cg_y_m",
    "cg_z_m",
)


def _mass(text: str, unit: str, gt: float | None = None) -> Any:
    """Return the field of a mass property that replaces the XML's."""
    return option(None, text, gt=gt, metavar=unit)


class InstrumentRequest(Request):
    """Add bounded delta coefficients (uq/...) to any aircraft; see docs/instrument.md."""

    command: ClassVar[str] = "instrument"
    examples: ClassVar[str] = """
  uqharness instrument c172x --out aircraft/c172x
  uqharness instrument c172x --out aircraft/c172x --constant CX=0.01,CZ=-0.05:0.08,Cm=0.02
  uqharness instrument identified/aircraft --bounds bounds/model-form.json --out bounded
  uqharness instrument c172x --out mine --mass-kg 998 --iyy-kgm2 1700 --cg-x-m 1.03
  uqharness instrument c172x --out aircraft/c172x --undo

DIR becomes a copy of the aircraft's folder with the plugin (DIR may be that folder itself), and a
record that --undo reads."""
    no: ClassVar[str] = (
        "the check failed: with uq/active 0 the copy is not bit-identical to the original in"
        " simulation, or a delta is wrong; or a control could not be measured, and its part of"
        " airframe.toml is assumed"
    )

    aircraft: fields.AircraftSource = fields.aircraft()
    form: Any = option(
        None,
        "model-form.json of `uqharness bounds`",
        flag="--bounds",
        metavar="FILE",
        kind="MadeBounds, ModelForm, str or Path, optional",
        positional=True,
    )
    out: FilePath = fields.out()
    constant: (
        Annotated[dict[fields.Coefficient, tuple[float, float]], BeforeValidator(_constant_bounds)]
        | None
    ) = option(
        None,
        "constant bounds: half width B or LOWER:UPPER per coefficient",
        metavar="C=B,...",
        kind="Mapping, optional",
        needed='C=B with C one of CX, CY, CZ, Cl, Cm, Cn, a mapping such as {"CX": 0.01},',
        write=_write_constant,
    )
    undo: Flag = option(
        False, "remove the plugin; the files are restored byte for byte", python=False
    )
    air: Flag = option(False, "also add this project's wind and turbulence (docs/air.md)")
    mass_kg: Number | None = _mass("mass of the aircraft, fuel and loads included, kg", "KG", 0.0)
    ixx_kgm2: Number | None = _mass(
        "moment of inertia about x, body axes at the centre of gravity, kg m2", "KGM2", 0.0
    )
    iyy_kgm2: Number | None = _mass("about y", "KGM2", 0.0)
    izz_kgm2: Number | None = _mass("about z", "KGM2", 0.0)
    ixz_kgm2: Number | None = _mass(
        "product of inertia, the integral of x z over the mass; JSBSim's inertia/ixz-slugs_ft2 is"
        " minus this",
        "KGM2",
    )
    cg_x_m: Number | None = _mass("centre of gravity in the XML's structural frame, aft, m", "M")
    cg_y_m: Number | None = _mass("to the right", "M")
    cg_z_m: Number | None = _mass("up", "M")
    mass: Properties = option(
        {},
        "the same mass properties by name",
        kind="Mapping, optional",
        needed='a mapping such as {"mass_kg": 900.0}',
        cli=False,
        toml=False,
    )
    dry_run: Flag = option(False, "print the changes, write nothing")
    page: fields.Page = fields.page("the bounds over the envelope", "--page")
    check: Flag = fields.checks("the check flights of the result and the original")

    @model_validator(mode="after")
    def _check_combination(self) -> InstrumentRequest:
        """Refuse options that exclude each other."""
        if unknown := [name for name in self.mass if name not in MASS_PROPERTIES]:
            raise ValueError(
                f"{{mass}}: {unknown[0]!r} is unknown; allowed are {', '.join(MASS_PROPERTIES)}"
            )
        if self.form is not None and self.constant is not None:
            raise ValueError("{form} and {constant} are two sources of bounds; give one of them")
        if not self.undo:
            if self.page is not None and self.dry_run:
                raise ValueError("{page}: {dry_run} writes no bounds to show; omit one of them")
            return self
        excluded = {"form", "constant", "page", "dry_run", "mass", *MASS_PROPERTIES}
        for name in sorted(excluded & self.model_fields_set):
            raise ValueError(f"{{undo}}: removes the complete plugin; omit {{{name}}}")
        return self

    def mass_properties(self) -> dict[str, float]:
        """Return the mass properties that were set, by name."""
        named = {name: getattr(self, name) for name in MASS_PROPERTIES}
        return {**self.mass, **{name: value for name, value in named.items() if value is not None}}
