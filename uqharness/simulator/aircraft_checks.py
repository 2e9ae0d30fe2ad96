"""Checks of an aircraft: geometry, inertia, rotors, a trial load, and errors in the XML.

JSBSim loads a wing without area, or an inertia that no body has, without a message and then
computes NaN. Such values are refused with file and line; questionable ones are warned about. Some
errors crash the interpreter, so that an unknown model is first loaded in a child process; the
result is cached by content. `findings` names all errors in the XML of a model that JSBSim refused.
"""

from __future__ import annotations

import difflib
import itertools
import json
import logging
import math
import re
import statistics
import sys
from collections.abc import Collection, Iterator
from dataclasses import astuple, dataclass
from io import BytesIO
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from lxml import etree

from sysid.foreign.limited import MemoryLimit
from sysid.foreign.regular_files import in_words, sha256_hex
from sysid.units import SLUG_FT2_KGM2
from uqharness.child_process import describe_exit, give_answer, run_module
from uqharness.errors import BadInputError
from uqharness.files import user_cache, write_bytes
from uqharness.malformed_xml import malformed_xml
from uqharness.simulator import engine, host
from uqharness.simulator.host import HostProperty
from uqharness.simulator.staging import (
    INSIDE,
    HasFiles,
    ModelFiles,
    NamedFiles,
    Staging,
    model_files,
    staged,
)

_LOG = logging.getLogger("uqharness")
_SIZES = {"wingarea": "area", "wingspan": "span", "chord": "mean chord"}
_MOMENTS = ("ixx", "iyy", "izz")
_PRODUCTS = ("ixy", "ixz", "iyz")
_TO_KGM2 = {"KG*M2": 1.0, "SLUG*FT2": SLUG_FT2_KGM2}
_TRIANGLE_TOLERANCE = 0.01  # inertia in an XML has two or three digits
_FEWEST_ROTORS = 3  # of a multirotor
_noted: set[tuple[str, str]] = set()


@dataclass(frozen=True)
class _Number:
    """A number of the XML and its place, "file:line"."""

    value: float
    place: str


def check_physical(aircraft: HasFiles) -> None:
    """Refuse sizes and inertia that no aircraft has; warn about rotors and unlikely inertia.

    Parameters
    ----------
    aircraft : HasFiles
        Any aircraft; its files are read through the gate.

    Raises
    ------
    BadInputError
        For a wing area, span or chord that is not positive, and for moments of inertia that are not
        positive or whose products make the tensor indefinite, with file and line.
    """
    files = model_files(aircraft)
    root = _root(aircraft, files, aircraft.xml.relative_to(aircraft.folder).as_posix())
    rotor = rotor_place(aircraft)
    try:
        _check_sizes(_section(aircraft, files, root, "metrics"))
    except BadInputError as error:
        # A multirotor has no wing to measure.
        raise BadInputError(
            f"{rotor}; only aircraft with wings are supported" if rotor else str(error)
        ) from None
    _check_inertia(_section(aircraft, files, root, "mass_balance"))
    for place, text in remarks(files, {name: str(aircraft.folder / name) for name in files.local}):
        _note(place, text)
    # Rotors fly in JSBSim but are not trimmed here.
    if rotor:
        place, _, text = rotor.partition(": ")
        _note(
            place, f"{text}; it is not trimmed, so commands that start from steady flight refuse it"
        )


def rotor_place(aircraft: HasFiles) -> str:
    """Return where the XML has a rotor, as "file:line: ..."; empty for other aircraft."""
    files = model_files(aircraft)
    rotors = {
        PurePosixPath(name).name
        for name, file in (files.local | files.shared).items()
        if file.root == "rotor"
    }
    for name, file in files.local.items():
        for reference in file.references:
            if reference.tag == "thruster" and PurePosixPath(reference.name).name in rotors:
                place = f"{aircraft.folder / name}:{reference.line}"
                return (
                    f'{place}: <thruster file="{reference.name}"> is a rotor: this is a rotorcraft'
                )
    return _multirotor_place(
        _root(aircraft, files, aircraft.xml.relative_to(aircraft.folder).as_posix())
    )


def _multirotor_place(root: _Section | None) -> str:
    """Return where three or more propellers or forces lift and none pulls; empty if not so."""
    if root is None:
        return ""
    lifting, forward = [], 0
    for node in root.element.iter("thruster", "force"):
        share = _upward_share(node)
        if share > 0.9:
            lifting.append(node)
        forward += share < 0.5
    if len(lifting) < _FEWEST_ROTORS or forward:
        return ""
    first = lifting[0]
    return (
        f"{root.where}:{first.sourceline}: {len(lifting)} <{first.tag}> lift and none pulls"
        " forward: this is a multirotor"
    )


