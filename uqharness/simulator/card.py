"""airframe.toml as the simulator needs it: which JSBSim property is which control, what open loop
means, what is scored.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import tomlkit
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator
from tomlkit.exceptions import TOMLKitError

from sysid.errors import LogError
from sysid.logs import AirframeCard, Reference, Sensors
from sysid.logs import card as airframe_card
from uqharness.errors import BadInputError
from uqharness.toml import dotted

# Sections and keys of inputs that are for reading logs alone, or are passed on as the one reader
# has them.
_LOG_READER_SECTIONS = {"reference", "sensors", "mixing"}
_SERVO_KEYS = {"servo_pwm", "channel"}


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


class InputCard(_Strict):
    """One control: the command property, its unit and its sign. ``servo_pwm`` and ``channel`` are
    for reading logs (docs/logs.md).

    ``selected`` is the command that counts after the aircraft's own selection (autopilot or pilot),
    ``position`` the surface; both are optional and both are only read. ``throw_deg`` turns a
    normalised command into a record's degrees: 1 is that many, with the record's sign."""

    property: str
    selected: str | None = None
    position: str | None = None
    unit: Literal["deg", "rad", "pct", "norm"] = "norm"
    positive: str = ""
    limits: tuple[float, float] = (-1.0, 1.0)
    throw_deg: float | None = None

    @field_validator("throw_deg")
    @classmethod
    def _moves(cls, value: float | None) -> float | None:
        if value == 0.0:
            raise ValueError("a throw of 0 degrees cannot be flown")
        return value


class MetricCard(_Strict):
    """True and noise-laden property of one error signal."""

    true: str
    measured: str | None = None


class ParameterCard(_Strict):
    """An identifiable property: first guess, bounds, unit and source."""

    initial: float | None = None
    bounds: tuple[float, float] | None = None
    unit: str = "1"
    source: str = ""


class AircraftSection(_Strict):
    """Name, file and integration step [s] of the aircraft."""

    name: str
    xml: str
    dt_s: float = Field(default=0.01, gt=0, le=0.1)


class _ReplaySection(_Strict):
    """``without_systems``: systems without effect in open loop and still air; a replay leaves them
    out, which saves a third of its time."""

    without_systems: tuple[str, ...] = ()


class Card(_Strict):
    """airframe.toml, validated."""

    aircraft: AircraftSection
    reference: Reference = Reference()
    inputs: Mapping[str, InputCard] = {}
    modes: Mapping[str, Mapping[str, float]] = {}
    outputs: Mapping[str, str] = {}
    metrics: Mapping[str, MetricCard] = {}
    parameters: Mapping[str, ParameterCard] = {}
    sensors: Sensors = Sensors()
    replay: _ReplaySection = _ReplaySection()


MEMS_NOISE_STD: Mapping[str, float] = MappingProxyType(
    {
        "V_mps": 0.3,
        "alpha_rad": 0.003,
        "beta_rad": 0.003,
        "phi_rad": 0.003,
        "theta_rad": 0.003,
        "psi_rad": 0.01,
        "p_radps": 0.003,
        "q_radps": 0.003,
        "r_radps": 0.003,
        "ax_mps2": 0.05,
        "ay_mps2": 0.05,
        "az_mps2": 0.05,
        "h_m": 0.3,
    }
)
"""Standard deviations taken for sensors of an aircraft whose card names none: an assumption, of the
size of small MEMS units.
"""


# JSBSim's own command properties, for an aircraft that comes without a card.
_STANDARD_INPUTS = {
    "elevator": InputCard(property="fcs/elevator-cmd-norm", positive="nose down"),
    "aileron": InputCard(property="fcs/aileron-cmd-norm", positive="right wing down"),
    "rudder": InputCard(property="fcs/rudder-cmd-norm", positive="nose left"),
    "throttle": InputCard(
        property="fcs/throttle-cmd-norm", positive="more thrust", limits=(0.0, 1.0)
    ),
}


def standard_card(name: str, xml: str) -> Card:
    """The card of an aircraft that has none: JSBSim's normalised commands."""
    return Card(aircraft=AircraftSection(name=name, xml=xml), inputs=_STANDARD_INPUTS)


def read_card(path: Path) -> Card:
    """Read and validate airframe.toml. Raises BadInputError with file, key and what is allowed."""
    try:
        return _validate(airframe_card.read_card(path))
    except LogError as error:
        raise BadInputError(str(error)) from None


def parse_card(text: str, path: Path) -> Card:
    """The same of the text of that file. Raises BadInputError."""
    try:
        return _validate(airframe_card.parse_card(text, path))
    except LogError as error:
        raise BadInputError(str(error)) from None


def _validate(airframe: AirframeCard) -> Card:
    sections: dict[str, Any] = {
        key: value for key, value in airframe.document.items() if key not in _LOG_READER_SECTIONS
    }
    if "inputs" in sections:
        sections["inputs"] = {
            control: {key: value for key, value in row.items() if key not in _SERVO_KEYS}
            for control, row in sections["inputs"].items()
        }
    try:
        return Card.model_validate(
            {**sections, "reference": airframe.reference, "sensors": airframe.sensors}
        )
    except ValidationError as error:
        first = error.errors()[0]
        problem = (
            "no such key in airframe.toml; see docs/aircraft.md"
            if first["type"] == "extra_forbidden"
            else first["msg"]
        )
        raise BadInputError(
            f"{airframe.path}: {dotted(first['loc'])}: {problem}; received {first.get('input')!r}"
        ) from None


# airframe.toml changed in place: the author's remarks, order and spacing stay.

DECIMALS = 7
"""Places of a metre that a sensor's position is written with."""


def sensors_from_cg(path: Path, forward_m: float, remark: str) -> None:
    """Positions in the card for a centre of gravity further forward by ``forward_m``; the sensors
    stay in the airframe.

    The card's positions are from the centre of gravity, x forward. Accelerometers without one sat
    at it. A folder without a card stays without. Raises BadInputError with the file where it is no
    TOML."""
    if not path.is_file():
        return
    try:
        card = tomlkit.parse(path.read_bytes().decode("utf-8"))
        sensors = card.setdefault("sensors", tomlkit.table())
        positions = sensors.setdefault("position_m", tomlkit.inline_table())
        for name in dict.fromkeys(("accelerometer", *positions)):
            x, *yz = (float(v) for v in positions.get(name, (0.0, 0.0, 0.0)))
            positions[name] = [round(x - forward_m, DECIMALS), *yz]
        if isinstance(positions, tomlkit.items.InlineTable):
            positions.comment(remark.replace("\n", " "))
    except (TOMLKitError, UnicodeDecodeError) as error:
        raise BadInputError(f"{path}: {error}") from None
    path.write_bytes(tomlkit.dumps(card).encode("utf-8"))
