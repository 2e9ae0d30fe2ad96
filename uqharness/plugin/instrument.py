"""Plan of an instrumentation: delta coefficients, bounds, and a record for undo.

The aerodynamics gain six functions, the aircraft's XML one line per system, and
``Systems/model-form.xml`` holds bounds and levels. An aircraft that already has the plugin only
gets new bounds. `plan` touches nothing; `uqharness.plugin.apply` carries it out.
"""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PureWindowsPath
from typing import Any

import tomlkit

from sysid.aerodynamics import COEFFICIENTS
from sysid.foreign.regular_files import parse_json, read_regular, sha256_hex
from sysid.model_form import ModelForm
from sysid.units import FT_M
from uqharness.errors import BadInputError
from uqharness.plugin.card import (
    ERRORS_SYSTEM,
    ERRORS_XML,
    IDLE_SYSTEM,
    IDLE_XML,
    SYSTEM_NAME,
    ScaledFunction,
    add_scales,
    card_text,
    coefficient_properties,
    host_lines,
    scale_entry,
    scale_system,
)
from uqharness.plugin.model_form_xml import constant_xml, model_form_xml
from uqharness.simulator import (
    HOST_SYSTEM,
    PROJECT_ROOT,
    Aircraft,
    AircraftFacts,
    HostProperty,
    content_hash,
    host_system_xml,
    parse_card,
    with_host_entries,
)
from uqharness.xml import (
    AeroSection,
    Insertion,
    Reference,
    SectionEdit,
    add_deltas,
    add_system,
    append_child,
    attribute,
    axis_name,
    declaration,
    folder_documents,
    folder_names,
    insert_before,
    read_document,
    read_reference,
    read_section,
    require_reference,
)

# Record of an instrumentation. An edited file is recorded by its insertions: undo removes them and
# keeps later changes of the author. Added files are removed, replaced ones restored.

FILE_NAME = "uq-instrument.json"
FORMAT = "instrument 1"


@dataclass(frozen=True)
class Change:
    """Change of one file.

    Attributes
    ----------
    before, after : str
        SHA-256; ``before`` is empty for a new file.
    insertions : tuple of Insertion
        Insertions into an edited file, at bytes of the original.
    content : bytes or None
        Original content of a replaced file.
    """

    before: str
    after: str
    insertions: tuple[Insertion, ...] = ()
    content: bytes | None = None

    @property
    def edited(self) -> bool:
        """Return whether an author's file was edited."""
        return bool(self.insertions)


def make_change(before: bytes | None, after: bytes, insertions: Sequence[Insertion] = ()) -> Change:
    """Return the change from ``before`` (None for a new file) to ``after``."""
    old = "" if before is None else sha256_hex(before)
    old_content = None if insertions else before
    return Change(
        old, sha256_hex(after), tuple(sorted(insertions, key=lambda item: item.at)), old_content
    )


def to_json(changes: Mapping[str, Change]) -> bytes:
    """Return the record as JSON: bytes of XML as Latin-1 text, replaced files in base 64."""
    files: dict[str, Any] = {}
    for name, change in sorted(changes.items()):
        row: dict[str, Any] = {"before": change.before, "after": change.after}
        # Latin-1 maps each byte to one character.
        if change.edited:
            row["insertions"] = [
                [i.at, i.text.decode("latin-1"), i.removed.decode("latin-1")]
                for i in change.insertions
            ]
        elif change.content is not None:
            row["content"] = base64.b64encode(change.content).decode("ascii")
        files[name] = row
    return (json.dumps({"format": FORMAT, "files": files}, indent=1) + "\n").encode("utf-8")


