"""Aircraft: finding one, checking that JSBSim can load it, opening it, and its signals.

`find_aircraft` reads a folder and its card (`read_card`: airframe.toml), `open_aircraft` returns a
JSBSim instance, and `sources` lists the JSBSim properties behind the columns of a flight record
with their factors to SI units.
"""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal
from xml.parsers import expat

import tomlkit
from lxml import etree
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator
from tomlkit.exceptions import TOMLKitError

from sysid.errors import LogError
from sysid.foreign.regular_files import sha256_hex
from sysid.logs import AirframeCard, Reference, Sensors
from sysid.logs import card as airframe_card
from sysid.record import FlightRecord
from sysid.units import FT_M, LB_KG, RAD_DEG, SLUG_FT2_KGM2, SLUG_FT3_KGPM3
from uqharness.arguments import path as argument_path
from uqharness.errors import BadInputError
from uqharness.files import PROJECT_ROOT
from uqharness.malformed_xml import malformed_xml
from uqharness.simulator import aircraft_checks, engine, host, staging
from uqharness.simulator.aircraft_checks import check_physical, ensure_loadable, undefined_message
from uqharness.simulator.host import HostProperty, parse_source
from uqharness.simulator.staging import (
    HasFiles,
    ModelFiles,
    Staging,
    fingerprint,
    identity,
    read_xml,
    signature,
    walk,
)
from uqharness.toml import dotted

# airframe.toml as the simulator needs it: controls, open-loop mode, scored signals, noise.
#
# `read_card` validates the file with pydantic. Sections that only serve the reading of logs are
# validated by `sysid.logs`. `sensors_from_cg` edits positions in place.

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
    position_unit : str or None
        Its unit, for a name without -deg, -rad or -norm of a normalised command.
    unit, positive, limits
        Unit of the command, meaning of its sign, and range.
    throw_deg : float or None
        Degrees of a record, with its sign, for a normalised command of 1.
    """

    property: str
    selected: str | None = None
    position: str | None = None
    position_unit: Literal["deg", "rad", "norm"] | None = None
    unit: Literal["deg", "rad", "pct", "norm"] = "norm"
    positive: str = ""
    limits: tuple[float, float] = (-1.0, 1.0)
    throw_deg: float | None = None

    @model_validator(mode="after")
    def _unit_of_a_position(self) -> InputCard:
        """Reject a unit of a position that nothing reads, or that its name contradicts."""
        if self.position_unit is None:
            return self
        ending = (self.position or "").rpartition("-")[2]
        if self.position is None or self.unit != "norm":
            raise ValueError('position_unit needs position and unit = "norm": delete it')
        if ending in ("deg", "rad", "norm") and ending != self.position_unit:
            raise ValueError(f"position is in {ending} by its name: delete position_unit")
        return self

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


def set_position(path: Path, control: str, name: str) -> None:
    """Write a control's position property into airframe.toml.

    Raises BadInputError if the file is no TOML.
    """
    try:
        card = tomlkit.parse(path.read_bytes().decode("utf-8"))
        card["inputs"][control]["position"] = name
        card["inputs"][control].pop("position_unit", None)
    except (TOMLKitError, UnicodeDecodeError) as error:
        raise BadInputError(f"{path}: {error}") from None
    path.write_bytes(tomlkit.dumps(card).encode("utf-8"))


@dataclass(frozen=True)
class Aircraft:
    """A JSBSim aircraft on disk.

    Attributes
    ----------
    name : str
        Name of its XML file without suffix.
    folder : Path
        Folder with ``<name>.xml``, systems and, optionally, airframe.toml.
    card : Card
        Content of airframe.toml, or a standard card.
    engine_path, systems_path : Path
        Folders searched for engines and systems after its own.
    source : Path
        What `find_aircraft` takes for it: its folder, or one of the files that the folder offers.
    """

    name: str
    folder: Path
    card: Card
    engine_path: Path
    systems_path: Path
    source: Path

    def __repr__(self) -> str:
        return f"Aircraft({self.name!r}, {str(self.folder)!r})"

    @property
    def xml(self) -> Path:
        """Return the aircraft's main XML file."""
        return self.folder / self.card.aircraft.xml

    @property
    def copy_name(self) -> str:
        """Return the name of a copy's folder, in which this model is found again."""
        return self.folder.name if self.source == self.folder else self.name

    @property
    def has_card(self) -> bool:
        """Return whether the folder has an airframe.toml; else JSBSim's normalised commands are
        used.
        """
        return (self.folder / "airframe.toml").is_file()

    @property
    def dt_s(self) -> float:
        """Return the integration step of the card [s]."""
        return self.card.aircraft.dt_s

    @property
    def accelerometer_m(self) -> tuple[float, float, float]:
        """Return the accelerometers' position from the CG in body axes [m]; zero by default."""
        return self.card.sensors.position_m.get("accelerometer", (0.0, 0.0, 0.0))