def _upward_share(node: Any) -> float:
    """Return the share of a thruster's or body-axis force's direction along z; NaN without one."""
    if node.tag == "thruster":
        pitch = _number(node.find("orient/pitch"))
        orient = node.find("orient")
        in_degrees = orient is not None and (orient.get("unit") or "").upper() == "DEG"
        return abs(math.sin(math.radians(pitch) if in_degrees else pitch))
    x, y, z = (_number(node.find(f"direction/{axis}")) for axis in "xyz")
    size = math.hypot(x, y, z)
    return abs(z) / size if size > 0.0 and node.get("frame") == "BODY" else math.nan


def _number(node: Any) -> float:
    """Return the number of an element; 0 if there is none."""
    try:
        return float(node.text) if node is not None else 0.0
    except (TypeError, ValueError):
        return 0.0


@dataclass(frozen=True)
class _Section:
    """An element of the aircraft and the file that holds it."""

    element: Any
    where: str

    def number(self, tag: str) -> _Number | None:
        """Return the number of a child in SI; None if it is absent or no number."""
        child = self.element.find(tag)
        if child is None:
            return None
        try:
            value = float((child.text or "").strip())
        except ValueError:
            return None
        unit = (child.get("unit") or "").upper()
        factor = _TO_KGM2.get(unit, SLUG_FT2_KGM2) if tag in (*_MOMENTS, *_PRODUCTS) else 1.0
        return _Number(value * factor, f"{self.where}:{child.sourceline}")


def _root(aircraft: HasFiles, files: ModelFiles, name: str) -> _Section | None:
    """Return the root element of a file of the aircraft."""
    if name not in files.local:
        return None
    parser = etree.XMLParser(remove_comments=True, resolve_entities=False)
    where = str(aircraft.folder / name)
    try:
        root = etree.parse(BytesIO(files.local[name].content), parser).getroot()
    except etree.XMLSyntaxError:
        raise malformed_xml(files.local[name].content, where) from None
    return _Section(root, where)


def _section(
    aircraft: HasFiles, files: ModelFiles, root: _Section | None, tag: str
) -> _Section | None:
    """Return a section of the aircraft, from its own file if it names one."""
    element = None if root is None else root.element.find(tag)
    if root is None or element is None:
        return None
    if not (name := (element.get("file") or "").strip()):
        return _Section(element, root.where)
    return _root(aircraft, files, name if name.endswith(".xml") else f"{name}.xml")


def _check_sizes(metrics: _Section | None) -> None:
    """Raise BadInputError for a reference size that is not positive."""
    for tag, words in _SIZES.items() if metrics is not None else ():
        number = metrics.number(tag)  # type: ignore[union-attr]
        if number is not None and not (number.value > 0.0 and math.isfinite(number.value)):
            raise BadInputError(
                f"{number.place}: <{tag}> is {number.value:g}: a positive {words} is needed,"
                " because coefficients and dimensionless rates refer to it"
            )


def _check_inertia(mass: _Section | None) -> None:
    """Raise BadInputError for impossible inertia; warn if the triangle inequality fails."""
    if mass is None:
        return
    moments = [mass.number(tag) for tag in _MOMENTS]
    # Point masses may carry all inertia; a negative moment is wrong even then.
    has_points = mass.element.find("pointmass") is not None
    for tag, moment in zip(_MOMENTS, moments, strict=True):
        if moment is None or (has_points and moment.value == 0.0):
            continue
        if not (moment.value > 0.0 and math.isfinite(moment.value)):
            raise BadInputError(
                f"{moment.place}: <{tag}> is {moment.value:g} kg m^2: a positive moment of inertia "
                "is needed"
            )
    present = [moment for moment in moments if moment is not None and moment.value > 0.0]
    # The tensor is tested only if it is complete.
    if len(present) != 3:
        return
    products = [number.value if (number := mass.number(tag)) else 0.0 for tag in _PRODUCTS]
    # JSBSim has two sign conventions of products; one possible tensor suffices.
    low, middle, high = max(_principal(present, products, sign) for sign in (1.0, -1.0))
    values = f"principal moments {low:.4g}, {middle:.4g} and {high:.4g} kg m^2"
    place = present[0].place
    if not low > 0.0:
        raise BadInputError(
            f"{place}: impossible inertia, {values}: all three must be positive; products "
            f"({', '.join(_PRODUCTS)}) are too large for the moments"
        )
    if high > (1.0 + _TRIANGLE_TOLERANCE) * (low + middle):
        _note(
            place,
            f"impossible inertia, {values}: the largest exceeds the sum of the others by"
            f" {100.0 * (high / (low + middle) - 1.0):.0f} %, which no body has; check"
            f" {', '.join(_MOMENTS)} and their units",
        )


def _principal(
    moments: list[_Number], products: list[float], sign: float
) -> tuple[float, float, float]:
    """Return the principal moments of inertia [kg m2] in rising order."""
    xy, xz, yz = (sign * value for value in products)
    xx, yy, zz = (moment.value for moment in moments)
    low, middle, high = np.linalg.eigvalsh([[xx, -xy, -xz], [-xy, yy, -yz], [-xz, -yz, zz]])
    return float(low), float(middle), float(high)