def read_record(folder: Path) -> dict[str, Change]:
    """Return the recorded changes of a folder. Raises BadInputError without a valid record."""
    path = folder / FILE_NAME
    try:
        document = parse_json(read_regular(path))
        if document["format"] != FORMAT:
            raise BadInputError(
                f"{path}: format is {str(document['format'])[:80]!r}; '{FORMAT}' is read"
            )
        # Names are checked, because undo writes and removes these files.
        return {_inside(name): _change(row) for name, row in document["files"].items()}
    except FileNotFoundError:
        raise BadInputError(
            f"{folder}: no {FILE_NAME}, so nothing here was instrumented by uqharness"
        ) from None
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        if isinstance(error, BadInputError):
            raise
        raise BadInputError(f"{path}: is no record of an instrumentation ({error})") from None


def _inside(name: str) -> str:
    """Return a name of a file inside the folder; ValueError for any other.

    Undo writes and removes the named files.
    """
    parts = name.split("/")
    # A damaged record must not make undo write elsewhere.
    hidden = any(part in ("", "..") or part.startswith(".") or len(part) > 100 for part in parts)
    if hidden or name == FILE_NAME or PureWindowsPath(name).drive or "\\" in name or "\0" in name:
        raise ValueError(f"it names {name[:200]!r}, which is no file that an instrumentation makes")
    return name


def _change(row: Mapping[str, Any]) -> Change:
    """Return a change from its JSON. Raises ValueError."""
    insertions = tuple(
        Insertion(int(at), text.encode("latin-1"), removed.encode("latin-1"))
        for at, text, removed in row.get("insertions", ())
    )
    content = row.get("content")
    before, after = row["before"], row["after"]
    if not (isinstance(before, str) and isinstance(after, str)) or any(
        i.at < 0 for i in insertions
    ):
        raise ValueError("a hash is no text, or an insertion lies before its file")
    return Change(before, after, insertions, None if content is None else base64.b64decode(content))


def restore(path: Path, change: Change, content: bytes) -> bytes | None:
    """Return a file's content without the instrumentation; None if the file is to be removed.

    Raises BadInputError unless each inserted text still occurs exactly once.
    """
    if not change.edited:
        return change.content
    # Unchanged since: restore by bytes, else by searching the inserted texts.
    if sha256_hex(content) == change.after:
        return _undo_insertions(path, change, content)
    for insertion in change.insertions:
        if content.count(insertion.text) != 1:
            line = next(iter(insertion.text.decode("latin-1").strip().splitlines()), "")
            raise BadInputError(
                f"{path}: changed since it was instrumented, and the lines that begin with '{line}'"
                " are not there once as they were written; take the uq/ lines out by hand"
            )
        content = content.replace(insertion.text, insertion.removed)
    return content


def _undo_insertions(path: Path, change: Change, content: bytes) -> bytes:
    """Return the original content of an unchanged file, checked by its digest."""
    pieces, position, shift = [], 0, 0
    for insertion in change.insertions:
        # Earlier insertions shift later ones.
        begin = insertion.at + shift
        pieces += [content[position:begin], insertion.removed]
        position = begin + len(insertion.text)
        shift += len(insertion.text) - len(insertion.removed)
    out = b"".join([*pieces, content[position:]])
    if sha256_hex(out) != change.before:
        raise BadInputError(
            f"{path}: the record of the instrumentation does not fit this file; take the uq/ lines"
            " out by hand"
        )
    return out


SYSTEM = "model-form"
AIR_SYSTEM = "air"
AIR_FILE = PROJECT_ROOT / "aircraft" / "espaaro" / "Systems" / "air.xml"
_SAME = 1e-6  # a card's rounded figures mean the XML's metrics
_PLUGIN_NAME = re.compile(r"uq/[\w./\-]+")


@dataclass(frozen=True)
class Bounds:
    """Source of bounds: a model form, or constant (lower, upper) per coefficient; else all zero."""

    form: ModelForm | None = None
    constant: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Plan:
    """What an instrumentation would write.

    Attributes
    ----------
    section : AeroSection
        The aircraft's aerodynamics.
    files : mapping
        Relative name to content.
    changes : mapping
        Relative name to its record.
    scaled : tuple of Scaled
        Functions with scale and bias.
    had_plugin : bool
        Whether the aerodynamics read uq/<C>/delta before.
    notes : tuple of str
        Remarks for the user.
    rows : tuple of (str, str, str)
        Coefficient, axis, and ``file:line`` of each delta.
    """

    section: AeroSection
    files: Mapping[str, bytes]
    changes: Mapping[str, Change]
    scaled: tuple[ScaledFunction, ...]
    had_plugin: bool
    notes: tuple[str, ...]
    rows: tuple[tuple[str, str, str], ...]