def find_aircraft(name_or_folder: str | Path) -> Aircraft:
    """Return the aircraft in a folder, or of a name.

    Names are searched in ./aircraft, in the project's aircraft/ and in JSBSim's collection.

    Parameters
    ----------
    name_or_folder : str or Path
        A name, a folder that holds ``<name>.xml`` and, optionally, airframe.toml, or one of the
        models of a folder: its XML, or FlightGear's ``-set.xml`` that names it.

    Returns
    -------
    Aircraft
        ``name``, ``folder``, ``xml`` and ``card`` (airframe.toml; docs/aircraft.md). Nothing is
        loaded into JSBSim yet.

    Raises
    ------
    BadInputError
        If there is no such aircraft (the message lists the names), or its card has an error.

    Examples
    --------
    >>> import uqharness as uq
    >>> aircraft = uq.find_aircraft("espaaro")
    >>> aircraft.name, aircraft.dt_s
    ('espaaro', 0.01)
    """
    return _read_aircraft(_find_source(argument_path("aircraft", name_or_folder)))


def find_folder(name_or_folder: str | Path) -> Path:
    """Return the folder of an aircraft without reading its files. Raises BadInputError."""
    return _folder_of(_find_source(name_or_folder))


def _folder_of(source: Path) -> Path:
    """Return the folder of an aircraft, whose model may lie in a subfolder such as Aero."""
    if source.is_dir():
        return source
    outer = source.parent.parent
    parts = {name for names in staging.INSIDE.values() for name in names if name}
    has_parts = any((source.parent / name).is_dir() for name in parts)
    return outer if not has_parts and any(outer.glob(f"*{_SET}")) else source.parent


_SET = "-set.xml"


def _find_source(name_or_folder: str | Path) -> Path:
    """Return the folder or file of an aircraft. Raises BadInputError."""
    requested = Path(name_or_folder)
    if requested.suffix == ".xml" and requested.is_file():
        return requested.resolve()
    roots = [Path.cwd() / "aircraft", PROJECT_ROOT / "aircraft", engine.default_root() / "aircraft"]
    # A folder counts before a name; names have one part.
    candidates = [requested] if requested.is_dir() else []
    if len(requested.parts) == 1:
        candidates += [root / requested for root in roots]
    for folder in candidates:
        if folder.is_dir():
            return folder.resolve()
    project_names = sorted(
        {
            path.name
            for root in roots[:2]
            if root.is_dir()
            for path in root.iterdir()
            if path.is_dir()
        }
    )
    raise BadInputError(
        f"aircraft '{name_or_folder}' not found: it is neither a folder nor a name under aircraft/ "
        f"(there: {', '.join(project_names) or 'none'}) or in JSBSim's own collection"
    )


def _read_aircraft(source: Path) -> Aircraft:
    """Read the card of an aircraft and find its engines and systems."""
    folder = _folder_of(source)
    card_file = folder / "airframe.toml"
    if card_file.is_file():
        card, source = read_card(card_file), folder
    else:
        folder, model = _model(source)
        source = folder if source.is_dir() else source
        xml = model.relative_to(folder).as_posix()
        card = standard_card(model.stem, xml, _commands(folder, xml))
    if staging.leads_out(card.aircraft.xml) or "\\" in card.aircraft.xml:
        raise BadInputError(
            f'{card_file}: [aircraft] xml = "{card.aircraft.xml}": the name of a file in this'
            " folder is needed"
        )
    xml_file = folder / card.aircraft.xml
    if not xml_file.is_file():
        raise BadInputError(
            f'{card_file}: [aircraft] xml = "{card.aircraft.xml}", but {xml_file} does not exist'
        )
    # Engines and systems lie next to the folder "aircraft" in a JSBSim root.
    root = folder.parent.parent
    stock = engine.default_root()
    engine_path, systems_path = (
        next((root / name for name in names if (root / name).is_dir()), stock / names[0])
        for names in (("engine", "engines", "Engines"), ("systems", "Systems"))
    )
    return Aircraft(
        name=xml_file.stem,
        folder=folder,
        card=card,
        engine_path=engine_path,
        systems_path=systems_path,
        source=source,
    )


def _commands(folder: Path, xml: str) -> dict[str, str]:
    """Return the commands of an aircraft without a card that are not JSBSim's own."""
    contents = []
    for _, path in walk(folder):
        # An aircraft that cannot be read is refused when it is loaded.
        if path.suffix == ".xml" and b"/controls/" in (content := read_xml(path)):
            contents.append((path.name, content))
    try:
        return host.commands(host.scan(contents))
    except etree.XMLSyntaxError:
        return {}