def _note(place: str, text: str) -> None:
    """Warn once per process, also about copies of the aircraft."""
    key = Path(place).name.rpartition(":")[0], text
    if key not in _noted:
        _noted.add(key)
        _LOG.warning("%s: %s", place, text)


# Trial load in a child process. JSBSim 1.3.3 has a segmentation fault at an unknown operation, and
# aborts when a model that reads an undefined property is destroyed. The check takes 0.5 s for a
# changed aircraft.

TIMEOUT_S = 60.0
MAX_BYTES = 1_500_000_000
"""Memory limit of the trial load; JSBSim's largest aircraft takes about 20 MB."""
_VERDICT_FORMAT = 3
_checked: dict[str, tuple[HostProperty, ...]] = {}


def ensure_loadable(aircraft: NamedFiles, content: str) -> tuple[HostProperty, ...]:
    """Load the model in a child process, unless the result is known.

    Parameters
    ----------
    aircraft : NamedFiles
        The aircraft.
    content : str
        Hash of its files.

    Returns
    -------
    tuple of HostProperty
        Properties that only a host would provide, with what it would write there.

    Raises
    ------
    BadInputError
        If the model cannot be loaded, or the child crashes or hangs. A refused model is not loaded
        again in this process: some refusals (a propeller without tables) corrupt JSBSim's memory.
    """
    # The verdict depends on files, JSBSim, the host's table, and the format of this cache.
    rules = sha256_hex(Path(host.__file__).read_bytes())[:12]
    key = f"{content}-{engine.JSBSIM_VERSION}-{_VERDICT_FORMAT}-{rules}"
    if key not in _checked:
        mark = user_cache() / "loadable" / key
        verdict = _recall(mark)
        if verdict is None:
            verdict = _try_in_child(aircraft)
            _remember(mark, verdict)
        _checked[key] = verdict
    return _checked[key]


def undefined_message(undefined: tuple[HostProperty, ...]) -> str:
    """Return a sentence that names every misspelt property, its place, and what to do."""
    names = ", ".join(f"{u.name} ({u.place})" if u.place else u.name for u in undefined)
    one = len(undefined) == 1
    subject = "a property" if one else f"{len(undefined)} properties"
    similar = ", ".join(
        u.similar if one else f"{u.name} -> {u.similar}" for u in undefined if u.similar
    )
    hint = f"did you mean {similar}? Correct" if similar else "correct"
    return (
        f"the model reads {subject} that nothing defines: {names}; {hint} the name, or give the"
        " property a value in [host] of airframe.toml"
    )


def _try_in_child(aircraft: NamedFiles) -> tuple[HostProperty, ...]:
    """Load the model in a child process and return what it reads of a host."""
    folder = aircraft.folder
    places = (folder, aircraft.xml.relative_to(folder), aircraft.engine_path, aircraft.systems_path)
    child = run_module(__name__, *places, timeout_s=TIMEOUT_S)
    if child.code is None:
        raise BadInputError(
            f"aircraft {folder}: JSBSim did not finish loading it within {TIMEOUT_S:g} s"
        )
    if "refused" in child.answer:
        message = str(child.answer["refused"])
        raise BadInputError(message if str(folder) in message else f"{folder}: {message}")
    if child.code < 0:
        raise BadInputError(
            f"aircraft {folder}: loading it ends JSBSim's process ({describe_exit(child.code)});"
            f" last output: {child.output or 'no message'}; look there for an unknown element or"
            " function operation, or a property name with illegal characters"
        )
    return tuple(HostProperty(*row) for row in child.answer.get("host", ()))