def plan(
    aircraft: Aircraft,
    bounds: Bounds,
    facts: AircraftFacts | None = None,
    air: bool = False,
    mass: Sequence[Insertion] = (),
    host: Sequence[HostProperty] = (),
) -> Plan:
    """Plan the instrumentation of an aircraft; nothing is written.

    Parameters
    ----------
    aircraft : Aircraft
        The aircraft.
    bounds : Bounds
        Error bounds.
    facts : AircraftFacts, optional
        Facts for a card, if the aircraft has none.
    air : bool
        Whether to add the air system (Systems/air.xml).
    mass : sequence of Insertion
        Edits of its XML (`mass_insertions`).
    host : sequence of HostProperty
        What the aircraft reads of a host, which a system then provides.

    Raises
    ------
    BadInputError
        With file and line: mixed axes, no reference, names that are taken, bounds on a control that
        the card does not give.
    """
    # Refuse what cannot be instrumented before anything is planned.
    section = read_section(aircraft.folder, aircraft.card.aircraft.xml)
    _refuse_outside(section)
    reference = coefficient_reference(aircraft, section)
    if None in (reference.S_sqft, reference.b_ft, reference.c_ft):
        require_reference(section)
    notes = _notes(section)
    had_plugin = _has_plugin(section)
    edit = SectionEdit(section, tuple((section.main, insertion) for insertion in mass))
    scaled: list[ScaledFunction] = []
    files: dict[str, bytes] = {}
    edit = _add_host(aircraft, host, edit, files)
    if had_plugin:
        system = _plugin_system(aircraft, section)
    else:
        _refuse_taken(aircraft)
        # New plugin: bounds, deltas, and scales where coefficients have no properties.
        system = _system_file(aircraft, SYSTEM)
        coefficient_names = coefficient_properties(list(folder_documents(aircraft.folder)))
        if coefficient_names:
            notes.append(
                f"{len(coefficient_names)} coefficient properties ({coefficient_names[0]}, ...): no"
                " scales and biases are"
                " needed"
            )
        else:
            edit, scaled = add_scales(edit, reference)
            if scaled:
                files[_system_file(aircraft, SYSTEM_NAME)] = scale_system(scaled)
        edit = add_deltas(edit, {c: [f"uq/{c}/delta"] for c in COEFFICIENTS}, "uq", reference)
        edit = add_system(edit, SYSTEM)
        if scaled:
            edit = add_system(edit, SYSTEM_NAME)
    if air and not folder_names(aircraft.folder, "air/"):
        files[_system_file(aircraft, AIR_SYSTEM)] = AIR_FILE.read_bytes()
        edit = add_system(edit, AIR_SYSTEM)
    card = None
    if facts is not None and not aircraft.has_card:
        edit = _add_card(aircraft, facts, scaled, edit, files, notes)
    elif scaled and aircraft.has_card:
        card = _with_parameters(aircraft.folder / "airframe.toml", scaled, notes)
    if host and aircraft.has_card and not aircraft.card.host:
        card = _with_host(aircraft.folder / "airframe.toml", host, card)
    # Bounds are written in every case.
    files[system] = bounds_xml(aircraft, bounds)
    if bounds.form is not None and bounds.form.aircraft.sha256 != content_hash(aircraft):
        notes.append(
            f"the bounds were made for aircraft {bounds.form.aircraft.name} with other files"
            f" (SHA-256 {bounds.form.aircraft.sha256[:12]}...); they mean something only if its"
            " aerodynamics are the same"
        )
    # Record new and replaced files; edited ones follow.
    changes = {
        name: make_change(_content(aircraft.folder / name), content)
        for name, content in files.items()
    }
    for document in section.documents:
        if mine := edit.insertions_into(document):
            name = document.path.relative_to(aircraft.folder).as_posix()
            files[name] = edit.files()[document.path]
            changes[name] = make_change(document.raw, files[name], mine)
    if card is not None:
        raw = (aircraft.folder / "airframe.toml").read_bytes()
        files["airframe.toml"] = raw + card.text
        changes["airframe.toml"] = make_change(raw, raw + card.text, [card])
    return Plan(
        section, files, changes, tuple(scaled), had_plugin, tuple(notes), _rows(section, had_plugin)
    )