def _model(source: Path) -> tuple[Path, Path]:
    """Return the folder and the model of an aircraft without a card.

    A folder's model is that of its name, else the one that FlightGear's -set.xml of its name or
    its only ones name, else its only one, else that of its only subfolder with one.
    """
    folder = _folder_of(source)
    # A -set.xml of FlightGear names its model, an XML file is one.
    if source.is_file() and source.name.endswith(_SET):
        aero = _set_file(folder, source.name).aero
        if not aero or not (folder / f"{aero}.xml").is_file():
            raise BadInputError(
                f"{source}: names no JSBSim model of this folder; <sim> <aero> must be the name of"
                f" its XML, received '{aero}'"
            )
        return folder, folder / f"{aero}.xml"
    if source.is_file():
        if b"<fdm_config" not in read_xml(source):
            raise BadInputError(
                f"{source}: is no JSBSim aircraft, which begins with <fdm_config>; give its XML,"
                " its folder or FlightGear's -set.xml"
            )
        return folder, source
    # A folder: its name decides, then FlightGear's -set.xml, then the only model.
    same_name = folder / f"{folder.name}.xml"
    if same_name.is_file():
        return folder, same_name
    sets = {
        path: folder / f"{aero}.xml"
        for path, aero in _jsbsim_sets(folder).items()
        if (folder / f"{aero}.xml").is_file()
    }
    by_name = [model for model in sets.values() if model.stem == folder.name]
    model_set = sets.get(folder / f"{folder.name}{_SET}") or next(iter(by_name), None)
    models = [path for path in sorted(folder.glob("*.xml")) if b"<fdm_config" in read_xml(path)]
    choices = [model_set] if model_set else sorted(set(sets.values())) or models
    if len(choices) == 1:
        return folder, choices[0]
    # Without a model of its own the only subfolder with one is taken.
    if not choices:
        below = [path for path in sorted(folder.iterdir()) if path.is_dir() and _has_model(path)]
        if len(below) == 1:
            return _model(below[0])
        if not below:
            raise BadInputError(
                f"{folder}: no airframe.toml and no {folder.name}.xml, so this is not a JSBSim"
                " aircraft folder"
            )
        raise BadInputError(
            f"{folder}: has no model itself, but {_listed(below, folder)} have one; give one of"
            " these folders"
        )
    files = [path for path, model in sets.items() if model in choices] or choices
    raise BadInputError(
        f"{folder}: no airframe.toml and no {folder.name}.xml, but {_listed(choices, folder)}; give"
        f" {files[0]} or another of them, or put an airframe.toml with [aircraft] name ="
        f' "{choices[0].stem}" and xml = "{choices[0].relative_to(folder).as_posix()}" into it'
    )


def _listed(paths: Collection[Path], folder: Path) -> str:
    """Return names in a folder as a list of words."""
    names = [path.relative_to(folder).as_posix() for path in paths]
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _has_model(folder: Path) -> bool:
    """Return whether a folder looks like an aircraft's."""
    return (folder / f"{folder.name}.xml").is_file() or bool(_jsbsim_sets(folder))


_MAX_SET_FILES = 16
_set_files: dict[tuple[str, bytes | None], tuple[dict[str, bytes | None], host.SetFile]] = {}


def _set_file(folder: Path, name: str) -> host.SetFile:
    """Return FlightGear's description of an aircraft, includes within its folder followed."""
    contents: dict[str, bytes | None] = {}

    def read(place: str) -> bytes | None:
        """Return the content of a file of the folder; None without that file."""
        if place not in contents:
            path = folder / place
            inside = not staging.leads_out(place) and path.is_file()
            contents[place] = read_xml(path) if inside else None
        return contents[place]

    # Cached by content: an aircraft is copied several times, and has a file for each variant.
    key = name, read(name)
    if key in _set_files:
        parts, result = _set_files[key]
        if all(read(place) == content for place, content in parts.items()):
            return result
    result = host.read_set_file(name, read)
    _set_files[key] = contents, result
    while len(_set_files) > _MAX_SET_FILES:
        del _set_files[next(iter(_set_files))]
    return result


def _jsbsim_sets(folder: Path) -> dict[Path, str]:
    """Return the -set.xml of a folder that fly in JSBSim, with the model that each names."""
    files = {path: _set_file(folder, path.name) for path in sorted(folder.glob(f"*{_SET}"))}
    return {
        path: file.aero
        for path, file in files.items()
        if file.aero and file.flight_model in ("", "jsb")
    }


def _initial_values(aircraft: Aircraft) -> Mapping[str, float]:
    """Return the initial values of the -set.xml that belongs to the model."""
    sets = _jsbsim_sets(aircraft.folder)
    model = Path(aircraft.card.aircraft.xml).with_suffix("").as_posix()
    mine = [path for path, aero in sets.items() if aero == model] or sorted(
        aircraft.folder.glob(f"*{_SET}")
    )
    # One for each variant of an aircraft: that of the request, of the folder, or of the model.
    preferred = [
        aircraft.source,
        *(aircraft.folder / f"{name}{_SET}" for name in (aircraft.folder.name, aircraft.name)),
    ]
    chosen = next((path for path in preferred if path in mine), mine[0] if mine else None)
    return {} if chosen is None else _set_file(aircraft.folder, chosen.name).values


def open_aircraft(aircraft: Aircraft, dt_s: float | None = None) -> Any:
    """Return a new ``FGFDMExec`` with the aircraft in its open-loop mode, before initialisation.

    Parameters
    ----------
    aircraft : Aircraft
        The aircraft.
    dt_s : float, optional
        Integration step [s]; the card's by default.

    Raises
    ------
    BadInputError
        If the aircraft cannot be loaded, or the card sets a property that does not exist.
    """
    check_loadable(aircraft)
    fdm = engine.open_fdm(staged(aircraft), dt_s or aircraft.dt_s)
    for name, value in aircraft.card.modes.get("open_loop", {}).items():
        try:
            engine.set_property(fdm, name, value)
        except BadInputError as error:
            raise BadInputError(f"{aircraft.folder}: {error}") from None
    return fdm


def with_step(aircraft: Aircraft, dt_s: float) -> Aircraft:
    """Return the aircraft with another integration step [s]."""
    section = aircraft.card.aircraft.model_copy(update={"dt_s": dt_s})
    return replace(aircraft, card=aircraft.card.model_copy(update={"aircraft": section}))


