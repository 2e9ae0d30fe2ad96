"""airframe.toml as the simulator needs it: controls, open-loop mode, scored signals, noise.

`read_card` validates the file with pydantic. Sections that only serve the reading of logs are
validated by `sysid.logs`. `sensors_from_cg` edits positions in place.
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
from uqharness.simulator.host import parse_source
from uqharness.toml import dotted

# Sections and keys that only the log reader uses, or that it has validated already.
_LOG_READER_SECTIONS = {"reference", "sensors", "mixing"}
_SERVO_KEYS = {"servo_pwm", "channel"}


class _Strict(BaseModel):
    """Immutable section; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


class InputCard(_Strict):
    """One control.

    Attributes
    ----------
    property : str
        Command property that is set.
    selected : str or None
        Command after the aircraft's own selection (autopilot or pilot); read only.
    position : str or None
        Position of the surface; read only.
    unit, positive, limits
        Unit of the command, meaning of its sign, and range.
    throw_deg : float or None
        Degrees of a record, with its sign, for a normalised command of 1.
    """

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
        """Reject a throw of zero."""
        if value == 0.0:
            raise ValueError("a throw of 0 degrees cannot be flown")
        return value


class MetricCard(_Strict):
    """Property of an error signal, and the one with sensor noise."""

    true: str
    measured: str | None = None


class ParameterCard(_Strict):
    """A parameter that can be identified: initial value, bounds, unit and source."""

    initial: float | None = None
    bounds: tuple[float, float] | None = None
    unit: str = "1"
    source: str = ""


class AircraftSection(_Strict):
    """Name, XML file and integration step [s]."""

    name: str
    xml: str
    dt_s: float = Field(default=0.01, gt=0, le=0.1)


class _ReplaySection(_Strict):
    """Systems that a replay leaves out, because they have no effect in open loop and still air.

    This saves a third of the time.
    """

    without_systems: tuple[str, ...] = ()


class Card(_Strict):
    """Validated content of airframe.toml."""

    aircraft: AircraftSection
    reference: Reference = Reference()
    inputs: Mapping[str, InputCard] = {}
    modes: Mapping[str, Mapping[str, float]] = {}
    outputs: Mapping[str, str] = {}
    metrics: Mapping[str, MetricCard] = {}
    parameters: Mapping[str, ParameterCard] = {}
    sensors: Sensors = Sensors()
    replay: _ReplaySection = _ReplaySection()
    host: Mapping[str, float | str] = {}

    @field_validator("host")
    @classmethod
    def _is_source(cls, entries: Mapping[str, float | str]) -> Mapping[str, float | str]:
        """Reject sources that are neither numbers nor expressions."""
        for source in entries.values():
            if isinstance(source, str):
                parse_source(source)
        return entries


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
"""Assumed standard deviations of sensor noise (small MEMS units) for a card without any."""


# JSBSim's command properties, for an aircraft without a card.
_STANDARD_INPUTS = {
    "elevator": InputCard(property="fcs/elevator-cmd-norm", positive="nose down"),
    "aileron": InputCard(property="fcs/aileron-cmd-norm", positive="right wing down"),
    "rudder": InputCard(property="fcs/rudder-cmd-norm", positive="nose left"),
    "throttle": InputCard(
        property="fcs/throttle-cmd-norm", positive="more thrust", limits=(0.0, 1.0)
    ),
}


def standard_card(name: str, xml: str, commands: Mapping[str, str] | None = None) -> Card:
    """Return the card of an aircraft without one: JSBSim's normalised commands.

    ``commands`` are properties of controls that another property commands.
    """
    inputs = {
        control: card.model_copy(update={"property": (commands or {}).get(control, card.property)})
        for control, card in _STANDARD_INPUTS.items()
    }
    return Card(aircraft=AircraftSection(name=name, xml=xml), inputs=inputs)


def read_card(path: Path) -> Card:
    """Read and validate airframe.toml. Raises BadInputError with file, key and what is allowed."""
    try:
        return _validate(airframe_card.read_card(path))
    except LogError as error:
        raise BadInputError(str(error)) from None


def parse_card(text: str, path: Path) -> Card:
    """Validate the text of airframe.toml; ``path`` names it in messages. Raises BadInputError."""
    try:
        return _validate(airframe_card.parse_card(text, path))
    except LogError as error:
        raise BadInputError(str(error)) from None


def _validate(airframe: AirframeCard) -> Card:
    """Validate the sections that the simulator uses."""
    sections: dict[str, Any] = {
        key: value for key, value in airframe.document.items() if key not in _LOG_READER_SECTIONS
    }
    # Keys of servos belong to the log reader.
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
        # One mistake per message: later ones often follow from the first.
        first = error.errors()[0]
        problem = (
            "no such key in airframe.toml; see docs/aircraft.md"
            if first["type"] == "extra_forbidden"
            else first["msg"]
        )
        raise BadInputError(
            f"{airframe.path}: {dotted(first['loc'])}: {problem}; received {first.get('input')!r}"
        ) from None


# Editing airframe.toml in place: comments, order and spacing are kept.

DECIMALS = 7
"""Decimals [m] of a sensor position."""


def sensors_from_cg(path: Path, forward_m: float, remark: str) -> None:
    """Rewrite sensor positions for a CG that is further forward; sensors stay in the airframe.

    Parameters
    ----------
    path : Path
        airframe.toml; nothing happens if it does not exist.
    forward_m : float
        Shift of the CG, + forward [m]. Positions are relative to the CG, x forward; accelerometers
        without a position were at the CG.
    remark : str
        Comment behind the positions.

    Raises
    ------
    BadInputError
        If the file is no TOML.
    """
    if not path.is_file():
        return
    try:
        card = tomlkit.parse(path.read_bytes().decode("utf-8"))
        sensors = card.setdefault("sensors", tomlkit.table())
        positions = sensors.setdefault("position_m", tomlkit.inline_table())
        # Accelerometers without a position were at the CG.
        for name in dict.fromkeys(("accelerometer", *positions)):
            x, *yz = (float(v) for v in positions.get(name, (0.0, 0.0, 0.0)))
            positions[name] = [round(x - forward_m, DECIMALS), *yz]
        if isinstance(positions, tomlkit.items.InlineTable):
            positions.comment(remark.replace("\n", " "))
    except (TOMLKitError, UnicodeDecodeError) as error:
        raise BadInputError(f"{path}: {error}") from None
    path.write_bytes(tomlkit.dumps(card).encode("utf-8"))
