"""Find an aircraft, check that JSBSim can load it, open it."""

from __future__ import annotations

import difflib
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import Any

from lxml import etree

from sysid.units import FT_M, RAD_DEG, SLUG_FT3_KGPM3
from uqharness.arguments import path as argument_path
from uqharness.errors import BadInputError
from uqharness.files import PROJECT_ROOT
from uqharness.simulator import engine
from uqharness.simulator.card import Card, InputCard, read_card, standard_card
from uqharness.simulator.physical_checks import (
    Undefined,
    check_physical,
    ensure_loadable,
    undefined_message,
)
from uqharness.simulator.staging import fingerprint, identity, read_xml, signature, staged, walk


@dataclass(frozen=True)
class Aircraft:
    """A JSBSim aircraft on disk.

    ``folder`` holds ``<name>.xml``, its systems and, perhaps, airframe.toml.
    """

    name: str
    folder: Path
    card: Card
    engine_path: Path
    systems_path: Path

    def __repr__(self) -> str:
        return f"Aircraft({self.name!r}, {str(self.folder)!r})"

    @property
    def xml(self) -> Path:
        """The aircraft's own XML file."""
        return self.folder / self.card.aircraft.xml

    @property
    def has_card(self) -> bool:
        """Whether the folder has an airframe.toml; without one, JSBSim's normalised commands are
        taken for the controls.
        """
        return (self.folder / "airframe.toml").is_file()

    @property
    def dt_s(self) -> float:
        """Integration step [s] that the card asks for."""
        return self.card.aircraft.dt_s

    @property
    def accelerometer_m(self) -> tuple[float, float, float]:
        """Place of the accelerometers from the centre of gravity, body axes [m]; at it unless the
        card says otherwise.
        """
        return self.card.sensors.position_m.get("accelerometer", (0.0, 0.0, 0.0))


def find_aircraft(name_or_folder: str | Path) -> Aircraft:
    """The aircraft of that folder, or of that name under ./aircraft, the project's aircraft/ or
    JSBSim's own.

    Parameters
    ----------
    name_or_folder : str or Path
        A name, or a folder that holds ``<name>.xml`` and, perhaps, airframe.toml.

    Returns
    -------
    Aircraft
        ``name``, ``folder``, ``xml`` and ``card`` (airframe.toml; docs/aircraft.md). Nothing has
        been loaded into JSBSim yet.

    Raises
    ------
    BadInputError
        Where there is none, naming those there are, and for a card with a mistake in it.

    Examples
    --------
    >>> import uqharness as uq
    >>> aircraft = uq.find_aircraft("espaaro")
    >>> aircraft.name, aircraft.dt_s
    ('espaaro', 0.01)
    """
    return _read_aircraft(find_folder(argument_path("aircraft", name_or_folder)))


def find_folder(name_or_folder: str | Path) -> Path:
    """Folder of that aircraft, its files unread. Raises BadInputError as find_aircraft does."""
    requested = Path(name_or_folder)
    roots = [Path.cwd() / "aircraft", PROJECT_ROOT / "aircraft", engine.default_root() / "aircraft"]
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


def _read_aircraft(folder: Path) -> Aircraft:
    card_file = folder / "airframe.toml"
    if card_file.is_file():
        card = read_card(card_file)
    else:
        xml = folder / f"{folder.name}.xml"
        if not xml.is_file():
            raise BadInputError(
                f"{folder}: no airframe.toml and no {folder.name}.xml, {_other_models(folder)}"
            )
        card = standard_card(folder.name, xml.name)
    if Path(card.aircraft.xml).name != card.aircraft.xml or "\\" in card.aircraft.xml:
        raise BadInputError(
            f'{card_file}: [aircraft] xml = "{card.aircraft.xml}": the name of a file in this'
            " folder is needed"
        )
    xml = folder / card.aircraft.xml
    if not xml.is_file():
        raise BadInputError(
            f'{card_file}: [aircraft] xml = "{card.aircraft.xml}", but {xml} does not exist'
        )
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


def _other_models(folder: Path) -> str:
    """Say which aircraft a folder holds under names other than its own."""
    models = [
        path.name for path in sorted(folder.glob("*.xml")) if b"<fdm_config" in read_xml(path)
    ]
    if not models:
        return "so this is not a JSBSim aircraft folder"
    name = Path(models[0]).stem
    return (
        f"but {' and '.join(models)}: JSBSim wants folder and file of one name; rename the"
        " folder to "
        f'{name}, or put an airframe.toml with [aircraft] name = "{name}" and xml = "{models[0]}"'
        " into it"
    )


def open_aircraft(aircraft: Aircraft, dt_s: float | None = None) -> Any:
    """A fresh ``FGFDMExec`` of the aircraft in its open-loop mode, nothing run.

    Raises BadInputError.
    """
    check_loadable(aircraft)
    fdm = engine.open_fdm(staged(aircraft), dt_s or aircraft.dt_s)
    for name, value in aircraft.card.modes.get("open_loop", {}).items():
        try:
            engine.set_property(fdm, name, value)
        except BadInputError as error:
            raise BadInputError(f"{aircraft.folder}: {error}") from None
    return fdm


def check_loadable(aircraft: Aircraft, defined: Collection[str] = ()) -> None:
    """Raise BadInputError if loading the aircraft would end the interpreter (see preflight). Cheap
    for unchanged files.

    ``defined`` are properties that a run script makes, which the aircraft may then read.
    """
    undefined = tuple(u for u in undefined_properties(aircraft) if u.name not in defined)
    if undefined:
        raise BadInputError(f"{aircraft.folder}: {undefined_message(undefined)}")