def check_loadable(aircraft: Aircraft, defined: Collection[str] = ()) -> None:
    """Raise BadInputError if loading the aircraft would crash the interpreter.

    Unchanged files are checked once. ``defined`` are properties that a run script creates.
    """
    misspelt = tuple(
        row for row in host_properties(aircraft) if row.misspelt and row.name not in defined
    )
    if misspelt:
        raise BadInputError(f"{aircraft.folder}: {undefined_message(misspelt)}")


def host_properties(aircraft: Aircraft) -> tuple[HostProperty, ...]:
    """Return the properties that only a host, such as FlightGear, would provide, with sources.

    The card's [host] changes sources and adds properties. Raises BadInputError if the aircraft is
    not loadable.
    """
    # Cached by file states within this process, and by content on disk.
    stamp = fingerprint(aircraft), f"{aircraft.source.name} {_entries(aircraft)}"
    if stamp not in _host:
        refuse_unknown_operations(aircraft)
        check_physical(aircraft)
        try:
            rows = ensure_loadable(aircraft, content_hash(aircraft))
        except BadInputError as error:
            # JSBSim names its first error; the others are looked for.
            errors = _errors_of_refused(aircraft)
            if not errors:
                raise
            raise BadInputError(_all_findings(errors)) from error
        rows = host.with_initial_values(rows, _initial_values(aircraft))
        # An instrumented aircraft brings the host's system along; its entries stay.
        files = staging.model_files(aircraft)
        if host_system := _carried_system(files):
            names = host.scan([(host_system, files.local[host_system].content)])
            defined = {
                *names.computed,
                *names.declared,
                *map(host.canonical, aircraft.card.host),
            }
            rows = tuple(row for row in rows if host.canonical(row.name) not in defined)
        else:
            rows = host.with_host_entries(rows, aircraft.card.host)
        _host[stamp] = rows
    return _host[stamp]


def model_files(aircraft: HasFiles) -> ModelFiles:
    """Return the screened files of an aircraft, with the system of its host where it needs one.

    Files that were staged have it already. Raises BadInputError with file and line.
    """
    files = staging.model_files(aircraft)
    if not isinstance(aircraft, Aircraft):
        return files
    local = dict(files.local)
    # In the aircraft's folder, where JSBSim looks before the shared one.
    for name, (content, text) in with_rotor_inertia(aircraft, files).items():
        part = local.get(name) or files.shared[f"engine/{Path(name).name}"]
        local[name] = replace(part, content=content)
        _report(text)
    main = aircraft.xml.relative_to(aircraft.folder).as_posix()
    if levels := fuel_levels(aircraft):
        local[main] = replace(local[main], content=_with_fuel(local[main].content, levels))
        _report(f"{aircraft.xml}: {describe_fuel(levels)}")
    host_system = _carried_system(files)
    if host_system and aircraft.card.host:
        content = host.host_system_xml(host.with_host_entries((), aircraft.card.host))
        if _without_comments(content) != _without_comments(local[host_system].content):
            _report(
                f"{aircraft.folder / host_system} differs from [host] of airframe.toml, which is"
                " flown; `uqharness instrument` writes the system again"
            )
            local[host_system] = replace(local[host_system], content=content)
    rows = _provided(aircraft)
    if not rows:
        return ModelFiles(local, files.shared, files.shared_paths)
    _report(f"{aircraft.name}: {host.describe(rows)}")
    author = local[main]
    # In the aircraft's own file, so that readers need no other.
    content = host.insert_system(author.content, host.host_system_xml(rows), str(aircraft.xml))
    local[main] = replace(author, content=content)
    return ModelFiles(local, files.shared, files.shared_paths)


_MIN_INERTIA = 1e-6
"""Inertia [slug ft2] that JSBSim takes for any smaller one."""
_INERTIA_KGM3 = 0.055
"""Moment of inertia over the fifth power of the diameter, of small wooden and plastic propellers.
"""


def with_rotor_inertia(aircraft: HasFiles, files: ModelFiles) -> dict[str, tuple[bytes, str]]:
    """Return the propellers without inertia: name in the folder to mended content and a sentence.

    Generators of aircraft write <ixx> 0.00 for small propellers. JSBSim takes 1e-6 slug ft2, with
    which the speed alternates between 0 and millions of rpm at any usual step; a propeller of
    typical inertia is as good as steady.
    """
    # Propellers lie in the aircraft's folder or in the shared engine folder.
    mended = {}
    places = {name: (aircraft.folder / name, file) for name, file in files.local.items()}
    for key, file in files.shared.items():
        kind, _, name = key.partition("/")
        if kind == "engine":
            places.setdefault(f"Engines/{name}", (aircraft.engine_path / name, file))
    for name, (path, file) in places.items():
        if file.root != "propeller":
            continue
        root: Any = etree.fromstring(file.content, etree.XMLParser(resolve_entities=False))
        node, diameter = root.find("ixx"), _length(root, "diameter")
        if node is None or not diameter or (node.text or "").strip("0. +-\t\r\n"):
            continue
        # Inertia grows with the fifth power of the diameter for one shape and material.
        inertia = f"{_INERTIA_KGM3 * diameter**5 / SLUG_FT2_KGM2:.3g}"
        if not float(inertia) > _MIN_INERTIA:
            continue
        # Only this element changes; all other bytes are the author's.
        lines = file.content.split(b"\n")
        lines[node.sourceline - 1] = re.sub(
            rb"<ixx[^>]*>[^<]*</ixx>",
            f'<ixx unit="SLUG*FT2"> {inertia} </ixx>'.encode(),
            lines[node.sourceline - 1],
        )
        sentence = (
            f"{path}:{node.sourceline}: <ixx> is 0, with which it turns at no steady speed:"
            f" flown with {inertia} slug ft2, typical of its diameter; write its own there"
        )
        mended[name] = (b"\n".join(lines), sentence)
    return mended