def _add_host(
    aircraft: Aircraft, host: Sequence[HostProperty], edit: SectionEdit, files: dict[str, bytes]
) -> SectionEdit:
    """Add the system of the host to ``files``, loaded before all others; return the edit."""
    main = edit.section.main
    host_node = next(
        (
            node
            for node in main.root.all("system")
            if Path(attribute(node, "file")).stem == HOST_SYSTEM
        ),
        None,
    )
    if host_node is not None:
        # An edited [host] of the card is written again.
        if aircraft.card.host:
            name = _system_file(aircraft, HOST_SYSTEM, may_exist=True)
            files[name] = host_system_xml(with_host_entries(host, aircraft.card.host))
        return edit
    if not host:
        return edit
    files[_system_file(aircraft, HOST_SYSTEM)] = host_system_xml(host)
    sections = ("system", "autopilot", "flight_control", "aerodynamics")
    nodes = [child for child in main.root.children if child.tag in sections]
    first = next((node for tag in sections for node in nodes if node.tag == tag), None)
    line = f'<system file="{HOST_SYSTEM}"/>'
    insertion = (
        append_child(main, main.root, [line])
        if first is None
        else insert_before(main, first, [line])
    )
    return edit.plus(main, insertion)


def _add_card(
    aircraft: Aircraft,
    facts: AircraftFacts,
    scaled: Sequence[ScaledFunction],
    edit: SectionEdit,
    files: dict[str, bytes],
    notes: list[str],
) -> SectionEdit:
    """Add a card and its systems to ``files`` and remarks to ``notes``; return the edit."""
    errors = not folder_names(aircraft.folder, "nav/")
    if errors:
        files[_system_file(aircraft, ERRORS_SYSTEM)] = ERRORS_XML
        edit = add_system(edit, ERRORS_SYSTEM)
    if not facts.engines and not folder_names(aircraft.folder, "fcs/throttle-cmd-norm"):
        files[_system_file(aircraft, IDLE_SYSTEM)] = IDLE_XML
        edit = add_system(edit, IDLE_SYSTEM)
    files["airframe.toml"] = card_text(
        aircraft.name, aircraft.card.aircraft.xml, facts, scaled, errors
    ).encode("utf-8")
    return edit


def bounds_xml(aircraft: Aircraft, bounds: Bounds) -> bytes:
    """Return model-form.xml for bounds. Raises BadInputError."""
    if bounds.form is not None:
        try:
            return model_form_xml(bounds.form, aircraft)
        except BadInputError as error:
            raise BadInputError(f"bounds for {aircraft.folder}: {error}") from None
    remark = (
        "Constant bounds, given by hand."
        if bounds.constant
        else "No bounds yet: all are zero. Write some, or instrument again."
    )
    return constant_xml(bounds.constant, remark)


def coefficient_reference(aircraft: Aircraft, section: AeroSection) -> Reference:
    """Return the reference area and lengths of coefficients in the aircraft's XML.

    JSBSim's own ``metrics/...`` are used where the card agrees with them to 1e-6, else the card's
    numbers.
    """
    card = aircraft.card.reference
    card_values = (
        card.S_m2 and card.S_m2 / FT_M**2,
        card.b_m and card.b_m / FT_M,
        card.c_m and card.c_m / FT_M,
    )
    xml_values = read_reference(section)
    # None takes JSBSim's own metrics.
    return Reference(
        *(
            None if w is None or abs(w - x) <= _SAME * w else w
            for w, x in zip(card_values, xml_values, strict=True)
        )
    )