def _recall(mark: Path) -> tuple[HostProperty, ...] | None:
    """Return a cached result; None without a valid one."""
    try:
        return tuple(HostProperty(*row) for row in json.loads(mark.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None


def _remember(mark: Path, undefined: tuple[HostProperty, ...]) -> None:
    """Cache a result."""
    # Without a writable cache the check is repeated.
    rows = [astuple(row) for row in undefined]
    try:
        mark.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(mark, json.dumps(rows).encode())
    except (OSError, BadInputError):
        return


@dataclass(frozen=True)
class _AircraftPaths:
    """Places of an aircraft whose card is not read."""

    folder: Path
    xml: Path
    engine_path: Path
    systems_path: Path

    @property
    def name(self) -> str:
        return self.xml.stem


def _child(folder: str, xml: str, engine_path: str, systems_path: str) -> None:
    """Load the aircraft in this process and answer the parent."""
    engine.mirror_messages(sys.stdout.fileno())
    aircraft = _AircraftPaths(
        Path(folder), Path(folder) / xml, Path(engine_path), Path(systems_path)
    )
    # A small XML can ask for huge tables.
    with MemoryLimit(MAX_BYTES):
        try:
            staging = staged(aircraft)
            fdm = engine.open_fdm(staging, 0.01)
        except BadInputError as error:
            give_answer({"refused": str(error)})
            return
        except MemoryError:
            give_answer({"refused": f"loading it takes more than {in_words(MAX_BYTES)} of memory"})
            return
        engines = fdm.get_propulsion().get_num_engines()
        names = host.scan(staged_contents(staging), engines)
        # Named functions are evaluated again when the instance is destroyed.
        missing = engine.undefined_properties(fdm, names.read)
        existing = set(engine.catalog(fdm)) - set(missing)
        unset = set(missing)
        rows = host.resolve(
            names,
            {name: _similar(name, existing) for name in missing},
            lambda name: name not in unset and fdm.get_property_manager().hasNode(name),
        )
        give_answer({"host": [astuple(row) for row in rows]})


def _similar(name: str, existing: set[str]) -> str:
    """Return the most similar existing name; empty without one."""
    matches = difflib.get_close_matches(name, existing, n=1, cutoff=0.8)
    return matches[0] if matches else ""


def staged_contents(staging: Staging) -> Iterator[tuple[str, bytes]]:
    """Yield name and content of the XML files that JSBSim loads, as messages name them."""
    for file, home in _model_files(staging):
        yield file.relative_to(home).as_posix(), file.read_bytes()


def function_properties(staging: Staging) -> Iterator[tuple[str, Path, int]]:
    """Yield (name, file, line) of every property that a function or table of the model reads.

    Names with an engine's number (#) are left out.
    """
    for file, _ in _model_files(staging):
        for element in _elements(file):
            if element.tag not in ("property", "p", "independentVar"):
                continue
            functions = [e for e in element.iterancestors() if e.tag == "function"]
            # Properties of a template function are its arguments.
            if any(e.get("type") == "template" for e in functions):
                continue
            name = (element.text or "").strip().lstrip("-")
            if (functions or element.tag == "independentVar") and engine.is_legal_name(name):
                yield name, file, _line(element)


def _line(element: etree._Element) -> int:
    """Return the line of an element; 0 if unknown."""
    return element.sourceline if isinstance(element.sourceline, int) else 0


def _elements(file: Path) -> Iterator[etree._Element]:
    """Return all elements of a file."""
    parser = etree.XMLParser(resolve_entities=False, remove_comments=True)
    return etree.parse(str(file), parser).getroot().iter("*")


def _model_files(staging: Staging) -> Iterator[tuple[Path, Path]]:
    """Yield (file, folder it is shown in) of the XML that JSBSim loads.

    A file of the aircraft hides a shared one of the same name.
    """
    local = [file for file in sorted(staging.folder.rglob("*.xml")) if file != staging.xml]
    yield staging.xml, staging.folder
    yield from ((file, staging.folder) for file in local)
    hidden = {file.name for file in local}
    for part in ("engine", "systems"):
        for file in sorted((staging.root / part).rglob("*.xml")):
            if file.name not in hidden:
                yield file, staging.root


if __name__ == "__main__":
    _child(*sys.argv[1:5])


# What is wrong in an aircraft's XML that JSBSim refused: all at once, with file, line and mend.
#
# JSBSim stops at its first error. `findings` reads the same files again and names every wrong
# number, table, double name, missing file, unknown unit and unknown operation. It is asked only
# about models that JSBSim refused, so that no working model is judged by these rules.

_MAX_FINDINGS = 30
# A text that is meant as a number: properties begin with a letter or a slash.
_NUMBER_LIKE = re.compile(r"[-+]*[.,]?\d\S*")
_AXES_TEXT = "DRAG SIDE LIFT AXIAL NORMAL X Y Z ROLL PITCH YAW"
_AXES = tuple(_AXES_TEXT.split())
_COMPONENTS_TEXT = """
accelerometer actuator aerosurface_scale angles angle deadband distributor fcs_function gyro
integrator kinematic lag_filter lead_lag_filter magnetometer pid property pure_gain scheduled_gain
second_order_filter sensor summer switch washout_filter waypoint_distance waypoint_heading
"""
_COMPONENTS = frozenset(_COMPONENTS_TEXT.split())
_COEFFICIENTS = {
    "lag_filter": 1,
    "washout_filter": 1,
    "integrator": 1,
    "lead_lag_filter": 4,
    "second_order_filter": 6,
}
_CONTACTS = ("BOGEY", "STRUCTURE")
_SECTIONS = ("metrics", "mass_balance", "ground_reactions", "aerodynamics")
_BURNING = frozenset({"piston_engine", "turbine_engine", "turboprop_engine"})
_UNITS_TEXT = """
M FT IN KM M2 FT2 M3 FT3 IN3 CC LTR LBS LB KG SLUG N NEWTONS DEG RAD DEG/SEC RAD/SEC FT/SEC M/S KTS
KPH MPH SLUG*FT2 KG*M2 LBS/FT N/M LBS/FT/SEC N/M/SEC LBS/FT2/SEC2 N/M2/SEC2 WATTS HP KW INHG PSF PA
ATM PSI PASCAL FT-LBS LBFT FT*LBS LBS*FT NM N*M LBS/SEC KG/MIN LBS/MIN KG/SEC GAL GAL/MIN CFM VOLTS
OHMS AMPERES RPM RPM/VOLT N*M/AMPERE SEC FAHRENHEIT CELSIUS RANKINE KELVIN K F R C M/SEC FT/MIN KT
N*M*SEC LBS/GAL M4*SEC/KG LBS/HR/HP FT*LB LBS/HP*HR SLUG*FT KM/SEC LBS/FT2 LB*FT FT4*SEC/SLUG
"""
_UNITS = frozenset(_UNITS_TEXT.split())
_LENGTHS = frozenset(["location", "wingspan", "chord", "htailarm", "vtailarm", "diameter"])
_COORDINATES = frozenset("xyz")
_LENGTHS_OF_TABLES = {"row": 1, "column": 2, "table": 3}
_PROSE_TEXT = """
author copyright description documentation email filecreationdate fileheader license limitation note
reference references version
"""
_PROSE = frozenset(_PROSE_TEXT.split())


def findings(
    files: ModelFiles,
    names: dict[str, str],
    operations: frozenset[str],
    *,
    present: Collection[str] = (),
    refused: bool = True,
) -> list[str]:
    """Return what is wrong, as "file:line: what; what to do", in the order of the files.

    Parameters
    ----------
    files : ModelFiles
        The files that JSBSim loads.
    names : dict
        Name of each local or shared file to the name that messages give.
    operations : frozenset of str
        Operations of a function that JSBSim knows.
    present : collection of str
        Places of the XML files in the aircraft's folder, for hints.
    refused : bool
        Whether JSBSim refused the model; else only what it ignores, or crashes on in flight, is
        judged.
    """
    messages: list[str] = []
    for name, file in [*files.local.items(), *files.shared.items()]:
        where = names.get(name, name)
        parser = etree.XMLParser(remove_comments=True, resolve_entities=False)
        try:
            root = etree.parse(BytesIO(file.content), parser).getroot()
        except etree.XMLSyntaxError:
            raise malformed_xml(file.content, where) from None
        if root.tag in ("initialize", "runscript"):
            continue
        rows = [*_operations(root, operations), *_components(root), *_feeds(root, files)]
        rows += [*_missing_mass(root), *_missing_places(root)]
        if refused:
            rows += [*_files(root, files, present), *_numbers(root), *_tables(root)]
            rows += [*_doubles(root), *_units(root), *_missing_parts(root)]
        messages += [f"{where}:{line}: {text}" for line, text in sorted(set(rows))]
    return messages[:_MAX_FINDINGS]


def _functional_elements(root: Any) -> Iterator[Any]:
    """Yield the elements outside of headers and descriptions."""
    for element in root.iterchildren("*"):
        if element.tag not in _PROSE:
            yield element
            yield from _functional_elements(element)


def _files(root: Any, files: ModelFiles, present: Collection[str]) -> Iterator[tuple[int, str]]:
    """Yield references to files that are not where JSBSim looks for them."""
    by_stem = {PurePosixPath(place).stem: place for place in present}
    for element in root.iter("*"):
        name = (element.get("file") or "").strip()
        if not name or element.tag in ("output", "input"):
            continue
        name = name if name.endswith(".xml") else f"{name}.xml"
        is_part = element.tag in ("engine", "thruster")
        folders = dict.fromkeys(folder for group in INSIDE.values() for folder in group)
        # JSBSim does not look for an engine beside the aircraft's XML.
        places = [f"{folder}/{name}".lstrip("/") for folder in folders if folder or not is_part]
        shared = [f"{kind}/{name}" for kind in INSIDE]
        parts = [files.local.get(place) for place in places]
        parts += [files.shared.get(place) for place in shared]
        if part := next((part for part in parts if part is not None), None):
            # JSBSim loads a part only from a file of the same element.
            if not is_part and part.root not in ("", element.tag):
                yield (
                    _line(element),
                    (
                        f'<{element.tag} file="{element.get("file")}">: this file is a'
                        f" <{part.root}>; write <{part.root} file=...>, or rename its root to"
                        f" <{element.tag}>"
                    ),
                )
            continue
        stem = PurePosixPath(name).stem
        matches = difflib.get_close_matches(stem, by_stem.keys() - {stem}, n=1)
        hint = f" or correct the name (did you mean {matches[0]}?)" if matches else ""
        hint = f", from {by_stem[stem]}" if stem in by_stem else hint
        folder = "Engines" if is_part else "Systems"
        yield (
            _line(element),
            (
                f'<{element.tag} file="{element.get("file")}">: there is no such file; put {name}'
                f" into the aircraft's folder {folder}{hint}"
            ),
        )


def _numbers(root: Any) -> Iterator[tuple[int, str]]:
    """Yield texts and values that are almost numbers."""
    for element in _functional_elements(root):
        if element.tag == "tableData":
            continue
        texts = [(element.text or "").strip(), (element.get("value") or "").strip()]
        if element.tag in ("value", "v") and not texts[0]:
            yield _line(element), f"<{element.tag}> is empty; write a number into it"
        for text in texts:
            if _NUMBER_LIKE.fullmatch(text) and not _is_number(text):
                yield (
                    _line(element),
                    (
                        f"<{element.tag}> is {text!r}, no number; write one with a single decimal"
                        f" point{_suggested(text)}"
                    ),
                )
        # A quantity is a number, in a few components a property, whose name has slashes.
        is_quantity = "unit" in element.attrib or element.tag in _COORDINATES
        is_word = re.fullmatch(r"[^\d/]+", texts[0]) is not None
        if is_quantity and is_word and not len(element):
            yield _line(element), f"<{element.tag}> is {texts[0]!r}; write a number"


def _is_number(text: str) -> bool:
    """Return whether a text is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def _suggested(text: str) -> str:
    """Return a number that a text may mean, for a message."""
    comma = re.sub(r"^[-+]+(?=[-+])", "", text.replace(",", "."))
    if _is_number(comma):
        return f", such as {comma}"
    head, _, decimals = comma.partition(".")
    number = f"{head}.{decimals.replace('.', '')}"
    return f", such as {number}" if _is_number(number) else ""


def _tables(root: Any) -> Iterator[tuple[int, str]]:
    """Yield tables whose data do not fit their axes."""
    for table in root.iter("table", "t"):
        data = table.findall("tableData")
        if not data:
            # A table may refer to another one by its name.
            if table.find("independentVar") is not None:
                yield _line(table), "this <table> has no <tableData>; add its numbers"
            continue
        axes = max(
            (
                _LENGTHS_OF_TABLES.get(variable.get("lookup", "row"), 1)
                for variable in table.findall("independentVar")
            ),
            default=0,
        )
        for block in data:
            yield from _block(block, axes)
        nested = any(block.get("breakPoint") is not None for block in data)
        if axes == 3 and not nested:
            yield (
                _line(table),
                (
                    "three axes are named by <independentVar>, but <tableData> has no breakPoint:"
                    ' remove the axis with lookup="table", or give one'
                    ' <tableData breakPoint="..."> for each of its values'
                ),
            )


def _block(block: Any, axes: int) -> Iterator[tuple[int, str]]:
    """Yield errors in one <tableData>."""
    # Rows of the data with their lines in the file.
    start = _line(block)
    lines = [
        (start + k, text.split())
        for k, text in enumerate((block.text or "").split("\n"))
        if text.split()
    ]
    if not lines and block.find("tableData") is None:
        yield start, "<tableData> is empty; write its rows, or a <value> for the table"
    # Words that are no number make every further check meaningless.
    other_words = [(line, token) for line, row in lines for token in row if not _is_number(token)]
    for line, token in other_words:
        yield line, f"{token!r} in <tableData> is no number{_suggested(token)}"
    if other_words or not lines:
        return
    # A table of two axes has a first row without a key.
    widths = [len(row) for _, row in lines]
    two = len(widths) > 1 and all(width == widths[0] + 1 for width in widths[1:])
    one = all(width == 2 for width in widths)
    # Tables of engines and propellers name no axis; most of their rows tell.
    if not axes and len(widths) > 1:
        axes = 2 if statistics.mode(widths[1:]) == widths[0] + 1 else 1
    # The number of declared axes must fit the shape of the data.
    if axes == 2 and not two and one:
        yield (
            start,
            (
                "two axes are named by <independentVar>, but <tableData> has one: remove the axis"
                ' with lookup="column", or begin the data with a row of its values'
            ),
        )
    elif axes == 1 and two and not one:
        yield (
            start,
            (
                "one axis is named by <independentVar>, but <tableData> has two: add an"
                ' <independentVar lookup="column">, or leave two columns'
            ),
        )
    elif axes:
        width = 2 if axes == 1 else widths[0] + 1
        first = 0 if axes == 1 else 1
        for line, row in lines[first:]:
            if len(row) != width:
                text = f"this row of <tableData> has {len(row)} numbers; {width} are needed"
                # Programs that reformat XML join lines.
                is_joined = len(lines) == 1 and len(row) % width == 0
                yield line, text + f"; begin a line after every {width}" * is_joined
    # Keys must increase from row to row.
    first = 1 if (two and not one) or (axes == 2 and not one) else 0
    keys = [(line, float(row[0])) for line, row in lines[first:]]
    for (_, before), (line, after) in itertools.pairwise(keys):
        if after <= before:
            yield (
                line,
                f"the row of {after:g} follows that of {before:g}; sort the rows, each value once",
            )


def _doubles(root: Any) -> Iterator[tuple[int, str]]:
    """Yield functions whose name is taken."""
    first: dict[str, int] = {}
    for element in root.iter("function"):
        name = re.sub(r"\s", "-", (element.get("name") or "").strip())
        # Names with a number are one for each engine.
        if not name or "#" in name or element.get("type") == "template":
            continue
        if name in first:
            yield (
                _line(element),
                (
                    f'<function name="{name}"> is there already (line {first[name]}); rename or'
                    " remove one of them"
                ),
            )
        first.setdefault(name, _line(element))


def _units(root: Any) -> Iterator[tuple[int, str]]:
    """Yield units that JSBSim does not know."""
    for element in _functional_elements(root):
        unit = (element.get("unit") or "").strip()
        if unit and unit not in _UNITS:
            if element.tag in _LENGTHS:
                hint = "; write the length in M, FT or IN"
            else:
                matches = difflib.get_close_matches(unit.upper(), sorted(_UNITS), n=1)
                hint = f"; did you mean {matches[0]}?" if matches else ""
            yield (
                _line(element),
                f'<{element.tag} unit="{unit}">: no unit of JSBSim{hint}',
            )


def _missing_parts(root: Any) -> Iterator[tuple[int, str]]:
    """Yield sections, coefficients, settings and axes without which JSBSim loads nothing."""
    if root.tag == "fdm_config":
        for tag in _SECTIONS:
            if root.find(tag) is None:
                yield _line(root), f"<fdm_config> has no <{tag}>; add it"
    for engine_node in root.iterfind("propulsion/engine"):
        is_inline = any(str(child.tag).endswith("_engine") for child in engine_node)
        if not (engine_node.get("file") or is_inline):
            yield _line(engine_node), '<engine> names no file; write <engine file="NAME">'
        if engine_node.find("thruster") is None:
            yield _line(engine_node), "<engine> has no <thruster>; add one inside it"
    for thruster in root.iterfind("propulsion/thruster"):
        yield _line(thruster), "<thruster> is outside of an <engine>; move it into its engine"
    for axis in root.iterfind("aerodynamics/axis"):
        if (name := axis.get("name", "")) not in _AXES:
            matches = difflib.get_close_matches(name.upper(), _AXES, n=1)
            hint = f"; did you mean {matches[0]}?" if matches else ""
            yield _line(axis), f'<axis name="{name}">: allowed are {", ".join(_AXES)}{hint}'
    for tag, number in _COEFFICIENTS.items():
        for component in root.iter(tag):
            missing = [f"c{k}" for k in range(1, number + 1) if component.find(f"c{k}") is None]
            if missing:
                yield _line(component), f"<{tag}> has no <{'>, <'.join(missing)}>; add it"
    for tag in (*_COEFFICIENTS, "pure_gain", "deadband", "pid"):
        for component in root.iterfind(f".//channel/{tag}"):
            if component.find("input") is None:
                yield _line(component), f"<{tag}> has no <input>; add the property that it reads"
    for variable in root.iter("independentVar"):
        lookup = variable.get("lookup", "row")
        if not (lookup in _LENGTHS_OF_TABLES or re.fullmatch(r"axis\d+", lookup)):
            yield _line(variable), f'lookup="{lookup}": allowed are row, column and table'
    for setting in root.iter("setting"):
        for tag in ("position", "time"):
            if setting.find(tag) is None:
                yield _line(setting), f"<setting> of <kinematic> has no <{tag}>; add it"


def _components(root: Any) -> Iterator[tuple[int, str]]:
    """Yield misspelt components, which JSBSim ignores."""
    for element in root.iterfind(".//channel/*"):
        if not isinstance(element.tag, str) or element.tag in _COMPONENTS:
            continue
        matches = difflib.get_close_matches(element.tag, sorted(_COMPONENTS), n=1, cutoff=0.8)
        if matches:
            text = f"<{element.tag}> is no component of JSBSim, which would ignore it"
            yield _line(element), f"{text}; did you mean <{matches[0]}>?"


def _missing_places(root: Any) -> Iterator[tuple[int, str]]:
    """Yield a misspelt centre of gravity or reference point, which JSBSim puts at 0, 0, 0."""
    for tag, place in (("metrics", "AERORP"), ("mass_balance", "CG")):
        for section in [root] if root.tag == tag else root.findall(tag):
            names = {str(node.get("name")): node for node in section.findall("location")}
            matches = difflib.get_close_matches(place, names, n=1)
            if matches and place not in names:
                yield (
                    _line(names[matches[0]]),
                    (
                        f'<location name="{place}"> is missing, so that JSBSim puts it at 0, 0, 0;'
                        f' rename "{matches[0]}"'
                    ),
                )


def _missing_mass(root: Any) -> Iterator[tuple[int, str]]:
    """Yield an empty weight or moment of inertia that is absent, which JSBSim takes for 0."""
    for mass in [root] if root.tag == "mass_balance" else root.findall("mass_balance"):
        # Rockets consist of point masses with a shape.
        if mass.get("file") or mass.find("pointmass/form") is not None:
            continue
        for tag in ("emptywt", *_MOMENTS):
            if mass.find(tag) is not None:
                continue
            misplaced = next(mass.iter(tag), None)
            parent = None if misplaced is None else misplaced.getparent().tag
            if misplaced is not None and parent != "pointmass":
                text = f"<{tag}> is inside <{parent}>, where JSBSim ignores it; move it into"
                yield _line(misplaced), f"{text} <mass_balance>"
            else:
                text = f"<mass_balance> has no <{tag}>, which JSBSim takes for 0; add it"
                yield _line(mass), text


_MAX_THRUST_RAD = math.radians(60.0)
"""Inclination of a thrust that still propels."""


def remarks(files: ModelFiles, names: dict[str, str]) -> Iterator[tuple[str, str]]:
    """Yield (place, text) of what JSBSim loads, but not as its author may expect.

    A property that is declared with two values, two components of one name in channels that always
    run, engines that lift, and contacts of an unknown type.
    """
    components: dict[str, str] = {}
    for name, file in files.local.items():
        root = etree.parse(BytesIO(file.content), etree.XMLParser(resolve_entities=False)).getroot()
        if root.tag in ("initialize", "runscript"):
            continue
        values: dict[str, tuple[str, int]] = {}
        for node in root.iter("property"):
            declared, value = (node.text or "").strip(), node.get("value")
            if value is None or not declared:
                continue
            first, line = values.setdefault(declared, (value, _line(node)))
            if first != value:
                yield (
                    f"{names[name]}:{_line(node)}",
                    (
                        f"<property> {declared} is declared as {value}, in line {line} as {first},"
                        " which JSBSim keeps; remove one of them"
                    ),
                )
        # Channels that run on a condition may share their outputs.
        channels = [one for one in root.iter("channel") if not one.get("execute")]
        for node in (part for one in channels for part in one.iterfind("*[@name]")):
            output = host.component_output(node.get("name", ""))
            if output in components:
                yield (
                    f"{names[name]}:{_line(node)}",
                    (
                        f"<{node.tag}> computes {output}, as another component does"
                        f" ({components[output]}): the later one wins; rename one of them"
                    ),
                )
            # Without the folder: copies of an aircraft get the same sentence, given once.
            components.setdefault(output, f"{name}:{_line(node)}")
        for orient in root.iterfind(".//thruster/orient[pitch]"):
            pitch: Any = orient.find("pitch")
            unit = math.pi / 180.0 if orient.get("unit", "RAD") == "DEG" else 1.0
            if _MAX_THRUST_RAD < abs(_number(pitch) * unit) < math.pi - _MAX_THRUST_RAD:
                yield (
                    f"{names[name]}:{_line(pitch)}",
                    (
                        f"<thruster> with a pitch of {(pitch.text or '').strip()} lifts: its"
                        " throttle stays closed, as in cruise"
                    ),
                )
        for node in root.iterfind(".//contact"):
            if (kind := node.get("type", "")) not in _CONTACTS:
                yield (
                    f"{names[name]}:{_line(node)}",
                    (
                        f'<contact type="{kind}">: JSBSim takes it for STRUCTURE; allowed are'
                        f" {' and '.join(_CONTACTS)}"
                    ),
                )


def burning_engines(files: ModelFiles) -> set[str]:
    """Return the names of the aircraft's engine files whose engines burn fuel."""
    parts = {**files.shared, **files.local}
    kinds = {PurePosixPath(name).stem: part.root for name, part in parts.items()}
    return {name for name, kind in kinds.items() if kind in _BURNING}


def _feeds(root: Any, files: ModelFiles) -> Iterator[tuple[int, str]]:
    """Yield engines that draw fuel from a tank that does not exist, where JSBSim crashes."""
    burning = burning_engines(files)
    tanks = len(root.findall("propulsion/tank"))
    for node in root.iterfind("propulsion/engine"):
        if PurePosixPath(node.get("file", "")).stem not in burning:
            continue
        for feed in node.iterfind("feed"):
            text = (feed.text or "").strip()
            if text.isdigit() and int(text) >= tanks:
                number = f"{tanks} tank{'s' * (tanks != 1)}, counted from 0"
                yield _line(feed), f"<feed> is {text}, of {number}; name one of them"


def _operations(root: Any, operations: frozenset[str]) -> Iterator[tuple[int, str]]:
    """Yield elements of functions that are no operation."""
    for function in root.iter("function"):
        for element in function.iterdescendants("*"):
            tables = {"table", "t"} & {parent.tag for parent in element.iterancestors()}
            if element.tag not in operations and not tables:
                matches = difflib.get_close_matches(str(element.tag), sorted(operations), n=1)
                hint = f"; did you mean <{matches[0]}>?" if matches else ""
                yield (
                    _line(element),
                    (
                        f"<{element.tag}> is no operation of a JSBSim function; JSBSim would ignore"
                        f" it{hint}"
                    ),
                )