_LBS_GAL = 6.0  # of aviation gasoline
_KEROSENE_LBS_GAL = 6.6  # JSBSim's default
_ASSUMED_FILL = 0.5  # of the usable fuel
_GALLONS = {"LTR": 0.2641720524, "FT3": 7.480519481, "M3": 264.1720524, "IN3": 1.0 / 231.0}


def fuel_levels(aircraft: Aircraft) -> dict[int, float]:
    """Return the fuel [lb] of tanks that are empty in the XML and filled by FlightGear, by number.

    FlightGear fills tanks from the -set.xml or by scripts. Tanks are half full where the former
    has no level. Nothing is filled if no engine starves; if other tanks have fuel, those of the
    starving engines only are filled, as a system would.
    """
    files = staging.model_files(aircraft)
    burning = aircraft_checks.burning_engines(files)
    main = files.local[aircraft.xml.relative_to(aircraft.folder).as_posix()]
    root: Any = etree.fromstring(main.content, etree.XMLParser(resolve_entities=False))
    tanks = root.findall("propulsion/tank")
    # An engine cannot draw what a tank keeps.
    unusable = [_unusable_lb(tank) for tank in tanks]
    contents = [
        present if (present := _number(tank, "contents")) > unusable_lb else 0.0
        for tank, unusable_lb in zip(tanks, unusable, strict=True)
    ]
    starved: set[int] = set()
    for node in root.iterfind("propulsion/engine"):
        feeds = [int(feed.text) for feed in node.iterfind("feed") if (feed.text or "").strip()]
        burns = Path(node.get("file", "")).stem in burning
        in_range = [number for number in feeds if number < len(tanks)]
        if burns and not any(contents[number] for number in in_range):
            starved |= set(in_range)
    if not starved:
        return {}
    values = _initial_values(aircraft)
    levels = {}
    for number, (tank, present, unusable_lb) in enumerate(
        zip(tanks, contents, unusable, strict=True)
    ):
        capacity = _number(tank, "capacity")
        is_reserve = any(contents) and number not in starved
        if present or is_reserve or not capacity or tank.find("contents") is None:
            continue
        name = "/consumables/fuel/tank" + (f"[{number}]" if number else "")
        level = (
            values.get(f"{name}/level-lbs", 0.0)
            or values.get(f"{name}/level-gal_us", 0.0) * _LBS_GAL
            or values.get(f"{name}/level-norm", 0.0) * capacity
        )
        levels[number] = (
            level if level > unusable_lb else unusable_lb + _ASSUMED_FILL * (capacity - unusable_lb)
        )
    return levels


def _unusable_lb(tank: Any) -> float:
    """Return the fuel that stays in a tank [lb]."""
    node = tank.find("unusable-volume")
    if node is None:
        return 0.0
    gallons = _number(tank, "unusable-volume") * _GALLONS.get(node.get("unit", "GAL"), 1.0)
    return gallons * (_number(tank, "density") or _KEROSENE_LBS_GAL)


def describe_fuel(levels: Mapping[int, float]) -> str:
    """Return a sentence that names the tanks that are filled."""
    tanks = ", ".join(f"{number}: {level:.4g} lb" for number, level in levels.items())
    return (
        f"its engines have no fuel, which FlightGear fills in: flown with tank {tanks}; write"
        " <contents> of its tanks"
    )


def _number(parent: Any, tag: str) -> float:
    """Return a child's weight [lb]; 0 without a number."""
    node = parent.find(tag)
    try:
        value = float(node.text)
    except (AttributeError, TypeError, ValueError):
        return 0.0
    return value / LB_KG if node.get("unit", "LBS") == "KG" else value


@dataclass(frozen=True)
class TankEdit:
    """The new contents of a tank: the bytes of the XML that ``new`` replaces from byte ``at``."""

    at: int
    new: bytes
    old: bytes


def fuel_edits(content: bytes, levels: Mapping[int, float]) -> tuple[TankEdit, ...]:
    """Return the edits of an aircraft's XML that fill its tanks, by number [lb]."""
    parser = expat.ParserCreate()
    path: list[str] = []
    edits: list[TankEdit] = []
    number, start, in_kg = -1, 0, False

    def opened(tag: str, attributes: dict[str, str]) -> None:
        nonlocal number, start, in_kg
        path.append(tag)
        number += path[1:] == ["propulsion", "tank"]
        if path[1:] == ["propulsion", "tank", "contents"]:
            start = content.index(b">", parser.CurrentByteIndex) + 1
            in_kg = attributes.get("unit") == "KG"

    def closed(_: str) -> None:
        if path[1:] == ["propulsion", "tank", "contents"] and number in levels:
            old = content[start : parser.CurrentByteIndex]
            # Comments and white space around the number stay.
            at = re.search(rb"(<!--.*?-->|\s)*(?P<text>[^<\s]*)", old, re.DOTALL)
            assert at is not None
            level = levels[number] * (LB_KG if in_kg else 1.0)
            new = f"{level:.6g}".encode()
            edits.append(TankEdit(start + at.start("text"), new, at["text"]))
        path.pop()

    parser.StartElementHandler, parser.EndElementHandler = opened, closed
    parser.Parse(content, True)
    return tuple(edits)