def metrics_of(aircraft: Aircraft) -> tuple[float, float, float]:
    """Return S [m2], b and c [m] of the XML. Raises BadInputError."""
    S, b, c = read_reference(read_section(aircraft.folder, aircraft.card.aircraft.xml))
    return S * FT_M**2, b * FT_M, c * FT_M


def _has_plugin(section: AeroSection) -> bool:
    """Return whether the aerodynamics add all six deltas; BadInputError if they add some."""
    delta_places: dict[str, str] = {}
    for document in section.documents:
        for node in document.root.walk():
            if node.tag in ("property", "p") and (
                match := re.fullmatch(r"uq/(C\w)/delta", node.text.strip())
            ):
                delta_places.setdefault(match.group(1), document.where(node))
    if not delta_places:
        return False
    # Some deltas only: neither instrumented nor clean.
    missing = [c for c in COEFFICIENTS if c not in delta_places]
    if missing:
        name, where = next(iter(delta_places.items()))
        raise BadInputError(
            f"{where}: the aerodynamics read uq/{name}/delta but not uq/{missing[0]}/delta;"
            " complete the plugin or remove it"
        )
    return True


def _refuse_taken(aircraft: Aircraft) -> None:
    """Raise BadInputError if the aircraft uses names of the plugin."""
    for document in folder_documents(aircraft.folder):
        for node in document.root.walk():
            for text in (node.text.strip(), *(value.strip() for value in node.attributes.values())):
                if _PLUGIN_NAME.fullmatch(text):
                    raise BadInputError(
                        f"{document.where(node)}: '{text}' is a name of the plugin, which this"
                        " aircraft lacks; rename it, or undo an earlier instrumentation"
                    )


def _refuse_outside(section: AeroSection) -> None:
    """Raise BadInputError for a file outside the folder, which a copy would not find."""
    for node in section.main.root.walk():
        name = attribute(node, "file")
        if name and ".." in Path(name).parts:
            raise BadInputError(
                f'{section.main.where(node)}: <{node.tag} file="{name}"> lies outside the'
                " aircraft's folder, and a copy elsewhere would not find it; move the file into"
                " the folder"
            )


def _notes(section: AeroSection) -> list[str]:
    """Return remarks about ignored axes and induced drag."""
    notes = [
        f'{axis.document.where(axis.node)}: JSBSim ignores this <axis name="{axis.name}">, because'
        " a later one replaces it"
        for axis in section.overridden
    ]
    induced = any(
        "aero/cl-squared" in node.text
        for document in section.documents
        for node in document.root.walk()
    )
    if induced:
        notes.append(
            "the drag follows aero/cl-squared: a delta in lift moves it from the next frame on, as"
            " more lift of any origin does"
        )
    return notes


def _plugin_system(aircraft: Aircraft, section: AeroSection) -> str:
    """Return the name, within the folder, of the system that declares uq/active."""
    for node in section.main.root.all("system"):
        name = attribute(node, "file")
        if not name:
            if declaration(section.main, "uq/active") is not None:
                raise BadInputError(
                    f"{section.main.where(node)}: the plugin's system is part of the aircraft's"
                    " main XML; move it to a file, "
                    f'<system file="{SYSTEM}"/>, so that bounds can replace it'
                )
            continue
        # The system may lie outside the folder; a copy then gets its own.
        for path in _candidates(aircraft, name):
            if path.is_file() and declaration(read_document(path), "uq/active") is not None:
                inside = path.is_relative_to(aircraft.folder)
                return (
                    path.relative_to(aircraft.folder).as_posix()
                    if inside
                    else _system_file(aircraft, name)
                )
    raise BadInputError(
        f"{section.main.where(section.main.root)}: the aerodynamics read uq/CX/delta, but no"
        " <system> declares uq/active; add "
        f'<system file="{SYSTEM}"/>'
    )


