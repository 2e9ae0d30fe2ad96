"""Find an aircraft and read its card: which JSBSim property is which control, and what open loop means."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any, Literal

from lxml import etree
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from sysid.foreign.parsed_text import ParseError, parse_toml
from sysid.foreign.regular_files import read_regular_text
from uqharness.errors import BadInputError
from uqharness.project_files import PROJECT_ROOT as PROJECT_ROOT
from uqharness.simulator import engine
from uqharness.simulator.aircraft_files import identity, read_xml, signature, walk
from uqharness.simulator.preflight import ensure_loadable
from uqharness.simulator.staging import fingerprint, staged
from uqharness.toml import dotted


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


class InputCard(_Strict):
    """One control: the command property, its unit, the sign and the servo table (microseconds -> unit).

    ``selected`` is the command that counts after the aircraft's own selection (autopilot or pilot), ``position`` the surface; both
    are optional and both are only read. ``throw_deg`` turns a normalised command into a record's degrees: 1 is that many, with the
    record's sign.
    """

    property: str
    selected: str | None = None
    position: str | None = None
    unit: Literal["deg", "rad", "pct", "norm"] = "norm"
    positive: str = ""
    limits: tuple[float, float] = (-1.0, 1.0)
    throw_deg: float | None = None
    # Read by sysid.logs.card, which turns servo microseconds into angles; here they only have to be allowed.
    servo_pwm: tuple[tuple[float, float], ...] | Mapping[str, float] = ()
    channel: int | None = Field(default=None, ge=1, le=32)

    @field_validator("limits")
    @classmethod
    def _low_then_high(cls, value: tuple[float, float]) -> tuple[float, float]:
        if not value[0] < value[1]:
            raise ValueError("limits are [low, high]")
        return value

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


class _AircraftSection(_Strict):
    name: str
    xml: str
    dt_s: float = Field(default=0.01, gt=0, le=0.1)


class _ReferenceSection(_Strict):
    S_m2: float | None = Field(default=None, gt=0)
    b_m: float | None = Field(default=None, gt=0)
    c_m: float | None = Field(default=None, gt=0)


class _SensorSection(_Strict):
    position_m: Mapping[str, tuple[float, float, float]] = {}
    noise_std: Mapping[str, float] = {}


class _ReplaySection(_Strict):
    """``without_systems``: systems without effect in open loop and still air; a replay leaves them out, which
    saves a third of its time."""

    without_systems: tuple[str, ...] = ()


class Card(_Strict):
    """airframe.toml, validated."""

    aircraft: _AircraftSection
    reference: _ReferenceSection = _ReferenceSection()
    inputs: Mapping[str, InputCard] = {}
    modes: Mapping[str, Mapping[str, float]] = {}
    outputs: Mapping[str, str] = {}
    metrics: Mapping[str, MetricCard] = {}
    parameters: Mapping[str, ParameterCard] = {}
    sensors: _SensorSection = _SensorSection()
    replay: _ReplaySection = _ReplaySection()
    # Which servo outputs a v-tail or elevons hang on: for reading logs alone, checked by sysid.logs.card.
    mixing: Mapping[str, Any] = {}


# JSBSim's own command properties, for an aircraft that comes without a card.
_STANDARD_INPUTS = {
    "elevator": InputCard(property="fcs/elevator-cmd-norm", positive="nose down"),
    "aileron": InputCard(property="fcs/aileron-cmd-norm", positive="right wing down"),
    "rudder": InputCard(property="fcs/rudder-cmd-norm", positive="nose left"),
    "throttle": InputCard(property="fcs/throttle-cmd-norm", positive="more thrust", limits=(0.0, 1.0)),
}


@dataclass(frozen=True)
class Aircraft:
    """A JSBSim aircraft on disk. ``folder`` holds ``<name>.xml``, its systems and, perhaps, airframe.toml."""

    name: str
    folder: Path
    card: Card
    engine_path: Path
    systems_path: Path

    @property
    def xml(self) -> Path:
        """The aircraft's own XML file."""
        return self.folder / self.card.aircraft.xml

    @property
    def has_card(self) -> bool:
        """Whether the folder has an airframe.toml; without one, JSBSim's normalised commands are taken for the controls."""
        return (self.folder / "airframe.toml").is_file()

    @property
    def dt_s(self) -> float:
        """Integration step [s] that the card asks for."""
        return self.card.aircraft.dt_s

    @property
    def accelerometer_m(self) -> tuple[float, float, float]:
        """Place of the accelerometers from the centre of gravity, body axes [m]; at it unless the card says otherwise."""
        return self.card.sensors.position_m.get("accelerometer", (0.0, 0.0, 0.0))


def find_aircraft(name_or_folder: str | Path) -> Aircraft:
    """The aircraft of that folder, or of that name under ./aircraft, the project's aircraft/ or JSBSim's own.

    Raises BadInputError naming what was looked at and what there is.
    """
    return _read_aircraft(find_folder(name_or_folder))


def find_folder(name_or_folder: str | Path) -> Path:
    """Folder of that aircraft, its files unread. Raises BadInputError as find_aircraft does."""
    given = Path(name_or_folder)
    roots = [Path.cwd() / "aircraft", PROJECT_ROOT / "aircraft", engine.default_root() / "aircraft"]
    candidates = [given] if given.is_dir() else []
    if len(given.parts) == 1:
        candidates += [root / given for root in roots]
    for folder in candidates:
        if folder.is_dir():
            return folder.resolve()
    known = sorted({path.name for root in roots[:2] if root.is_dir() for path in root.iterdir() if path.is_dir()})
    raise BadInputError(
        f"aircraft '{name_or_folder}' not found: it is neither a folder nor a name under aircraft/ "
        f"(there: {', '.join(known) or 'none'}) or in JSBSim's own collection"
    )