def _with_fuel(content: bytes, levels: Mapping[int, float]) -> bytes:
    """Return an aircraft's XML with other contents of its tanks; lines keep their numbers."""
    for edit in reversed(fuel_edits(content, levels)):
        content = content[: edit.at] + edit.new + content[edit.at + len(edit.old) :]
    return content


def _provided(aircraft: Aircraft) -> tuple[HostProperty, ...]:
    """Return what a host provides; nothing for a model that JSBSim refuses.

    Whoever opens the model is told why it does not load.
    """
    try:
        return tuple(row for row in host_properties(aircraft) if not row.misspelt)
    except BadInputError:
        return ()


def stage(aircraft: Aircraft, root: Path) -> Staging:
    """Write the files of `model_files` into ``root``, which is made. Raises BadInputError."""
    return staging.write(model_files(aircraft), aircraft, root)


def staged(aircraft: Aircraft) -> Staging:
    """Return the aircraft staged in this process's temporary folder, with its host's system.

    It is staged again once a file has changed. Raises BadInputError.
    """
    author = staging.staged(aircraft)
    if author.root not in _mended:
        _mended[author.root] = bool(
            with_rotor_inertia(aircraft, staging.model_files(aircraft)) or fuel_levels(aircraft)
        )
    if not aircraft.card.host and not _provided(aircraft) and not _mended[author.root]:
        return author
    # A card that was changed in this process has other entries.
    place = author.root / f"hosted-{sha256_hex(_entries(aircraft).encode())[:12]}"
    if not place.is_dir():
        stage(aircraft, place)
    return replace(
        author,
        root=place,
        user_folders=tuple(
            (place / at.relative_to(author.root), real) for at, real in author.user_folders
        ),
    )


_mended: dict[Path, bool] = {}


def _without_comments(content: bytes) -> bytes:
    """Return XML without comments and white space."""
    return b"".join(re.sub(rb"<!--.*?-->", b"", content, flags=re.DOTALL).split())


def _entries(aircraft: Aircraft) -> str:
    """Return the entries of the card's [host] as text."""
    return repr(sorted(aircraft.card.host.items()))


def _carried_system(files: ModelFiles) -> str:
    """Return the file of the host's system that an instrumented aircraft has; empty without one."""
    return next((name for name in files.local if Path(name).stem == host.HOST_SYSTEM), "")


def _report(message: str) -> None:
    """Log a message once per process."""
    if message not in _reported:
        _reported.add(message)
        _LOG.info("%s", message)


# Operations in a <function> of JSBSim 1.3.3. It ignores others silently, or crashes.
_OPERATIONS_TEXT = """
abs acos and asin atan atan2 avg ceil cos difference eq exp floor fmod fraction ge gt ifthen integer
interpolate1d le ln log10 log2 lt max min mod not nq or p pi pow product property quotient random
rotation_alpha_local rotation_beta_local rotation_bf_to_wf rotation_gamma_local rotation_wf_to_bf
roundmultiple sign sin sqrt sum switch t table tan todegrees toradians urandom v value description
documentation
"""
_OPERATIONS = frozenset(_OPERATIONS_TEXT.split())


def refuse_unknown_operations(aircraft: Aircraft) -> None:
    """Raise BadInputError with file and line for operations that JSBSim does not know.

    Only files that JSBSim reads are searched: folders also hold sounds, scenes and panels.
    """
    if errors := _findings(aircraft, refused=False):
        # Errors that keep JSBSim from loading it are named with these.
        try:
            rows = ensure_loadable(aircraft, content_hash(aircraft))
            errors += _misspelt(aircraft, rows)
        except BadInputError:
            errors = _errors_of_refused(aircraft)
        raise BadInputError(_all_findings(errors))


def _findings(aircraft: Aircraft, refused: bool) -> list[str]:
    """Return what is wrong in the aircraft's XML: all that JSBSim refused, or what it ignores."""
    files = staging.model_files(aircraft)
    names = {name: str(aircraft.folder / name) for name in files.local}
    present = [name for name, _ in walk(aircraft.folder) if name.endswith(".xml")]
    return aircraft_checks.findings(files, names, _OPERATIONS, present=present, refused=refused)


def _errors_of_refused(aircraft: Aircraft) -> list[str]:
    """Return all errors of an aircraft that JSBSim refused, misspelt properties included."""
    errors = _findings(aircraft, refused=True)
    # Without an error the reason of the refusal is unknown, and JSBSim's own message is better.
    names = host.scan(staging.model_files(aircraft).contents()) if errors else host.Names()
    rows = host.misspelt_physics(names, _common_properties())
    return errors + _misspelt(aircraft, rows)