def _candidates(aircraft: Aircraft, name: str) -> list[Path]:
    """Return where JSBSim looks for a system, in its order (FGFCS::FindFullPathName)."""
    file = name if name.endswith(".xml") else f"{name}.xml"
    return [
        aircraft.folder / file,
        *(aircraft.folder / sub / file for sub in ("Systems", "systems")),
        aircraft.systems_path / file,
    ]


def _system_file(aircraft: Aircraft, name: str, may_exist: bool = False) -> str:
    """Return the file of a new system; BadInputError if the aircraft has another of that name.

    With ``may_exist`` a file of that name is this program's.
    """
    for path in _candidates(aircraft, name)[:3]:
        if path.is_file() and may_exist:
            return path.relative_to(aircraft.folder).as_posix()
        if path.is_file() and declaration(read_document(path), "uq/active") is None:
            raise BadInputError(
                f"{path}:1: the aircraft has a system of this name, which the plugin needs; rename"
                " it"
            )
    return f"Systems/{name}.xml"


def _with_parameters(
    card: Path, scaled: list[ScaledFunction], notes: list[str]
) -> Insertion | None:
    """Return the insertion of scales into [parameters] of a card; None with a note if it fails."""
    raw = card.read_bytes()
    newline = b"\r\n" if raw.count(b"\r\n") * 2 > raw.count(b"\n") else b"\n"
    tables = [tomlkit.dumps({"parameters": {row.scale: scale_entry(row)}}) for row in scaled]
    text = newline.join([b"", *"".join(tables).encode().split(b"\n")])
    text = text if raw.endswith(b"\n") or not raw else newline + text
    try:
        # The extended card must still be valid.
        parse_card((raw + text).decode("utf-8"), card)
    except (UnicodeDecodeError, BadInputError):
        notes.append(
            f"{card}: the scales could not be added to [parameters]; name them by hand or with"
            " --params"
        )
        return None
    return Insertion(len(raw), text)


def _with_host(card: Path, host: Sequence[HostProperty], before: Insertion | None) -> Insertion:
    """Return the insertion of [host] into a card, after another insertion at its end."""
    raw = card.read_bytes()
    newline = b"\r\n" if raw.count(b"\r\n") * 2 > raw.count(b"\n") else b"\n"
    lines = ["", *host_lines(host), ""]
    text = newline.join(line.encode() for line in lines)
    if before is not None:
        return Insertion(before.at, before.text + text)
    return Insertion(len(raw), text if raw.endswith(b"\n") or not raw else newline + text)


def _content(path: Path) -> bytes | None:
    """Return the content of a file; None if it does not exist."""
    return path.read_bytes() if path.is_file() else None


def _rows(section: AeroSection, had_plugin: bool) -> tuple[tuple[str, str, str], ...]:
    """Return (coefficient, axis, file:line) of each delta."""
    if had_plugin:
        return tuple((c, "already there", "") for c in COEFFICIENTS)
    turned_axes = {"wind": "DRAG, SIDE, LIFT", "stability": "X, Z (stability)"}.get(section.force)
    out = []
    for slot, c in enumerate(COEFFICIENTS):
        axis = section.axes.get(slot)
        name = axis_name(section, slot)
        # Increments in turned axes spread over several axis elements.
        turned = (
            (turned_axes is not None and (slot != 1 or section.force == "wind"))
            if slot < 3
            else section.moment != "body"
        )
        target = (
            name
            if not turned
            else turned_axes
            if slot < 3 and turned_axes
            else f"ROLL, PITCH, YAW ({section.moment})"
        )
        where = (
            axis.document.where(axis.node)
            if axis
            else f"{section.document.where(section.node)} (axis made)"
        )
        out.append((c, target, where))
    return tuple(out)