def undefined_properties(aircraft: Aircraft) -> tuple[Undefined, ...]:
    """Properties that the aircraft reads and only a host such as FlightGear may define.

    Raises BadInputError as above.
    """
    stamp = fingerprint(aircraft)
    if stamp not in _undefined:
        for _, path in walk(aircraft.folder):
            if path.suffix == ".xml":
                refuse_unknown_operations(path)
        check_physical(aircraft)
        _undefined[stamp] = ensure_loadable(aircraft, content_hash(aircraft))
    return _undefined[stamp]


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
    """BadInputError with file and line for an operation within a function that JSBSim does not
    know.
    """

    def walk(element: etree._Element) -> None:
        for child in element.iterchildren("*"):
            if child.tag not in _OPERATIONS:
                matches = difflib.get_close_matches(str(child.tag), sorted(_OPERATIONS), n=1)
                hint = f"; did you mean <{matches[0]}>?" if matches else ""
                raise BadInputError(
                    f"{path}:{child.sourceline}: <{child.tag}> is no operation of a JSBSim"
                    f" function; JSBSim would ignore it{hint}"
                )
            if child.tag not in _TABLES:
                walk(child)

    for function in parse_xml(path).getroot().iter("function"):
        walk(function)


_undefined: dict[str, tuple[Undefined, ...]] = {}


def content_hash(aircraft: Aircraft) -> str:
    """SHA-256 over every file that decides how the aircraft flies; the identity a campaign is tied
    to. Raises BadInputError.
    """
    return identity(aircraft)


def folder_hash(folder: Path) -> str:
    """The same for an aircraft's folder. Raises BadInputError."""
    return identity(_read_aircraft(folder.resolve()))


def folder_fingerprint(folder: Path) -> str:
    """A text that changes when a file of the aircraft in ``folder`` does; reads none where nothing
    has. Raises BadInputError.
    """
    return fingerprint(_read_cached(folder, signature(folder)))


@lru_cache(maxsize=8)
def _read_cached(folder: Path, _: object) -> Aircraft:
    return _read_aircraft(folder)


def parse_xml(path: Path) -> etree._ElementTree:
    """Parse an XML file with line numbers; BadInputError with file and line if it is not well
    formed.
    """
    try:
        return etree.parse(
            BytesIO(read_xml(path)), etree.XMLParser(remove_comments=False, resolve_entities=False)
        )
    except etree.XMLSyntaxError as error:
        raise BadInputError(
            f"{path}:{error.lineno}: not well-formed XML: {' '.join(error.msg.split())}"
        ) from None


# Signals of a flight record and the JSBSim properties they come from: one table, with the
# factor to SI.

LBF_PER_SLUG_TO_MPS2 = FT_M
"""Force in lbf over mass in slugs is ft/s2."""


@dataclass(frozen=True)
class Source:
    """signal = factor * property (divided by ``over``, if given)."""

    property: str
    factor: float = 1.0
    over: str | None = None


# Specific force is total force without gravity over mass, at the CG: JSBSim's own a-pilot
# properties are one frame old, and a record promises that the acceleration of a sample has already
# seen the command of that sample.
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
"""Adams-Bashforth integrators of second order for a flight that is to be compared with others.

JSBSim's default for body rates and attitude is Euler's rule, which at 100 Hz makes roll damping 4 %
too strong and moves everything by half a step; an identification would put the difference into the
coefficients."""

_UNIT_TO_RECORD = {"deg": 1.0, "pct": 1.0, "rad": RAD_DEG, "norm": 1.0}
_COLUMN = {
    "elevator": "elevator_deg",
    "aileron": "aileron_deg",
    "rudder": "rudder_deg",
    "throttle": "throttle_pct",
}


def sources(aircraft: Aircraft) -> dict[str, Source]:
    """The record's signals for this aircraft: the standard table, the card's outputs, commands and
    measured surfaces.

    A normalised command (unit "norm") becomes percent of a throttle, and degrees of a surface
    through the card's throw_deg; without a throw it is left as it stands and named
    ``<surface>_norm``."""
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
        selected = card.selected or card.property
        table[column] = Source(selected, factor)
        if card.position is not None and column.endswith("_deg"):
            table[column.replace("_deg", "_pos_deg")] = Source(card.position, position_factor(card))
    return table


def position_factor(card: InputCard) -> float:
    """Unit of a card's position property to degrees, + as a record counts.

    A card in deg or rad has its position in the same unit. Of a normalised command the property's
    ending tells (JSBSim's own names end in -deg, -rad or -norm), and the throw its sign."""
    if card.unit != "norm" or card.position is None:
        return _UNIT_TO_RECORD.get(card.unit, 1.0)
    throw = 1.0 if card.throw_deg is None else card.throw_deg
    if card.position.endswith("-rad"):
        return math.copysign(_UNIT_TO_RECORD["rad"], throw)
    return throw if card.position.endswith("-norm") else math.copysign(1.0, throw)


def standard_positions() -> dict[str, Source]:
    """Surface positions by JSBSim's own properties, for an aircraft without a card; they may or may
    not be there.
    """
    return {
        f"{surface}_pos_deg": Source(f"fcs/{surface}-pos-deg")
        for surface in ("elevator", "aileron", "rudder")
    }