@lru_cache(maxsize=1)
def _common_properties() -> frozenset[str]:
    """Return the properties that JSBSim has whatever the model is, from a bomb without engines."""
    bomb = find_aircraft("mk82")
    return frozenset(engine.catalog(engine.open_fdm(staged(bomb), bomb.dt_s)))


def _misspelt(aircraft: Aircraft, rows: Iterable[HostProperty]) -> list[str]:
    """Return the errors of misspelt properties that no entry of the card's [host] defines."""
    defined = {host.canonical(name) for name in aircraft.card.host}
    return [
        f"{aircraft.folder / row.place}: {undefined_message((replace(row, place=''),))}"
        for row in rows
        if row.misspelt and host.canonical(row.name) not in defined
    ]


def _all_findings(errors: list[str]) -> str:
    """Return findings as one message."""
    if len(errors) == 1:
        return errors[0]
    return f"{len(errors)} errors in the XML: " + "; ".join(
        f"({number}) {text}" for number, text in enumerate(errors, start=1)
    )


_LOG = logging.getLogger("uqharness")
_host: dict[tuple[str, str], tuple[HostProperty, ...]] = {}
_reported: set[str] = set()


def content_hash(aircraft: Aircraft) -> str:
    """Return the SHA-256 over all files that determine how the aircraft flies.

    It identifies the aircraft of a campaign. Raises BadInputError.
    """
    files = identity(aircraft)
    # A folder offers several models.
    chosen = aircraft.source.relative_to(aircraft.folder).as_posix()
    return files if chosen == "." else sha256_hex(f"{files} {chosen}".encode())


def folder_hash(folder: Path) -> str:
    """Return the `content_hash` of the aircraft in a folder. Raises BadInputError."""
    return content_hash(_read_aircraft(folder.resolve()))


def aircraft_fingerprint(name_or_folder: str | Path) -> str:
    """Return a text that changes whenever a file of the aircraft does.

    Files are read only after a change. Raises BadInputError.
    """
    source = _find_source(name_or_folder)
    return fingerprint(_read_cached(source, signature(_folder_of(source))))


@lru_cache(maxsize=8)
def _read_cached(source: Path, _: object) -> Aircraft:
    """Return the aircraft of a folder, read again only if its file states changed."""
    return _read_aircraft(source)


def parse_xml(path: Path) -> etree._ElementTree:
    """Parse an XML file with line numbers; BadInputError with file and line if it is malformed."""
    content = read_xml(path)
    try:
        return etree.parse(
            BytesIO(content), etree.XMLParser(remove_comments=False, resolve_entities=False)
        )
    except etree.XMLSyntaxError:
        raise malformed_xml(content, str(path)) from None


# Signals of a flight record and the JSBSim properties behind them.

LBF_PER_SLUG_TO_MPS2 = FT_M
"""lbf/slug is ft/s2."""


@dataclass(frozen=True)
class Source:
    """A signal: factor * property, divided by ``over`` if given."""

    property: str
    factor: float = 1.0
    over: str | None = None


# Specific force at the CG: total force without gravity over mass. JSBSim's own a-pilot properties
# are one frame old, while a record's acceleration includes the command of its row.
STANDARD: Mapping[str, Source] = MappingProxyType(
    {
        "time_s": Source("simulation/sim-time-sec"),
        "V_mps": Source("velocities/vt-fps", FT_M),
        "alpha_rad": Source("aero/alpha-rad"),
        "beta_rad": Source("aero/beta-rad"),
        "phi_rad": Source("attitude/phi-rad"),
        "theta_rad": Source("attitude/theta-rad"),
        "psi_rad": Source("attitude/psi-rad"),
        "p_radps": Source("velocities/p-rad_sec"),
        "q_radps": Source("velocities/q-rad_sec"),
        "r_radps": Source("velocities/r-rad_sec"),
        "ax_mps2": Source("forces/fbx-total-lbs", LBF_PER_SLUG_TO_MPS2, "inertia/mass-slugs"),
        "ay_mps2": Source("forces/fby-total-lbs", LBF_PER_SLUG_TO_MPS2, "inertia/mass-slugs"),
        "az_mps2": Source("forces/fbz-total-lbs", LBF_PER_SLUG_TO_MPS2, "inertia/mass-slugs"),
        "h_m": Source("position/h-sl-ft", FT_M),
        "vn_mps": Source("velocities/v-north-fps", FT_M),
        "ve_mps": Source("velocities/v-east-fps", FT_M),
        "vd_mps": Source("velocities/v-down-fps", FT_M),
        "rho_kgpm3": Source("atmosphere/rho-slugs_ft3", SLUG_FT3_KGPM3),
    }
)

SECOND_ORDER: Mapping[str, float] = MappingProxyType(
    {
        "simulation/integrator/rate/rotational": 3.0,
        "simulation/integrator/rate/translational": 3.0,
        "simulation/integrator/position/rotational": 3.0,
    }
)
"""Second-order Adams-Bashforth integrators, for flights that are compared with others.

JSBSim's default for body rates and attitude is Euler's rule. At 100 Hz it makes roll damping 4 %
too strong and shifts everything by half a step, which an identification would attribute to the
coefficients.
"""