def _read_aircraft(folder: Path) -> Aircraft:
    card_file = folder / "airframe.toml"
    if card_file.is_file():
        card = read_card(card_file)
    else:
        xml = folder / f"{folder.name}.xml"
        if not xml.is_file():
            raise BadInputError(f"{folder}: no airframe.toml and no {folder.name}.xml, so this is not a JSBSim aircraft folder")
        card = Card(aircraft=_AircraftSection(name=folder.name, xml=xml.name), inputs=_STANDARD_INPUTS)
    if Path(card.aircraft.xml).name != card.aircraft.xml or "\\" in card.aircraft.xml:
        raise BadInputError(f'{card_file}: [aircraft] xml = "{card.aircraft.xml}": the name of a file in this folder is wanted')
    xml = folder / card.aircraft.xml
    if not xml.is_file():
        raise BadInputError(f'{card_file}: [aircraft] xml = "{card.aircraft.xml}", but {xml} does not exist')
    root = folder.parent.parent
    own_engine, own_systems = root / "engine", root / "systems"
    stock = engine.default_root()
    return Aircraft(
        name=xml.stem,
        folder=folder,
        card=card,
        engine_path=own_engine if own_engine.is_dir() else stock / "engine",
        systems_path=own_systems if own_systems.is_dir() else stock / "systems",
    )


def read_card(path: Path) -> Card:
    """Read and validate airframe.toml. Raises BadInputError with file, key and what is allowed."""
    try:
        data = parse_toml(read_regular_text(path))
    except ParseError as error:
        raise BadInputError(f"{path}: {error}") from None
    except UnicodeDecodeError:
        raise BadInputError(f"{path}: not a text file in UTF-8") from None
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        return Card.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        key = dotted(first["loc"])
        what = "no such key in airframe.toml; see docs/aircraft.md" if first["type"] == "extra_forbidden" else first["msg"]
        raise BadInputError(f"{path}: {key}: {what}; received {first.get('input')!r}") from None


def open_aircraft(aircraft: Aircraft, dt_s: float | None = None) -> Any:
    """A fresh ``FGFDMExec`` of the aircraft in its open-loop mode, nothing run. Raises BadInputError."""
    check_loadable(aircraft)
    fdm = engine.open_fdm(staged(aircraft), dt_s or aircraft.dt_s)
    for name, value in aircraft.card.modes.get("open_loop", {}).items():
        engine.set_property(fdm, name, value)
    return fdm


def check_loadable(aircraft: Aircraft) -> None:
    """BadInputError if loading the aircraft would end the interpreter; see preflight. Cheap when nothing has changed on disk."""
    stamp = fingerprint(aircraft)
    if stamp not in _loadable:
        for _, path in walk(aircraft.folder):
            if path.suffix == ".xml":
                refuse_unknown_operations(path)
        ensure_loadable(aircraft, content_hash(aircraft))
        _loadable.add(stamp)


# What JSBSim 1.3.3 computes within a <function>; anything else it drops without a word, or dies of.
_OPERATIONS_TEXT = """
abs acos and asin atan atan2 avg ceil cos difference eq exp floor fmod fraction ge gt ifthen integer interpolate1d le ln
log10 log2 lt max min mod not nq or p pi pow product property quotient random rotation_alpha_local rotation_beta_local
rotation_bf_to_wf rotation_gamma_local rotation_wf_to_bf roundmultiple sign sin sqrt sum switch t table tan todegrees
toradians urandom v value description documentation
"""
_OPERATIONS = frozenset(_OPERATIONS_TEXT.split())
_TABLES = frozenset({"table", "t"})


def refuse_unknown_operations(path: Path) -> None:
    """BadInputError with file and line for an operation within a function that JSBSim does not know."""

    def walk(element: etree._Element) -> None:
        for child in element.iterchildren("*"):
            if child.tag not in _OPERATIONS:
                near = difflib.get_close_matches(str(child.tag), sorted(_OPERATIONS), n=1)
                hint = f"; did you mean <{near[0]}>?" if near else ""
                raise BadInputError(
                    f"{path}:{child.sourceline}: <{child.tag}> is no operation of a JSBSim function, and it would be left out "
                    f"in silence{hint}"
                )
            if child.tag not in _TABLES:
                walk(child)

    for function in parse_xml(path).getroot().iter("function"):
        walk(function)


_loadable: set[str] = set()


def content_hash(aircraft: Aircraft) -> str:
    """SHA-256 over every file that decides how the aircraft flies; the identity a campaign is tied to. Raises BadInputError."""
    return identity(aircraft)


def folder_hash(folder: Path) -> str:
    """The same for an aircraft's folder. Raises BadInputError."""
    return identity(_read_aircraft(folder.resolve()))


def folder_fingerprint(folder: Path) -> str:
    """A text that changes when a file of the aircraft in ``folder`` does; reads none where nothing has. Raises BadInputError."""
    return fingerprint(_unchanged(folder, signature(folder)))


@lru_cache(maxsize=8)
def _unchanged(folder: Path, _: object) -> Aircraft:
    return _read_aircraft(folder)


def parse_xml(path: Path) -> etree._ElementTree:
    """Parse an XML file with line numbers; BadInputError with file and line if it is not well formed."""
    try:
        return etree.parse(BytesIO(read_xml(path)), etree.XMLParser(remove_comments=False, resolve_entities=False))
    except etree.XMLSyntaxError as error:
        raise BadInputError(f"{path}:{error.lineno}: not well-formed XML: {' '.join(error.msg.split())}") from None