_UNIT_TO_RECORD = {"deg": 1.0, "pct": 1.0, "rad": RAD_DEG, "norm": 1.0}
_COLUMN = {
    "elevator": "elevator_deg",
    "aileron": "aileron_deg",
    "rudder": "rudder_deg",
    "throttle": "throttle_pct",
}


def sources(aircraft: Aircraft) -> dict[str, Source]:
    """Return the signals of a record for this aircraft.

    These are the standard signals, the card's outputs, the commands and the measured surfaces. A
    normalised command becomes percent for a throttle, and degrees for a surface whose card has
    throw_deg. Without a throw it stays normalised and is named ``<surface>_norm``.
    """
    table = dict(STANDARD)
    for signal, name in aircraft.card.outputs.items():
        table[signal] = Source(name)
    for control, card in aircraft.card.inputs.items():
        column = _COLUMN.get(control, f"{control}_{card.unit}")
        factor = _UNIT_TO_RECORD.get(card.unit, 1.0)
        if card.unit == "norm":
            if control == "throttle":
                factor = 100.0
            elif card.throw_deg is not None:
                factor = card.throw_deg
            else:
                column = f"{control}_norm"
        # The command after the autopilot's selection, where the card names it.
        selected = card.selected or card.property
        table[column] = Source(selected, factor)
        if card.position is not None and column.endswith("_deg"):
            table[column.replace("_deg", "_pos_deg")] = Source(card.position, position_factor(card))
    return table


def position_factor(card: InputCard) -> float:
    """Return the factor from a card's position property to degrees in the record's sign.

    A card in deg or rad has its position in the same unit. For a normalised command,
    `position_unit` or the ending of the property (-deg, -rad, -norm) gives the unit, and the throw
    gives the sign.
    """
    if card.unit != "norm" or card.position is None:
        return _UNIT_TO_RECORD.get(card.unit, 1.0)
    # Normalised command: the throw's sign is the record's sign.
    throw = 1.0 if card.throw_deg is None else card.throw_deg
    unit = card.position_unit or card.position.rpartition("-")[2]
    return throw if unit == "norm" else math.copysign(_UNIT_TO_RECORD.get(unit, 1.0), throw)


def standard_positions() -> dict[str, Source]:
    """Return JSBSim's usual position properties of the surfaces; they may not exist."""
    return {
        f"{surface}_pos_deg": Source(f"fcs/{surface}-pos-deg")
        for surface in ("elevator", "aileron", "rudder")
    }


# Altitude at the start of a flight whose record does not tell it.
#
# Air density changes by 1 % in 100 m, and so does every identified coefficient. Without density
# or altitude in the record, the altitude of the aircraft's only initial condition is used, with
# a warning.

_METRES = {"M": 1.0, "FT": FT_M, "IN": FT_M / 12.0, "KM": 1000.0}
_SETTLES = "a column rho_kgpm3 settles it"


def with_start_altitude(record: FlightRecord, folder: Path) -> tuple[FlightRecord, str]:
    """Return the record with an altitude above sea level, and a warning if that is assumed.

    Parameters
    ----------
    record : FlightRecord
        The flight.
    folder : Path
        Folder of the aircraft with its initial conditions.

    Returns
    -------
    record : FlightRecord
        Unchanged if density or altitude is known, or no assumption is possible.
    warning : str
        Empty if nothing is assumed.
    """
    start = record.metadata.start
    if "rho_kgpm3" in record or "alt_m" in start:
        return record, ""
    altitudes = _initial_altitudes(folder)
    # Several initial conditions, or none: nothing can be assumed.
    if len(altitudes) != 1:
        return (
            record,
            (
                "the record has neither rho_kgpm3 nor the altitude of its start; it was flown in"
                " the air of sea level: 100 m more are 1 % less density, which goes into every"
                f" coefficient; {_SETTLES}"
            ),
        )
    name, altitude = altitudes[0]
    metadata = replace(record.metadata, start={**start, "alt_m": altitude})
    return (
        record.with_columns({}, metadata),
        (
            f"the record has neither rho_kgpm3 nor the altitude of its start; {altitude:g} m above"
            f" sea level were taken from {name}: 100 m more are 1 % less density, which goes into"
            f" every coefficient; {_SETTLES}"
        ),
    )


def _initial_altitudes(folder: Path) -> list[tuple[str, float]]:
    """Return (file, altitude above sea level [m]) of the initial conditions that give one."""
    altitudes = []
    for path in sorted(folder.glob("*.xml")):
        try:
            root = parse_xml(path).getroot()
        except BadInputError:
            continue
        if root.tag != "initialize":
            continue
        # JSBSim: altitude above sea level, or above the ground at an elevation.
        ground = _length(root, "elevation")
        above = [_length(root, "altitudeAGL"), _length(root, "altitude")]
        sea = _length(root, "altitudeMSL")
        agl = next((a for a in above if a is not None), None)
        if sea is None and agl is not None:
            sea = agl + (ground or 0.0)
        if sea is not None:
            altitudes.append((path.name, sea))
    return altitudes


def _length(root: etree._Element, tag: str) -> float | None:
    """Return an element's length [m]; None without a number. JSBSim's default unit is feet."""
    element = root.find(tag)
    try:
        return (
            None
            if element is None
            else float(element.text or "") * _METRES[element.get("unit", "FT").upper()]
        )
    except (ValueError, KeyError):
        return None
